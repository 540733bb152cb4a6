"""Oracle for a whole exploration episode (Holz et al. 2010, sections 2.1 to 2.3), in plain loops.

The world is static and the sensor perfect unless `sense` replaces it; the robot walks from cell centre to cell centre.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np

from . import beams, clock, plans

HEADING_OF = dict(zip(plans.MOTIONS, (0, 90, 180, 270, 45, 135, 225, 315)))
SHARES = (50, 90, 95, 99)


@dataclasses.dataclass
class Plan:
    """One planning step. `target` is None, `cost` 0 and `path` empty if there was nothing left to go to."""

    robot: tuple[int, int]  # (row, col) where it was made
    target: tuple[int, int] | None  # (row, col)
    cost: int  # fixed point, 2**16 a straight step
    path: list  # (row, col) of every cell to come, without the robot's own


@dataclasses.dataclass
class Result:
    """Result of an episode; counts as the robot made them, metres derived from them at the end."""

    outcome: str = ""  # COMPLETE, BLOCKED, STUCK, EXPLORED, STEP_LIMIT, PLAN_LIMIT, PATH_LIMIT, TIME_LIMIT
    events: list = dataclasses.field(default_factory=list)  # what took time, see `clock.play`
    visited: list = dataclasses.field(default_factory=list)  # (row, col): the start, then one cell a step
    headings: list = dataclasses.field(default_factory=list)  # degrees in [0, 360), one a scan
    hits: np.ndarray | None = None  # [H, W] int64
    misses: np.ndarray | None = None  # [H, W] int64
    straight: int = 0  # straight steps
    diagonal: int = 0  # diagonal steps
    turns: int = 0  # units of 45 degrees
    refused: int = 0  # steps refused
    scans: int = 0
    plans: int = 0
    exhausted: int = 0
    log: list = dataclasses.field(default_factory=list)  # a Plan for each plan
    known_after_scan: list = dataclasses.field(default_factory=list)  # (steps, known cells), one a scan
    explored_fraction: float = 0.0
    path_m_at: dict = dataclasses.field(default_factory=dict)  # per cent -> m, by `known_after_scan`
    path_m_along: list = dataclasses.field(default_factory=list)  # m at each per cent of `knowable`, NaN: never
    steps_at: list = dataclasses.field(default_factory=list)  # steps made at each of `path_m_at`
    steps_along: list = dataclasses.field(default_factory=list)  # and of `path_m_along`, None: never
    room_entries: int | None = None  # None without rooms

    @property
    def steps(self):
        """Steps made, straight and diagonal."""
        return self.straight + self.diagonal


def initial_scan_count(fov_deg):
    """Scans that look all round: ceil(360 / fov), raised to 1, 2, 4 or 8 so that headings stay on the lattice."""
    return next((n for n in (1, 2, 4, 8) if n * fov_deg >= 360), 8)


def connected(passable, start):
    """Cells connected to `start` over `passable` by straight steps.

    Diagonal steps would add none: their orthogonal neighbours have to be passable too.
    """
    seen = np.zeros(passable.shape, bool)
    if not passable[start]:
        return seen
    seen[start] = True
    stack = [start]
    while stack:
        row, col = stack.pop()
        for motion in plans.MOTIONS[:4]:
            cell = row + motion[0], col + motion[1]
            if plans.may_step(passable, row, col, motion) and not seen[cell]:
                seen[cell] = True
                stack.append(cell)
    return seen


def goal_cells(occupied, start, clear_r2, near_r2, within=True):
    """Truly clear cells connected to the start: what has to be known for COMPLETE."""
    truly_clear = plans.clear(~occupied, occupied, clear_r2) & within
    passable = truly_clear | (~occupied & within & plans.disc(occupied.shape, *start, near_r2))
    return truly_clear & connected(passable, start)


def knowable(inside, within):
    """Count the cells that a perfect scanner can come to know: those inside, and the walls that it hits from there."""
    cells = set(map(tuple, np.argwhere(inside).tolist()))
    beside = {(r + dr, c + dc) for r, c in cells for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0))}
    return len(cells | {cell for cell in beside if within[cell]})


def count_room_entries(visited, rooms):
    """Times that the robot came to stand in a room other than the last room it stood in; the first counts as one."""
    entries, last = 0, -1
    for cell in visited:
        room = int(rooms[cell])
        if room >= 0 and room != last:
            entries += 1
            last = room
    return entries


class Robot:
    """The robot in its world, with its map, its odometer and its record."""

    def __init__(
        self, occupied, start, heading_deg, sense, p_free, scan_every, no_echo="free", within=None, known=None
    ):
        self.no_echo = no_echo
        self.within = np.ones(occupied.shape, bool) if within is None else within
        known = np.full(occupied.shape, -1) if known is None else known
        self.scan_every, self.unscanned = scan_every, 0  # cost of the way, fixed point
        self.occupied, self.sense, self.p_free = occupied, sense, p_free
        self.cell, self.heading = start, heading_deg % 360
        self.driven = np.zeros(occupied.shape, bool)
        self.driven[start] = True
        self.exhausted = np.zeros(occupied.shape, bool)
        self.target, self.home, self.homing = None, start, None
        self.connectivity, self.least = 8, 1
        shape = occupied.shape
        self.result = Result(visited=[start], hits=np.zeros(shape, np.int64), misses=np.zeros(shape, np.int64))
        self.result.hits[known == 1] = 1
        self.result.misses[known == 0] = 1
        self.known_before = int(((known >= 0) & self.within).sum())

    def classes(self):
        """`(known, free, occupied)` as the robot believes them."""
        return plans.classify(self.result.hits, self.result.misses, self.p_free)

    def known_count(self):
        """Count the observed cells, walls included."""
        return int((self.classes()[0] & self.within).sum())

    def live(self, target):
        """Return whether a target is still adjacent to an unknown cell."""
        return bool(plans.beside_unknown(self.classes()[0] | ~self.within, self.connectivity)[target])

    def scan(self, heading_deg):
        """Make one scan and count it."""
        readings = self.sense(*self.cell, heading_deg)
        if self.no_echo == "unknown":
            readings = [(missed, hit) for missed, hit in readings if hit is not None]
        beams.fold(self.result.hits, self.result.misses, *self.cell, readings)
        self.unscanned = 0
        self.result.headings.append(heading_deg)
        self.result.scans += 1
        self.result.known_after_scan.append((self.result.steps, self.known_count()))

    def turn_to(self, heading_deg):
        """Turn in place by the smaller way."""
        difference = (heading_deg - self.heading) % 360
        eighths = min(difference, 360 - difference) // 45
        self.result.turns += eighths
        self.result.events += [("turn", eighths)] * (eighths > 0)
        self.heading = heading_deg % 360

    def look_all_round(self, n):
        """The scans at the start: they are no turns, and the heading stays."""
        for i in range(n):
            self.scan((self.heading + i * 360 // n) % 360)

    def look_around(self, n, over):
        """Scans after equal turns to the left, n all round with the one on arrival; the last heading stays.

        Returns the outcome of an episode that ends meanwhile, or None.
        """
        for _ in range(n - 1):
            if ended := over.limit(self, None):
                return ended
            self.turn_to((self.heading + 360 // n) % 360)
            self.scan(self.heading)
            self.result.events.append(("scan",))
            if ended := over.enough(self):
                return ended
        return None

    def go(self, cell):
        """Turn and go to a neighbouring cell; False if the step is refused."""
        row, col = self.cell
        motion = cell[0] - row, cell[1] - col
        self.turn_to(HEADING_OF[motion])
        if self.occupied[cell] or not self.within[cell] or not (self.classes()[1][cell] or self.driven[cell]):
            self.result.refused += 1
            self.result.events.append(("scan",))
            return False
        self.cell = cell
        self.result.events.append(("step", all(motion)))
        self.result.visited.append(cell)
        self.driven[cell] = True
        self.result.straight += not all(motion)
        self.result.diagonal += all(motion)
        self.unscanned += 92682 if all(motion) else 65536
        if all(motion):
            self.driven[cell[0], col] = self.driven[row, cell[1]] = True
        return True

    def scan_is_due(self):
        """Return whether the way asks for a scan."""
        return self.unscanned >= self.scan_every or self.cell == self.target

    def step(self, cell):
        """Go to a neighbouring cell and scan; False if the step is refused (the robot turns and scans all the same)."""
        went = self.go(cell)
        if not went or self.scan_is_due():
            self.scan(self.heading)
        return went

    def plan(self, choose, clear_r2, near_r2):
        """Choose a target and the way to it; the record says which."""
        known, free, occupied = self.classes()
        passable = plans.traversable(free, occupied, self.driven, *self.cell, clear_r2, near_r2) & self.within
        cost, pred = plans.dijkstra(passable, self.cell)
        clear = plans.clear(free, occupied, clear_r2)
        how = self.exhausted, self.connectivity, self.least
        targets = plans.frontier(clear, cost, known | ~self.within, *how)
        if self.homing:
            targets = np.zeros_like(targets)
            targets[self.home] = cost[self.home] < plans.FAR
            choose = None
        self.result.plans += 1
        self.result.events.append(("plan",))
        plan = Plan(self.cell, None, 0, [])
        if targets.any():
            target = self.chosen(choose, targets, cost)
            plan = Plan(self.cell, target, int(cost[target]), plans.path(pred, self.cell, target))
        self.result.log.append(plan)
        self.target = plan.target
        return plan

    def chosen(self, choose, targets, cost):
        """Return one of the targets."""
        flat = np.flatnonzero(targets)
        if choose is None:
            chosen = plans.closest(targets, cost)
        else:
            chosen = int(choose(flat, cost.flat[flat], self.result.plans - 1))
        if chosen not in flat:
            raise ValueError(f"expected one of the candidates, got {chosen}")
        return divmod(chosen, targets.shape[1])

    def arrive(self, target, n_looks, over):
        """Look around at a live target; one that is live even then is exhausted. Returns an outcome, or None."""
        if self.live(target):
            if n_looks and (ended := self.look_around(n_looks, over)):
                return ended
            if self.live(target):
                self.exhausted[target] = True
                self.result.exhausted += 1
        return None


@dataclasses.dataclass
class Over:
    """When an episode ends."""

    max_steps: int
    max_plans: int
    known: float = math.inf  # cells that are enough
    return_home: bool = False
    max_length: float = math.inf  # units of which a straight step has 408, a diagonal one 577
    max_ms: float = math.inf
    now_ms: Callable = None

    def end(self, robot, outcome):
        """Return the outcome, or None and "HOME" noted: the robot goes home first."""
        if robot.homing:
            return robot.homing
        if self.return_home and robot.cell != robot.home:
            robot.homing = outcome
            return "HOME"
        return outcome

    def enough(self, robot):
        """Return what follows once enough is known; None before."""
        if robot.homing or robot.known_count() < self.known:
            return None
        return self.end(robot, "EXPLORED")

    def limit(self, robot, cell):
        """Return the limit that the step to a cell, or a look in place (None), would exceed; None without one."""
        result = robot.result
        if cell is not None:
            is_diagonal = cell[0] != robot.cell[0] and cell[1] != robot.cell[1]
            length = 408 * (result.straight + (not is_diagonal)) + 577 * (result.diagonal + is_diagonal)
            if result.steps == self.max_steps:
                return "STEP_LIMIT"
            if length > self.max_length:
                return "PATH_LIMIT"
        late = self.max_ms < math.inf and self.now_ms(result.events) >= self.max_ms
        return "TIME_LIMIT" if late else None


def drive(robot, plan, recheck, arrival_r2, n_looks, over):
    """Carry out a plan: the outcome, "HOME" if the robot is to go home, None if it is to plan anew."""
    for cell in plan.path:
        if ended := over.limit(robot, cell):
            return ended
        went = robot.step(cell)
        if ended := over.enough(robot):
            return ended
        if not went:
            return None
        near = sum((a - b) ** 2 for a, b in zip(robot.cell, plan.target)) <= arrival_r2
        if not robot.homing and (recheck or near) and not robot.live(plan.target) and robot.cell != plan.target:
            return None
    return robot.homing or robot.arrive(plan.target, n_looks, over)


def run(robot, goal, recheck, choose, clear_r2, near_r2, arrival_r2, n_looks, over):
    """The episode after the initial scans; returns the name of its outcome."""
    ended = over.enough(robot)
    while ended in (None, "HOME"):
        if robot.result.plans == over.max_plans:
            return "PLAN_LIMIT"
        plan = robot.plan(choose, clear_r2, near_r2)
        if plan.target is None:
            ended = over.end(robot, "COMPLETE")
        else:
            ended = drive(robot, plan, recheck, arrival_r2, n_looks, over)
    return "BLOCKED" if ended == "COMPLETE" and not robot.classes()[0][goal].all() else ended


def simulate(
    occupied,
    start_row,
    start_col,
    start_heading_deg,
    *,
    recheck,
    choose=None,
    cell_m=0.1,
    n_beams=181,
    fov_deg=180.0,
    range_m=8.0,
    clearance_m=0.3,
    near_m=0.5,
    p_free=0.25,
    max_steps=None,
    max_plans=None,
    rooms=None,
    look_around=True,
    scan_every_m=0.0,
    arrival_m=0.0,
    no_echo="free",
    within=None,
    known=None,
    sense=None,
    frontier_connectivity=8,
    min_frontier_cells=1,
    stop_at=None,
    return_home=False,
    max_path_m=None,
    max_time_s=None,
    robot_times=None,
):
    """One episode, from the scans at the start to a named outcome.

    Args:
      occupied: `[H, W]` bool, the true world, with an occupied ring.
      start_row, start_col, start_heading_deg: the first pose; the heading a multiple of 45.
      recheck: whether a target that is no longer live is given up on the way.
      choose: `choose(candidates, costs, plan_number)` -> one of the candidates: ascending flat indices of the frontier,
        their fixed-point costs, plans made before this one. Default: the cheapest, ties to the lowest index.
      max_steps, max_plans: bounds; default the larger of 20000 and the number of cells.
      scan_every_m: way after which the robot scans; it does so at its target and where a step is refused as well.
      arrival_m: distance from which a target that is no longer live counts as reached.
      no_echo: "free", or "unknown": a beam that nothing stops says nothing.
      within: `[H, W]` bool, where the robot may be and what it is to know; default everywhere.
      known: `[H, W]` int, what it knows from the beginning, as if seen once: -1 unknown, 0 free, 1 occupied.
      rooms: `[H, W]` int, room number, -1 for none.
      sense: `sense(row, col, heading_deg)` -> list of `(missed, hit)`, in place of the perfect scanner.
      frontier_connectivity, min_frontier_cells, stop_at, return_home, max_path_m, max_time_s: of `Rules`.
      robot_times: `Robot`, for the limit of the time.

    Returns:
      a `Result`.
    """
    if start_heading_deg % 45:
        raise ValueError(f"expected a heading that is a multiple of 45 degrees, got {start_heading_deg}")
    start = (int(start_row), int(start_col))
    clear_r2, near_r2 = plans.radius2(clearance_m, cell_m), plans.radius2(near_m, cell_m)
    reach = beams.in_cells(range_m, cell_m)
    bound = max(20000, occupied.size)

    def perfect(row, col, heading_deg):
        return beams.scan(occupied, row, col, heading_deg, n_beams, fov_deg, reach)

    scan_every = round(beams.in_cells(scan_every_m, cell_m) * 65536)
    arrival_r2 = plans.radius2(arrival_m, cell_m)
    heading = int(start_heading_deg)
    robot = Robot(occupied, start, heading, sense or perfect, p_free, scan_every, no_echo, within, known)
    robot.connectivity, robot.least = frontier_connectivity, min_frontier_cells
    goal = goal_cells(occupied, start, clear_r2, near_r2, robot.within)
    elsewhere = goal.copy()
    elsewhere[start] = False
    if occupied[start] or not elsewhere.any():
        robot.result.outcome = "STUCK"
    else:
        n_scans = initial_scan_count(fov_deg)
        robot.look_all_round(n_scans)
        n_looks = max(4, n_scans) if look_around else 0
        over = Over(*(bound if m is None else m for m in (max_steps, max_plans)), return_home=return_home)
        over.now_ms = lambda events: clock.play(events, robot_times, cell_m)[3]
        if stop_at is not None:
            whole = knowable(connected(~occupied & robot.within, start), robot.within)
            over.known = math.ceil(round(10_000 * stop_at) * whole / 10_000)
        if max_path_m is not None:
            over.max_length = 408 * beams.in_cells(max_path_m, cell_m) + 1e-6
        if max_time_s is not None:
            over.max_ms = round(1000 * max_time_s, 6)
        robot.result.outcome = run(robot, goal, recheck, choose, clear_r2, near_r2, arrival_r2, n_looks, over)
    measure(robot, start, cell_m, rooms)
    return robot.result


def measure(robot, start, cell_m, rooms):
    """Derive the other measures from the counts."""
    result = robot.result
    known = robot.classes()[0]
    inside = connected(~robot.occupied & robot.within, start)
    result.explored_fraction = float(known[inside].mean()) if inside.any() else 0.0

    lengths_m = [0.0]  # after every step; built from counts, so that no rounding piles up
    straight = diagonal = 0
    for a, b in itertools.pairwise(result.visited):
        is_diagonal = a[0] != b[0] and a[1] != b[1]
        straight, diagonal = straight + (not is_diagonal), diagonal + is_diagonal
        lengths_m.append((straight + diagonal * math.sqrt(2)) * cell_m)
    final = int((known & robot.within).sum())
    by_scan = [*result.known_after_scan, (result.steps, final)]
    for share in SHARES:
        step = next(step for step, count in by_scan if 100 * count >= share * final)
        result.steps_at.append(step)
        result.path_m_at[share] = lengths_m[step]
    whole = knowable(inside, robot.within)
    for share in range(1, 101):
        steps = [
            step
            for step, count in [(0, robot.known_before), *result.known_after_scan]
            if whole and 100 * count >= share * whole
        ]
        result.steps_along.append(steps[0] if steps else None)
        result.path_m_along.append(lengths_m[steps[0]] if steps else math.nan)
    if rooms is not None:
        result.room_entries = count_room_entries(result.visited, rooms)
