"""Rooms on maps that no setting was chosen on: leave one building out, plain and furnished together.

    python benchmarks/segmentation_left_out.py [--own N] [--rows N] [--variants NAME...] FOLDER

FOLDER has maps as NAME.png, furnished as NAME_furnitures.png, and the true rooms as NAME_gt_segmentation.png, at 0.05 m
a pixel (Bormann et al. 2016). Buildings are these and N furnished worlds of the package's own generators, with plain
twins (#5000 and on, of three kinds each; 0 leaves them out), and N plans of small rooms that face each other across a
corridor narrower than they are, through doors of 0.55 to 0.9 of their width. For each building a variant's settings
are those with the best mean MCC on all others; the scores of the building by them are what counts. Prints every
setting's mean (the curve) and, by building, the settings chosen and the scores, then means.
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
    "voronoi": {"ratio": (0.65, 0.7, 0.75, 0.8), "narrowing": (0.0, 0.85, 0.9), "clutter_m": (0.7, 1.0, 1.4)},
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


def facing_rows(seed: int) -> Map:
    """Two rows of eight rooms, each as wide as the others but for a tenth, and the corridor between them."""
    rng = np.random.default_rng(seed)
    width_m, wall_m, share = rng.uniform(1.7, 2.8), rng.uniform(0.1, 0.25), rng.uniform(0.55, 0.9)
    widths = np.rint(width_m * (1 + 0.1 * rng.uniform(-1, 1, 8)) / CELL_M).astype(int)
    wall, corridor = round(wall_m / CELL_M), round(rng.uniform(1.2, 0.95 * width_m) / CELL_M)
    heights = np.rint(rng.uniform(2.0, 4.5, 2) / CELL_M).astype(int)
    tops = np.cumsum([wall, heights[0], wall, corridor, wall, heights[1]])
    free = np.zeros((tops[-1] + wall, widths.sum() + 9 * wall), bool)
    free[tops[2] : tops[3], wall:-wall] = True
    closed = free.copy()
    lefts = wall + np.concatenate([[0], np.cumsum(widths + wall)[:-1]])
    for row, doorway in (((tops[0], tops[1]), (tops[1], tops[2])), ((tops[4], tops[5]), (tops[3], tops[4]))):
        for left, width in zip(lefts, widths):
            free[slice(*row), left : left + width] = closed[slice(*row), left : left + width] = True
            door = round(share * width)
            begin = left + int(rng.integers(0, width - door + 1))
            free[slice(*doorway), begin : begin + door] = True
    return Map(f"rows#{seed}", False, free, rooms_of(closed, min_px=LEAST_PX))


def maps_of(folder: Path, own: int, rows: int = 0) -> Iterator[Map]:
    """All maps."""
    yield from map(facing_rows, range(rows))
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
    found = divided(one.free, np.zeros_like(one.free), variant, settings, CELL_M)
    scores = score(one.truth, scored_regions(np.where(one.free, found.label, -1), one.free, min_px=LEAST_PX))
    return scores["mcc"], int(scores["room_count_error"])


def left_out(maps: list[Map], variant: str) -> list[list[str]]:
    """Prints curve and choices of a variant; returns its line of the last table."""
    grid = GRIDS[variant]
    settings = [RoomSettings(**dict(zip(grid, values))) for values in itertools.product(*grid.values())]
    # [settings, maps, 2]
    scores = np.array([[judged(one, variant, setting) for one in maps] for setting in settings], float)
    building, is_furnished = np.array([one.building for one in maps]), np.array([one.is_furnished for one in maps])
    is_rows = np.array([name.startswith("rows#") for name in building])
    is_own = np.array(["#" in name for name in building]) & ~is_rows
    is_real = ~is_own & ~is_rows
    groups = [("real, plain", is_real & ~is_furnished), ("real, furnished", is_real & is_furnished)]
    groups += [("own, plain", is_own & ~is_furnished), ("own, furnished", is_own & is_furnished)]
    groups += [("facing rows", is_rows)]
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
        judgements = [f"{mcc:.3f} ({error:+.0f})" for mcc, error in chosen[own]]
        rows.append([name, by, *judgements, *["-"] * (2 - len(judgements))])
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
    parser.add_argument("--rows", type=int, default=3, metavar="N")
    parser.add_argument("--variants", nargs="+", choices=GRIDS, default=list(GRIDS), metavar="NAME")
    options = parser.parse_args()
    use_compilation_cache()
    maps = list(maps_of(options.folder, options.own, options.rows))
    rows = [row for variant in options.variants for row in left_out(maps, variant)]
    print("## Left-out scores\n")
    print(markdown(["variant", "maps", "n", "MCC mean", "median", "least", "room count error"], rows))


if __name__ == "__main__":
    main()
