"""A team step by step, for whoever chooses all targets itself; rules as in `team.environment`."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import run_if, take_one
from jexplore.config import InputError, require_whole
from jexplore.engine.program import Given
from jexplore.exploration import environment
from jexplore.exploration.motion import LENGTHS
from jexplore.exploration.state import Outcome, Setup, steps_m
from jexplore.exploration.team.contact import meet
from jexplore.exploration.team.environment import act, advance, begin, is_held
from jexplore.exploration.team.episode import of_ranges
from jexplore.exploration.team.state import (
    TeamSetup,
    TeamState,
    TeamTask,
    given_of_robot,
    is_done,
    is_exploring,
    must_decide,
    next_robot,
)
from jexplore.exploration.team.team import EVERYBODY, MOST_ROBOTS, Contact, Member, read_members
from jexplore.planning import Field, choose, field, is_live
from jexplore.raycast import Beams
from jexplore.reach import FAR
from jexplore.rules import Lidar


def ready_team(robots: int, members: str | Sequence[str], lidar: Lidar, is_of_one: bool) -> tuple[Member, ...]:
    """Return the robots of a team, all alike where no members are given; `is_of_one`: see the message.

    Raises:
      InputError: a size that cannot be, members of another number.
    """
    if require_whole("robots", robots, 1, MOST_ROBOTS) > 1 and is_of_one:
        raise InputError("recheck, paths, metrics and a pose that is not given are of one robot: leave out robots")
    own = read_members(members, lidar)
    if own and (robots == 1 or len(own) != robots):
        raise InputError(f"members must be one for each of 2 or more robots, got {len(own)} for {robots}")
    return own or (Member(),) * robots


def equipped(team: Sequence[Member], beams: Beams, lidar: Lidar, cell_m: float) -> tuple[Beams, Array]:
    """Return the beams of a team's robots (`of_ranges`), and their paces: `[N]` int32."""
    own = of_ranges(beams, lidar.without_noise(), cell_m, [one.range_m for one in team])
    return jax.tree.map(jnp.asarray, own), jnp.asarray([one.pace for one in team], jnp.int32)


def setup_of(robot: Setup, robots: int, cells: int) -> TeamSetup:
    """Return the static config of a team, of that of one robot; `cells` are those where robots may start."""
    if robots > cells:
        raise InputError(f"{robots} robots do not fit: a world has {cells} clear cells")
    return TeamSetup(robot._replace(native=None), robots, None, 1)


def fields(team: TeamState) -> Field:
    """Return the reachability maps of all robots: a leading axis N."""
    return lax.map(field, team.robots.belief)


def cell_inside(shape: tuple[int, ...], row: Array, col: Array) -> tuple[Array, Array, Array]:
    """Return whether a cell lies on the maps, and the cell; outside, (0, 0), which is a wall."""
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    return inside, jnp.where(inside, row, 0), jnp.where(inside, col, 0)


def _take_target(setup: TeamSetup, given: Given, team: TeamState, cell: Array) -> tuple[TeamState, Array]:
    """Have the robot whose turn it is plan: `(team, whether a path leads to the cell)`.

    Without a frontier in its map it ends; where no path leads it waits for the time of a straight step.
    """
    i = next_robot(team)
    team, heard = meet(given, team, i, plans=True)
    own, state = given_of_robot(given, i), take_one(team.robots, i)
    known, belief = field(state.belief), state.belief
    inside, row, col = cell_inside(belief.driven.shape, cell[0], cell[1])
    ends, valid = ~jnp.any(known.frontier), inside & (known.cost[row, col] < FAR)
    goes = valid & ~ends
    at = (jnp.where(goes, place, -1) for place in (row, col))
    choice, route = choose(belief, state.route, known, *at)
    held = is_held(team, i, route[belief.row, belief.col])
    live = is_live(belief, row, col)

    def commit(team: TeamState) -> TeamState:
        after = environment.commit(setup.robot, own, state, choice, route, live, held)
        return act(given, team, i, state, after, heard, held)

    def wait(team: TeamState) -> TeamState:
        clock = team.clock.at[i].add(LENGTHS[0] * given.task.paces[i])
        return team.replace(waits=team.waits.at[i].add(1), clock=clock)

    return run_if(~(goes | ends), wait, run_if(goes | ends, commit, team)), goes


def step(setup: TeamSetup, given: Given, team: TeamState, cells: Array) -> tuple[TeamState, Array]:
    """Give each robot that needs one its target, and go on until a robot needs one; that has exchanged maps then.

    Args:
      cells: `[N, 2]` int32, row and col for each robot; those of robots under way, or ended, are not looked at.

    Returns:
      The team, and for which robots a target was taken: `[N]` bool.
    """

    def going(now: Any) -> Array:
        team, waiting, _ = now
        return ~is_done(team) & (~must_decide(team) | waiting[next_robot(team)])

    def turn(now: Any) -> Any:
        team, asks = now[0], must_decide(now[0])
        i = next_robot(team)

        def plan(now: Any) -> Any:
            team, waiting, taken = now
            team, goes = _take_target(setup, given, team, cells[i])
            return team, waiting.at[i].set(False), taken.at[i].set(goes)

        planned = run_if(asks, plan, now)
        return run_if(~asks, lambda now: (advance(setup, given, now[0]), *now[1:]), planned)

    waiting = is_exploring(team) & ~team.robots.plan_active
    team, _, taken = lax.while_loop(going, turn, (team, waiting, jnp.zeros(setup.n, bool)))
    return meet(given, team, next_robot(team), plans=True)[0], taken


def begun(setup: TeamSetup, given: Given, is_bad: Array) -> TeamState:
    """Return a team; the task is a `task_of`.

    Where `is_bad`, or two start in one cell, it is over at once, as BAD_START.
    """
    starts = given.task.starts
    team, _ = meet(given, begin(setup, given), jnp.int32(0), plans=True)
    same = jnp.any(jnp.triu(jnp.all(starts[:, None, :2] == starts[:, :2], axis=-1), 1))
    outcome = jnp.where(is_bad | same, Outcome.BAD_START, team.robots.outcome)
    return team.replace(robots=team.robots.replace(outcome=outcome))


def task_of(starts: Array, paces: Array) -> TeamTask:
    """Return the task of a team that hears each other everywhere: `[N, 3]` int32 and `[N]` int32, as its fields."""
    contact = Contact(jnp.int32(EVERYBODY), jnp.bool_(False), jnp.int32(0), jnp.float32(0), jnp.int32(0))
    return TeamTask(starts, contact, paces)


def drawn(key: Array, most: int, n: Array, robots: int) -> Array:
    """Draw different numbers below n, which is at most `most`, one for each robot: `[robots]` int32."""
    order = jnp.where(lax.iota(jnp.int32, most) < n, jax.random.uniform(key, (most,)), -1.0)
    return lax.top_k(order, robots)[1]


def play(setup: TeamSetup, given: Given, team: TeamState, cells: Array) -> tuple[TeamState, Array, dict[str, Array]]:
    """Make a `step`: the team, the reward and the entries of `info`, as in `studies.environment`."""
    now, valid = step(setup, given, team, cells)
    cell_m = given.numbers.model.cell_m
    before, after = (steps_m(jnp.sum(one.robots.straight), jnp.sum(one.robots.diagonal), cell_m) for one in (team, now))
    outcome = jnp.max(jax.vmap(environment.outcome_of)(now.robots))
    info = {"valid": valid, "outcome": outcome, "path_m": after, "known_m2": now.n_known * cell_m**2}
    return now, before - after, info
