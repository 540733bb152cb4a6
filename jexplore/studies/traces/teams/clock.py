"""Trace robots on one clock, and the maps that they hold at every exchange.

The robots neither see nor steer by each other: each makes the run that it would make alone.
"""

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jexplore.btm import Btm
from jexplore.driving import mission
from jexplore.driving.local.batch import in_threads, run_tasks, true_places
from jexplore.driving.mission import RunOutcome, RunResult
from jexplore.engine.runner import Costs
from jexplore.studies.traces.job import TraceJob
from jexplore.studies.traces.recording import advance, begin_run
from jexplore.tracemap.record import BtmMap

EXCHANGE_STEPS = 100  # steps between two exchanges: 10 s, in which a robot drives 4 m


class Held(NamedTuple):
    """Map of a robot at some time."""

    map: Btm
    node_at: Any  # [N, 2] float32 array, where the robot truly was when it made a node, building's frame


@dataclasses.dataclass(frozen=True)
class RobotLog:
    """Run of one robot of a team."""

    result: RunResult
    truth: np.ndarray
    """`[n, 3]` float32, true poses, building's frame; n = steps."""
    exchanges: list[Held]
    """At every exchange."""
    maps: dict[int, BtmMap] = dataclasses.field(default_factory=dict[int, BtmMap])
    """Exchange -> map there; of those that were needed."""

    def held(self, exchange: int) -> Held:
        """Return the map that the robot has when an exchange begins, from 0; after its run that of its end."""
        if exchange < len(self.exchanges):
            return self.exchanges[exchange]
        return Held(self.result.map, self.result.node_at)

    def place(self, exchange: int) -> np.ndarray:
        """Return where the robot truly is when an exchange begins: `[2]`, metres; where it has ended after its run."""
        return self.truth[min(EXCHANGE_STEPS * (exchange + 1), len(self.truth)) - 1, :2]


def run_robots(
    plan: TraceJob, *, workers: int | None = None, on_progress: Callable[[int], Any] | None = None
) -> tuple[list[RobotLog], Costs]:
    """Make the runs of a plan without a sweep, each on a core: `(logs, costs)`.

    Raises:
      KeyboardInterrupt: after Ctrl-C; the others' maps of that time are missing.
    """
    begin_s, logs = time.perf_counter(), []
    held: list[list[Held]] = [[] for _ in range(plan.runs)]

    def on_run(i, result, way):
        logs.append(RobotLog(result, way, held[i]))
        if on_progress is not None:
            on_progress(len(logs))

    def on_step(i, run):
        if len(run.pilot.way) % EXCHANGE_STEPS == 0:
            held[i].append(Held(jax.device_get(run.map.to_btm(*plan.size)), true_places(run, plan.size[0])))

    def by_triangles(i, watch):
        setup, given, state = begin_run(plan, i)
        while int(state.outcome) == RunOutcome.RUNNING:
            state = advance(setup, given, state)
            if int(state.step) % EXCHANGE_STEPS == 0:
                held[i].append(jax.device_get(Held(state.writer.map, state.node_at)))
            watch()
        return jax.device_get((mission.finish(setup, given, state), state.truth[: int(state.step)]))

    if plan.perception == "map":
        tasks = plan.local_tasks(*plan.all_runs())
        told = {"on_run": lambda i, result, way: on_run(i, result, way.truth), "on_step": on_step}
        run_tasks(tasks, plan.max_steps, plan.size, workers=workers, **told)
    else:
        in_threads(plan.runs, by_triangles, workers, lambda i, found: on_run(i, *found))
    return logs, Costs(run_s=time.perf_counter() - begin_s)
