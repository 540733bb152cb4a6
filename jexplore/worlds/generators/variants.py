"""Irregularities of a drawn building: wide openings, fewer cycles, corridors of different widths.

Each is drawn from a random stream of its own, so that a building without it stays the same.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jexplore.worlds.bounds import MAX_LOOPS
from jexplore.worlds.generators.draft import WALL_THICK_M, Door, FloorPlan, same_place
from jexplore.worlds.generators.furniture import furnish
from jexplore.worlds.world import World

_OPENING_M = (1.6, 2.6)
_JAMB_M = 0.25  # of wall that remains on both sides of an opening
_SHAFT_M = (1.2, 6.0)  # least and greatest length of what narrows a corridor
_MOST_M = 3.0  # the widest, where the corridors are not wider anyway
_LEAST_M = 1.5  # the narrowest corridor between the middles of its walls: 1.3 m in cells of 0.2 m
_AREA_CELL_M = 0.1  # m; cell in which the area is measured: a seed gives the same building at every cell_m
_OPENINGS, _LOOPS, _WIDTHS, _NICHES = 101, 102, 103, 104  # random streams


def corridor_widths(plan: FloorPlan, corridor_m: float, sd_m: float) -> list[float]:
    """Return the width of every corridor, one in every 10 m of depth: all equal, or drawn by a normal distribution."""
    n = max(1, round(plan.height_m / 10))
    drawn = plan.stream(_WIDTHS).normal(corridor_m, sd_m, n)
    return np.clip(drawn, _LEAST_M, max(_MOST_M, corridor_m)).tolist()


def finish_building(
    plan: FloorPlan,
    cell_m: float,
    furniture: float,
    wide_openings: float,
    max_loops: float,
    corridor_sd_m: float = 0.0,
    flips: Sequence[bool] = (False, False),
) -> World:
    """Draw the irregularities of a building and its furniture into the plan, and render it.

    `furniture` is the share of the pieces that exist, see `furniture.furnish`; `wide_openings` the share of the doors
    that are openings 1.6 to 2.6 m wide where the wall allows. Of more than `max_loops` cycles in 1000 m2 doors are
    closed, but none that would cut off a room. `corridor_sd_m` is the standard deviation of the widths of corridors and
    the depth of constrictions, metres. `flips`: mirrored left to right, and bottom to top.
    """
    narrow_corridors(plan, corridor_sd_m)
    limit_loops(plan, max_loops)
    widen_openings(plan, wide_openings)
    furnish(plan, furniture)
    return plan.render(cell_m, flips)


def narrow_corridors(plan: FloorPlan, sd_m: float) -> None:
    """Stand shafts in the corridors, in one wall, away from doors and ends; their depths are half normal."""
    if not sd_m:
        return
    rng = plan.stream(_NICHES)
    corridors = [number for number, of_kind in enumerate(plan.kinds) if of_kind == "corridor"]
    for number, (x0, y0, x1, y1) in [(i, rect) for i in corridors for rect in plan.rooms[i]]:
        vertical, width = (x1 - x0 < y1 - y0), min(x1 - x0, y1 - y0)
        wall = ((x0, x1) if vertical else (y0, y1))[rng.integers(2)]
        first, last = (y0, y1) if vertical else (x0, x1)
        for side in plan.bare_walls(number, _SHAFT_M[0] / 4):
            if side.vertical == vertical and same_place(side.wall, wall):
                length, depth, at = rng.uniform(*_SHAFT_M), abs(rng.normal(0, sd_m)), rng.random()
                low, high = max(side.low, first + width), min(side.high, last - width)
                depth = min(depth, width - _LEAST_M)
                if high - low >= _SHAFT_M[0] and depth >= WALL_THICK_M:
                    low += at * max(high - low - length, 0)
                    plan.blocks.append(side.block(low, 0, min(low + length, high), depth + WALL_THICK_M / 2))


def limit_loops(plan: FloorPlan, max_loops: float) -> None:
    """Close doors until a building has at most `max_loops` cycles per 1000 m2 of free area; none that cuts off a room.

    The doors of rooms with few doors go first, the ways round by the corridors last. A lower limit closes more.
    """
    if max_loops >= MAX_LOOPS:
        return
    pairs = [plan.beside(door) for door in plan.doors]
    n_doors = np.bincount(np.ravel(pairs), minlength=len(plan.rooms))
    order = plan.stream(_LOOPS).permutation(len(pairs)).tolist()
    order.sort(key=lambda i: min(n_doors[list(pairs[i])]))
    group = np.arange(len(plan.rooms))
    tree = set()
    for i in reversed(order):  # the doors that go last hold the building together
        a, b = group[list(pairs[i])]
        if a != b:
            tree.add(i)
            group[group == b] = a
    most = int(max_loops * plan.render(_AREA_CELL_M).free_m2 / 1000)
    spare = [i for i in order if i not in tree]
    closed = set(spare[: max(0, len(spare) - most)])
    plan.doors[:] = [door for i, door in enumerate(plan.doors) if i not in closed]


def widen_openings(plan: FloorPlan, share: float) -> None:
    """Make openings of a share of the doors, as far as their walls are long enough; of a larger share, of some more."""
    rng = plan.stream(_OPENINGS)
    draws = list(zip(rng.permutation(len(plan.doors)).tolist(), rng.uniform(*_OPENING_M, len(plan.doors)).tolist()))
    left = round(share * len(plan.doors))
    for i, width in draws:
        wider = _widened(plan.doors, i, width) if left else None
        if wider is not None:
            plan.doors[i] = wider
            left -= 1


def _widened(doors: list[Door], i: int, width: float) -> Door | None:
    """Widen door `i` to an opening, between the ends of its wall and its other doors; None if it does not fit."""
    door = doors[i]
    low, high = door.low + WALL_THICK_M / 2, door.high - WALL_THICK_M / 2
    for other in doors:
        if other is not door and other.vertical == door.vertical and same_place(other.wall, door.wall):
            if other.middle < door.middle:
                low = max(low, other.middle + other.width / 2)
            else:
                high = min(high, other.middle - other.width / 2)
    low, high = low + _JAMB_M, high - _JAMB_M
    if high - low < _OPENING_M[0]:
        return None
    width = min(width, high - low)
    return dataclasses.replace(door, middle=min(max(door.middle, low + width / 2), high - width / 2), width=width)
