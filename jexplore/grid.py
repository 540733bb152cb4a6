"""The reflection map: how often each cell stopped a beam and how often it let one through.

Also the only place that converts between metres and cells. Cells are `(row, col)`, row 0 at the bottom; the point
`(x, y)` lies in row `y / cell_m`, column `x / cell_m` counted from the map's origin.
"""

import math
from typing import Any

import chex
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits

TOLERANCE = 1e-3  # cells^2: two radii closer than this in their square reach the same cells


@struct.dataclass
class Grid:
    """Reflection map (Holz et al. 2010, section 2.1)."""

    hits: Array  # [H, W] int32, beams that ended in the cell
    misses: Array  # [H, W] int32, beams that passed through the cell; one more a scan in the robot's own cell


def empty_grid(shape: tuple[int, ...]) -> Grid:
    """Return a map without observations; `shape`, `(H, W)`, is static."""
    return Grid(hits=jnp.zeros(shape, jnp.int32), misses=jnp.zeros(shape, jnp.int32))


def _observations(grid: Grid) -> Array:
    """Return how often every cell was observed, once the dtype and the shapes are seen to be right."""
    chex.assert_type([grid.hits, grid.misses], jnp.int32)
    chex.assert_equal_shape([grid.hits, grid.misses])
    return grid.hits + grid.misses


def probability(grid: Grid) -> Array:
    """Compute the reflection probability of every cell, hits / (hits + misses): `[H, W]` float32.

    It is 0.5, the prior, where nothing was observed.
    """
    n = _observations(grid)
    return jnp.where(n > 0, grid.hits.astype(jnp.float32) / jnp.maximum(n, 1).astype(jnp.float32), jnp.float32(0.5))


def is_known(grid: Grid) -> Array:
    """Return cells with at least one observation: `[H, W]` bool. A cell at p = 0.5 with observations is known."""
    return (grid.hits | grid.misses) != 0


def is_free(grid: Grid, p_free: Array | float) -> Array:
    """Return known cells with a reflection probability of at most `p_free`, in float32: `[H, W]` bool."""
    n = _observations(grid)
    return (n > 0) & (grid.hits.astype(jnp.float32) <= p_free * n.astype(jnp.float32))


def is_occupied(grid: Grid, p_free: Array | float) -> Array:
    """Return known cells whose reflection probability is above `p_free`, in float32: `[H, W]` bool."""
    n = _observations(grid)
    return (n > 0) & (grid.hits.astype(jnp.float32) > p_free * n.astype(jnp.float32))


def entropy(grid: Grid) -> Array:
    """Compute the entropy of every cell, bits: `[H, W]` float32, 1 where nothing was observed, 0 where beams agreed.

    Source:
      Holz et al. 2010, section 3.2. Changed: logarithm to base 2, so that an unknown cell holds one bit.
    """
    p = probability(grid)

    def plogp(q: Array) -> Array:
        return jnp.where(q > 0, q * jnp.log2(jnp.where(q > 0, q, 1.0)), 0.0)

    return -(plogp(p) + plogp(1 - p))


def bordered(array: Array, fill: float) -> Array:
    """Add a border of `fill`, one cell wide: `[H + 2, W + 2]`. Neighbours are taken from it by `beside`."""
    return jnp.pad(array, 1, constant_values=fill)


def beside(bordered_array: Array, drow: int, dcol: int) -> Array:
    """Return the neighbours at `(row + drow, col + dcol)` of every cell: `[H, W]`; -1, 0 or 1, static.

    `bordered_array` is `[H + 2, W + 2]`, from `bordered`.
    """
    height, width = bordered_array.shape[0] - 2, bordered_array.shape[1] - 2
    return bordered_array[1 + drow : 1 + drow + height, 1 + dcol : 1 + dcol + width]


def any_within_one(mask: Array) -> Array:
    """Return cells that are True or have one among their 8 neighbours; outside counts as False: `[H, W]` bool."""
    return bits.unpack(any_within_one_packed(bits.pack(mask)), mask.shape[0])


def any_within_one_packed(words: Array, connectivity: int = 8) -> Array:
    """Compute `any_within_one` for packed masks: `[K, W]` uint32 to the same; with 4, neighbours across edges alone."""
    across = words | bits.shifted(words, 0, 1) | bits.shifted(words, 0, -1)
    along = across if connectivity == 8 else words
    return across | bits.shifted(along, 1, 0) | bits.shifted(along, -1, 0)


def count(mask: Array) -> Array:
    """Count the True cells of a matrix: int32.

    Row onto row first, then across: on a CPU that vectorises, both at once does not (measured: a quarter of the time).
    """
    return jnp.sum(lax.optimization_barrier(jnp.sum(mask, axis=0, dtype=jnp.int32)), dtype=jnp.int32)


def lowest(values: Array) -> Array:
    """Return the smallest value of a matrix, in the same two steps as `count`."""
    return jnp.min(lax.optimization_barrier(jnp.min(values, axis=0)))


def radius_d2(radius_m: float, cell_m: float) -> int:
    """Return the largest squared distance in cells that counts as within a radius; Python numbers.

    It is floor((radius_m / cell_m)^2 + 1e-3): a cell whose centre lies on the circle is within it.
    """
    return math.floor((radius_m / cell_m) ** 2 + TOLERANCE)


def centre_of(row: Any, col: Any, *, cell_m: float, origin_m: tuple[float, float] = (0.0, 0.0)) -> tuple[Any, Any]:
    """Return the centre of a cell: `(x_m, y_m)`, metres."""
    return (col + 0.5) * cell_m + origin_m[0], (row + 0.5) * cell_m + origin_m[1]


def in_cells(length_m: float, cell_m: float) -> float:
    """Convert a length to cells: a Python float, rounded to 1e-9 so that 0.3 m / 0.1 m is 3."""
    return round(length_m / cell_m, 9)
