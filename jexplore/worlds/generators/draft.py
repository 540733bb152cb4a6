"""Floor plans drawn in metres and rasterised to cells: common code of the generators.

Rectangles are `(x0, y0, x1, y1)` in metres and run along the middles of the walls: neighbours share a coordinate. All
random numbers are drawn in metres before any cell exists: a seed gives the same building at every `cell_m`.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from jexplore.grid import radius_d2
from jexplore.worlds.bounds import count_cells
from jexplore.worlds.world import World

PASSABLE_M = 0.30  # every door lets a robot through that needs this much, centre to centre
WALL_THICK_M = 0.15
OUTER_WALL_M = 0.3
Rect = tuple[float, float, float, float]
_STREAMS = {"cave": 1, "office": 2, "hospital": 3, "maze": 4, "rooms": 5, "course": 6}


def random_stream(seed: int, kind: str, *use: int) -> np.random.Generator:
    """Return the generator of a seed and a kind of world; `use` is the number of another of its uses."""
    return np.random.default_rng([seed, _STREAMS[kind], *use])


def passable_cells(cell_m: float) -> int:
    """Return the narrowest passable gap, cells: one of its cells has more than `PASSABLE_M` to both sides."""
    return 2 * math.isqrt(radius_d2(PASSABLE_M, cell_m)) + 1


def to_cells(length: float) -> int:
    """Round to a whole number; a half goes up, also one that rounding has made slightly less."""
    return math.floor(length + 0.5 + 1e-6)


def wall_span(
    middle_m: float, side_m: float, cell_m: float, *, wall_m: float = WALL_THICK_M, outer_m: float = OUTER_WALL_M
) -> tuple[int, int]:
    """Return the cells `(first, stop)` across the thickness of a wall, at least one: the same number anywhere.

    `middle_m` is the place of the wall's middle; 0 and `side_m` are the outer faces of the outer walls.
    """
    n_cells = count_cells(side_m, cell_m)
    thick = max(1, to_cells(outer_m / cell_m))
    if middle_m < 1e-6:
        return 0, thick
    if middle_m > side_m - 1e-6:
        return n_cells - thick, n_cells
    thick = max(1, to_cells(wall_m / cell_m))
    first = to_cells(middle_m / cell_m - thick / 2)
    return first, first + thick


def rects_near(a: Sequence[float], b: Sequence[float], gap_m: float = 0.0) -> bool:
    """Return whether two rectangles are nearer than `gap_m` in both axes; by default whether they overlap."""
    return a[0] < b[2] + gap_m and b[0] < a[2] + gap_m and a[1] < b[3] + gap_m and b[1] < a[3] + gap_m


def block_cells(block: Rect, cell_m: float) -> tuple[slice, slice]:
    """Return the rows and columns that a block covers: at least one of each."""
    x, y = (
        slice(to_cells(low / cell_m), max(to_cells(low / cell_m) + 1, to_cells(high / cell_m)))
        for low, high in (block[::2], block[1::2])
    )
    return y, x


@dataclasses.dataclass(frozen=True)
class Side:
    """A side of a room's rectangle."""

    vertical: bool
    wall: float  # as in `Door`
    inward: int  # 1 where the room lies at higher coordinates than the wall, else -1
    low: float
    high: float  # ends of the side along the wall, metres

    def block(self, low: float, near: float, high: float, far: float) -> Rect:
        """Return a rectangle from `low` to `high` along the wall, and `near` to `far` from its middle, metres."""
        first, last = sorted((self.wall + self.inward * near, self.wall + self.inward * far))
        return (first, low, last, high) if self.vertical else (low, first, high, last)


def sides_of(*rects: Rect) -> Iterator[Side]:
    """Yield the four sides of every rectangle: bottom, top, left, right."""
    for x0, y0, x1, y1 in rects:
        yield from (Side(False, y0, 1, x0, x1), Side(False, y1, -1, x0, x1))
        yield from (Side(True, x0, 1, y0, y1), Side(True, x1, -1, y0, y1))


def same_place(a: float, b: float) -> bool:
    """Return whether two coordinates are equal but for rounding."""
    return abs(a - b) < 1e-6


@dataclasses.dataclass(frozen=True)
class Door:
    """A gap in a wall between two rooms."""

    vertical: bool  # true if the wall runs along y
    wall: float  # position of the wall's middle: x if it is vertical, else y, metres
    middle: float  # middle of the gap along the wall, metres
    width: float  # metres
    low: float
    high: float  # ends of the stretch of wall that both rooms share, metres


@dataclasses.dataclass
class FloorPlan:
    """A floor plan under construction. What no room covers is solid."""

    kind: str
    seed: int
    width_m: float
    height_m: float
    rooms: list[list[Rect]] = dataclasses.field(default_factory=list)
    """A room is a list of rectangles; those that overlap are one space."""
    doors: list[Door] = dataclasses.field(default_factory=list)
    blocks: list[Rect] = dataclasses.field(default_factory=list)
    """Columns, counters, furniture: rectangles of their true size, at least one cell."""
    kinds: list[str] = dataclasses.field(default_factory=list)
    """Use of every room: a key of `furniture.ROOMS`; empty if its size decides."""

    def stream(self, *use: int) -> np.random.Generator:
        """Return the plan's `random_stream`, or that of another of its uses."""
        return random_stream(self.seed, self.kind, *use)

    def room(self, *rects: Rect, kind: str = "") -> int:
        """Add a room of one or more overlapping rectangles, of a kind (see `kinds`). Returns its number."""
        self.rooms.append(list(rects))
        self.kinds.append(kind)
        return len(self.rooms) - 1

    def beside(self, door: Door) -> tuple[int, int]:
        """Return the numbers of the rooms on both sides of a door: at the lower and at the higher coordinate."""
        found = {-1: -1, 1: -1}
        for number, rects in enumerate(self.rooms):
            for side in sides_of(*rects):
                if (
                    side.vertical == door.vertical
                    and side.low < door.middle < side.high
                    and same_place(side.wall, door.wall)
                ):
                    found[side.inward] = number
        return found[-1], found[1]

    def shared_walls(self, a: int, b: int) -> list[tuple[bool, float, float, float]]:
        """Return the straight stretches of wall that two rooms share: `(vertical, wall, low, high)`, see `Door`."""
        stretches = []
        for p, q in itertools.product(sides_of(*self.rooms[a]), sides_of(*self.rooms[b])):
            low, high = max(p.low, q.low), min(p.high, q.high)
            if p.vertical == q.vertical and p.inward != q.inward and same_place(p.wall, q.wall) and high - low > 1e-6:
                stretches.append((p.vertical, p.wall, low, high))
        apart = []
        for vertical, wall, low, high in sorted(stretches):  # rectangles of one room overlap, and so may stretches
            if apart and apart[-1][0] == vertical and same_place(apart[-1][1], wall) and low < apart[-1][3]:
                low, high = apart[-1][2], max(high, apart.pop()[3])
            apart.append((vertical, wall, low, high))
        return apart

    def bare_walls(self, room: int, keep_m: float) -> list[Side]:
        """Return the stretches of a room's walls that are `keep_m` metres and more away from its doors and openings."""
        stretches = []
        for side in sides_of(*self.rooms[room]):
            across, along = (0, 1) if side.vertical else (1, 0)
            taken = [
                (door.middle - door.width / 2, door.middle + door.width / 2)
                for door in self.doors
                if door.vertical == side.vertical and same_place(door.wall, side.wall)
            ]
            taken += [
                (other[along], other[along + 2])
                for other in self.rooms[room]
                if other[across] + 1e-6 < side.wall < other[across + 2] - 1e-6
            ]
            at = side.low
            for low, high in sorted([*taken, (side.high + keep_m, math.inf)]):
                if low < side.high + keep_m + 1e-6 and min(low - keep_m, side.high) > at + 1e-6:
                    stretches.append(dataclasses.replace(side, low=at, high=min(low - keep_m, side.high)))
                at = max(at, high + keep_m)
        return stretches

    def gap(self, stretch: tuple[bool, float, float, float], width: float, at: float = 0.5) -> None:
        """Add a door in a stretch of wall. `at` goes from 0, at its lower end, to 1; jambs remain at both ends."""
        vertical, wall, low, high = stretch
        margin = min((high - low) / 2, width / 2 + WALL_THICK_M / 2 + 0.25)
        self.doors.append(Door(vertical, wall, low + margin + at * (high - low - 2 * margin), width, low, high))

    def door(self, a: int, b: int, width: float, at: float = 0.5) -> None:
        """Add a door between two rooms, in the longest stretch of wall that they share."""
        self.gap(max(self.shared_walls(a, b), key=lambda stretch: stretch[3] - stretch[2]), width, at)

    def render(self, cell_m: float, flips: Sequence[bool] = (False, False)) -> World:
        """Render the plan as cells, mirrored left to right, bottom to top; rooms are numbered as they were added.

        A door has the whole number of cells nearest to its width, fewer where that leaves no cell of wall on either
        side, but never fewer than a robot passes (`passable_cells`). Walls, blocks and doorways are no room's.
        """
        sides = (self.width_m, self.height_m)
        spans = [lambda middle, side=side: wall_span(middle, side, cell_m) for side in sides]
        cols, rows = (count_cells(side, cell_m) for side in sides)
        occupied = np.ones((rows, cols), bool)
        rooms = np.full((rows, cols), -1, np.int32)
        for number, rects in enumerate(self.rooms):
            for x0, y0, x1, y1 in rects:
                inside = slice(spans[1](y0)[1], spans[1](y1)[0]), slice(spans[0](x0)[1], spans[0](x1)[0])
                occupied[inside] = False
                rooms[inside] = number
        for door in self.doors:
            across = slice(*spans[0 if door.vertical else 1](door.wall))
            span = spans[1 if door.vertical else 0]
            first, stop = span(door.low)[1], span(door.high)[0]
            n = min(to_cells(door.width / cell_m), stop - first - 2)
            n = min(max(n, passable_cells(cell_m)), stop - first)
            jamb = min(1, (stop - first - n) // 2)
            begin = min(max(to_cells(door.middle / cell_m - n / 2), first + jamb), stop - jamb - n)
            along = slice(begin, begin + n)
            occupied[(along, across) if door.vertical else (across, along)] = False
        for block in self.blocks:
            inside = block_cells(block, cell_m)
            occupied[inside] = True
            rooms[inside] = -1
        flip = tuple(slice(None, None, -1 if flipped else 1) for flipped in flips[::-1])
        return World(occupied=occupied[flip].copy(), rooms=rooms[flip].copy(), cell_m=float(cell_m))


def stretches(
    rng: np.random.Generator, first: float, last: float, kinds: Sequence[tuple[float, float, float]]
) -> list[tuple[float, float]]:
    """Cut a line into stretches of kinds `(weight, low, high)`, metres, none shorter than the least `low`.

    Returns the ends of each; none if the line has no length.
    """
    length = last - first
    if length <= 1e-6:
        return []
    weights = np.array([kind[0] for kind in kinds], float)
    lengths = []
    while sum(lengths) < length:
        _, low, high = kinds[rng.choice(len(kinds), p=weights / weights.sum())]
        lengths.append(rng.uniform(low, high))
    least = min(kind[1] for kind in kinds)
    while len(lengths) > 1 and (
        sum(lengths) - length > lengths[-1] / 2 or min(lengths) * length < least * sum(lengths)
    ):
        lengths.pop()
    ends = itertools.accumulate((one * length / sum(lengths) for one in lengths), initial=first)
    return list(itertools.pairwise(ends))


def bands(
    rng: np.random.Generator, height_m: float, widths: Sequence[float], edge: tuple[float, float]
) -> list[tuple[float, float]]:
    """Stack a building of n corridors: a row of rooms, a corridor, a core, a corridor, ..., a row of rooms.

    `widths` are those of the corridors, bottom to top; `edge` is the least and largest depth of the first and last row,
    as a multiple of half a corridor's share of the depth. The cores take the rest. Returns `(y0, y1)` of each from 0 to
    `height_m`: rows and cores have even indices, corridors odd ones.
    """
    n = len(widths)
    row = (height_m - math.fsum(widths)) / (2 * n)
    if n == 1:
        depths = [row * (share := rng.uniform(0.9, 1.1)), row * (2 - share)]
    else:
        first, last = row * rng.uniform(*edge, 2)
        depths = [first, *[(2 * n * row - first - last) / (n - 1)] * (n - 1), last]
    heights = [depth for pair in zip(depths, [*widths, 0.0]) for depth in pair][:-1]
    edges = [0.0, *np.cumsum(heights)[:-1].tolist(), height_m]
    return list(itertools.pairwise(edges))


def stand_columns(plan: FloorPlan, rect: Rect, *, spacing_m: float, margin_m: float) -> None:
    """Stand columns of 0.4 m in a room, at least `spacing_m` apart and `margin_m` from the middles of its walls."""
    x0, y0, x1, y1 = rect
    lines, half = [], 0.2
    for low, high in ((x0 + margin_m, x1 - margin_m), (y0 + margin_m, y1 - margin_m)):
        if high - low < 2 * half:
            return
        n = 1 + int((high - low) // spacing_m)
        lines.append(np.linspace(low, high, n) if n > 1 else [(low + high) / 2])
    plan.blocks += [(x - half, y - half, x + half, y + half) for x in lines[0] for y in lines[1]]
