"""Units of a comparison's work: some episodes of one strategy in one world, run, kept and put together again.

pandas is imported by the functions that need it.
"""

import collections
import io
import itertools
import os
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jexplore.config import Lidar, Rules
from jexplore.engine.runner import Costs
from jexplore.exploration import batch
from jexplore.exploration.batch import Job, Outcomes
from jexplore.exploration.results import columns, map_state, progress_m
from jexplore.exploration.state import MARKS, Outcome
from jexplore.report.ledger import Ledger

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    *("world", "strategy", "episode", "seed", "start_row", "start_col", "path_m", "turning_rad"),
    *("steps", "scans", "plans", "outcome", "exhausted", "explored_fraction"),
    *("path_m_at_50", "path_m_at_90", "path_m_at_95", "path_m_at_99", "room_entries"),
    *("start_heading_deg", "refused", "saturated", "overflow"),
)
"""Columns of a table of episodes. `stats` and `plot` read them by these names."""
LEAST = 8  # least number of episodes of a unit
UNIT_S = 1.0  # seconds that a unit should take, about: writing it takes a hundredth of that
CELL_S = 1.3e-6  # seconds of an episode of closest+recheck, for every cell of its world (benchmarks/RESULTS.md)
FIRSTS = 12  # jobs of which what the first episode left is kept, for a report
MOST_UNITS = 256  # of one strategy in one world
PROGRESS, SEEN, WAY, MAP = "_progress_m", "_seen", "_way", "_map"  # columns of a unit's file besides `COLUMNS`


class Seen(NamedTuple):
    """End of episode 0 of a strategy in a world: its map and its way."""

    strategy: str
    state: np.ndarray  # [H, W] uint8, 0 unknown, 1 free, 2 occupied
    rows: np.ndarray  # [n + 1] int32, cells driven
    cols: np.ndarray  # [n + 1] int32
    cell_m: float
    path_m: float


class Unit(NamedTuple):
    """Some episodes of a job."""

    job: int  # number of the job
    first: int  # number of the first episode
    n: int
    turn: int  # units of a later turn come later


class Piece(NamedTuple):
    """Episodes of a job that have ended, in order."""

    job: int
    table: "pd.DataFrame"  # columns `COLUMNS`, then those of metrics
    progress: np.ndarray  # [n, MARKS] float64, metres
    seen: Seen | None  # of episode 0, where that is among them
    paths: list[np.ndarray] | None  # if they are kept
    maps: np.ndarray | None  # [n, H, W] uint8, if they are kept


def cut(jobs: Sequence[Job]) -> list[Unit]:
    """Cut jobs into units, in the order in which they are worth doing: the first episodes of all jobs first."""
    units = []
    for i, job in enumerate(jobs):
        n = len(job.starts)
        cells = job.world.shape[0] * job.world.shape[1]
        size = max(LEAST, -(-n // MOST_UNITS), round(UNIT_S / (CELL_S * cells)))
        units += [Unit(i, first, min(size, n - first), first // size) for first in range(0, n, size)]
    return sorted(units, key=lambda unit: (unit.turn, unit.job, unit.first))


def job_of(job: Job, unit: Unit) -> Job:
    """Return the episodes of a unit as a `Job`."""
    starts = job.starts[unit.first : unit.first + unit.n]
    return job._replace(starts=starts, first=unit.first, turn=unit.turn)


def rows_of(job: Job, unit: Unit, found: Outcomes) -> dict[str, Any]:
    """Return the episodes of a unit that have ended, as columns, an array or a list for each."""
    ended = np.asarray(found.result.outcome) != Outcome.RUNNING
    starts, world = job.starts[unit.first : unit.first + unit.n], job.world
    has_rooms = world.rooms is not None
    rows = columns(found.result, starts, seed=job.seed, cell_m=world.cell_m, has_rooms=has_rooms)
    rows["episode"] = rows["episode"] + unit.first
    rows |= {"world": [os.fspath(world.name)] * len(starts), "strategy": [job.strategy.name] * len(starts)}
    for name, values in zip(job.metrics, found.result.metrics):
        rows[name] = values.astype(np.int64 if values.dtype == np.int32 else np.float64)
    if not ended.all():
        for name, values in rows.items():
            rows[name] = list(itertools.compress(values, ended)) if isinstance(values, list) else values[ended]
    return {name: rows[name] for name in (*COLUMNS, *job.metrics)}


def table_of(rows: Sequence[Mapping[str, Any]]) -> "pd.DataFrame":
    """Join columns of several units, one below the other, as one table."""
    import pandas as pd

    joined = {
        name: list(itertools.chain.from_iterable(one[name] for one in rows))
        if isinstance(rows[0][name], list)
        else np.concatenate([one[name] for one in rows])
        for name in rows[0]
    }
    return pd.DataFrame(joined).astype({"room_entries": "Int64"})


def piece_of(job: Job, unit: Unit, found: Outcomes) -> Piece:
    """Return the finished part of a unit. `job` is the whole one, with its scanner and rules."""
    assert job.rules is not None
    result, world, strategy = found.result, job.world, job.strategy.name
    ended = np.asarray(result.outcome) != Outcome.RUNNING
    table = table_of([rows_of(job, unit, found)])
    seen = None
    if unit.first == 0 and ended[0] and found.first is not None:
        final = found.first
        state = map_state(final.hits, final.misses, job.rules.p_free)
        seen = Seen(strategy, state, final.rows, final.cols, world.cell_m, float(table["path_m"].iloc[0]))
    paths = maps = None
    if found.records is not None and (found.records or not ended.any()):
        own = [found.records[i] for i in np.flatnonzero(ended).tolist()]
        paths = [record.path for record in own]
        states = [record.state for record in own if record.state is not None]
        maps = np.stack(states) if states else None
    return Piece(unit.job, table, progress_m(result, world.cell_m)[ended], seen, paths, maps)


def _packed(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return zlib.compress(file.getvalue(), 1)


def _unpacked(data):
    return np.load(io.BytesIO(zlib.decompress(data)))


def to_table(piece: Piece) -> "pd.DataFrame":
    """Convert a piece to a table for a file, from which `of_table` makes it again."""
    n, extra = len(piece.table), {}
    extra[PROGRESS] = [row.tobytes() for row in piece.progress]
    if piece.seen is not None:
        seen = piece.seen
        first = _packed(state=seen.state, rows=seen.rows, cols=seen.cols)
        extra[SEEN] = [first, *[None] * (n - 1)]
    if piece.paths is not None:
        extra[WAY] = [_packed(way=path) for path in piece.paths]
    if piece.maps is not None:
        extra[MAP] = [_packed(map=state) for state in piece.maps]
    return piece.table.assign(**extra)


def of_table(table: "pd.DataFrame", job: int, cell_m: float) -> Piece:
    """Return the piece that `to_table` made a table of."""
    rows = table.drop(columns=[name for name in (PROGRESS, SEEN, WAY, MAP) if name in table])
    marks = np.frombuffer(b"".join(table[PROGRESS]), np.float64).reshape(len(table), MARKS)
    seen = paths = maps = None
    if SEEN in table:
        with _unpacked(table[SEEN].iloc[0]) as first:
            seen = Seen(
                *(rows["strategy"].iloc[0], first["state"], first["rows"], first["cols"], cell_m),
                float(rows["path_m"].iloc[0]),
            )
    if WAY in table:
        paths = [_unpacked(data)["way"] for data in table[WAY]]
    if MAP in table:
        maps = np.stack([_unpacked(data)["map"] for data in table[MAP]])
    return Piece(job, rows, marks, seen, paths, maps)


def recut(jobs: Sequence[Job], keep: str | None, rows: "pd.DataFrame") -> Iterable[tuple[int, "pd.DataFrame", bool]]:
    """Yield the units of some jobs of which a table has first episodes: number, table for a file, bool: complete.

    Args:
      jobs: list of `Job`.
      keep: as in `batch.run_jobs`; episodes of which that is not kept are left out.
      rows: as `to_table` makes them, of whatever units; others are left out.
    """
    needed = [WAY] * (keep is not None) + [MAP] * (keep == "maps")
    if not {PROGRESS, *needed} <= set(rows):
        return
    rows = rows.dropna(subset=[PROGRESS, *needed]).sort_values("episode")
    of_pair: dict[Any, Any] = dict(iter(rows.groupby(["world", "strategy"], sort=False)))
    for number, unit in enumerate(cut(jobs)):
        own = of_pair.get((os.fspath(jobs[unit.job].world.name), jobs[unit.job].strategy.name))
        if own is None:
            continue
        own = own[own["episode"].between(unit.first, unit.first + unit.n - 1)]
        own = own[own["episode"] == unit.first + np.arange(len(own))]  # up to the first that is missing
        has_seen = unit.first == 0 and SEEN in own and own[SEEN].notna().iloc[:1].all()
        if len(own) and (unit.first or has_seen):
            columns = [*COLUMNS, *jobs[unit.job].metrics, PROGRESS, *([SEEN] if has_seen else []), *needed]
            yield number, own[columns].reset_index(drop=True), len(own) == unit.n


class Ran(NamedTuple):
    """Result of `run_units`."""

    pieces: list[Piece]  # in the order of the units
    costs: Costs
    resumed: int  # episodes that were there before
    firsts: dict[int, Outcomes]  # number of a job, one of the first -> what its first unit left, if that was run here


def _rest(unit: Unit, part: Piece | None) -> list[Unit]:
    """Return the missing part of a unit that is partly finished: runs of consecutive episodes, as units."""
    there = set() if part is None else set(part.table["episode"])
    left = [i for i in range(unit.first, unit.first + unit.n) if i not in there]
    runs = itertools.groupby(enumerate(left), lambda pair: pair[1] - pair[0])
    spans = [[episode for _, episode in run] for _, run in runs]
    return [unit._replace(first=span[0], n=len(span)) for span in spans]


def _joined(pieces: Collection[Piece]) -> Piece:
    """Join pieces of a unit, its episodes in order."""
    parts = [piece for piece in pieces if len(piece.table)] or list(pieces)[:1]
    if len(parts) == 1:
        return parts[0]
    import pandas as pd

    table = pd.concat([part.table for part in parts], ignore_index=True)
    order = np.argsort(table["episode"].to_numpy())
    paths = maps = None
    if all(part.paths is not None for part in parts):
        every = [path for part in parts for path in part.paths or ()]
        paths = [every[i] for i in order]
    if all(part.maps is not None for part in parts):
        maps = np.concatenate([part.maps for part in parts if part.maps is not None])[order]
    return Piece(
        parts[0].job,
        table.iloc[order].reset_index(drop=True),
        np.concatenate([part.progress for part in parts])[order],
        next((part.seen for part in parts if part.seen is not None), None),
        paths,
        maps,
    )


class _Work:
    """Units in progress: finished, remaining and returned ones."""

    def __init__(self, jobs, wanted, ledger):
        self.jobs, self.cuts, self.ledger, self.firsts = jobs, cut(jobs), ledger, {}
        wanted = range(len(self.cuts)) if wanted is None else sorted(wanted)
        self.pieces = {i: self._read(i) for i in wanted if ledger is not None and i in ledger.done}
        parts = {i: self._read(i) for i in wanted if ledger is not None and i in ledger.parts}
        self.resumed = sum(len(piece.table) for piece in (*self.pieces.values(), *parts.values()))
        waiting = [i for i in wanted if i not in self.pieces]
        self.left = [(i, span) for i in waiting for span in _rest(self.cuts[i], parts.get(i))]
        # number of a unit -> its pieces: by their places in `left`, and what was there before
        self.made = {i: {-1: part} for i, part in parts.items()}
        self.needs = collections.Counter([*(i for i, _ in self.left), *parts])

    def _read(self, number):
        job = self.cuts[number].job
        return of_table(self.ledger.get(number), job, self.jobs[job].world.cell_m)

    def put(self, place: int, found: Outcomes) -> None:
        """Take the results of a span of `left`, and keep its unit if that was the last."""
        number, span = self.left[place]
        if span.first == 0 and span.job < FIRSTS:
            self.firsts[span.job] = found
        made = self.made.setdefault(number, {})
        made[place] = piece_of(self.jobs[span.job], span, found)
        if len(made) == self.needs[number]:
            piece = _joined(made.values())
            if self.ledger is not None:
                self.ledger.put(number, to_table(piece))
            self.pieces[number] = piece

    def end(self, outcomes: Sequence[Outcomes]) -> None:
        """Take, after an interruption, the results of every span, and keep partly finished units."""
        for place, found in enumerate(outcomes):
            number, span = self.left[place]
            if number not in self.pieces and place not in self.made.setdefault(number, {}):
                self.made[number][place] = piece_of(self.jobs[span.job], span, found)
        for number in self.made.keys() - self.pieces.keys():
            self.pieces[number] = piece = _joined(self.made[number].values())
            if self.ledger is not None and len(piece.table):
                is_whole = len(piece.table) == self.cuts[number].n
                (self.ledger.put if is_whole else self.ledger.put_part)(number, to_table(piece))


def run_units(
    jobs: Sequence[Job],
    *,
    ledger: Ledger | None = None,
    units: Iterable[int] | None = None,
    engine: str = "auto",
    lanes: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], object] | None = None,
    keep: str | None = None,
    alike: Sequence[tuple[Lidar, Rules]] = (),
) -> Ran:
    """Run every episode of every job that the ledger does not have.

    Args:
      jobs: list of `Job`, each with its scanner and rules.
      ledger: where units are kept as soon as they are finished.
      units: numbers of the units to be run or read; by default all.
      engine, lanes, workers, on_progress, keep, alike: as in `batch.run_jobs`; progress counts earlier ones too.

    Returns:
      `Ran`. After Ctrl-C it holds what had been finished.

    Raises:
      InputError: as `batch.run_jobs`; a unit cannot be written or read.
      KeyboardInterrupt: nothing had been finished.
    """
    work, costs = _Work(jobs, units, ledger), Costs()
    if work.left:
        some = [job_of(jobs[span.job], span) for _, span in work.left]
        progress = None if on_progress is None else (lambda done: on_progress(done + work.resumed))
        how: dict[str, Any] = {"engine": engine, "lanes": lanes, "workers": workers, "keep": keep, "alike": alike}
        try:
            found = batch.run_jobs(some, Lidar(), Rules(), **how, on_progress=progress, on_job=work.put)
        except KeyboardInterrupt:
            if not work.pieces and not work.made:
                raise
            found = batch.Finished([], Costs(interrupted=True))
        costs = found.costs
        work.end(found.outcomes)
    return Ran([work.pieces[i] for i in sorted(work.pieces)], costs, work.resumed, work.firsts)
