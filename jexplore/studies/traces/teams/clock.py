"""Trace robots on one clock, and the maps that they hold at every exchange.

The robots neither see nor steer by each other: each makes the run that it would make alone.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jexplore.btm import Btm
from jexplore.driving import mission
from jexplore.driving.local.batch import make_all, run_task, true_places
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
    tasks = plan.local_tasks(*plan.all_runs()) if plan.perception == "map" else []

    def by_map(i, watch):
        held: list[Held] = []

        def on_step(run):
            if len(run.pilot.way) % EXCHANGE_STEPS == 0:
                held.append(Held(jax.device_get(run.map.to_btm(*plan.size)), true_places(run, plan.size[0])))
            watch()

        result, way = run_task(tasks[i], plan.size, on_step)
        return RobotLog(result, way.truth, held)

    def by_triangles(i, watch):
        held: list[Held] = []
        setup, given, state = begin_run(plan, i)
        while int(state.outcome) == RunOutcome.RUNNING:
            state = advance(setup, given, state)
            if int(state.step) % EXCHANGE_STEPS == 0:
                held.append(jax.device_get(Held(state.writer.map, state.node_at)))
            watch()
        result, truth = jax.device_get((mission.finish(setup, given, state), state.truth[: int(state.step)]))
        return RobotLog(result, truth, held)

    return make_all(plan.runs, by_map if tasks else by_triangles, workers, on_progress)
