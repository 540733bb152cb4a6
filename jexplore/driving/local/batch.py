"""Runs of robots with a local map, with the results of `driving.batch.run_missions`."""

import collections
import dataclasses
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.config import InputError
from jexplore.driving.batch import Driven, MissionResults
from jexplore.driving.local.pilot import RunEnded
from jexplore.driving.local.run import LocalRun
from jexplore.driving.local.window import Fixed
from jexplore.driving.mission import MAP_SIZE, RunOutcome, RunResult
from jexplore.driving.records import Building
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.engine.devices import random_key
from jexplore.engine.runner import Costs, cpu_devices, find_resources
from jexplore.slam2d.settings import SlamSettings

# The constants of a step of the odometry are for a step of 0.1 s, not for those of logs: 4 mm, a tenth of the way, and
# 0.15 degrees, one and a half times the heading's walk. Larger ones let matches slide along walls, 0.7 m in 70 m. The
# gate stays at 0.3 m: in the open the pose may err by as much before walls are in sight again.
MATCHING = SlamSettings(way_m=0.004, turn_deg=0.15, max_deviations=40.0)
OnStep = Callable[[int, LocalRun], object]  # of the number of a run and the run


class LocalTask(NamedTuple):
    """All that a run needs."""

    fixed: Fixed
    tuning: Tuning
    start: np.ndarray  # [3] float32


def require_cpu(engine: str, lanes: int | None) -> None:
    """Refuse settings of an engine that runs of robots with a local map do not have.

    Raises:
      InputError: naming them.
    """
    if (engine, lanes) != ("auto", None):
        raise InputError("engine and lanes go with perception triangles: a local map runs on the CPU")


def tasks_of(
    building: Building,
    robots: Robot,
    tunings: Tuning,
    noises: Noise,
    starts: np.ndarray,
    seed: int,
    draws: np.ndarray,
) -> list[LocalTask]:
    """Return the runs; arguments as of `driving.batch.run_missions`."""
    key, on_device = random_key(np.uint32(seed)), jax.device_put(building, (cpu_devices() or jax.devices())[0])
    robots = dataclasses.replace(robots, name="")  # a name would make another program
    found = []
    for i, draw in enumerate(draws):
        robot, tuning, noise = jax.tree.map(lambda a, i=i: a[i], (robots, tunings, noises))
        fixed = Fixed(on_device, robot, noise, MATCHING, jax.random.fold_in(key, draw))
        found.append(LocalTask(jax.tree.map(jnp.asarray, fixed), tuning, starts[i]))
    return found


def in_threads(
    n: int,
    run_one: Callable[[int, Callable[[], None]], Any],
    workers: int | None,
    on_run: Callable[[int, Any], object],
) -> None:
    """Make runs, `workers` at a time, by default one a core; `on_run` is called with what each returns, in order.

    `run_one` is called with the number of a run and a function that it must call after every step.

    Raises:
      KeyboardInterrupt: after Ctrl-C, once the runs that have begun have been stopped.
    """
    halts = threading.Event()

    def watch():
        if halts.is_set():
            raise RunEnded(RunOutcome.RUNNING)

    with ThreadPoolExecutor(find_resources(workers=workers).workers) as pool:
        waiting = collections.deque(pool.submit(run_one, i, watch) for i in range(n))
        try:
            for i in range(n):
                on_run(i, waiting.popleft().result())
        finally:
            halts.set()
            pool.shutdown(cancel_futures=True)


def run_tasks(
    tasks: Sequence[LocalTask],
    max_steps: int,
    size: tuple[int, int],
    *,
    workers: int | None = None,
    on_run: Callable[[int, RunResult, Driven], object],
    on_step: OnStep = lambda i, run: None,
) -> None:
    """Make runs as `in_threads` does; `on_run` is called with each in their order.

    `on_step` is called after every step, from the run's thread.
    """

    def run_one(i, watch):
        def stepped(run):
            on_step(i, run)
            watch()

        task = tasks[i]
        run = LocalRun(task.fixed, task.start, task.tuning, max_steps, stepped)
        return _results_of(run, run.drive(), task.fixed, size)

    in_threads(len(tasks), run_one, workers, lambda i, found: on_run(i, *found))


def run_missions(
    tasks: Sequence[LocalTask],
    *,
    workers: int | None = None,
    max_steps: int,
    size: tuple[int, int] = MAP_SIZE,
    on_progress: Callable[[int], object] | None = None,
    blocks: Sequence[tuple[int, int]] | None = None,
    on_block: Callable[[int, RunResult, Driven | None], object] | None = None,
) -> MissionResults:
    """Make runs in a building on level ground; other arguments and results as of `driving.batch.run_missions`."""
    begin_s, results, ways, costs = time.perf_counter(), dict[int, RunResult](), dict[int, Driven](), Costs()
    blocks = [(0, len(tasks))] if blocks is None else list(blocks)
    order = [i for first, n in blocks for i in range(first, first + n)]
    firsts, ends = {first for first, _ in blocks}, {first + n - 1: k for k, (first, n) in enumerate(blocks)}

    def put(place, result, way):
        i = order[place]
        results[i] = result
        if i in firsts:
            ways[i] = way
        if on_progress is not None:
            on_progress(len(results))
        if on_block is not None and i in ends:
            first, n = blocks[ends[i]]
            on_block(ends[i], _stacked([results[k] for k in range(first, first + n)]), ways[first])

    try:
        run_tasks([tasks[i] for i in order], max_steps, size, workers=workers, on_run=put)
    except KeyboardInterrupt:
        if not results:
            raise
        costs.interrupted = True
    blank = jax.tree.map(np.zeros_like, next(iter(results.values())))
    costs.run_s = time.perf_counter() - begin_s
    stacked = _stacked([results.get(i, blank) for i in range(len(tasks))])
    return MissionResults(stacked, ways.get(blocks[0][0]), costs)


def _stacked(results) -> Any:
    return jax.tree.map(lambda *a: np.stack(a), *results)


def true_places(run: LocalRun, n: int) -> np.ndarray:
    """Return where the nodes of a run truly are: `[n, 2]` float32, metres, building's frame; NaN beyond the last."""
    places = np.full((n, 2), np.nan, np.float32)
    places[: len(run.map.nodes)] = [node.truth for node in run.map.nodes[:n]]
    return places


def _results_of(run, outcome, fixed, size):
    """Return the result and the way of a run that has ended."""
    now, found = run.pilot.now, run.map.to_btm(*size)
    estimate, truth, mode = (np.array(a) for a in zip(*run.pilot.way, strict=True))
    marks = np.asarray(fixed.building.marks)
    off2 = ((truth[None, ::2, :2] - marks[:, None, :2]) ** 2).sum(-1).min(1)
    fields: dict[str, Any] = {
        "map": found,
        "outcome": np.int32(RunOutcome.MAP_FULL if found.overflow else outcome),
        "steps": np.int32(len(run.pilot.way)),
        "path_m": np.float32(now.path_m),
        "contacts": np.int32(now.contacts),
        "refused": np.int32(now.refused),
        "interventions": np.int32(0),
        "node_at": true_places(run, size[0]),
        "mistaken": np.int32(run.mistaken),
        "met": off2 < marks[:, 2] ** 2,
        "scan_overflow": np.int32(run.pilot.points_left_out),
        "drift_m": np.float32(np.hypot(*(now.truth - now.pose)[:2])),
        "end": now.truth,
    }
    result = RunResult(**fields)
    pitch = np.zeros(len(mode), np.float32)
    return result, Driven(truth, estimate, mode.astype(np.int32), pitch)
