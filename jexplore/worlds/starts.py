"""Starts of episodes in a world: the cells where a robot has room, and starts drawn from them."""

import hashlib
import operator
import os
import re
from collections.abc import Iterable
from typing import SupportsIndex

import numpy as np
from scipy import ndimage

from jexplore.arrays.padding import within
from jexplore.config import InputError
from jexplore.grid import radius_d2
from jexplore.rooms.scores import label_components
from jexplore.worlds.world import World, ring_of

HEADINGS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)


def clear_of_walls(occupied: np.ndarray, clearance_m: float, cell_m: float) -> np.ndarray:
    """Return the clear cells `[H, W]` bool: free, and no occupied cell within the clearance, centre to centre."""
    if not occupied.any():
        return ~occupied
    d2 = np.rint(np.asarray(ndimage.distance_transform_edt(~occupied)) ** 2)
    return d2 > radius_d2(clearance_m, cell_m)


def largest_component(mask: np.ndarray, counted: np.ndarray | None = None) -> np.ndarray:
    """Return the cells of the largest 4-connected component; of equal ones, of that with the lowest flat index.

    With `counted`, some cells of the mask, only these have a size and are returned.
    """
    labels, counted = label_components(mask), mask if counted is None else counted
    return counted & (labels == np.argmax(np.bincount(labels[counted], minlength=1)))


def clear_in(world: World, clearance_m: float) -> np.ndarray:
    """Return the clear cells of a world, beyond whose edge is wall: `[H, W]` bool; arguments as for `start_region`."""
    ring = ring_of(world.occupied)
    clear = clear_of_walls(np.pad(world.occupied, ring, constant_values=True), clearance_m, world.cell_m)
    clear = within(clear, world.shape, ring)
    return clear if world.within is None else clear & world.within


def start_region(world: World, clearance_m: float) -> np.ndarray:
    """Return the cells that a drawn start may lie in: the largest 4-connected component of the clear cells.

    Only a world's region counts, and what its partial map shows to be free. Of equal ones it is the first.
    """
    clear = clear_in(world, clearance_m)
    return largest_component(clear, clear if world.known is None else clear & (world.known == 0))


def draw_starts(world: World, seed: int, n: int, clearance_m: float) -> np.ndarray:
    """Draw starts 0 to n - 1 of a seed: `[n, 3]` int32, row, col, heading in degrees.

    Uniform over the start region and the multiples of 45 degrees. Start i depends on the world and its name, the
    clearance, `seed` and i alone: neither on n nor on padding. Of a map file's name the folder does not count; a
    generator's name without a seed is that with seed 0.
    """
    if seed < 0:
        raise InputError(f"the seed of starts must be at least 0, got {seed}")
    cells, words, starts = start_cells(world, clearance_m), _words(world.name), []
    for i in range(n):
        generator = np.random.Generator(np.random.PCG64([seed, i, *words]))
        starts.append((*cells[generator.integers(len(cells))], HEADINGS_DEG[generator.integers(len(HEADINGS_DEG))]))
    return np.array(starts, np.int32).reshape(n, 3)


def start_cells(world: World, clearance_m: float) -> np.ndarray:
    cells = np.argwhere(start_region(world, clearance_m))
    if not len(cells):
        raise InputError(
            f"{world.name or 'world'!r}: no cell has more than {clearance_m:g} m of clearance; "
            "use a smaller rules.clearance_m or a roomier map"
        )
    return cells


def _words(name: str) -> list[int]:
    """Hash a world's name into the seed of its starts: four 32-bit numbers."""
    name = re.split(r"[/\\]", name)[-1]
    name = re.sub(r"^([A-Za-z_][\w-]*)(?=:|$)", r"\1#0", name)
    return np.frombuffer(hashlib.sha256(os.fsencode(name)).digest()[:16], "<u4").tolist()


def check_start(
    world: World, start: Iterable[SupportsIndex], clearance_m: float, near_m: float = 0.5
) -> tuple[int, int, int]:
    """Refuse a start that an episode cannot leave or stand on; return it as integers, the heading from 0 to 315.

    The robot may drive over clear cells and over free cells within `near_m` of the start. A start from which no clear
    cell but itself can be reached that way is enclosed.
    """
    try:
        row, col, heading = (operator.index(value) for value in start)
    except (TypeError, ValueError):
        raise InputError(f"start must be three integers row,col,heading_deg, got {start!r}") from None
    rows, cols = world.shape
    place = f"start ({row}, {col}) of {world.name or 'world'!r}"
    if not (0 <= row < rows and 0 <= col < cols):
        raise InputError(f"{place}: lies outside; rows are 0 to {rows - 1}, columns 0 to {cols - 1}")
    if world.occupied[row, col]:
        raise InputError(f"{place}: lies in a wall; choose a free cell")
    if heading % 45:
        raise InputError(f"{place}: its heading must be a multiple of 45 degrees, got {heading}")
    if world.within is not None and not world.within[row, col]:
        raise InputError(f"{place}: lies outside the region that the robot is to stay in")
    reached = reached_from(world, row, col, clearance_m, near_m)
    reached[row, col] = False
    if not reached.any():
        raise InputError(f"{place}: is enclosed; no cell with more than {clearance_m:g} m of clearance can be reached")
    return row, col, heading % 360


def reached_from(world: World, row: int, col: int, clearance_m: float, near_m: float) -> np.ndarray:
    """Return the clear cells that a robot reaches from a free cell: `[H, W]` bool; arguments as of `check_start`."""
    clear = clear_in(world, clearance_m)
    rows, cols = world.shape
    dy, dx = np.arange(rows)[:, None] - row, np.arange(cols)[None, :] - col
    near = (dy * dy + dx * dx <= radius_d2(near_m, world.cell_m)) & ~world.occupied
    if world.within is not None:
        near &= world.within
    labels = label_components(clear | near)
    return clear & (labels == labels[row, col])
