"""A course for trace maps: passages, a slope, junctions and a hall, with its true topology."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jexplore.worlds.bounds import CREASES
from jexplore.worlds.generators.course_map import (
    CLEAR_GAP_M,
    RAMP_M,
    CoursePlan,
    Leg,
    Ramp,
    Stop,
    drawn_width,
    fifths,
    render_course,
)
from jexplore.worlds.generators.draft import Rect, random_stream, rects_near
from jexplore.worlds.generators.network import draw_network
from jexplore.worlds.world import World

RIGHT, STRAIGHT, LEFT = -1, 0, 1
_STEP = ((1, 0), (0, 1), (-1, 0), (0, -1))
_START_M = 1.5  # from the wall behind the start
_ATTEMPTS = 60
_JUNCTIONS = (
    ((RIGHT, LEFT), 0.2),
    ((RIGHT, STRAIGHT), 0.2),
    ((STRAIGHT, LEFT), 0.15),
    ((RIGHT, STRAIGHT, LEFT), 0.15),
    ((LEFT,), 0.2),
    ((RIGHT,), 0.1),
)
"""Openings, and how often: T from its stem, T from either side, crossing, corners."""


def course(
    seed: int,
    *,
    cell_m: float = 0.1,
    width_m: float = 2.0,
    obstacle: str = "slope",
    riser_m: float = 0.10,
    furniture: bool = False,
    dead_ends: bool = True,
    loops: int = 0,
    repeat: int = 0,
) -> World:
    """Generate a course from start to goal, for a robot that takes the first way counter-clockwise from behind.

    Seed 0 is the course described in the paper: a passage, a slope of 10 degrees up and down, a junction (right), an
    elevator hall passed along its right wall, a junction (right), the goal; the lengths are ours. Every other seed
    draws lengths, widths, the angle (6 to 15 degrees), the elements and their order. Ways that the robot does not take
    are at least 6 m long. `World.course` has start, goal and true topology: a divergence lies at the centre of the
    largest empty circle that touches three walls, links run along the centre lines, and their bearings are those of the
    passages. With `loops` or `repeat` there is no goal, and the topology is whole.

    All lengths are multiples of 0.2 m: a seed gives the same course for every `cell_m` that divides 0.2 m; at other
    cells widths are rounded to whole cells, and the topology with them.

    Args:
      seed: integer from 0.
      cell_m: edge of a cell, metres, at most 0.2.
      width_m: width of the passages, metres; for seeds from 1 they have 0.7 to 1.2 times this, and at least 1.2 m.
      obstacle: `slope`; in the same layout `stairs` of the same length, with treads of 0.3 m; a `platform` of one step
        up and one down; a `sill` 0.2 m long, two cells at least; a `cross-slope`, which rises to one side; `none`.
      riser_m: height of a step, metres.
      furniture: small boxes stand along some walls; they leave at least 1.2 m. The topology has no divergence there.
      dead_ends: a way to the right, or a ring, may have a dead end, for seeds from 1.
      loops: number of independent cycles, 0 to 3: rings of at least 20 m, apart or with a side in common.
      repeat: number of T junctions, 0 or 2 to 10, equally far apart and alike; with `loops`, on the first ring.

    Source:
      Mano et al. 2009, Autonomous generation of Behavioral Trace Maps using rescue robots.
    """
    rng, creases = random_stream(seed, "course"), CREASES[obstacle]
    if loops or repeat:
        plan = draw_network(rng if seed else None, width_m, creases, loops, repeat, dead_ends)
    else:
        plan = _draw_route(rng, width_m, creases, dead_ends) if seed else _route_of_paper(width_m, creases)
        if furniture:
            _furnish(rng, plan)
    return render_course(plan, cell_m, obstacle, riser_m)


class CourseRoute(CoursePlan):
    """Plan under construction, drawn as one would walk it.

    The robot stands at `at`, on the centre line, at the end of the carved passage.
    """

    def __init__(self, heading: int, width: float, start_m: float) -> None:
        """Begin with a wall, and the robot `start_m` before it with its back to it."""
        self.at, self.heading, self.width = (0.0, 0.0), heading, width
        self.part = 0
        self.fits = True
        """False once a passage came too near to an earlier one. Neighbouring parts of a route cannot."""
        self.straights: list[tuple[Rect, int]] = []
        self._last: int | None = None
        self._parts: list[int] = []
        super().__init__(self._stop("terminal"), [], [], [], [], has_goal=True)
        self._carve(start_m)
        self._advance(start_m)
        self.start = self._stop("terminal")
        self._arrive(self.start)

    def passage(self, length: float) -> None:
        """Go on straight. Every passage begins a part of the route; what follows it belongs to the same part."""
        self.part += 1
        rect = self._carve(length)
        self.straights.append((rect, self.heading))
        self._advance(length)

    def ramp(self, angle_deg: float, creases: int = 3) -> None:
        """Add an up-and-down obstacle with a number of creases. With 0 it is omitted, but its place remains."""
        self._carve(2 * RAMP_M)
        if creases:
            ramp = Ramp(self.heading, self._lane(), self._along(), angle_deg)
            self.ramps.append(ramp)
            for crease in range(creases):
                self._arrive(dataclasses.replace(self._stop("obstacle"), ramp=ramp, crease=crease))
        self._advance(2 * RAMP_M)

    def hall(self, length: float, depth: float, side: int) -> None:
        """Add a free space: one wall of the passage steps back by `depth`, on the `side` LEFT or RIGHT."""
        self._arrive(self._stop("free_space"))
        self._carve(length, (-side * self.width / 2, side * (self.width / 2 + depth)))
        self._advance(length)
        self._arrive(self._stop("free_space"))

    def junction(self, turns: Sequence[int], width: float, stub_m: float, dead_m: float = 0.0) -> None:
        """Add a corner, T or crossing. The robot takes the first way counter-clockwise from the way in.

        `turns` have an opening, the passage across is `width` wide, and passages that the robot does not take are
        `stub_m` long. With `dead_m` it first takes a passage so long, a dead end, and returns from it.
        """
        rect = self._carve(width)
        openings = [self.heading + 2, *(self.heading + turn for turn in turns)]
        node = self._arrive(self._stop("divergence", rect, openings))
        before = self.at, self.heading, self.width
        todo = sorted(turns)
        if dead_m:
            self._turn(before, todo.pop(0), width)
            self._carve(dead_m - self.width)
            self._advance(dead_m - self.width)
            end = self._stop("divergence", self._carve(self.width), [self.heading + 2])
            self._arrive(end)
            self._last = node
        for turn in todo[1:]:
            self._turn(before, turn, width)
            self._carve(stub_m)
            self.legs.append(Leg(node, None, self.heading, self._lane()))
        self._turn(before, todo[0], width)

    def goal(self, length: float, beyond: float) -> None:
        """Add the goal after `length` of passage; the passage goes on for `beyond`."""
        self.passage(length)
        self._arrive(self._stop("terminal"))
        self._carve(beyond)

    def _lane(self) -> tuple[float, float]:
        middle = self.at[1 - self.heading % 2]
        return middle - self.width / 2, middle + self.width / 2

    def _along(self) -> float:
        return self.at[self.heading % 2]

    def _stop(self, kind: str, rect: Rect | None = None, openings: Sequence[int] = ()) -> Stop:
        arms = frozenset(opening % 4 for opening in openings)
        return Stop(kind, self.heading, self._lane(), self._along(), rect, arms)

    def _arrive(self, stop: Stop) -> int:
        self.stops.append(stop)
        number = len(self.stops) - 1
        if self._last is not None:
            self.legs.append(Leg(self._last, number, self.heading, self._lane()))
        self._last = number
        return number

    def _advance(self, length: float) -> None:
        dx, dy = _STEP[self.heading]
        self.at = self.at[0] + dx * length, self.at[1] + dy * length

    def _turn(self, before: tuple[tuple[float, float], int, float], turn: int, width: float) -> None:
        """Stand in the mouth of one arm of a junction whose near side is at `before`."""
        self.at, self.heading, self.width = before
        if turn == STRAIGHT:
            self._advance(width)
            return
        self._advance(width / 2)
        self.heading = (self.heading + turn) % 4
        self._advance(self.width / 2)
        self.width = width

    def _carve(self, length: float, sides: tuple[float, float] | None = None) -> Rect:
        """Free a rectangle ahead; `sides` are its two sides, metres to the left of the centre line."""
        right, left = sides or (-self.width / 2, self.width / 2)
        (dx, dy), (x, y) = _STEP[self.heading], self.at
        xs = sorted(round(x + dx * a - dy * b, 6) for a, b in ((0.0, right), (length, left)))
        ys = sorted(round(y + dy * a + dx * b, 6) for a, b in ((0.0, right), (length, left)))
        rect = xs[0], ys[0], xs[1], ys[1]
        earlier = (other for part, other in zip(self._parts, self.areas) if part < self.part - 1)
        self.fits &= not any(rects_near(rect, other, CLEAR_GAP_M) for other in earlier)
        self._parts.append(self.part)
        self.areas.append(rect)
        return rect


def _route_of_paper(width_m: float, creases: int) -> CourseRoute:
    route = CourseRoute(0, width_m, _START_M)
    route.passage(4.1)
    route.ramp(10.0, creases)
    route.passage(5.0)
    route.junction((RIGHT, LEFT), width_m, 7.0)
    route.passage(5.0)
    route.hall(6.0, 5.0, LEFT)
    route.passage(5.0)
    route.junction((RIGHT, STRAIGHT), width_m, 7.0)
    route.goal(5.0, 7.0)
    return route


def _draw_route(rng: np.random.Generator, width_m: float, creases: int, dead_ends: bool) -> CourseRoute:
    """Draw a route that keeps clear of itself: with fewer elements if many do not fit. Two always do."""
    for n_elements in range(int(rng.integers(4, 9)), 1, -1):
        for _ in range(_ATTEMPTS):
            route = _attempt(rng, n_elements, width_m, creases, dead_ends)
            if route.fits:
                return route
    raise AssertionError("a route of two elements keeps clear of itself")


def _attempt(rng: np.random.Generator, n_elements: int, width_m: float, creases: int, dead_ends: bool) -> CourseRoute:
    elements = ["ramp", "junction", *(["hall"] if n_elements > 2 and rng.random() < 0.8 else [])]
    elements += ["junction"] * (n_elements - len(elements))
    route = CourseRoute(int(rng.integers(4)), drawn_width(rng, width_m), _START_M)
    first_m = 0.1  # brings the first passage to whole multiples
    for element in rng.permutation(elements):
        route.passage(fifths(rng, 4.4, 7.0) + first_m)
        first_m = 0.0
        if element == "ramp":
            route.ramp(float(rng.integers(6, 16)), creases)
        elif element == "hall":
            route.hall(fifths(rng, 5.0, 8.0), fifths(rng, 4.0, 6.0), int(rng.choice((LEFT, RIGHT))))
        else:
            turns = _JUNCTIONS[rng.choice(len(_JUNCTIONS), p=[weight for _, weight in _JUNCTIONS])][0]
            dead_m = fifths(rng, 5.0, 7.0) if rng.random() < 0.4 else 0.0
            possible = dead_ends and RIGHT in turns and len(turns) > 1
            route.junction(turns, drawn_width(rng, width_m), fifths(rng, 6.2, 8.0), dead_m if possible else 0.0)
    route.goal(fifths(rng, 5.0, 7.0), fifths(rng, 6.2, 8.0))
    return route


def _furnish(rng: np.random.Generator, route: CourseRoute) -> None:
    """Place a box at a wall of some passages, no nearer than 1.6 m to their ends, where the nodes are."""
    for rect, heading in route.straights:
        along, across = (1, 0) if heading % 2 else (0, 1)
        length, width = (rect[axis + 2] - rect[axis] for axis in (along, across))
        depth = min(0.4, 0.2 * int((width - 1.2 + 1e-6) / 0.2))
        size = fifths(rng, 0.4, 0.8)
        start = fifths(rng, 1.6, max(1.6, length - 1.6 - size))
        at_high = bool(rng.integers(2))
        if depth <= 0 or rng.random() >= 0.4:
            continue
        box = list(rect)
        box[along], box[along + 2] = rect[along] + start, rect[along] + start + size
        if at_high:
            box[across] = rect[across + 2] - depth
        else:
            box[across + 2] = rect[across] + depth
        x0, y0, x1, y1 = box
        route.boxes.append((x0, y0, x1, y1))
