"""Two plain room segmentations, scored against ground truth: what a new method has to beat.

    python benchmarks/segmentation_baselines.py MAP.png...

Written anew after the ideas in Bormann et al. 2016, "Room Segmentation: Survey, Implementation, and Analysis", so the
figures are near the published ones, not equal to them. Maps are pictures at 0.05 m a pixel, free where the grey is 250
or more. The ground truth lies beside a map, as NAME_gt_segmentation.png for NAME.png and NAME_furnitures.png: the same
picture with lines across the doorways.
"""

import argparse
import statistics
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage
from skimage.segmentation import watershed

from jexplore.config import InputError
from jexplore.studies.room_scores import regions_of, rooms_of, score

CELL_M = 0.05
FREE_GREY = 250
DISTANCE_MIN_M2 = 0.35  # of a seed; the limit in the authors' published settings
MORPHOLOGICAL_M2 = (0.8, 47.0)  # of a seed; likewise
LEVEL_STEP_PX = 0.5

COLUMNS = {
    "MCC": "mcc",
    "P room": "precision_room",
    "R room": "recall_room",
    "P pixel": "precision_pixel",
    "R pixel": "recall_pixel",
    "IoU s->g": "iou_predicted",
    "IoU g->s": "iou_truth",
    "VI bits": "variation_of_information",
}


def load_free(path):
    """`[H, W]` bool, the free pixels of a picture."""
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("L")) >= FREE_GREY
    except OSError as error:
        raise InputError(f"{path}: must be a picture ({error})") from None


def truth_path(path):
    """Where the ground truth of a map lies."""
    return path.with_name(path.stem.removesuffix("_furnitures") + "_gt_segmentation.png")


def grown(seeds, free):
    """Every free pixel takes the label of the seed nearest by steps to the four neighbours; -1 where none gets to."""
    return watershed(np.zeros(free.shape, np.uint8), seeds, mask=free, connectivity=1) - 1


def drained(seeds, free):
    """Like `grown`, but by a flood from the middle of the rooms outward, so that labels meet in the narrow places."""
    clearance = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    return watershed(-clearance, seeds, mask=free, connectivity=1) - 1


def distance_seeds(free):
    """The pixels whose clearance is above the level that gives the most components of at least `DISTANCE_MIN_M2`.

    Ties go to the lowest level, which has the largest seeds.
    """
    clearance = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    most, best = 0, np.zeros(free.shape, np.int32)
    for level in np.arange(0.0, clearance.max(initial=0.0), LEVEL_STEP_PX):
        parts, n = ndimage.label(clearance > level)
        large = np.bincount(parts.ravel(), minlength=n + 1) * CELL_M**2 >= DISTANCE_MIN_M2
        large[0] = False
        if large.sum() > most:
            most, best = large.sum(), np.where(large[parts], parts, 0)
    return best


def morphological_seeds(free):
    """Erodes by a square of 3 pixels; a component whose area comes within `MORPHOLOGICAL_M2` is set aside as a seed."""
    seeds, left = np.zeros(free.shape, np.int32), free.copy()
    while left.any():
        parts, n = ndimage.label(left)
        area_m2 = np.bincount(parts.ravel(), minlength=n + 1) * CELL_M**2
        room = (area_m2 >= MORPHOLOGICAL_M2[0]) & (area_m2 <= MORPHOLOGICAL_M2[1])
        room[0] = False
        found = room[parts]
        seeds[found] = parts[found] + seeds.max()
        left = ndimage.binary_erosion(left & ~found, np.ones((3, 3), bool))
    return seeds


METHODS = {"distance transform": distance_seeds, "morphological": morphological_seeds}
SPREADS = {"grow": grown, "drain": drained}


def table(rows):
    """A Markdown table of `(name, scores)` with rows for mean and median."""
    lines = [["map", "rooms / truth", *COLUMNS], ["---"] + ["---:"] * (len(COLUMNS) + 1)]
    for name, scores in rows:
        counts = f"{scores['rooms']} / {scores['rooms_truth']}"
        lines.append([name, counts, *(f"{scores[key]:.3f}" for key in COLUMNS.values())])
    for name, middle in (("mean", statistics.mean), ("median", statistics.median)):
        of = {key: middle([scores[key] for _, scores in rows]) for key in ("rooms", "rooms_truth", *COLUMNS.values())}
        counts = f"{of['rooms']:.1f} / {of['rooms_truth']:.1f}"
        lines.append([name, counts, *(f"{of[key]:.3f}" for key in COLUMNS.values())])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main():
    """Scores both methods on every map and prints a table a method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", nargs="+", type=Path, metavar="MAP.png")
    parser.add_argument(
        "--spread",
        choices=SPREADS,
        default="grow",
        help="how seeds take the rest: by steps, as the authors do, or by clearance",
    )
    options = parser.parse_args()
    maps = [(path.stem, load_free(path), rooms_of(load_free(truth_path(path)))) for path in options.maps]
    for method, seeds_of in METHODS.items():
        rows = []
        for name, free, truth in maps:
            labels = SPREADS[options.spread](seeds_of(free), free)
            try:
                rows.append((name, score(truth, regions_of(labels, free))))
            except InputError as error:
                raise InputError(f"{name}: {error}") from None
        print(f"{method} ({options.spread}):\n\n{table(rows)}\n")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(f"{Path(sys.argv[0]).name}: error: {error}", file=sys.stderr)
        sys.exit(2)
