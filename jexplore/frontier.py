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
    height, width = frontier.shape
    none = height * width
    cells = groups.grouped(frontier, most_cells(frontier.shape) if max_cells is None else min(none, max_cells))
    number, count, total = _sizes(cells, width, max_clusters)
    chosen, label = _members(cells, number, total, cost, frontier.shape)
    used = total[0] > 0
    return Clusters(
        label=label.reshape(height, width),
        size=total[0],
        row=jnp.where(used, chosen // width, -1),
        col=jnp.where(used, chosen % width, -1),
        count=count,
        overflow=jnp.maximum(count - max_clusters, 0),
        left_out=cells.overflow,
    )


def large_groups(frontier: Array, least: int) -> Array:
    """Return the frontier cells whose 8-connected group has at least some cells: `[H, W]` bool. `least` is static."""
    if least == 1:
        return frontier
    height, width = frontier.shape
    most = -(-height // 2) * -(-width // 2)  # groups that do not touch
    found = frontier_clusters(frontier, max_clusters=most, max_cells=frontier.size)
    return frontier & (found.size[found.label] >= least)


def _sizes(cells: groups.Groups, width: int, max_clusters: int) -> tuple[Array, Array, Array]:
    """Label the listed cells by cluster, and sum the clusters up.

    Returns:
      `(number, n, sums)`: `[K]` int32, `max_clusters` for one that does not fit; int32, clusters; `[3, M]` int32, their
        cells, the sum of their rows, and of their columns.
    """

    def add(slot: Array, used: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        number, total, count = state
        at, lowest = groups.read(cells.cell, slot), groups.read(cells.lowest, slot)
        is_first = used & (lowest == slot)
        # A cluster's first cell comes before its others, so that its number is known by then.
        own = count + jnp.cumsum(is_first, dtype=jnp.int32) - 1
        number = groups.write(number, slot, is_first, jnp.minimum(own, max_clusters))
        own = number[lowest]
        number = groups.write(number, slot, used, own)
        which = jnp.where(used, own, max_clusters)
        more = jnp.stack([jnp.ones_like(at), at // width, at % width])
        return number, total.at[:, which].add(more, mode="drop"), count + jnp.sum(is_first, dtype=jnp.int32)

    number = jnp.full(cells.cell.shape, max_clusters, jnp.int32)
    start = number, jnp.zeros((3, max_clusters), jnp.int32), jnp.int32(0)
    number, total, count = groups.by_parts(cells, add, start)
    return number, count, total


def _members(
    cells: groups.Groups, number: Array, total: Array, cost: Array | None, shape: tuple[int, ...]
) -> tuple[Array, Array]:
    """Choose the cell that stands for each cluster; arguments from `_sizes` and `frontier_clusters`.

    Returns:
      `(member, label)`: `[M]` int32, flat index; `[H * W]` int32, the cluster of every cell of the map.
    """
    none, width, max_clusters = shape[0] * shape[1], shape[1], total.shape[1]

    def off(slot: Array, which: Array) -> Array:
        """Return the misfit of the cells of a part as representatives of their clusters."""
        at = groups.read(cells.cell, slot)
        if cost is not None:
            return groups.at(cost, at, 0)
        # In units of 1 / size, squared: integers would overflow, and equal distances must tie.
        size, sum_row, sum_col = total.at[:, which].get(mode="clip")
        dr = (at // width * size - sum_row).astype(jnp.float32) / jnp.maximum(size, 1)
        dc = (at % width * size - sum_col).astype(jnp.float32) / jnp.maximum(size, 1)
        return dr * dr + dc * dc

    def least(slot: Array, used: Array, state: Array) -> Array:
        which = jnp.where(used, groups.read(number, slot), max_clusters)
        return state.at[which].min(off(slot, which), mode="drop")

    def first_of_the_best(slot: Array, used: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        chosen, label = state
        at, own = groups.read(cells.cell, slot), groups.read(number, slot)
        which = jnp.where(used, own, max_clusters)
        good = off(slot, which) == best.at[which].get(mode="clip")
        chosen = chosen.at[jnp.where(good, which, max_clusters)].min(at, mode="drop")
        return chosen, label.at[jnp.where(used, at, none)].set(jnp.where(own < max_clusters, own, -1), mode="drop")

    worst = jnp.full(max_clusters, jnp.iinfo(jnp.int32).max) if cost is not None else jnp.full(max_clusters, jnp.inf)
    best = groups.by_parts(cells, least, worst)
    blank = jnp.full(max_clusters, none, jnp.int32), jnp.full(none, -1, jnp.int32)
    return groups.by_parts(cells, first_of_the_best, blank)
