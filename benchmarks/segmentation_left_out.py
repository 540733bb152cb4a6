"""Rooms on maps that no setting was chosen on: leave one building out, plain and furnished together.

    python benchmarks/segmentation_left_out.py [--own N] FOLDER

FOLDER has maps as NAME.png, furnished as NAME_furnitures.png, and the true rooms as NAME_gt_segmentation.png, at 0.05 m
a pixel (Bormann et al. 2016). Buildings are these and N furnished worlds of the package's own generators, with plain
twins (#5000 and on, of three kinds each; 0 leaves them out). For each building a variant's settings are those with the
best mean MCC on all others; the scores of the building by them are what counts. Prints every setting's mean (the curve)
and, by building, the settings chosen and the scores, then means.
"""

import argparse
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jexplore.bench.tables import markdown
from jexplore.config import InputError
from jexplore.engine.backend import use_compilation_cache
from jexplore.rooms.scores import rooms_of, score, scored_regions
from jexplore.studies.room_variants import RoomSettings, divided
from jexplore.worlds import load_world

CELL_M = 0.05
LEAST_PX = 100
FIRST = 5000
KINDS = ("office", "hospital", "rooms")
FURNISHED = "furniture=1,wide_openings=0.1,max_loops=5"
GRIDS = {
    "voronoi": {"ratio": (0.65, 0.7, 0.75, 0.8), "smallest_m2": (1.0, 2.0, 3.0), "clutter_m": (0.7, 1.0, 1.4)},
    "distance": {"clutter_m": (0.7, 1.0, 1.4)},
    "morphological": {"clutter_m": (0.7, 1.0, 1.4)},
    "maoris": {"clutter_m": (0.7, 1.0, 1.4)},  # its rules were chosen on the real buildings: no left-out scores there
    "holz": {"prominence_m": (0.1, 0.15, 0.2), "gamma": (3.0, 5.0, 8.0)},
}


class Map(NamedTuple):
    """A map with its true rooms."""

    building: str
    is_furnished: bool
    free: np.ndarray
    truth: np.ndarray


def maps_of(folder: Path, own: int) -> Iterator[Map]:
    """All maps."""
    for path in sorted(folder.glob("*_gt_segmentation.png")):
        name = path.name.removesuffix("_gt_segmentation.png")
        closed = ~load_world(f"{path}@{CELL_M}", cell_m=CELL_M).occupied
        for more in ("", "_furnitures"):
            free = ~load_world(f"{folder / name}{more}.png@{CELL_M}", cell_m=CELL_M).occupied
            if free.shape != closed.shape:
                raise InputError(f"{path}: must be as large as {name}{more}.png")
            yield Map(name, bool(more), free, rooms_of(closed, min_px=LEAST_PX))
    for seed in range(FIRST, FIRST + own):
        kind = KINDS[seed % len(KINDS)]
        for is_furnished in (False, True):
            world = load_world(f"{kind}#{seed}" + f":{FURNISHED}" * is_furnished, cell_m=CELL_M)
            yield Map(f"{kind}#{seed}", is_furnished, ~world.occupied, world.rooms)


def judged(one: Map, variant: str, settings: RoomSettings) -> tuple[float, int]:
    """MCC and room count error."""
    (found,) = divided(one.free, np.zeros_like(one.free), [variant], settings, CELL_M)
    scores = score(one.truth, scored_regions(np.where(one.free, found.label, -1), one.free, min_px=LEAST_PX))
    return scores["mcc"], int(scores["room_count_error"])


def left_out(maps: list[Map], variant: str) -> list[list[str]]:
    """Prints curve and choices of a variant; returns its line of the last table."""
    grid = GRIDS[variant]
    settings = [RoomSettings(**dict(zip(grid, values))) for values in itertools.product(*grid.values())]
    # [settings, maps, 2]
    scores = np.array([[judged(one, variant, setting) for one in maps] for setting in settings], float)
    building, is_furnished = np.array([one.building for one in maps]), np.array([one.is_furnished for one in maps])
    is_own = np.array(["#" in name for name in building])
    groups = [("real, plain", ~is_own & ~is_furnished), ("real, furnished", ~is_own & is_furnished)]
    groups += [("own, plain", is_own & ~is_furnished), ("own, furnished", is_own & is_furnished)]
    groups = [(name, mask) for name, mask in groups if mask.any()]
    print(f"## {variant}\n\nMean MCC by setting:\n")
    rows = [
        [*(f"{getattr(setting, key):g}" for key in grid), *(f"{own[mask, 0].mean():.3f}" for _, mask in groups)]
        for setting, own in zip(settings, scores)
    ]
    print(markdown([*grid, *(name for name, _ in groups)], rows), "\n")
    chosen, rows = np.zeros((len(maps), 2)), []
    for name in dict.fromkeys(building):
        own = building == name
        best = int(np.argmax(scores[:, ~own, 0].mean(axis=1)))
        chosen[own] = scores[best, own]
        by = ", ".join(f"{key} {getattr(settings[best], key):g}" for key in grid)
        rows.append([name, by, *(f"{mcc:.3f} ({error:+.0f})" for mcc, error in chosen[own])])
    print("Left out, MCC and room count error:\n")
    print(markdown(["building", "chosen on all others", "plain", "furnished"], rows), "\n", flush=True)
    return [
        [
            *(variant, name, str(mask.sum())),
            *(f"{f(chosen[mask, 0]):.3f}" for f in (np.mean, np.median, np.min)),
            f"{np.abs(chosen[mask, 1]).mean():.1f}",
        ]
        for name, mask in groups
    ]


def main() -> None:
    """Prints all tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--own", type=int, default=6, metavar="N")
    options = parser.parse_args()
    use_compilation_cache()
    maps = list(maps_of(options.folder, options.own))
    rows = [row for variant in GRIDS for row in left_out(maps, variant)]
    print("## Left-out scores\n")
    print(markdown(["variant", "maps", "n", "MCC mean", "median", "least", "room count error"], rows))


if __name__ == "__main__":
    main()
