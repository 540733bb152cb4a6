"""Robots without a clearance: which targets never show anything, and what that does to an ordering.

    python benchmarks/point_robots.py MAPS [--maps 100]

MAPS is a folder with the pictures of DARE's test maps (marmotlab/DARE, `maps_test`), 0.2 m a pixel, here in cells of
0.4 m, with its scanner: 20 m, 360 degrees, 720 beams.
"""

import argparse
import itertools

import numpy as np
from scipy import ndimage

import jexplore as jx

LIDAR = jx.Lidar(n_beams=720, fov_deg=360, range_m=20)
STRATEGIES = "closest+recheck", "tour+recheck"
CROSS = ndimage.generate_binary_structure(2, 1)


def left_over(world: jx.World, seen: np.ndarray) -> tuple[int, int, int]:
    """Count the free cells that touch an unknown one in the end, those across a corner alone, and walls among these.

    `seen`: `[H, W]` uint8, 0 unknown, 1 free, 2 occupied.
    """
    free, unknown = seen == 1, seen == 0
    touching = free & ndimage.binary_dilation(unknown, np.ones((3, 3)))
    across = touching & ~ndimage.binary_dilation(unknown, CROSS)
    hidden = unknown & world.occupied  # these hide all that such a cell touches
    walled = across & ~ndimage.binary_dilation(unknown & ~hidden, np.ones((3, 3)))
    return int(touching.sum()), int(across.sum()), int(walled.sum())


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder")
    parser.add_argument("--maps", type=int, default=100)
    given = parser.parse_args()
    worlds = [
        jx.load_world(f"{given.folder}/{number}.png@0.2:free=151", cell_m=0.4) for number in range(1, given.maps + 1)
    ]
    print("| connectivity | stop at | path, m | exhausted | touch unknown | across a corner | walls | tour / closest |")
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for connectivity, stop_at in itertools.product((8, 4), (None, 0.99)):
        rules = jx.Rules(clearance_m=0, near_m=0, frontier_connectivity=connectivity, stop_at=stop_at)
        found = jx.compare(worlds, STRATEGIES, episodes=1, lidar=LIDAR, rules=rules, cell_m=0.4, keep="maps")
        closest = found.episodes[found.episodes["strategy"] == STRATEGIES[0]]
        maps = [found.maps[world.name, STRATEGIES[0]][0] for world in worlds]
        counts = np.mean([left_over(world, seen) for world, seen in zip(worlds, maps)], axis=0)
        ratio = found.standings.set_index("strategy").loc[STRATEGIES[1], ["ratio", "ratio_low", "ratio_high"]]
        row = [connectivity, stop_at or "-", f"{closest['path_m'].mean():.0f}", f"{closest['exhausted'].mean():.1f}"]
        row += [f"{count:.1f}" for count in counts]
        print("|", " | ".join(map(str, row)), "| {:.3f} [{:.3f}, {:.3f}] |".format(*ratio), flush=True)


if __name__ == "__main__":
    main()
