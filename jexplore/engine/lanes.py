"""Episodes in lockstep: L lanes that scan, move and plan together, as an accelerator wants it.

No lane waits for the slowest. All lanes make a step in every turn; those whose plan is done wait until there are enough
of them to fill a group, which is gathered and plans on its own; those whose episode has ended are measured, and filled
again from the queue, in groups as well. Results are written by their place in the queue.
"""

import functools
import math

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import first_lanes, put, take
from jexplore.exploration import episode
from jexplore.exploration.episode import Numbers, Outcome, Result, State
from jexplore.grid import Grid
from jexplore.raycast import BLOCK

PLANNERS = 8  # one lane in so many plans at a time: at most so large a share of the lanes waits
STARTERS = 16  # one lane in so many is measured and started at a time


@struct.dataclass
class Lines:
    """J strategies in worlds that share a compiled program."""

    world: Array  # [J] int32, which of the worlds in `Truth`
    seed: Array  # [J] uint32
    numbers: Numbers  # [J]


@struct.dataclass
class Queue:
    """The episodes to be run: N, of which the first `count` are real."""

    line: Array  # [N] int32
    number: Array  # [N] int32, with its line's seed it makes the episode's key
    start: Array  # [N, 3] int32, row, col, heading (units of 45 degrees)
    count: Array  # int32


@struct.dataclass
class Use:
    """How much of the work was useful."""

    turns: Array  # int32
    walked: Array  # int32, lanes that made a step or a scan in these turns
    groups: Array  # int32, groups that planned
    planned: Array  # int32, lanes in these groups


@struct.dataclass
class Work:
    """Lanes under way and what they have found."""

    at: Array  # [L] int32, place in the queue; -1: none
    state: State  # [L]
    next: Array  # int32, place in the queue of the next episode to be started
    done: Array  # int32, episodes that have ended
    results: Result  # [N]; outcome RUNNING where there is none yet
    grids: Grid  # [J, H, W], the last map of episode 0 of each line
    trails: Array  # [J, T + 1, 3] int32, its trail


def _blank(tree, n=None):
    """Zeros like shapes, with a leading axis of n."""
    lead = () if n is None else (n,)
    return jax.tree.map(lambda x: jnp.zeros((*lead, *x.shape), x.dtype), tree)


def empty(setup, queue, lines, truth, beams, n_lanes):
    """`Work` that nothing has been done of.

    Args:
      setup: `episode.Setup`. Static.
      queue, lines, truth, beams: `Queue`, `Lines`, `Truth`, `Beams`.
      n_lanes: L. Static.
    """
    zero = jnp.int32(0)

    def one():
        numbers = take(lines.numbers, zero)
        state = episode.begin(jax.random.key(0), setup, truth, beams, numbers, zero, jnp.zeros(3, jnp.int32))
        return state, episode.finish(truth, state)

    state, result = jax.eval_shape(one)
    n_lines = lines.world.shape[0]
    return Work(
        at=jnp.full((n_lanes,), -1, jnp.int32),
        state=_blank(state, n_lanes),
        next=zero,
        done=zero,
        results=_blank(result, queue.line.shape[0]),
        grids=_blank(state.belief.grid, n_lines),
        trails=_blank(state.trail, n_lines),
    )


def lane_bytes(work, beams):
    """An estimate of what one lane needs, with its share of what planning, starting and scanning need in between."""
    n_lanes = work.at.shape[0]
    own = sum(math.prod(a.shape) * a.dtype.itemsize for a in jax.tree.leaves(work.state)) // n_lanes
    cells = math.prod(work.state.belief.driven.shape[1:])
    planning = 2 * own // PLANNERS + 2 * own // STARTERS + 40 * cells // PLANNERS
    return own + planning + 12 * math.prod(beams.offset.shape[1:]) + 16 * BLOCK


def _select(mask, new, old):
    """Small leaves of lanes that do nothing are kept; large ones have been left as they were."""
    return jax.tree.map(
        lambda a, b: jnp.where(mask.reshape(-1, *[1] * (a.ndim - 1)), a, b) if a.ndim <= 2 else a, new, old
    )


def _keys(lines, queue, at):
    line = queue.line[at]

    def key(seed, number):
        return jax.random.fold_in(jax.random.key(seed), number)

    return jax.vmap(key)(lines.seed[line], queue.number[at])


def _measure(queue, truth, work, m):
    """Writes the results of up to m lanes whose episode has ended, and frees the lanes."""
    n = queue.line.shape[0]
    ended = (work.at >= 0) & (work.state.outcome != Outcome.RUNNING)
    lanes = first_lanes(ended, m)
    real = lanes < work.at.shape[0]
    at = jnp.where(real, take(work.at, lanes), n)
    state = take(work.state, lanes)
    result = jax.vmap(functools.partial(episode.finish, truth))(state)
    line = jnp.where(real & (take(queue.number, at) == 0), take(queue.line, at), work.trails.shape[0])
    return work.replace(
        at=work.at.at[lanes].set(-1, mode="drop"),
        done=work.done + jnp.sum(real, dtype=jnp.int32),
        results=put(work.results, at, result),
        grids=put(work.grids, line, state.belief.grid),
        trails=put(work.trails, line, state.trail),
    )


def _start(setup, queue, lines, truth, beams, work, m):
    """Starts up to m episodes in free lanes."""
    lanes = first_lanes(work.at < 0, m)
    at = work.next + lax.iota(jnp.int32, m)
    real = (lanes < work.at.shape[0]) & (at < queue.count)
    at = jnp.where(real, at, 0)
    line = queue.line[at]

    def one(key, numbers, world, start):
        return episode.begin(key, setup, truth, beams, numbers, world, start)

    state = jax.vmap(one)(_keys(lines, queue, at), take(lines.numbers, line), lines.world[line], queue.start[at])
    lanes = jnp.where(real, lanes, work.at.shape[0])
    return work.replace(
        at=work.at.at[lanes].set(at, mode="drop"),
        state=put(work.state, lanes, state),
        next=work.next + jnp.sum(real, dtype=jnp.int32),
    )


def _plan(setup, queue, lines, truth, beams, work, m):
    """Up to m lanes without a plan make one: `(work, how many)`."""
    lanes = first_lanes(_waiting(work), m)
    at = take(work.at, lanes)
    numbers = take(lines.numbers, queue.line[at])

    def one(key, numbers, state):
        return episode.limit_plans(numbers, episode.plan(key, setup, truth, beams, numbers, state))

    # Planning neither reads the trail and the goal, nor changes the map and the way driven.
    old = work.state.replace(trail=None, goal=None)
    new = jax.vmap(one)(_keys(lines, queue, at), numbers, take(old, lanes))
    without = [s.replace(belief=s.belief.replace(grid=None, driven=None)) for s in (old, new)]
    state = put(without[0], lanes, without[1])
    state = state.replace(
        trail=work.state.trail,
        goal=work.state.goal,
        belief=state.belief.replace(grid=work.state.belief.grid, driven=work.state.belief.driven),
    )
    return work.replace(state=state), jnp.sum(lanes < work.at.shape[0], dtype=jnp.int32)


def _advance(setup, queue, lines, truth, beams, work):
    """One scan and motion of every lane that carries out a plan."""
    at = jnp.maximum(work.at, 0)
    numbers = take(lines.numbers, queue.line[at])

    def one(key, numbers, state):
        return episode.limit_plans(numbers, episode.advance(key, setup, truth, beams, numbers, state))

    new = jax.vmap(one)(_keys(lines, queue, at), numbers, work.state)
    return work.replace(state=_select(work.state.walking, new, work.state))


def _waiting(work):
    return (work.at >= 0) & (work.state.outcome == Outcome.RUNNING) & ~work.state.walking


def _count(mask):
    return jnp.sum(mask, dtype=jnp.int32)


def go_on(setup, work, queue, turns, lines, truth, beams):
    """Some turns, or as many as it takes until the queue is done.

    Args:
      setup: `episode.Setup`. Static.
      work: `Work`.
      queue: `Queue`.
      turns: int32.
      lines, truth, beams: `Lines`, `Truth`, `Beams`.

    Returns:
      `(Work, Use)`.
    """
    n_lanes = work.at.shape[0]
    planners, starters = -(-n_lanes // PLANNERS), -(-n_lanes // STARTERS)

    def change(work):
        """Whether lanes are to be measured or started now: enough for a group, or nothing else to do."""
        free, left = _count(work.at < 0), queue.count - work.next
        ended = _count((work.at >= 0) & (work.state.outcome != Outcome.RUNNING))
        startable = jnp.minimum(free, left)
        idle = ~jnp.any((work.at >= 0) & (work.state.outcome == Outcome.RUNNING))
        return (ended >= starters) | (startable >= starters) | (idle & ((ended > 0) | (startable > 0)))

    def changed(work):
        work = _measure(queue, truth, work, starters)
        return _start(setup, queue, lines, truth, beams, work, starters)

    def must_plan(state):
        work, _ = state
        waiting = _count(_waiting(work))
        return (waiting >= planners) | ((waiting > 0) & ~jnp.any(work.state.walking & (work.at >= 0)))

    def planned(state):
        work, use = state
        work, n = _plan(setup, queue, lines, truth, beams, work, planners)
        return work, use.replace(groups=use.groups + 1, planned=use.planned + n)

    def turn(state):
        work, use = state
        work = lax.while_loop(change, changed, work)
        work, use = lax.while_loop(must_plan, planned, (work, use))
        walked = _count(work.state.walking)
        work = _advance(setup, queue, lines, truth, beams, work)
        return work, use.replace(turns=use.turns + 1, walked=use.walked + walked)

    def under_way(state):
        work, use = state
        return (use.turns < turns) & (work.done < queue.count)

    zero = jnp.int32(0)
    return lax.while_loop(under_way, turn, (work, Use(turns=zero, walked=zero, groups=zero, planned=zero)))
