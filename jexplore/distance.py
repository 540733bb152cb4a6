"""Distances on the grid: exact squared Euclidean distance, nearest site, and the clearance test."""

import math

import jax
import jax.numpy as jnp
from jax import lax

from jexplore import bits

FAR = 2**30  # no site at all


def _nearer(d2, site, other_d2, other_site):
    """The nearer of two candidates per cell; a tie goes to the lower flat index."""
    better = (other_d2 < d2) | ((other_d2 == d2) & (other_site < site))
    return jnp.where(better, other_d2, d2), jnp.where(better, other_site, site)


@jax.jit
def nearest_site(sites):
    """Squared distance to the nearest site of every cell, and which site it is.

    Ties go to the lowest flat index. Exact: integers throughout.

    Args:
      sites: `[H, W]` bool, True at a site. H and W at most 16384.

    Returns:
      `d2`: `[H, W]` int32, squared distance, cells^2; `FAR` without any site.
      `site`: `[H, W]` int32, flat index (row * W + col) of the nearest site; -1 without any site.

    Raises:
      ValueError: while tracing, if `sites` is not a bool matrix.

    Source:
      Saito and Toriwaki 1994: columns first, then along the rows. Changed: the search along the rows stops as soon as
        no offset can bring anything nearer.
    """
    if sites.ndim != 2 or sites.dtype != bool:
        raise ValueError(f"expected sites: [H, W] bool, got {sites.shape} {sites.dtype}")
    height, width = sites.shape
    none = height * width
    rows = lax.broadcasted_iota(jnp.int32, (height, width), 0)
    cols = lax.broadcasted_iota(jnp.int32, (height, width), 1)
    below = lax.cummax(jnp.where(sites, rows, -height), axis=0)  # nearest site row at or below, in the same column
    above = lax.cummin(jnp.where(sites, rows, 2 * height), axis=0, reverse=True)
    row = jnp.where(rows - below <= above - rows, below, above)
    found = (row >= 0) & (row < height)
    d2 = jnp.where(found, (row - rows) ** 2, FAR)
    site = jnp.where(found, row * width + cols, none)
    # A candidate from an offset of dx columns adds dx^2 to the column's own distance. Columns outside have no site.
    wide_d2 = jnp.pad(d2, ((0, 0), (width, width)), constant_values=FAR)
    wide_site = jnp.pad(site, ((0, 0), (width, width)), constant_values=none)

    def may_improve(state):
        dx, best, _ = state
        return (dx < width) & (dx * dx <= jnp.max(best))

    def widen(state):
        dx, best, best_site = state
        for start in (width - dx, width + dx):
            other = lax.dynamic_slice_in_dim(wide_d2, start, width, axis=1)
            other = jnp.where(other < FAR, other + dx * dx, FAR)
            other_site = lax.dynamic_slice_in_dim(wide_site, start, width, axis=1)
            best, best_site = _nearer(best, best_site, other, other_site)
        return dx + 1, best, best_site

    _, d2, site = lax.while_loop(may_improve, widen, (jnp.int32(1), d2, site))
    return d2, jnp.where(site < none, site, -1)


def within(mask, d2):
    """Cells that have a True cell within a distance: the test behind clearance.

    Args:
      mask: `[H, W]` bool.
      d2: largest squared distance that counts, cells^2 (see `grid.radius_d2`). Static.

    Returns:
      `[H, W]` bool. Outside the map counts as False.
    """
    return bits.unpack(within_packed(bits.pack(mask), d2), mask.shape[0])


def within_packed(words, d2):
    """`within` for packed masks: `[K, W]` uint32 to the same."""
    radius = math.isqrt(d2)
    # spread[w]: True within w columns of a True cell; a disc is one such row for every row offset.
    spread = [words]
    for w in range(1, radius + 1):
        spread.append(spread[-1] | bits.shifted(words, 0, w) | bits.shifted(words, 0, -w))
    out = spread[radius]
    for dy in range(1, radius + 1):
        row = spread[math.isqrt(d2 - dy * dy)]
        out = out | bits.shifted(row, dy, 0) | bits.shifted(row, -dy, 0)
    return out
