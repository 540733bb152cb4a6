"""Cost of a plan of each strategy, on one core: all on the same beliefs, those of one episode."""

import statistics
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jexplore import planning
from jexplore.bench import oracles
from jexplore.bench.beliefs import Recording, record
from jexplore.bench.engines import Compiler
from jexplore.bench.kernels import NEVER, microseconds, row_of
from jexplore.bench.rates import Effort
from jexplore.bench.timing import compiled, interleaved, speed_clock
from jexplore.engine.draws import random_key
from jexplore.policies import parse_strategy
from jexplore.raycast import Beams
from jexplore.reach import FAR, NO_MOTION
from jexplore.worlds.world import World

PLAN_PASSES = 10  # plans from the same belief in one timed call
BELIEFS = 24  # at most, evenly spaced over the episode
RECORDED = "closest+recheck"


def plan_program(
    policy: Any, params: Any, beams: Beams, shape: tuple[int, ...], passes: int
) -> Callable[[planning.Belief], Any]:
    """Return a function that plans a number of times from a belief."""
    route = jnp.full(shape, NO_MOTION, jnp.int8)

    @jax.jit
    def plans(belief, route, carry):
        def body(i, state):
            choice, route, grid = state
            no = choice.cost == NEVER
            grid = grid.replace(hits=grid.hits.at[0, 0].add(no))
            here = belief.replace(row=belief.row + no, grid=grid)
            key = jax.random.fold_in(random_key(0), i)
            _, choice, route = policy.select(key, params, carry, here, beams, route)
            return choice, route, grid

        first = jax.eval_shape(lambda b: policy.select(random_key(0), params, carry, b, beams, route)[1], belief)
        start = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), first)
        return lax.fori_loop(0, passes, body, (start, route, belief.grid))[:2]

    return lambda belief: plans(belief, route, policy.init(params, belief))


def plan_costs(
    world: World,
    names: Iterable[str],
    *,
    others: Mapping[str, Callable[[planning.Belief], Any]] | None = None,
    repeat: int = 3,
) -> dict[str, float]:
    """Measure milliseconds a plan, each strategy on the same beliefs: those of an episode of `closest+recheck`.

    Args:
      world: `World`.
      names: strategies. Modifiers that do not change how a plan is made cost nothing here.
      others: `{name: function of a belief}`, timed as well, or None.
      repeat: turns.

    Returns:
      `{name: milliseconds}`; the median over turns of the mean over beliefs.
    """
    recording = record(Compiler(), world, parse_strategy(RECORDED))
    site, n = recording.site, len(recording.beliefs)
    chosen = np.unique(np.linspace(0, n - 1, min(n, BELIEFS)).round().astype(int))
    beliefs = jax.device_put([recording.beliefs[i] for i in chosen])

    def each(program):
        return lambda: [jax.block_until_ready(program(belief)) for belief in beliefs]

    def task(name):
        strategy = parse_strategy(name)
        setup, numbers = site.with_strategy(strategy)
        return each(plan_program(setup.policy, numbers.params, site.beams, site.truth.occupied.shape, 1))

    tasks = {name: task(name) for name in names}
    tasks |= {name: each(jax.jit(function)) for name, function in (others or {}).items()}
    for first in tasks.values():
        first()
    turns = interleaved(tasks, repeat)
    clock = speed_clock()
    return {
        name: 1e3 * statistics.median(getattr(took, clock) for _, took in runs) / len(beliefs)
        for name, runs in turns.items()
    }


@jax.jit
def _plans(passes, belief, route):
    """Make `passes` plans from the same belief."""

    def body(_, state):
        choice, route, grid = state
        no = choice.cost == NEVER
        grid = grid.replace(hits=grid.hits.at[0, 0].add(no))
        return *planning.nearest_frontier(belief.replace(row=belief.row + no, grid=grid), route), grid

    zero = jnp.int32(0)
    state = planning.Choice(zero, zero, zero, zero), route, belief.grid
    return lax.fori_loop(0, passes, body, state)[:2]


def _judged(belief):
    """Compute traversable and frontier cells of a belief by scipy."""
    shape = belief.driven.shape
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    inside = (rows < int(belief.extent[0])) & (cols < int(belief.extent[1]))
    hits, misses, driven, exhausted = (
        np.asarray(a) for a in (belief.grid.hits, belief.grid.misses, belief.driven, belief.exhausted)
    )
    numbers = {
        "p_free": float(belief.model.p_free),
        "near_d2": int(belief.model.near_d2),
        "clearance_d2": belief.model.clearance_d2,
    }
    row, col = int(belief.row), int(belief.col)
    return oracles.masks(hits, misses, driven, exhausted, inside, row, col, **numbers)


def measure_nearest(recording: Recording, repeat: int) -> dict[str, Any]:
    """Time the nearest frontier and the route to it at every plan of an episode: a dict for the report.

    Args:
      recording: `Recording` of a strategy that goes there.
      repeat: turns.
    """
    beliefs = recording.beliefs
    shape = beliefs[0].driven.shape
    route = jnp.full(shape, NO_MOTION, jnp.int8)
    program, took = compiled(lambda: _plans.lower(np.int32(1), beliefs[0], route))
    found = [jax.tree.map(int, program(np.int32(1), belief, route)[0]) for belief in beliefs]
    judged = [_judged(belief) for belief in beliefs]
    places = [(int(belief.row), int(belief.col)) for belief in beliefs]

    def other():
        return [oracles.dijkstra(mask, *at, goals, True) for (mask, goals), at in zip(judged, places)]

    def wanted(cost, target):
        at = divmod(int(target), shape[1]) if target >= 0 else (-1, -1)
        return (*at, int(cost[at]) if target >= 0 else FAR)

    equal = all(
        (choice.row, choice.col, choice.cost) == wanted(*theirs)
        and (choice.row, choice.col) == (own if own is not None else (-1, -1))
        for choice, theirs, own in zip(found, other(), recording.targets)
    )
    passes = np.int32(PLAN_PASSES)

    def ours():
        for belief in beliefs:
            jax.block_until_ready(program(passes, belief, route))

    tasks = {"": ours} | ({"other": other} if oracles.NATIVE else {})
    units = {"": PLAN_PASSES * len(beliefs), "other": len(beliefs)}
    times = microseconds(interleaved(tasks, repeat), units)
    reference = "masks given, Dijkstra up to the first frontier, numba", equal, times.get("other")
    on = f"{recording.world.name}, {len(beliefs)} plans"
    work = Effort()  # how much of the map a plan reads is not known
    return row_of("plan", on, recording.world.shape, took, times[""], [reference], work)
