"""A robot that follows a route over a trace map by its local map, and notes what it finds otherwise.

It plans to the next node of the route through all that it does not know to be occupied. Places that it recognises put
right where it expects the nodes after them.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from jexplore.arrays.poses import wrapped
from jexplore.driving.local.lattice import Lattice, State, distance_m
from jexplore.driving.local.nodes import TRIES, length_of
from jexplore.driving.local.pilot import LOOK_M, Pilot, RunEnded
from jexplore.driving.local.sight import SeenPlace, look
from jexplore.driving.local.window import CELL_M, SIDE, LocalTask, Window
from jexplore.driving.mission import RunOutcome
from jexplore.driving.params.tree import P

MATCH_M = 1.5  # a place no farther than this from where the map has it is the map's: half of two junctions' distance,
EXIT_COST_M = 0.7  # and each exit that one of them lacks counts as this way off
OFF_COST = 4.0  # a node is gone to as near as its surroundings allow: a metre off costs as much as this way
PASS_M = 0.7  # from another node: there its exits are seen
SHUT_M = 2 * LOOK_M  # a node of no more clearance than this is shut behind the robot: a passage, not free space
MOST = 1.5, 10.0  # the robot is lost after this many times the length of its route, and metres: a passage's detour


class Stop(NamedTuple):
    """A node of a route after the first."""

    xy: np.ndarray  # [2], metres, where the map has it, building's frame
    is_place: bool  # a divergence, to be recognised
    exits: Sequence[float]  # bearings of its exits, radians
    out: float  # bearing by which the route leaves it


class Follower:
    """A robot that follows a route."""

    def __init__(
        self,
        task: LocalTask,
        stops: Sequence[Stop],
        *,
        begin: np.ndarray,
        length_m: float,
        places: np.ndarray,
        on_step: Callable[[], object],
    ) -> None:
        """Stand at the start, on the way from a node at `begin` `[2]` to the first stop.

        `length_m` is the route's; `places` `[n, 2]` are all divergences of the map. `on_step` is called after every
        step.
        """
        self.pilot, tuning = Pilot(task, on_step), task.tuning
        self._robot, self._start = task.fixed.robot, np.asarray(task.start[:2], float)
        self._how, self._at_m = (float(tuning.width_m), float(tuning.open_m)), float(tuning.arrive_m)
        self._most_m = MOST[0] * length_m + MOST[1]
        self._stops, self._places, self._shift = stops, places, np.zeros(2)
        self._left = np.asarray(begin, float)  # the node that the robot has left
        self._exit: np.ndarray | None = None  # the point to leave it by; None: it has left
        self._is_sure = True  # whether that node was recognised
        self._is_there = False  # whether the robot is as near to its goal as it gets
        self.next = 0
        """Stop that the robot goes to."""
        self.walled = False
        """True where a wall blocks its way, not the ground."""
        self.missed, self.extra = 0, list[np.ndarray]()
        self.found: dict[int, list[float]] = {}
        """Stop -> bearings of the exits that were seen at it, radians."""

    def drive(self) -> str:
        """Drive until the run ends; return the outcome."""
        fails = 0
        try:
            while self.pilot.odometer_m < self._most_m and fails <= TRIES:
                self._look()
                while self._is_passed():
                    if self.next == len(self._stops) - 1:
                        return "ARRIVED"
                    self._pass()
                path = self._plan()
                if path is None:
                    fails += 1
                    self.pilot.retrace(float(self._robot.length_m))
                    continue
                if self._is_shut and self._exit is not None:
                    self._exit = None
                    continue
                begin_m, refused = self.pilot.odometer_m, self.pilot.now.refused
                goes, is_at_end = self._go(path)
                self._is_there = self._is_in_reach and is_at_end
                self.walled = self._is_shut and is_at_end
                if self.walled or self.pilot.now.refused > refused:
                    return "BLOCKED" if self._is_sure else "LOST"
                fails = fails + 1 if self.pilot.odometer_m - begin_m < CELL_M else 0
                if not goes:
                    self.pilot.retrace(float(self._robot.length_m))
        except RunEnded as end:
            return "LOST" if end.outcome == RunOutcome.STEP_LIMIT else end.outcome.name
        return "LOST"

    @property
    def _stop(self):
        return self._stops[self.next]

    @property
    def _goal_xy(self):
        return self._exit if self._exit is not None else self._stop.xy + self._shift

    # Perception

    def _look(self):
        self._window = self.pilot.window()
        self._clear_m = distance_m(self._window.occupied)
        self._seen = [
            place
            for place in look(self._window, self.pilot.pose, self._start, *self._how)
            if place.is_sure and place.type == "divergence"
        ]
        self._recognise()
        for place in self._seen:
            is_there = math.dist(place.xy, self.pilot.pose[:2]) < max(PASS_M, place.radius_m)
            known = [*(self._places + self._shift), *self.extra]
            if is_there and all(math.dist(place.xy, xy) > MATCH_M for xy in known):
                self.extra.append(place.xy)

    def _recognise(self):
        self._place = recognised(self._seen, self._stop, self._places, self._shift) if self._stop.is_place else None
        if self._place is not None:
            self._shift = self._place.xy - self._stop.xy

    def _clearance(self, xy):
        cell = self._window.cell(xy)
        return float(self._clear_m[tuple(cell)]) if np.all((cell >= 0) & (cell < SIDE)) else math.inf

    # Nodes

    def _is_passed(self):
        """Return whether the robot is at the stop, or as near as it gets; leave the exit where it is at that."""
        is_last, off_m = self.next == len(self._stops) - 1, math.dist(self._goal_xy, self.pilot.pose[:2])
        if self._exit is not None:
            if off_m < self._at_m or self._is_there:
                self._exit, self._is_there = None, False
            return False
        return self._is_there or off_m < (self._at_m if is_last else max(PASS_M, self._clearance(self._goal_xy) / 2))

    def _pass(self):
        """Note the exits of the stop, and go on to the next one."""
        stop, place, self._left = self._stop, self._place, self._goal_xy
        radius, room = self._shut()
        out_m = max(MATCH_M, room + self._at_m) if radius < SHUT_M else MATCH_M
        ahead = self._left + out_m * np.array([math.cos(stop.out), math.sin(stop.out)])
        if stop.is_place:
            self._is_sure = place is not None
            self.missed += place is None
        if place is not None:
            long = [way for way in place.ways if way.to >= 0 or length_of(way.path) > place.radius_m + LOOK_M]
            self.found[self.next] = [way.bearing for way in long]
            ways = [way for way in place.ways if not is_new(way.bearing, [stop.out])]
            if ways:
                path = min(ways, key=lambda way: abs(wrapped(way.bearing - stop.out))).path
                near = np.hypot(*(path - place.xy).T) < out_m
                ahead = path[-1] if near.all() else path[int((~near).argmax())]
        self.next, self._is_there = self.next + 1, False
        self._recognise()
        self._exit = ahead if math.dist(self._left, self._stop.xy + self._shift) > 2 * out_m else None

    # Ways

    def _shut(self):
        """Return the radius in which the node that it has left is shut, and the distance from where it fits."""
        radius = self._clearance(self._left) + CELL_M
        return radius, radius + math.hypot(float(self._robot.length_m), float(self._robot.width_m)) / 2 + 2 * CELL_M

    def _plan(self) -> list[State] | None:
        """Return a path to the goal, towards it, or to where its way is shut; None where the robot cannot move."""
        window, pose, xy = self._window, self.pilot.pose, self._goal_xy
        row, col = np.mgrid[:SIDE, :SIDE]
        cells = window.xy(np.stack([row, col], -1))
        radius, room = self._shut()
        if self._exit is None and radius < SHUT_M and all(math.dist(self._left, at) > room for at in (pose[:2], xy)):
            behind = np.hypot(*np.moveaxis(cells - self._left, -1, 0)) < radius
            window = Window(window.corner, window.occupied | behind, window.known)
        lattice = Lattice(window, pose, self._robot, through_unknown=True)
        off = np.hypot(*np.moveaxis(cells - xy, -1, 0))
        cost = np.where(off < LOOK_M, lattice.cost + OFF_COST * off, math.inf)
        self._is_in_reach = bool(np.isfinite(cost).any())
        if not self._is_in_reach:
            edge = (np.minimum(row, col) == 1) | (np.maximum(row, col) == SIDE - 2)
            cost = np.where(edge, lattice.cost + off, math.inf)
        self._is_shut = bool(np.isinf(cost).all())
        if self._is_shut:  # a wall, or high ground: the robot goes there to see
            cost = np.where(np.isfinite(lattice.cost), off, math.inf)
        cell = np.array(np.unravel_index(cost.argmin(), cost.shape))
        return lattice.path_to(cell) if np.isfinite(cost[tuple(cell)]) else None

    def _go(self, path):
        """Follow a path to the next look in known cells, and turn to the first unknown one.

        Return whether it could, and whether it is at the end.
        """
        gone_m, n = 0.0, 1
        while n < len(path) and gone_m < LOOK_M and self._window.known[tuple(path[n].cell)]:
            gone_m += math.dist(path[n].cell, path[n - 1].cell) * CELL_M
            n += 1
        goes = self.pilot.follow(path[:n], self._window, LOOK_M)
        if n < len(path) and gone_m < LOOK_M:
            off = self._window.xy(path[n].cell) - self.pilot.pose[:2]
            goes = self.pilot.turn_to(math.atan2(off[1], off[0])) and goes
        off_m = math.dist(self._window.xy(path[-1].cell), self.pilot.pose[:2])
        return goes, off_m < self._at_m / 2


def recognised(seen: Sequence[SeenPlace], stop: Stop, places: np.ndarray, shift: np.ndarray) -> SeenPlace | None:
    """Return which of the places seen is a stop of the map; None without one.

    It lies near where the map, moved by `shift` `[2]`, has the stop, and no nearer to another of its `places` `[n, 2]`.
    """

    def off_m(place):
        ways = [way.bearing for way in place.ways]
        only = sum(is_new(a, two) for one, two in ((ways, stop.exits), (stop.exits, ways)) for a in one)
        return math.dist(place.xy, stop.xy + shift) + EXIT_COST_M * only

    def is_nearest(place):
        nearest = places[np.hypot(*(places + shift - place.xy).T).argmin()]
        return math.dist(nearest, stop.xy) < CELL_M

    return min((place for place in seen if off_m(place) < MATCH_M and is_nearest(place)), key=off_m, default=None)


def is_new(bearing: float, others: Iterable[float]) -> bool:
    """Return whether a bearing differs from those of all other exits; radians."""
    return all(abs(wrapped(bearing - other)) > P.places.same_exit_rad for other in others)
