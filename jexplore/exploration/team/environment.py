"""The rules of a team: turns, bodies, knowledge.

Each robot lives by the rules of `exploration.environment`: `begin`, `decide`, `commit`, `advance`. A team adds these.

Clock: a robot's clock is the length of its way and its waiting, times its pace. The robot with the least clock acts, of
equal ones that with the lowest number: it plans, or makes its scan and the next motion. Only steps and waiting take
time.
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
Rendezvous: a robot that has not heard all that explore for some time goes, when it plans, to where the first robot
started. There, or where others keep it from there, it waits until it hears them, at most for that time. After Hollinger
and Singh 2012 (periodic connectivity, IEEE Transactions on Robotics 28 (4)); changed: the place is fixed, and no robot
plans for others.
"""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import put_one, run_if, take_one
from jexplore.engine.program import Given
from jexplore.exploration import environment
from jexplore.exploration.motion import LENGTHS, motion_step
from jexplore.exploration.sensing import blank_grid
from jexplore.exploration.state import State
from jexplore.exploration.team.contact import come_together, meet, wait
from jexplore.exploration.team.coordination import joint_view
from jexplore.exploration.team.state import (
    ENDED,
    TeamSetup,
    TeamState,
    counts,
    given_of_robot,
    is_exploring,
    next_robot,
    paced_ms,
)
from jexplore.grid import Grid, count, is_known
from jexplore.native.drive import take_turns
from jexplore.native.kernels import target_of
from jexplore.planning import Belief, Choice, choose, field, first_at
from jexplore.raycast import Beams
from jexplore.reach import FAR

PATIENCE = 2  # waits in a row of robot 0 before it plans anew: fewer, and robots turn round for one that only passes


def begin(setup: TeamSetup, given: Given) -> TeamState:
    """Return a team of which each robot has made its first scans; the task is a `TeamTask`."""
    n = setup.n
    robots = lax.map(lambda i: environment.begin(setup.robot, given_of_robot(given, i)), lax.iota(jnp.int32, n))
    known, before = jnp.any(is_known(robots.belief.grid), axis=0), counts(blank_grid(given))
    zeros, zero, shape = jnp.zeros(n, jnp.int32), jnp.int32(0), known.shape
    none = jnp.zeros((n, *shape), bool)
    way = jnp.zeros((n, setup.capacity + 1, 3), jnp.int32).at[:, :, 2].set(-1)
    team = TeamState(
        robots=robots,
        clock=zeros,
        waits=zeros,
        in_a_row=zeros,
        hemmed=jnp.zeros(n, bool),
        fled=jnp.full((n, 2), -1, jnp.int32),
        shunned=none,
        since=jnp.full((n, n), -1, jnp.int32),
        acts=zero,
        heard=jnp.eye(n, dtype=bool),
        met=zeros,
        came=jnp.full(n, -1, jnp.int32),
        own=none,
        shared=jnp.broadcast_to(before, none.shape),
        seen_at=jnp.where(known, 0, ENDED),
        n_known=count(known if robots.belief.within is None else known & robots.belief.within[0]),
        log=jnp.zeros((math.prod(shape) + 1, 4), jnp.int32),
        n_log=zero,
        last=zero,
        links=zero,
        way=way.at[:, 0, 0].set(robots.row * shape[1] + robots.col),
    )
    return _note(given, team, zero, take_one(robots, 0), jnp.bool_(True))


def _note(given: Given, team: TeamState, i: Array, before: State, grew: Array) -> TeamState:
    """Note the number of known cells after a scan, made before a motion. A place and time has one entry, the last."""
    pace = given.task.paces[i]
    clock = pace * (before.straight + team.waits[i]), pace * before.diagonal
    entry = jnp.stack([team.n_known, *clock, paced_ms(before.time_ms, pace)])
    newest = team.log[jnp.maximum(team.n_log - 1, 0)]
    again = (team.n_log > 0) & (team.last == i) & (newest[1] == entry[1]) & (newest[2] == entry[2])
    at = jnp.where(again, team.n_log - 1, jnp.where(grew, team.n_log, team.log.shape[0]))
    log, more = team.log.at[at].set(entry, mode="drop"), grew & ~again
    return team.replace(log=log, n_log=team.n_log + more, last=jnp.where(more, i, team.last))


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
    return belief.replace(grid=grid, driven=driven, exhausted=belief.exhausted | take_one(team.shunned, i))


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
    """Have the robot whose turn it is plan, and make the first motion; or wait at the rendezvous."""
    i = next_robot(team)
    team, heard = meet(given, team, i, plans=True)
    if not setup.meets:
        return _plan(setup, given, team, i, heard, jnp.bool_(False))
    team, is_due, waits = come_together(given, team, i)
    team = run_if(waits, lambda team: wait(given, team, i), team)
    return run_if(~waits, lambda team: _plan(setup, given, team, i, heard, is_due), team)


def _plan(setup: TeamSetup, given: Given, team: TeamState, i: Array, heard: Array, is_due: Array) -> TeamState:
    """Have a robot plan, and make the first motion; `is_due`: it is to go to the rendezvous, unless it has ended."""
    own, state = given_of_robot(given, i), take_one(team.robots, i)
    if setup.n == 1:
        carry, choice, route = _ask(setup, own, team, i, state, heard)
        live: Any = True
    else:
        hemmed = _hemmed_in(team, i, state.belief)
        carry, choice, route = _ask(setup, own, team, i, state.replace(belief=hemmed), heard)
        live = ~(team.hemmed[i] & (choice.row < 0))
        if setup.meets:
            returns, asked = is_due & ~team.hemmed[i] & (choice.row >= 0), (choice, route, jnp.bool_(False))
            *found, goes = run_if(returns, lambda _: environment.go_to(hemmed, route, *given.task.starts[0, :2]), asked)
            choice, route = jax.tree.map(lambda new, old: jnp.where(goes, new, old), tuple(found), asked[:2])
            state = state.replace(homing=goes.astype(jnp.int32))  # its target may show nothing
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
    """Have the robot whose turn it is make its scan and the next motion of its plan.

    In native code the others do so as well, until one must plan, where all always hear each other.
    """
    i = next_robot(team)
    team, heard = meet(given, team, i, plans=False)
    if target_of(setup.native):
        goes_on = False if setup.meets else (setup.n == 1) | given.task.contact.is_always
        own, n_heard = functools.partial(given_of_robot, given), jnp.sum(heard)
        return take_turns(setup, given, own, team, i, n_heard, goes_on)
    own, state = given_of_robot(given, i), take_one(team.robots, i)
    held = is_held(team, i, state.route[state.belief.row, state.belief.col])
    after = environment.advance(setup.robot, own, state, held)
    # What a robot knew before is in `seen_at`.
    new = is_known(after.belief.grid) & (team.seen_at == ENDED)
    grew = count(new if state.belief.within is None else new & state.belief.within)
    team = team.replace(seen_at=jnp.where(new, team.clock[i], team.seen_at), n_known=team.n_known + grew)
    return act(given, _note(given, team, i, state, grew > 0), i, state, after, heard, held)


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
    clock = given.task.paces[i] * (LENGTHS[0] * (after.straight + waits[i]) + LENGTHS[1] * after.diagonal)
    step = jnp.where(moved, after.steps, team.way.shape[1])
    target = jnp.where(after.target[0] < 0, -1, after.target[0] * after.shape[1] + after.target[1])
    here = jnp.stack([after.row * after.shape[1] + after.col, clock, target])
    return team.replace(
        robots=put_one(team.robots, i, after),
        clock=team.clock.at[i].set(clock),
        waits=waits,
        hemmed=team.hemmed.at[i].set(gives_up),
        links=team.links + jnp.where(moved, jnp.sum(heard, dtype=jnp.int32) - 1, 0),
        way=team.way.at[i, step].set(here, mode="drop"),
    )
