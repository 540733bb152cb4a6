"""8-connected groups of the True cells of a mask, over a list of these cells that is worked on a part at a time: the
work grows with the cells that there are, not with the map or with the room in the list.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits
from jexplore.arrays.loops import repeat

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


PART = 256  # cells of a list that are worked on at a time


@struct.dataclass
class Groups:
    """True cells of a mask in (row, col) order, and the group of each. K slots, of which the first `count` are used."""

    cell: Array  # [K] int32, flat index (row * W + col); H * W in an unused slot
    lowest: Array  # [K] int32, lowest slot of the cell's group; its own in an unused slot
    count: Array  # int32, used slots
    overflow: Array  # int32, cells that did not fit
    part: int = struct.field(pytree_node=False)  # slots processed at a time; divides K


def by_parts(groups: Groups, work: Callable[[Array, Array, Any], Any], state: Any) -> Any:
    """Return the state after `work(slot, used, state)` for every part of a list, the first one first.

    `work` takes slots, `[part]` int32, and which of them are used. Where none is used it must leave the state as it is,
    and slots may then lie beyond the list.
    """
    return _by_parts(groups.count, groups.cell.shape[0], groups.part, work, state)


def _by_parts(count, size, part, work, state):
    """Return `by_parts` of a list of `size` slots, the first `count` of them used."""
    slots = lax.iota(jnp.int32, part)
    if part == size:
        return work(slots, slots < count, state)

    def go_on(state):
        first, inner = state
        on = first < count
        return first + jnp.where(on, part, 0), work(first + slots, first + slots < count, inner)

    return repeat(lambda state: state[0] < count, go_on, (jnp.int32(0), state))[1]


def read(values: Array, slot: Array) -> Array:
    """Return a part of a list: `[..., K]` to `[..., part]`."""
    return lax.dynamic_slice_in_dim(values, slot[0], slot.shape[0], axis=values.ndim - 1)


def write(values: Array, slot: Array, used: Array, new: Array) -> Array:
    """Return a list with the used slots of a part replaced: `[..., K]`."""
    new = jnp.where(used, new, read(values, slot))
    return lax.dynamic_update_slice_in_dim(values, new, slot[0], axis=values.ndim - 1)


def grouped(mask: Array, size: int, *, part: int = PART) -> Groups:
    """Return `Groups` of a mask `[H, W]`; `size` and `part` are static.

    K is `size`, cells that there is room for, rounded up to whole parts of `part` cells.

    Source:
      Zhang, Azad and Buluc 2020 (FastSV): rounds that grow with the logarithm of a group's longest way, not with it.
      Changed: what a part has learnt, the next one knows.
    """
    height, width = mask.shape
    none = height * width
    part = min(part, size)
    room = -(-size // part) * part
    order = bits.ordered_cells(bits.pack(mask))
    total = order.until[-1]
    count = jnp.minimum(total, size)

    def pick(slot, used, state):
        cell, slot_of = state
        at = jnp.where(used, bits.nth_of(order, slot, width), none)
        return write(cell, slot, used, at), slot_of.at[at].set(slot, mode="drop")

    blank = jnp.full((room,), none, jnp.int32), jnp.full((none,), room, jnp.int32)
    cell, slot_of = _by_parts(count, room, part, pick, blank)

    def meet(slot, used, near):
        at = read(cell, slot)
        row, col = at // width, at % width
        beside = []
        for drow, dcol in EIGHT_NEIGHBOURS:
            inside = used & (row + drow >= 0) & (row + drow < height) & (col + dcol >= 0) & (col + dcol < width)
            beside.append(jnp.where(inside, slot_of[jnp.clip(at + drow * width + dcol, 0, none - 1)], room))
        return write(near, slot, used, jnp.stack(beside))

    near = _by_parts(count, room, part, meet, jnp.full((len(EIGHT_NEIGHBOURS), room), room, jnp.int32))

    def hook(slot, used, state):
        label, changed = state
        own = read(label, slot)
        low = jnp.min(label.at[read(near, slot)].get(mode="fill", fill_value=room), axis=0)
        low = jnp.where(used, jnp.minimum(low, label[own]), own)
        # What a cell has learnt, the cell that it points at learns too.
        return label.at[own].min(low).at[slot].min(low, mode="drop"), changed | jnp.any(low < own)

    def settle(state):
        return _by_parts(count, room, part, hook, (state[0], jnp.bool_(False)))

    lowest, _ = repeat(lambda state: state[1], settle, (lax.iota(jnp.int32, room), count > 0))
    return Groups(cell, lowest, count, total - count, part)
