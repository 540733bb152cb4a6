"""Measure the cost of a larger map with the same explored part: one episode in a world with growing padding.

    taskset -c 0 python benchmarks/map_size.py
    taskset -c 0 python benchmarks/map_size.py --worlds MAPS/stage/hospital.png@141.5x54 --cell-m 0.05 --sides 0

What beginning and ending take is that of an episode that ends after one step. Equal: whether all results of a world
and a strategy are, whatever the padding.
"""

import argparse
import functools
import statistics

import jax
import numpy as np

from jexplore.bench.engines import LIDAR, RULES, SEED, same
from jexplore.bench.tables import markdown
from jexplore.bench.timing import timed
from jexplore.engine import one_by_one
from jexplore.engine.backend import start_backend
from jexplore.exploration.site import line_of, prepare_site
from jexplore.studies.checks import ready_strategies, ready_worlds
from jexplore.worlds.starts import draw_starts


def episode(world, strategy, side, repeat):
    """Run episode 0 in a square of a side, or in the world's own padding for 0.

    Returns:
      its result, the padded shape, and processor ms of its first step with begin and end, and of the whole.
    """
    site = prepare_site(world, LIDAR, RULES, (side, side) if side else None)
    tasks = np.zeros((one_by_one.CHUNK, 3), np.int32)
    tasks[0] = draw_starts(world, SEED, 1, RULES.clearance_m)[0] // [1, 1, 45]
    line = line_of(site, site.with_strategy(strategy), tasks, SEED, np.arange(1))
    scenes, shared = jax.device_put((jax.tree.map(lambda a: a[None], line.scene), line.shared))
    call = jax.jit(functools.partial(one_by_one.chunk, line.program))
    draws, one, seed = np.zeros(one_by_one.CHUNK, np.int32), np.int32(1), np.uint32(SEED)
    first = line.numbers.replace(max_steps=np.int32(1))
    program = call.lower(draws, tasks, one, seed, scenes, shared, first).compile(dict(line.program.cpu_options))
    found, ms = None, []
    for numbers in (first, line.numbers):
        runs = [
            timed(lambda n=numbers: jax.block_until_ready(program(draws, tasks, one, seed, scenes, shared, n)))
            for _ in range(repeat)
        ]
        (found, _), _ = runs[0][0]
        ms.append(1e3 * statistics.median(took.cpu for _, took in runs))
    return jax.tree.map(lambda a: np.asarray(a)[:1], found), site.truth.occupied.shape, ms


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", default=["cave"])
    parser.add_argument("--strategies", nargs="+", default=["closest+recheck"])
    parser.add_argument("--cell-m", type=float, default=0.1)
    parser.add_argument("--sides", nargs="+", type=int, default=[0, 512, 1024, 2048], help="cells; 0: the world's own")
    parser.add_argument("--repeat", type=int, default=3)
    args = parser.parse_args()
    start_backend(1)
    rows = []
    for world in ready_worlds(args.worlds, args.cell_m):
        for strategy in ready_strategies(args.strategies):
            results = []
            for side in args.sides:
                result, shape, (first_ms, ms) = episode(world, strategy, side, args.repeat)
                results.append(result)
                scans, plans = int(result.scans[0]), int(result.plans[0])
                size = " x ".join(map(str, shape))
                rows.append(
                    [
                        world.name.rpartition("/")[2],
                        strategy.name,
                        size,
                        scans,
                        plans,
                        ms,
                        first_ms,
                        ms - first_ms,
                        same(results),
                    ]
                )
    print(
        markdown(["world", "strategy", "cells", "scans", "plans", "CPU ms", "start and end", "between", "equal"], rows)
    )


if __name__ == "__main__":
    main()
