"""Where a robot may go and where the unknown begins: clear, traversable and frontier cells, and clusters of
frontier cells.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore import bits
from jexplore.control import stored
from jexplore.distance import within, within_packed
from jexplore.grid import any_within_one, any_within_one_packed, is_free, is_known, is_occupied


def clear_cells(grid, *, p_free, clearance_d2):
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


def disc(shape, row, col, d2):
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


def traversable_cells(clear, free, driven, row, col, near_d2):
    """Cells that a path may use: clear ones, free ones near the robot, and the way that the robot has driven.

    Without the last two, walls that are seen late close the way behind the robot.

    Args:
      clear, free, driven: `[H, W]` bool.
      row, col: int32, the robot's cell; may lie outside the arrays when these are a window.
      near_d2: squared distance, cells^2; scalar.

    Returns:
      `[H, W]` bool.
    """
    return clear | (free & disc(clear.shape, row, col, near_d2)) | driven


def frontier_cells(clear, grid, inside):
    """Clear cells that are 8-adjacent to an unknown cell; whether a path leads there is not asked here.

    Args:
      clear: `[H, W]` bool.
      grid: `Grid`, `[H, W]`.
      inside: `[H, W]` bool, False in padding: what lies outside the map is never unknown.

    Returns:
      `[H, W]` bool.

    Source:
      Holz et al. 2010, equation 2. Changed: unknown is "never observed", not p = 0.5.
    """
    return clear & any_within_one(~is_known(grid) & inside)


class Masks(NamedTuple):
    """What a plan needs to know of every cell, packed (see bits.py)."""

    traversable: Array  # [ceil(H / 32), W] uint32
    frontier: Array  # [ceil(H / 32), W] uint32, exhausted targets left out


def plan_masks(grid, driven, exhausted, inside, row, col, *, p_free, near_d2, clearance_d2):
    """Traversable and frontier cells at once, as `clear_cells`, `traversable_cells` and `frontier_cells` define them.

    Args:
      grid: `Grid`, `[H, W]`.
      driven, exhausted, inside: `[H, W]` bool.
      row, col: int32, the robot's cell, inside the arrays.
      p_free, near_d2: scalars.
      clearance_d2: cells^2. Static.

    Returns:
      `Masks`.
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
    row: Array  # [M] int32, member cell nearest to the cluster's centroid; -1 in an unused slot
    col: Array  # [M] int32, likewise
    count: Array  # int32, clusters on the map, whether they fit or not
    overflow: Array  # int32, clusters that did not fit into M slots


def label_clusters(mask):
    """For every True cell the lowest flat index of its 8-connected group; H * W elsewhere. `[H, W]` int32."""
    height, width = mask.shape
    none = height * width
    index = lax.broadcasted_iota(jnp.int32, (height, width), 0) * width + lax.broadcasted_iota(
        jnp.int32, (height, width), 1
    )

    def spread(state):
        label, _ = state
        padded = lax.optimization_barrier(jnp.pad(label, 1, constant_values=none))
        rows = jnp.minimum(jnp.minimum(padded[:height], padded[1 : height + 1]), padded[2:])
        new = jnp.minimum(jnp.minimum(rows[:, :width], rows[:, 1 : width + 1]), rows[:, 2:])
        new = jnp.where(mask, new, none)
        # Pointer jumping: a cell also learns what the cell that it points at has learnt.
        at = jnp.minimum(new, none - 1).reshape(-1)
        new = jnp.where(mask, jnp.minimum(new, new.reshape(-1)[at].reshape(height, width)), none)
        return new, jnp.any(new != label)

    label, _ = lax.while_loop(lambda s: s[1], spread, (jnp.where(mask, index, none), True))
    return label


def frontier_clusters(frontier, *, max_clusters):
    """Groups of frontier cells that touch each other along edges or corners.

    Args:
      frontier: `[H, W]` bool.
      max_clusters: M, slots. Static. Clusters beyond it are counted in `overflow`, not kept.

    Returns:
      `Clusters`. Among members equally near to the centroid, the one with the lowest flat index.

    Source:
      Yamauchi 1997 (frontier regions). Changed: the representative is a member, so that it is always a frontier cell.
    """
    height, width = frontier.shape
    none = height * width
    lowest = label_clusters(frontier).reshape(-1)
    index = lax.iota(jnp.int32, none)
    is_first = lowest == index
    number = jnp.cumsum(is_first, dtype=jnp.int32) - 1  # number of each cluster, at its first cell
    label = jnp.where(lowest < none, number[jnp.minimum(lowest, none - 1)], max_clusters)
    slot = jnp.minimum(label, max_clusters)  # clusters that do not fit go to one slot too many, which is cut off
    count = jnp.sum(is_first, dtype=jnp.int32)

    def total(values):
        return jax.ops.segment_sum(values, slot, max_clusters + 1)

    rows, cols = index // width, index % width
    size = total(jnp.where(label < max_clusters, 1, 0))
    sum_row, sum_col = total(rows), total(cols)
    # Distance to the centroid in units of 1 / size, squared: integers would overflow, and equal distances must tie.
    dr = (rows * size[slot] - sum_row[slot]).astype(jnp.float32) / jnp.maximum(size[slot], 1)
    dc = (cols * size[slot] - sum_col[slot]).astype(jnp.float32) / jnp.maximum(size[slot], 1)
    d2 = dr * dr + dc * dc
    nearest = jax.ops.segment_min(jnp.where(label < max_clusters, d2, jnp.inf), slot, max_clusters + 1)
    member = jnp.where((d2 == nearest[slot]) & (label < max_clusters), index, none)
    chosen = jax.ops.segment_min(member, slot, max_clusters + 1)[:max_clusters]
    used = size[:max_clusters] > 0
    return Clusters(
        label=jnp.where(label < max_clusters, label, -1).reshape(height, width),
        size=size[:max_clusters],
        row=jnp.where(used, chosen // width, -1),
        col=jnp.where(used, chosen % width, -1),
        count=count,
        overflow=jnp.maximum(count - max_clusters, 0),
    )
