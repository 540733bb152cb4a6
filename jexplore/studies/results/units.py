"""Units of work: some episodes, run and kept together; and the tables that are made of them."""

import collections
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jexplore.config import InputWarning
from jexplore.engine.runner import Costs
from jexplore.exploration import batch
from jexplore.exploration.batch import Job, Outcomes
from jexplore.exploration.metrics import reached_limit
from jexplore.exploration.results import columns, map_state, progress_m
from jexplore.exploration.team.episode import team_columns
from jexplore.report.ledger import Ledger, Work
from jexplore.rules import Lidar, Rules
from jexplore.studies.results import details
from jexplore.studies.results.columns import COLUMNS, TEAM_COLUMNS

MIN_UNIT_EPISODES = 8  # least number of episodes of a unit
UNIT_S = 1.0  # seconds that a unit should take, about: writing it takes a hundredth of that
CELL_S = 1.3e-6  # seconds of an episode of closest+recheck, for every cell of its world (benchmarks/RESULTS.md)
MAX_UNITS_OF_JOB = 256  # of one strategy in one world


class Block(NamedTuple):
    """Some episodes of a job."""

    job: int  # number of the job
    first: int  # number of the first episode
    n: int


class Unit(NamedTuple):
    """Some episodes that are run and kept together."""

    blocks: tuple[Block, ...]
    phase: int  # units of a later phase come later

    @property
    def n(self) -> int:
        """Number of its episodes."""
        return sum(block.n for block in self.blocks)


def unit_size(cells: int) -> int:
    """Return about how many episodes a unit has, in a world with this number of cells."""
    return max(MIN_UNIT_EPISODES, round(UNIT_S / (CELL_S * cells)))


def cut_jobs(jobs: Sequence[Job], after: int = 0) -> list[Unit]:
    """Cut jobs, from this episode on, into units, in the order in which they are worth doing: the first ones of all."""
    units = []
    for i, job in enumerate(jobs):
        n = len(job.starts)
        size = max(unit_size(job.world.occupied.size), -(-n // MAX_UNITS_OF_JOB))
        starts = range(after, n, size)
        units += [Unit((Block(i, first, min(size, n - first)),), phase) for phase, first in enumerate(starts)]
    return sorted(units, key=lambda unit: (unit.phase, unit.blocks))


def rows_of(job: Job, found: Outcomes) -> dict[str, Any]:
    """Return the episodes of a job as columns, an array or a list for each."""
    n, world = len(job.starts), job.world
    has_rooms = world.rooms is not None
    rows = columns(found.result, job.starts, seed=job.seed, cell_m=world.cell_m, has_rooms=has_rooms, robot=job.robot)
    rows["episode"] = rows["episode"] + job.first
    rows |= {"world": [os.fspath(world.name)] * n, "strategy": [job.strategy.name] * n}
    for (name, metric), values in zip(job.metrics.items(), found.result.metrics):
        if metric.reduce == "sum" and reached_limit(values):
            warnings.warn(f"metric {name!r}: a sum has left int32: return a float32", InputWarning, stacklevel=2)
        rows[name] = values.astype(np.int64 if values.dtype == np.int32 else np.float64)
    if job.team is not None:
        rows |= team_columns(found.result, job.team, world.cell_m, job.robot)
    return {name: rows[name] for name in columns_of(job)}


def columns_of(job: Job) -> tuple[str, ...]:
    """Return the columns that the episodes of a job have in tables."""
    return *COLUMNS, *job.metrics, *(() if job.team is None else TEAM_COLUMNS)


def table_of(rows: Mapping[str, Any]) -> pd.DataFrame:
    """Return the columns of `rows_of`, and others, as a table."""
    return pd.DataFrame(rows).astype({"room_entries": "Int64"})


def block_table(block: Block, job: Job, found: Outcomes) -> pd.DataFrame:
    """Return the episodes of a comparison's job, with its scanner and rules; columns with `details.EXTRAS`."""
    assert job.rules is not None
    table, n = table_of(rows_of(job, found)), len(job.starts)
    extras: dict[str, list[Any]] = {
        details.PROGRESS: list(progress_m(found.result, job.world.cell_m)),
        details.SEEN: [None] * n,
    }
    if job.first == 0 and (final := found.first) is not None:
        state = map_state(final.hits, final.misses, job.rules.p_free)
        path_m = float(table["path_m"].iloc[0])
        extras[details.SEEN][0] = details.Seen(job.strategy.name, state, *final.own_cells, job.world.cell_m, path_m)
    if found.records:
        records = [found.records[i] for i in range(n)]
        extras[details.WAY] = [record.path for record in records]
        extras |= {} if records[0].state is None else {details.MAP: [record.state for record in records]}
    return table.assign(**extras)


class Ran(NamedTuple):
    """Result of `run_units`."""

    tables: list[pd.DataFrame]
    costs: Costs
    resumed: int  # episodes that were there before


def run_units(
    jobs: Sequence[Job], units: Sequence[Unit], numbers: Sequence[int] | None = None, *, ledger: Ledger | None = None,
    earlier: Sequence[pd.DataFrame] = (), to_table: Callable[[Block, Job, Outcomes], pd.DataFrame] = block_table,
    windows: Callable[[Sequence[int]], Iterable[Sequence[int]]] = lambda left: [left],
    on_progress: Callable[[int], object] | None = None, **how: Any,
) -> Ran:  # fmt: skip
    """Make the units that the ledger does not have. After Ctrl-C the result holds those that had been finished.

    Args:
      jobs: each with scanner and rules.
      units: of the whole run.
      numbers: of the units that are to be made; by default all.
      ledger: takes every unit as soon as it is finished.
      earlier: tables of a run that this one continues.
      to_table: returns the results of a block, of its job cut to its episodes and what that left.
      windows: cuts the numbers of units into those that are run together.
      on_progress: called with the number of episodes that are there.
      how: engine, lanes, workers, keep, shared_with, as of `batch.run_jobs`.

    Raises:
      KeyboardInterrupt: no unit has been finished.
    """
    asked = range(len(units)) if numbers is None else numbers
    work = Work(asked, ledger, details.to_file, details.of_file)
    resumed = sum(map(len, (*earlier, *work.done.values())))
    costs, done = Costs(), resumed
    for window in windows(work.left) if work.left else ():
        parts = [(number, block) for number in window for block in units[number].blocks]
        left, found = collections.Counter(number for number, _ in parts), {}
        cut = [
            jobs[i]._replace(starts=jobs[i].starts[first : first + n], first=first, phase=units[number].phase)
            for number, (i, first, n) in parts
        ]

        def on_job(place, outcomes, parts=parts, left=left, found=found, cut=cut):
            number = parts[place][0]
            found[place] = outcomes
            left[number] -= 1
            if not left[number]:
                own = [i for i in sorted(found) if parts[i][0] == number]
                tables = [to_table(parts[i][1], cut[i], found.pop(i)) for i in own]
                work.put(number, pd.concat(tables, ignore_index=True))

        moved = None if on_progress is None else (lambda n, done=done: on_progress(n + done))
        try:
            ran = batch.run_jobs(cut, Lidar(), Rules(), **how, on_progress=moved, on_job=on_job).costs
        except KeyboardInterrupt:
            costs.interrupted = True
            break
        costs = costs.plus(ran)
        done += sum(len(job.starts) for job in cut)
        if costs.interrupted:
            break
    if work.left and not work.done:  # a shorter run stays as it is
        raise KeyboardInterrupt
    return Ran([*earlier, *work.results], costs, resumed)
