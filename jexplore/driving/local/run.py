"""A run: look, enter the places seen, go to the nearest place or exit that is left, until all are searched.

The robot goes to exits in the local map first, nearest by the cost of driving there. Without one it follows links to
the nearest node that has one. Where nothing can be reached it goes back the way it came.
"""

import math
from collections.abc import Callable

import numpy as np

from jexplore.driving.local.area import SeenArea, nearest_to
from jexplore.driving.local.lattice import CLOSE_COST, Lattice, distance_m
from jexplore.driving.local.nodes import NEAR_M, TRIES, Exit, TraceMap, length_of
from jexplore.driving.local.pilot import LOOK_M, Pilot, RunEnded
from jexplore.driving.local.sight import SeenPlace, look
from jexplore.driving.local.window import SIDE, LocalTask
from jexplore.driving.mission import RunOutcome
from jexplore.driving.records import RunMode
from jexplore.driving.vehicle import DT_S, SCAN_RANGE_M

LINK_M = 1.5  # the robot looks anew at the end of the straight piece of a link on which it has come this far
POINT_M = 0.3  # a point of a path is reached from a cell no farther away
PLACE_M = 1.5  # a place is gone to as near as its clearance, and no farther off than this
FACE_M = 0.15  # the robot turns towards the end of what it knows of a way if that lies farther away
RETRACES = 2 * TRIES  # times in a row that the robot goes back before it is STUCK, twice as far each time
SURE_RETRACES = TRIES - 1  # and before it gives up what no route leads to
MOST_IDLE = 30  # looks in a row without a step in between, after which the robot is STUCK


class LocalRun:
    """A robot that writes its trace map."""

    def __init__(self, task: LocalTask, on_step: Callable[["LocalRun"], object]) -> None:
        """Begin at the start; of the thresholds width and clearance of passages, speed and gain count.

        `on_step` is called with the run after every step.
        """
        self._tuning, self._start = task.tuning, np.asarray(task.start[:2], float)
        self.pilot = Pilot(task, lambda: on_step(self))
        self.robot = task.fixed.robot
        self.map = TraceMap(self._start, self.pilot.now.truth[:2].astype(float))
        self.mistaken = 0
        self._at, self._since = 0, 0  # the node that the robot was at last, and the step then
        self._target: tuple[int, Exit | None] | None = None
        self._stops = 0  # times that something stopped it where it set off, since it last came to a target
        self._node_of: dict[int, int] = {}
        self._hoped: Lattice | None = None
        self._area = SeenArea()
        self._frontiers: list[np.ndarray] = []  # in the local map
        self.seen: list[SeenPlace] = []
        """Places of the last look."""

    def drive(self) -> RunOutcome:
        """Drive until the run ends; return its outcome."""
        try:
            heading = float(self.pilot.pose[2])
            for quarter in range(1, 5):
                self.pilot.turn_to(heading + quarter * math.pi / 2)
            retraces, idle, steps, known = 0, 0, 0, 0
            while idle < MOST_IDLE:
                idle, steps = (idle + 1 if steps == len(self.pilot.way) else 0), len(self.pilot.way)
                self._look()
                if self._go_near() or self._go_to_frontier():
                    retraces = 0
                elif not (goals := self._open_nodes() or self._near_frontiers()):
                    return RunOutcome.EXHAUSTED if np.isfinite(self._lattice.cost).any() else RunOutcome.STUCK
                elif (here := self._here()) is None or self._is_shut_in():
                    if retraces >= RETRACES:
                        return RunOutcome.STUCK
                    if here is None and not retraces:
                        self._go_straight()
                    else:
                        self.pilot.retrace(LOOK_M * 2**retraces)
                    retraces += 1
                elif self._doubt_shut(goals):
                    retraces = 0
                    self.pilot.retrace(float(self.robot.length_m))
                elif route := self.map.route(here, goals) or self.map.route(here, self._near_frontiers()):
                    retraces = 0
                    self._go_along(route)
                elif retraces < SURE_RETRACES:
                    self.pilot.retrace(LOOK_M * 2**retraces)
                    retraces += 1
                elif here in goals:
                    self._give_up(here)
                elif len(self.map.nodes) > known and self._is_cut_off(here, goals) and self.map.forget_failures():
                    retraces, known = 0, len(self.map.nodes)  # once for all that is new
                else:
                    return RunOutcome.EXHAUSTED if self._is_free(here) else RunOutcome.STUCK
        except RunEnded as end:
            return end.outcome
        return RunOutcome.STUCK

    def _is_free(self, here):
        return here == 0 or self.map.route(here, {0}) is not None

    def _is_cut_off(self, here, goals):
        """Return whether no link leads on to a node where the robot has been."""
        return not self._is_free(here) or any(self.map.nodes[i].is_visited for i in goals)

    def _give_up(self, at):
        """Give up the exits of a node that the robot is at, and the frontiers near it: it cannot reach them."""
        self.map.nodes[at].is_visited = True
        for exit_ in self.map.nodes[at].exits:
            exit_.tries = TRIES
        self._leave_frontiers(at)

    # Perception

    def _look(self):
        window, pose = self.pilot.window(), self.pilot.pose
        self._lattice, self._hoped = Lattice(window, pose, self.robot), None
        self._area.add(window, float(self._tuning.width_m))
        self._frontiers = self._area.frontiers(window)
        how = float(self._tuning.width_m), float(self._tuning.open_m)
        self.seen = look(self._area.around(window), pose, self._start, *how)
        self._node_of = self.map.note(self.seen, pose, self.pilot.now.truth)
        self._drop_disproved()
        self._visit()

    def _drop_disproved(self):
        """Drop nodes where the robot has not been that it would see now if they were places."""
        edge_m, found = distance_m(np.any(self._frontiers or [np.zeros((SIDE, SIDE), bool)], axis=0)), []
        for i, node in enumerate(self.map.nodes):
            is_kept = node.is_visited or i == self._at or i in self._node_of.values()
            if is_kept or math.dist(node.xy, self.pilot.pose[:2]) > NEAR_M:
                continue
            near = self._lattice.nearest(node.xy, node.reached_m)
            if near and near[1] < 2 * NEAR_M and edge_m[tuple(self._lattice.window.cell(node.xy))] > node.radius_m:
                found.append(i)
        for i in found[::-1]:
            self.map.drop(i)
            self._at, self._target = self._at - (self._at > i), None
            self._node_of = {place: at - (at > i) for place, at in self._node_of.items()}

    def _visit(self):
        """Note which nodes the robot is at, and the link that it has driven from the last one."""
        xy, truth = self.pilot.pose[:2], self.pilot.now.truth[:2]
        for i in self._node_of.values():
            node = self.map.nodes[i]
            node.is_visited |= math.dist(node.xy, xy) < node.reached_m
        at = min(range(len(self.map.nodes)), key=lambda i: math.dist(self.map.nodes[i].xy, xy))
        node = self.map.nodes[at]
        if math.dist(node.xy, xy) < node.reached_m:
            if at != self._at:
                way = [step[0][:2] for step in self.pilot.way[self._since :: round(0.5 / DT_S)]]
                ends = self.map.nodes[self._at].xy, node.xy
                self.map.link_driven(self._at, at, np.array([ends[0], *way, ends[1]]))
                # A node's true position is that of its middle, the robot's its own.
                off_m = math.dist(node.truth - node.xy, truth - xy)
                self.mistaken += off_m > node.reached_m
            self._at, self._since = at, len(self.pilot.way)

    # Targets

    def _open_nodes(self):
        """Return the nodes that the robot has still to go to."""

        def is_open(node):
            waits = not node.is_visited and node.tries < TRIES
            return waits or any(e.to < 0 and e.tries < TRIES for e in node.exits)

        return {i for i, node in enumerate(self.map.nodes) if is_open(node)}

    def _go_near(self):
        """Go to the nearest place or exit that is left in the local map; return False without one."""
        targets = []
        for i in self._open_nodes():
            node = self.map.nodes[i]
            if math.dist(node.xy, self.pilot.pose[:2]) > 2 * SCAN_RANGE_M:
                continue
            if not node.is_visited and node.tries < TRIES:
                found = self._lattice.nearest(node.xy, self._within(node))
                targets += [(found[1], i, None, found[0])] if found else []
            for exit_ in node.exits:
                if exit_.to < 0 and exit_.tries < TRIES:
                    ends = (self._lattice.nearest(xy, POINT_M) for xy in exit_.path[::-1])
                    found = next(filter(None, ends), None)
                    targets += [(found[1], i, exit_, found[0])] if found else []
        if not targets:
            return False
        _, i, exit_, cell = min(targets, key=lambda target: target[0] - 2 * LOOK_M * (target[1:3] == self._target))
        self._target = i, exit_
        window, begin_m = self._lattice.window, self.pilot.odometer_m
        self.pilot.mode = RunMode.BRANCH_SELECTION
        follows = self.pilot.follow(self._lattice.path_to(cell), window, LOOK_M)
        is_there = math.dist(window.xy(cell), self.pilot.pose[:2]) < FACE_M
        if is_there:
            self._stops = 0
            self._arrive(self.map.nodes[i], exit_)
        elif not follows and self.pilot.odometer_m - begin_m < FACE_M:
            # What stops the robot here says nothing of a place elsewhere: it begins from farther back each time.
            if self._stops >= SURE_RETRACES:
                self._arrive(self.map.nodes[i], exit_)
            self.pilot.retrace(float(self.robot.length_m) * 2**self._stops)
            self._stops = min(self._stops + 1, RETRACES)
        return True

    def _arrive(self, node, exit_: Exit | None):
        """Look along the way whose end is reached, or where the robot does not get on; note that it has been there."""
        if exit_ is None:
            node.tries += 1
            return
        off = exit_.path[-1] - self.pilot.pose[:2]
        if math.hypot(*off) > FACE_M:
            self.pilot.turn_to(math.atan2(off[1], off[0]))
        exit_.tries += 1

    # Frontiers

    def _go_to_frontier(self):
        """Go to the nearest frontier in the local map; return False without one."""
        window = self._lattice.window
        found = [(nearest_to(some, self._lattice, LOOK_M), some) for some in self._frontiers]
        found = [(*there, some) for there, some in found if there]
        if not found:
            return False
        cell, _, some = min(found, key=lambda target: target[1])
        begin_m, self.pilot.mode = self.pilot.odometer_m, RunMode.WALL_FOLLOWING
        self.pilot.follow(self._lattice.path_to(cell), window, LOOK_M)
        is_there = math.dist(window.xy(cell), self.pilot.pose[:2]) < FACE_M
        if is_there or self.pilot.odometer_m - begin_m < FACE_M:
            self._area.give_up(window, window.xy(np.argwhere(some)))
        return True

    def _frontiers_of(self, cells):
        """Return the node nearest to each of some points `[n, 2]`."""
        nodes = np.array([node.xy for node in self.map.nodes])
        return np.hypot(*(cells[:, None] - nodes).transpose(2, 0, 1)).argmin(1)

    def _near_frontiers(self):
        """Return the nodes nearest to frontiers out of the local map; give up those in it, which are not reached."""
        window = self._lattice.window
        for some in self._frontiers:
            self._area.give_up(window, window.xy(np.argwhere(some)))
        return set(self._frontiers_of(self._area.elsewhere(window)).tolist())

    def _leave_frontiers(self, at):
        """Give up the frontiers out of the local map to which a node, where the robot is, is the nearest."""
        window = self._lattice.window
        left = self._area.elsewhere(window)
        self._area.give_up(window, left[self._frontiers_of(left) == at])

    def _hopes(self):
        """Return the least costs of the robot at the last look if all that is unknown is free."""
        if self._hoped is None:
            self._hoped = Lattice(self._lattice.window, self.pilot.pose, self.robot, through_unknown=True)
        return self._hoped

    def _is_shut_in(self):
        """Return whether most of the way that it has driven in the local map cannot be driven again.

        Then contacts or noise have shut it in, and what it cannot reach from here says nothing.
        """
        window = self._lattice.window
        cells = window.cell(np.array([pose[:2] for pose, *_ in self.pilot.way[:: round(0.5 / DT_S)]]).reshape(-1, 2))
        cells = cells[np.all((cells >= 0) & (cells < SIDE), axis=1)]
        return bool(np.isinf(self._hopes().cost[tuple(cells.T)]).mean() > 0.5) if len(cells) else False

    def _doubt_shut(self, goals):
        """Count a try at all in the local map that no way leads to, not even through unknown cells; return if any is.

        A contact or noise may have shut the way for a while only: the robot looks from several places.
        """
        window, hopes, found = self._lattice.window, self._hopes(), False

        def is_shut(points, within_m):
            cells = window.cell(points)
            return bool(np.all((cells > 0) & (cells < SIDE - 1))) and not any(
                hopes.nearest(xy, within_m) for xy in points
            )

        for node in (self.map.nodes[i] for i in goals):
            if not node.is_visited and node.tries < TRIES and is_shut(node.xy[None], self._within(node)):
                node.tries, found = node.tries + 1, True
            for exit_ in node.exits:
                if exit_.to < 0 and exit_.tries < TRIES and is_shut(exit_.path, POINT_M):
                    exit_.tries, found = exit_.tries + 1, True
        return found

    @staticmethod
    def _within(node):
        """Return the distance of a cell from which a place is looked at, at most."""
        return min(max(POINT_M, node.radius_m), PLACE_M)

    # Links

    def _here(self):
        """Return the node in the local map that is nearest by the cost of driving there; None: none can be reached."""
        costs = {}
        for i in self._node_of.values():
            node = self.map.nodes[i]
            found = self._lattice.nearest(node.xy, node.reached_m)
            costs |= {i: found[1]} if found else {}
        return min(costs, key=lambda i: costs[i], default=None)

    def _go_straight(self):
        """Go straight to the nearest node: in a hall it may be out of the local map."""
        xy = self.pilot.pose[:2]
        near = min(range(len(self.map.nodes)), key=lambda i: math.dist(self.map.nodes[i].xy, xy))
        to = self.map.nodes[near].xy
        self._go_along([(Exit(0.0, np.linspace(xy, to, int(math.dist(xy, to) / POINT_M) + 2)), near)])

    def _go_along(self, route):
        """Follow links; count a failure of the one along which the robot does not get on, and go back a little."""
        self.pilot.mode = RunMode.CENTRAL
        goal = self.map.nodes[route[-1][1]]
        path = np.concatenate([exit_.path for exit_, _ in route])
        at, steps = 0, len(self.pilot.way)
        while (
            goal in self.map.nodes and math.dist(goal.xy, self.pilot.pose[:2]) > goal.reached_m and at < len(path) - 1
        ):
            found, to = self._farthest(path, at)
            begin_m = self.pilot.odometer_m
            if found is not None:
                self.pilot.follow(self._lattice.path_to(found), self._lattice.window, LINK_M)
            if self.pilot.odometer_m - begin_m < FACE_M:
                off_m = math.inf if found is None else math.dist(self._lattice.window.xy(found), self.pilot.pose[:2])
                if to == len(path) - 1 and off_m < FACE_M:
                    break
                exit_ = min((e for e, _ in route), key=lambda e: np.hypot(*(e.path - self.pilot.pose[:2]).T).min())
                exit_.fails += 1
                self.pilot.retrace(float(self.robot.length_m))
                return
            near = np.hypot(*(path[at : to + 1] - self.pilot.pose[:2]).T)
            at += int(near.argmin())
            self._look()
        if goal not in self.map.nodes:
            return
        goal.is_visited, i = True, self.map.nodes.index(goal)
        self._leave_frontiers(i)
        if steps == len(self.pilot.way):  # it is there, and nothing that is left there can be reached
            self._give_up(i)

    def _farthest(self, path, at):
        """Return the cell from which the robot reaches the farthest point of a path, and the number of that point."""
        for i in range(len(path) - 1, at - 1, -1):
            found = self._lattice.nearest(path[i], POINT_M)
            if found:
                on_path_m = math.dist(path[at], self.pilot.pose[:2]) + length_of(path[at : i + 1])
                if found[1] < (1 + CLOSE_COST) * on_path_m + 2 * LOOK_M:  # no detour: close to walls at most
                    return found[0], i
        return None, at
