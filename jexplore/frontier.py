"""Clear, traversable and frontier cells of a map, and clusters of frontier cells."""

import math
from typing import NamedTuple

import chex
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits, groups
from jexplore.arrays.loops import stored
from jexplore.config import checked_names
from jexplore.distance import within, within_packed
from jexplore.grid import Grid, any_within_one_packed, is_free, is_known, is_occupied


def clear_cells(grid: Grid, *, p_free: Array | float, clearance_d2: int) -> Array:
    """Return free cells with no occupied cell within the clearance: `[H, W]` bool.

    `p_free` is the largest reflection probability of a free cell; `clearance_d2`, cells^2 (`grid.radius_d2`), is
    static.

    Source:
      Holz et al. 2010, section 2.2, with d_max as the clearance.
    """
    return is_free(grid, p_free) & ~within(is_occupied(grid, p_free), clearance_d2)


def disc(shape: tuple[int, ...], row: Array | int, col: Array | int, d2: Array | float) -> Array:
    """Return cells within a distance of a cell, which may lie outside: `[H, W]` bool.

    `shape` is static; `d2` is the largest squared distance that counts, cells^2.
    """
    rows = lax.broadcasted_iota(jnp.int32, shape, 0)
    cols = lax.broadcasted_iota(jnp.int32, shape, 1)
    return (rows - row) ** 2 + (cols - col) ** 2 <= d2


class Masks(NamedTuple):
    """Masks for planning, packed (see bits.py)."""

    traversable: Array  # [ceil(H / 32), W] uint32
    frontier: Array  # [ceil(H / 32), W] uint32, exhausted targets left out


def plan_masks(
    grid: Grid,
    driven: Array,
    exhausted: Array,
    inside: Array,
    row: Array | int,
    col: Array | int,
    *,
    p_free: Array | float,
    near_d2: Array | float,
    clearance_d2: int,
    stays_inside: bool = False,
    connectivity: int = 8,
) -> Masks:
    """Compute traversable and frontier cells at once, packed.

    Traversable: clear cells, free ones near the robot, and the way that it has driven; without the last two, walls
    that are seen late close the way behind the robot. Frontier: clear cells that are adjacent to an unknown cell
    inside; whether a path leads there is not asked here.

    Args:
      grid: `Grid`, `[H, W]`.
      driven, exhausted, inside: `[H, W]` bool.
      row, col: int32, the robot's cell, inside the arrays.
      p_free, near_d2: scalars.
      clearance_d2: cells^2. Static.
      stays_inside: whether cells outside are left out of both, whatever they are. Static.
      connectivity: 8, or 4: what lies across a corner is not adjacent. Static.

    Returns:
      `Masks`.

    Source:
      Holz et al. 2010, section 2.2 and equation 2. Changed: unknown is "never observed", not p = 0.5.
    """
    shape = grid.hits.shape
    chex.assert_shape([driven, exhausted, inside], shape)
    chex.assert_type([driven, exhausted, inside], bool)

    def pack_all() -> list[Array]:
        cells = is_occupied(grid, p_free), is_known(grid), driven, exhausted, inside, disc(shape, row, col, near_d2)
        return [bits.pack(mask) for mask in cells]

    occupied, known, driven, exhausted, inside, near = stored(row >= 0, pack_all)

    def judge() -> Masks:
        free = known & ~occupied
        clear = free & ~within_packed(occupied, clearance_d2)
        frontier = clear & any_within_one_packed(inside & ~known, connectivity) & ~exhausted
        traversable = clear | (free & near) | driven
        return Masks(traversable & inside, frontier & inside) if stays_inside else Masks(traversable, frontier)

    return stored(row >= 0, judge)


@struct.dataclass
class Clusters:
    """8-connected groups of frontier cells, in the order of their lowest flat index. M slots, `count` of them used."""

    label: Array  # [H, W] int32, number of the cell's cluster; -1 without one, or if it did not fit
    size: Array  # [M] int32, cells; 0 in an unused slot
    row: Array  # [M] int32, of the member cell that stands for the cluster; -1 in an unused slot
    col: Array  # [M] int32, column of the same
    count: Array  # int32, clusters on the map, whether they fit or not
    overflow: Array  # int32, clusters that did not fit into M slots
    left_out: Array  # int32, frontier cells that were not looked at, because there were too many


def most_cells(shape: tuple[int, ...]) -> int:
    """Return how many frontier cells of a map are looked at by default: one in 16 of all, at least 256."""
    return min(math.prod(shape), max(256, math.prod(shape) // 16))


@checked_names
def frontier_clusters(
    frontier: Array,
    cost: Array | None = None,
    *,
    max_clusters: int,
    max_cells: int | None = None,
) -> Clusters:
    """Group frontier cells that touch each other along edges or corners.

    Args:
      frontier: `[H, W]` bool.
      cost: `[H, W]` int32, or None: what makes one member stand for its cluster, the lowest; by default the squared
        distance from the cluster's centroid.
      max_clusters: M, slots. Static. Clusters beyond it are counted in `overflow`, not kept.
      max_cells: frontier cells that are looked at, the first in (row, col) order; by default `most_cells`. Static.

    Returns:
      `Clusters`. Among members that are equally good, the one with the lowest flat index stands for all.

    Source:
      Yamauchi 1997 (frontier regions). Changed: the representative is a member, so that it is always a frontier cell.
    """
    chex.assert_rank(frontier, 2)
    chex.assert_type(frontier, bool)
    (height, width), none = frontier.shape, frontier.size
    cells = groups.list_cells(frontier, most_cells(frontier.shape) if max_cells is None else min(none, max_cells))
    used, lowest = cells.cell < none, groups.lowest_of_group(cells)
    is_first = used & (lowest == lax.iota(jnp.int32, used.shape[0]))
    # A cluster's first cell comes before its others; `max_clusters` is the number of a cell without a slot.
    number = jnp.cumsum(is_first, dtype=jnp.int32)[lowest] - 1
    number = jnp.where(used, jnp.minimum(number, max_clusters), max_clusters)
    row, col = cells.cell // width, cells.cell % width
    sums = jnp.zeros((3, max_clusters), jnp.int32).at[:, number].add(jnp.stack([used, row, col]), mode="drop")
    misfit = groups.at(cost, cells.cell, 0) if cost is not None else _off_centroid(row, col, sums, number)
    worst = jnp.inf if cost is None else jnp.iinfo(jnp.int32).max
    best = jnp.full(max_clusters, worst, misfit.dtype).at[number].min(misfit, mode="drop")
    good = misfit == best.at[number].get(mode="clip")
    chosen = jnp.full(max_clusters, none, jnp.int32)
    chosen = chosen.at[jnp.where(good, number, max_clusters)].min(cells.cell, mode="drop")
    own = jnp.where(number < max_clusters, number, -1)
    count, has_cells = jnp.sum(is_first, dtype=jnp.int32), sums[0] > 0
    return Clusters(
        label=jnp.full(none, -1, jnp.int32).at[cells.cell].set(own, mode="drop").reshape(height, width),
        size=sums[0],
        row=jnp.where(has_cells, chosen // width, -1),
        col=jnp.where(has_cells, chosen % width, -1),
        count=count,
        overflow=jnp.maximum(count - max_clusters, 0),
        left_out=cells.overflow,
    )


def _off_centroid(row: Array, col: Array, sums: Array, number: Array) -> Array:
    """Return the squared distances of cells from their clusters' centroids: float32.

    In units of 1 / size, squared: integers would overflow, and equal distances must tie. `sums` are the clusters' cells
    and the sums of their rows and columns.
    """
    size, sum_row, sum_col = sums.at[:, number].get(mode="clip")
    dr = (row * size - sum_row).astype(jnp.float32) / jnp.maximum(size, 1)
    dc = (col * size - sum_col).astype(jnp.float32) / jnp.maximum(size, 1)
    return dr * dr + dc * dc


def large_groups(frontier: Array, least: int) -> Array:
    """Return the frontier cells whose 8-connected group has at least some cells: `[H, W]` bool. `least` is static."""
    if least == 1:
        return frontier
    height, width = frontier.shape
    most = -(-height // 2) * -(-width // 2)  # groups that do not touch
    found = frontier_clusters(frontier, max_clusters=most, max_cells=frontier.size)
    return frontier & (found.size[found.label] >= least)
