"""Glances: whether a window round the robot settles which frontier is the nearest, by work that is the same whatever is
in it. For many robots on an accelerator; what it finds is what `planning.nearest_in_window` does.

Within a window a way has so few motions that lengths of 70 for a straight step and 99 for a diagonal one order them as
costs do, equal ones included: 99 / 70 is a continued fraction's convergent, and no fraction with a smaller denominator
lies between it and the ratio of the costs. They need two bytes.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import stored
from jexplore.grid import lowest
from jexplore.planning import Belief, Choice, bound_of, corner_of, cut_out, first_at, masks_of
from jexplore.planning.readout import Way, last_motions, way_by_doubling
from jexplore.reach import DIAGONAL, FAR, STRAIGHT, motions_into, relaxed

UNITS = (70, 99)  # what a straight and a diagonal step cost in a window
MOST = 64  # motions of a way, in whole `ROUNDS`, that these tell apart: fewer than a straight step's units
UNREACHED = 2**14
INVERSE = 29  # 29 * 99 is 1 more than a multiple of 70


@struct.dataclass
class Glance:
    """What a glance has found."""

    settled: Array  # bool, whether the window settles it
    choice: Choice
    way: Way  # from the robot to the target; without any motion where it is not settled
    cost: Array  # [h, w] int16, in `UNITS`, final up to the window's bound; UNREACHED elsewhere


def costs_of(units: Array) -> Array:
    """Costs (see `reach`) of what has been counted in `UNITS`, int16 or int32; FAR of what is unreached."""
    units = units.astype(jnp.int32)
    diagonal = INVERSE * units % UNITS[0]
    cost = (units - UNITS[1] * diagonal) // UNITS[0] * STRAIGHT + diagonal * DIAGONAL
    return jnp.where(units < UNREACHED, cost, FAR)


def placed(
    units: Array, side: int, belief: Belief, origin: tuple[Array | int, Array | int], shape: tuple[int, int]
) -> Array:
    """What a glance has found of a window, in a larger one or in the whole map.

    Args:
      units: `[h, w]` int16, `Glance.cost`.
      side: of its window. Static.
      belief: `Belief` that it was made of.
      origin, shape: of the larger one, which need not end where the map does. Shape static.

    Returns:
      `[H, W]` int16 of that shape; UNREACHED outside the window.
    """
    corner, _ = corner_of(belief, side)
    row = lax.broadcasted_iota(jnp.int32, shape, 0) + (origin[0] - corner[0])
    col = lax.broadcasted_iota(jnp.int32, shape, 1) + (origin[1] - corner[1])
    within = (row >= 0) & (row < units.shape[0]) & (col >= 0) & (col < units.shape[1])
    at = jnp.where(within, row * units.shape[1] + col, 0)
    return jnp.where(within, units.reshape(-1).at[at].get(mode="promise_in_bounds"), jnp.int16(UNREACHED))


def glance(belief: Belief, side: int, before: Array | None = None, side_before: int = 0) -> Glance:
    """The nearest frontier if a window settles it.

    Args:
      belief: `Belief`.
      side: of the window, one of `planning.windows`. Static.
      before: `Glance.cost` of a smaller window that has not settled it, from which the wave goes on; None: none has.
      side_before: of that window. Static.

    Returns:
      `Glance`. Equal costs go to the lowest flat index.
    """
    radius, settled_before = (bound_of(n, belief.model.clearance_d2) // STRAIGHT for n in (side, side_before))
    rounds = radius if before is None else radius - settled_before
    if radius > MOST:
        raise ValueError(f"expected a window that is settled within {MOST} cells, got side {side}")
    origin, shape = corner_of(belief, side)
    row, col = belief.row - origin[0], belief.col - origin[1]
    rows, cols = (jnp.abs(lax.broadcasted_iota(jnp.int32, shape, axis) - at) for axis, at in ((0, row), (1, col)))
    masks = masks_of(cut_out(belief, origin, shape), origin)
    central = stored(row >= 0, lambda: bits.pack((rows <= radius) & (cols <= radius)))
    words, frontier = masks.traversable & central, bits.unpack(masks.frontier & central)
    height = bits.WORD * words.shape[0]
    if before is None:
        start = jnp.where((rows == 0) & (cols == 0), jnp.int16(0), jnp.int16(UNREACHED))
    else:
        start = placed(before, side_before, belief, origin, shape)
    start = jnp.pad(start, ((0, height - shape[0]), (0, 0)), constant_values=UNREACHED)
    with jax.named_scope("wave"):
        units = relaxed(start, motions_into(words), UNITS, rounds, far=UNREACHED)
    best = lowest(jnp.where(frontier, units, UNREACHED))
    settled = best <= UNITS[0] * radius
    at = first_at(frontier & (units == best))
    target = jnp.where(settled, at[0], row), jnp.where(settled, at[1], col)
    with jax.named_scope("route"):
        motions = last_motions(units, bits.unpack(words), UNITS, UNREACHED)
        way = way_by_doubling(motions, target, origin, belief.driven.shape[0], n=radius)
    choice = Choice(target[0] + origin[0], target[1] + origin[1], costs_of(best), jnp.int32(0))
    return Glance(settled, choice, way, units[: shape[0]])
