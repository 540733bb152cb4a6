"""Trajectory and map of a recorded log, by its scans and its odometry alone."""

import dataclasses
import os
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from jexplore.arrays.poses import between, compose
from jexplore.config import InputError, InputWarning, as_record, checked_names, require_number
from jexplore.slam2d.mapping import Mapper
from jexplore.slam2d.matching import Outcome
from jexplore.slam2d.settings import SlamSettings
from jexplore.studies.slam.errors import Relations, error_rows, read_relations, relations_between, trajectory_error
from jexplore.worlds.readers.bags import is_bag, read_laser_bag
from jexplore.worlds.readers.carmen import read_carmen
from jexplore.worlds.readers.scans import ScanLog, ScanMap, fold_scans

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_BACK = 0.1  # share of scans that may be earlier than the one before; the times of a log of more tell no order


@checked_names
@dataclasses.dataclass(frozen=True)
class SlamResult:
    """Result of `slam`."""

    log: ScanLog
    """The scans in the order in which they were taken in."""
    poses: np.ndarray
    """`[N, 3]` float64, estimate: x m, y m, heading rad; the first is the log's own."""
    matching: SlamSettings
    closing: bool
    keys: np.ndarray
    """`[K]` int, scans of which the map is made."""
    loops: list[tuple[int, int]]
    """Loops closed: pairs of numbers of `keys`, the later one first."""
    outcomes: np.ndarray
    """`[N]` int, `Outcome` of every match; an interrupted run has fewer scans."""
    fitness: np.ndarray
    """`[N]` float64, share of a scan's points that matched."""
    overflow: int
    """The most points for which a map, remade now and then, had no room."""
    errors: pd.DataFrame
    """A row a kind of relation: `relations`, `pairs`, mean and standard deviation of `place_m` and `turn_deg`. Empty
    for a log without corrected poses and relations."""
    ate_m: float
    """Root mean square distance from the log's corrected poses after alignment, metres; NaN without any."""
    interrupted: bool

    def map(self, cell_m: float = 0.05) -> ScanMap:
        """Return the reflection map of the scans at the estimated poses."""
        return fold_scans(dataclasses.replace(self.log, poses=self.poses), cell_m=cell_m)

    def map_before(self, cell_m: float = 0.05) -> ScanMap:
        """Return the same at the poses of the odometry."""
        return fold_scans(dataclasses.replace(self.log, poses=self.log.odometry), cell_m=cell_m)

    def trajectory(self) -> str:
        """Return the trajectory in the format of TUM: lines `t x y z qx qy qz qw`, in order of time."""
        half = self.poses[:, 2] / 2
        rows = zip(self.log.times, *self.poses[:, :2].T, np.sin(half), np.cos(half))
        lines = [f"{t:.6f} {x:.6f} {y:.6f} 0 0 0 {qz:.9f} {qw:.9f}" for t, x, y, qz, qw in rows]
        order = np.argsort(self.log.times, kind="stable")
        return "".join(f"{lines[i]}\n" for i in order)

    def to_markdown(self) -> str:
        """Return the errors and the outcomes as text."""
        from jexplore.report.tables import aligned_table

        counts = np.bincount(self.outcomes, minlength=len(Outcome))
        told = ", ".join(f"{n} {Outcome(k).name.lower()}" for k, n in enumerate(counts) if n)
        way = np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum()
        lines = [
            f"{len(self.poses)} scans, {way:.0f} m: {told}; {len(self.keys)} key scans, {len(self.loops)} loops closed",
        ]
        if len(self.errors):
            head = ["relations", "pairs", "place m", "sd", "turn deg", "sd"]
            rows = [
                [str(name), str(n), *(f"{v:.3f}" for v in numbers)]
                for name, n, *numbers in self.errors.itertuples(index=False)
            ]
            lines += ["", aligned_table(head, rows, left=["relations"])]
        if np.isfinite(self.ate_m):
            lines.append(f"distance from the corrected poses, aligned: {self.ate_m:.3f} m (root mean square)")
        if n := counts[Outcome.AMBIGUOUS]:
            lines.append(
                f"warning: {n} scans without odometry fit another place nearly as well: the way may be wrong there"
            )
        if self.overflow:
            lines.append(f"warning: {self.overflow} points found no room in the map")
        return "\n".join(lines) + "\n"

    def figure(self) -> "Figure":
        """Draw the map by odometry and the map found, each with its way."""
        from jexplore.report.plots.maps import scans_figure

        return scans_figure(self.map_before(0.1), self.log.odometry, self.map(0.1), self.poses)


@checked_names
def slam(
    log: str | os.PathLike[str] | ScanLog, *, closing: bool = True,
    matching: SlamSettings | Mapping[str, Any] | None = None, max_range_m: float | None = None,
    topic: str | None = None, odometry_topic: str | None = None,
    relations: str | os.PathLike[str] | None = None, relations_offset_s: float = 0.0,
    on_progress: Callable[[int], Any] | None = None,
) -> SlamResult:  # fmt: skip
    """Find the poses of a recorded robot by its scans and its odometry; corrected poses of the log only judge them.

    A step of the odometry of exactly 0 counts as unknown: it is looked for as far as the search goes. Scans are taken
    in order of time; where more than a tenth are earlier than the one before, in the file's order.

    Args:
      log: a CARMEN log (`.log`, `.clf`, also packed as `.gz`), a rosbag with LaserScan and Odometry, or a `ScanLog`.
      closing: also recognise places, and correct the poses by a pose graph; the map is made of the key scans.
      matching: `SlamSettings`, or a mapping of some of its fields.
      max_range_m: see `read_carmen`.
      topic, odometry_topic: of a rosbag, see `read_laser_bag`.
      relations, relations_offset_s: see `read_relations`.
      on_progress: called with the number of scans taken in.

    Returns:
      `SlamResult`. After Ctrl-C it holds the scans taken in.

    Warns:
      InputWarning: no odometry, poses that may be corrected in its place, or scans out of order.

    Source:
      Holz et al. 2010, sections 2.1 and 2.3; Censi 2008; Olson 2009.
    """
    matching = as_record("matching", matching or SlamSettings(), SlamSettings)
    if matching.gate_m > 4 * matching.min_distance_m:
        raise InputError("matching: gate_m must be at most 4 min_distance_m")
    log = in_order(log if isinstance(log, ScanLog) else read_log(log, max_range_m, topic, odometry_topic))
    known = relations_between(log.poses) if _is_corrected(log) else {}
    if relations is not None:
        require_number("relations_offset_s", relations_offset_s, low=-np.inf)
        known |= {"given": read_relations(relations, log.times, relations_offset_s)}
    mapper, interrupted = Mapper(matching, log.angles_rad, log.max_range_m, closing=closing), False
    moved = between(log.odometry[:-1], log.odometry[1:])
    if len(moved) and (still := int((moved == 0).all(axis=1).sum())) > len(moved) // 2:
        told = f"{still} of {len(moved)} steps have no odometry: scans are matched from where the last one was"
        warnings.warn(told, InputWarning, stacklevel=2)
    try:
        for i, ranges in enumerate(log.ranges):
            mapper.put(ranges, moved[i - 1] if i and moved[i - 1].any() else None)
            if on_progress is not None:
                on_progress(i + 1)
    except KeyboardInterrupt:
        interrupted = True
        if not mapper.places:
            raise
    return _result(log, mapper, known, interrupted)


def _is_corrected(log):
    return bool((log.poses != log.odometry).any())


def _result(log, mapper, known, interrupted):
    """Return the result of the scans taken in."""
    n = len(mapper.places)
    log = dataclasses.replace(log, **{name: getattr(log, name)[:n] for name in PER_SCAN})
    found = mapper.poses()
    poses = compose(np.broadcast_to(log.poses[0], found.shape), found)
    inside = {name: (one.ends < n).all(axis=1) for name, one in known.items()}
    known = {name: Relations(*(a[inside[name]] for a in one)) for name, one in known.items() if inside[name].any()}
    return SlamResult(
        log, poses, mapper.settings, mapper.closing,
        keys=np.unique([place.key for place in mapper.places], return_index=True)[1],
        loops=mapper.loops,
        outcomes=np.array([place.outcome for place in mapper.places]),
        fitness=np.array([place.fitness for place in mapper.places]),
        overflow=mapper.overflow,
        errors=pd.DataFrame(error_rows(poses, known)),
        ate_m=trajectory_error(poses, log.poses) if _is_corrected(log) else np.nan,
        interrupted=interrupted,
    )  # fmt: skip


PER_SCAN = ("poses", "odometry", "ranges", "times")


def read_log(
    path: str | os.PathLike[str], max_range_m: float | None, topic: str | None, odometry_topic: str | None
) -> ScanLog:
    """Read a log of any kind."""
    if is_bag(path):
        if max_range_m is not None:
            raise InputError(f"{os.fspath(path)!r}: says itself how far its scanner reaches; leave out max_range_m")
        return read_laser_bag(path, topic=topic, odometry_topic=odometry_topic)
    for name, value in (("topic", topic), ("odometry_topic", odometry_topic)):
        if value is not None:
            raise InputError(f"{os.fspath(path)!r}: {name} is for rosbags, whose names end in .bag, .db3 or .mcap")
    log = read_carmen(path, max_range_m=max_range_m)
    if not _is_corrected(log):
        told = f"{os.fspath(path)!r}: has one pose a scan: it counts as odometry, also if it was corrected"
        warnings.warn(told, InputWarning, stacklevel=3)
    return log


def in_order(log: ScanLog) -> ScanLog:
    """Return the scans in order of time, unless the times tell none."""
    back, n = int((np.diff(log.times) < 0).sum()), len(log.times)
    if not back:
        return log
    is_kept = back > MOST_BACK * n
    told = f"{back} of {n} scans {'is' if back == 1 else 'are'} earlier than the one before: "
    told += "they are taken in the log's order" if is_kept else "all are sorted by time"
    warnings.warn(told, InputWarning, stacklevel=3)
    if is_kept:
        return log
    order = np.argsort(log.times, kind="stable")
    return dataclasses.replace(log, **{name: getattr(log, name)[order] for name in PER_SCAN})
