"""The work of a sweep: its units, run block by block, by whatever engine.

pandas is imported by the functions that need it.
"""

import collections
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jexplore.config import Lidar, Rules
from jexplore.engine.runner import Costs
from jexplore.exploration import batch
from jexplore.studies.results.units import Unit, join_columns, rows_of
from jexplore.studies.sweeps.plan import SweepPlan

if TYPE_CHECKING:
    import pandas as pd

WINDOW_EPISODES = 8192  # of units that are run together
WINDOW_SITES = 32  # worlds made ready at a time


def run_block_units(
    plan: SweepPlan,
    numbers: Sequence[int],
    on_unit: Callable[[int, "pd.DataFrame"], object],
    *,
    engine: str = "auto",
    lanes: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> Costs:
    """Run units of a sweep.

    Args:
      plan: `SweepPlan`.
      numbers: of the units, in order.
      on_unit: called with the number of a unit and its table, once all its episodes have ended.
      engine, lanes, workers, on_progress: as in `batch.run_jobs`.

    Returns:
      `Costs`, added up; `interrupted` after Ctrl-C.
    """
    costs, done = Costs(), 0
    for window in _windows(plan, numbers):
        blocks = [(number, block) for number in window for block in plan.units[number]]
        left = collections.Counter(number for number, _ in blocks)
        tables: dict[int, list[Any]] = {number: [] for number in window}
        jobs = [plan.job(block, window.index(number)) for number, block in blocks]

        def on_job(place, found, blocks=blocks, left=left, tables=tables, jobs=jobs):
            number, block = blocks[place]
            tables[number].append((place, _rows(plan, block, jobs[place], found)))
            left[number] -= 1
            if not left[number]:
                rows = [own for _, own in sorted(tables.pop(number), key=lambda own: own[0])]
                on_unit(number, typed(join_columns(rows), plan))

        progress = None if on_progress is None else (lambda n, done=done: on_progress(done + n))
        how: dict[str, Any] = {"engine": engine, "lanes": lanes, "workers": workers}
        how["alike"] = plan.alike
        try:
            found = batch.run_jobs(jobs, Lidar(), Rules(), **how, on_progress=progress, on_job=on_job).costs
        except KeyboardInterrupt:
            costs.interrupted = True
            return costs
        costs = costs.plus(found)
        done += sum(block.n for _, block in blocks)
        if costs.interrupted:
            break
    return costs


def _windows(plan: SweepPlan, numbers: Sequence[int]) -> Iterator[list[int]]:
    """Yield units that are run together: few enough to fit into the memory."""
    window, sites, episodes = [], set(), 0
    for number in numbers:
        own = {(block.setting, block.world) for block in plan.units[number]}
        n = sum(block.n for block in plan.units[number])
        if window and (episodes + n > WINDOW_EPISODES or len(sites | own) > WINDOW_SITES):
            yield window
            window, sites, episodes = [], set(), 0
        window.append(number)
        sites |= own
        episodes += n
    if window:
        yield window


def _rows(plan, block, job, found):
    """Return the rows of a block, as columns."""
    strategy = plan.strategies[block.strategy]
    # The job's own starts begin with the block's first episode.
    rows = rows_of(job._replace(strategy=strategy), Unit(0, 0, block.n, 0), found)
    rows["episode"] = rows["episode"] + block.first
    setting, n = plan.settings[block.setting], len(rows["episode"])
    own = {"setting": np.full(n, block.setting)}
    for name in plan.columns[1:]:
        kind, _, key = name.partition(".")
        rows[name] = [plan.parameters[block.strategy].get(key) if kind == "strategy" else setting[name]] * n
    return own | rows


def typed(table: "pd.DataFrame", plan: Any) -> "pd.DataFrame":
    """Convert a table of a sweep, or of its part, to the column types of the whole plan.

    Types are truth values, whole numbers, numbers (NaN where missing), and text (empty where missing).
    """
    for name, kind in plan.kinds.items():
        if kind == "text":
            table[name] = ["" if value is None or value != value else str(value) for value in table[name]]
        else:
            table[name] = table[name].astype(kind)
    return table
