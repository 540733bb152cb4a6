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


class Unit(NamedTuple):
    """Some episodes of a job."""

    job: int  # number of the job
    first: int  # number of the first episode
    n: int
    phase: int  # units of a later phase come later


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


def join_columns(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Join columns of several units, one below the other, as one table."""
    return pd.concat([pd.DataFrame(one).astype({"room_entries": "Int64"}) for one in rows], ignore_index=True)


def unit_table(job: Job, found: Outcomes) -> pd.DataFrame:
    """Return a comparison's unit: the episodes of a job, with its scanner and rules; columns with `details.EXTRAS`."""
    assert job.rules is not None
    table, n = join_columns([rows_of(job, found)]), len(job.starts)
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


def make_units(
    work: Work[Any], jobs_of: Callable[[int], Sequence[Job]],
    table_of: Callable[[int, Sequence[tuple[Job, Outcomes]]], Any], *,
    windows: Callable[[Sequence[int]], Iterable[Sequence[int]]] = lambda left: [left], resumed: int = 0,
    on_progress: Callable[[int], object] | None = None, **how: Any,
) -> Costs:  # fmt: skip
    """Make the units that are left, of one run or of one after the other; return the costs.

    Args:
      work: takes every unit as soon as it is finished.
      jobs_of: returns the jobs of a unit, each with scanner and rules.
      table_of: returns the results of a unit, of its number, its jobs and what they left.
      windows: cuts the numbers of units into those that are run together.
      resumed: number of episodes that are there already.
      on_progress: called with the number of episodes that are there.
      how: engine, lanes, workers, keep, shared_with, as of `batch.run_jobs`.
    """
    costs, done = Costs(), resumed
    for window in windows(work.left) if work.left else ():
        parts = [(number, job) for number in window for job in jobs_of(number)]
        left, found = collections.Counter(number for number, _ in parts), {}

        def on_job(place, outcomes, parts=parts, left=left, found=found):
            number = parts[place][0]
            found[place] = outcomes
            left[number] -= 1
            if not left[number]:
                own = [i for i in sorted(found) if parts[i][0] == number]
                work.put(number, table_of(number, [(parts[i][1], found.pop(i)) for i in own]))

        moved = None if on_progress is None else (lambda n, done=done: on_progress(n + done))
        jobs = [job for _, job in parts]
        try:
            ran = batch.run_jobs(jobs, Lidar(), Rules(), **how, on_progress=moved, on_job=on_job).costs
        except KeyboardInterrupt:
            costs.interrupted = True
            break
        costs = costs.plus(ran)
        done += sum(len(job.starts) for job in jobs)
        if costs.interrupted:
            break
    return costs


class Ran(NamedTuple):
    """Result of `run_units`."""

    tables: list[pd.DataFrame]  # of `unit_table`
    costs: Costs
    resumed: int  # episodes that were there before


def run_units(
    jobs: Sequence[Job], *, ledger: Ledger | None = None, on_progress: Callable[[int], object] | None = None,
    **how: Any,
) -> Ran:  # fmt: skip
    """Run every episode of every job, with its scanner and rules, that the ledger does not have.

    `on_progress` and `how` are as of `make_units`. After Ctrl-C the result holds the units that had been finished.

    Raises:
      KeyboardInterrupt: there are none.
    """
    units = cut_jobs(jobs, 0 if ledger is None else ledger.after)
    earlier = [] if ledger is None or not ledger.after else [_earlier(ledger, jobs)]
    work: Work[pd.DataFrame] = Work(range(len(units)), ledger, details.to_file, details.of_file)
    resumed = sum(map(len, (*earlier, *work.done.values())))

    def jobs_of(number):
        number, first, n, phase = units[number]
        return [jobs[number]._replace(starts=jobs[number].starts[first : first + n], first=first, phase=phase)]

    costs = make_units(
        work, jobs_of, lambda _, made: unit_table(*made[0]), resumed=resumed, on_progress=on_progress, **how
    )
    if not work.done:  # a shorter run stays as it is
        raise KeyboardInterrupt
    return Ran([*earlier, *work.results], costs, resumed)


def _earlier(ledger, jobs):
    """Return the episodes of the finished comparison that the run of a ledger continues, as `unit_table` does."""
    episodes, extras, _ = details.read_details(ledger.folder.parent)
    return episodes[[*columns_of(jobs[0])]].join(extras)[episodes["episode"] < ledger.after]
