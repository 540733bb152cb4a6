"""The plan of a course in metres, and its conversion to cells: walls, height of the ground, and the true topology.

Headings and turns are quarter turns: 0 is +x, 1 is +y, 2 is -x, 3 is -y. Every coordinate is rounded to the nearest
edge of a cell on its own, so walls in line stay in line; the topology is made from the rounded plan and is exact for
the cells, not for the drawing.
"""

import dataclasses
import math
from collections.abc import Collection, Sequence

import numpy as np

from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node
from jexplore.tracemap.rooted import topology_from
from jexplore.worlds.bounds import count_cells, require_side
from jexplore.worlds.generators.draft import Rect, to_cells
from jexplore.worlds.world import Course, World

ROCK_M = 1.0  # wall between two passages that do not meet, and round the whole
CLEAR_GAP_M = ROCK_M - 1e-6  # nearer than this, passages do not keep clear of each other
RAMP_M = 2.4  # length of the way up, and of the way down
TREAD_M = 0.30
SILL_M = 0.2
TWIST_M = 1.0  # on which level ground becomes a cross slope
_BESIDE_M = 0.4  # m; the ground of a ramp continues this far into the adjacent walls, for interpolation


@dataclasses.dataclass(frozen=True)
class Ramp:
    """An obstacle across a passage, twice `RAMP_M` long."""

    heading: int
    lane: tuple[float, float]  # the two sides of the passage: their y if it runs along x, else their x
    along: float  # start of the ramp: x if the passage runs along x, else y
    angle_deg: float


@dataclasses.dataclass(frozen=True)
class Stop:
    """A place that becomes a node of the topology."""

    type: str  # like `tracemap.record.Node.type`
    heading: int  # in which the robot comes
    lane: tuple[float, float]  # of the passage, as in `Ramp`
    along: float = 0.0  # as in `Ramp`. Without meaning where there is a rectangle or a ramp
    rect: Rect | None = None  # of a divergence: where its passages overlap; the last stretch of a dead end
    arms: frozenset[int] = frozenset()  # of a divergence: headings of its openings
    ramp: Ramp | None = None
    crease: int = 0  # of an obstacle: which of the places at which its ground changes


@dataclasses.dataclass(frozen=True)
class Leg:
    """A straight way between two stops, or out of one."""

    start: int
    end: int | None
    heading: int
    lane: tuple[float, float]


@dataclasses.dataclass
class CoursePlan:
    """A plan that `render_course` makes a world of."""

    start: Stop  # the robot's; its heading is that of the course
    areas: list[Rect]  # free
    stops: list[Stop]
    legs: list[Leg]
    ramps: list[Ramp]
    boxes: list[Rect] = dataclasses.field(default_factory=list)  # furniture
    has_goal: bool = False  # the last stop is the goal, and ways that the robot does not take have no end


def drawn_width(rng: np.random.Generator, width_m: float) -> float:
    """Draw the width of a passage, metres: a multiple of 0.2 m, 0.7 to 1.2 times `width_m` and at least 1.2 m."""
    return max(1.2, fifths(rng, 0.7 * width_m, 1.2 * width_m))


def fifths(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a multiple of 0.2 m from about `low` to about `high`."""
    return 0.2 * int(rng.integers(round(low / 0.2), round(high / 0.2) + 1))


class _Grid:
    """Metres of a drawing to metres of the cells; `axis` is 0 for x, 1 for y."""

    def __init__(self, rects: list[Rect], cell_m: float) -> None:
        corners = np.array(rects)
        self.low = corners[:, :2].min(axis=0) - ROCK_M
        high = corners[:, 2:].max(axis=0) + ROCK_M
        self.cell_m = cell_m
        self.shape = tuple(count_cells(side, cell_m) for side in (high - self.low)[::-1].tolist())

    def cells(self, value: float, axis: int) -> int:
        """Return the nearest edge between cells."""
        return to_cells((value - float(self.low[axis])) / self.cell_m)

    def snap(self, value: float, axis: int) -> float:
        """Return the same in metres."""
        return round(self.cells(value, axis) * self.cell_m, 9)

    def snap_rect(self, rect: Rect) -> list[float]:
        return [self.snap(value, i % 2) for i, value in enumerate(rect)]

    def box(self, rect: Rect) -> tuple[slice, slice]:
        """Return rows and columns of a rectangle."""
        x0, y0, x1, y1 = (self.cells(value, i % 2) for i, value in enumerate(rect))
        return slice(y0, y1), slice(x0, x1)

    def lane(self, way: Leg | Ramp | Stop) -> list[float]:
        """Return the sides of a passage, metres."""
        return [self.snap(side, 1 - way.heading % 2) for side in way.lane]

    def width(self, leg: Leg) -> float:
        """Return the width of a passage, metres."""
        low, high = (self.cells(side, 1 - leg.heading % 2) for side in leg.lane)
        return round((high - low) * self.cell_m, 9)


def render_course(plan: CoursePlan, cell_m: float, obstacle: str, riser_m: float) -> World:
    """Render a course as a world whose start is the course's; with elevation if it has ramps."""
    grid = _Grid(plan.areas, cell_m)
    require_side("course", *grid.shape)
    occupied = np.ones(grid.shape, bool)
    for rect in plan.areas:
        occupied[grid.box(rect)] = False
    for rect in plan.boxes:
        occupied[grid.box(rect)] = True
    elevation = np.zeros(grid.shape, np.float32)
    for ramp in plan.ramps:
        _raise_ground(elevation, grid, ramp, obstacle, riser_m)
    nodes = tuple(_node(i, stop, grid, obstacle, riser_m) for i, stop in enumerate(plan.stops))
    topology = BtmMap(nodes, _links(plan, nodes, grid))
    start, heading_deg = _node(0, plan.start, grid, obstacle, riser_m), 90.0 * plan.start.heading
    pose = start.x_m, start.y_m, heading_deg
    course = Course(
        start_pose=pose,
        goal_m=(nodes[-1].x_m, nodes[-1].y_m) if plan.has_goal else None,
        topology=topology if plan.has_goal else topology_from(topology, pose),
    )
    cell = int(start.y_m / cell_m), int(start.x_m / cell_m), int(heading_deg)
    ground = elevation if plan.ramps else None
    return World(occupied=occupied, elevation=ground, start=cell, cell_m=float(cell_m), course=course)


def _creases(grid: _Grid, ramp: Ramp, obstacle: str) -> list[float]:
    """Return the positions along a ramp's passage where the ground bends, metres: start, top and end; of stairs both
    ends of the landing, of a platform its ends, of a sill its middle, of a cross slope the middles of its twists.

    A slope has its creases half a cell after the drawing, in the middles of cells: interpolated heights are then exact.
    """
    forward = 1 if ramp.heading < 2 else -1
    run = to_cells(RAMP_M / grid.cell_m) * grid.cell_m
    start = grid.snap(ramp.along, ramp.heading % 2)
    if obstacle == "slope":
        return [start + forward * (grid.cell_m / 2 + k * run) for k in range(3)]
    twist = to_cells(TWIST_M / grid.cell_m) * grid.cell_m
    along = {
        "stairs": (0, run - TREAD_M, run + TREAD_M, 2 * run),
        "platform": (0, 2 * run),
        "sill": (run,),
        "cross-slope": (twist / 2, 2 * run - twist / 2),
    }
    return [start + forward * at for at in along[obstacle]]


def _raise_ground(elevation: np.ndarray, grid: _Grid, ramp: Ramp, obstacle: str, riser_m: float) -> None:
    start, *_, end = _creases(grid, ramp, "slope" if obstacle == "slope" else "platform")
    top = (start + end) / 2
    axis = ramp.heading % 2
    run = abs(top - start)
    middles = (np.arange(elevation.shape[1 - axis]) + 0.5) * grid.cell_m
    inward = run - np.abs(middles - top)  # distance from the nearer end
    if obstacle in ("slope", "cross-slope"):
        height = np.maximum(inward, 0) * math.tan(math.radians(ramp.angle_deg))
    elif obstacle == "stairs":
        height = np.where(inward > 0, (np.floor(inward / TREAD_M + 1e-6) + 1) * riser_m, 0)
    else:
        edge_m = 0 if obstacle == "platform" else run - max(SILL_M / 2, grid.cell_m)
        height = np.where(inward > edge_m + 1e-6, riser_m, 0)
    low, high = min(start, end), max(start, end)
    along = slice(math.floor(low / grid.cell_m + 1e-6), math.ceil(high / grid.cell_m - 1e-6))
    across = slice(
        grid.cells(ramp.lane[0] - _BESIDE_M, 1 - axis),
        grid.cells(ramp.lane[1] + _BESIDE_M, 1 - axis),
    )
    tilt = np.ones(across.stop - across.start)
    if obstacle == "cross-slope":  # it twists to its angle, and rises to one side of the middle by as much as it falls
        middle = sum(grid.lane(ramp)) / 2
        height = np.minimum(height / TWIST_M, math.tan(math.radians(ramp.angle_deg)))
        tilt = (np.arange(across.start, across.stop) + 0.5) * grid.cell_m - middle
    ground = elevation if axis else elevation.T
    ground[along, across] = height[along, None] * tilt


def _node(number: int, stop: Stop, grid: _Grid, obstacle: str, riser_m: float) -> Node:
    about = {}
    if stop.rect is not None:
        x, y, _ = largest_circle(grid.snap_rect(stop.rect), stop.arms)
        return Node(number, x, y, stop.type)
    axis = stop.heading % 2
    if stop.ramp is not None:
        along = _creases(grid, stop.ramp, obstacle)[stop.crease]
        if obstacle in ("slope", "cross-slope"):
            about = {"obstacle": "slope", "inclination_deg": stop.ramp.angle_deg}
        else:
            about = {"obstacle": "stairs", "step_m": riser_m}
    elif stop.type == "free_space":
        along = grid.snap(stop.along, axis)
    else:
        along = round(stop.along - float(grid.low[axis]), 9)
    middle = sum(grid.lane(stop)) / 2
    x, y = (middle, along) if axis else (along, middle)
    return Node(number, x, y, stop.type, **about)


def _links(plan: CoursePlan, nodes: tuple[Node, ...], grid: _Grid) -> tuple[Link, ...]:
    """Return links that the robot follows in the order of following, then the others."""
    links = []
    for leg in sorted(plan.legs, key=lambda leg: leg.end is None):
        width, bearing_deg = grid.width(leg), 90.0 * leg.heading
        link = Link(len(links), leg.start, NOWHERE, "un-searched", start_bearing_deg=bearing_deg, opening_m=width)
        if leg.end is not None:
            ends = [(node.x_m, node.y_m)[leg.heading % 2] for node in (nodes[leg.start], nodes[leg.end])]
            link = dataclasses.replace(
                link,
                end=leg.end,
                status="searched",
                end_bearing_deg=90.0 * ((leg.heading + 2) % 4),
                length_m=round(abs(ends[1] - ends[0]), 9),
                min_width_m=round(width - _furniture(plan.boxes, grid, leg, ends), 9),
            )
        links.append(link)
    return tuple(links)


def _furniture(boxes: list[Rect], grid: _Grid, leg: Leg, ends: list[float]) -> float:
    """Return the width that the deepest piece of furniture takes from a passage between two nodes, metres."""
    axis, sides, deepest = leg.heading % 2, grid.lane(leg), 0.0
    for box in boxes:
        snapped = grid.snap_rect(box)
        middle = [(snapped[i] + snapped[i + 2]) / 2 for i in range(2)]
        if min(ends) < middle[axis] < max(ends) and sides[0] < middle[1 - axis] < sides[1]:
            deepest = max(deepest, snapped[3 - axis] - snapped[1 - axis])
    return deepest


def largest_circle(rect: Sequence[float], arms: Collection[int]) -> tuple[float, float, float]:
    """Return x, y and radius of the largest empty circle at a junction: it touches three walls, at a crossing four.

    `rect`: where the passages overlap; of a dead end, its last stretch. `arms`: headings of the openings.
    """
    x0, y0, x1, y1 = rect
    closed = sorted({0, 1, 2, 3} - set(arms))
    if not closed:
        return (x0 + x1) / 2, (y0 + y1) / 2, ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5 / 2
    size = x1 - x0, y1 - y0
    if len(closed) == 1:  # far wall and the two corners of the stem
        across, stem = size if closed[0] % 2 == 0 else size[::-1]
        radius = across / 2 + stem**2 / (8 * across)
    elif len(closed) == 2:  # two outer walls and the inner corner
        radius = size[0] + size[1] - (2 * size[0] * size[1]) ** 0.5
    else:
        radius = size[(min(arms) + 1) % 2] / 2
    x = x1 - radius if 0 in closed else x0 + radius if 2 in closed else (x0 + x1) / 2
    y = y1 - radius if 1 in closed else y0 + radius if 3 in closed else (y0 + y1) / 2
    return x, y, radius
