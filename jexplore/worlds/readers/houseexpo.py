"""Floor plans of the HouseExpo data set: an outline in metres and boxes of rooms.

Source:
  Li et al. 2019, HouseExpo. Changed: y points up as everywhere here (its pictures have it down), and the outline is
  a wall, which also keeps plans apart whose walls are thinner than a cell.
"""

import math

import numpy as np

from jexplore.arrays.files import read_json
from jexplore.config import InputError
from jexplore.worlds.bounds import require_side
from jexplore.worlds.world import World

_MAX_BYTES = 16 * 2**20


def load_houseexpo(path: str, *, cell_m: float = 0.1) -> World:
    """Load a world from a HouseExpo plan.

    Cells on the outline are occupied, at least one cell thick; a cell whose centre lies inside is free; all others are
    occupied. A room is a box of a `room_category`, numbered from 0 in the order of the file; where boxes overlap the
    smallest one counts, and of equal ones the first.

    Args:
      path: the JSON file, with `verts` (the closed outline, metres) and `room_category` (name -> boxes
        [x0, y0, x1, y1], metres). Its other keys are not read.
      cell_m: edge of a cell, metres.

    Returns:
      A `World` with `rooms`, -1 at occupied cells and outside all boxes; `rooms` is None if the plan has no box.
      The lower left corner of cell (0, 0) is that of the outline's bounding box.

    Raises:
      InputError: the file cannot be read, is not such a plan, encloses no free cell, or is too large.
    """
    plan = _read_plan(path)
    verts = _numbers(path, "verts", plan.get("verts"), 2)
    if len(verts) < 3:
        raise InputError(f"{path!r}: verts must be at least 3 points [x, y] in metres, got {len(verts)}")
    low = verts.min(axis=0)
    corners = np.round((verts - low) / cell_m, 6)
    cols_rows = np.floor(corners.max(axis=0)) + 1
    require_side(path, cols_rows[1], cols_rows[0], cell_m)
    shape = (int(cols_rows[1]), int(cols_rows[0]))
    occupied = _outline(corners, shape) | ~_inside(corners, shape)
    if occupied.all():
        raise InputError(f"{path!r}: its outline encloses no free cell at cell_m = {cell_m:g}")
    return World(
        occupied=occupied,
        rooms=_rooms(path, plan.get("room_category", {}), low, cell_m, occupied),
        cell_m=cell_m,
        name=path,
        origin_m=(float(low[0]), float(low[1])),
    )


def _read_plan(path):
    plan = read_json(path, _MAX_BYTES)
    if not isinstance(plan, dict) or "verts" not in plan:
        raise InputError(f"{path!r}: is not a HouseExpo plan; expected an object with the key 'verts'")
    return plan


def _numbers(path, key, value, width):
    """Return `[n, width]` float64."""
    try:
        numbers = np.array(value, float) if value else np.empty((0, width))
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty(0)
    if numbers.shape[1:] != (width,) or not np.isfinite(numbers).all() or np.abs(numbers).max(initial=0) > 1e6:
        raise InputError(f"{path!r}: {key} must be a list of [{', '.join(['metres'] * width)}]")
    return numbers


def _edges(corners):
    """Yield edges of the closed outline, the lower end first: x0, y0, x1, y1 in cells."""
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0)):
        yield (x0, y0, x1, y1) if y0 <= y1 else (x1, y1, x0, y0)


def _outline(corners, shape):
    """Return cells that an edge passes through; a cell owns its left and lower sides."""
    wall = np.zeros(shape, bool)
    for x0, y0, x1, y1 in _edges(corners):
        for row in range(math.floor(y0), math.floor(y1) + 1):
            ends = [x0, x1] if y0 == y1 else [x0 + (x1 - x0) * t for t in _clip(row, y0, y1)]
            wall[row, max(0, math.floor(min(ends))) : math.floor(max(ends)) + 1] = True
    return wall


def _clip(row, y0, y1):
    """Return the parts of an edge from y0 up to y1 at which it enters and leaves a row."""
    return (max(row, y0) - y0) / (y1 - y0), (min(row + 1, y1) - y0) / (y1 - y0)


def _inside(corners, shape):
    """Return cells whose centres lie inside the outline, by the even-odd rule."""
    rows, cols = shape
    crossings = np.zeros((rows, cols + 1), np.int32)  # edges that cross a row's centre line left of a cell's centre
    for x0, y0, x1, y1 in _edges(corners):
        row = np.arange(math.ceil(y0 - 0.5), math.ceil(y1 - 0.5))  # y0 <= row + 0.5 < y1
        if row.size:
            x = x0 + (x1 - x0) * (row + 0.5 - y0) / (y1 - y0)
            crossings[row, np.ceil(x - 0.5).astype(int)] += 1
    return np.cumsum(crossings[:, :cols], axis=1) % 2 == 1


def _rooms(path, categories, low, cell_m, occupied):
    if not isinstance(categories, dict):
        raise InputError(f"{path!r}: room_category must map names to lists of boxes [x0, y0, x1, y1]")
    boxes = [_numbers(path, f"room_category {name!r}", of_name, 4) for name, of_name in categories.items()]
    boxes = np.concatenate([*boxes, np.empty((0, 4))])
    if not len(boxes):
        return None
    cells = (boxes - np.tile(low, 2)) / cell_m
    rooms = np.full(occupied.shape, -1, np.int32)
    area = np.abs((cells[:, 2] - cells[:, 0]) * (cells[:, 3] - cells[:, 1]))
    for number in np.lexsort((-np.arange(len(cells)), -area)):  # the largest first, so that the smallest stays
        x0, y0, x1, y1 = cells[number]
        # cells with their centres in the box
        row = _between(min(y0, y1), max(y0, y1), occupied.shape[0])
        col = _between(min(x0, x1), max(x0, x1), occupied.shape[1])
        rooms[row, col] = number
    rooms[occupied] = -1
    return rooms


def _between(low, high, n):
    """Return indices of the cells 0..n-1 with centres from low to below high."""
    first, end = (min(max(math.ceil(value - 0.5 - 1e-6), 0), n) for value in (low, high))
    return slice(first, end)
