"""The picture by which a world shows itself: walls black, rooms in soft colours, the start as an arrow."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from jexplore.arrays.pictures import LONG_PX, soft_colours, written

_FINE = 2  # supersampling factor
ROBOT_PX = 9  # from the middle of the arrow to its tip
ROBOT = (230, 159, 0)


def floor_plan(occupied: np.ndarray, rooms: np.ndarray | None = None, start: Any = None) -> bytes:
    """Draw the arrays and the start of a `World` as the bytes of a PNG, about `LONG_PX` on its longer side.

    A cell is a square of whole pixels; of larger maps a pixel is the mean of several cells: a thin wall becomes grey.
    """
    from PIL import Image, ImageDraw

    colours = _colours(occupied, rooms)
    cells = math.ceil(max(occupied.shape) / (1.5 * LONG_PX))  # to a pixel
    image = Image.fromarray(np.ascontiguousarray(colours[::-1])).reduce(cells)
    pixels = _FINE * max(1, LONG_PX // max(image.size))  # pixels per side of a cell after thinning
    image = image.resize((pixels * image.width, pixels * image.height), Image.Resampling.NEAREST)
    if start is not None:
        row, col, heading_deg = start
        middle = pixels / cells * (col + 0.5), pixels / cells * (occupied.shape[0] - row - 0.5)
        ImageDraw.Draw(image).polygon(list(_arrow(middle, heading_deg)), fill=ROBOT, outline=(0, 0, 0), width=_FINE)
    return written(image.reduce(_FINE))


def draw_plan(
    ax: Any,
    occupied: np.ndarray,
    rooms: np.ndarray | None = None,
    start: Any = None,
    title: str = "",
    *,
    cell_m: float,
    origin_m: tuple[float, float] = (0.0, 0.0),
) -> Any:
    """Draw the arrays and the start of a `World` on matplotlib `Axes`, in metres; return these."""
    (rows, cols), (x_m, y_m) = occupied.shape, origin_m
    extent = (x_m, x_m + cols * cell_m, y_m, y_m + rows * cell_m)
    ax.imshow(_colours(occupied, rooms), origin="lower", extent=extent)
    if start is not None:
        row, col, heading_deg = start
        at, colour = (x_m + (col + 0.5) * cell_m, y_m + (row + 0.5) * cell_m), [channel / 255 for channel in ROBOT]
        ax.plot(*at, marker=(3, 0, heading_deg - 90), markersize=ROBOT_PX, color=colour, markeredgecolor="black")
    ax.set(xlabel="x (m)", ylabel="y (m)")
    ax.set_title(title).set_parse_math(False)
    return ax


def _colours(occupied: np.ndarray, rooms: np.ndarray | None) -> np.ndarray:
    """Return `[H, W, 3]` uint8: walls black, floor white, rooms in soft colours."""
    rooms = None if rooms is None else np.asarray(rooms)
    colours = np.full((*occupied.shape, 3), 255, np.uint8)
    if rooms is not None and rooms.max() >= 0:
        colours[rooms >= 0] = np.array(soft_colours(int(rooms.max()) + 1), np.uint8)[rooms[rooms >= 0]]
    colours[occupied] = 0
    return colours


def _arrow(middle: tuple[float, float], heading_deg: float) -> Iterator[tuple[float, float]]:
    """Yield corners of an arrow head, pixels of the fine image."""
    turn = math.radians(heading_deg)
    for ahead, left in ((1.0, 0.0), (-0.7, 0.7), (-0.3, 0.0), (-0.7, -0.7)):
        x, y = ahead * math.cos(turn) - left * math.sin(turn), ahead * math.sin(turn) + left * math.cos(turn)
        yield middle[0] + _FINE * ROBOT_PX * x, middle[1] - _FINE * ROBOT_PX * y
