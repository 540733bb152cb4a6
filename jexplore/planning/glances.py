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
from jexplore.planning import Belief, Choice, bound_of, corner_of, cut_out, masks_of
from jexplore.planning.readout import Way, last_motions_by, way_by_doubling
from jexplore.planning.waves import SHUT, margins, outwards, room, shut_ways, width_of
from jexplore.reach import DIAGONAL, FAR, STRAIGHT, motions_into

UNITS = (70, 99)  # what a straight and a diagonal step cost in a window
MOST = 64  # motions of a way that these tell apart: fewer than a straight step's units
UNREACHED = 2**14
PLACES = 2**16  # cells that a glance can tell apart: with units before them, less than 2**31
INVERSE = 29  # 29 * 99 is 1 more than a multiple of 70
FRONTIER = 5  # bit of a cell that says so


@struct.dataclass
class Glance:
    """What a glance has found."""

    settled: Array  # bool, whether the window settles it
    choice: Choice
    way: Way  # from the robot to the target; without any motion where it is not settled
    # [2 r + 1, waves.width_of(r)] int16, the robot's cell in row and column r; in `UNITS`: final up to the window's
    # bound, above it that of some way, or UNREACHED
    cost: Array


def costs_of(units: Array) -> Array:
    """Costs (see `reach`) of what has been counted in `UNITS`, int16 or int32; FAR of what is unreached."""
    units = units.astype(jnp.int32)
    diagonal = INVERSE * units % UNITS[0]
    cost = (units - UNITS[1] * diagonal) // UNITS[0] * STRAIGHT + diagonal * DIAGONAL
    return jnp.where(units < UNREACHED, cost, FAR)


def _radius(side, belief):
    """How far a window of a side decides, cells."""
    return bound_of(side, belief.model.clearance_d2) // STRAIGHT


def placed(units: Array, side: int, belief: Belief, shape: tuple[int, int]) -> Array:
    """What a glance has found, in the whole map.

    Args:
      units: int16, `Glance.cost`.
      side: of its window. Static.
      belief: `Belief` that it was made of.
      shape: of the map. Static.

    Returns:
      `[H, W]` int16; UNREACHED outside what the glance looked at.
    """
    radius = _radius(side, belief)
    row = lax.broadcasted_iota(jnp.int32, shape, 0) - (belief.row - radius)
    col = lax.broadcasted_iota(jnp.int32, shape, 1) - (belief.col - radius)
    within = (row >= 0) & (row < units.shape[0]) & (col >= 0) & (col < units.shape[1])
    at = jnp.where(within, row * units.shape[1] + col, 0)
    return jnp.where(within, units.reshape(-1).at[at].get(mode="promise_in_bounds"), jnp.int16(UNREACHED))


def _seen_round(belief, side, radius):
    """What a window shows of the cells round the robot: `waves.shut_ways`, and in bit `FRONTIER` those of the frontier.

    Returns:
      uint8 of the shape `waves.room(radius)`, the robot's cell in that row and column that `waves.margins` says; beyond
        the radius all ways are shut.
    """
    origin, shape = corner_of(belief, side)
    row, col = belief.row - origin[0], belief.col - origin[1]
    rows, cols = (jnp.abs(lax.broadcasted_iota(jnp.int32, shape, axis) - at) for axis, at in ((0, row), (1, col)))
    masks = masks_of(cut_out(belief, origin, shape), origin)
    central = stored(row >= 0, lambda: bits.pack((rows <= radius) & (cols <= radius), method="halves"))
    words, frontier = masks.traversable & central, masks.frontier & central
    cells = shut_ways(motions_into(words)) | bits.unpack(frontier).astype(jnp.uint8) << FRONTIER
    size, (above, left) = room(radius), margins(radius)
    cells = jnp.pad(cells, ((above, above), (left, size[1] - left)), constant_values=SHUT)
    return lax.optimization_barrier(lax.dynamic_slice(cells, (row, col), size))  # once, and not in every round


def _cheapest(units, frontier):
    """The cheapest frontier cell, the first of equal ones: `(units, (row, col))`; UNREACHED for none."""
    width = units.shape[1]
    flat = lax.broadcasted_iota(jnp.int32, units.shape, 0) * width + lax.broadcasted_iota(jnp.int32, units.shape, 1)
    # Cost and cell in one number: one pass.
    low = jnp.min(jnp.where(frontier, units.astype(jnp.int32) * PLACES + flat, UNREACHED * PLACES))
    at = low % PLACES
    return low // PLACES, (at // width, at % width)


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
    radius = _radius(side, belief)
    if radius > MOST:
        raise ValueError(f"expected a window that is settled within {MOST} cells, got side {side}")
    cells = _seen_round(belief, side, radius)
    if before is None:
        first, before = 0, jnp.full((1, width_of(0)), UNREACHED, jnp.int16).at[0, 0].set(0)
    else:
        first = _radius(side_before, belief)
    with jax.named_scope("wave"):
        units = outwards(before, cells, UNITS, (first, radius), UNREACHED)
    above, left = (n - radius for n in margins(radius))
    cells = cells[above : above + units.shape[0], left : left + units.shape[1]]
    frontier = cells >> FRONTIER & 1 != 0
    best, at = _cheapest(units, frontier)
    settled = best <= UNITS[0] * radius
    target = jnp.where(settled, at[0], radius), jnp.where(settled, at[1], radius)
    origin = belief.row - radius, belief.col - radius
    with jax.named_scope("route"):
        motions = last_motions_by(units, cells, UNITS, UNREACHED)
        way = way_by_doubling(motions, target, origin, belief.driven.shape[0], n=radius)
    choice = Choice(target[0] + origin[0], target[1] + origin[1], costs_of(best), jnp.int32(0))
    return Glance(settled, choice, way, units)
