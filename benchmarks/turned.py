"""Measure the change of a mean path when the map is turned or mirrored: the effect of ties decided by position.

    python benchmarks/turned.py [--worlds W...] [--strategies S...] [--episodes 50]

The same episodes in all eight positions of a map, from the same starts, turned with it. Nothing but the order in which
equal paths and equal targets are tried differs.
"""

import argparse

import numpy as np

from jexplore import Lidar, Rules
from jexplore.bench.tables import markdown
from jexplore.engine.backend import use_compilation_cache
from jexplore.exploration import batch
from jexplore.exploration.results import path_m
from jexplore.policies import parse_strategy
from jexplore.worlds import load_world
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World


def turned(world, starts, quarters, mirrored):
    """A world and starts, turned counter-clockwise by quarters after mirroring left to right: `(World, [N, 3])`."""
    occupied = world.occupied[:, ::-1] if mirrored else world.occupied
    row, col, heading = starts.T
    if mirrored:
        col, heading = world.shape[1] - 1 - col, 180 - heading
    for _ in range(quarters):  # row 0 is the bottom: a quarter turn takes (row, col) to (col, height - 1 - row)
        occupied, (row, col), heading = occupied.T[:, ::-1], (col, occupied.shape[0] - 1 - row), heading + 90
    world = World(occupied=occupied.copy(), cell_m=world.cell_m, name=f"{world.name} {quarters} {mirrored}")
    return world, np.stack([row, col, heading % 360], axis=1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", default=["cave", "office", "rooms"])
    parser.add_argument("--strategies", nargs="+", default=["closest", "closest+recheck"])
    parser.add_argument("--episodes", type=int, default=50)
    given = parser.parse_args()
    use_compilation_cache()
    lidar, rules, rows = Lidar(), Rules(), []
    strategies = [parse_strategy(name) for name in given.strategies]
    for name in given.worlds:
        world = load_world(name)
        starts = draw_starts(world, 0, given.episodes, rules.clearance_m)
        placed = [turned(world, starts, quarters, mirrored) for quarters in range(4) for mirrored in (False, True)]
        jobs = [batch.Job(*pair[:1], strategy, pair[1]) for strategy in strategies for pair in placed]
        found = [outcomes.result for outcomes in batch.run_jobs(jobs, lidar, rules).outcomes]
        means = np.array([path_m(one.straight, one.diagonal, world.cell_m).mean() for one in found])
        for strategy, eight in zip(strategies, means.reshape(-1, 8)):
            off = 100 * (eight / eight.mean() - 1)
            rows.append([name, strategy.name, f"{eight.mean():.2f}", f"{off.min():+.1f} to {off.max():+.1f} %"])
    print(markdown(["world", "strategy", "mean path m", "in the eight positions of the map"], rows))


if __name__ == "__main__":
    main()
