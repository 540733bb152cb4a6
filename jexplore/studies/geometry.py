"""Geometry of a building for `jexplore worlds --geometry`: its kind, and its amount of furniture.

- An obstacle is an 8-connected component of occupied cells; its length is the longer side of its bounding box. The one
  that reaches the edge of the map, and those longer than 1.25 m, are the walls. The others are islands: legs, columns,
  bins. Furniture against a wall is part of the wall.
- Cycles longer than 2.5 m: obstacles inside the map with such a boundary, taken as twice the length, that is, the holes
  of the free space other than islands. Each adds an independent cycle to the building's passages.
- Rooms are those that the world knows, else the segments, over 0.25 m2, of `jexplore.segment` (variant holz, the
  settings of `jexplore segment`) in the map without its islands.
- Openings, where the rooms are known: 4-connected sets of free cells that lie in no room and touch two or more rooms,
  and of cells of one room next to another's; where the rooms are segments: critical points with a different room on
  either side. The width is that of the widest disc with its middle in the opening: between obstacles, or between the
  walls where the rooms are segments.
- Corridors: runs of cells that have walls on opposite sides, at equal distances and 0.8 to 4 m apart, at least
  three times as long as the median distance between these walls, which is their width.
"""

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np
import pandas as pd
from scipy import ndimage

from jexplore import segment
from jexplore.config import require_number
from jexplore.report.tables import aligned_table, number_text
from jexplore.rooms.scores import label_components, scored_regions
from jexplore.studies.room_variants import segmented
from jexplore.studies.segmentation import MIN_SCORED_M2
from jexplore.worlds.starts import clear_of_walls
from jexplore.worlds.world import World, with_ring

WALL_LENGTH_M = 1.25  # an obstacle longer than this, its boundary than 2.5 m, is a wall; a shorter one an island
LEG_M = 0.3  # an island longer than this is more than a leg
WIDE_OPENING_M = 1.6  # an opening from this width on is no door
SMALL_M2, LARGE_M2 = 8.0, 60.0  # rooms below, rooms over
CORRIDOR_M = (0.8, 4.0)  # a narrower one is a slot, a wider one a hall
SLENDER = 3.0  # least ratio of length and width of a corridor
_EIGHT = np.ones((3, 3), bool)
_OPPOSITE = -0.5  # cosine of the angle at which two walls are seen that lie on opposite sides: 120 degrees and more


@dataclasses.dataclass(frozen=True)
class Geometry:
    """Figures of one world. Shares go from 0 to 1; NaN where there is nothing to measure.

    Fields that a table shows say the head of their column and their decimals.
    """

    world: str
    """Name of the world."""
    free_m2: float
    """Area of the free cells, square metres."""
    rooms_from: str
    """`truth`: the world knows its rooms; `segments`: found by `jexplore.segment`."""
    rooms: int
    rooms_per_100_m2: Annotated[float, "rooms/100 m²", 2]
    room_m2: Annotated[float, "room m²", 1]
    """Median area of the free cells of a room, square metres."""
    small_rooms: Annotated[float, "< 8 m²", 2]
    """Share of the rooms below `SMALL_M2`."""
    large_rooms: Annotated[float, "> 60 m²", 2]
    """Share of the rooms over `LARGE_M2`."""
    openings: int
    opening_m: Annotated[float, "opening m", 2]
    """Median width of an opening, metres."""
    wide_openings: Annotated[float, "≥ 1.6 m", 2]
    """Share of the openings that are `WIDE_OPENING_M` wide or wider."""
    corridor_low_m: Annotated[float, "corridor m", 2]
    corridor_high_m: Annotated[float, "to", 2]
    """Quartiles of the width of the corridors, over the cells of their axes, metres."""
    dead_ends: Annotated[float, "dead ends", 2]
    """Share of the rooms that have exactly one opening."""
    loops_per_1000_m2: Annotated[float, "ways round/1000 m²", 1]
    """Ways round: obstacles longer than `WALL_LENGTH_M` that the free space surrounds, a 1000 m2 of free area."""
    islands_per_100_m2: Annotated[float, "islands/100 m²", 1]
    """Obstacles up to `WALL_LENGTH_M` long that touch no wall, a 100 m2 of free area."""
    long_islands_per_100_m2: Annotated[float, "> 0.3 m", 1]
    """Those of them that are longer than `LEG_M`."""
    clear_share: Annotated[float, "clear", 2]
    """Of the free cells, those of the largest region that a robot with the clearance can drive over."""


_COLUMNS = {name: get_args(hint)[1:] for name, hint in get_type_hints(Geometry, include_extras=True).items()}
GEOMETRY_COLUMNS = {column[0]: (name, column[1]) for name, column in _COLUMNS.items() if column}
"""Head of a column of the table -> the field of `Geometry` and its decimals."""


def geometry(world: World, *, clearance_m: float = 0.30) -> Geometry:
    """Measure a world, generated or read from a file; see the module for what everything means.

    `clearance_m` is that of the robot whose share of the free cells is told: no obstacle within it, centre to centre.
    Lengths are good to a cell.
    """
    require_number("clearance_m", clearance_m, high=100)
    world = with_ring(world)
    cell_m, free = world.cell_m, ~world.occupied
    islands, lengths = _obstacles(world.occupied, cell_m)
    walls, known = world.occupied & ~islands, world.rooms is not None
    labels, joined, at = _known_rooms(free, world.rooms) if known else _found_rooms(walls, cell_m)
    widths = _widths(world.occupied if known else walls, at) * cell_m
    area = np.bincount(labels[free & (labels >= 0)]) * cell_m**2
    doors = np.bincount(np.array([room for rooms in joined for room in rooms], int), minlength=len(area))[area > 0]
    area = area[area > 0]  # numbers may be left out
    corridor = _corridor_widths(walls, cell_m)
    furniture = lengths[lengths <= WALL_LENGTH_M]
    clear = label_components(clear_of_walls(world.occupied, clearance_m, cell_m))
    per_m2 = 1 / world.free_m2
    return Geometry(
        world=world.name,
        free_m2=world.free_m2,
        rooms_from="truth" if known else "segments",
        rooms=len(area),
        rooms_per_100_m2=100 * per_m2 * len(area),
        room_m2=_median(area),
        small_rooms=_mean(area < SMALL_M2),
        large_rooms=_mean(area > LARGE_M2),
        openings=len(widths),
        opening_m=_median(widths),
        wide_openings=_mean(widths >= WIDE_OPENING_M - 1e-9),
        corridor_low_m=float(np.quantile(corridor, 0.25)) if len(corridor) else np.nan,
        corridor_high_m=float(np.quantile(corridor, 0.75)) if len(corridor) else np.nan,
        dead_ends=_mean(doors == 1),
        loops_per_1000_m2=1000 * per_m2 * int((lengths > WALL_LENGTH_M).sum()),
        islands_per_100_m2=100 * per_m2 * len(furniture),
        long_islands_per_100_m2=100 * per_m2 * int((furniture > LEG_M).sum()),
        clear_share=int(np.bincount(clear[clear >= 0], minlength=1).max()) / int(free.sum()),
    )


def geometry_table(found: Sequence[Geometry]) -> str:
    """Format `Geometry` records as an aligned Markdown table; more than one end with a row of medians."""
    fields, decimals = zip(*GEOMETRY_COLUMNS.values())
    rows = [(one.world, *(getattr(one, field) for field in fields)) for one in found]
    rows += [("median", *medians(found).values())] if len(found) > 1 else []
    lines = [[name, *map(number_text, values, decimals)] for name, *values in rows]
    return aligned_table(["world", *GEOMETRY_COLUMNS], lines, left=["world"])


def medians(found: Sequence[Geometry]) -> dict[str, float]:
    """Compute the median of every column of the table over worlds: field -> number."""
    fields = [field for field, _ in GEOMETRY_COLUMNS.values()]
    return pd.DataFrame([dataclasses.asdict(one) for one in found])[fields].median().to_dict()


def _median(values):
    return float(np.median(values)) if len(values) else np.nan


def _mean(values):
    return float(np.mean(values)) if len(values) else np.nan


def _components(mask, structure=None) -> tuple[np.ndarray, Any]:
    """Label connected components from 1, 0 elsewhere: `[H, W]` int32; and the rows and columns of each."""
    labels = np.empty(mask.shape, np.int32)
    ndimage.label(mask, structure, output=labels)
    return labels, ndimage.find_objects(labels)


def _obstacles(occupied, cell_m):
    """Return the cells of islands, and the lengths of all obstacles inside the map: `[H, W]` bool, `[n]` metres."""
    labels, boxes = _components(occupied, _EIGHT)
    lengths = np.array([0, *(max(y.stop - y.start, x.stop - x.start) for y, x in boxes)]) * cell_m - 1e-9
    edge = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    inside = np.ones(len(lengths), bool)
    inside[edge] = inside[0] = False
    return (inside & (lengths <= WALL_LENGTH_M))[labels], lengths[inside]


def _known_rooms(free, rooms):
    """Return `(labels, joined, at)` of a world that knows its rooms: see `_found_rooms`."""
    labels: Any = np.where(free, np.asarray(rooms, np.int32), -1)
    beside = np.zeros(free.shape, bool)  # cells of a room next to one of another
    for axis in (0, 1):
        low, high = (np.moveaxis(a, axis, 0) for a in (labels, beside))
        border = (low[1:] != low[:-1]) & (low[1:] >= 0) & (low[:-1] >= 0)
        high[1:] |= border
        high[:-1] |= border
    parts = []
    for mask in (free & (labels < 0), beside):
        numbers, boxes = _components(mask)
        parts += [(box, numbers, i) for i, box in enumerate(boxes, 1)]
    joined, at = [], []
    for (y, x), numbers, i in parts:
        wide = slice(max(y.start - 1, 0), y.stop + 1), slice(max(x.start - 1, 0), x.stop + 1)
        own = numbers[wide] == i
        sides = np.unique(labels[wide][ndimage.binary_dilation(own)])
        sides = sides[sides >= 0]
        if len(sides) > 1:
            joined.append(sides.tolist())
            at.append(np.argwhere(own) + np.array([wide[0].start, wide[1].start]))
    return labels, joined, at


def _found_rooms(walls, cell_m):
    """Return rooms by their Voronoi graph: `[H, W]` numbers, -1 for none; of every opening its rooms, and its cells."""
    made = segmented(~walls, segment.criteria(prominence=segment.PROMINENCE_M / cell_m))
    labels = scored_regions(np.where(walls, -1, made.label), ~walls, min_px=round(MIN_SCORED_M2 / cell_m**2))
    joined, at = [], []
    for k, cell in enumerate(made.graph.cell[made.critical]):
        seeds = made.seed[2 * k : 2 * k + 2]
        if len(seeds) < 2 or max(cell, *seeds) >= walls.size:
            continue
        rooms = np.unique(labels.reshape(-1)[seeds])
        if len(rooms) == 2 and rooms[0] >= 0:
            joined.append(rooms.tolist())
            at.append(np.array([np.unravel_index(cell, walls.shape)]))
    return labels, joined, at


def _widths(walls, at):
    """Return the diameter of the widest disc between walls with its middle in each list of cells, cells: `[n]`."""
    # Cells cut in four: the distance from a cell's quarter to the nearest of a wall is then the width of the gap.
    fine: Any = ndimage.distance_transform_edt(~np.repeat(np.repeat(walls, 2, 0), 2, 1))
    quarters = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
    cells = [(2 * some[:, None] + quarters).reshape(-1, 2) for some in at]
    return np.array([fine[tuple(some.T)].max() for some in cells])


def _corridor_widths(walls, cell_m):
    """Return the width at every cell of the axes of corridors, metres: `[n]`."""
    site: Any = ndimage.distance_transform_edt(~walls, return_distances=False, return_indices=True)
    here = np.indices(walls.shape)
    width = np.zeros(walls.shape)
    for low, high in ((np.s_[:, :-1, :], np.s_[:, 1:, :]), (np.s_[:, :, :-1], np.s_[:, :, 1:])):
        a, b = site[low] - here[low], site[high] - here[low]
        size = np.hypot(*a) * np.hypot(*b)
        apart = (np.hypot(*(a - b)) - 1) * cell_m
        axis = (size > 0) & ((a * b).sum(0) <= _OPPOSITE * size) & (apart >= CORRIDOR_M[0]) & (apart <= CORRIDOR_M[1])
        width[low[1:]] = np.maximum(width[low[1:]], np.where(axis, apart, 0))
    runs, boxes = _components(width > 0, _EIGHT)
    found = [np.zeros(0)]
    for i, (y, x) in enumerate(boxes, 1):
        own = width[y, x][runs[y, x] == i]
        if max(y.stop - y.start, x.stop - x.start) * cell_m >= SLENDER * np.median(own):
            found.append(own)
    return np.concatenate(found)
