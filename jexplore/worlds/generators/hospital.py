"""A hospital wing: a ward round a core with the nurses' station, a hall, and a treatment wing."""

from jexplore.worlds.generators.draft import FloorPlan, bands, stand_columns, stretches
from jexplore.worlds.generators.variants import corridor_widths, finish_building
from jexplore.worlds.world import World


def hospital(
    seed: int,
    *,
    cell_m: float = 0.1,
    width_m: float = 50.0,
    height_m: float = 20.0,
    corridor_m: float = 2.4,
    room_m: float = 4.2,
    corridor_sd_m: float = 0.0,
    furniture: float = 0.0,
    wide_openings: float = 0.0,
    max_loops: float = 1000.0,
) -> World:
    """Generate a hospital floor: a ward, a hall and a treatment wing side by side.

    In the ward, a corridor runs round a core (several for buildings from 25 m in height; a single straight one below 15
    m). Patient rooms lie at the facades, most with a bathroom next to the entrance; nurses, stores and treatment lie in
    the core. The corridors end at the hall. The treatment wing has one corridor, patient rooms on one side and on the
    other suites of a waiting room and the rooms behind it; it may be less deep than the ward. `room_m` is the width of
    a common patient room; the other parameters are those of `office`.
    """
    plan = FloorPlan("hospital", seed, width_m, height_m)
    rng, widths = plan.stream(), corridor_widths(plan, corridor_m, corridor_sd_m)
    stack = bands(rng, height_m, widths, (1.25, 1.4))
    hall_m = rng.uniform(6.0, 8.5) if width_m > 40 else 6.0
    x0 = width_m * rng.uniform(0.45, 0.58) - hall_m / 2
    kinds = [(0.5, 0.9 * room_m, 1.05 * room_m), (0.3, 1.2 * room_m, 1.6 * room_m), (0.2, 2.2, 2.8)]
    corridor = _ward(rng, plan, x0, stack, corridor_m, kinds)
    hall = _hall(rng, plan, (x0, x0 + hall_m), stack)
    for stretch in plan.shared_walls(corridor, hall):
        plan.gap(stretch, 1.2)
    _treatment(rng, plan, x0 + hall_m, stack, hall, kinds)
    flips = (rng.random(2) < 0.5).tolist()
    return finish_building(plan, cell_m, furniture, wide_openings, max_loops, corridor_sd_m, flips)


def _ward(rng, plan, end, stack, corridor_m, kinds):
    """Draw the ward from x = 0 to `end`; return the number of its corridor."""
    lines = stack[1::2]
    x = 0.0
    if len(lines) == 1:
        corridor = plan.room((0.0, lines[0][0], end, lines[0][1]), kind="corridor")
    else:
        x = rng.uniform(4.2, 5.2)
        y0, y1 = lines[0][0], lines[-1][1]
        along = ((x, low, end, high) for low, high in lines)
        corridor = plan.room((x, y0, x + corridor_m, y1), *along, kind="corridor")
        for low, high in stretches(rng, y0, y1, [(1.0, 2.8, 5.5)]):
            plan.room((0.0, low, x, high), kind="treatment")
            plan.gap((True, x, low, high), rng.choice([0.9, 1.2]), rng.choice([0.1, 0.5, 0.9]))
        for low, high in stack[2:-1:2]:
            _core(rng, plan, (x + corridor_m, low, end, high))
    for (y0, y1), front in ((stack[0], lines[0][0]), (stack[-1], lines[-1][1])):
        begin = 0.0
        if len(lines) > 1:  # a corner room: it must reach the corridor
            begin = x + rng.uniform(2.0, 3.0)
            plan.room((0.0, y0, begin, y1), kind="treatment")
            plan.gap((False, front, x, begin), 1.2)
        _patients(rng, plan, (begin, y0, end, y1), front, kinds)
    return corridor


def _patients(rng, plan, rect, front, kinds):
    """Draw a row of patient rooms and stores between a facade and a corridor that begins at y = `front`."""
    first, y0, last, y1 = rect
    left = bool(rng.random() < 0.5)
    for x0, x1 in stretches(rng, first, last, kinds):
        width = x1 - x0
        inner_m = min(rng.uniform(1.8, 2.2), width - 1.9)
        if inner_m < 1.8 or y1 - y0 < 4.2 or rng.random() < 0.15:
            plan.room((x0, y0, x1, y1), kind="patient" if width >= 3 else "store")
            plan.gap((False, front, x0, x1), 0.9 if width < 3 else 1.2, rng.choice([0.0, 0.1, 0.9, 1.0]))
        else:
            _with_bathroom(rng, plan, (x0, y0, x1, y1), front, inner_m, left)
            left = not left  # bathrooms of neighbours share a wall of pipes


def _with_bathroom(rng, plan, rect, front, inner_m, left):
    """Draw a patient room with a bathroom `inner_m` wide in the corner next to the entrance."""
    x0, y0, x1, y1 = rect
    depth = rng.uniform(1.8, 2.2)
    y = front + depth if front == y0 else front - depth
    x = x0 + inner_m if left else x1 - inner_m
    low, high = min(y, front), max(y, front)
    bath = (x0, low, x, high) if left else (x, low, x1, high)
    entry = (x, y0, x1, y1) if left else (x0, y0, x, y1)
    plan.room(entry, (x0, y, x1, y1) if front == y0 else (x0, y0, x1, y), kind="patient")
    plan.room(bath, kind="bath")
    plan.gap((False, front, entry[0], entry[2]), 1.2)
    if rng.random() < 0.5:
        plan.gap((True, x, low, high), 0.9)
    else:
        plan.gap((False, y, bath[0], bath[2]), 0.9)


def _core(rng, plan, rect):
    """Place the nurses' station somewhere in the core, and stores and treatment rooms on both sides."""
    x0, y0, x1, y1 = rect
    size = rng.uniform(6.0, 7.5)
    size = size if x1 - x0 - size > 2.2 else x1 - x0
    rest = x1 - x0 - size
    begin = x0 + rest * rng.uniform(0.3, 0.7) if rest > 8 else x0
    station = (begin, y0, begin + size, y1)
    plan.room(station, kind="station")
    for y in (y0, y1):
        for at in (0.1, 0.9):
            plan.gap((False, y, station[0], station[2]), 1.2, at)
    if y1 - y0 > 4.4 and size > 5.0:
        _desk(plan, begin + size / 2, (y0 + y1) / 2)
    kinds = [(0.4, 2.2, 3.0), (0.6, 3.2, 5.0)]
    for side in ((x0, begin), (begin + size, x1)):
        for low, high in stretches(rng, *side, kinds):
            if y1 - y0 > 4.6 and rng.random() < 0.55:  # two rooms, back to back
                y = y0 + (y1 - y0) * rng.uniform(0.42, 0.58)
                halves = [(y0, y, y0), (y, y1, y1)]
            else:
                halves = [(y0, y1, (y0, y1)[rng.integers(2)])]
            for bottom, top, front in halves:
                plan.room((low, bottom, high, top), kind="treatment" if high - low > 3 else "store")
                plan.gap((False, front, low, high), rng.choice([0.9, 1.1]), rng.choice([0.1, 0.5, 0.9]))


def _desk(plan, x, y):
    """Draw a counter on three sides of a square place, open towards the top."""
    half_x, half_y, depth = 1.3, 0.85, 0.4
    plan.blocks += [
        (x - half_x, y - half_y, x + half_x, y - half_y + depth),
        (x - half_x, y - half_y, x - half_x + depth, y + half_y),
        (x + half_x - depth, y - half_y, x + half_x, y + half_y),
    ]


def _hall(rng, plan, ends, stack):
    """Draw the hall, from the facade to the last corridor, and the rooms behind it; return its number."""
    x0, x1 = ends
    y = stack[-2][1]
    rect = (x0, 0.0, x1, y)
    stand_columns(plan, rect, spacing_m=3.6, margin_m=1.9)
    hall = plan.room(rect, kind="lobby")
    for low, high in stretches(rng, x0, x1, [(1.0, 2.6, 4.5)]):
        plan.room((low, y, high, plan.height_m))
        plan.gap((False, y, low, high), rng.choice([0.9, 1.0]), rng.choice([0.1, 0.5, 0.9]))
    return hall


def _treatment(rng, plan, begin, stack, hall, kinds):
    """Draw the wing from x = `begin` to the end, along the first or the last corridor of the ward."""
    end = plan.width_m
    first = bool(rng.random() < 0.5)
    row, line = (stack[0], stack[1]) if first else (stack[-1], stack[-2])
    corridor = plan.room((begin, line[0], end, line[1]), kind="corridor")
    plan.door(corridor, hall, 1.2)
    near, far = line if first else line[::-1]  # sides of the corridor towards the row, and away from it
    _patients(rng, plan, (begin, row[0], end, row[1]), near, kinds)
    room_m = plan.height_m - far if first else far
    suites = room_m >= 7.0 and rng.random() < 0.65
    depth = min(room_m, rng.uniform(7.6, 8.8) if suites else rng.uniform(4.8, 5.6))
    if room_m - depth < 1.0:
        depth = room_m
    y = far + depth if first else far - depth
    y = min(max(y, 0.0), plan.height_m)
    if suites:
        _suites(rng, plan, (begin, end), far, y)
    else:
        _patients(rng, plan, (begin, min(far, y), end, max(far, y)), far, kinds)


def _suites(rng, plan, ends, front, back):
    """Draw waiting rooms at a corridor (y = `front`), each with two or three rooms behind it."""
    for x0, x1 in stretches(rng, ends[0], ends[1], [(1.0, 6.5, 10.0)]):
        middle = front + (back - front) * rng.uniform(0.42, 0.52)
        plan.room((x0, min(front, middle), x1, max(front, middle)), kind="waiting")
        for at in (0.1, 0.9) if x1 - x0 > 7.5 else (0.5,):
            plan.gap((False, front, x0, x1), 1.2, at)
        for low, high in stretches(rng, x0, x1, [(1.0, 2.6, 4.4)]):
            plan.room((low, min(back, middle), high, max(back, middle)), kind="treatment")
            plan.gap((False, middle, low, high), rng.choice([0.9, 1.0]), rng.choice([0.1, 0.5, 0.9]))
