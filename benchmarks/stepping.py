"""Measure the cost of a decision, step by step: `jx.Environment` under vmap, and compared with `jx.compare`.

    python benchmarks/stepping.py                       # 256 lanes of 64 x 64 rooms
    python benchmarks/stepping.py --lanes 64 --decisions 50 --worlds cave

The nearest frontier is chosen at every step, so that the episodes are those of `closest`. Compile time is apart;
figures are medians.
"""

import argparse
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

import jexplore as jx
from jexplore.bench.tables import markdown
from jexplore.worlds.starts import draw_starts


def nearest(view):
    cost = jnp.where(view.frontier, view.cost, jnp.iinfo(jnp.int32).max)
    return jnp.stack(jnp.unravel_index(jnp.argmin(cost), cost.shape))


def seconds(call, repeat):
    """Median seconds of a call that has been compiled."""
    jax.block_until_ready(call())
    took = []
    for _ in range(repeat):
        began = time.perf_counter()
        jax.block_until_ready(call())
        took.append(time.perf_counter() - began)
    return statistics.median(took)


def stepping(env, lanes, decisions, repeat):
    """Steps and scans a second under vmap and scan, lanes starting anew where they are done."""

    @jax.jit
    def run(key):
        def decide(carry, i):
            state, view = carry
            keys = jax.random.split(jax.random.fold_in(key, i), lanes)
            state, view, _, done, _ = jax.vmap(env.step)(keys, state, jax.vmap(nearest)(view))
            return (state, view), jnp.stack([jnp.sum(~done), jnp.sum(state.episode.scans)])

        return jax.lax.scan(decide, jax.vmap(env.reset)(jax.random.split(key, lanes)), jnp.arange(decisions))[1]

    key = jax.random.key(0)
    under_way, scans = np.asarray(run(key)).T
    return seconds(lambda: run(key), repeat), int(under_way.sum()), int(scans[-1])


def whole(env, repeat, episodes):
    """Seconds an episode of `closest` takes, driven by the environment; and by `compare` with one worker."""
    world = env.worlds[0]
    starts = jnp.asarray(draw_starts(world, 0, episodes, jx.Rules().clearance_m))
    keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.key(0), i))(jnp.arange(episodes))

    @jax.jit
    def run(key, start):
        def decide(carry):
            state, view = carry
            return env.step(key, state, nearest(view))[:2]

        carry = jax.lax.while_loop(lambda carry: carry[0].episode.outcome == 0, decide, env.reset(key, start))
        return carry[0].episode.straight

    ours, theirs = [], []
    jx.compare(world, "closest", episodes=episodes, workers=1)
    for _ in range(repeat):
        ours.append(seconds(lambda: [run(k, s) for k, s in zip(keys, starts)], 1) / episodes)
        theirs.append(jx.compare(world, "closest", episodes=episodes, workers=1).run_s / episodes)
    return statistics.median(ours), statistics.median(theirs)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", default=["rooms:width_m=6,height_m=6"])
    parser.add_argument("--lanes", type=int, default=256)
    parser.add_argument("--decisions", type=int, default=20)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=20)
    args = parser.parse_args()
    rows = []
    for name in args.worlds:
        env = jx.Environment(name)
        took, n, scans = stepping(env, args.lanes, args.decisions, args.repeat)
        ours, theirs = whole(env, args.repeat, args.episodes)
        cells = f"{env.shape[0]} x {env.shape[1]}"
        rows.append(
            [
                name,
                cells,
                args.lanes,
                n / took,
                scans / took,
                1e6 * took / scans,
                ours * 1e3,
                theirs * 1e3,
                ours / theirs,
            ]
        )
    head = ["world", "cells", "lanes", "steps/s", "scans/s", "µs a scan", "ms an episode", "by compare", "ratio"]
    print(markdown(head, rows))


if __name__ == "__main__":
    main()
