"""Distances on the grid: exact squared Euclidean distance to the nearest site, and the clearance test."""

import math

import chex
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays import bits

FAR = 2**30  # no site at all
REACH = 1023  # cells; a site further away is not found
CODES = 2 * (REACH + 1)  # a candidate in one number: its squared distance times this, plus its column's offset


def nearest_offset(sites: Array) -> tuple[Array, Array, Array]:
    """Compute squared distance and offset from every cell to its nearest site.

    Ties go to the lowest column, then to the lowest row. Exact: integers throughout.

    Args:
      sites: `[H, W]` bool, True at a site.

    Returns:
      `d2`: `[H, W]` int32, squared distance, cells^2; `FAR` without any site within `REACH` cells.
      `drow`, `dcol`: `[H, W]` int32, the site's row and column relative to the cell's; 0 without any.

    Source:
      Saito and Toriwaki 1994: columns first, then along the rows. Changed: the search along the rows stops as soon as
        no offset can bring anything nearer; distance and site share one number, so that a comparison takes one minimum.
    """
    chex.assert_rank(sites, 2)
    chex.assert_type(sites, bool)
    height, width = sites.shape
    rows = lax.broadcasted_iota(jnp.int32, (height, width), 0)
    below = lax.cummax(jnp.where(sites, rows, -height - REACH), axis=0)  # nearest site row at or below, in the column
    above = lax.cummin(jnp.where(sites, rows, 2 * height + REACH), axis=0, reverse=True)
    off = jnp.where(rows - below <= above - rows, below, above) - rows
    none = jnp.uint32(2**31)  # twice it still fits
    near = jnp.where(jnp.abs(off) <= REACH, (off * off * CODES + REACH + 1).astype(jnp.uint32), none)
    wide = jnp.pad(near, ((0, 0), (width, width)), constant_values=none)

    def may_improve(state: tuple[Array, Array]) -> Array:
        dx, best = state
        furthest = jnp.max(lax.optimization_barrier(jnp.max(best, axis=0)))
        return (dx < min(width, REACH + 1)) & ((dx * dx * CODES).astype(jnp.uint32) <= furthest)

    def widen(state: tuple[Array, Array]) -> tuple[Array, Array]:
        dx, best = state
        for offset in (-dx, dx):
            other = lax.dynamic_slice_in_dim(wide, width + offset, width, axis=1)
            best = jnp.minimum(best, other + (dx * dx * CODES + offset).astype(jnp.uint32))
        return dx + 1, best

    _, best = lax.while_loop(may_improve, widen, (jnp.int32(1), near))
    found = best < none
    dcol = jnp.where(found, (best % CODES).astype(jnp.int32) - (REACH + 1), 0)
    drow = jnp.take_along_axis(off, lax.broadcasted_iota(jnp.int32, (height, width), 1) + dcol, axis=1)
    return jnp.where(found, (best // CODES).astype(jnp.int32), FAR), jnp.where(found, drow, 0), dcol


def within(mask: Array, d2: int) -> Array:
    """Return cells that have a True cell within a distance, `[H, W]` bool; outside the map counts as False.

    The test behind clearance. `d2` is the largest squared distance that counts, cells^2 (see `grid.radius_d2`), static.
    """
    chex.assert_rank(mask, 2)
    chex.assert_type(mask, bool)
    return bits.unpack(within_packed(bits.pack(mask), d2), mask.shape[0])


def within_packed(words: Array, d2: int) -> Array:
    """Compute `within` for packed masks: `[K, W]` uint32 to the same."""
    radius = math.isqrt(d2)
    # spread[w]: True within w columns of a True cell; a disc needs one such row for every row offset.
    spread = [words]
    for w in range(1, radius + 1):
        spread.append(spread[-1] | bits.shifted(words, 0, w) | bits.shifted(words, 0, -w))
    out = spread[radius]
    for dy in range(1, radius + 1):
        row = spread[math.isqrt(d2 - dy * dy)]
        out = out | bits.shifted(row, dy, 0) | bits.shifted(row, -dy, 0)
    return out
