"""Measure the effect of choices that the paper leaves open: prominence, gamma.

    python benchmarks/segmentation_order.py MAP.png...

Maps at 0.05 m a pixel with ground truth next to them (`NAME_gt_segmentation.png`). One row a choice, all by `holz`.
"""

import os
import sys

import numpy as np

from jexplore import segment
from jexplore.bench.tables import markdown
from jexplore.rooms.scores import rooms_of, score, scored_regions
from jexplore.studies.room_variants import segmented
from jexplore.worlds.readers.images import load_image

CHOICES = {
    "as shipped (prominence 0.15 m)": {"prominence": 3.0},
    "any minimum (literal)": {"prominence": 0.0},
    "prominence 0.05 m": {"prominence": 1.0},
    "prominence 0.1 m": {"prominence": 2.0},
    "prominence 0.2 m": {"prominence": 4.0},
    "gamma 2 cells": {"prominence": 3.0, "gamma": 2.0},
    "gamma 8 cells": {"prominence": 3.0, "gamma": 8.0},
}


def main(paths):
    found = {name: [] for name in CHOICES}
    for path in paths:
        stem = os.path.splitext(path)[0].removesuffix("_furnitures")
        world, truth = load_image(path, 0.05, cell_m=0.05), load_image(f"{stem}_gt_segmentation.png", 0.05, cell_m=0.05)
        free, rooms = ~world.occupied, rooms_of(~truth.occupied & ~world.occupied)
        for name, numbers in CHOICES.items():
            made = segmented(free, segment.criteria("holz", **numbers))
            found[name].append(score(rooms, scored_regions(np.where(free, made.label, -1), free)))
    rows = []
    for name, scores in found.items():
        mcc = [s["mcc"] for s in scores]
        error = float(np.mean([s["room_count_error"] for s in scores]))
        rows.append([name, f"{np.mean(mcc):.3f}", f"{np.median(mcc):.3f}", f"{error:+.1f}"])
    print(markdown([f"{len(paths)} maps", "MCC mean", "median", "room error"], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
