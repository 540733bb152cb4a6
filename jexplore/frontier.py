"""Where a robot may go and where the unknown begins: clear, traversable and frontier cells, and clusters of
frontier cells.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits, sparse
from jexplore.arrays.loops import settled, stored
from jexplore.distance import within, within_packed
from jexplore.grid import Grid, any_within_one_packed, is_free, is_known, is_occupied


def clear_cells(grid: Grid, *, p_free: Array | float, clearance_d2: int) -> Array:
    """Free cells with no occupied cell within the clearance.

    Args:
      grid: `Grid`, `[H, W]`.
      p_free: largest reflection probability of a free cell; scalar.
      clearance_d2: squared distance, cells^2 (`grid.radius_d2`). Static.

    Returns:
      `[H, W]` bool.

    Source:
      Holz et al. 2010, section 2.2, with d_max as the clearance.
    """
    return is_free(grid, p_free) & ~within(is_occupied(grid, p_free), clearance_d2)


def disc(shape: tuple[int, ...], row: Array | int, col: Array | int, d2: Array | float) -> Array:
    """Cells within a distance of a cell.

    Args:
      shape: `(H, W)`. Static.
      row, col: int32; may lie outside.
      d2: largest squared distance that counts, cells^2; scalar.

    Returns:
      `[H, W]` bool.
    """
    rows = lax.broadcasted_iota(jnp.int32, shape, 0)
    cols = lax.broadcasted_iota(jnp.int32, shape, 1)
    return (rows - row) ** 2 + (cols - col) ** 2 <= d2


class Masks(NamedTuple):
    """What a plan needs to know of every cell, packed (see bits.py)."""

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
) -> Masks:
    """Traversable and frontier cells at once, packed.

    Traversable: clear cells, free ones near the robot, and the way that it has driven; without the last two, walls
    that are seen late close the way behind the robot. Frontier: clear cells that are 8-adjacent to an unknown cell
    inside; whether a path leads there is not asked here.

    Args:
      grid: `Grid`, `[H, W]`.
      driven, exhausted, inside: `[H, W]` bool.
      row, col: int32, the robot's cell, inside the arrays.
      p_free, near_d2: scalars.
      clearance_d2: cells^2. Static.

    Returns:
      `Masks`.

    Source:
      Holz et al. 2010, section 2.2 and equation 2. Changed: unknown is "never observed", not p = 0.5.
    """
    shape = driven.shape

    def pack_all():
        cells = is_occupied(grid, p_free), is_known(grid), driven, exhausted, inside, disc(shape, row, col, near_d2)
        return [bits.pack(mask) for mask in cells]

    occupied, known, driven, exhausted, inside, near = stored(row >= 0, pack_all)

    def judge():
        free = known & ~occupied
        clear = free & ~within_packed(occupied, clearance_d2)
        frontier = clear & any_within_one_packed(inside & ~known) & ~exhausted
        return Masks(clear | (free & near) | driven, frontier)

    return stored(row >= 0, judge)


@struct.dataclass
class Clusters:
    """8-connected groups of frontier cells, in the order of their lowest flat index. M slots, `count` of them used."""

    label: Array  # [H, W] int32, number of the cell's cluster; -1 where there is none, or it did not fit
    size: Array  # [M] int32, cells; 0 in an unused slot
    row: Array  # [M] int32, of the member cell that stands for the cluster; -1 in an unused slot
    col: Array  # [M] int32, likewise
    count: Array  # int32, clusters on the map, whether they fit or not
    overflow: Array  # int32, clusters that did not fit into M slots
    left_out: Array  # int32, frontier cells that were not looked at, because there were too many


def label_clusters(cells: sparse.Cells) -> Array:
    """For every cell of a list the lowest slot of its 8-connected group: `[K]` int32; its own in an unused slot.

    Args:
      cells: `sparse.Cells`.

    Source:
      Zhang, Azad and Buluc 2020 (FastSV): rounds that grow with the logarithm of a group's longest way, not with it.
    """
    size = cells.cell.shape[0]

    def hook(label):
        above = label[label]
        low = jnp.min(above.at[cells.near].get(mode="fill", fill_value=size), axis=1)
        low = jnp.minimum(low, above)
        # What a cell has learnt, the cell that it points at learns too.
        return jnp.minimum(above.at[label].min(low), low)

    return settled(hook, lax.iota(jnp.int32, size))


def frontier_clusters(
    frontier: Array, cost: Array | None = None, *, max_clusters: int, max_cells: int | None = None
) -> Clusters:
    """Groups of frontier cells that touch each other along edges or corners.

    Args:
      frontier: `[H, W]` bool.
      cost: `[H, W]` int32, or None: what makes one member stand for its cluster, the lowest; by default the squared
        distance from the cluster's centroid.
      max_clusters: M, slots. Static. Clusters beyond it are counted in `overflow`, not kept.
      max_cells: frontier cells that are looked at, the first in (row, col) order; by default one in 16 of the map, at
        least 256. Static.

    Returns:
      `Clusters`. Among members that are equally good, the one with the lowest flat index stands for all.

    Source:
      Yamauchi 1997 (frontier regions). Changed: the representative is a member, so that it is always a frontier cell.
    """
    height, width = frontier.shape
    none = height * width
    cells = sparse.listed(frontier, min(none, max(256, none // 16) if max_cells is None else max_cells))
    size = cells.cell.shape[0]
    lowest = label_clusters(cells)
    is_first = (lowest == lax.iota(jnp.int32, size)) & (cells.cell < none)
    number = jnp.cumsum(is_first, dtype=jnp.int32) - 1  # number of each cluster, at its first cell
    label = jnp.where(cells.cell < none, number[lowest], max_clusters)
    slot = jnp.minimum(label, max_clusters)  # clusters that do not fit go to one slot too many, which is cut off
    count = jnp.sum(is_first, dtype=jnp.int32)

    def total(values):
        return jax.ops.segment_sum(values, slot, max_clusters + 1)

    rows, cols = cells.cell // width, cells.cell % width
    sizes = total(jnp.where(label < max_clusters, 1, 0))
    sum_row, sum_col = total(rows), total(cols)
    if cost is None:
        # In units of 1 / size, squared: integers would overflow, and equal distances must tie.
        dr = (rows * sizes[slot] - sum_row[slot]).astype(jnp.float32) / jnp.maximum(sizes[slot], 1)
        dc = (cols * sizes[slot] - sum_col[slot]).astype(jnp.float32) / jnp.maximum(sizes[slot], 1)
        off = dr * dr + dc * dc
    else:
        off = sparse.at(cost, cells.cell, 0)
    best = jax.ops.segment_min(off, slot, max_clusters + 1)
    member = jnp.where((off == best[slot]) & (label < max_clusters), cells.cell, none)
    chosen = jax.ops.segment_min(member, slot, max_clusters + 1)[:max_clusters]
    used = sizes[:max_clusters] > 0
    kept = jnp.where(label < max_clusters, label, -1)
    return Clusters(
        label=jnp.full((none,), -1, jnp.int32).at[cells.cell].set(kept, mode="drop").reshape(height, width),
        size=sizes[:max_clusters],
        row=jnp.where(used, chosen // width, -1),
        col=jnp.where(used, chosen % width, -1),
        count=count,
        overflow=jnp.maximum(count - max_clusters, 0),
        left_out=cells.overflow,
    )
