"""Does it pay to explore room by room if the robot knows the true rooms? `closest+recheck` with and without.

    python benchmarks/true_rooms.py [EPISODES]

Frontier cells in the robot's own true room come first: in every labelled region, corridors and halls included, or only
in rooms up to 35 m^2. Built-in worlds, which know their rooms.
"""

import sys

import numpy as np

from jexplore import Lidar, Robot, Rules
from jexplore.arrays.loops import run_if
from jexplore.arrays.padding import bucket
from jexplore.bench.tables import markdown
from jexplore.engine.backend import use_compilation_cache
from jexplore.exploration import batch
from jexplore.exploration.results import columns
from jexplore.policies import Strategy, parse_strategy
from jexplore.policies.policy import Policy
from jexplore.report.tables import ratio_text
from jexplore.studies.statistics.paired import paired_ratio
from jexplore.worlds import load_world
from jexplore.worlds.starts import draw_starts

WORLDS = ("hospital", "office")
LARGEST_M2 = 35.0
CLOSEST = parse_strategy("closest+recheck")


def _select(key, params, carry, belief, beams, route):
    inner = CLOSEST.policy.select
    own = params[belief.row, belief.col]
    inside = belief.replace(exhausted=belief.exhausted | ((params != own) & (own >= 0)))
    found = inner(key, (), carry, inside, beams, route)
    return run_if(found[1].row < 0, lambda found: inner(key, (), carry, belief, beams, found[2]), found)


def with_rooms(name, world, rooms):
    """`closest+recheck` that prefers its own of some rooms: `[H, W]` int32, -1 where there is no preference."""
    height, width = world.shape
    padded = np.full((bucket(height), bucket(width)), -1, np.int32)
    padded[:height, :width] = rooms
    return Strategy(name, Policy(CLOSEST.policy.init, _select, padded), True)


def main(arguments):
    episodes, rows = int(arguments[0]) if arguments else 20, []
    use_compilation_cache()
    for name in WORLDS:
        world = load_world(name)
        sizes = np.bincount(world.rooms[world.rooms >= 0])
        small = np.append(sizes * world.cell_m**2 <= LARGEST_M2, False)[world.rooms]
        starts = draw_starts(world, 0, episodes, Rules().clearance_m)
        strategies = [
            CLOSEST,
            with_rooms("all", world, world.rooms),
            with_rooms("small", world, np.where(small, world.rooms, -1)),
        ]
        jobs = [batch.Job(world, strategy, starts, 0) for strategy in strategies]
        report = batch.run_jobs(jobs, Lidar(), Rules())
        paths, entries = [], []
        for result, *_ in report.outcomes:
            table = columns(result, starts, seed=0, cell_m=world.cell_m, has_rooms=True, robot=Robot())
            paths.append(table["path_m"])
            entries.append(f"{np.mean(table['room_entries']):.1f}")
        ratios = [paired_ratio(path, paths[0]) for path in paths[1:]]
        rows.append([name, *(ratio_text(r.ratio, r.low, r.high) for r in ratios), " / ".join(entries)])
    head = [
        "world",
        "own true room first",
        f"only in rooms up to {LARGEST_M2:g} m²",
        "room entries: none / all / small",
    ]
    print(markdown(head, rows))


if __name__ == "__main__":
    main(sys.argv[1:])
