"""Shares of an episode's time, on one core: every part in a loop of its own, on the episode's data."""

import functools
import statistics
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jexplore.arrays import bits
from jexplore.bench.beliefs import Recording
from jexplore.bench.engines import RULES, SEED, Compiler
from jexplore.bench.kernels import NEVER, blank, never, vary_masks
from jexplore.bench.plans import plan_program
from jexplore.bench.timing import interleaved, speed_clock
from jexplore.frontier import plan_masks
from jexplore.grid import Grid, empty_grid
from jexplore.planning import Belief, bound_of, windows
from jexplore.policies import Strategy
from jexplore.raycast import Scan, fold, scan
from jexplore.reach import FAR, STRAIGHT, reach_packed
from jexplore.worlds.starts import draw_starts

PASSES = 16  # calls in a row on the same input
MOST_PLANS = 64  # plans of an episode that are timed, evenly spaced
PARTS = ("ranges", "map update", "masks and distance", "reachability", "selection and route", "rest")


class Look(NamedTuple):
    """Part of the map that one plan works on: a window round the robot, or the whole map."""

    masks: tuple[Any, ...]  # arguments of `plan_masks`
    words: np.ndarray  # [K, W] uint32, packed traversable cells
    goals: np.ndarray | None  # [32 K, W] bool; None where all costs are wanted
    limit: int
    decided: bool  # whether the plan needed no more


@functools.partial(jax.jit, static_argnames=("clearance_d2",))
def _masks(passes, arguments, p_free, near_d2, *, clearance_d2):
    numbers = {"p_free": p_free, "near_d2": near_d2, "clearance_d2": clearance_d2}

    def body(_, state):
        out, arguments = state
        arguments = vary_masks(never(out), arguments)
        return plan_masks(*arguments, **numbers), arguments

    start = blank(jax.eval_shape(lambda a: plan_masks(*a, **numbers), arguments))
    return lax.fori_loop(0, passes, body, (start, arguments))[0]


@jax.jit
def _costs(passes, words, row, col, goals, limit):
    def body(_, state):
        cost, words = state
        words = words.at[0, 0].set(words[0, 0] ^ (cost[-1, -1] == NEVER))
        return reach_packed(words, row, col, goals, limit=limit), words

    start = jnp.zeros((bits.WORD * words.shape[0], words.shape[1]), jnp.int32)
    return lax.fori_loop(0, passes, body, (start, words))[0]


def _cut(belief, side):
    """Return arguments of `plan_masks` for a window of a belief; for the whole map if `side` is None."""
    full = belief.driven.shape
    shape = full if side is None else tuple(min(n, side) for n in full)
    at = int(belief.row), int(belief.col)
    origin = (0, 0) if side is None else tuple(max(0, min(a - side // 2, n - side)) for a, n in zip(at, full))
    window = tuple(slice(first, first + n) for first, n in zip(origin, shape))
    inside = np.indices(full).reshape(2, *full) < np.asarray(belief.extent)[:, None, None]
    hits, misses, driven, exhausted, inside = (
        np.asarray(a)[window]
        for a in (belief.grid.hits, belief.grid.misses, belief.driven, belief.exhausted, inside.all(axis=0))
    )
    row, col = (np.int32(a - first) for a, first in zip(at, origin))
    # Ignored types: numpy on the host, where the record says what it is on the device.
    return Grid(hits, misses), driven, exhausted, inside, row, col  # type: ignore[arg-type]


def _look(belief, side, nearest_only):
    """Make a `Look` of a belief, as `planning` does."""
    cut = _cut(belief, side)
    shape, row, col = cut[1].shape, cut[4], cut[5]
    found = _masks(np.int32(1), cut, belief.model.p_free, belief.model.near_d2, clearance_d2=belief.model.clearance_d2)
    words, goals = np.asarray(found.traversable), np.asarray(bits.unpack(found.frontier))
    limit, decided = FAR, True
    if side is not None:
        radius = bound_of(side, belief.model.clearance_d2) // STRAIGHT
        rows, cols = np.ogrid[: shape[0], : shape[1]]
        central = (abs(rows - row) <= radius) & (abs(cols - col) <= radius)
        words = words & np.asarray(bits.pack(jnp.asarray(central)))
        goals = goals & np.pad(central, ((0, len(goals) - shape[0]), (0, 0)))
        limit = radius * STRAIGHT if goals.any() else -1
        cost = np.asarray(_costs(np.int32(1), words, row, col, goals, np.int32(limit)))
        decided = limit >= 0 and int(cost[goals].min()) <= limit
    return Look(cut, words, goals if nearest_only else None, limit, decided)


def looks(belief: Belief, nearest_only: bool) -> list[Look]:
    """List the parts of the map that a plan works on; windows first if only the nearest frontier is needed."""
    found, shape = [], belief.driven.shape
    for side in windows(shape, belief.model.clearance_d2) if nearest_only else ():
        found.append(_look(belief, side, True))
        if found[-1].decided:
            return found
    return [*found, _look(belief, None, nearest_only)]


def wants_nearest(strategy: Strategy) -> bool:
    """Return whether a strategy goes to the nearest frontier, which `planning` finds in windows."""
    return strategy.name.partition(":")[0].partition("+")[0] == "closest"


def cells_of(beliefs: Iterable[Belief]) -> float:
    """Return the average number of cells that the nearest frontier's plans examine."""
    return statistics.fmean(sum(look.masks[1].size for look in looks(belief, True)) for belief in beliefs)


def _scan_programs(recording):
    """Return `(ranges, update)`: functions of no arguments that make all scans of the episode, and count them in."""
    truth, beams, poses = jax.device_put((recording.site.truth.occupied, recording.site.beams, recording.poses))
    n, shape = len(recording.poses), truth.shape

    @jax.jit
    def ranges(truth, beams, poses):
        def step(i, ended):
            seen = scan(truth, *poses[i], beams)
            return Scan(ended.end.at[i].set(seen.end), ended.hit.at[i].set(seen.hit))

        blank = jnp.zeros((n, beams.length.shape[1]), jnp.int32)
        return lax.fori_loop(0, n, step, Scan(blank, blank != 0))

    @jax.jit
    def update(beams, poses, seen):
        def step(i, grid):
            return fold(grid, *poses[i], jax.tree.map(lambda a: a[i], seen), beams)

        return lax.fori_loop(0, n, step, empty_grid(shape))

    seen = ranges(truth, beams, poses)
    return lambda: ranges(truth, beams, poses), lambda: update(beams, poses, seen)


def measure_shares(compiler: Compiler, recording: Recording, strategy: Strategy, repeat: int) -> dict[str, Any]:
    """Measure the shares of an episode's time: a dict for the report.

    Args:
      compiler: `Compiler`.
      recording: `Recording` of the strategy's episode 0.
      strategy: `Strategy`.
      repeat: turns.
    """
    world, site = recording.world, recording.site
    setup, numbers = site.with_strategy(strategy)
    program, starts = compiler.one_by_one(world, strategy), draw_starts(world, SEED, 1, RULES.clearance_m)
    n = len(recording.beliefs)
    chosen = np.unique(np.linspace(0, n - 1, min(n, MOST_PLANS)).round().astype(int))
    beliefs = [recording.beliefs[i] for i in chosen]
    seen = [look for belief in beliefs for look in looks(belief, wants_nearest(strategy))]
    seen = jax.device_put([look._asdict() for look in seen])
    ranges, update = _scan_programs(recording)
    plan = plan_program(setup.policy, numbers.params, site.beams, site.truth.occupied.shape, PASSES)
    first, passes = beliefs[0], np.int32(PASSES)
    model, thresholds = first.model, (first.model.p_free, first.model.near_d2)

    def each(function, items):
        for item in items:
            jax.block_until_ready(function(item))

    def judge(look):
        return _masks(passes, look["masks"], *thresholds, clearance_d2=model.clearance_d2)

    def spread_costs(look):
        at = look["masks"][4:]
        return _costs(passes, look["words"], *at, look["goals"], jnp.int32(look["limit"]))

    tasks = {
        "episode": lambda: program.run(starts),
        "ranges": lambda: jax.block_until_ready(ranges()),
        "map update": lambda: jax.block_until_ready(update()),
        "plan": lambda: each(plan, beliefs),
        "masks and distance": lambda: each(judge, seen),
        "reachability": lambda: each(spread_costs, seen),
    }
    for task in tasks.values():
        task()
    runs = interleaved(tasks, repeat)
    result = runs["episode"][0][0].result
    scans, plans = int(result.scans[0]), int(result.plans[0])
    return _shares(recording, runs, len(beliefs), scans, plans)


def _shares(recording, runs, timed, scans, plans):
    """Return the shares of an episode's time by timed parts: a dict for the report.

    Args:
      recording: `Recording`.
      runs: from `interleaved`.
      timed: plans that were timed.
      scans, plans: of the episode.
    """
    units = {"episode": 1, "ranges": len(recording.poses), "map update": len(recording.poses)}
    calls = {"episode": 1, "ranges": scans, "map update": scans}
    call_s = {
        name: statistics.median(getattr(took, speed_clock()) for _, took in turns) / units.get(name, PASSES * timed)
        for name, turns in runs.items()
    }
    total = {name: seconds * calls.get(name, plans) for name, seconds in call_s.items()}
    parts = {name: total[name] for name in PARTS[:4]}
    parts["selection and route"] = total["plan"] - total["masks and distance"] - total["reachability"]
    parts["rest"] = total["episode"] - total["ranges"] - total["map update"] - total["plan"]
    return {
        "world": recording.world.name,
        "strategy": recording.strategy,
        "episode_s": total["episode"],
        "scans": scans,
        "plans": plans,
        "plans_timed": timed,
        "call_us": {name: 1e6 * seconds for name, seconds in call_s.items() if name != "episode"},
        "shares": {name: seconds / total["episode"] for name, seconds in parts.items()},
    }
