"""Decisions of training: how many a second on one core, and whether any was ever one that could not be made.

    python benchmarks/decisions.py [DECISIONS] [CELL_M] [WORLD ...]

Slots are drawn at random among the used ones; an episode that is over gives way to a new one, as in `ppo`. Prints
decisions a second without compiling, slots chosen that were not used, and clusters that had no room. Ends with status 1
if a slot was chosen that was not used.
"""

import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.engine.backend import use_compilation_cache
from jexplore.learn.bank import prepare_bank
from jexplore.learn.brax_env import Lanes, Slots, unflat
from jexplore.policies.learned.networks import MASKED

LANES, PART = 4, 250  # steps of all lanes in one call


def main(arguments):
    total = int(arguments[0]) if arguments else 100_000
    cell_m = float(arguments[1]) if len(arguments) > 1 else 0.1
    worlds = arguments[2:] or ["rooms#1000:width_m=6,height_m=6", "maze#1000:width_m=6,height_m=6"]
    use_compilation_cache()
    from jexplore.learn.decisions import Decisions

    decisions = Decisions(prepare_bank(worlds, cell_m=cell_m), starts=16)
    env, slots = Lanes(decisions), Slots(decisions.n_choices)

    def choose(state, key):
        used = unflat(state.obs).used
        state = env.step(state, slots.sample(jnp.where(used, 0.0, MASKED), key))
        return state, [state.metrics["invalid"], state.done, state.metrics["overflow"]]

    @jax.jit
    def part(state, key):
        return jax.lax.scan(choose, state, jax.random.split(key, PART))

    state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), LANES))  # brax has legacy keys
    state = jax.block_until_ready(part(state, jax.random.key(1))[0])
    seconds, made, invalid, ended, overflow = 0.0, 0, 0, 0, 0
    while made < total:
        began = time.perf_counter()
        state, found = jax.block_until_ready(part(state, jax.random.key(2 + made)))
        seconds += time.perf_counter() - began
        made += PART * LANES
        bad, done, left_out = (np.asarray(a) for a in found)
        invalid, ended, overflow = invalid + int(bad.sum()), ended + int(done.sum()), max(overflow, int(left_out.max()))
    print(f"{made} decisions in {ended} episodes, {made / seconds:.0f} a second")
    print(f"{invalid} were of an unused slot; at most {overflow} clusters of an episode had no room")
    return int(invalid > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
