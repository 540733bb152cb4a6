"""Processor time of `jx.next_target` on a grid of 1,000 x 1,000 cells, half known, after compiling.

    python benchmarks/next_target.py

Once with the robot in the middle of the known part, as far from every frontier as can be, and once at its edge.
"""

import statistics
import time

import numpy as np

import jexplore as jx
from jexplore.grid import centre_of

NAMES = "closest", "random", "small-first", "distance-advantage", "utility", "tour", "learned", "decision-theoretic"
CELL_M = 0.1
TIMES = 20  # calls of each, of which the median counts


def half_known(name: str):
    """Return the grid of a world known within the half nearest to its middle, and poses there and at the edge."""
    walls = jx.load_world(name, cell_m=CELL_M).occupied
    rows, cols = np.indices(walls.shape)
    off = np.hypot(rows - walls.shape[0] // 2, cols - walls.shape[1] // 2)
    known = off < np.median(off)
    free = np.argwhere(~walls & known)
    far = off[tuple(free.T)]
    poses = [(*centre_of(*free[i], cell_m=CELL_M), 0.0) for i in (np.argmin(far), np.argmax(far))]
    return np.where(known, 100 * walls, -1).astype(np.int8), poses


def main() -> None:
    """Print a table."""
    print("| strategy | office, middle, ms | edge | cave, middle | edge |\n| --- | ---: | ---: | ---: | ---: |")
    worlds = [half_known(f"{kind}#1:width_m=100,height_m=100") for kind in ("office", "cave")]
    for name in NAMES:
        strategy, row = jx.strategy(name), [name]
        for grid, pose in [(grid, pose) for grid, poses in worlds for pose in poses]:
            times = []
            for _ in range(TIMES + 1):
                began = time.process_time()
                jx.next_target(grid, pose, cell_m=CELL_M, strategy=strategy)
                times.append(time.process_time() - began)
            row.append(f"{1000 * statistics.median(times[1:]):.1f}")
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
