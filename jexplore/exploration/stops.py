"""An episode once more, seen at some of its steps only: one compiled loop runs from each to the next.

`replay` shows every scan and comes back to the host for each; where a few hundred of many thousands are wanted, this is
many times faster.
"""

import functools
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from numpy.typing import ArrayLike

from jexplore.arrays.loops import run_if
from jexplore.engine.draws import pinned_draws, random_key
from jexplore.engine.program import Given
from jexplore.exploration import environment
from jexplore.exploration.replay import target_of
from jexplore.exploration.site import Site, tasks_of
from jexplore.exploration.state import State
from jexplore.exploration.trail import CHOICES, Final
from jexplore.planning import Belief, Choice
from jexplore.policies.policy import Policy, Strategy
from jexplore.reach import FAR, MOTIONS, NO_MOTION


class Stop(NamedTuple):
    """An episode as the robot leaves a place, or ends there."""

    step: int  # steps made before
    row: int  # in the world
    col: int
    heading: int  # units of 45 degrees, at the last scan there
    belief: Belief  # after that scan; with the site's ring and padding, on the device, until the next `Stop`


class _Script(NamedTuple):
    """The record of an episode, as long as there is room for."""

    motions: Array  # [T] int8, of each step
    targets: Array  # [P, 2] int32, row and col of each plan; -1: there was none
    is_view: Array  # [P] bool
    is_bad: Array  # [P] bool, whether it was refused
    until: Array  # [P] int32, steps made when it was done
    refused: Array  # [P] int8, the motion with which it ended because the way was blocked; -1: none
    n_plans: Array  # int32


def _nothing(params, belief):
    del params, belief
    return ()


def _never(key, params, carry, belief, beams, route):
    raise AssertionError("a record asks no strategy")


def _bare(setup, numbers):
    """Strip a strategy to `live`, so that all strategies without one share a compiled program."""
    live = setup.policy.live
    params = () if live is None else numbers.params
    return setup._replace(policy=Policy(_nothing, _never, (), live)), numbers.replace(params=params)


def _script(final, capacity, ring):
    room, steps = -(-capacity // CHOICES), len(final.rows) - 1
    script = _Script(
        motions=np.full(capacity, NO_MOTION, np.int8),  # type: ignore[arg-type]  # numpy on the host, here and below
        targets=np.full((room, 2), -1, np.int32),  # type: ignore[arg-type]
        is_view=np.zeros(room, bool),  # type: ignore[arg-type]
        is_bad=np.zeros(room, bool),  # type: ignore[arg-type]
        until=np.full(room, steps, np.int32),  # type: ignore[arg-type]
        refused=np.full(room, NO_MOTION, np.int8),  # type: ignore[arg-type]
        n_plans=np.int32(len(final.plans)),  # type: ignore[arg-type]
    )
    moves = zip(np.diff(final.rows).tolist(), np.diff(final.cols).tolist())
    script.motions[:steps] = [MOTIONS.index(move) for move in moves]
    for i, plan in enumerate(final.plans):
        after = final.plans[i + 1].step if i + 1 < len(final.plans) else steps
        script.targets[i] = target_of(plan, ring)
        script.is_view[i], script.is_bad[i], script.until[i] = plan.is_view, plan.is_bad, after
        if len(plan.motions) > after - plan.step:
            script.refused[i] = plan.motions[-1]
    return script


_begin = pinned_draws()(jax.jit(environment.begin, static_argnums=0))


@pinned_draws()
@functools.partial(jax.jit, static_argnums=0, donate_argnums=3)
def _go_on(setup, given, script, state, step):
    """Return the state as the robot leaves its place after some steps, and its turn there."""

    def ahead(state, plan):
        """Return the route of the state with the next motion of a plan laid at the robot."""
        motion = jnp.where(state.steps < script.until[plan], script.motions[state.steps], script.refused[plan])
        return state.route.at[state.belief.row, state.belief.col].set(motion)

    def advance(both):
        state, _ = both
        there = state.replace(route=ahead(state, state.plans - 1))
        return environment.advance(setup, given, there), state.heading

    def commit(both):
        state, heading = both
        plan = state.plans
        cost = jnp.where(script.is_bad[plan], FAR, 0)  # what it cost is on no record
        row, col = script.targets[plan]
        choice = Choice(row, col, cost, is_view=script.is_view[plan])
        return environment.commit(setup, given, state, choice, ahead(state, plan)), heading

    def here(both):
        return both[0].steps <= step

    def turn(both):
        both = lax.while_loop(lambda both: both[0].walking & here(both), advance, both)
        return run_if(~both[0].walking & here(both) & (both[0].plans < script.n_plans), commit, both)

    def goes_on(both):
        return here(both) & (both[0].walking | (both[0].plans < script.n_plans))

    return lax.while_loop(goes_on, turn, (state, state.heading))


def stops(
    site: Site, strategy: Strategy, start: ArrayLike, seed: int, number: int, final: Final, steps: Iterable[int]
) -> Iterator[Stop]:
    """Yield an episode as it was after some numbers of steps.

    Args:
      site: `Site`, with the kernels of one robot.
      strategy: `Strategy`; asked only whether a view point is still worth going to.
      start: row, col, heading in degrees.
      seed: of the run.
      number: of the episode.
      final: the episode's record; its plans must be known.
      steps: ascending, from 0 to those of the episode.

    Yields:
      `Stop`s, one for each number of steps. What one holds is gone when the next is asked for.
    """
    setup, numbers = _bare(*site.with_strategy(strategy))
    (task,) = tasks_of(np.asarray(start)[None], site.ring)
    given = jax.device_put(
        Given(
            key=jax.random.fold_in(random_key(np.uint32(seed)), number),
            shared=site.beams,
            scenes=jax.tree.map(lambda a: a[None], site.truth),
            scene=np.int32(0),  # type: ignore[arg-type]  # numpy on the host, here and below
            numbers=numbers,
            task=task,  # type: ignore[arg-type]
        )
    )
    script, state = jax.device_put(_script(final, setup.capacity, site.ring)), _begin(setup, given)
    for step in steps:
        state, heading = _go_on(setup, given, script, state, np.int32(step))
        row, col = int(final.rows[step]), int(final.cols[step])
        yield Stop(step, row, col, int(heading), _at(state, row + site.ring, col + site.ring, heading))


def _at(state: State, row: int, col: int, heading: Array) -> Belief:
    # Where the robot is, it believes to be.
    return state.belief.replace(row=np.int32(row), col=np.int32(col), heading=heading)
