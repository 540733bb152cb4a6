"""Study behind `jexplore segment`: quality of found rooms, by variant and known share of the map."""

import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jexplore.config import InputError, checked_names, require_different, unknown
from jexplore.exploration.results import FREE, UNKNOWN
from jexplore.report.tables import aligned_table
from jexplore.rooms.doors import Doors, compared
from jexplore.rooms.scores import AGREEMENT, rooms_of, score, scored_regions
from jexplore.studies.checks import LIDAR, RULES, list_of, ready_worlds
from jexplore.studies.explore import maps_at, prepare_job, run_job
from jexplore.studies.room_variants import BEST, ROOM_VARIANTS, RoomSettings, divided
from jexplore.worlds import known_generators, names
from jexplore.worlds.names import short_names
from jexplore.worlds.readers.images import load_image, read_pixels
from jexplore.worlds.regions import warn_of_outside
from jexplore.worlds.starts import start_region
from jexplore.worlds.world import World

MIN_SCORED_M2 = 0.25  # regions up to this area are not scored: 100 pixels of 0.05 m
SHARES = (0.25, 0.5, 0.75)  # of the cells known in the end, at which partial maps are taken
EXPLORER = "closest+recheck"  # the strategy of the episodes that partial maps come from
COUNTS = ("rooms", "rooms_truth", "room_count_error", "doors", "doors_missed", "doors_extra", "overflow")
MOST_ROOMS = 10_000  # of a ground truth
SCORE_COLUMNS = (
    *("map", "variant", "stage", "explored", *AGREEMENT, "rooms", "rooms_truth", "room_count_error"),
    *("variation_of_information", "doors", "doors_missed", "doors_extra", "overflow"),
)


class Picture(NamedTuple):
    """Segmentation of a map by a variant."""

    name: str  # of the map, as short as tells it from the others
    variant: str
    explored: float  # known share of the map; 1: the whole map
    label: np.ndarray  # [H, W] int32
    free: np.ndarray  # [H, W] bool
    lines: np.ndarray  # [n] int, flat index of the cells of the Voronoi graph
    critical: np.ndarray  # [m] int, flat index of the critical points
    doors: Doors
    cell_m: float


@checked_names
class SegmentationResult(NamedTuple):
    """Scores and pictures of segmentations."""

    scores: pd.DataFrame
    """One row a map, variant and share, columns `SCORE_COLUMNS`; NaN where the true rooms are not known."""
    pictures: list[Picture]

    def to_markdown(self) -> str:
        """Format a table for every share of the map and every variant: all scores, their means and medians."""
        text = []
        groups: Any = self.scores.groupby(["stage", "variant"], sort=False)
        for (stage, variant), rows in groups:
            shown = rows.drop(columns=["variant", "stage"]).set_index("map")
            whole = [name in COUNTS for name in shown.columns]
            shown = shown.rename(columns={"variation_of_information": "VI bits", "room_count_error": "room error"})
            lines = [[name, *map(_text, row, whole)] for name, row in zip(short_names(shown.index), shown.to_numpy())]
            if len(shown) > 1:
                lines += [[name, *map(_text, getattr(shown, name)(), whole)] for name in ("mean", "median")]
            table = aligned_table(["map", *(name.replace("_", " ") for name in shown.columns)], lines, left=["map"])
            text.append(f"### {variant}, {stage:.0%} of the map\n\n{table}")
        return "\n".join(text)


def _text(value, whole):
    value = float(value)
    return "-" if np.isnan(value) else f"{value:.0f}" if whole and value.is_integer() else f"{value:.3f}"


ROOM_DEFAULTS = RoomSettings()


@checked_names
def segment_maps(
    maps: str | os.PathLike[str] | World | Iterable[str | os.PathLike[str] | World], *,
    truth: str | Sequence[str] | None = None, variants: str | Sequence[str] = BEST, partial: bool = False,
    cell_m: float = 0.05, seed: int = 0, on_progress: Callable[[int], Any] | None = None,
    ratio: float = ROOM_DEFAULTS.ratio, narrowing: float = ROOM_DEFAULTS.narrowing,
    smallest_m2: float = ROOM_DEFAULTS.smallest_m2, clutter_m: float = ROOM_DEFAULTS.clutter_m,
    prominence_m: float = ROOM_DEFAULTS.prominence_m, gamma: float = ROOM_DEFAULTS.gamma,
) -> SegmentationResult:  # fmt: skip
    """Divide maps into rooms and score the result.

    Args:
      maps: names (`worlds.load_world`) or `World`s; one may stand for itself.
      truth: pictures with the true rooms, in the order of the maps: as the map, with doorways closed by lines. By
        default worlds that know their rooms are scored by them.
      variants: names in `room_variants.ROOM_VARIANTS`: voronoi, distance, morphological, maoris, thrun, wurm, holz. By
        default the one with the best scores on maps that it was not chosen on.
      partial: also segment the maps that a robot has when it first knows 25, 50 and 75 % of what it will know. Stages
        that it has passed with its very first scans are left out.
      cell_m: edge of a cell of the worlds that are loaded by name, metres.
      seed: of the start of the episodes that partial maps come from.
      on_progress: called with the number of maps, partial ones included, that are done.
      ratio, narrowing, smallest_m2, clutter_m: of voronoi, the last also of distance, morphological and maoris; see
        `room_variants.RoomSettings`.
      prominence_m, gamma: of thrun, wurm, holz.

    Raises:
      InputWarning: the largest region of a map lies outside a building: its rooms are not those of the building.
    """
    chosen: Any = list_of("variants", variants)
    numbers = RoomSettings(ratio, narrowing, smallest_m2, clutter_m, prominence_m, gamma)
    worlds = prepare_maps(maps, truth, chosen, cell_m)
    jobs = [
        prepare_job(world, EXPLORER, seed=seed, cell_m=cell_m, start="random", lidar=LIDAR, rules=RULES)
        for world in worlds
        if partial
    ]
    rows, pictures, done = [], [], 0
    short = short_names([os.fspath(world.name) for world in worlds])
    for i, world in enumerate(worlds):
        for stage, explored, free, unseen in _stages(world, jobs[i] if partial else None):
            for variant in chosen:
                made = divided(free, unseen, variant, numbers, world.cell_m)
                row, picture = _judged(world, variant, stage, explored, free, made)
                rows.append(row)
                pictures.append(picture._replace(name=short[i]))
            done += 1
            if on_progress is not None:
                on_progress(done)
    return SegmentationResult(pd.DataFrame(rows, columns=list(SCORE_COLUMNS)), pictures)


def _stages(world, job):
    """Return the maps to be segmented, `(stage, explored, free, unseen)`: with a job partial ones, then the whole."""
    partial = () if job is None else maps_at(run_job(job), SHARES)
    whole = 1.0, 1.0, ~world.occupied, np.zeros_like(world.occupied)
    return [*((*shares, state == FREE, state == UNKNOWN) for *shares, state in partial), whole]


def prepare_maps(
    maps: str | os.PathLike[str] | World | Iterable[str | os.PathLike[str] | World], truth: Any, variants: Any,
    cell_m: float,
) -> list[World]:  # fmt: skip
    """Check and load everything before `segment_maps` runs: worlds with their true rooms. Arguments as there."""
    variants = list_of("variants", variants)
    require_different("variants", variants)
    for variant in variants:
        if variant not in ROOM_VARIANTS:
            raise unknown("variant", variant, ROOM_VARIANTS)
    worlds = ready_worlds(maps, cell_m)
    for world in worlds:
        warn_of_outside(world, start_region(world, RULES.clearance_m))
    if truth is None:
        return worlds
    truth = list_of("truth", truth)
    if len(truth) != len(worlds):
        raise InputError(f"expected ground truth for each of {len(worlds)} maps, got {len(truth)}")
    return [world.replace(rooms=_rooms_in(picture, world)) for world, picture in zip(worlds, truth)]


def _rooms_in(picture, world):
    """Return the true rooms of a world from its picture with closed doorways: `[H, W]` int32."""
    parsed = names.parse_name(os.fspath(world.name), generators=known_generators())
    if parsed.kind != "image" or not isinstance(parsed.scale, float | int):
        raise InputError(f"{world.name!r}: ground truth is for maps such as map.png@0.05, metres a pixel")
    sizes = [read_pixels(path).shape[1::-1] for path in (picture, parsed.base)]
    if sizes[0] != sizes[1]:
        (w, h), (width, height) = sizes
        raise InputError(f"{picture!r}: must be as large as {parsed.base!r}, {width} x {height} pixels, got {w} x {h}")
    free: Any = parsed.parameters.get("free", 250)
    closed = load_image(picture, parsed.scale, cell_m=world.cell_m, free=free).occupied
    found = rooms_of(~closed & ~world.occupied, min_px=_smallest_px(world.cell_m))
    count = int(found.max(initial=-1)) + 1
    if not 0 < count <= MOST_ROOMS:
        raise InputError(f"{picture!r}: must have 1 to {MOST_ROOMS} rooms of more than {MIN_SCORED_M2} m2, got {count}")
    return found


def _smallest_px(cell_m):
    return round(MIN_SCORED_M2 / cell_m**2)


def _judged(world, variant, stage, explored, free, made):
    """Return a row of scores, and a picture."""
    row: dict[str, Any] = dict.fromkeys(SCORE_COLUMNS, np.nan)
    least = _smallest_px(world.cell_m)
    found = scored_regions(np.where(free, made.label, -1), free, min_px=least)
    row |= {"map": os.fspath(world.name), "variant": variant, "rooms": found.max() + 1}
    row |= {"stage": stage, "explored": explored}
    seen = None
    if world.rooms is not None:
        # In a partial map only known cells count, on both sides.
        seen = np.where(free | (explored == 1), world.rooms, -1)
        sizes = np.bincount(seen[seen >= 0], minlength=1)
        seen = np.where((seen >= 0) & (sizes[np.maximum(seen, 0)] > least), seen, -1)
        row |= score(seen, found)
    doors = compared(seen, found, free, world.cell_m)
    row |= {"doors": doors.touching, "overflow": made.overflow}
    if seen is not None:
        row |= {"doors_missed": len(doors.missed), "doors_extra": len(doors.extra)}
    picture = Picture(row["map"], variant, explored, found, free, made.lines, made.critical, doors, world.cell_m)
    return row, picture
