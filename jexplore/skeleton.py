"""The Voronoi graph of free space: cells equally far from two obstacles, thinned to lines and linked to a graph."""

import chex
import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore.arrays import bits, groups
from jexplore.arrays.groups import EIGHT_NEIGHBOURS
from jexplore.arrays.loops import settled
from jexplore.distance import FAR, nearest_offset
from jexplore.grid import beside, bordered


@struct.dataclass
class Graph:
    """A skeleton as a graph of its cells. K slots, in the order of flat indices.

    Diagonal neighbours are linked only where no straight way of the skeleton joins them, so that a corner of a line is
    not a junction.
    """

    cell: Array  # [K] int32, flat index; H * W in an unused slot
    d2: Array  # [K] int32, squared distance to the nearest obstacle, cells^2; 0 in an unused slot
    link: Array  # [K, 8] int32, slot of the neighbour in each direction of `EIGHT_NEIGHBOURS`; K for none
    degree: Array  # [K] int32, links; 0 in an unused slot
    overflow: Array  # int32, cells that did not fit into K slots


def medial_axis(d2: Array, drow: Array, dcol: Array, gamma2: Array | float) -> Array:
    """Return cells on a boundary between the regions of two obstacles, up to two cells wide: `[H, W]` bool.

    `d2`, `drow`, `dcol` are from `nearest_offset` of the obstacles; `gamma2` is how far apart two obstacle cells must
    be to count as different obstacles, cells^2, exclusive.

    Source:
      Hesselink and Roerdink 2008, integer medial axis, with constant pruning.
    """
    chex.assert_rank(d2, 2)
    chex.assert_equal_shape([d2, drow, dcol])
    open_ = bordered((d2 > 0) & (d2 < FAR), False)
    rows, cols = bordered(drow, 0), bordered(dcol, 0)
    marked = jnp.zeros(d2.shape, bool)
    for step in EIGHT_NEIGHBOURS[:4]:
        there_row, there_col = beside(rows, *step), beside(cols, *step)
        apart_row, apart_col = drow - there_row - step[0], dcol - there_col - step[1]
        # Of two neighbours the one whose side of their middle the boundary lies on, or both.
        side = apart_row * (drow + there_row) + apart_col * (dcol + there_col)
        marked |= beside(open_, *step) & (apart_row**2 + apart_col**2 > gamma2) & (side >= 0)
    return marked & beside(open_, 0, 0)


def thin(words: Array) -> Array:
    """Thin to lines one cell wide with the same connections: cells are taken from both sides until none can go.

    `words` is a packed mask, `[K, W]` uint32, as is the result.

    Source:
      Guo and Hall 1989, algorithm A1.
    """

    def removable(x: Array, first: bool) -> Array:
        east, north, west, south, ne, nw, sw, se = (bits.shifted(x, drow, dcol) for drow, dcol in EIGHT_NEIGHBOURS)
        if not first:
            east, north, west, south, ne, nw, sw, se = west, south, east, north, sw, se, ne, nw
        pairs = (~north & (ne | east), ~east & (se | south), ~south & (sw | west), ~west & (nw | north))
        a, b, c, d = pairs
        one = ((a ^ b) & ~(c | d)) | ((c ^ d) & ~(a | b))  # exactly one
        low, high = (nw | north, ne | east, se | south, sw | west), (north | ne, east | se, south | sw, west | nw)
        (two_low, four_low), (two_high, four_high) = _two_and_four(low), _two_and_four(high)
        # The smaller of both sums is 2 or 3.
        middling = two_low & two_high & ~(four_low & four_high)
        return x & one & middling & ~((north | ne | ~se) & east)

    def round_(words: Array) -> Array:
        for first in (True, False):
            words = words & ~removable(words, first)
        return words

    return settled(round_, words)


def _two_and_four(masks: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return the cells where at least two of four masks hold, and where all do."""
    a, b, c, d = masks
    return (a & b) | (c & d) | ((a | b) & (c | d)), a & b & c & d


def graph(skeleton: Array, d2: Array, *, size: int) -> Graph:
    """Link the cells of a thin skeleton, `[H, W]` bool.

    `d2` is the squared distance to the nearest obstacle; `size` is K, static.
    """
    cells = groups.list_cells(skeleton, size)
    east, north, west, south, *diagonal = (cells.near[:, i] for i in range(len(EIGHT_NEIGHBOURS)))
    corners = ((east, north), (west, north), (west, south), (east, south))
    diagonal = [jnp.where((a < size) | (b < size), size, d) for d, (a, b) in zip(diagonal, corners)]
    link = jnp.stack([east, north, west, south, *diagonal], axis=1)
    return Graph(
        cell=cells.cell,
        d2=groups.at(d2, cells.cell, 0),
        link=link,
        degree=jnp.sum(link < size, axis=1, dtype=jnp.int32),
        overflow=cells.overflow,
    )


def voronoi_graph(obstacle: Array, gamma2: Array | float, *, size: int) -> tuple[Graph, Array, Array]:
    """Compute the Voronoi graph of the space between obstacles, `[H, W]` bool.

    `gamma2` is as of `medial_axis`; `size`, slots of the graph, is static. Returns `(graph, drow, dcol)`: `Graph`, and
    for every cell how far away its nearest obstacle is, see `nearest_offset`.

    Source:
      Holz et al. 2010, Figure 7, step 1. Changed: the integer medial axis, thinned, instead of Fortune's sweep.
    """
    d2, drow, dcol = nearest_offset(obstacle)
    lines = thin(bits.pack(medial_axis(d2, drow, dcol, gamma2)))
    return graph(bits.unpack(lines, obstacle.shape[0]), d2, size=size), drow, dcol
