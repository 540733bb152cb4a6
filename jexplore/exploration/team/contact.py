"""Whom robots of a team hear, what they then exchange, and where they meet; rules as in `team.environment`."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.arrays.loops import put_one, run_if, take_one
from jexplore.engine.program import Given
from jexplore.exploration.motion import LENGTHS, STEP, tick
from jexplore.exploration.sensing import known_cells, stacked
from jexplore.exploration.state import State, Stream
from jexplore.exploration.team.state import TeamState, counts, is_exploring, own_cells
from jexplore.grid import Grid


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


def _exchange(maps: tuple[State, Array, Array], heard: Array) -> tuple[State, Array, Array]:
    """Return robots of which those heard have exchanged maps, `TeamState.own` and `shared`."""
    robots, own, before = maps
    own = own_cells(robots, own, before)

    def shared(maps: Array) -> Array:
        most = jnp.max(jnp.where(heard[:, None, None], maps, jnp.zeros_like(maps)), axis=0)
        return jnp.where(heard[:, None, None], most, maps)

    belief = robots.belief
    grid = Grid(shared(belief.grid.hits), shared(belief.grid.misses))
    first = jnp.argmax(heard)
    n_known = known_cells(take_one(grid, first), None if belief.within is None else belief.within[0])
    belief = belief.replace(grid=grid, exhausted=shared(belief.exhausted))
    return robots.replace(belief=belief, n_known=jnp.where(heard, n_known, robots.n_known)), own, counts(grid)


def meet(given: Given, team: TeamState, i: Array, *, plans: bool) -> tuple[TeamState, Array]:
    """Have a robot exchange maps with those that it hears, if it plans or one of them is new."""
    if team.clock.shape[0] == 1:
        return team, jnp.ones(1, bool)
    heard, since = _hears(given, team, i)
    is_due = (plans & jnp.any(heard.at[i].set(False))) | jnp.any(heard & ~team.heard[i])
    maps = team.robots, team.own, team.shared
    robots, own, shared = run_if(is_due, lambda maps: _exchange(maps, heard), maps)
    team = team.replace(robots=robots, own=own, shared=shared)
    team = team.replace(since=since, acts=team.acts + 1, heard=team.heard.at[i].set(heard))
    return _note_meeting(team, i, jnp.all(heard | ~is_exploring(team))), heard


def _note_meeting(team: TeamState, i: Array, met: Array) -> TeamState:
    """Note that a robot has met all others, or need not wait for them any more, if `met`."""
    clock, came = jnp.where(met, team.clock[i], team.met[i]), jnp.where(met, -1, team.came[i])
    return team.replace(met=team.met.at[i].set(clock), came=team.came.at[i].set(came))


def come_together(given: Given, team: TeamState, i: Array) -> tuple[TeamState, Array, Array]:
    """Return the team, whether a robot is to look for the others, and whether it waits for them where it is."""
    (row, col), now, most = given.task.starts[0, :2], team.clock[i], given.task.contact.rendezvous
    is_due = now - team.met[i] >= most
    off = jnp.maximum(jnp.abs(team.robots.row[i] - row), jnp.abs(team.robots.col[i] - col))
    here = is_due & ((off == 0) | (team.hemmed[i] & (off <= team.clock.shape[0])))
    since = jnp.where(team.came[i] < 0, now, team.came[i])
    enough = here & (now - since >= most)
    team = _note_meeting(team, i, enough)
    came = jnp.where(here & ~enough, since, team.came[i])
    return team.replace(came=team.came.at[i].set(came)), is_due & ~enough, here & ~enough


def wait(given: Given, team: TeamState, i: Array) -> TeamState:
    """Have a robot stand for the time of a straight step."""
    state, table = take_one(team.robots, i), given.numbers.clock
    time = tick(table, state, state.heading, jnp.bool_(False), jnp.bool_(True), table[STEP])
    return team.replace(
        robots=put_one(team.robots, i, state.replace(**time)),
        waits=team.waits.at[i].add(1),
        clock=team.clock.at[i].add(LENGTHS[0] * given.task.paces[i]),
        hemmed=team.hemmed.at[i].set(False),
    )
