"""Exploration transform: the way to a frontier on which length and danger together are least.

Wirth and Pellenz, "Exploration Transform: A Stable Exploring Algorithm for Robots in Rescue Environments", SSRR 2007:
the transform of a cell is the least `l(C) + alpha sum_c c_danger(c)` over all paths C from it to any frontier cell,
with `c_danger = (d_safe - d)^2` where an obstacle is nearer than d_safe; the robot follows its steepest descent. The
defaults are those of their package homer_navigation: 0.7 m and, in cells of 0.05 m, alpha = 1.2. Left out: danger in
wide open space, which neither that package nor hector_exploration_planner computes; hector's penalty for frontiers
behind the robot; its search for inner frontiers and along walls once no frontier is left.
"""

from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import repeat
from jexplore.config import require_number
from jexplore.distance import nearest_offset
from jexplore.grid import is_occupied
from jexplore.planning import Belief, Choice, Field, choose, field, nearest_of
from jexplore.policies.policy import Policy, Span, no_carry
from jexplore.raycast import Beams
from jexplore.reach import FAR, MOTIONS, spread

STEPS = (4096, 5793)  # costs of a straight and a diagonal step: danger makes ways up to 2**18 steps long
MOST = 2**25  # largest danger of a cell, 8192 steps


class Params(NamedTuple):
    """Parameters."""

    weight: float  # 1/m^2; alpha times the square of the cells in a metre
    safe_m: float  # from an obstacle there is no danger


def transform(params: Params, belief: Belief, reached: Field) -> Array:
    """Compute the exploration transform: `[H, W]` int32, in `STEPS`; FAR where no way leads to a frontier."""
    off_m = jnp.sqrt(nearest_offset(is_occupied(belief.grid, belief.model.p_free))[0]) * belief.model.cell_m
    danger = params.weight * jnp.maximum(params.safe_m - off_m, 0) ** 2
    danger = jnp.round(jnp.minimum(danger * STEPS[0], MOST)).astype(jnp.int32)
    start = jnp.where(reached.frontier, 0, FAR)
    return spread(bits.pack(reached.traversable), start, steps=STEPS, extra=danger)[: start.shape[0]]


def descent(value: Array, traversable: Array, row: Array, col: Array) -> tuple[Array, Array, Array]:
    """Follow the steepest descent of a transform: where it ends, and the motion at each of its cells, `[H, W]` int8."""
    value_, can = jnp.pad(value, 1, constant_values=FAR), jnp.pad(traversable, 1)
    moves = jnp.asarray(MOTIONS, jnp.int32)

    def going(state):
        n, row, col, _ = state
        return (value[row, col] > 0) & (value[row, col] < FAR) & (n < value.size)

    def descend(state):
        n, row, col, motions = state
        on = going(state)
        near, free = (lax.dynamic_slice(a, (row, col), (3, 3)) for a in (value_, can))
        after = [
            jnp.where(
                free[1 + drow, 1 + dcol] & free[1 + drow, 1] & free[1, 1 + dcol],
                near[1 + drow, 1 + dcol] + STEPS[bool(drow and dcol)],
                FAR,
            )
            for drow, dcol in MOTIONS
        ]
        best = jnp.argmin(jnp.stack(after))
        motion = jnp.where(on, best.astype(jnp.int8), motions[row, col])
        motions = lax.dynamic_update_slice(motions, motion[None, None], (row, col))
        return n + on, *(jnp.where(on, at + moves[best, axis], at) for axis, at in enumerate((row, col))), motions

    state = jnp.int32(0), row, col, jnp.full(value.shape, -1, jnp.int8)
    return repeat(going, descend, state)[1:]


def _select(
    key: Array, params: Params, carry: Any, belief: Belief, beams: Beams, route: Array
) -> tuple[Any, Choice, Array]:
    reached = field(belief)
    value = transform(params, belief, reached)
    found = value[belief.row, belief.col] < FAR
    *end, motions = descent(value, reached.traversable, belief.row, belief.col)
    # Where danger makes every way too long, and without a frontier: as `closest`.
    target = (jnp.where(found, at, nearest) for at, nearest in zip(end, nearest_of(reached)))
    choice, route = choose(belief, route, reached, *target)
    return carry, choice, jnp.where(motions >= 0, motions, route)


def exploration_transform(
    weight: Annotated[float, Span(1.0, 1000.0, is_log=True)] = 480.0,
    safe_m: Annotated[float, Span(0.3, 1.5)] = 0.7,
) -> Policy:
    """Return the policy. Carry: `()`. Parameters: `Params`."""
    given = {"weight": weight, "safe_m": safe_m}
    return Policy(no_carry, _select, Params(*(require_number(name, a, high=1e4) for name, a in given.items())))
