"""Trace robots on one clock, and the maps that they hold at every exchange.

The robots neither see nor steer by each other: each makes the run that it would make alone.
"""

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.btm import Btm
from jexplore.driving import mission
from jexplore.driving.batch import COMPILER_OPTIONS, step_slots
from jexplore.driving.local.batch import require_cpu, run_tasks, true_places
from jexplore.driving.mission import MissionTask, RunOutcome, RunResult, Setup
from jexplore.driving.records import State
from jexplore.engine.program import Given, Line, Program
from jexplore.engine.runner import Costs, find_resources, level_of, run_all
from jexplore.studies.traces.job import TraceJob
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
    rows: np.ndarray
    """`[K, W]` int32, map and true places at every exchange: see `_row`."""
    maps: dict[int, BtmMap] = dataclasses.field(default_factory=dict[int, BtmMap])
    """Exchange -> map there; of those that were needed."""

    def held(self, exchange: int) -> Held:
        """Return the map that the robot has when an exchange begins, from 0; after its run that of its end."""
        last = Held(self.result.map, self.result.node_at)
        if exchange >= len(self.rows):
            return last
        like, tree = jax.tree.flatten(last)
        parts = np.split(self.rows[exchange], np.cumsum([leaf.size for leaf in like])[:-1])
        # A bool was written as a number, other words as they are.
        typed = [part != 0 if leaf.dtype.kind == "b" else part.view(leaf.dtype) for part, leaf in zip(parts, like)]
        return jax.tree.unflatten(tree, [part.reshape(leaf.shape) for part, leaf in zip(typed, like)])

    def place(self, exchange: int) -> np.ndarray:
        """Return where the robot truly is when an exchange begins: `[2]`, metres; where it has ended after its run."""
        return self.truth[min(EXCHANGE_STEPS * (exchange + 1), len(self.truth)) - 1, :2]


class _Setup(NamedTuple):
    mission: Setup
    every: int


class _State(NamedTuple):
    robot: State
    rows: Array


def _row(held):
    """Return a `Held` as one row of words: one write a step in place of dozens."""
    leaves = jax.tree.leaves(held)
    words = [a.astype(jnp.int32) if a.dtype == bool else lax.bitcast_convert_type(a, jnp.int32) for a in leaves]
    return jnp.concatenate([a.ravel() for a in words])


def _row_of(robot):
    return _row(Held(robot.writer.map, robot.node_at))


def _begin(setup: _Setup, given: Given) -> _State:
    robot = mission.begin(setup.mission, given)
    width = jax.eval_shape(_row_of, robot).size
    return _State(robot, jnp.zeros((setup.mission.room // setup.every, width), jnp.int32))


def _advance(setup: _Setup, given: Given, state: _State) -> _State:
    robot = mission.advance(setup.mission, given, state.robot)
    n = state.rows.shape[0]
    at = jnp.where(robot.step % setup.every == 0, robot.step // setup.every - 1, n)
    return _State(robot, state.rows.at[at].set(_row_of(robot), mode="drop"))


def _is_done(state: _State) -> Array:
    return state.robot.outcome != RunOutcome.RUNNING


def _finish(setup: _Setup, given: Given, state: _State) -> RunResult:
    return mission.finish(setup.mission, given, state.robot)


def _detail(state: _State) -> tuple[Array, Array]:
    return state.robot.truth, state.rows


def run_robots(
    plan: TraceJob, *, engine: str = "auto", lanes: int | None = None, workers: int | None = None,
    on_progress: Callable[[int], Any] | None = None,
) -> tuple[list[RobotLog], Costs]:  # fmt: skip
    """Make the runs of a plan without a sweep: `(logs, costs)`.

    Raises:
      KeyboardInterrupt: after Ctrl-C; the others' maps of that time are missing.
    """
    if plan.perception == "map":
        require_cpu(engine, lanes)
        return _run_by_map(plan, workers, on_progress)
    resources = find_resources(engine=engine, lanes=lanes, workers=workers)
    setting, which = plan.all_runs()
    robots, tunings, noises = plan.settings_of(setting)
    unnamed = dataclasses.replace(robots, name="")  # a name would make another program
    tasks = MissionTask(unnamed, tunings, noises, plan.starts_of(which), None)  # type: ignore[arg-type]
    setup = _Setup(Setup(step_slots(plan.max_steps), *plan.size), EXCHANGE_STEPS)
    program = Program(setup, _begin, _advance, _is_done, _finish, _detail, cpu_options=COMPILER_OPTIONS)
    lines = [
        Line(
            *(program, (), plan.building, np.int32(plan.max_steps), plan.seed),
            jax.tree.map(lambda a, i=i: a[i : i + 1], tasks),
            np.zeros(1),
            draws=which[i : i + 1],
        )
        for i in range(plan.runs)
    ]  # a line a robot: of each the detailed record is kept
    costs = run_all(lines, resources, on_progress)
    costs.engine, costs.levels = engine, {plan.robot.name: [level_of(lines[0], resources)]}
    if costs.interrupted:
        raise KeyboardInterrupt
    return [_log(line) for line in lines], costs


def _run_by_map(plan, workers, on_progress):
    """Make the runs of robots with a local map: `run_robots`."""
    begin_s, tasks, logs = time.perf_counter(), plan.local_tasks(*plan.all_runs()), []
    rows = [[] for _ in tasks]

    def on_step(i, run):
        if len(run.pilot.way) % EXCHANGE_STEPS == 0:
            rows[i].append(np.asarray(_row(Held(run.map.to_btm(*plan.size), true_places(run, plan.size[0])))))

    def on_run(i, result, way):
        logs.append(RobotLog(result, way.truth, np.array(rows[i])))
        if on_progress is not None:
            on_progress(len(logs))

    run_tasks(tasks, plan.max_steps, plan.size, workers=workers, on_run=on_run, on_step=on_step)
    return logs, Costs(run_s=time.perf_counter() - begin_s)


def _log(line):
    result = jax.tree.map(lambda a: a[0], line.results)
    steps, (truth, rows) = int(result.steps), line.detail
    # Copies: a view would keep the room of all the steps that a run may have.
    return RobotLog(result, np.array(truth[:steps]), np.array(rows[: steps // EXCHANGE_STEPS]))
