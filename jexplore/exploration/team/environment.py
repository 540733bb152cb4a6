"""The rules of a team: turns, bodies, knowledge.

Each robot lives by the rules of `exploration.environment`: `begin`, `decide`, `commit`, `advance`. A team adds these.

Clock: a robot's clock is the length of its way and its waiting. The robot with the least clock acts, of equal ones that
with the lowest number: it plans, or makes its scan and the next motion. Only steps and waiting take time.
Bodies: a robot is in one cell, from the beginning of the step into it until the next step begins. A step
into a cell that another one is in is not made, nor a diagonal one between two cells of which another is in one: robots
neither meet, nor swap, nor cross. The robot waits for the time of a straight step. After `PATIENCE` waits in a row, and
one more for each robot with a lower number, it plans anew and takes robots in adjacent cells for walls; where it then
finds no target, it goes to the cell that is farthest away, to let others pass; a target that it
leaves in this way twice, and no other in between, it gives up. A robot that has ended steps aside and is in nobody's
way.
Knowledge: two robots have a link within a distance, if wanted only where no wall lies between them. When a robot acts,
each link may fail; one that has held for long enough carries. Robots hear each other by such links, and through others.
When a robot plans, or first hears another, it and all that it hears exchange maps: each then has, of each cell, the
most hits and the most misses that one of them has. Nothing is counted twice, in whatever order robots meet.
"""

import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.engine.program import Given
from jexplore.exploration import environment
from jexplore.exploration.motion import LENGTHS, motion_step
from jexplore.exploration.sensing import blank_grid, known_cells, stacked
from jexplore.exploration.state import Outcome, Setup, State, Stream
from jexplore.exploration.team.coordination import Coordination, joint_view
from jexplore.exploration.team.team import Contact
from jexplore.grid import Grid, count, is_known
from jexplore.planning import Belief, Choice, choose, field, first_at
from jexplore.raycast import Beams
from jexplore.reach import FAR

PATIENCE = 2  # waits in a row of robot 0 before it plans anew: fewer, and robots turn round for one that only passes
ENDED = 2**31 - 1  # clock of a robot that has ended, and of a cell that nobody has seen


class TeamSetup(NamedTuple):
    """Static config of a team. Hashable."""

    robot: Setup  # of each; its own trail has no room, `TeamState.way` is there instead
    n: int
    coordination: Coordination | None  # None: each robot asks its strategy
    capacity: int  # T, steps that the way of each has room for


class TeamTask(NamedTuple):
    """Task of a team's run."""

    starts: Any  # [N, 3] int32, row, col and heading of each
    contact: Contact


@struct.dataclass
class TeamState:
    """A team under way."""

    robots: State  # with a leading axis N
    clock: Array  # [N] int32, in units of `motion.LENGTHS`
    waits: Array  # [N] int32
    in_a_row: Array  # [N] int32, waits since the last step
    hemmed: Array  # [N] bool, whether its next plan takes robots for walls
    fled: Array  # [N, 2] int32, the target from which each has fled last; -1 for none
    shunned: Array  # [N, H, W] bool, targets that each has given up because others were always in the way
    since: Array  # [N, N] int32, clock since which each two have a link; -1 for none
    acts: Array  # int32, times that a robot has acted
    heard: Array  # [N, N] bool, whom each heard when it last acted
    own: Array  # [N, H, W] bool, cells that each has seen itself
    seen_at: Array  # [H, W] int32, clock when any of them first knew each cell; `ENDED`: not yet
    n_known: Array  # int32, those among them that are to be known
    log: Array  # [H * W + 1, 4] int32: n_known, straight steps and waits, diagonal steps, ms; when it last grew
    n_log: Array  # int32, entries
    last: Array  # int32, robot of the last entry
    links: Array  # int32, sum over steps of the others that the robot heard
    way: Array  # [N, T + 1, 3] int32, at the start and after each step: index of the cell, clock, index of the target
    replace: ClassVar[Callable[..., Self]]


def take(tree: Any, i: Array | int) -> Any:
    """Return one robot's part of a pytree with a leading axis N."""
    return jax.tree.map(lambda a: lax.dynamic_index_in_dim(a, i, 0, keepdims=False), tree)


def _put(tree: Any, i: Array, one: Any) -> Any:
    return jax.tree.map(lambda a, new: lax.dynamic_update_index_in_dim(a, jnp.asarray(new, a.dtype), i, 0), tree, one)


def given_of_robot(given: Given, i: Array | int) -> Given:
    """Return the run context of one robot: the first draws as a robot alone, the others from keys of their own."""
    others = jax.random.fold_in(jax.random.fold_in(given.key, Stream.ROBOT), i)
    return given.replace(key=jnp.where(i == 0, given.key, others), task=take(given.task.starts, i))


def is_exploring(team: TeamState) -> Array:
    """Return which robots have not ended: `[N]` bool."""
    return team.robots.outcome == Outcome.RUNNING


def next_robot(team: TeamState) -> Array:
    """Return whose turn it is: int32."""
    return jnp.argmin(jnp.where(is_exploring(team), team.clock, ENDED)).astype(jnp.int32)


def is_done(team: TeamState) -> Array:
    """Return whether all robots have ended: bool."""
    return ~jnp.any(is_exploring(team))


def must_decide(team: TeamState) -> Array:
    """Return whether the robot whose turn it is has no plan: bool."""
    return ~team.robots.plan_active[next_robot(team)]


def begin(setup: TeamSetup, given: Given) -> TeamState:
    """Return a team of which each robot has made its first scans; the task is a `TeamTask`."""
    n = setup.n
    robots = lax.map(lambda i: environment.begin(setup.robot, given_of_robot(given, i)), lax.iota(jnp.int32, n))
    grid, before = robots.belief.grid, blank_grid(given)
    own = (grid.hits != before.hits) | (grid.misses != before.misses)
    known = jnp.any(own, axis=0) | is_known(before)
    zeros, zero, shape = jnp.zeros(n, jnp.int32), jnp.int32(0), known.shape
    way = jnp.zeros((n, setup.capacity + 1, 3), jnp.int32).at[:, :, 2].set(-1)
    team = TeamState(
        robots=robots,
        clock=zeros,
        waits=zeros,
        in_a_row=zeros,
        hemmed=jnp.zeros(n, bool),
        fled=jnp.full((n, 2), -1, jnp.int32),
        shunned=jnp.zeros_like(own),
        since=jnp.full((n, n), -1, jnp.int32),
        acts=zero,
        heard=jnp.eye(n, dtype=bool),
        own=own,
        seen_at=jnp.where(known, 0, ENDED),
        n_known=count(known if robots.belief.within is None else known & robots.belief.within[0]),
        log=jnp.zeros((math.prod(shape) + 1, 4), jnp.int32),
        n_log=zero,
        last=zero,
        links=zero,
        way=way.at[:, 0, 0].set(robots.row * shape[1] + robots.col),
    )
    return _note(team, zero, take(robots, 0), jnp.bool_(True))


def _note(team: TeamState, i: Array, before: State, grew: Array) -> TeamState:
    """Note the number of known cells after a scan, made before a motion. A place and time has one entry, the last."""
    entry = jnp.stack([team.n_known, before.straight + team.waits[i], before.diagonal, before.time_ms])
    newest = team.log[jnp.maximum(team.n_log - 1, 0)]
    again = (team.n_log > 0) & (team.last == i) & (newest[1] == entry[1]) & (newest[2] == entry[2])
    at = jnp.where(again, team.n_log - 1, jnp.where(grew, team.n_log, team.log.shape[0]))
    log, more = team.log.at[at].set(entry, mode="drop"), grew & ~again
    return team.replace(log=log, n_log=team.n_log + more, last=jnp.where(more, i, team.last))


def _sees(given: Given, rows: Array, cols: Array) -> Array:
    """Return which two robots see each other: `[N, N]` bool, symmetric.

    The line from the one with the lower number passes a cell for each row or column of the longer side, the nearest one
    (half up): none of them, apart from the two of the robots, is occupied.
    """
    occupied, base = stacked(given, given.scenes.occupied)
    n, shape = rows.shape[0], given.scenes.occupied.shape[1:]
    first, second = np.triu_indices(n, 1)
    drow, dcol = rows[second] - rows[first], cols[second] - cols[first]
    length = jnp.maximum(jnp.abs(drow), jnp.abs(dcol))[:, None]
    step, whole = lax.iota(jnp.int32, max(shape))[None], jnp.maximum(length, 1)
    row, col = (
        at[first, None] + (2 * step * ahead[:, None] + whole) // (2 * whole)
        for at, ahead in ((rows, drow), (cols, dcol))
    )
    walls = occupied[base + jnp.clip(row, 0, shape[0] - 1), jnp.clip(col, 0, shape[1] - 1)]
    sees = jnp.zeros((n, n), bool).at[first, second].set(~jnp.any(walls & (step > 0) & (step < length), axis=1))
    return sees | sees.T


def _hears(given: Given, team: TeamState, i: Array) -> tuple[Array, Array]:
    """Return whom a robot hears, itself included, and since when each two have a link: `[N]` bool, `[N, N]` int32."""
    contact, now = given.task.contact, team.clock[i]
    rows, cols = team.robots.row, team.robots.col
    n, d2 = rows.shape[0], (rows[:, None] - rows) ** 2 + (cols[:, None] - cols) ** 2
    near = run_if(contact.in_sight, lambda near: near & _sees(given, rows, cols), d2 <= contact.d2)

    def without_lost(near: Array) -> Array:
        key = jax.random.fold_in(jax.random.fold_in(given.key, Stream.CONTACT), team.acts)
        lost = jnp.triu(jax.random.uniform(key, (n, n)) < contact.loss, 1)
        return near & ~(lost | lost.T)

    near = run_if(contact.loss > 0, without_lost, near)
    since = jnp.where(near, jnp.where(team.since < 0, now, team.since), -1)
    heard = near & (now - since >= contact.delay) | jnp.eye(n, dtype=bool)
    for _ in range((n - 1).bit_length()):
        heard = jnp.any(heard[:, :, None] & heard[None], axis=1)
    return heard[i], since


def _exchange(robots: State, heard: Array) -> State:
    """Return robots of which those heard have exchanged maps."""

    def shared(maps: Array) -> Array:
        most = jnp.max(jnp.where(heard[:, None, None], maps, jnp.zeros_like(maps)), axis=0)
        return jnp.where(heard[:, None, None], most, maps)

    belief = robots.belief
    grid = Grid(shared(belief.grid.hits), shared(belief.grid.misses))
    first = jnp.argmax(heard)
    n_known = known_cells(take(grid, first), None if belief.within is None else belief.within[0])
    belief = belief.replace(grid=grid, exhausted=shared(belief.exhausted))
    return robots.replace(belief=belief, n_known=jnp.where(heard, n_known, robots.n_known))


def meet(given: Given, team: TeamState, i: Array, *, plans: bool) -> tuple[TeamState, Array]:
    """Have a robot exchange maps with those that it hears, if it plans or one of them is new."""
    if team.clock.shape[0] == 1:
        return team, jnp.ones(1, bool)
    heard, since = _hears(given, team, i)
    is_due = (plans & jnp.any(heard.at[i].set(False))) | jnp.any(heard & ~team.heard[i])
    robots = run_if(is_due, lambda robots: _exchange(robots, heard), team.robots)
    return team.replace(robots=robots, since=since, acts=team.acts + 1, heard=team.heard.at[i].set(heard)), heard


def _others(team: TeamState, i: Array) -> Array:
    """Return the other robots that are on the floor: `[N]` bool."""
    return is_exploring(team) & (lax.iota(jnp.int32, team.clock.shape[0]) != i)


def is_held(team: TeamState, i: Array, motion: Array) -> Array | None:
    """Return whether another robot is in the way of a robot's motion, an index into `reach.MOTIONS`: bool."""
    if team.clock.shape[0] == 1:
        return None
    drow, dcol, _ = motion_step(motion)
    rows, cols = team.robots.row - team.robots.row[i], team.robots.col - team.robots.col[i]
    between = ((rows == drow) & (cols == 0)) | ((rows == 0) & (cols == dcol))
    in_way = ((rows == drow) & (cols == dcol)) | ((drow != 0) & (dcol != 0) & between)
    return jnp.any(_others(team, i) & in_way)


def _hemmed_in(team: TeamState, i: Array, belief: Belief) -> Belief:
    """Return the belief that a robot plans by: without targets given up; robots in adjacent cells may be walls."""
    rows, cols = team.robots.row, team.robots.col
    near = (jnp.maximum(jnp.abs(rows - belief.row), jnp.abs(cols - belief.col)) <= 1) & _others(team, i)
    at = jnp.where(near & team.hemmed[i], rows, belief.driven.shape[0]), cols
    grid = Grid(belief.grid.hits.at[at].set(1, mode="drop"), belief.grid.misses.at[at].set(0, mode="drop"))
    driven = belief.driven.at[at].set(False, mode="drop")
    return belief.replace(grid=grid, driven=driven, exhausted=belief.exhausted | take(team.shunned, i))


def _farthest(belief: Belief, route: Array) -> tuple[Choice, Array]:
    """Choose the cell with the longest way, of equal ones the first, and lay the way there: `(choice, route)`."""
    reached = field(belief)
    cost = jnp.where(reached.cost < FAR, reached.cost, -1)
    choice, route = choose(belief, route, reached, *first_at(cost == jnp.max(cost)))
    return choice.replace(overflow=jnp.int32(0)), route


def _ask(setup: TeamSetup, given: Given, team: TeamState, i: Array, state: State, heard: Array) -> Any:
    """Return the robot's next carry, choice and route."""
    robot = setup.robot
    if setup.coordination is not None:
        choose_jointly = setup.coordination
        there, cells = heard & is_exploring(team), jnp.stack([team.robots.row, team.robots.col], axis=1)
        aims = there & team.robots.plan_active & (lax.iota(jnp.int32, setup.n) != i)
        aims = jnp.where(aims[:, None], team.robots.target, -1)

        def select(key: Array, params: Any, carry: Any, belief: Belief, beams: Beams, route: Array) -> Any:
            del key, params
            return carry, *choose_jointly(*joint_view(belief, beams, i, there, cells, aims), route)

        robot = robot._replace(policy=robot.policy._replace(select=select))
    return environment.decide(robot, given, state)


def decide(setup: TeamSetup, given: Given, team: TeamState) -> TeamState:
    """Have the robot whose turn it is plan, and make the first motion."""
    i = next_robot(team)
    team, heard = meet(given, team, i, plans=True)
    own, state = given_of_robot(given, i), take(team.robots, i)
    if setup.n == 1:
        carry, choice, route = _ask(setup, own, team, i, state, heard)
        live: Any = True
    else:
        hemmed = _hemmed_in(team, i, state.belief)
        carry, choice, route = _ask(setup, own, team, i, state.replace(belief=hemmed), heard)
        live = ~(team.hemmed[i] & (choice.row < 0))
        choice, route = run_if(~live, lambda _: _farthest(hemmed, route), (choice, route))
        again = ~live & jnp.all(state.target == team.fled[i])
        row = jnp.where(again, state.target[0], hemmed.driven.shape[0])
        team = team.replace(
            fled=team.fled.at[i].set(jnp.where(live, team.fled[i], state.target)),
            shunned=team.shunned.at[i, row, state.target[1]].set(True, mode="drop"),
        )
    held = is_held(team, i, route[state.belief.row, state.belief.col])
    after = environment.commit(setup.robot, own, state.replace(carry=carry), choice, route, live, held)
    return act(given, team, i, state, after, heard, held)


def advance(setup: TeamSetup, given: Given, team: TeamState) -> TeamState:
    """Have the robot whose turn it is make its scan and the next motion of its plan."""
    i = next_robot(team)
    team, heard = meet(given, team, i, plans=False)
    own, state = given_of_robot(given, i), take(team.robots, i)
    held = is_held(team, i, state.route[state.belief.row, state.belief.col])
    after = environment.advance(setup.robot, own, state, held)
    old, grid = state.belief.grid, after.belief.grid
    seen = (grid.hits != old.hits) | (grid.misses != old.misses)
    new = seen & (team.seen_at == ENDED)
    grew = count(new if state.belief.within is None else new & state.belief.within)
    mine = lax.dynamic_update_index_in_dim(team.own, take(team.own, i) | seen, i, 0)
    team = team.replace(own=mine, seen_at=jnp.where(new, team.clock[i], team.seen_at), n_known=team.n_known + grew)
    return act(given, _note(team, i, state, grew > 0), i, state, after, heard, held)


def act(
    given: Given, team: TeamState, i: Array, before: State, after: State, heard: Array, held: Array | None
) -> TeamState:
    """Put a robot back into its team after it has acted: its clock, waits and way."""
    waited, gives_up = jnp.bool_(False), jnp.bool_(False)
    moved = after.steps != before.steps
    if held is not None:
        waited = held & after.plan_active & (after.looked == before.looked)
        in_a_row = jnp.where(moved, 0, team.in_a_row[i] + waited)
        gives_up = waited & (in_a_row >= PATIENCE + i)
        team = team.replace(in_a_row=team.in_a_row.at[i].set(jnp.where(gives_up, 0, in_a_row)))
        after = environment.limit_plans(given.numbers, after.replace(plan_active=after.plan_active & ~gives_up))
    waits = team.waits.at[i].add(waited)
    clock = LENGTHS[0] * (after.straight + waits[i]) + LENGTHS[1] * after.diagonal
    step = jnp.where(moved, after.steps, team.way.shape[1])
    target = jnp.where(after.target[0] < 0, -1, after.target[0] * after.shape[1] + after.target[1])
    here = jnp.stack([after.row * after.shape[1] + after.col, clock, target])
    return team.replace(
        robots=_put(team.robots, i, after),
        clock=team.clock.at[i].set(clock),
        waits=waits,
        hemmed=team.hemmed.at[i].set(gives_up),
        links=team.links + jnp.where(moved, jnp.sum(heard, dtype=jnp.int32) - 1, 0),
        way=team.way.at[i, step].set(here, mode="drop"),
    )
