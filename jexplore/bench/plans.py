"""What a plan of each strategy costs, on one core: all on the same beliefs, those of one episode."""

import statistics

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jexplore.bench.beliefs import record
from jexplore.bench.engines import Compiler
from jexplore.bench.kernels import NEVER
from jexplore.bench.timing import interleaved, speed_clock
from jexplore.exploration.batch import ENGINES
from jexplore.exploration.site import numbers_of, setup_of
from jexplore.policies import parse_strategy
from jexplore.reach import NO_MOTION

BELIEFS = 24  # at most, evenly spaced over the episode
RECORDED = "closest+recheck"


def plan_program(strategy, setup, params, beams, shape, passes):
    """Function of a belief that plans so many times from it."""
    route = jnp.full(shape, NO_MOTION, jnp.int8)

    @jax.jit
    def plans(belief, route, carry):
        def body(i, state):
            choice, route, grid = state
            no = choice.cost == NEVER
            grid = grid.replace(hits=grid.hits.at[0, 0].add(no))
            here = belief.replace(row=belief.row + no, grid=grid)
            _, choice, route = setup.select(jax.random.fold_in(jax.random.key(0), i), params, carry, here, beams, route)
            return choice, route, grid

        first = jax.eval_shape(lambda b: setup.select(jax.random.key(0), params, carry, b, beams, route)[1], belief)
        start = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), first)
        return lax.fori_loop(0, passes, body, (start, route, belief.grid))[:2]

    return lambda belief: plans(belief, route, setup.init(params, belief))


def plan_costs(world, names, *, others=None, repeat=3):
    """Milliseconds a plan, each strategy on the same beliefs: those at the plans of an episode of `closest+recheck`.

    Args:
      world: `World`.
      names: strategies. Modifiers that do not change how a plan is made cost nothing here.
      others: `{name: function of a belief}`, timed beside them, or None.
      repeat: turns.

    Returns:
      `{name: milliseconds}`; the median over turns of the mean over beliefs.
    """
    recording = record(Compiler(), world, parse_strategy(RECORDED), ENGINES["serial"].reach)
    site, n = recording.site, len(recording.beliefs)
    chosen = np.unique(np.linspace(0, n - 1, min(n, BELIEFS)).round().astype(int))
    beliefs = jax.device_put([recording.beliefs[i] for i in chosen])

    def each(program):
        return lambda: [jax.block_until_ready(program(belief)) for belief in beliefs]

    def task(name):
        strategy = parse_strategy(name)
        setup, params = setup_of(site, strategy, ENGINES["serial"]), numbers_of(site, strategy).params
        return each(plan_program(strategy, setup, params, site.beams, site.truth.occupied.shape, 1))

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
