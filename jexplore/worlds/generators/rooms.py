"""Rectangular rooms that fill a rectangle, each behind the next."""

import math

import numpy as np

from jexplore.worlds.generators.draft import FloorPlan, Rect
from jexplore.worlds.generators.variants import finish_building
from jexplore.worlds.world import World

_SHARED_M = 1.9  # a stretch of wall that holds the widest door, its jambs and the walls at both ends


def rooms(
    seed: int,
    *,
    cell_m: float = 0.1,
    width_m: float = 20.0,
    height_m: float = 20.0,
    room_m: float = 2.5,
    extra_doors: float = 0.3,
    furniture: float = 0.0,
    wide_openings: float = 0.0,
    max_loops: float = 1000.0,
) -> World:
    """Generate random rectangular rooms without corridors: cut in two again and again, then joined by doors.

    The doors 0.9 to 1.2 m wide are a random spanning tree of the neighbours, and a fraction `extra_doors` of the
    others. `room_m` is the least side of a room, between the middles of its walls; the others are as of
    `finish_building`.
    """
    plan = FloorPlan("rooms", seed, width_m, height_m)
    rng = plan.stream()
    todo = [(0.0, 0.0, width_m, height_m)]
    while todo:
        rect = todo.pop()
        halves = _halves(rng, rect, room_m)
        todo += halves
        if not halves:
            plan.room(rect, kind="mixed")
    pairs = _neighbours(np.array([rects[0] for rects in plan.rooms]))
    group = np.arange(len(plan.rooms))  # rooms that are joined carry one number
    for a, b in rng.permutation(pairs).tolist():
        if group[a] != group[b] or rng.random() < extra_doors:
            plan.door(a, b, rng.uniform(0.9, 1.2), rng.random())
            group[group == group[b]] = group[a]
    return finish_building(plan, cell_m, furniture, wide_openings, max_loops)


def _halves(rng: np.random.Generator, rect: Rect, room_m: float) -> list[Rect]:
    """Cut a rectangle in two, unless it stays one room: too small, or small enough for its draw."""
    x0, y0, x1, y1 = rect
    width, height = x1 - x0, y1 - y0
    small = math.exp(rng.uniform(0.0, 2.7)) * room_m**2
    if max(width, height) < 2 * room_m or (width * height < small and max(width, height) < 2.5 * min(width, height)):
        return []
    share = rng.beta(2.5, 2.5)
    if width >= 2 * room_m and (height < 2 * room_m or rng.random() < width**2 / (width**2 + height**2)):
        x = x0 + room_m + share * (width - 2 * room_m)
        return [(x0, y0, x, y1), (x, y0, x1, y1)]
    y = y0 + room_m + share * (height - 2 * room_m)
    return [(x0, y0, x1, y), (x0, y, x1, y1)]


def _neighbours(rects: np.ndarray) -> np.ndarray:
    """Return pairs of rooms that share enough wall for a door, `[n, 2]`; they join all rooms."""
    x0, y0, x1, y1 = rects.T
    along_x = np.minimum(x1, x1[:, None]) - np.maximum(x0, x0[:, None]) >= _SHARED_M
    along_y = np.minimum(y1, y1[:, None]) - np.maximum(y0, y0[:, None]) >= _SHARED_M
    return np.argwhere(((x0 == x1[:, None]) & along_y) | ((y0 == y1[:, None]) & along_x))
