"""Scans that a robot has recorded, and the reflection map that they make.

Beams are traced as everywhere here, but on the host and in float64: a recorded robot stands anywhere in a cell, with
any heading.
"""

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from jexplore.config import InputError, checked_names, require_number, require_setting
from jexplore.grid import Grid, is_free
from jexplore.raycast import advance_beams, beam_geometry, exact_direction, n_steps
from jexplore.worlds.bounds import require_side
from jexplore.worlds.world import World

_BELIEVED = {"low_open": True, "high": 1000}
_BOUNDS: dict[str, dict[str, Any]] = {
    "p_free": {"high": 1, "high_open": True},
    "range_m": _BELIEVED,
    "max_range_m": _BELIEVED,
    "no_echo_m": {"high": 1000},
}
_TOGETHER = 2**18  # beams that are traced at a time


def require_of_scans(what: str, **given: Any) -> None:
    """Refuse parameters of recorded scans that are out of bounds; None stands for a default."""
    for name, value in given.items():
        if value is not None:
            require_number(f"{what!r}: {name}", value, **_BOUNDS[name])


@checked_names
@dataclasses.dataclass(frozen=True)
class ScanLog:
    """Recording of a robot with a planar laser scanner: N scans of B readings."""

    poses: np.ndarray
    """`[N, 3]` float64, where the scanner was: x m, y m, heading rad; the best that the log knows."""
    odometry: np.ndarray
    """`[N, 3]` float64, poses by the robot's odometry."""
    ranges: np.ndarray
    """`[N, B]` float64, readings, metres. As REP 117 of ROS has them: inf is no echo; NaN, invalid, and 0 or less, too
    near, say nothing."""
    angles_rad: np.ndarray
    """`[B]` float64, directions of the readings relative to the heading, counter-clockwise."""
    times: np.ndarray
    """`[N]` float64, seconds; not necessarily ascending."""
    max_range_m: float
    """A reading of this or more means that nothing was seen, metres."""

    def __post_init__(self) -> None:
        n, n_beams = np.shape(self.ranges) if np.ndim(self.ranges) == 2 else (0, 0)
        shapes = {"ranges": (n, n_beams), "poses": (n, 3), "odometry": (n, 3), "angles_rad": (n_beams,), "times": (n,)}
        for name, shape in shapes.items():
            array = np.asarray(getattr(self, name))
            finite = name == "ranges" or (array.dtype.kind in "fiu" and np.isfinite(array).all())
            if array.shape != shape or not array.size or array.dtype.kind not in "fiu" or not finite:
                expected = f"finite numbers of shape {list(shape)}" if n * n_beams else "readings [N, B]"
                raise InputError(f"{name} of a ScanLog must be {expected}, got {array.dtype} {list(array.shape)}")
        require_of_scans("ScanLog", max_range_m=self.max_range_m)

    @property
    def echo(self) -> np.ndarray:
        """Return `[N, B]` bool, where a reading is the distance of something."""
        return (self.ranges > 0) & (self.ranges < self.max_range_m)

    def __repr__(self) -> str:
        n, n_beams = self.ranges.shape
        return f"<ScanLog of {n} scans of {n_beams} readings below {self.max_range_m:g} m>"


@checked_names
@dataclasses.dataclass(frozen=True)
class ScanMap:
    """A reflection map of recorded scans, and where it lies."""

    grid: Grid
    """`Grid`, `[H, W]`."""
    cell_m: float
    """Edge of a cell, metres."""
    origin_m: tuple[float, float]
    """x, y of the lower left corner of cell (0, 0), metres: whole multiples of `cell_m`."""
    start: tuple[int, int, int]
    """Pose of the first scan: row, col, heading in degrees, the nearest multiple of 45."""

    def world(self, *, p_free: float = 0.25, name: str = "") -> World:
        """Return the map as a world to be explored: cells that are not known to be free are occupied.

        `p_free` is the largest reflection probability of a free cell. The start is the robot's, if that cell is free.
        """
        require_of_scans(name or "scans", p_free=p_free)
        occupied = ~np.asarray(is_free(self.grid, p_free))
        if occupied.all():
            raise InputError(f"{name or 'scans'!r}: no cell is free at p_free = {p_free:g}")
        start = None if occupied[self.start[:2]] else self.start
        return World(occupied=occupied, start=start, cell_m=self.cell_m, name=name, origin_m=self.origin_m)


@checked_names
def fold_scans(
    log: ScanLog, *, cell_m: float = 0.1, range_m: float | None = None, no_echo_m: float = 0.0, name: str = "scans"
) -> ScanMap:
    """Count recorded scans into a reflection map: a miss for every cell passed, a hit where a reading ends.

    The robot's own cell gets one miss a scan. A reading ends in the last cell that its beam enters at that distance or
    before; one that ends in the robot's own cell counts nothing, nor does a reading of 0. A reading of `range_m` or
    more has no hit, and misses only in the cells that the beam enters below `range_m`.

    A reading of the log's `max_range_m` or more, inf among them, says that no echo came back, as from open space, but
    as well from glass, a mirror or a black wall. Its misses end at `no_echo_m`, by default at once: it counts nothing.
    A reading that says nothing, NaN or below 0, counts nothing either.

    Args:
      log: `ScanLog`.
      cell_m: edge of a cell, metres.
      range_m: how far an echo is believed, metres. Default: the log's `max_range_m`, which is also the most.
      no_echo_m: how far a beam without an echo is believed to be free, metres; the range of a simulated scanner.
      name: what errors call the log.

    Returns:
      `ScanMap`. It covers, with a cell to spare, where the scanner was and where readings below `range_m` end; other
      beams count as far as it reaches.

    Source:
      Holz et al. 2010, section 2.1; Amanatides and Woo 1987.
    """
    require_setting("cell_m", cell_m)
    require_of_scans(name, no_echo_m=no_echo_m, range_m=range_m)
    longest_m = min(log.max_range_m, range_m or math.inf)
    at, angle = np.round(log.poses[:, :2] / cell_m, 9), log.poses[:, 2:] + log.angles_rad  # x and y in cells
    ends = log.echo & (log.ranges < longest_m)
    # Up to here a beam enters cells: to where it ends, that included, or to where it is no longer believed, exclusive.
    beyond = np.select([log.echo, log.ranges >= log.max_range_m], [longest_m, no_echo_m], 0.0)
    limit = np.round(np.where(ends, log.ranges, beyond) / cell_m, 9)
    tips = at[:, None] + limit[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    points = np.concatenate([at, tips[ends]])
    first = np.floor(points.min(axis=0)) - 1  # with a spare cell on every side
    shape = np.floor(points.max(axis=0)) + 2 - first
    require_side(name, *shape[::-1])
    shape = tuple(shape[::-1].astype(int))
    hits, misses = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
    at -= first
    own = np.floor(at).astype(np.int64)
    np.add.at(misses, (own[:, 1], own[:, 0]), 1)
    together = max(1, _TOGETHER // limit.shape[1])
    for i in range(0, len(at), together):
        scan, beam = np.nonzero(limit[i : i + together] > 0)
        scan += i
        _count_beams(hits, misses, at[scan], angle[scan, beam], limit[scan, beam], ends[scan, beam])
    x_m, y_m = (round(float(n) * cell_m, 9) for n in first)
    return ScanMap(
        grid=Grid(hits=jnp.asarray(hits), misses=jnp.asarray(misses)),
        cell_m=cell_m,
        origin_m=(x_m, y_m),
        start=(int(own[0, 1]), int(own[0, 0]), int(np.rint(np.degrees(log.poses[0, 2]) / 45)) % 8 * 45),
    )


def _count_beams(
    hits: np.ndarray, misses: np.ndarray, at: np.ndarray, angle: np.ndarray, limit: np.ndarray, ends: np.ndarray
) -> None:
    """Count beams into a map, without the misses of the cells that they begin in."""
    limit = np.where(ends, np.nextafter(limit, np.inf), limit)
    own, within = np.divmod(at, 1)
    geometry = beam_geometry(*exact_direction(np.degrees(angle)), within[:, 0], within[:, 1])
    # Of the beams under way: crossings made, and the cell that each is in, relative to that of the robot.
    nx = ny = row = col = np.zeros(len(limit))

    def add(counts: np.ndarray, which: np.ndarray) -> None:
        rows, cols = own[which, 1] + row[which], own[which, 0] + col[which]
        inside = (rows >= 0) & (rows < counts.shape[0]) & (cols >= 0) & (cols < counts.shape[1])
        np.add.at(counts, (rows[inside].astype(np.int64), cols[inside].astype(np.int64)), 1)

    for step in range(n_steps(limit.max(initial=0))):
        (nx, ny), (next_row, next_col, entry) = advance_beams((nx, ny), geometry)
        goes_on = entry < limit
        if step:
            add(hits, ends & ~goes_on)
            add(misses, goes_on | ~ends)
        nx, ny, row, col, own, limit, ends = (a[goes_on] for a in (nx, ny, next_row, next_col, own, limit, ends))
        geometry = tuple(a[goes_on] for a in geometry)
        if not len(limit):
            break
