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
from jexplore.planning import Choice, Field, masks_of, nearest_in_window, nearest_of
from jexplore.planning.readout import STRIDES, last_motions, lay_some
from jexplore.reach import FAR, motions_into, saturated, source, spread

PIECE, BACK = 16, 32  # rounds of the wave in a piece, and motions of the way back


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
    route: Array  # [H, W] int8, see `planning.readout.lay_route`
    replace: ClassVar[Callable[..., Self]]


@dataclasses.dataclass(frozen=True)
class Glance:
    """Whether a window settles it."""

    side: int

    def __call__(self, setup: Setup, given: Given, state: State) -> tuple[Array, State]:
        """`(settled, state)`: with the next plan under way, if it is settled."""
        undecided, choice, route = nearest_in_window(state.belief, state.route, self.side, fixed=True)
        return ~undecided, environment.commit(setup, given, state, choice, route)


def _begin(setup, given, state):
    del setup, given
    belief, masks = state.belief, masks_of(state.belief)
    start = jnp.stack([belief.row, belief.col])
    none = jnp.full(2, -1, jnp.int32)
    shape = bits.WORD * masks.traversable.shape[0], masks.traversable.shape[1]
    cost = source(shape, belief.row, belief.col)
    # Whatever way was laid before: what is not on the new one is never read.
    return Search(masks.traversable, masks.frontier, start, jnp.int32(0), cost, none, start, state.route)


def _go_on(search):
    """Some rounds of the wave; where it has ended, some motions of the way back."""
    height = search.route.shape[0]
    goals, before = bits.unpack(search.frontier), search.settled
    settled, cost = spread(motions_into(search.traversable), (before, search.cost), goals, rounds=PIECE)
    # A wave that has ended runs on idly: what it finds to be cheaper lies beyond the target.
    settled = jnp.where(before >= FAR, FAR, settled)
    known = Field(bits.unpack(search.traversable)[:height], cost[:height], (goals & (cost < FAR))[:height])
    ends = (settled >= FAR) & (before < FAR)
    target = jnp.where(ends, jnp.stack(nearest_of(known)), search.target)
    at = jnp.where(ends & (target[0] >= 0), target, search.at)
    motions, route = last_motions(known.cost, known.traversable), search.route
    stride, start = STRIDES["wave"], (search.start[0], search.start[1])

    def lay(_, state):
        return lay_some(state[1], motions, start, state[0], (0, 0), n=stride)

    at, route = lax.fori_loop(0, BACK // stride, lay, ((at[0], at[1]), search.route))
    return search.replace(settled=settled, cost=cost, target=target, at=jnp.stack(at), route=route)


def _is_done(search):
    return (search.settled >= FAR) & jnp.all(search.at == search.start)


def _conclude(setup, given, state, search):
    row, col = search.target
    none, shape = row < 0, search.route.shape
    cost = jnp.where(none, FAR, search.cost[jnp.maximum(row, 0), jnp.maximum(col, 0)])
    # All that can be reached has been by the end of a search that found nothing.
    beyond = saturated(search.cost[: shape[0]], bits.unpack(search.traversable)[: shape[0]])
    choice = Choice(row, col, cost, jnp.where(none, beyond, 0))
    return environment.commit(setup, given, state, choice, search.route)


def pieces_of(windows: tuple[int, ...]) -> Pieces:
    """`Pieces` of planning to the nearest frontier.

    Args:
      windows: sides, from `planning.windows`.
    """
    glances: tuple[Any, ...] = tuple(Glance(side) for side in windows)
    return Pieces(glances, _begin, _go_on, _is_done, _conclude)
