"""Oracle for teams in plain loops, the same team by the engine, and their differences.

The rules are those of `exploration/team/environment.py`; each robot is a `simulator.Robot`, and others act between its
motion and the scan that follows.
"""

import functools
import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.engine.one_by_one import run_one
from jexplore.engine.program import Given
from jexplore.exploration.environment import outcome_of
from jexplore.exploration.state import Outcome, Setup, Stream
from jexplore.exploration.team.episode import decode, detail_of, program_of
from jexplore.exploration.team.state import TeamSetup, TeamTask
from jexplore.exploration.team.team import EVERYBODY, NOBODY, Contact, read_coordination
from jexplore.native.drive import load_driving
from jexplore.policies import parse_strategy
from jexplore.raycast import scans_all_round
from jexplore.rules import Lidar, Robot, Rules

from . import beams, clock, episodes, fuzz, plans, simulator

STRAIGHT, DIAGONAL = 408, 577
PATIENCE = 2
SHAPE, BEAMS_AS, CAPACITY = (32, 32), (24, 61), 2000
ROBOT = Robot()


class Case(NamedTuple):
    """A team's episode to be compared."""

    occupied: np.ndarray
    starts: list  # (row, col, heading in degrees) of each robot
    coordination: str
    contact: Contact
    recheck: bool
    lidar: Lidar
    rules: Rules
    cell_m: float
    world: str
    paces: tuple = ()  # of each robot; (): all have 1, and by the program of teams whose robots are alike
    ranges_m: tuple = ()  # of each robot's scanner


class Radio:
    """The links between the robots of a team."""

    def __init__(self, case):
        self.case, self.contact, self.since, self.acts = case, case.contact, {}, 0

    def is_open(self, a, b):
        """Return whether no wall lies on the line between two cells."""
        n = max(abs(a[0] - b[0]), abs(a[1] - b[1]))
        between = [tuple(math.floor(p + k * (q - p) / n + 0.5) for p, q in zip(a, b)) for k in range(1, n)]
        return not any(self.case.occupied[cell] for cell in between)

    def links(self, team, now):
        """The pairs of robots whose link carries, the lower number first; to be asked once an act."""
        key = jax.random.fold_in(jax.random.fold_in(episodes.key_of(0), Stream.CONTACT), self.acts)
        lost = np.asarray(jax.random.uniform(key, (len(team),) * 2)) < self.contact.loss if self.contact.loss else None
        self.acts, held = self.acts + 1, {}
        for a, b in itertools.combinations(team, 2):
            pair = a.number, b.number
            near = (a.cell[0] - b.cell[0]) ** 2 + (a.cell[1] - b.cell[1]) ** 2 <= self.contact.d2
            if (
                near
                and (not self.contact.in_sight or self.is_open(a.cell, b.cell))
                and (lost is None or not lost[pair])
            ):
                held[pair] = self.since.get(pair, now)
        self.since = held
        return {pair for pair, began in held.items() if now - began >= self.contact.delay}


class Member(simulator.Robot):
    """A robot of a team: between two calls of `act` others act."""

    def join(self, number, case, goal, radio):
        """Take a place in the team."""
        self.number, self.case, self.goal, self.radio = number, case, goal, radio
        self.time = self.waits = self.in_a_row = self.looking = self.looked = self.links = self.met = 0
        self.active = self.hemmed = self.homing = False
        self.pace, self.came = case.paces[number] if case.paces else 1, None
        self.path, self.pending, self.ended = [], None, None
        self.last_heard = {number}
        self.own = np.zeros(self.occupied.shape, bool)
        self.shunned, self.fled_from = np.zeros(self.occupied.shape, bool), None
        self.way = [(*self.cell, 0)]
        self.clear_r2 = plans.radius2(case.rules.clearance_m, case.cell_m)
        self.near_r2 = plans.radius2(case.rules.near_m, case.cell_m)
        self.n_looks = max(4, simulator.initial_scan_count(case.lidar.fov_deg)) if case.rules.look_around else 0

    def note_scan(self, heading_deg):
        """Make a scan and keep what it showed."""
        before = self.result.hits.copy(), self.result.misses.copy()
        self.scan(heading_deg)
        self.own |= (before[0] != self.result.hits) | (before[1] != self.result.misses)

    def others(self, team):
        """The other robots that are on the floor."""
        return [robot for robot in team if robot is not self and robot.ended is None]

    def hear(self, team, planning):
        """Exchange maps if it is due, and return the numbers of those heard."""
        links = self.radio.links(team, self.time)
        heard, grown = set(), {self.number}
        while heard != grown:
            heard = set(grown)
            grown |= {b for a in heard for b in range(len(team)) if (min(a, b), max(a, b)) in links}
        if (planning and len(heard) > 1) or heard - self.last_heard:
            for name, best in (("hits", np.maximum), ("misses", np.maximum)):
                most = functools.reduce(best, (getattr(team[j].result, name) for j in heard))
                for j in heard:
                    setattr(team[j].result, name, most.copy())
            spent = functools.reduce(np.logical_or, (team[j].exhausted for j in heard))
            for j in heard:
                team[j].exhausted = spent.copy()
        self.last_heard = heard
        return heard

    def act(self, team):
        """Plan, or scan, and make the next motion."""
        before, heard = self.result.steps, self.hear(team, not self.active)
        if {robot.number for robot in self.others(team)} <= heard:
            self.met, self.came = self.time, None
        if self.active:
            self.finish_motion()
            self.judge()
        else:
            due, rests = self.rendezvous(team)
            if rests:
                self.waits, self.hemmed = self.waits + 1, False
                self.result.events.append(("wait",))
            else:
                self.choose(team, heard, due)
        if self.active and self.ended is None:
            self.move(team)
        if self.ended is None and not self.active and self.result.plans >= (self.case.rules.max_plans or CAPACITY):
            self.ended = "PLAN_LIMIT"
        self.time = self.pace * (STRAIGHT * (self.result.straight + self.waits) + DIAGONAL * self.result.diagonal)
        if self.result.steps > before:
            self.links += len(heard) - 1
            self.way.append((*self.cell, self.time))

    def rendezvous(self, team):
        """Return whether it is time to look for the others, and whether to wait for them here."""
        most = self.case.contact.rendezvous
        if not most or self.time - self.met < most:
            return False, False
        off = max(abs(a - b) for a, b in zip(self.cell, self.case.starts[0]))
        if off > (len(team) if self.hemmed else 0):
            return True, False
        self.came = self.time if self.came is None else self.came
        if self.time - self.came >= most:
            self.met, self.came = self.time, None
            return False, False
        return True, True

    def finish_motion(self):
        """Make the scan that belongs to the last motion, if one is due."""
        if self.pending == "refused" or self.scan_is_due():
            self.note_scan(self.heading)

    def judge(self):
        """Give the plan up, or go on with it, or arrive."""
        near = sum((a - b) ** 2 for a, b in zip(self.cell, self.target)) <= self.arrival_r2
        if self.pending == "refused" or (
            (self.case.recheck or near) and not self.live(self.target) and self.cell != self.target and not self.homing
        ):
            self.active = False
        elif self.cell == self.target and self.looking == 0:
            self.come(self.live(self.target))

    def come(self, live):
        """Look around at a live target, or note that looking does not help."""
        looks = live and self.looked < self.n_looks - 1
        self.looking, self.active = (self.n_looks - 1 if looks else 0), looks
        if live and not looks:
            self.exhausted[self.target] = True
            self.result.exhausted += 1

    def choose(self, team, heard, due):
        """Choose a target and the way there."""
        kept = self.result.hits, self.result.misses, self.driven
        if self.hemmed:
            self.result.hits, self.result.misses, self.driven = (a.copy() for a in kept)
            for cell in (robot.cell for robot in self.others(team)):
                if max(abs(a - b) for a, b in zip(cell, self.cell)) <= 1:
                    self.result.hits[cell], self.result.misses[cell], self.driven[cell] = 1, 0, False
        known, free, occupied = self.classes()
        passable = plans.traversable(free, occupied, self.driven, *self.cell, self.clear_r2, self.near_r2)
        cost, pred = plans.dijkstra(passable, self.cell)
        targets = plans.frontier(plans.clear(free, occupied, self.clear_r2), cost, known, self.exhausted | self.shunned)
        target, flees = self.pick(team, heard, targets, cost, free, occupied), False
        base = tuple(self.case.starts[0][:2])
        self.homing = due and not self.hemmed and target is not None and cost[base] < plans.FAR
        target = base if self.homing else target
        if target is None and self.hemmed:
            flees = True
            self.shunned[self.target] |= self.target == self.fled_from
            self.fled_from = self.target
            target = divmod(int(np.argmax(np.where(cost < plans.FAR, cost, -1))), cost.shape[1])
        self.result.hits, self.result.misses, self.driven = kept
        self.hemmed = False
        self.result.plans += 1
        self.result.events.append(("plan",))
        self.target, self.active = target, target is not None
        if target is None:
            self.ended = "COMPLETE"
            return
        self.path = plans.path(pred, self.cell, target)
        if not self.path:
            self.come(not flees)

    def pick(self, team, heard, targets, cost, free, occupied):
        """The target that the coordination chooses, of equal ones the first; None without any."""
        if not targets.any():
            return None
        score = -cost.astype(np.float64)
        there = [robot for robot in self.others(team) if robot.number in heard]
        if self.case.coordination in ("voronoi", "minpos"):
            rank = np.zeros(cost.shape, int)
            group = plans.clusters(targets)
            mine = np.array([cost[group == g].min() for g in range(group.max() + 1)])
            for other in there:
                passable = plans.traversable(free, occupied, self.driven, *other.cell, self.clear_r2, self.near_r2)
                passable[other.cell] = True
                theirs, own = plans.dijkstra(passable, other.cell)[0], cost
                if self.case.coordination == "minpos":
                    theirs = np.array([theirs[group == g].min() for g in range(group.max() + 1)])[group]
                    own = mine[group]
                rank += ((theirs < own) | ((theirs == own) & (other.number < self.number))) & (theirs < plans.FAR)
            least = rank[targets].min()
            chosen = targets & (rank == least)
            if self.case.coordination == "minpos" or least == 0:
                score = np.where(chosen, score, -np.inf)
        best = max(np.flatnonzero(targets), key=lambda i: (score.flat[i], -i))
        return divmod(int(best), cost.shape[1])

    def move(self, team):
        """Make the next motion, or wait for a robot in the way."""
        if self.looking:
            self.turn_to((self.heading + 360 // self.n_looks) % 360)
            self.looking, self.looked, self.pending = self.looking - 1, self.looked + 1, "look"
            self.result.events.append(("scan",))
            return
        if self.result.steps == (self.case.rules.max_steps or CAPACITY):
            self.ended, self.active = "STEP_LIMIT", False
            return
        (row, col), cell = self.cell, self.path[0]
        taken = {robot.cell for robot in self.others(team)}
        motion = cell[0] - row, cell[1] - col
        if cell in taken or (all(motion) and {(cell[0], col), (row, cell[1])} & taken):
            self.waits, self.in_a_row, self.pending = self.waits + 1, self.in_a_row + 1, "wait"
            self.result.events.append(("wait",))
            if self.in_a_row >= PATIENCE + self.number:
                self.active, self.hemmed, self.in_a_row = False, True, 0
            return
        if not self.go(cell):
            self.pending = "refused"
            return
        self.path.pop(0)
        self.pending, self.in_a_row, self.looked = "step", 0, 0


def simulate(case):
    """Explore as a team: `(robots, log)`, the log a list of known cells and the clock after each scan."""

    def perfect(reach, row, col, heading_deg):
        return beams.scan(case.occupied, row, col, heading_deg, case.lidar.n_beams, case.lidar.fov_deg, reach)

    scan_every = round(beams.in_cells(case.rules.scan_every_m, case.cell_m) * 65536)
    team, radio = [], Radio(case)
    for number, (row, col, heading) in enumerate(case.starts):
        range_m = case.ranges_m[number] if case.ranges_m else case.lidar.range_m
        sees = functools.partial(perfect, beams.in_cells(range_m, case.cell_m))
        robot = Member(case.occupied, (row, col), heading, sees, case.rules.p_free, scan_every)
        radii = (plans.radius2(m, case.cell_m) for m in (case.rules.clearance_m, case.rules.near_m))
        goal = simulator.goal_cells(case.occupied, (row, col), *radii)
        robot.join(number, case, goal, radio)
        robot.arrival_r2 = plans.radius2(case.rules.arrival_m, case.cell_m)
        elsewhere = goal.copy()
        elsewhere[row, col] = False
        if not elsewhere.any():
            robot.ended = "STUCK"
        else:
            n = simulator.initial_scan_count(case.lidar.fov_deg)
            for i in range(n):
                robot.note_scan((robot.heading + i * 360 // n) % 360)
        team.append(robot)
    union = functools.reduce(np.logical_or, (robot.own for robot in team))
    log = [(int(union.sum()), 0)]
    while running := [robot for robot in team if robot.ended is None]:
        robot = min(running, key=lambda robot: (robot.time, robot.number))
        now = robot.time
        robot.act(team)
        union |= robot.own
        log.append((int(union.sum()), now))
        cells = [each.cell for each in team if each.ended is None]
        assert len(set(cells)) == len(cells), f"two robots in one cell: {cells}"
    for robot in team:
        if robot.ended == "COMPLETE" and not robot.classes()[0][robot.goal].all():
            robot.ended = "BLOCKED"
    return team, log


# ---------------------------------------------------------------- by the engine


@functools.partial(jax.jit, static_argnames="setup")
def compiled(setup, first_scans, truth, table, numbers, task):
    """Make one team's episode; scans at the start may vary, for fewer programs."""
    program = program_of(setup._replace(robot=setup.robot._replace(first_scans=first_scans)))
    given = Given(episodes.key_of(0), table, truth, jnp.int32(0), numbers, task)
    team = run_one(program, given)
    return program.finish(program.setup, given, team), detail_of(team), jax.vmap(outcome_of)(team.robots)


def beams_of(case):
    """The beams of a case; with a length for every robot where ranges are given."""
    found, *own = (
        episodes.beams_of(case.lidar.replace(range_m=one), case.cell_m, SHAPE[1], BEAMS_AS)
        for one in (case.lidar.range_m, *case.ranges_m)
    )
    if not own:
        return found
    return found.replace(length=np.stack([one.length for one in own]), reach=np.stack([one.reach for one in own]))


def play(case, native=True):
    """Explore by the engine, driven by native code or not: `(Result, Final, outcomes)`."""
    name = "closest+recheck" if case.recheck else "closest"
    strategy = parse_strategy(name)
    robot = Setup(strategy.policy._replace(params=()), 0, False, 1)
    setup = TeamSetup(robot, len(case.starts), read_coordination(case.coordination), CAPACITY, bool(case.paces))
    setup = setup._replace(native=load_driving().name if native else None)
    rules = case.rules.replace(max_steps=case.rules.max_steps or CAPACITY, max_plans=case.rules.max_plans or CAPACITY)
    starts = np.array([(row, col, heading // 45) for row, col, heading in case.starts], np.int32)
    found = compiled(
        setup,
        jnp.int32(scans_all_round(case.lidar)),
        jax.device_put(episodes.truth_of(case.occupied, None, SHAPE)),
        jax.device_put(beams_of(case)),
        episodes.numbers_of(strategy, case.lidar, rules, case.cell_m, max(SHAPE), ROBOT),
        TeamTask(
            jnp.asarray(starts),
            Contact(*map(jnp.asarray, case.contact)),
            jnp.asarray(case.paces or [1] * len(starts), jnp.int32),
        ),
    )
    result, detail, outcomes = jax.tree.map(np.asarray, found)
    return result, decode(detail, case.occupied.shape, 0), [Outcome(int(code)).name for code in outcomes]


# ---------------------------------------------------------------- compared with each other


def draw_case(seed, number, coordination, n):
    """A case: of the same arguments always the same one."""
    draw = np.random.default_rng((seed, number))
    cell_m = float(draw.choice([0.05, 0.1, 0.2]))
    while True:
        height, width = (int(side) for side in draw.integers(8, 25, 2))
        world = str(draw.choice(["corridor", "maze", "maze", "pillars"]))
        occupied = fuzz.KINDS[world](draw, height, width)
        cells = episodes.clear_cells(occupied, 0)
        if len(cells) >= 3 * n:
            break
    if draw.random() < 0.5:  # all at one door
        at = cells[draw.integers(len(cells))]
        cells = cells[np.argsort(np.abs(cells - at).sum(axis=1), kind="stable")[:n]]
    chosen = cells[draw.permutation(len(cells))[:n]]
    starts = [(int(row), int(col), 45 * int(draw.integers(8))) for row, col in chosen]
    range_cells = int(draw.integers(2, 13))
    return Case(
        occupied=occupied,
        starts=starts,
        coordination=coordination,
        contact=Contact(
            d2=np.int32(draw.choice([NOBODY, EVERYBODY, draw.integers(1, 100)])),
            in_sight=np.bool_(draw.random() < 0.3),
            delay=np.int32(draw.choice([0, 0, STRAIGHT * draw.integers(1, 10)])),
            loss=np.float32(draw.choice([0, 0, 0.3])),
        ),
        recheck=bool(draw.random() < 0.5),
        lidar=Lidar(
            n_beams=int(draw.integers(20, 62)), fov_deg=float(draw.choice([180.0, 360.0])), range_m=range_cells * cell_m
        ),
        rules=Rules(
            clearance_m=0.0,
            near_m=float(draw.choice([0.0, 2 * cell_m])),
            look_around=bool(draw.random() < 0.75),
            scan_every_m=float(draw.choice([0, 0, 3 * cell_m])),
            arrival_m=float(draw.choice([0, 0, 2 * cell_m])),
            max_steps=int(draw.integers(10, 100)) if draw.random() < 0.1 else None,
            max_plans=int(draw.integers(3, 20)) if draw.random() < 0.1 else None,
        ),
        cell_m=cell_m,
        world=world,
    )


def mixed(case, number):
    """A case with robots that differ, most with a rendezvous; of the same arguments always the same one."""
    draw, n = np.random.default_rng((3, number)), len(case.starts)
    ticks = draw.choice([100_000, *draw.integers(3, 30, 2)])  # the first: never
    return case._replace(
        paces=tuple(draw.integers(1, 4, n).tolist()),
        ranges_m=tuple((case.lidar.range_m * draw.choice([0.4, 0.7, 1.0], n)).tolist()),
        contact=case.contact._replace(rendezvous=np.int32(STRAIGHT * ticks)),
    )


def when(log, counts):
    """The clock when each count of known cells was first reached; -1 for never."""
    return [next((at for known, at in log if known >= count), -1) for count in counts]


def lengths(straight, diagonal):
    """Clocks of counts of steps; -1 stays."""
    return np.where(np.asarray(straight) < 0, -1, STRAIGHT * np.asarray(straight) + DIAGONAL * np.asarray(diagonal))


def differences(case, native=True):
    """Everything in which the engine and the oracle differ, as texts, and the outcomes and waits of the robots."""
    (result, final, outcomes), (team, log) = play(case, native), simulate(case)
    ways = [[tuple(row[:3]) for row in way.tolist()] for way in final.ways]
    end_ms = [clock.play(robot.result.events, ROBOT, case.cell_m)[1] * robot.pace for robot in team]
    whole = simulator.knowable(simulator.connected(~case.occupied, case.starts[0][:2]), np.ones_like(case.occupied))
    counts, known = result.metrics, log[-1][0]
    pairs = {
        "outcomes": (outcomes, [robot.ended for robot in team]),
        "waits": (counts.waits.tolist(), [robot.waits for robot in team]),
        **{f"way {i}": (way, robot.way) for i, (way, robot) in enumerate(zip(ways, team))},
        "hits": (final.hits.tolist(), functools.reduce(np.maximum, (robot.result.hits for robot in team)).tolist()),
        "misses": (final.misses.tolist(), functools.reduce(np.maximum, (r.result.misses for r in team)).tolist()),
        "seen at": (
            [int((final.seen_at <= now).sum()) for _, now in log[:-1]],
            [max(known for known, at in log if at <= now) for _, now in log[:-1]],
        ),
        "own": (counts.own.tolist(), [int(robot.own.sum()) for robot in team]),
        "known": ((int(result.n_known), int(counts.seen)), (known, known)),
        "links": (int(counts.links), sum(robot.links for robot in team)),
        "clock": (int(lengths(result.straight, result.diagonal)), max(robot.time for robot in team)),
        "at": (
            lengths(result.straight_at, result.diagonal_at).tolist(),
            when(log, [math.ceil(known * share / 100) for share in simulator.SHARES]),
        ),
        "along": (
            lengths(result.straight_along, result.diagonal_along).tolist(),
            when(log, [math.ceil(whole * share / 100) for share in range(1, 101)]),
        ),
        "time": (counts.time_ms.tolist(), end_ms),
        **{
            name: (int(getattr(result, name)), sum(getattr(robot.result, name) for robot in team))
            for name in ("turns", "scans", "plans", "exhausted", "refused")
        },
    }
    return [f"{name}: {got}, expected {want}" for name, (got, want) in pairs.items() if got != want], team
