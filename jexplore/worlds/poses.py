"""Places as a user writes them: where episodes start, in cells or in metres of the map's frame, and polygons."""

import dataclasses
import itertools
import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from jexplore.config import InputError, require_number, shown, warn_of_input

if TYPE_CHECKING:
    from jexplore.worlds.world import World

ROUNDING_DEG = 0.5  # a heading in whole degrees, or in radians with two decimals, is nearer to what was meant
SNAP = 6  # decimals of a cell to which a point is rounded: 0.3 m lies at the edge of cells of 0.1 m, not before it
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_METRES = re.compile(rf"({_NUMBER}) ?m, ?({_NUMBER}) ?m, ?({_NUMBER}) ?(deg|°|rad|)", re.IGNORECASE)
Polygon = Sequence[tuple[float, float]]
_CELLS = re.compile(r"([-+]?\d{1,9}), ?([-+]?\d{1,9}), ?([-+]?\d{1,9})")


@dataclasses.dataclass(frozen=True)
class Pose:
    """A place and a heading in the frame of a map, as ROS has them."""

    x_m: float
    y_m: float
    yaw_deg: float
    """Counter-clockwise from +x."""

    def __str__(self) -> str:
        return f"{self.x_m:g}m,{self.y_m:g}m,{self.yaw_deg:g}"


def read_start(start: Any, start_m: Any = None) -> "str | tuple[Any, ...] | Pose":
    """Read a start given by a user, and return what the engine takes: a word, cells or a `Pose`.

    `start` is "random"; "world"; cells, `(row, col, heading_deg)` or the text `12,30,90`; or the text `2.0m,1.5m,90`: x
    and y in metres, marked by their `m`, and the yaw in degrees, or in radians as `1.5708rad`. `start_m` is `(x_m, y_m,
    yaw_deg)`, instead of `start`.
    """
    if start_m is not None:
        if start != "random":
            raise InputError(f"start and start_m say the same in cells and in metres: give one, got {start!r} as well")
        try:
            x_m, y_m, yaw_deg = start_m
        except (TypeError, ValueError):
            raise InputError(f"start_m must be x_m, y_m, yaw_deg, got {shown(start_m)}") from None
        return _pose(x_m, y_m, yaw_deg)
    if isinstance(start, Pose) or (isinstance(start, str) and start in ("random", "world")):
        return start
    if isinstance(start, str):
        metres, cells = _METRES.fullmatch(start.strip()), _CELLS.fullmatch(start.strip())
        if metres:
            x_m, y_m, yaw = map(float, metres.groups()[:3])
            return _pose(x_m, y_m, math.degrees(yaw) if metres[4].lower() == "rad" else yaw)
        if cells:
            return tuple(map(int, cells.groups()))
        raise InputError(
            "start must be random, world, cells such as 12,30,90 (row, column, degrees) or metres such as "
            f"2.0m,1.5m,90 (x, y, degrees; radians as 1.57rad), got {shown(start)}"
        )
    try:
        start = tuple(start)
    except TypeError:
        raise InputError(f"start must be random, world, or row, col, heading_deg, got {shown(start)}") from None
    if any(isinstance(value, float) for value in start):
        raise InputError(f"start must be integers row, col, heading_deg; metres go into start_m, got {shown(start)}")
    return start


def _pose(*values: Any) -> Pose:
    for name, value in zip(("x", "y", "yaw"), values):
        require_number(f"{name} of the start", value, low=-1e9, high=1e9)
    return Pose(*map(float, values))


def read_polygon(polygon: str | Polygon) -> list[tuple[float, float]]:
    """Return the corners of a polygon, three or more, metres, from pairs or from text: `x,y x,y x,y`."""
    try:
        pairs = [pair.split(",") for pair in polygon.split()] if isinstance(polygon, str) else polygon
        corners = [(float(x), float(y)) for x, y in pairs]
    except (TypeError, ValueError):
        corners = []
    if len(corners) < 3 or not all(map(math.isfinite, itertools.chain(*corners))):
        raise InputError(
            f"within must be three or more corners (x, y) in metres, such as '0,0 5,0 5,4', got {shown(polygon)}"
        )
    return corners


def cell_at(world: "World", x_m: float, y_m: float, what: str) -> tuple[int, int]:
    """Return row and column of the cell in which a point lies; refuse one outside, which a message calls `what`."""
    rows, cols = world.shape
    (low_x, low_y), cell_m = world.origin_m, world.cell_m
    row, col = (math.floor(round((at - low) / cell_m, SNAP)) for at, low in ((y_m, low_y), (x_m, low_x)))
    if not (0 <= row < rows and 0 <= col < cols):
        raise InputError(
            f"{what}: lies outside; x is {low_x:.6g} to {low_x + cols * cell_m:.6g} m, "
            f"y {low_y:.6g} to {low_y + rows * cell_m:.6g} m"
        )
    return row, col


def cell_of(world: "World", pose: Pose) -> tuple[int, int, int]:
    """Return row and column of the cell in which a pose lies, and the nearest heading of the grid in degrees.

    Warns if the heading changes by `ROUNDING_DEG` or more.
    """
    row, col = cell_at(world, pose.x_m, pose.y_m, f"start {pose} of {world.name or 'world'!r}")
    heading = round(pose.yaw_deg / 45) * 45
    if abs(pose.yaw_deg - heading) >= ROUNDING_DEG:
        warn_of_input(
            f"start {pose}: its yaw of {pose.yaw_deg:g} degrees becomes {heading % 360}, for headings are multiples of "
            "45 degrees",
            stacklevel=2,
        )
    return row, col, heading % 360
