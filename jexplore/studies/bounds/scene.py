"""Cells that a walk must see, those from which each is visible, and those seen from a cell. On the host, exact."""

import dataclasses
import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jexplore.config import InputError
from jexplore.grid import radius_d2
from jexplore.raycast import HEADINGS, beam_table
from jexplore.rooms.scores import label_components
from jexplore.rules import Lidar, Rules
from jexplore.worlds.starts import clear_of_walls
from jexplore.worlds.world import World

TABLE_BYTES = 2_000_000_000  # of the visibility from every cell, at most: 0.36 GB for 1,000,000 cells of 0.1 m
ROWS_BYTES = 300_000_000  # of the cache of single cells


class Rays(NamedTuple):
    """The different beams of the eight headings: the cells that each enters, in order, relative to the robot's."""

    drow: np.ndarray  # [R, S] int32
    dcol: np.ndarray  # [R, S] int32
    length: np.ndarray  # [R] int32, cells entered
    headings: np.ndarray  # [8, R] bool, which of them a scan with each heading has


@functools.lru_cache(maxsize=8)
def rays_of(lidar: Lidar, cell_m: float) -> Rays:
    """Return the `Rays` of a scanner."""
    table = beam_table(lidar, cell_m, 1)
    steps = max(1, int(np.max(table.length)))
    drow, dcol = (np.asarray(a)[:, :steps].swapaxes(1, 2).reshape(-1, steps) for a in (table.drow, table.dcol))
    length = np.asarray(table.length).reshape(-1)
    keys, which = np.unique(np.concatenate([length[:, None], drow, dcol], axis=1), axis=0, return_inverse=True)
    headings = np.zeros((HEADINGS, len(keys)), bool)
    headings[np.arange(HEADINGS)[:, None], which.reshape(HEADINGS, -1)] = True
    return Rays(keys[:, 1 : steps + 1], keys[:, steps + 1 :], keys[:, 0], headings)


class Sights:
    """Visibility on a map padded with walls by the scanner's range; cells are flat numbers in the padded map.

    Every ray of every cell is followed once; after that a region or a view is a look-up.
    """

    def __init__(self, occupied: np.ndarray, pad: int, rays: Rays) -> None:
        self.rays = rays
        self._offset = rays.drow * occupied.shape[1] + rays.dcol
        self._ray, self._step = np.nonzero(np.arange(self._offset.shape[1]) < rays.length[:, None])
        self._leads = self._offset[self._ray, self._step]
        self._first, self._last = pad * occupied.shape[1], (occupied.shape[0] - pad) * occupied.shape[1]
        n = self._last - self._first  # cells of the rows that are not padding
        count = np.dtype(np.min_scalar_type(self._offset.shape[1]))
        if len(rays.length) * n * count.itemsize > TABLE_BYTES:
            raise InputError(f"the world has too many cells to be bounded, {n}: use a larger cell or a shorter range")
        free, still = (~occupied.reshape(-1)).astype(np.uint8), np.empty(n, np.uint8)
        self._free_steps = np.zeros((len(rays.length), n), count)
        for ray, steps in enumerate(rays.length):  # one step of one ray at a time, for all cells together
            still[:] = 1
            for leads in self._offset[ray, :steps]:
                still &= free[self._first + leads : self._last + leads]
                self._free_steps[ray] += still

    def region(self, cell: int, stand: np.ndarray) -> np.ndarray:
        """Return cells of `stand` from which some beam enters a free cell: `[n]` int, sorted, itself included.

        Cast from where the robot stands: sight on a lattice is not symmetric. `stand` is `[P]` bool, without padding.
        """
        place = cell - self._leads
        known = np.flatnonzero((place >= self._first) & (place < self._last))
        known = known[stand[place[known]]]
        sees = self._free_steps[self._ray[known], place[known] - self._first] > self._step[known]
        found = np.append(place[known[sees]], cell)
        return np.unique(found[stand[found]])

    def seen(self, cell: int, heading: int | None = None) -> np.ndarray:
        """Return free cells seen by a robot on a cell, turned to all headings or to one: `[n]` int, itself included."""
        own = slice(None) if heading is None else self.rays.headings[heading]
        offset, steps = self._offset[own], self._free_steps[own, cell - self._first]
        return np.append(cell + offset[np.arange(offset.shape[1]) < steps[:, None]], cell)


class Coverage:
    """Cells seen along walks, with a cache for single cells."""

    def __init__(self, sights: Sights, must_see: np.ndarray) -> None:
        self.sights, self.cells = sights, np.flatnonzero(must_see)
        self._place = np.full(len(must_see), -1, np.int32)
        self._place[self.cells] = np.arange(len(self.cells))
        self._rows: dict[int, np.ndarray] = {}

    def unseen(self, walk: np.ndarray) -> np.ndarray:
        """Return cells that must be seen and are not seen from a walk: `[n]` int."""
        seen = np.zeros(-(-len(self.cells) // 8), np.uint8)
        for cell in dict.fromkeys(walk.tolist()):
            if len(self._rows) * len(seen) > ROWS_BYTES:
                self._rows.clear()
            if cell not in self._rows:
                own = np.zeros(len(self.cells) + 1, bool)  # the last is of what need not be seen
                own[self._place[self.sights.seen(cell)]] = True
                self._rows[cell] = np.packbits(own[:-1])
            seen |= self._rows[cell]
        return self.cells[np.unpackbits(seen, count=len(self.cells)) == 0]


@functools.lru_cache(maxsize=2)
def _sights(occupied: bytes, shape: tuple[int, int], pad: int, lidar: Lidar, cell_m: float) -> Sights:
    """Return the `Sights` of a world, made once for all its starts."""
    return Sights(np.frombuffer(occupied, bool).reshape(shape), pad, rays_of(lidar, cell_m))


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
    clear = clear_of_walls(occupied, rules.clearance_m, world.cell_m)
    rows, cols = np.indices(occupied.shape)
    near = (rows - row) ** 2 + (cols - col) ** 2 <= radius_d2(rules.near_m, world.cell_m)
    # A diagonal motion needs both orthogonal neighbours, so that it reaches nothing that straight ones do not.
    stand, anywhere = (label_components(free) for free in (clear | (~occupied & near), ~occupied))
    stand, anywhere = stand == stand[row, col], anywhere == anywhere[row, col]
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
        any=anywhere.reshape(-1),
        must_see=must_see,
        sights=sights,
    )
