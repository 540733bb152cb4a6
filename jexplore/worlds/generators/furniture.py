"""Furniture: tables and chairs on legs, beds, shelves and cupboards, where they stand in the rooms of a floor plan.

What a robot's scanner sees of a chair is its four legs. Pieces are drawn in metres, room by room from a random stream
of the room's own, and every piece has a rank from 0 to 1: with less furniture, only the pieces of low rank are there.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jexplore.rooms.scores import label_components
from jexplore.worlds.generators.draft import (
    OUTER_WALL_M,
    WALL_THICK_M,
    Door,
    FloorPlan,
    Rect,
    Side,
    block_cells,
    rects_near,
)
from jexplore.worlds.starts import clear_of_walls, largest_component
from jexplore.worlds.world import World

Part = tuple[float, list[Rect]]  # a rank, and the blocks of a piece or of a chair that belongs to it

ROOMS: dict[str, dict[str, float]] = {
    "corridor": {"cupboard": 40, "bench": 50, "bin": 50},
    "office": {"desk": 16, "cupboard": 28, "shelf": 32, "seat": 27, "bin": 20},
    "meeting": {"table": 34, "cupboard": 30, "seat": 34, "bin": 25},
    "open": {"pod": 52, "cupboard": 30, "shelf": 36, "table": 90, "bin": 32},
    "lobby": {"table": 34, "bench": 26, "shelf": 40, "seat": 24, "bin": 28},
    "store": {"shelf": 9, "bin": 8},
    "bath": {"basin": 8},
    "patient": {"bed": 21, "cupboard": 90, "table": 50, "seat": 13, "bin": 16},
    "treatment": {"bed": 50, "desk": 20, "cupboard": 40, "seat": 16, "bin": 16},
    "station": {"desk": 16, "shelf": 30, "seat": 18, "bin": 16},
    "waiting": {"table": 34, "bench": 30, "seat": 9, "bin": 20},
    "mixed": {"desk": 27, "table": 60, "bed": 60, "cupboard": 42, "shelf": 50, "seat": 44, "bin": 26},
}
"""Kind of room -> piece -> square metres per piece. The first pieces choose their places first."""

WALL_PIECES = {
    "cupboard": ((0.8, 1.6), (0.4, 0.6)),
    "shelf": ((0.8, 2.0), (0.28, 0.4)),
    "basin": ((0.45, 0.6), (0.4, 0.55)),
    "bed": ((0.9, 1.0), (1.95, 2.1)),
}
"""Piece that stands against a wall -> its least and greatest length along the wall, and depth, metres."""

_LEG_M = 0.05
_CHAIR_M = 0.42
_OFF_WALL_M = 0.25  # m; legs stand this far from the wall so that they do not merge with it
_BIN_M = 0.28
_GAP_M = 0.3  # between two pieces: at least a cell, so that nothing is shut in behind them
_DOOR_M = (0.2, 0.95)  # m; free space kept to the sides of a door and before it
_PASSAGE_M = 1.35  # what remains free of a corridor
_ROUND_M = 0.85  # between tables and the middles of the walls
_AISLE_M = 1.0  # between rows of desks
_TRIES = 12  # places, before a piece is left out
_FURNITURE = 110  # random stream
CHECKED_CELLS = ((0.05, 0.35), (0.1, 0.35), (0.15, 0.30), (0.2, 0.30))
"""Cells, and the clearance that a robot has in them everywhere it must get to, metres: with a margin."""
_LEFT = 0.5  # of the places where a robot could stand in the empty room, the share that it still reaches


class _Piece(NamedTuple):
    zone: Rect  # occupied area, chairs included, metres
    parts: list[Part]


def furnish(plan: FloorPlan, furniture: float) -> None:
    """Furnish the rooms of a plan, as blocks.

    Doorways and a strip before them stay free. A piece that would separate two doors of a room, enclose free space or
    take more than half of a room's standing places is left out, by the cells of `CHECKED_CELLS`, whatever `cell_m` is.
    Pieces stay in place as the share grows.
    """
    if not furniture:
        return
    doors: list[list[Door]] = [[] for _ in plan.rooms]
    for door in plan.doors:
        for number in plan.beside(door):
            doors[number].append(door)
    empty, standing = [plan.render(cell_m) for cell_m, _ in CHECKED_CELLS], list(plan.blocks)
    for number in range(len(plan.rooms)):
        rng = plan.stream(_FURNITURE, number)
        parts = _draw_parts(rng, plan, number, doors[number], standing)
        blocks = [blocks for rank, blocks in sorted(parts, key=lambda part: part[0]) if rank <= furniture]
        rooms = zip(empty, CHECKED_CELLS)
        spaces = [_Space(world, number, plan.rooms[number], doors[number], clear_m) for world, (_, clear_m) in rooms]
        for kept in _that_fit(blocks, [], spaces):
            plan.blocks += kept


def _draw_parts(
    rng: np.random.Generator, plan: FloorPlan, number: int, doors: list[Door], standing: list[Rect]
) -> list[Part]:
    """Draw all furniture that a room could have: pieces that overlap neither each other nor standing ones."""
    rects = plan.rooms[number]
    area = sum(map(_area, rects))
    kind = plan.kinds[number] or ("store" if area < 7 else "office" if area < 24 else "meeting")
    taken = [_door_zone(door) for door in doors]
    taken += [_grown(block, _GAP_M) for block in standing if any(rects_near(block, rect) for rect in rects)]
    walls = plan.bare_walls(number, _DOOR_M[0])
    parts = []
    for name, share in ROOMS[kind].items():
        for _ in range(math.floor(area / share + rng.random())):
            for _ in range(_TRIES):
                if name in ("table", "pod"):
                    piece = _in_the_open(rng, rects, name)
                else:
                    piece = _at_a_wall(rng, plan, walls, rects, name, _PASSAGE_M if kind == "corridor" else 0.3)
                if piece is not None and not any(rects_near(piece.zone, other) for other in taken):
                    parts += piece.parts
                    taken.append(_grown(piece.zone, _GAP_M))
                    break
    return parts


def _at_a_wall(
    rng: np.random.Generator, plan: FloorPlan, walls: list[Side], rects: list[Rect], name: str, beyond_m: float
) -> _Piece | None:
    """Place a piece somewhere along a room's walls, `beyond_m` metres next to it left free; None if it does not fit."""
    length, depth, parts = _wall_piece(rng, name)
    lengths = np.array([side.high - side.low for side in walls])
    if not len(lengths):
        return None
    side = walls[rng.choice(len(walls), p=lengths / lengths.sum())]
    low = side.low + _face(plan, not side.vertical, side.low)
    high = side.high - _face(plan, not side.vertical, side.high)
    if high - low < length:
        return None
    at = low + (high - low - length) * (0.0 if name == "bin" else rng.random())  # a bin stands in a corner
    face = _face(plan, side.vertical, side.wall)
    x0, y0, x1, y1 = side.block(at, 0, at + length, face + depth + beyond_m)
    if not any(a <= x0 and b <= y0 and x1 <= c and y1 <= d for a, b, c, d in rects):
        return None
    placed = [
        (rank, [side.block(at + u0, v0 + face if v0 else 0, at + u1, v1 + face) for u0, v0, u1, v1 in blocks])
        for rank, blocks in parts
    ]
    return _Piece(side.block(at, 0, at + length, face + depth), placed)


def _wall_piece(rng: np.random.Generator, name: str) -> tuple[float, float, list[Part]]:
    """Draw a piece along a wall: length, depth, and its parts: `u` along the wall, `v` away from it, metres."""
    rank, later = rng.random(2)
    later = max(rank, later)
    if name == "desk":
        length, depth = rng.uniform(1.2, 1.7), rng.uniform(0.65, 0.8)
        far = _OFF_WALL_M + depth
        chair = length * rng.uniform(0.35, 0.65) - _CHAIR_M / 2
        legs = _legs(chair, far + 0.1, chair + _CHAIR_M, far + 0.1 + _CHAIR_M)
        return length, far + 0.1 + _CHAIR_M, [(rank, _legs(0, _OFF_WALL_M, length, far)), (later, legs)]
    if name in ("seat", "bench"):
        length = _CHAIR_M if name == "seat" else rng.uniform(1.2, 1.8)
        return length, _OFF_WALL_M + _CHAIR_M, [(rank, _legs(0, _OFF_WALL_M, length, _OFF_WALL_M + _CHAIR_M))]
    if name == "bin":
        near = _OFF_WALL_M / 2
        return near + _BIN_M, near + _BIN_M, [(rank, [(near, near, near + _BIN_M, near + _BIN_M)])]
    length, depth = (rng.uniform(*span) for span in WALL_PIECES[name])
    parts = [(rank, [(0.0, 0.0, length, depth)])]
    if name == "bed":  # and the furniture next to it
        parts.append((later, [(length, 0.0, length + 0.45, 0.45)]))
        length += 0.45
    return length, depth, parts


def _in_the_open(rng: np.random.Generator, rects: list[Rect], name: str) -> _Piece | None:
    """Draw a table with chairs or desks face to face, away from the walls; None if the room is too small."""
    x0, y0, x1, y1 = max(rects, key=_area)
    if name == "pod":  # as many desks in a row as there is room for, all rows one way
        turned, seats = x1 - x0 < y1 - y0, 2 if max(x1 - x0, y1 - y0) > 9 else 1
        length, depth = 1.6 * seats, 1.6
    else:
        turned, length, depth = rng.random() < 0.5, rng.uniform(1.2, 2.4), rng.uniform(0.8, 1.1)
        seats = int(length / 0.75)
    out = 0.1 + _CHAIR_M  # how far chairs reach beyond the table
    sizes = np.array((length, depth + 2 * out)[:: -1 if turned else 1])
    room = np.array((x1 - x0, y1 - y0)) - 2 * _ROUND_M - sizes
    if min(room) < 0:
        return None
    share = rng.random(2)
    if name == "pod" and rng.random() < 0.7:  # in line with others, if columns leave room for that
        steps = np.maximum(1, room // (sizes + _AISLE_M)).astype(int)
        share = rng.integers(steps + 1) / steps
    x, y = (np.array((x0, y0)) + _ROUND_M + share * room).tolist()
    rank = rng.random()
    columns = np.linspace(0.0, length - _LEG_M, 1 + math.ceil(length / 1.7)).tolist()
    parts = [(rank, [_leg(u, v) for u in columns for v in (out, out + depth - _LEG_M)])]
    for i in range(seats):
        chair = length * (i + 0.5) / seats - _CHAIR_M / 2
        for near in (0.0, out + depth + 0.1):
            parts.append((max(rank, rng.random()), _legs(chair, near, chair + _CHAIR_M, near + _CHAIR_M)))

    def placed(u0, v0, u1, v1):
        return (x + v0, y + u0, x + v1, y + u1) if turned else (x + u0, y + v0, x + u1, y + v1)

    parts = [(rank, [placed(*block) for block in blocks]) for rank, blocks in parts]
    return _Piece((x, y, x + float(sizes[0]), y + float(sizes[1])), parts)


def _leg(u: float, v: float) -> Rect:
    return (u, v, u + _LEG_M, v + _LEG_M)


def _legs(u0: float, v0: float, u1: float, v1: float) -> list[Rect]:
    """Return the legs at the corners of a rectangle."""
    return [_leg(u, v) for u in (u0, u1 - _LEG_M) for v in (v0, v1 - _LEG_M)]


def _door_zone(door: Door, before: float = _DOOR_M[1]) -> Rect:
    """Return the area to keep free on both sides of a door."""
    low, high = door.middle - door.width / 2 - _DOOR_M[0], door.middle + door.width / 2 + _DOOR_M[0]
    return Side(door.vertical, door.wall, 1, low, high).block(low, -before, high, before)


def _face(plan: FloorPlan, vertical: bool, wall: float) -> float:
    """Return the distance of a wall's face from its `wall` coordinate, metres."""
    end = plan.width_m if vertical else plan.height_m
    return OUTER_WALL_M if wall < 1e-6 or wall > end - 1e-6 else WALL_THICK_M / 2


def _area(rect: Rect) -> float:
    return (rect[2] - rect[0]) * (rect[3] - rect[1])


def _grown(rect: Rect, by: float) -> Rect:
    x0, y0, x1, y1 = rect
    return x0 - by, y0 - by, x1 + by, y1 + by


class _Space:
    """The cells of one room of an empty building, and whether furniture leaves enough of them to a robot."""

    def __init__(self, world: World, number: int, rects: list[Rect], doors: list[Door], clearance_m: float) -> None:
        low = np.min(rects, axis=0)[:2] - 1.0
        high = np.max(rects, axis=0)[2:] + 1.0
        self.clearance_m, self.cell_m = clearance_m, world.cell_m
        window = block_cells((*np.maximum(low, 0), *high), world.cell_m)
        self.row, self.col = window[0].start, window[1].start
        self.occupied = world.occupied[window]
        rooms = np.asarray(world.rooms)[window]
        self.doors = []
        for door in doors:
            at = np.zeros_like(self.occupied)
            at[self._window(_door_zone(door, OUTER_WALL_M))] = True  # no more of the strip than the wall's thickness
            self.doors.append(at & ~self.occupied & (rooms < 0))
        self.own = np.logical_or.reduce([rooms == number, *self.doors])
        self.parts, self.reach, size = self._state(self.occupied)
        self.least = _LEFT * size

    def _window(self, block: Rect) -> tuple[slice, ...]:
        y, x = block_cells(block, self.cell_m)
        return tuple(slice(max(0, s.start - o), max(0, s.stop - o)) for s, o in ((y, self.row), (x, self.col)))

    def _state(self, occupied: np.ndarray) -> tuple[int, list[bool], int]:
        """Return the number of free components, the doors reached by the largest clear one, and its size."""
        n_parts = int(label_components(self.own & ~occupied).max()) + 1
        main = largest_component(self.own & clear_of_walls(occupied, self.clearance_m, self.cell_m))
        return n_parts, [bool((main & door).any()) for door in self.doors], int(main.sum())

    def fits(self, pieces: Sequence[list[Rect]]) -> bool:
        """Return whether a robot gets through and round the room with these pieces, lists of blocks, in it."""
        occupied = self.occupied.copy()
        for block in (block for blocks in pieces for block in blocks):
            occupied[self._window(block)] = True
        parts, reach, size = self._state(occupied)
        keeps = all(after or not before for before, after in zip(self.reach, reach))
        return parts <= self.parts and keeps and size >= self.least


def _that_fit(pieces: list[list[Rect]], before: list[list[Rect]], spaces: list[_Space]) -> list[list[Rect]]:
    """Return those pieces that fit into a room after others: each one that fits with all accepted before."""
    if not pieces or all(space.fits([*before, *pieces]) for space in spaces):
        return pieces
    if len(pieces) == 1:
        return []
    half = len(pieces) // 2
    first = _that_fit(pieces[:half], before, spaces)
    return first + _that_fit(pieces[half:], [*before, *first], spaces)
