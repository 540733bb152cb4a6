"""Driving: turn, drive straight, follow a path, go back by its own commands."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from jexplore.arrays.poses import wrapped
from jexplore.driving.local.lattice import MARGIN_M, STEPS, State
from jexplore.driving.local.window import (
    CELL_M,
    LocalTask,
    Report,
    Window,
    begin_run,
    make_step,
    read_report,
    window_of,
)
from jexplore.driving.mission import RunOutcome
from jexplore.driving.params.tree import P
from jexplore.driving.records import RunMode
from jexplore.driving.vehicle import DT_S

TURNED_RAD = 0.04  # from the end of a turn: 5 cm aside after a metre of way
BLIND_STEPS = 30  # steps without a scan after which a run ends: three seconds, less than one turn in place
OFF_RAD = 0.5  # a robot turned farther from its way turns before it drives
LOOK_M = 1.0  # a robot looks anew at the end of the straight piece on which it has come this far
PATIENCE = 100  # steps more than a motion should take, after which it counts as prevented


class RunEnded(Exception):
    """The run has ended while the robot drove."""

    def __init__(self, outcome: RunOutcome) -> None:
        """End with this outcome."""
        super().__init__(outcome.name)
        self.outcome = outcome


class Pilot:
    """A robot in a building, its way and its local map."""

    def __init__(self, task: LocalTask, on_step: Callable[[], object] = lambda: None) -> None:
        """Stand at the start; of the thresholds speed and gain count; `on_step` is called after every step."""
        self._fixed, self._max_steps, self._on_step = task.fixed, task.max_steps, on_step
        self._speed, self._gain = float(task.tuning.speed_m_s), float(task.tuning.turn_gain)
        self._turn_rad_s = float(task.fixed.robot.max_turn_rad_s)
        self._state, report = begin_run(task.fixed, task.start)
        self.now: Report = read_report(report)
        self.way: list[tuple[np.ndarray, np.ndarray, RunMode]] = []
        """Pose, true pose and mode of every step, before it was made."""
        self.mode, self.target = RunMode.CENTRAL, np.asarray(task.start[:2], float)
        self.odometer_m, self._blind = 0.0, 0
        self._commands: list[tuple[float, float]] = []  # speeds, m/s, and rates of turning, rad/s

    @property
    def pose(self) -> np.ndarray:
        """Return the estimated pose `[3]`."""
        return self.now.pose

    def window(self) -> Window:
        """Return the local map."""
        return window_of(self._state)

    @property
    def ranges_m(self) -> np.ndarray:
        """Return the last scan, `[181]` float32."""
        return np.asarray(self._state.senses.ranges_m)

    @property
    def points_left_out(self) -> int:
        """Return the most points that found no room in the map of points by which it finds its pose."""
        return int(max(self._state.slam.overflow, self._state.slam.points.overflow))

    def _step(self, speed_m_s: float, turn_rad_s: float) -> bool:
        """Make a step; return whether it was made, which a contact prevents."""
        before = self.now
        self.way.append((before.pose, before.truth, self.mode))
        self._state, report = make_step(self._fixed, self._state, np.float32(speed_m_s), np.float32(turn_rad_s))
        self.now = read_report(report)
        self.odometer_m += math.dist(before.pose[:2], self.now.pose[:2])
        self._on_step()
        self._blind = self._blind + 1 if self.now.is_blind else 0
        if self.now.beacon_m < P.graph.goal_m:
            raise RunEnded(RunOutcome.GOAL)
        if self._blind >= BLIND_STEPS:
            raise RunEnded(RunOutcome.BLIND)
        if len(self.way) >= self._max_steps:
            raise RunEnded(RunOutcome.STEP_LIMIT)
        goes = self.now.contacts + self.now.refused == before.contacts + before.refused
        if goes and self.mode != RunMode.CONTACT_GUARD:
            self._commands.append((speed_m_s, turn_rad_s))
        return goes

    def turn_to(self, heading: float) -> bool:
        """Turn in place to a heading, radians; return whether nothing was in the way."""
        for _ in range(round(math.pi / (self._turn_rad_s * DT_S)) + PATIENCE):
            off = wrapped(heading - float(self.pose[2]))
            if abs(off) < TURNED_RAD:
                return True
            if not self._step(0.0, float(np.clip(off / DT_S, -self._turn_rad_s, self._turn_rad_s))):
                return False
        return False

    def drive_to(self, xy: np.ndarray, back: bool) -> bool:
        """Drive straight to a point, metres, or past it; return whether nothing was in the way."""
        self.target = np.asarray(xy, float)
        due = math.dist(xy, self.pose[:2]) / (self._speed * DT_S)
        for _ in range(round(due) + PATIENCE):
            off, heading = np.asarray(xy) - self.pose[:2], float(self.pose[2])
            away_m, sign = math.hypot(*off), -1 if back else 1
            if away_m < MARGIN_M or sign * (off @ (math.cos(heading), math.sin(heading))) < 0:
                return True
            turn = wrapped(math.atan2(off[1], off[0]) + math.pi * back - heading)
            speed = sign * min(self._speed, away_m / DT_S) * math.cos(turn) if abs(turn) < OFF_RAD else 0.0
            if speed and (self.now.behind_m if back else self.now.ahead_m) < 2 * self._speed * DT_S:
                return False
            if not self._step(speed, float(np.clip(self._gain * turn, -self._turn_rad_s, self._turn_rad_s))):
                return False
        return False

    def follow(self, path: Sequence[State], window: Window, most_m: float) -> bool:
        """Follow a path for a distance or more, to the end of a straight piece; return whether it could."""
        begin_m, first = self.odometer_m, path[0]
        off = window.xy(first.cell) - self.pose[:2]
        if not self.turn_to(first.heading * math.pi / 4):
            return False
        if math.hypot(*off) > CELL_M:
            heading = float(self.pose[2])
            if not self.drive_to(window.xy(first.cell), bool(off @ (math.cos(heading), math.sin(heading)) < 0)):
                return False
        i = 1
        while i < len(path) and self.odometer_m - begin_m < most_m:
            (heading, cell), before = path[i], path[i - 1]
            if heading != before.heading:
                if not self.turn_to(heading * math.pi / 4):
                    return False
            else:
                step = cell - before.cell
                while i + 1 < len(path) and np.all(path[i + 1].cell - path[i].cell == step):
                    i += 1
                if not self.drive_to(window.xy(path[i].cell), bool(step @ STEPS[heading] < 0)):
                    return False
            i += 1
        return True

    def retrace(self, most_m: float) -> None:
        """Go back for a distance, by its own commands the other way round, until something is in the way.

        What it has not gone back stays to be gone back later: without slip that leads out of every place.
        """
        begin_m, mode, self.mode = self.odometer_m, self.mode, RunMode.CONTACT_GUARD
        while self._commands and self.odometer_m - begin_m < most_m:
            speed, turn = self._commands[-1]
            if not self._step(-speed, -turn):
                break
            self._commands.pop()
        self.mode = mode
