"""Units of a comparison's work: some episodes of one strategy in one world, run, kept and put together again.

pandas is imported by the functions that need it.
"""

import io
import itertools
import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jexplore.config import Lidar, Rules
from jexplore.engine.runner import Costs
from jexplore.exploration import batch
from jexplore.exploration.batch import Job, Outcomes
from jexplore.exploration.results import columns, map_state, progress_m
from jexplore.exploration.state import MARKS, Outcome
from jexplore.report.ledger import Ledger
from jexplore.studies.results.columns import COLUMNS

if TYPE_CHECKING:
    import pandas as pd

MIN_UNIT_EPISODES = 8  # least number of episodes of a unit
UNIT_S = 1.0  # seconds that a unit should take, about: writing it takes a hundredth of that
CELL_S = 1.3e-6  # seconds of an episode of closest+recheck, for every cell of its world (benchmarks/RESULTS.md)
FIRSTS = 12  # jobs of which what the first episode left is kept, for a report
MAX_UNITS_OF_JOB = 256  # of one strategy in one world
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
    phase: int  # units of a later phase come later


class Piece(NamedTuple):
    """Episodes of a job that have ended, in order."""

    job: int
    table: "pd.DataFrame"  # columns `COLUMNS`, then those of metrics
    progress: np.ndarray  # [n, MARKS] float64, metres
    seen: Seen | None  # of episode 0, where that is among them
    paths: list[np.ndarray] | None  # if they are kept
    maps: np.ndarray | None  # [n, H, W] uint8, if they are kept


def cut_jobs(jobs: Sequence[Job], after: int = 0) -> list[Unit]:
    """Cut jobs, from this episode on, into units, in the order in which they are worth doing: the first ones of all."""
    units = []
    for i, job in enumerate(jobs):
        n = len(job.starts)
        cells = job.world.shape[0] * job.world.shape[1]
        size = max(MIN_UNIT_EPISODES, -(-n // MAX_UNITS_OF_JOB), round(UNIT_S / (CELL_S * cells)))
        firsts = range(after, n, size)
        units += [Unit(i, first, min(size, n - first), phase) for phase, first in enumerate(firsts)]
    return sorted(units, key=lambda unit: (unit.phase, unit.job, unit.first))


def job_of(job: Job, unit: Unit) -> Job:
    """Return the episodes of a unit as a `Job`."""
    starts = job.starts[unit.first : unit.first + unit.n]
    return job._replace(starts=starts, first=unit.first, phase=unit.phase)


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


def join_columns(rows: Sequence[Mapping[str, Any]]) -> "pd.DataFrame":
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
    table = join_columns([rows_of(job, unit, found)])
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


class Ran(NamedTuple):
    """Result of `run_units`."""

    pieces: list[Piece]  # in the order of the units
    costs: Costs
    resumed: int  # episodes that were there before
    firsts: dict[int, Outcomes]  # number of a job, one of the first -> what its first unit left, if that was run here


class _Work:
    """Units in progress: finished and remaining ones."""

    def __init__(self, jobs: Sequence[Job], ledger: Any) -> None:
        self.jobs, self.ledger, self.firsts = jobs, ledger, {}
        self.units = cut_jobs(jobs, 0 if ledger is None else ledger.after)
        self.pieces: dict[int, Piece] = {}
        for i in () if ledger is None else sorted(ledger.done & set(range(len(self.units)))):
            job = self.units[i].job
            self.pieces[i] = of_table(self.ledger.get(i), job, jobs[job].world.cell_m)
        self.resumed = sum(len(piece.table) for piece in self.pieces.values())
        self.left = [i for i in range(len(self.units)) if i not in self.pieces]

    def put(self, place: int, found: Outcomes) -> None:
        """Take and keep the results of a unit of `left`."""
        number = self.left[place]
        unit = self.units[number]
        if unit.first == 0 and unit.job < FIRSTS:
            self.firsts[unit.job] = found
        piece = piece_of(self.jobs[unit.job], unit, found)
        if self.ledger is not None:
            self.ledger.put(number, to_table(piece))
        self.pieces[number] = piece

    def add_parts(self, outcomes: Sequence[Outcomes]) -> None:
        """Take, after an interruption, the finished episodes of units that are not; these are not kept."""
        for number, found in zip(self.left, outcomes):
            unit = self.units[number]
            if number not in self.pieces and np.any(np.asarray(found.result.outcome) != Outcome.RUNNING):
                self.pieces[number] = piece_of(self.jobs[unit.job], unit, found)


def run_units(
    jobs: Sequence[Job],
    *,
    ledger: Ledger | None = None,
    earlier: Sequence[Piece] = (),
    engine: str = "auto",
    lanes: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], object] | None = None,
    keep: str | None = None,
    shared_with: Sequence[tuple[Lidar, Rules]] = (),
) -> Ran:
    """Run every episode of every job, with its scanner and rules, that the ledger does not have.

    Args:
      ledger: where units are kept as soon as they are finished.
      earlier: episodes before those of the ledger, see `loading.earlier_pieces`.
      engine, lanes, workers, on_progress, keep: as in `batch.run_jobs`; progress counts earlier ones too.

    Returns:
      `Ran`. After Ctrl-C it holds what had been finished.

    Raises:
      KeyboardInterrupt: nothing had been finished, or no unit of a run that continues an earlier one.
    """
    work, costs = _Work(jobs, ledger), Costs()
    resumed = work.resumed + sum(len(piece.table) for piece in earlier)
    if work.left:
        some = [job_of(jobs[unit.job], unit) for unit in (work.units[i] for i in work.left)]
        progress = None if on_progress is None else (lambda done: on_progress(done + resumed))
        how: dict[str, Any] = {
            "engine": engine,
            "lanes": lanes,
            "workers": workers,
            "keep": keep,
            "shared_with": shared_with,
        }
        try:
            found = batch.run_jobs(some, Lidar(), Rules(), **how, on_progress=progress, on_job=work.put)
        except KeyboardInterrupt:
            found = batch.Finished([], Costs(interrupted=True))
        costs = found.costs
        work.add_parts(found.outcomes)
    if not work.pieces or (ledger is not None and earlier and not ledger.done):  # the shorter run stays as it is
        raise KeyboardInterrupt
    return Ran([*earlier, *(work.pieces[i] for i in sorted(work.pieces))], costs, resumed, work.firsts)
