"""Planning in pieces, for many robots on an accelerator: to the nearest frontier in windows at a glance, in the whole
map by a search that goes on from turn to turn. Its choices and ways are those of `planning.nearest_frontier`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, Self

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.engine.program import Given, Pieces
from jexplore.exploration import environment
from jexplore.exploration.state import Setup, State
from jexplore.planning import Choice, Field, bound_of, masks_of, nearest_of
from jexplore.planning.glances import costs_of, glance, placed
from jexplore.planning.readout import Way, last_motions_by, way_by_steps
from jexplore.planning.waves import shut_ways
from jexplore.reach import FAR, STEPS, motions_into, saturated, source, spread

PIECE, BACK = 32, 96  # rounds of the wave in a piece, and motions of the way back


@struct.dataclass
class Search:
    """The nearest frontier of a whole map, looked for; then the way to it, laid from its end."""

    traversable: Array  # [K, W] uint32, packed
    frontier: Array  # [K, W] uint32, packed
    start: Array  # [2] int32, row and col
    settled: Array  # int32, costs up to it are final; FAR once the wave has ended
    cost: Array  # [32 K, W] int32
    target: Array  # [2] int32, row and col; -1 for none, and before the wave has ended
    at: Array  # [2] int32, where the part of the way that has been laid begins
    motion: Array  # int32, the first motion of the way, once it has been laid
    replace: ClassVar[Callable[..., Self]]


@struct.dataclass
class Planned:
    """What a plan writes into the large arrays of a state, besides its way."""

    number: Array  # int32, of the plan
    entry: Array  # [2] int32, in the record of plans
    exhausted: Array  # [2] int32, row and col to be marked; beyond the last row for none


@struct.dataclass
class Notes:
    """What deciding writes into the large arrays of a state."""

    way: Way | None  # into the route
    plan: Planned | None


def _settle(setup, given, state, choice, motion, way):
    """`environment.settle`: `(state, notes)`."""
    new, spent, entry = environment.settle(setup, given, state, choice, motion)
    row = jnp.where(spent, new.target[0], state.shape[0])
    return new, Notes(way, Planned(state.plans, entry, jnp.stack([row, new.target[1]])))


def write(state: State, lane: Array, notes: Notes) -> State:
    """Writes what some lanes have noted.

    Args:
      state: `State` of L lanes.
      lane: `[m]` int32, none of them twice; beyond the last for what is to be dropped.
      notes: `Notes` of m lanes.
    """
    once = {"mode": "drop", "unique_indices": True}
    if (way := notes.way) is not None:
        state = state.replace(route=state.route.at[lane[:, None], way.rows, way.cols].set(way.motions, **once))
    if (plan := notes.plan) is None:
        return state
    exhausted = state.belief.exhausted.at[lane, plan.exhausted[:, 0], plan.exhausted[:, 1]].set(True, **once)
    choices = state.choices.at[lane, plan.number].set(plan.entry, **once)
    return state.replace(choices=choices, belief=state.belief.replace(exhausted=exhausted))


@dataclasses.dataclass(frozen=True)
class Glance:
    """Whether a window settles it."""

    side: int
    before: int  # side of the window that was glanced at before; 0 for none

    def __call__(self, setup: Setup, given: Given, state: State, seen: Any) -> tuple[Array, State, Notes, Array]:
        """`(settled, state, notes, seen)`: with the next plan under way, if it is settled."""
        found = glance(state.belief, self.side, seen if self.before else None, self.before)
        motion = found.way.first(state.belief.row, state.belief.col)
        return found.settled, *_settle(setup, given, state, found.choice, motion, found.way), found.cost


@dataclasses.dataclass(frozen=True)
class Begin:
    """A search, from what the last glance has seen."""

    before: int  # side of its window; 0 for none

    def __call__(self, setup: Setup, given: Given, state: State, seen: Any) -> Search:
        """`Search`."""
        del setup, given
        belief, masks = state.belief, masks_of(state.belief)
        start = jnp.stack([belief.row, belief.col])
        none = jnp.full(2, -1, jnp.int32)
        shape = bits.WORD * masks.traversable.shape[0], masks.traversable.shape[1]
        settled, cost = 0, source(shape, belief.row, belief.col)
        if self.before:
            settled, cost = (
                bound_of(self.before, belief.model.clearance_d2),
                costs_of(placed(seen, self.before, belief, shape)),
            )
        return Search(masks.traversable, masks.frontier, start, jnp.int32(settled), cost, none, start, jnp.int32(0))


def _go_on(search):
    """Some rounds of the wave; where it has ended, some motions of the way back."""
    goals, before = bits.unpack(search.frontier), search.settled
    ways_in = motions_into(search.traversable)
    settled, cost = spread(ways_in, (before, search.cost), goals, rounds=PIECE)
    # A wave that has ended runs on idly: what it finds to be cheaper lies beyond the target.
    settled = jnp.where(before >= FAR, FAR, settled)
    known = Field(bits.unpack(search.traversable), cost, goals & (cost < FAR))
    ends = (settled >= FAR) & (before < FAR)
    target = jnp.where(ends, jnp.stack(nearest_of(known)), search.target)
    at = jnp.where(ends & (target[0] >= 0), target, search.at)
    # Made once, and not for every step that is looked up.
    motions = lax.optimization_barrier(last_motions_by(cost, shut_ways(ways_in), STEPS, FAR))
    at, way = way_by_steps(motions, (at[0], at[1]), (0, 0), cost.shape[0], n=BACK)
    motion = search.motion + way.first(*search.start)
    return search.replace(settled=settled, cost=cost, target=target, at=jnp.stack(at), motion=motion), Notes(way, None)


def _is_done(search):
    return (search.settled >= FAR) & jnp.all(search.at == search.start)


def _conclude(setup, given, state, search):
    row, col = search.target
    none = row < 0
    cost = jnp.where(none, FAR, search.cost[jnp.maximum(row, 0), jnp.maximum(col, 0)])
    # All that can be reached has been by the end of a search that found nothing.
    beyond = saturated(search.cost, bits.unpack(search.traversable), packing="halves")
    choice = Choice(row, col, cost, jnp.where(none, beyond, 0))
    return _settle(setup, given, state, choice, search.motion, None)


def pieces_of(windows: tuple[int, ...]) -> Pieces:
    """`Pieces` of planning to the nearest frontier.

    Args:
      windows: sides, from `planning.windows`.
    """
    before = (0, *windows)
    glances: tuple[Any, ...] = tuple(Glance(side, last) for side, last in zip(windows, before))
    return Pieces(glances, Begin(before[-1]), _go_on, _is_done, _conclude, write)
