"""The True cells of a mask as a list, their neighbours in it, and their 8-connected groups."""

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import settled

EIGHT_NEIGHBOURS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))  # straight ones first


@struct.dataclass
class Cells:
    """True cells of a mask in (row, col) order. K slots."""

    cell: Array  # [K] int32, flat index (row * W + col); H * W in an unused slot
    near: Array  # [K, 8] int32, slot of the neighbour in each direction of `EIGHT_NEIGHBOURS`; K for none
    overflow: Array  # int32, cells that did not fit


def list_cells(mask: Array, size: int) -> Cells:
    """List the `Cells` of a mask, `[H, W]` bool, in K = `size` slots."""
    height, width = mask.shape
    none = height * width
    words = bits.pack(mask)
    cell = jnp.minimum(bits.first_cells(words, size), none)
    slot = jnp.full((none,), size, jnp.int32).at[cell].set(lax.iota(jnp.int32, size), mode="drop")
    row, col = cell // width, cell % width
    near = []
    for drow, dcol in EIGHT_NEIGHBOURS:
        r, c = row + drow, col + dcol
        inside = (r >= 0) & (r < height) & (c >= 0) & (c < width) & (cell < none)
        near.append(jnp.where(inside, slot[jnp.clip(r, 0, height - 1) * width + jnp.clip(c, 0, width - 1)], size))
    count = jnp.sum(lax.population_count(words).astype(jnp.int32))
    return Cells(cell, jnp.stack(near, axis=1), jnp.maximum(count - size, 0))


def at(array: Array, cell: Array, fill: float) -> Array:
    """Return values of a map, or of a list, at listed places: of their shape; `fill` beyond the last."""
    return array.reshape(-1).at[cell].get(mode="fill", fill_value=fill)


def lowest_of_group(cells: Cells) -> Array:
    """Return the lowest slot of every cell's group: `[K]` int32; its own in an unused slot.

    Source:
      Zhang, Azad and Buluc 2020 (FastSV): rounds that grow with the logarithm of a group's longest way, not with it.
    """
    size = cells.cell.shape[0]

    def hook(label: Array) -> Array:
        low = jnp.minimum(label[label], jnp.min(at(label, cells.near, size), axis=1))
        # What a cell has learnt, the cell that it points at learns too.
        return jnp.minimum(label.at[label].min(low), low)

    return settled(hook, lax.iota(jnp.int32, size))
