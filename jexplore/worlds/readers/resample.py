"""From pixels of one size, or polygons, to cells; no resampling ever opens a wall.

A cell is occupied if any occupied pixel overlaps it, whichever of the two is larger. Two free cells side by side
then lie over pixels that are free and connected side by side: what was apart in the picture stays apart in the world,
for a robot and for a beam, both of which go from cell to cell across edges.
"""

import numpy as np

from jexplore.config import InputError
from jexplore.worlds.bounds import count_cells, require_side

LEAST_PIXEL_M, MOST_PIXEL_M = 1e-4, 1e6  # a scale beyond these is a slip of the pen
_SLIVER = 1e-6  # an overlap of less than this part of a pixel, or of a cell at the far edge, is rounding


def resample(occupied: np.ndarray, pixel_m: tuple[float, float], cell_m: float, *, name: str) -> np.ndarray:
    """Resample the occupied cells of a picture. The lower left corners of cell (0, 0) and pixel (0, 0) coincide.

    The last row and column of cells may reach beyond the picture; only the part within counts.

    Args:
      occupied: `[h, w]` bool, row 0 at the bottom.
      pixel_m: `(x, y)`, width and height of a pixel, metres.
      cell_m: edge of a cell, metres.
      name: of the world, for errors.

    Raises:
      InputError: more than `MAX_SIDE` cells a side, or pixels beyond all measure, before anything is allocated.
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
