"""Floor plans of the HouseExpo data set: an outline in metres and boxes of rooms.

Source:
  Li et al. 2019, HouseExpo. Changed: y points up as everywhere here (its pictures have it down), and the outline is
  a wall, which also keeps plans apart whose walls are thinner than a cell.
"""

import itertools
import math
from typing import Any

import numpy as np

from jexplore.arrays.files import read_json
from jexplore.config import InputError
from jexplore.worlds.bounds import require_side
from jexplore.worlds.readers.grids import inside_polygon
from jexplore.worlds.world import World

_MAX_PLAN_BYTES = 16 * 2**20


def load_houseexpo(path: str, *, cell_m: float = 0.1) -> World:
    """Load a world from a HouseExpo plan: JSON with `verts` (outline) and `room_category` (name -> boxes), metres.

    Cells on the outline are occupied, at least one cell thick; a cell whose centre lies inside is free. A room is a box
    [x0, y0, x1, y1], numbered from 0 in the order of the file; where boxes overlap the smallest one counts, and of
    equal ones the first. The lower left corner of cell (0, 0) is that of the outline's bounding box.
    """
    plan = read_json(path, _MAX_PLAN_BYTES)
    if not isinstance(plan, dict) or "verts" not in plan:
        raise InputError(f"{path!r}: is not a HouseExpo plan; expected an object with the key 'verts'")
    verts, categories = _numbers(path, "verts", plan["verts"], 2), plan.get("room_category", {})
    if len(verts) < 3:
        raise InputError(f"{path!r}: verts must be at least 3 points [x, y] in metres, got {len(verts)}")
    if not isinstance(categories, dict):
        raise InputError(f"{path!r}: room_category must map names to lists of boxes [x0, y0, x1, y1]")
    boxes = itertools.chain(*(_numbers(path, f"room_category {name!r}", own, 4) for name, own in categories.items()))
    low = verts.min(axis=0)
    corners = np.round((verts - low) / cell_m, 6)
    rows, cols = (np.floor(corners.max(axis=0)[::-1]) + 1).astype(int).tolist()
    require_side(path, rows, cols, cell_m)
    occupied = _outline(corners, (rows, cols)) | ~inside_polygon(corners, np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    rooms = _rooms((np.array([*boxes]).reshape(-1, 2, 2) - low) / cell_m, occupied)
    return World(occupied=occupied, rooms=rooms, cell_m=cell_m, name=path, origin_m=(float(low[0]), float(low[1])))


def _numbers(path: str, key: str, value: Any, width: int) -> np.ndarray:
    """Return `[n, width]` float64."""
    try:
        numbers = np.array(value, float) if value else np.empty((0, width))
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty(0)
    if numbers.shape[1:] != (width,) or not np.isfinite(numbers).all() or np.abs(numbers).max(initial=0) > 1e6:
        raise InputError(f"{path!r}: {key} must be a list of [{', '.join(['metres'] * width)}]")
    return numbers


def _outline(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return cells that an edge of the closed outline passes through; a cell owns its left and lower sides."""
    wall = np.zeros(shape, bool)
    for ends in zip(corners, np.roll(corners, -1, axis=0)):
        (x0, y0), (x1, y1) = sorted(ends, key=lambda end: end[1])
        for row in range(math.floor(y0), math.floor(y1) + 1):
            x = [x0, x1]
            if y0 != y1:  # where it enters and leaves the row
                x = [x0 + (x1 - x0) * ((y - y0) / (y1 - y0)) for y in (max(row, y0), min(row + 1, y1))]
            wall[row, max(0, math.floor(min(x))) : math.floor(max(x)) + 1] = True
    return wall


def _rooms(boxes: np.ndarray, occupied: np.ndarray) -> np.ndarray | None:
    """Return the room of every cell, of boxes `[n, 2, 2]`, two corners each in cells; None without any."""
    if not len(boxes):
        return None
    rooms = np.full(occupied.shape, -1, np.int32)
    area = np.abs(np.prod(boxes[:, 1] - boxes[:, 0], axis=1))
    for number in np.lexsort((-np.arange(len(boxes)), -area)):  # the largest first, so that the smallest stays
        # Cells with centres in the box.
        x, y = np.ceil(np.sort(boxes[number], axis=0) - 0.5 - 1e-6).clip(0, occupied.shape[::-1]).astype(int).T
        rooms[slice(*y), slice(*x)] = number
    rooms[occupied] = -1
    return rooms
