"""Waves of known length, for many robots on an accelerator: rounds of relaxations that look at no edge.

An array that a round reads is larger than what it makes, by a row above and below and two columns at each side, so that
no neighbour is asked whether it lies inside; and a wave from one cell is made no larger than it can have come. A column
at each side would do: two leave widths whole multiples of `ALIGN` in every round.
"""

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.reach import MOTIONS, ROUNDS

ALIGN = 4  # columns are made in whole multiples: as many are the work of one thread of an accelerator
SHUT = 2**5 - 1  # no way into a cell


def width_of(radius: int) -> int:
    """Columns in which a square of a radius is kept: those of the square, and up to 3 more."""
    return -(-(2 * radius + 1) // ALIGN) * ALIGN


def shut_ways(motions: list[Array]) -> Array:
    """Ways into each cell that are shut, one bit each: the straight ones, and each diagonal one.

    Args:
      motions: from `reach.motions_into`.

    Returns:
      `[32 K, W]` uint8.
    """
    return sum(((~bits.unpack(words)).astype(jnp.uint8) << i for i, words in enumerate(motions[3:])), jnp.uint8(0))


def _relaxed(cost, shut, steps, far):
    """The cheapest cost after at most one more motion: `[h - 2, w - 4]` of `[h, w]`, `shut` of the smaller shape."""
    height, width = cost.shape

    def at(drow, dcol):
        return cost[1 + drow : height - 1 + drow, 2 + dcol : width - 2 + dcol]

    # What cannot be entered has a floor of `far`: its bit, moved to where that is the only one of `far`.
    shut = shut.astype(cost.dtype)
    floors = [(shut << far.bit_length() - 1 - i) & cost.dtype.type(far) for i in range(5)]
    straight = jnp.minimum(jnp.minimum(at(0, -1), at(0, 1)), jnp.minimum(at(-1, 0), at(1, 0)))
    best = jnp.minimum(at(0, 0), jnp.maximum(straight, floors[0]) + steps[0])
    first, *others = [jnp.maximum(at(-row, -col), floor) for (row, col), floor in zip(MOTIONS[4:], floors[1:])]
    for other in others:
        first = jnp.minimum(first, other)
    return jnp.minimum(best, first + steps[1])


def _rounds(cost, shut, at, steps, far, n):
    """n rounds of costs `[h + 2 n, w + 4 n]`: `[h, w]`, which lies at `at` in `shut`."""
    for left in reversed(range(n)):
        height, width = cost.shape[0] - 2, cost.shape[1] - 4
        row, col = at[0] - left, at[1] - 2 * left
        cost = _relaxed(cost, shut[row : row + height, col : col + width], steps, far)
        cost = lax.optimization_barrier(cost) if left else cost
    return cost


def margins(radius: int) -> tuple[int, int]:
    """Rows above the middle one, and columns left of it, whose ways `outwards` wants to know to go to a radius."""
    return radius + ROUNDS - 1, radius + 2 * (ROUNDS - 1)


def room(radius: int) -> tuple[int, int]:
    """All rows and columns whose ways it wants to know: `(h, w)`."""
    above, left = margins(radius)
    # Right of the middle one as many as left of it, and up to 3 more, which `width_of` adds on the way to the radius.
    return 2 * above + 1, -(-(2 * left + ALIGN) // ALIGN) * ALIGN


def outwards(cost: Array, shut: Array, steps: tuple[int, int], radii: tuple[int, int], far: int) -> Array:
    """A wave that goes on from a square round the cell that it began in to a larger one.

    Args:
      cost: `[2 r + 1, width_of(r)]`, the cell in row and column r; `far` beyond a distance of r rows or columns.
      shut: uint8 of the shape `room(R)`, from `shut_ways`, the cell in that row and column that `margins(R)` says.
      steps: what a straight and a diagonal step cost. Static.
      far: a power of two no less than any cost; with a step added it still fits. Static.
      radii: r and R. Static.

    Returns:
      `[2 R + 1, width_of(R)]`, likewise, after R - r rounds.
    """
    radius, last = radii
    middle = margins(last)
    while radius < last:
        n = min(ROUNDS, last - radius)
        radius += n
        # By as much as the wave goes on, and by as much as the rounds take away.
        rows, left, width = 2 * n, 3 * n, width_of(radius) + 4 * n
        cost = jnp.pad(cost, ((rows, rows), (left, width - left - cost.shape[1])), constant_values=far)
        cost = _rounds(cost, shut, (middle[0] - radius, middle[1] - radius), steps, far, n)
        cost = lax.optimization_barrier(cost) if radius < last else cost
    return cost
