"""Occupancy grids of ROS: which of their cells are free, and grids that lie turned in their frame."""

import math
import warnings

import numpy as np

from jexplore.config import InputError, InputWarning, require_whole

FREE_MAX, OCCUPIED_MIN = 25, 65  # per cent, as map_saver has them
_SUSPECT = 0.01  # share of the known cells that another bound would make free without a word
_SLIVER = 1e-6  # an overlap of less than this part of a cell is rounding


def free_cells(
    where: str, occupancy: np.ndarray, *, free_max: int | None = None, occupied_min: int | None = None
) -> np.ndarray:
    """Return the free cells of an occupancy grid, -1 unknown, 0 free to 100 occupied. `where` names it in messages.

    Args:
      free_max: a cell is free if its occupancy is from 0 to this. Default: 25, or the values below `occupied_min`.
      occupied_min: a cell is occupied if its occupancy is this or more. Default: 65, or the values above `free_max`.
        Cells between the two count as unknown.

    Warns:
      InputWarning: `free_max` is not given, and at least 1 % of the known cells lie between it and 50.

    Raises:
      InputError: a bound that is no integer or out of range, `occupied_min` is not above `free_max`, or no cell is free
        where the warning would be given.
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
        warnings.warn(text, InputWarning, stacklevel=3)
    return free


def upright(
    where: str, occupancy: np.ndarray, yaw_rad: float, resolution_m: float, origin_m: tuple[float, float]
) -> tuple[np.ndarray, tuple[float, float]]:
    """Resample a grid that lies turned in its frame to one whose rows run along x.

    A turn that is a multiple of 90 degrees moves whole cells; so does one that differs from it by so little that no
    cell is moved by half its edge. At another angle a cell has the largest occupancy of all cells that it overlaps, the
    unknown above all but 100: no wall opens. Where its centre lies outside the grid it is unknown.

    Args:
      where: what the warning, that the grid has been turned, calls it.
      occupancy: `[H, W]` integers, -1 unknown, 0 free to 100 occupied.
      yaw_rad: turn about the lower left corner of cell (0, 0), counter-clockwise.
      resolution_m: edge of a cell, metres.
      origin_m: x, y of that corner, metres.

    Returns:
      The new grid, and its own `origin_m`.
    """
    yaw_rad = math.remainder(yaw_rad, 2 * math.pi)
    quarters = round(yaw_rad / (math.pi / 2))
    rest_rad = yaw_rad - quarters * (math.pi / 2)
    rows, cols = occupancy.shape
    whole = abs(rest_rad) * math.hypot(rows, cols) < 0.5
    quarters %= 4
    if whole and not quarters:
        return occupancy, origin_m
    if whole:
        turned = np.ascontiguousarray(np.rot90(occupancy, -quarters))
        low = ((0, 0), (-rows, 0), (-cols, -rows), (0, -cols))[quarters]
        turned_deg, how = (0, 90, 180, -90)[quarters], "cell for cell"
    else:
        turned, low = _turned_grid(occupancy, yaw_rad)
        turned_deg, how = math.degrees(yaw_rad), "and only cells that overlap nothing occupied or unknown are free"
    warnings.warn(
        f"{where}: is turned by {turned_deg:.4g} degrees; its cells have been laid along x and y, {how}",
        InputWarning,
        stacklevel=4,
    )
    x_m, y_m = (at + n * resolution_m for at, n in zip(origin_m, low))
    return turned, (x_m, y_m)


def _turned_grid(occupancy: np.ndarray, yaw_rad: float) -> tuple[np.ndarray, tuple[float, float]]:
    """Turn the grid by any angle, and return its lower left corner: x, y in cells from the old one."""
    rows, cols = occupancy.shape
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    x, y = (np.array([0, cols, 0, cols]) * a + np.array([0, 0, rows, rows]) * b for a, b in ((cos, -sin), (sin, cos)))
    low_x, low_y = float(x.min()), float(y.min())
    shape = tuple(math.ceil(float(np.ptp(side)) - _SLIVER) for side in (y, x))
    # 100 is 200, unknown 199; a border of 0, of which nothing is told.
    rank = np.pad(np.where(occupancy < 0, 199, 2 * occupancy.astype(np.int16)), 1)
    reach = 0.5 + (abs(cos) + abs(sin)) / 2 - _SLIVER  # touching squares are this far apart along one of four axes
    out = np.full(shape, 199, np.int16)
    x = np.arange(shape[1]) + 0.5 + low_x
    for row in range(shape[0]):
        y = row + 0.5 + low_y
        u, v = cos * x + sin * y, cos * y - sin * x  # the centres, in cells of the old grid
        (inside,) = np.nonzero((u >= 0) & (u < cols) & (v >= 0) & (v < rows))
        u, v = u[inside], v[inside]
        at_col, at_row = u.astype(int), v.astype(int)
        u, v = at_col + 0.5 - u, at_row + 0.5 - v
        worst = np.zeros(len(inside), np.int16)
        for i, j in np.ndindex(3, 3):
            du, dv = u + (j - 1), v + (i - 1)
            apart = np.maximum(np.abs(du), np.abs(dv))
            apart = np.maximum(apart, np.maximum(np.abs(cos * du - sin * dv), np.abs(sin * du + cos * dv)))
            np.maximum(worst, np.where(apart < reach, rank[at_row + i, at_col + j], 0), out=worst)
        out[row, inside] = worst
    return np.where(out == 199, -1, out // 2).astype(occupancy.dtype), (low_x, low_y)
