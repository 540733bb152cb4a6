"""The plan of a course without a goal: passages that meet, in rings and in rows of equal junctions, and a way in.

It is drawn with the way in from the west and the rings growing to the north and east, and turned and mirrored last.
Lines are the lanes of passages: columns run along y, rows along x, in the order of their keys; whole keys are sides of
rings, fractions the middles between.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from jexplore.worlds.generators.course_map import CLEAR_GAP_M, RAMP_M, CoursePlan, Leg, Ramp, Stop, drawn_width, fifths
from jexplore.worlds.generators.draft import Rect, rects_near

_Key = tuple[float, float]  # of a column and a row
_Option = TypeVar("_Option")
START_M = 4.0  # from the wall behind the start: outside the circle of the dead end there
_SEED_0_M = 6.0  # length of a passage between two junctions


@dataclasses.dataclass(frozen=True, order=True)
class _Side:
    """A straight stretch of a ring, or between two rings."""

    axis: int  # 0: it runs along x, on a row; 1: along y, on a column
    line: float  # _Key of the row or column
    low: float
    high: float  # keys of the columns or rows where it ends


def draw_network(
    rng: np.random.Generator | None, width_m: float, creases: int, loops: int, repeat: int, spurs: bool
) -> CoursePlan:
    """Plan a course with independent cycles, or of equal junctions, or both; the first passage has start and obstacle.

    Without `rng` nothing is drawn: widths are `width_m` and all lengths 6 m. `creases` places of the obstacle become
    nodes. Each of the `loops` rings shares a side with the one before or is joined to it by a passage. `repeat` T
    junctions, with dead ends of equal length, lie at equal distances: on the first ring, else on a straight. With
    `spurs` rings have dead ends.
    """
    draw = _Draws(rng, width_m)
    sides = _rings(draw, loops) if loops else {_Side(0, 0.0, 1 / (repeat + 1), repeat / (repeat + 1))}
    entry = (0.0, draw.choice((0.5, 0.0, 1.0))) if loops else (1 / (repeat + 1), 0.0)
    equal = [(t / (repeat + 1), 0.0) for t in range(1, repeat + 1)]
    wanted = _wanted(draw, sides, repeat) if spurs and loops else []
    keys = [(side.line, at)[:: 1 if side.axis else -1] for side in sides for at in (side.low, side.high)]
    keys += [entry, *equal, *(at for at, _ in wanted)]
    columns = _lines(draw, {column for column, _ in keys}, repeat)
    rows = _lines(draw, {row for _, row in keys}, 0)
    made = _Passages(columns, rows, sides)
    before_m = START_M + draw.passage()
    made.spur(entry, 2, before_m + 2 * RAMP_M + draw.passage())
    length = draw.length(6.2, 8.0)
    for at in equal:
        made.spur(at, 3, length)
    if not loops:
        made.spur(equal[-1], 0, draw.length(6.2, 8.0))
    for at, heading in wanted:
        made.spur(at, heading, draw.length(5.0, 7.0), may_fail=True)
    places, pairs = made.places_and_pairs()
    places = _turned_rects(places, draw.choice(range(4)), draw.choice((False, True)))
    return _planned(places, pairs, before_m, creases, draw.angle())


class _Draws:
    """Numbers that are drawn, or fixed where there is nothing to draw from."""

    def __init__(self, rng: np.random.Generator | None, width_m: float) -> None:
        self.rng, self.width_m = rng, width_m

    def choice(self, options: Sequence[_Option]) -> _Option:
        return options[0] if self.rng is None else options[int(self.rng.integers(len(options)))]

    def width(self) -> float:
        return self.width_m if self.rng is None else drawn_width(self.rng, self.width_m)

    def length(self, low: float, high: float) -> float:
        return _SEED_0_M if self.rng is None else fifths(self.rng, low, high)

    def passage(self) -> float:
        return self.length(4.4, 7.0)

    def angle(self) -> float:
        return 10.0 if self.rng is None else float(self.rng.integers(6, 16))


def _rings(draw: _Draws, loops: int) -> set[_Side]:
    """Return the sides of a number of rings: a staircase to the north and east, so that no further ring arises."""
    column, row, sides = 0, 0, _sides_of(0, 0)
    for _ in range(loops - 1):
        shares, east, upper = draw.choice((True, False)), draw.choice((True, False)), draw.choice((0, 1))
        if not shares:
            line, low = (row + upper, column + 1) if east else (column + upper, row + 1)
            sides = sides | {_Side(0 if east else 1, float(line), float(low), float(low + 1))}
        step = 1 if shares else 2
        column, row = (column + step, row) if east else (column, row + step)
        sides = sides | _sides_of(column, row)
    return sides


def _sides_of(column: int, row: int) -> set[_Side]:
    return {_Side(0, float(row + k), float(column), float(column + 1)) for k in (0, 1)} | {
        _Side(1, float(column + k), float(row), float(row + 1)) for k in (0, 1)
    }


def _wanted(draw: _Draws, sides: set[_Side], repeat: int) -> list[tuple[_Key, int]]:
    """Return places, keys of column and row, and headings of dead ends for rings; none next to equal junctions."""
    found = []
    for side in sorted(sides):
        along = draw.choice((side.low, (side.low + side.high) / 2, side.high))
        at = (along, side.line) if side.axis == 0 else (side.line, along)
        heading = draw.choice((1, 3) if side.axis == 0 else (0, 2))
        if draw.choice((False, True)) and not (repeat and (at[1] == 0 or 0 < at[0] < 1)):
            found.append((at, heading))
    return found


def _lines(draw: _Draws, keys: set[float], repeat: int) -> dict[float, _Key]:
    """Return key -> the two sides of a line, metres. Those of equal junctions are alike and equally far apart."""
    equal_width, equal_gap, at, found = draw.width(), draw.length(5.0, 8.0), 0.0, {}
    ordered = sorted(keys)
    for key, after in zip(ordered, [*ordered[1:], None]):
        is_equal = repeat and 0 < key < 1
        width = equal_width if is_equal else draw.width()
        found[key] = (round(at, 6), round(at + width, 6))
        if after is not None:
            is_whole = key % 1 == after % 1 == 0
            gap = draw.length(5.0, 9.0) if is_whole else draw.passage()
            at += width + (equal_gap if repeat and (is_equal or 0 < after < 1) else gap)
    return found


class _Passages:
    """Lines in metres, and the passages on them."""

    def __init__(self, columns: dict[float, _Key], rows: dict[float, _Key], sides: set[_Side]) -> None:
        self.columns, self.rows, self.sides = columns, rows, sorted(sides)
        ends = [[(key, s.line) if s.axis == 0 else (s.line, key) for key in (s.low, s.high)] for s in self.sides]
        self.keys = {at for pair in ends for at in pair}
        self.areas = [_hull(*map(self._place, pair)) for pair in ends]
        self.spurs: list[tuple[_Key, Rect]] = []

    def _place(self, at: _Key) -> Rect:
        (x0, x1), (y0, y1) = self.columns[at[0]], self.rows[at[1]]
        return x0, y0, x1, y1

    def spur(self, at: _Key, heading: int, length: float, may_fail: bool = False) -> None:
        """Add a passage with a dead end; one that may fail is left out where it would come near to another passage."""
        base = self._place(at)
        width = base[3] - base[1] if heading % 2 == 0 else base[2] - base[0]
        stub = _beyond(base, heading, 0.0, length)
        others = ((area, _hull(area, base) == area) for area in self.areas)
        if any(rects_near(stub, area, -1e-6 if touches else CLEAR_GAP_M) for area, touches in others):
            assert may_fail, "what the plan relies on keeps clear of itself"
            return
        far = _beyond(base, heading, length - width, length)
        self.keys.add(at)
        self.areas.append(_hull(base, far))
        self.spurs.append((at, far))

    def places_and_pairs(self) -> tuple[list[Rect], list[tuple[int, int]]]:
        """Return rectangles of places where passages meet or end, and passages as pairs, dead ends first."""
        keys = sorted(self.keys)
        places = [*map(self._place, keys), *(far for _, far in self.spurs)]
        pairs = [(len(keys) + i, keys.index(at)) for i, (at, _) in enumerate(self.spurs)]
        for side in self.sides:
            on = [at for at in keys if at[1 - side.axis] == side.line and side.low <= at[side.axis] <= side.high]
            pairs += [(keys.index(one), keys.index(two)) for one, two in itertools.pairwise(on)]
        return places, pairs


def _beyond(rect: Rect, heading: int, near_m: float, far_m: float) -> Rect:
    """Return the stretch of a passage that leaves a rectangle, between two distances from its mouth."""
    edge, forward = rect[(heading + 2) % 4], 1 if heading < 2 else -1
    low, high = sorted((edge + forward * near_m, edge + forward * far_m))
    x0, y0, x1, y1 = rect
    return (x0, low, x1, high) if heading % 2 else (low, y0, high, y1)


def _hull(*rects: Rect) -> Rect:
    x0, y0, x1, y1 = zip(*rects)
    return min(x0), min(y0), max(x1), max(y1)


def _turned_rects(rects: list[Rect], quarters: int, mirrored: bool) -> list[Rect]:
    """Turn rectangles counter-clockwise about the origin, then mirror them in x."""
    for _ in range(quarters):
        rects = [(-y1, x0, -y0, x1) for x0, y0, x1, y1 in rects]
    return [(-x1, y0, -x0, y1) for x0, y0, x1, y1 in rects] if mirrored else list(rects)


def _planned(
    places: list[Rect], pairs: list[tuple[int, int]], before_m: float, creases: int, angle_deg: float
) -> CoursePlan:
    """Return the plan of places and passages; the first has the start and, `before_m` from its end, the ramp."""
    ways = [(a, b, _heading(places[a], places[b])) for a, b in pairs]
    arms = [{heading for a, _, heading in ways if a == i} | {(h + 2) % 4 for _, b, h in ways if b == i}
            for i in range(len(places))]  # fmt: skip
    stops = [
        Stop("divergence", min(own), (0.0, 0.0), rect=rect, arms=frozenset(own)) for rect, own in zip(places, arms)
    ]
    legs = [Leg(a, b, heading, _lane(places[a], heading)) for a, b, heading in ways[1:]]
    end, base, heading = ways[0]
    lane, forward = _lane(places[end], heading), 1 if heading < 2 else -1
    wall = places[end][heading]
    start = Stop("terminal", heading, lane, wall + forward * START_M)
    ramp = Ramp(heading, lane, wall + forward * before_m, angle_deg)
    chain = [end, *range(len(stops), len(stops) + creases), base]
    stops += [Stop("obstacle", heading, lane, ramp=ramp, crease=crease) for crease in range(creases)]
    legs += [Leg(a, b, heading, lane) for a, b in itertools.pairwise(chain)]
    areas = [_hull(places[a], places[b]) for a, b, _ in ways]
    return CoursePlan(start, areas, stops, legs, [ramp] if creases else [])


def _heading(a: Rect, b: Rect) -> int:
    dx, dy = b[0] + b[2] - a[0] - a[2], b[1] + b[3] - a[1] - a[3]
    return (0 if dx > 0 else 2) if abs(dx) > abs(dy) else (1 if dy > 0 else 3)


def _lane(rect: Rect, heading: int) -> _Key:
    return (rect[1], rect[3]) if heading % 2 == 0 else (rect[0], rect[2])
