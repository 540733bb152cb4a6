"""How far a robot sees from every cell, and with that from where each cell is seen. On the host, exact."""

import functools
from typing import Any, NamedTuple

import numpy as np

from jexplore.config import Lidar
from jexplore.raycast import HEADINGS, beam_table

MOST_BYTES = 1_000_000_000  # of a table of sights
ROWS_BYTES = 300_000_000  # of what is remembered of single cells


class Rays(NamedTuple):
    """The different beams of the eight headings: the cells that each enters, in order, relative to the robot's."""

    drow: np.ndarray  # [R, S] int32
    dcol: np.ndarray  # [R, S] int32
    length: np.ndarray  # [R] int32, cells entered
    headings: np.ndarray  # [8, R] bool, which of them a scan with each heading has


@functools.lru_cache(maxsize=8)
def rays_of(lidar: Lidar, cell_m: float) -> Rays:
    """The `Rays` of a scanner."""
    table = beam_table(lidar, cell_m, 1)
    steps = max(1, int(np.max(table.length)))
    drow, dcol = (np.asarray(a)[:, :steps].swapaxes(1, 2).reshape(-1, steps) for a in (table.drow, table.dcol))
    length = np.asarray(table.length).reshape(-1)
    keys, which = np.unique(np.concatenate([length[:, None], drow, dcol], axis=1), axis=0, return_inverse=True)
    headings = np.zeros((HEADINGS, len(keys)), bool)
    headings[np.arange(HEADINGS)[:, None], which.reshape(HEADINGS, -1)] = True
    return Rays(keys[:, 1 : steps + 1], keys[:, steps + 1 :], keys[:, 0], headings)


class Sights:
    """What is seen from every cell of a map that is padded with walls by the scanner's range.

    Cells are flat numbers in the padded map. Every ray of every cell is followed once, one step of one ray at a time
    for all cells together; after that a region or a view is a look-up.
    """

    def __init__(self, occupied: np.ndarray, pad: int, rays: Rays) -> None:
        """`occupied`: `[H, W]` bool, padded. `pad`: cells of padding on each side."""
        width = occupied.shape[1]
        self.rays, self._first = rays, pad * width
        self._n = (occupied.shape[0] - 2 * pad) * width  # cells of the rows that are not padding
        self._offset = rays.drow * width + rays.dcol
        within = np.arange(self._offset.shape[1]) < rays.length[:, None]
        self._ray, self._step = np.nonzero(within)
        self._leads = self._offset[self._ray, self._step]
        free, still = (~occupied).reshape(-1).astype(np.uint8), np.empty(self._n, np.uint8)
        self._free_steps = np.zeros((len(rays.length), self._n), _counts(self._offset.shape[1]))
        for ray, steps in enumerate(rays.length):
            still[:] = 1
            for leads in self._offset[ray, :steps]:
                at = self._first + leads
                still &= free[at : at + self._n]
                self._free_steps[ray] += still

    @staticmethod
    def size(shape: tuple[int, int], pad: int, rays: Rays) -> int:
        """Bytes that the table of a map of this shape, without padding, takes."""
        return len(rays.length) * shape[0] * (shape[1] + 2 * pad) * _counts(rays.drow.shape[1])().itemsize

    def region(self, cell: int, stand: np.ndarray) -> np.ndarray:
        """Cells from which some beam enters a cell: `[n]` int, sorted, its own among them.

        Cast from where the robot stands: sight on a lattice is not symmetric.

        Args:
          cell: free.
          stand: `[P]` bool, where a robot may stand.
        """
        place = cell - self._leads - self._first
        inside = np.flatnonzero((place >= 0) & (place < self._n))
        inside = inside[stand[place[inside] + self._first]]
        sees = self._free_steps[self._ray[inside], place[inside]] > self._step[inside]
        found = np.append(place[inside[sees]] + self._first, cell)
        return np.unique(found[stand[found]])

    def seen(self, cell: int, heading: int | None = None) -> np.ndarray:
        """Free cells that a robot on a cell sees, turned to every heading or to one: `[n]` int, its own among them."""
        own = slice(None) if heading is None else self.rays.headings[heading]
        offset, steps = self._offset[own], self._free_steps[own, cell - self._first]
        return np.append(cell + offset[np.arange(offset.shape[1]) < steps[:, None]], cell)


def _counts(steps: int) -> Any:
    """The type that so many steps fit into."""
    return np.uint8 if steps < 256 else np.uint16


class Coverage:
    """What is seen along walks, remembered for single cells."""

    def __init__(self, sights: Sights, must_see: np.ndarray) -> None:
        self.sights, self.cells = sights, np.flatnonzero(must_see)
        self._place = np.full(len(must_see), -1, np.int32)
        self._place[self.cells] = np.arange(len(self.cells))
        self._rows: dict[int, np.ndarray] = {}

    def unseen(self, walk: np.ndarray) -> np.ndarray:
        """Cells that must be seen and are not from a walk: `[n]` int."""
        if len(self._rows) * len(self.cells) // 8 > ROWS_BYTES:
            self._rows.clear()
        seen = np.zeros(-(-len(self.cells) // 8), np.uint8)
        for cell in dict.fromkeys(walk.tolist()):
            if cell not in self._rows:
                own = np.zeros(len(self.cells) + 1, bool)  # the last is of what need not be seen
                own[self._place[self.sights.seen(cell)]] = True
                self._rows[cell] = np.packbits(own[:-1])
            seen |= self._rows[cell]
        return self.cells[np.unpackbits(seen, count=len(self.cells)) == 0]
