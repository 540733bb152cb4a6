"""An office floor: corridors with rooms on both sides, and a core with an open-plan area between them."""

import itertools

from jexplore.worlds.generators.draft import FloorPlan, bands, stand_columns, stretches
from jexplore.worlds.generators.variants import corridor_widths, finish_building
from jexplore.worlds.world import World

_LARGE = {"lobby": (3.0, 1.7, 1.2), "open": (4.5, 2.2, 1.1)}
"""Kind of a large room -> spacing of its columns, their least distance from the walls, width of its doors, metres."""


def office(
    seed: int,
    *,
    cell_m: float = 0.1,
    width_m: float = 30.0,
    height_m: float = 20.0,
    corridor_m: float = 2.0,
    room_m: float = 3.4,
    corridor_sd_m: float = 0.0,
    furniture: float = 0.0,
    wide_openings: float = 0.0,
    max_loops: float = 1000.0,
) -> World:
    """Generate a floor of offices, meeting rooms, small service rooms, one open-plan area and a lobby at the facade.

    Corridors run the length of the building, one in every 10 m of its height; cross corridors join two of them, open to
    one and with a door to the other. Every corridor is a room of its own, together with the cross corridors open to it.
    `corridor_m` is measured between the middles of the walls, `room_m` is the width of a common office, which the
    others follow; the others are as of `finish_building`.
    """
    plan = FloorPlan("office", seed, width_m, height_m)
    rng, widths = plan.stream(), corridor_widths(plan, corridor_m, corridor_sd_m)
    stack = bands(rng, height_m, widths, (1.05, 1.25))
    _floor(rng, plan, stack, corridor_m, _kinds(room_m))
    flips = (rng.random(2) < 0.5).tolist()
    return finish_building(plan, cell_m, furniture, wide_openings, max_loops, corridor_sd_m, flips)


def _floor(rng, plan, stack, corridor_m, kinds):
    """Draw rows of rooms at both facades, and cores between the corridors."""
    width_m = plan.width_m
    end = width_m
    if len(stack) > 3 and width_m >= 22 and rng.random() < 0.5:
        end -= rng.uniform(0.22, 0.3) * width_m
    crossings = {k: _crossings(rng, end, corridor_m) for k in range(2, len(stack) - 1, 2)}
    corridors = _corridors(rng, plan, stack, crossings, end)
    bottom, top = ((0.0, y0, end, y1) for y0, y1 in (stack[0], stack[-1]))
    if end < width_m:
        _head(rng, plan, end, stack, corridors)
        _row(rng, plan, bottom, corridors[0], kinds)
    else:
        _row_around(rng, plan, bottom, corridors[0], kinds, "lobby", 7.0)
    if crossings:
        _row(rng, plan, top, corridors[-1], kinds)
    else:
        _row_around(rng, plan, top, corridors[-1], kinds, "open", 10.0)
    for k, across in crossings.items():
        ends = 0.0, *itertools.chain(*across), end
        _core(rng, plan, ends, stack[k], corridors[k // 2 - 1 : k // 2 + 1], kinds)


def _kinds(room_m):
    """Return kinds of rooms: how common, least and greatest width, metres."""
    return [
        (0.40, 0.8 * room_m, 1.0 * room_m),
        (0.28, 1.0 * room_m, 1.4 * room_m),
        (0.18, 1.5 * room_m, 2.1 * room_m),
        (0.14, max(1.9, 0.55 * room_m), max(2.2, 0.7 * room_m)),
    ]


def _crossings(rng, end, corridor_m):
    """Draw the positions of cross corridors through a core from 0 to `end`: a list of `(x0, x1)`."""
    n = max(1, round(end / 20 + rng.uniform(-0.5, 0.7)))
    half = corridor_m / 2 * rng.uniform(1.0, 1.15)
    middles = [end * (i + rng.uniform(0.25, 0.75)) / n for i in range(n)]
    return [(x - half, x + half) for x in middles]


def _corridors(rng, plan, stack, crossings, end):
    """Add the corridors, bottom to top, and the doors at the ends of cross corridors. Returns their room numbers."""
    shapes = [[(0.0, y0, end, y1)] for y0, y1 in stack[1::2]]
    for k, across in crossings.items():
        for x0, x1 in across:
            if rng.random() < 0.5:  # open to the corridor below
                shapes[k // 2 - 1].append((x0, stack[k - 1][0], x1, stack[k][1]))
            else:
                shapes[k // 2].append((x0, stack[k][0], x1, stack[k + 1][1]))
    numbers = [plan.room(*shape, kind="corridor") for shape in shapes]
    for below, above in itertools.pairwise(numbers):
        for stretch in plan.shared_walls(below, above):
            plan.gap(stretch, 1.2)
    return numbers


def _head(rng, plan, end, stack, corridors):
    """Draw the lobby and large rooms at the corridors' ends, one each, and perhaps meeting rooms in the corners."""
    corners = [y if rng.random() < 0.6 else edge for y, edge in ((stack[0][1], 0.0), (stack[-1][0], plan.height_m))]
    middles = [y0 + (y1 - y0) * rng.uniform(0.35, 0.65) for y0, y1 in stack[2:-1:2]]
    large = []
    for (y0, y1), corridor in zip(itertools.pairwise([corners[0], *middles, corners[1]]), corridors):
        rect = (end, y0, plan.width_m, y1)
        stand_columns(plan, rect, spacing_m=3.5, margin_m=1.7)
        large.append(plan.room(rect, kind="open" if large else "lobby"))
        plan.door(large[-1], corridor, 1.2)
    for before, after in itertools.pairwise(large):
        plan.door(before, after, 1.2, rng.uniform(0.2, 0.8))
    for low, high, room in ((0.0, corners[0], large[0]), (corners[1], plan.height_m, large[-1])):
        if high > low:
            plan.door(plan.room((end, low, plan.width_m, high)), room, 1.0, rng.choice([0.1, 0.9]))


def _row_around(rng, plan, rect, corridor, kinds, special, size_m):
    """Draw a row of rooms with a large one of the kind `special` somewhere in it, about `size_m` long."""
    x0, y0, x1, y1 = rect
    size = min(size_m * rng.uniform(0.85, 1.2), (x1 - x0) / 2)
    begin = x0 + rng.uniform(3.0, x1 - x0 - size - 3.0)
    _large_room(plan, (begin, y0, begin + size, y1), (corridor,), special)
    _row(rng, plan, (x0, y0, begin, y1), corridor, kinds)
    _row(rng, plan, (begin + size, y0, x1, y1), corridor, kinds)


def _large_room(plan, rect, corridors, kind):
    """Draw a large room with columns, and two doors to every corridor next to it."""
    spacing_m, margin_m, door_m = _LARGE[kind]
    stand_columns(plan, rect, spacing_m=spacing_m, margin_m=margin_m)
    room = plan.room(rect, kind=kind)
    for corridor in corridors:
        for at in (0.12, 0.88):
            plan.door(room, corridor, door_m, at)


def _row(rng, plan, rect, corridor, kinds):
    """Draw rooms side by side along a corridor; some lie behind a front office, some have a door to the room before."""
    first, y0, last, y1 = rect
    above = plan.rooms[corridor][0][1] > y0  # the corridor lies above the row
    before = None
    for x0, x1 in stretches(rng, first, last, kinds):
        width = x1 - x0
        if width >= 3.2 and y1 - y0 >= 4.6 and rng.random() < 0.18:
            share = rng.uniform(0.45, 0.55)
            y = y0 + (y1 - y0) * share
            low, high = plan.room((x0, y0, x1, y)), plan.room((x0, y, x1, y1))
            front, back = (high, low) if above else (low, high)
            plan.door(front, back, 0.9, rng.random())
        else:
            front = back = plan.room((x0, y0, x1, y1))
        if width > 6.2:
            plan.door(front, corridor, 1.0, 0.05)
            plan.door(front, corridor, 1.0, 0.95)
        else:
            plan.door(front, corridor, 1.2 if width > 4.8 else rng.choice([0.9, 1.0]), rng.choice([0.0, 0.1, 0.9, 1.0]))
        if before is not None and width > 2.4 and rng.random() < 0.12:
            plan.door(before, back, 0.9, rng.choice([0.1, 0.9]))
        before = back if width > 2.4 else None


def _core(rng, plan, ends, band, corridors, kinds):
    """Fill the band between corridors: an open-plan area in a long part, else rooms. `ends`: x0, x1 of the parts."""
    y0, y1 = band
    parts = list(zip(ends[::2], ends[1::2]))
    lengths = [x1 - x0 for x0, x1 in parts]
    long = [i for i, length in enumerate(lengths) if length >= min(8.0, max(lengths))]
    chosen = long[rng.integers(len(long))]
    for i, (x0, x1) in enumerate(parts):
        if i == chosen:
            size = rng.uniform(8.0, 13.0)
            size = size if x1 - x0 - size >= 3.0 else x1 - x0
            _large_room(plan, (x0, y0, x0 + size, y1), corridors, "open")
            x0 += size
        if x1 - x0 < 1.9:  # nothing is left, or a shaft
            continue
        if 3.5 < x1 - x0 < 7.5 and rng.random() < 0.3:
            room = plan.room((x0, y0, x1, y1), kind="meeting")
            plan.door(room, corridors[0], 1.2, rng.choice([0.1, 0.9]))
            plan.door(room, corridors[1], 1.2, rng.choice([0.1, 0.9]))
        elif y1 - y0 < 5.2:
            _row(rng, plan, (x0, y0, x1, y1), corridors[rng.integers(2)], kinds)
        else:
            y = y0 + (y1 - y0) * rng.uniform(0.46, 0.54)
            _row(rng, plan, (x0, y0, x1, y), corridors[0], kinds)
            _row(rng, plan, (x0, y, x1, y1), corridors[1], kinds)
