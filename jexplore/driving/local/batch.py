"""Runs of robots with a local map, one after the other, with the results of `driving.batch.run_missions`."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.driving.approach import HELPS_KEPT
from jexplore.driving.batch import Driven, MissionResults
from jexplore.driving.local.run import LocalRun
from jexplore.driving.local.window import Fixed
from jexplore.driving.mission import MAP_SIZE, RunOutcome, RunResult
from jexplore.driving.records import Building
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.engine.draws import random_key
from jexplore.engine.runner import Costs
from jexplore.slam2d.settings import SlamSettings


def run_missions(
    building: Building,
    robots: Robot,
    tunings: Tuning,
    noises: Noise,
    starts: np.ndarray,
    seed: int,
    draws: np.ndarray,
    *,
    max_steps: int,
    size: tuple[int, int] = MAP_SIZE,
    on_progress: Callable[[int], object] | None = None,
    blocks: Sequence[tuple[int, int]] | None = None,
    on_block: Callable[[int, RunResult, Driven | None], object] | None = None,
) -> MissionResults:
    """Make runs in a building on level ground; arguments and results as of `driving.batch.run_missions`."""
    begin_s, results, ways = time.perf_counter(), dict[int, RunResult](), dict[int, Driven]()
    key, on_device = random_key(np.uint32(seed)), jax.device_put(building)
    robots = dataclasses.replace(robots, name="")  # a name would make another program
    costs = Costs()
    blocks = [(0, len(draws))] if blocks is None else list(blocks)
    try:
        for number, (first, n) in enumerate(blocks):
            for i in range(first, first + n):
                robot, tuning, noise = jax.tree.map(lambda a, i=i: a[i], (robots, tunings, noises))
                fixed = Fixed(on_device, robot, noise, SlamSettings(), jax.random.fold_in(key, draws[i]))
                results[i], way = _run(fixed, tuning, starts[i], max_steps, size)
                if i == first:
                    ways[i] = way
                if on_progress is not None:
                    on_progress(len(results))
            if on_block is not None:
                on_block(number, _stacked([results[i] for i in range(first, first + n)]), ways[first])
    except KeyboardInterrupt:
        if not results:
            raise
        costs.interrupted = True
    blank = jax.tree.map(np.zeros_like, next(iter(results.values())))
    costs.run_s = time.perf_counter() - begin_s
    stacked = _stacked([results.get(i, blank) for i in range(len(draws))])
    return MissionResults(stacked, ways.get(blocks[0][0]), costs)


def _stacked(results) -> Any:
    return jax.tree.map(lambda *a: np.stack(a), *results)


def _run(fixed, tuning, start, max_steps, size):
    """Make one run: `(result, way)`."""
    run = LocalRun(jax.tree.map(jnp.asarray, fixed), start, tuning, max_steps)
    outcome = run.drive()
    now, nodes, found = run.pilot.now, run.map.nodes, run.map.to_btm(*size)
    estimate, truth, mode = (np.array(a) for a in zip(*run.pilot.way, strict=True))
    node_at = np.full((size[0], 2), np.nan, np.float32)
    node_at[: min(len(nodes), size[0])] = [node.truth for node in nodes[: size[0]]]
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
        "help_at": np.full((HELPS_KEPT, 4), np.nan, np.float32),
        "node_at": node_at,
        "mistaken": np.int32(run.mistaken),
        "met": off2 < marks[:, 2] ** 2,
        "scan_overflow": np.int32(run.pilot.points_left_out),
        "drift_m": np.float32(np.hypot(*(now.truth - now.pose)[:2])),
        "end": now.truth,
        "guide": None,
    }
    result = RunResult(**fields)
    pitch = np.zeros(len(mode), np.float32)
    return result, Driven(truth, estimate, mode.astype(np.int32), pitch)
