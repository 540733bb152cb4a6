"""What a walk must see, and from where each of it is seen. On the host, exact."""

import dataclasses
import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from jexplore.config import Lidar, Rules
from jexplore.grid import radius_d2
from jexplore.raycast import HEADINGS, beam_table
from jexplore.worlds.world import World


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
    """`[P]` bool, what is to be seen and was not at the start."""
    rays: Rays
    """Beams of all headings."""

    def cells(self, flat: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns in the world of cells with these numbers."""
        rows, cols = np.divmod(np.asarray(flat), self.width)
        return rows - self.pad, cols - self.pad

    @functools.cached_property
    def _forward(self):
        """`[R, S]` int, cells of each ray relative to the robot's, and `[R, S]` bool, within its range."""
        within = np.arange(self.rays.drow.shape[1]) < self.rays.length[:, None]
        return self.rays.drow * self.width + self.rays.dcol, within

    @functools.cached_property
    def _steps(self):
        """Every step of every ray after its first: its place in the flat table of `_forward`, how many steps come
        before it, and where it leads, relative to the robot's cell: three of `[N]` int.
        """
        offset, within = self._forward
        ray, step = np.nonzero(within & (np.arange(offset.shape[1]) > 0))
        return ray * offset.shape[1] + step, step, offset[ray, step]

    def region(self, cell: int) -> np.ndarray:
        """Cells from which some beam enters a cell, wherever a robot may stand: `[n]` int, sorted, its own among them.

        Cast from where the robot stands: sight on a lattice is not symmetric.
        """
        offset, (place, before, leads) = self._forward[0].reshape(-1), self._steps
        stand = cell - leads
        left = np.flatnonzero(self.any[stand])
        place, before, stand, seen = place[left], before[left], stand[left], []
        for back in range(1, self._forward[0].shape[1] + 1):  # what is on the way there, from the cell backwards
            arrived = before < back
            seen.append(stand[arrived])
            place, before, stand = place[~arrived], before[~arrived], stand[~arrived]
            if not len(stand):
                break
            open_way = ~self.occupied[stand + offset[place - back]]
            place, before, stand = place[open_way], before[open_way], stand[open_way]
        next_to = cell - self._forward[0][self.rays.length > 0, 0]
        found = np.unique(np.concatenate([[cell], next_to, *seen]))
        return found[self.any[found]]

    def seen_from(self, cells: ArrayLike, heading: int | None = None) -> np.ndarray:
        """What robots on some cells see, turned to every heading, or to one: `[P]` bool, their own cells among it."""
        offset, within = self._forward
        if heading is not None:
            own = self.rays.headings[heading]
            offset, within = offset[own], within[own]
        found = np.zeros(len(self.occupied), bool)
        cells = np.atleast_1d(np.asarray(cells, np.int64))
        found[cells] = True
        for some in np.array_split(cells, max(1, len(cells) // 64)):
            at = some[:, None, None] + offset
            ended = np.cumsum(self.occupied[at], axis=2, dtype=np.int16)
            passed = within & (ended == 0)
            found[at[passed]] = True
        return found


def prepare_scene(world: World, start: tuple[int, int, int], lidar: Lidar, rules: Rules, looks: int) -> Scene | None:
    """A `Scene`.

    Args:
      world: `World`.
      start: row, col, heading in degrees.
      lidar: `Lidar`.
      rules: `Rules`.
      looks: scans at the start.

    Returns:
      `Scene`; None where the start is enclosed.
    """
    rays = rays_of(lidar, world.cell_m)
    pad = int(rays.length.max()) + 1
    occupied = np.pad(world.occupied, pad, constant_values=True)
    row, col = start[0] + pad, start[1] + pad
    clear = ~_within(occupied, radius_d2(rules.clearance_m, world.cell_m))
    rows, cols = np.indices(occupied.shape)
    near = (rows - row) ** 2 + (cols - col) ** 2 <= radius_d2(rules.near_m, world.cell_m)
    stand = flooded(clear | (~occupied & near), row, col)
    goal = clear & stand
    if occupied[row, col] or not np.any(goal & ((rows != row) | (cols != col))):
        return None
    width = occupied.shape[1]
    scene = Scene(
        *(width, pad, world.shape, row * width + col, occupied.reshape(-1), stand.reshape(-1)),
        any=flooded(~occupied, row, col).reshape(-1),
        must_see=goal.reshape(-1),
        rays=rays,
    )
    seen = np.zeros(len(scene.occupied), bool)
    for look in range(looks):
        seen |= scene.seen_from([scene.start], (start[2] // 45 + look * HEADINGS // looks) % HEADINGS)
    return dataclasses.replace(scene, must_see=scene.must_see & ~seen)


def _within(occupied, d2):
    """Cells whose distance to the nearest occupied one is at most sqrt(d2) cells."""
    nearest: Any = ndimage.distance_transform_edt(~occupied, return_distances=False, return_indices=True)
    rows, cols = nearest
    at = np.indices(occupied.shape)
    return (rows - at[0]) ** 2 + (cols - at[1]) ** 2 <= d2


def flooded(free: np.ndarray, row: int, col: int) -> np.ndarray:
    """Cells to which a path leads. The start is among them, and need not be free.

    A diagonal motion needs both cells beside it, so that it leads nowhere that straight ones do not.
    """
    free = free.copy()
    free[row, col] = True
    labels, _ = ndimage.label(free)  # type: ignore[misc]
    return labels == labels[row, col]
