"""Conversion of a course plan to cells: walls, height of the ground, and the true topology.

Every coordinate is rounded to the nearest edge of a cell on its own, so walls in line stay in line; the topology is
made from the rounded plan and is exact for the cells, not for the drawing.
"""

import dataclasses
import math

import numpy as np

from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node
from jexplore.tracemap.rooted import topology_from
from jexplore.worlds.bounds import count_cells, require_side
from jexplore.worlds.generators.draft import Rect, to_cells
from jexplore.worlds.generators.route import RAMP_M, ROCK_M, CoursePlan, Leg, Ramp, Stop, largest_circle
from jexplore.worlds.world import Course, World

TREAD_M = 0.30
SILL_M = 0.2
TWIST_M = 1.0  # on which level ground becomes a cross slope
_BESIDE_M = 0.4  # m; the ground of a ramp continues this far into the adjacent walls, for interpolation


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
    elevation = np.zeros(grid.shape, np.float32) if plan.ramps else None
    if elevation is not None:
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
    return World(occupied=occupied, elevation=elevation, start=cell, cell_m=float(cell_m), course=course)


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
