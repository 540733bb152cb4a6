"""The plan of a course in metres: a route of straight passages, and the places along it that become nodes.

A route is drawn as one would walk it. Headings and turns are quarter turns: 0 is +x, 1 is +y, 2 is -x, 3 is -y.
"""

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np

from jexplore.worlds.generators.draft import Rect, rects_near

ROCK_M = 1.0  # wall between two passages that do not meet, and round the whole
CLEAR_GAP_M = ROCK_M - 1e-6  # nearer than this, passages do not keep clear of each other
RAMP_M = 2.4  # length of the way up, and of the way down
RIGHT, STRAIGHT, LEFT = -1, 0, 1
_STEP = ((1, 0), (0, 1), (-1, 0), (0, -1))


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
    """A plan that `course_map.render_course` makes a world of."""

    start: Stop  # the robot's; its heading is that of the course
    areas: list[Rect]  # free
    stops: list[Stop]
    legs: list[Leg]
    ramps: list[Ramp]
    boxes: list[Rect] = dataclasses.field(default_factory=list)  # furniture
    has_goal: bool = False  # the last stop is the goal, and ways that the robot does not take have no end


class CourseRoute(CoursePlan):
    """Plan under construction: the robot stands at `at`, on the centre line, at the end of the carved passage."""

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


def drawn_width(rng: np.random.Generator, width_m: float) -> float:
    """Draw the width of a passage, metres: a multiple of 0.2 m, 0.7 to 1.2 times `width_m` and at least 1.2 m."""
    return max(1.2, fifths(rng, 0.7 * width_m, 1.2 * width_m))


def fifths(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a multiple of 0.2 m from about `low` to about `high`."""
    return 0.2 * int(rng.integers(round(low / 0.2), round(high / 0.2) + 1))


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
