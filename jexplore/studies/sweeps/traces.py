"""Sweeps of robots that write Behavioral Trace Maps: thresholds and noise as settings.

pandas is imported by the functions that need it.
"""

import dataclasses
import itertools
import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jexplore.config import InputError, require_different
from jexplore.driving.batch import MAX_STEPS
from jexplore.driving.settings import for_world, require_noise, require_tuning
from jexplore.engine.runner import Costs
from jexplore.report.tables import aligned_table, number_text, spread_text
from jexplore.studies.checks import require_different_buildings
from jexplore.studies.results.provenance import world_digest
from jexplore.studies.sweeps.plan import MAX_SWEEP_UNITS, column_type
from jexplore.studies.sweeps.spec import MAX_TOTAL, Sweep, plain_spec
from jexplore.studies.traces.job import NOISE, TraceJob, prepare_trace
from jexplore.studies.traces.tracing import trace_table
from jexplore.version import __version__
from jexplore.worlds.world import World

if TYPE_CHECKING:
    import pandas as pd

UNIT_RUNS = 256  # runs of a unit, about
RUN_S = 0.1  # processor seconds of a run of the course, about (benchmarks/RESULTS.md, Behavioral Trace Maps)
TRACE_COMPILE_S = 25.0  # of compiling a program


@dataclasses.dataclass(frozen=True)
class TracePlan:
    """A sweep of robots that can be run."""

    spec: Sweep
    settings: list[dict[str, Any]]
    groups: list[tuple[list[int], TraceJob]]
    """Runs of one robot in one world with one seed, one call of the engine: numbers of the settings in order, job."""
    units: list[tuple[int, int, int]]
    """Of every unit group, first run and number of runs."""

    @property
    def reference(self) -> str:
        """Return no reference: robots are not compared with one."""
        return ""

    def all_worlds(self) -> list[World]:
        """Return every world in every cell size."""
        return list({(job.world.name, job.world.cell_m): job.world for _, job in self.groups}.values())

    @property
    def episodes(self) -> int:
        """Return the number of runs of the whole sweep."""
        return sum(n for *_, n in self.units)

    @property
    def programs(self) -> int:
        """Return the number of compiled programs: one for each size of world."""
        return len({job.world.shape for _, job in self.groups})

    @property
    def columns(self) -> list[str]:
        """Return columns of settings in the table of runs."""
        return ["setting", *self.settings[0]]

    @property
    def kinds(self) -> dict[str, str]:
        """Return columns of settings and the types of their values, see `plan.kind_of`."""
        return {name: column_type([setting[name] for setting in self.settings]) for name in self.columns[1:]}

    def size(self, unit: int) -> int:
        """Return the number of runs of a unit."""
        return self.units[unit][2]

    def seconds(self, workers: int) -> float:
        """Estimate the time on a number of cores, compiling included."""
        return (RUN_S * self.episodes + TRACE_COMPILE_S * self.programs) / max(workers, 1)

    def asked(self, shard: tuple[int, int] | None = None) -> dict[str, Any]:
        """Return all that the results depend on, as plain values."""
        return {
            "version": __version__,
            "spec": plain_spec(self.spec),
            "digests": [world_digest(job.world) for _, job in self.groups],
            "shard": None if shard is None else f"{shard[0] + 1}/{shard[1]}",
        }

    def shorter(self, shard: tuple[int, int] | None = None) -> None:
        """Return no shorter sweeps to continue."""
        del shard


def prepare_traces(spec: Sweep) -> TracePlan:
    """Check a sweep of robots, and cut its work.

    Raises:
      InputError: what cannot be run, in one line.
    """
    require_different("worlds", [os.fspath(world) for world in spec.worlds])
    require_different("robots", list(spec.robots))
    settings, records = spec.expanded(), spec.records("tuning", "noise")
    for *_, tuning, noise in records:
        require_tuning(for_world(tuning, is_course=False))
        require_noise(noise)
    total = spec.episodes * len(settings) * len(spec.worlds) * len(spec.robots)
    if total > MAX_TOTAL:
        raise InputError(f"a sweep may have {MAX_TOTAL:,} runs, got {total:,}; use fewer settings or runs")
    if spec.start != "random" or spec.start_m is not None:
        raise InputError("start is for strategies: a robot starts where its world says")
    # What there is to find depends on C1, and on where the robot has its nodes in free space.
    together: dict[tuple[int, float, float, float], list[int]] = {}
    for i, (seed, cell_m, tuning, _) in enumerate(records):
        together.setdefault((seed, cell_m, tuning.open_m, tuning.coast_m), []).append(i)
    groups = []
    for name, kind in itertools.product(spec.worlds, spec.robots):
        for (seed, cell_m, *_), own in together.items():
            job = prepare_trace(name, robot=kind, runs=1, seed=seed, tuning=records[own[0]][2], cell_m=cell_m)
            groups.append((own, _with_settings(job, spec, records, own)))
    require_different_buildings(job.world for _, job in groups)
    size, units = max(UNIT_RUNS, -(-total // MAX_SWEEP_UNITS)), []
    for i, (own, _) in enumerate(groups):
        n = len(own) * spec.episodes
        units += [(i, first, min(size, n - first)) for first in range(0, n, size)]
    return TracePlan(spec, settings, groups, units)


def _with_settings(job, spec, records, own):
    """Return a job whose thresholds and noise are those of some settings."""
    swept = {}
    tunings = [for_world(records[i][2], is_course=job.world.course is not None) for i in own]
    for tuning in tunings:
        require_tuning(tuning)
    for part, settings, default in (("", tunings, job.tuning), (NOISE, [records[i][3] for i in own], job.noise)):
        for field in dataclasses.fields(default):
            values = np.array([getattr(one, field.name) for one in settings])
            if len(set(values.tolist())) > 1 or values[0] != getattr(default, field.name):
                swept[f"{part}{field.name}"] = values
    return dataclasses.replace(job, runs=spec.episodes, swept=swept, settings=len(own), max_steps=MAX_STEPS)


def run_traces(
    plan: TracePlan,
    numbers: Sequence[int],
    on_unit: Callable[[int, "pd.DataFrame"], object],
    *,
    on_progress: Callable[[int], object] | None = None,
    **how: Any,
) -> Costs:
    """Run units of a sweep of robots; `on_unit` gets the number and the table of each that has ended.

    `how` has engine, lanes and workers, see `runner.find_resources`.
    """
    costs, done = Costs(), 0
    for group in dict.fromkeys(plan.units[number][0] for number in numbers):
        mine = [number for number in numbers if plan.units[number][0] == group]
        progress = None if on_progress is None else (lambda n, done=done: on_progress(done + n))
        try:
            found = _run_group(plan, plan.groups[group], mine, on_unit, {**how, "on_progress": progress})
        except KeyboardInterrupt:
            costs.interrupted = True
            return costs
        costs = costs.plus(found)
        done += sum(plan.size(number) for number in mine)
        if costs.interrupted:
            break
    return costs


def _run_group(plan, group, numbers, on_unit, how):
    (settings, job), blocks = group, [plan.units[number][1:] for number in numbers]
    setting, which = job.all_runs()

    def on_block(place, result, driven):
        at = slice(blocks[place][0], sum(blocks[place]))
        table, _ = trace_table(job, result, np.asarray(settings)[setting[at]], which[at], {})
        for name in plan.columns[1:]:
            table[name] = [plan.settings[i][name] for i in table["setting"]]
        on_unit(numbers[place], table)

    return job.run(setting, which, blocks=blocks, on_block=on_block, **how).costs


def summarise_traces(runs: "pd.DataFrame", columns: Sequence[str]) -> "pd.DataFrame":
    """Tabulate one row a setting, world and robot.

    Columns are `n` runs; `goal`, the share that reached the goal or left nothing to follow; `true`, the share whose map
    is the world's true one (NaN without a truth); `same`, the share with the commonest map; `mean` and `sd` of the
    path, metres; `contacts`, their mean number; and those of settings.
    """
    import pandas as pd

    rows, own = [], [name for name in columns if name != "setting"]
    for (setting, world, robot), some in runs.groupby(["setting", "world", "robot"], sort=False):  # type: ignore[misc]
        known = some["true"].dropna()
        rows.append(
            {
                **{"setting": setting, "world": world, "robot": robot},
                **{name: some[name].iloc[0] for name in own},
                "n": len(some),
                "goal": some["outcome"].isin(["GOAL", "EXHAUSTED"]).mean(),
                "true": known.astype(float).mean() if len(known) else np.nan,
                "same": some["code"].value_counts().iloc[0] / len(some),
                **{
                    "mean": some["path_m"].mean(),
                    "sd": some["path_m"].std(ddof=1),
                    "contacts": some["contacts"].mean(),
                },
            }
        )
    return pd.DataFrame(rows)


def traces_table(summary: Any, varied: Sequence[str], as_text: Callable[..., str] = aligned_table) -> str:
    """Format rows of `summarise_traces` as Markdown, or by `as_text` from names of columns and texts of rows."""
    head = ["world", "robot", *varied, "n", "reached", "true map", "commonest map", "path m", "contacts"]
    lines = []
    for _, row in summary.iterrows():
        settings = [f"{row[name]:.4g}" if isinstance(row[name], float) else str(row[name]) for name in varied]
        shares = ["-" if row[name] != row[name] else f"{100 * row[name]:.0f}%" for name in ("goal", "true", "same")]
        path = [spread_text(row["mean"], row["sd"]), number_text(row["contacts"], 1)]
        lines.append([row["world"], row["robot"], *settings, str(row["n"]), *shares, *path])
    return as_text(head, lines, left=("world", "robot"))
