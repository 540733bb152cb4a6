"""From pixels and polygons to cells, and from occupancy grids of ROS to free cells; nothing here ever opens a wall.

A cell is occupied if any occupied pixel overlaps it, whichever of the two is larger. Two free cells side by side
then lie over pixels that are free and connected side by side: what was apart in the picture stays apart in the world,
for a robot and for a beam, both of which go from cell to cell across edges.
"""

import math

import numpy as np

from jexplore.config import InputError, require_whole, warn_of_input
from jexplore.worlds.bounds import count_cells, require_side

FREE_MAX, OCCUPIED_MIN = 25, 65  # per cent, as map_saver has them
_SUSPECT = 0.01  # share of the known cells that another bound would make free without a word
LEAST_PIXEL_M, MOST_PIXEL_M = 1e-4, 1e6  # a scale beyond these is a slip of the pen
_SLIVER = 1e-6  # an overlap of less than this part of a pixel, or of a cell at the far edge, is rounding


def free_cells(
    where: str, occupancy: np.ndarray, *, free_max: int | None = None, occupied_min: int | None = None
) -> np.ndarray:
    """Return the free cells of an occupancy grid, -1 unknown, 0 free to 100 occupied. `where` names it in messages.

    A cell is free up to `free_max`, by default 25 or the values below `occupied_min`, and occupied from `occupied_min`
    on, by default 65 or the values above `free_max`. Cells between the two count as unknown. Warns where `free_max` is
    not given and at least 1 % of the known cells lie between it and 50; refuses that where no cell is free.
    """
    if free_max is not None:
        free_max = require_whole(f"{where}: free_max", free_max, 0, 99)
    if occupied_min is not None:
        occupied_min = require_whole(f"{where}: occupied_min", occupied_min, 1, 100)
    low = min(FREE_MAX, (occupied_min or OCCUPIED_MIN) - 1) if free_max is None else free_max
    high = max(OCCUPIED_MIN, low + 1) if occupied_min is None else occupied_min
    if high <= low:
        raise InputError(f"{where}: occupied_min must be above free_max, got {high} and {low}")
    known, free = occupancy >= 0, (occupancy >= 0) & (occupancy <= low)
    cut = 50 if low < 50 <= high else high
    more = known & ~free & (occupancy < cut)
    if free_max is None and more.sum() >= _SUSPECT * known.sum() > 0:
        share = (known & ~free & (occupancy < high)).sum() / known.sum()
        now = int(free.sum())
        text = (
            f"{where}: {share:.0%} of its known cells are from {low + 1} to {high - 1}, neither free nor occupied, and "
            f"count as unknown; with :free_max={cut - 1},occupied_min={cut} in its name {now + int(more.sum())} cells "
            f"are free, not {now}"
        )
        if not now:
            raise InputError(text)
        warn_of_input(text)
    return free


def require_upright(where: str, shape: tuple[int, ...], yaw_rad: float) -> None:
    """Refuse a grid turned about the lower left corner of its cell (0, 0), if a cell moves by half its edge.

    `where` names it in messages.
    """
    yaw_rad = math.remainder(yaw_rad, 2 * math.pi)
    if abs(yaw_rad) * math.hypot(*shape) >= 0.5:
        raise InputError(
            f"{where}: is turned by {math.degrees(yaw_rad):.4g} degrees; with a yaw of 0 it is the same building"
        )


def resample(occupied: np.ndarray, pixel_m: tuple[float, float], cell_m: float, *, name: str) -> np.ndarray:
    """Resample the occupied cells of a picture `[h, w]`. The lower left corners of cell and pixel (0, 0) coincide.

    The last row and column of cells may reach beyond the picture; only the part within counts. `pixel_m` is width and
    height of a pixel. Too large a world is refused before anything is allocated.
    """
    if not LEAST_PIXEL_M <= min(pixel_m) <= max(pixel_m) <= MOST_PIXEL_M:
        raise InputError(
            f"{name!r}: a pixel must be {LEAST_PIXEL_M:g} to {MOST_PIXEL_M:g} m wide and high, got {pixel_m[0]:g} x "
            f"{pixel_m[1]:g} m"
        )
    rows, cols = (n * size / cell_m for n, size in zip(occupied.shape, reversed(pixel_m)))
    require_side(name, rows - _SLIVER, cols - _SLIVER, cell_m)
    by_rows = _overlapped(occupied, pixel_m[1], cell_m)
    return np.ascontiguousarray(_overlapped(by_rows.T, pixel_m[0], cell_m).T)


def _overlapped(occupied: np.ndarray, pixel_m: float, cell_m: float) -> np.ndarray:
    """Resample along the first axis alone."""
    n = len(occupied)
    edges = np.arange(count_cells(n * pixel_m, cell_m) + 1) * (cell_m / pixel_m)  # cell edges, in pixels
    first = np.minimum(np.floor(edges[:-1] + _SLIVER).astype(int), n - 1)
    last = np.ceil(edges[1:] - _SLIVER).astype(int)  # beyond the picture, a slice ends with it
    out = np.empty((len(first), occupied.shape[1]), bool)
    for k in range(len(first)):
        occupied[first[k] : last[k]].any(axis=0, out=out[k])
    return out


def inside_polygon(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return `[len(y), len(x)]` bool: points inside a polygon `[n, 2]`, by the even-odd rule."""
    inside = np.zeros((len(y), len(x)), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0)):
        if y0 != y1:  # the edge crosses the rows between its ends, and turns round what lies to its left
            rows = (y0 <= y) != (y1 <= y)
            inside[rows] ^= x < (x0 + (y[rows] - y0) / (y1 - y0) * (x1 - x0))[:, None]
    return inside
