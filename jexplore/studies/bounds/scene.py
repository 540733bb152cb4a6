"""Cells that a walk must see, and the cells from which each is visible. On the host, exact."""

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from jexplore.config import Lidar, Rules
from jexplore.grid import radius_d2
from jexplore.raycast import HEADINGS
from jexplore.studies.bounds.sights import TABLE_BYTES, Sights, TableOfSights, rays_of
from jexplore.worlds.world import World


@functools.lru_cache(maxsize=2)
def _sights(occupied: bytes, shape: tuple[int, int], pad: int, lidar: Lidar, cell_m: float) -> Sights:
    """Return the `Sights` of a world, made once for all its starts."""
    rays = rays_of(lidar, cell_m)
    small = TableOfSights.size((shape[0] - 2 * pad, shape[1] - 2 * pad), pad, rays) <= TABLE_BYTES
    kind = TableOfSights if small else Sights
    return kind(np.frombuffer(occupied, bool).reshape(shape), pad, rays)


@dataclasses.dataclass(frozen=True)
class Scene:
    """A world and a start, made ready: maps padded with walls by the scanner's range, cells as flat numbers."""

    width: int
    """Of the padded maps."""
    pad: int
    """Cells of padding on each side."""
    shape: tuple[int, int]
    """Of the world."""
    start: int
    """The robot's cell."""
    occupied: np.ndarray
    """`[P]` bool."""
    clear: np.ndarray
    """`[P]` bool, where the reference robot may stand: clear cells and free ones near the start, all that a path
    leads to."""
    any: np.ndarray
    """`[P]` bool, where any robot may stand: free cells that a path leads to."""
    must_see: np.ndarray
    """`[P]` bool, places to be seen, other than those seen at the start."""
    sights: Sights
    """Visibility between cells."""

    def cells(self, flat: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns in the world of cells with these numbers."""
        rows, cols = np.divmod(np.asarray(flat), self.width)
        return rows - self.pad, cols - self.pad

    def region(self, cell: int) -> np.ndarray:
        """Return cells from which some beam enters a cell, standing anywhere: `[n]` int, sorted, itself included."""
        return self.sights.region(cell, self.any)


def prepare_scene(world: World, start: tuple[int, int, int], lidar: Lidar, rules: Rules, looks: int) -> Scene | None:
    """Make the `Scene` of a start (row, col, heading in degrees), with `looks` scans there; None if it is enclosed."""
    pad = int(rays_of(lidar, world.cell_m).length.max()) + 1
    occupied = np.pad(world.occupied, pad, constant_values=True)
    row, col = start[0] + pad, start[1] + pad
    clear = ~_within(occupied, radius_d2(rules.clearance_m, world.cell_m))
    rows, cols = np.indices(occupied.shape)
    near = (rows - row) ** 2 + (cols - col) ** 2 <= radius_d2(rules.near_m, world.cell_m)
    stand = reachable_from(clear | (~occupied & near), row, col)
    goal = clear & stand
    if occupied[row, col] or not np.any(goal & ((rows != row) | (cols != col))):
        return None
    width = occupied.shape[1]
    sights = _sights(occupied.tobytes(), occupied.shape, pad, lidar, world.cell_m)
    must_see = goal.reshape(-1)
    for look in range(looks):
        must_see[sights.seen(row * width + col, (start[2] // 45 + look * HEADINGS // looks) % HEADINGS)] = False
    return Scene(
        *(width, pad, world.shape, row * width + col, occupied.reshape(-1), stand.reshape(-1)),
        any=reachable_from(~occupied, row, col).reshape(-1),
        must_see=must_see,
        sights=sights,
    )


def _within(occupied, d2):
    """Return cells whose distance to the nearest occupied one is at most sqrt(d2) cells."""
    nearest: Any = ndimage.distance_transform_edt(~occupied, return_distances=False, return_indices=True)
    rows, cols = nearest
    at = np.indices(occupied.shape)
    return (rows - at[0]) ** 2 + (cols - at[1]) ** 2 <= d2


def reachable_from(free: np.ndarray, row: int, col: int) -> np.ndarray:
    """Return the cells that a path reaches, among them the start, which need not be free.

    A diagonal motion needs both orthogonal neighbours, so that it reaches nothing that straight ones do not.
    """
    free = free.copy()
    free[row, col] = True
    labels, _ = ndimage.label(free)  # type: ignore[misc]
    return labels == labels[row, col]
