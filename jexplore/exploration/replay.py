"""An episode once more, scan by scan, by the environment's own rules with the choices that it recorded."""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from jexplore.engine.devices import pinned_draws
from jexplore.engine.program import Given, given_of
from jexplore.exploration import environment
from jexplore.exploration.site import Site, line_of
from jexplore.exploration.state import Setup, State
from jexplore.exploration.trail import Plan
from jexplore.planning import Belief, Choice
from jexplore.policies.policy import Strategy
from jexplore.reach import FAR, MOTIONS, NO_MOTION


class Moment(NamedTuple):
    """An episode just after a scan."""

    step: int  # steps made before it
    row: int  # where the scan was made, in the world
    col: int
    heading: int  # units of 45 degrees
    belief: Belief  # after it, at that place; with the site's ring and padding
    state: State  # after it, and after the motion that follows


_begin = pinned_draws()(jax.jit(environment.begin, static_argnums=0))
_advance = pinned_draws()(jax.jit(environment.advance, static_argnums=0))


@pinned_draws()
@functools.partial(jax.jit, static_argnums=0)
def _commit(
    setup: Setup, given: Given, state: State, row: Array, col: Array, is_view: Array, is_bad: Array, route: Array
) -> State:
    cost = jnp.where(is_bad, FAR, 0)  # what it cost is on no record; only whether a path led there matters
    return environment.commit(setup, given, state, Choice(row, col, cost, is_view=is_view), route)


def moments(
    site: Site, strategy: Strategy, start: ArrayLike, seed: int, number: int, plans: Any,
    on_plan: Callable[[Belief, Plan], object] = lambda belief, plan: None,
) -> Iterator[Moment]:  # fmt: skip
    """Yield every scan of an episode, first that after the scans at the start.

    Args:
      site: `Site`, with the kernels of one robot.
      strategy: asked only whether a view point is still worth going to.
      start: row, col, heading in degrees.
      seed, number: of the run, and of the episode in it.
      plans: list of `trail.Plan`.
      on_plan: called with the belief in which a plan was made, and the plan, that which ended the episode included.
    """
    starts = np.tile(np.asarray(start, np.int32), (number + 1, 1))
    line = line_of(site, site.with_strategy(strategy), starts, seed, [number])
    given, setup = jax.device_put(given_of(line, number)), line.program.setup
    state = _begin(setup, given)
    yield _moment(state, state, site.ring)
    for plan in plans:
        on_plan(state.belief, plan)
        target, route = np.array(target_of(plan, site.ring), np.int32), _route(state, plan.motions)
        state = _commit(setup, given, state, *target, np.bool_(plan.is_view), plan.is_bad, route)
        while state.plan_active:
            before, state = state, _advance(setup, given, state)
            yield _moment(before, state, site.ring)


def target_of(plan: Plan, ring: int) -> tuple[int, int]:
    """Return the target of a plan in the maps of a site with this ring; some cell if it was refused, -1 for none."""
    if plan.target is None:
        return (0, 0) if plan.is_bad else (-1, -1)
    return plan.target[0] + ring, plan.target[1] + ring


def _moment(before: State, state: State, ring: int) -> Moment:
    row, col, heading, step = (int(a) for a in (before.row, before.col, before.heading, before.steps))
    belief = before.belief
    here = state.belief.replace(row=belief.row, col=belief.col, heading=belief.heading)
    return Moment(step, row - ring, col - ring, heading, here, state)


def _route(state: State, motions: Sequence[int]) -> np.ndarray:
    """Return the map of motions of a way that begins at the robot: `[H, W]` int8."""
    route = np.full(state.shape, NO_MOTION, np.int8)
    row, col = int(state.belief.row), int(state.belief.col)
    for motion in motions:
        route[row, col] = motion
        row, col = row + MOTIONS[motion][0], col + MOTIONS[motion][1]
    return route
