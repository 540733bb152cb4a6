"""Runs of robots with a local map, with the results of `driving.batch.run_missions`."""

import dataclasses
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.driving.batch import Driven, MissionResults
from jexplore.driving.local.run import LocalRun
from jexplore.driving.local.window import Fixed, LocalTask
from jexplore.driving.mission import MAP_SIZE, RunOutcome, RunResult
from jexplore.driving.records import Building
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.engine.devices import random_key
from jexplore.engine.runner import Costs, OwnRuns, cpu_devices, find_resources, run_all
from jexplore.engine.threads import Pieces
from jexplore.slam2d.settings import SlamSettings

# The constants of a step of the odometry are for a step of 0.1 s, not for those of logs: 4 mm, a tenth of the way, and
# 0.15 degrees, one and a half times the heading's walk. Larger ones let matches slide along walls, 0.7 m in 70 m. The
# gate stays at 0.3 m: in the open the pose may err by as much before walls are in sight again.
MATCHING = SlamSettings(way_m=0.004, turn_deg=0.15, max_deviations=40.0)


def tasks_of(
    building: Building,
    robots: Robot,
    tunings: Tuning,
    noises: Noise,
    starts: np.ndarray,
    seed: int,
    draws: np.ndarray,
    max_steps: int,
) -> list[LocalTask]:
    """Return the runs, each of at most `max_steps`; other arguments as of `driving.batch.run_missions`."""
    key, on_device = random_key(np.uint32(seed)), jax.device_put(building, (cpu_devices() or jax.devices())[0])
    robots = dataclasses.replace(robots, name="")  # a name would make another program
    found = []
    for i, draw in enumerate(draws):
        robot, tuning, noise = jax.tree.map(lambda a, i=i: a[i], (robots, tunings, noises))
        fixed = Fixed(on_device, robot, noise, MATCHING, jax.random.fold_in(key, draw))
        found.append(LocalTask(jax.tree.map(jnp.asarray, fixed), tuning, starts[i], max_steps))
    return found


class HostRuns(OwnRuns):
    """Runs that are made on the host, one a core at a time."""

    def __init__(self, n: int, run_one: Callable[[int, Callable[[], None]], Any], phase: int = 0) -> None:
        """Make n runs: `run_one` is called with the number of each and a function that it must call after every step.

        `phase` is that of `threads.Pieces`.
        """
        self.which, self.finished = np.arange(n, dtype=np.int32), np.zeros(n, bool)
        self.found: list[Any] = [None] * n
        """Values that `run_one` has returned; None before."""
        self._run_one, self._phase, self._halts = run_one, phase, threading.Event()

    def pieces(self) -> Pieces:
        """Return the runs, for `threads.share_out`."""

        def keep(i, _, found):
            self.found[i], self.finished[i] = found, True

        return Pieces(len(self.found), 1, lambda i, _: self._run_one(i, self._watch), keep, phase=self._phase)

    def give_up(self) -> None:
        """Make runs that are under way break off at their next step."""
        self._halts.set()

    def _watch(self):
        if self._halts.is_set():
            raise CancelledError


def make_all(
    n: int,
    run_one: Callable[[int, Callable[[], None]], Any],
    workers: int | None,
    on_progress: Callable[[int], object] | None,
) -> tuple[list[Any], Costs]:
    """Make `HostRuns`, `workers` at a time, by default one a core; return what each has returned, and the costs.

    Raises:
      KeyboardInterrupt: after Ctrl-C.
    """
    runs = HostRuns(n, run_one)
    costs = run_all([runs], find_resources(workers=workers), on_progress)
    if costs.interrupted:
        raise KeyboardInterrupt
    return runs.found, costs


def run_task(task: LocalTask, size: tuple[int, int], on_step: Callable[[LocalRun], object]) -> tuple[RunResult, Driven]:
    """Make a run: its result and its way. `on_step` is called with it after every step."""
    run = LocalRun(task, on_step)
    return _results_of(run, run.drive(), task.fixed, size)


def run_missions(
    tasks: Sequence[LocalTask],
    *,
    workers: int | None = None,
    size: tuple[int, int] = MAP_SIZE,
    on_progress: Callable[[int], object] | None = None,
    blocks: Sequence[tuple[int, int]] | None = None,
    on_block: Callable[[int, RunResult, Driven | None], object] | None = None,
) -> MissionResults:
    """Make runs in a building on level ground; other arguments and results as of `driving.batch.run_missions`."""
    blocks = [(0, len(tasks))] if blocks is None else blocks

    def run_one(i, watch):
        result, way = run_task(tasks[i], size, lambda run: watch())
        return result, way if i == 0 else None  # those of thousands of runs would fill the memory

    work = [
        HostRuns(n, lambda i, watch, first=first: run_one(first + i, watch), phase)
        for phase, (first, n) in enumerate(blocks)
    ]

    def tell(k):
        if on_block is not None:
            on_block(k, _stacked([result for result, _ in work[k].found]), work[k].found[0][1])

    costs = run_all(work, find_resources(workers=workers), on_progress, tell)
    found = {first + i: one for (first, _), own in zip(blocks, work) for i, one in enumerate(own.found) if one}
    blank = jax.tree.map(np.zeros_like, next(iter(found.values()))[0]), None
    made = [found.get(i, blank) for i in range(len(tasks))]
    return MissionResults(_stacked([result for result, _ in made]), made[0][1], costs)


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
