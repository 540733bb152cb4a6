"""Rooms: the watershed of the clearance, where two basins are one room if the pass between them is wide.

Peaks of the clearance and passes between them are the nodes and the narrow places of the Voronoi graph. So this cuts
free space where `segment` does, and needs no graph, whose spurs would hide narrow places from each other.
"""

import functools
import math
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits, groups
from jexplore.arrays.loops import settled
from jexplore.distance import nearest_offset
from jexplore.grid import any_within_one, any_within_one_packed, beside, bordered, count

RATIO = 0.65
NARROWING = 0.9  # 0.65 and 0.9: chosen for 17 of 18 buildings by the others, MCC .930 and .879 (furnished) on nine real
SMALLEST_ROOM_M2 = 2.0
CLUTTER_M = 1.0
HIGHEST = 2**20  # squared clearance without any obstacle, cells^2
_FAN = np.linspace(-np.pi / 2, np.pi / 2, 17, dtype=np.float32)  # directions to one side of a pass, 11 degrees apart


@struct.dataclass
class RoomCriteria:
    """Criteria of a room. Numbers that may be swept without compiling anew."""

    ratio: Array  # float32: a pass is a door if its clearance is below this share of that of the lower of both peaks
    narrowing: Array | None  # float32: or of that as far from it as it is wide, on both sides; None: only of the peaks
    smallest: Array  # float32, cells: the area of the smallest room
    clutter: Array  # float32, cells: an obstacle whose bounding box has a shorter diagonal is clutter, no wall


class RoomForm(NamedTuple):
    """Static sizes. Hashable."""

    basins: int  # B, peaks of the clearance, at most
    passes: int  # between two basins, along the rows and along the columns each, at most
    edges: int  # most obstacle cells next to free ones


@struct.dataclass
class Rooms:
    """Free space in rooms. A room is known by the number of one of its B basins."""

    label: Array  # [H, W] int32, room of every free cell, 0 or more, not consecutive; -1 elsewhere
    door_d2: Array  # [B] int32, squared clearance of the widest way out of each room, cells^2; 0 without any
    area: Array  # [B] int32, free cells of each room; 0 in a slot that is no room
    peaks: Array  # int32, peaks that there are, whether they fit or not
    passes: Array  # int32, passes along the rows or along the columns, whichever is more, that did not fit
    overflow: Array  # int32, edges, peaks and passes that did not fit


def room_form_for(shape: tuple[int, ...], *, coarse: bool = False) -> RoomForm:
    """Return the `RoomForm` that suits a map of a shape.

    One cell in 128 may be a peak, one in 96 a pass, one in 7 an edge; on coarse maps, where rooms are only some cells
    wide, one in 48, in 40, in 5. The most that built-in worlds have is printed by `benchmarks/graph_sizes.py`.
    """
    cells = shape[0] * shape[1]
    peaks, passes, edges = (48, 40, 5) if coarse else (128, 96, 7)
    return RoomForm(max(96, cells // peaks), max(256, cells // passes), max(768, cells // edges))


def room_criteria(
    cell_m: float,
    *,
    ratio: float = RATIO,
    narrowing: float | None = NARROWING,
    smallest_m2: float = SMALLEST_ROOM_M2,
    clutter_m: float = CLUTTER_M,
) -> RoomCriteria:
    """Return `RoomCriteria` for cells of a size. Lengths in metres, areas in square metres."""
    near = None if narrowing is None else jnp.float32(narrowing)
    return RoomCriteria(jnp.float32(ratio), near, jnp.float32(smallest_m2 / cell_m**2), jnp.float32(clutter_m / cell_m))


def clutter(free: Array, size: Array | float, *, edges: int) -> tuple[Array, Array]:
    """Find obstacles other than walls: legs of tables, cupboards in the middle of a room.

    Cells that are not `free` `[H, W]` and touch along edges or corners are one obstacle. One whose bounding box has a
    diagonal shorter than `size` cells, and that is not at the map's rim, is clutter. At most `edges` obstacle cells
    next to free ones are examined; those beyond count as walls. Returns `[H, W]` bool, and int32, how many edges did
    not fit.
    """
    height, width = free.shape
    edge = ~free & any_within_one(free)
    cells = groups.grouped(edge, edges)
    group = cells.lowest  # all round an obstacle, or all round a hole in one
    row, col = cells.cell // width, cells.cell % width
    used = cells.cell < height * width
    bottom, top, left, right = (
        jax.ops.segment_max(jnp.where(used, end, -HIGHEST), group, group.shape[0]) for end in (-row, row, -col, col)
    )
    is_small = (top + bottom) ** 2 + (left + right) ** 2 < size**2
    at = jnp.where(used & is_small[group], cells.cell, height * width)
    small = jnp.zeros((height * width,), bool).at[at].set(True, mode="drop").reshape(height, width)
    rows, cols = (lax.broadcasted_iota(jnp.int32, free.shape, axis) for axis in (0, 1))
    rim = (rows == 0) | (rows == height - 1) | (cols == 0) | (cols == width - 1)
    # Clutter lies within its size of its edge. Whatever hangs together with a long edge, the rim or what lies farther
    # from all small edges is a wall.
    solid, around = bits.pack(~free), bits.pack(small)
    around = lax.fori_loop(
        0, jnp.int32(jnp.minimum(size, height + width)) + 1, lambda _, words: any_within_one_packed(words), around
    )
    wall = bits.pack(~free & ((edge & ~small) | rim)) | (solid & ~around)

    def spread(_, words):
        return words | (any_within_one_packed(words) & solid)

    wall = settled(lambda words: lax.fori_loop(0, 8, spread, words), wall)
    return ~free & ~bits.unpack(wall, height), cells.overflow


@functools.partial(jax.jit, static_argnames=("edges",))
def cleared(free: Array, unknown: Array, size: Array | float, *, edges: int) -> tuple[Array, Array, Array]:
    """Return free space without clutter, and the distances of its walls. Arguments as of `watershed` and `clutter`.

    `(inside, d2, overflow)`: `[H, W]` bool, free cells and clutter; `[H, W]` int32, squared distance to the nearest
    wall, cells^2, at most `HIGHEST`; int32, edges that did not fit.
    """
    small, overflow = clutter(free, size, edges=edges)
    return free | small, jnp.minimum(nearest_offset(~free & ~small & ~unknown)[0], HIGHEST), overflow


def peaks(d2: Array, inside: Array) -> Array:
    """Return the peak that steepest ascent reaches from every cell.

    Args:
      d2: `[H, W]` int32, 0 or more: the squares of the heights.
      inside: `[H, W]` bool, cells that the ascent may cross. A diagonal step needs one of its two orthogonal
        neighbours.

    Returns:
      `[H, W]` int32, flat index of the peak; outside `inside`, the cell itself. Cells of equal height ascend in the
      order of their indices, and of equally steep steps the last is taken.
    """
    shape = d2.shape
    own = lax.broadcasted_iota(jnp.int32, shape, 0) * shape[1] + lax.broadcasted_iota(jnp.int32, shape, 1)
    height = jnp.sqrt(d2.astype(jnp.float32))
    heights, open_ = bordered(jnp.where(inside, height, -1.0), -1.0), bordered(inside, False)
    best, up = jnp.zeros(shape, jnp.float32), own
    for drow, dcol in groups.EIGHT_NEIGHBOURS:
        # A straight step before a diagonal one to the same height: along a straight wall nobody drifts aside.
        step = 1.0 if 0 in (drow, dcol) else math.sqrt(0.5)
        slope = (beside(heights, drow, dcol) - height) * jnp.float32(step)
        at = own + drow * shape[1] + dcol
        may = beside(open_, drow, 0) | beside(open_, 0, dcol)
        steeper = may & ((slope > best) | ((slope == best) & (at > up)))
        best, up = jnp.where(steeper, slope, best), jnp.where(steeper, at, up)
    up = jnp.where(inside, up, own).reshape(-1)
    return settled(lambda up: up[up], up).reshape(shape)


class _Passes(NamedTuple):
    """Pairs of cells side by side in two basins; of pairs that touch each other the widest, the first of equals.

    The widest come last; of equally wide ones those between the higher peaks, so that turning a map changes little.
    """

    one: Array  # [E] int32, basin; B in an unused slot
    other: Array  # [E] int32, second basin
    d2: Array  # [E] int32, squared clearance: the smaller one of both cells
    narrow: Array  # [E] bool: the clearance rises on both sides within the width of the pass


def _is_narrow(d2, cell, low, step, share):
    """Return whether passes are narrow compared with what lies next to them on both sides: `[E]` bool.

    Looked at are the half circles round both cells of the pair, as far away as the nearest obstacle. Beyond a wall
    there no cell is farther from the wall than the pass is, so that nothing leaks.
    """
    height, width = d2.shape
    reach = jnp.sqrt(low.astype(jnp.float32))[:, None]
    along, aside = (jnp.round(reach * part(_FAN)).astype(jnp.int32) for part in (np.cos, np.sin))
    near = []
    for ahead in (-along, 1 + along):
        row, col = (aside, ahead) if step == (0, 1) else (ahead, aside)
        row = jnp.clip(cell[:, None] // width + row, 0, height - 1)
        col = jnp.clip(cell[:, None] % width + col, 0, width - 1)
        near.append(jnp.max(d2[row, col], axis=1))
    return _clearance(low) < share * _clearance(jnp.minimum(*near))


def _passes(basin, d2, tops, n, size, narrowing):
    """Find `(passes, most)` of basins 0 to n - 1, `[H, W]` int32, n elsewhere, with peaks `tops`."""
    basins, heights = bordered(basin, n), bordered(d2, 0)
    found, most = [], jnp.int32(0)
    for step in ((0, 1), (1, 0)):
        other = beside(basins, *step)
        is_pair = (basin < n) & (other < n) & (basin != other)
        low = jnp.where(is_pair, jnp.minimum(d2, beside(heights, *step)), -1)
        pairs, lows = bordered(jnp.where(is_pair, basin * n + other, -1), -1), bordered(low, -1)
        widest = is_pair
        for aside in ((sign, shift) if step == (0, 1) else (shift, sign) for sign in (1, -1) for shift in (-1, 0, 1)):
            there = jnp.where(beside(pairs, *aside) == beside(pairs, 0, 0), beside(lows, *aside), -1)
            widest &= (there <= low) if aside > (0, 0) else (there < low)
        cell = bits.first_cells(bits.pack(widest), size)
        lows = groups.at(low, cell, 0)
        narrow = jnp.zeros((size,), bool)
        if narrowing is not None:
            narrow = _is_narrow(jnp.where(basin < n, d2, 0), cell, lows, step, narrowing)
        found.append(_Passes(groups.at(basin, cell, n), groups.at(other, cell, n), lows, narrow))
        most = jnp.maximum(most, count(widest))
    passes = _Passes(*map(jnp.concatenate, zip(*found)))
    ends = tops[passes.one], tops[passes.other]
    last = -lax.iota(jnp.int32, 2 * size)
    order = jnp.lexsort((last, jnp.minimum(*ends), jnp.maximum(*ends), passes.d2))
    return _Passes(*(a[order] for a in passes)), most


def _widest(room, passes, is_open):
    """Return for every room, `[B + 1]`, the room beyond its widest open pass, itself without any, and that pass's d2.

    `room` is that of every basin, the last stands for none; `is_open` [E] bool, passes between two rooms that count.
    """
    n = room.shape[0]
    one, other = room[passes.one], room[passes.other]
    slots = jnp.where(is_open, lax.iota(jnp.int32, passes.d2.shape[0]), -1)
    slot = jnp.full((n,), -1, jnp.int32).at[one].max(slots).at[other].max(slots)
    at, own = jnp.maximum(slot, 0), lax.iota(jnp.int32, n)
    beyond = jnp.where(one[at] == own, other[at], one[at])
    return jnp.where(slot >= 0, beyond, own), jnp.where(slot >= 0, passes.d2[at], -1)


def _clearance(d2):
    """Return the clearance from the middle of a cell to the edge of the obstacle, cells."""
    return jnp.sqrt(d2.astype(jnp.float32)) - 0.5


def _joined(passes, heights, ratio):
    """Join basins across wide passes, the widest first: `[B + 1]` int32, a basin of each room.

    A room whose own widest pass is wide for its own peak can be joined at once, in any order: nothing that happens to
    the room beyond can make that pass a door. So all such rooms are joined in one round.
    """
    own = lax.iota(jnp.int32, heights.shape[0])

    def join(room):
        highest = jnp.zeros_like(own).at[room].max(heights)
        needed = ratio * _clearance(highest)
        one, other = room[passes.one], room[passes.other]
        is_wide = _clearance(passes.d2) >= jnp.minimum(needed[one], needed[other])
        is_open = (one != other) & is_wide & ~passes.narrow
        there, d2 = _widest(room, passes, is_open)
        to = jnp.where((d2 >= 0) & (_clearance(d2) >= needed), there, own)
        to = jnp.where((to[to] == own) & (own < to), own, to)  # of two that want each other one stays
        return settled(lambda to: to[to], to)[room]

    return settled(join, own)


def _absorbed(room, passes, each, smallest):
    """Join rooms that are too small to the one beyond their widest pass.

    In rounds, until none is left: every such room at once, but for those that a smaller one wants to join, and, of two
    small ones, the larger. `each` is the free cells of every basin.
    """
    own = lax.iota(jnp.int32, room.shape[0])

    def absorb(room):
        area = jnp.zeros_like(own).at[room].add(each)
        there, _ = _widest(room, passes, room[passes.one] != room[passes.other])
        smaller = (area < area[there]) | ((area == area[there]) & (own < there))
        wants = (area < smallest) & (there != own) & (smaller | (area[there] >= smallest))
        is_wanted = jnp.zeros(own.shape, bool).at[jnp.where(wants, there, own.size)].set(True, mode="drop")
        return jnp.where(wants & ~is_wanted, there, own)[room]

    return settled(absorb, room)


@functools.partial(jax.jit, static_argnames=("form",))
def watershed(free: Array, unknown: Array, criteria: RoomCriteria, *, form: RoomForm) -> Rooms:
    """Divide free space into rooms.

    Every cell belongs to the peak of clearance that steepest ascent leads to. Two such basins are one room unless the
    pass between them is a door: narrow compared with both peaks, or with what lies next to it on both sides. The second
    tells a doorway nearly as wide as a room from the corridor that it opens to, narrow along its length. Rooms that are
    too small become part of the room beyond their widest exit.

    Args:
      free: `[H, W]` bool, cells known to be free. What lies outside the map is no obstacle.
      unknown: `[H, W]` bool, cells that are neither free nor obstacles: no walls, and no way through.
      form: static.

    Source:
      Thrun 1998 and Holz et al. 2010, section 2.4, cut free space at the minima of clearance along the Voronoi graph;
      Vincent and Soille 1991, watersheds. A pass is judged relative to the peaks, so that no length is tuned.
    """
    chex.assert_rank([free, unknown], 2)
    chex.assert_type([free, unknown], bool)
    chex.assert_equal_shape([free, unknown])
    n, cells = form.basins, free.size
    inside, d2, lost_edges = cleared(free, unknown, criteria.clutter, edges=form.edges)
    peak = peaks(d2, inside)
    own = lax.iota(jnp.int32, cells).reshape(free.shape)
    is_peak = inside & (peak == own)
    n_peaks = count(is_peak)
    slot = bits.first_cells(bits.pack(is_peak), n)
    number = jnp.full((cells,), n, jnp.int32).at[slot].set(lax.iota(jnp.int32, n), mode="drop")
    basin = jnp.where(inside, number[peak], n)
    tops = jnp.append(groups.at(d2, slot, 0), 0)
    passes, n_passes = _passes(basin, d2, tops, n, form.passes, criteria.narrowing)
    each = jax.ops.segment_sum(free.astype(jnp.int32).reshape(-1), basin.reshape(-1), n + 1)
    room = _joined(passes, tops, criteria.ratio)
    room = _absorbed(room, passes, each, criteria.smallest)
    _, door_d2 = _widest(room, passes, room[passes.one] != room[passes.other])
    return Rooms(
        label=jnp.where(free & (basin < n), room[basin], -1),
        door_d2=jnp.maximum(door_d2[:n], 0),
        area=jnp.zeros((n + 1,), jnp.int32).at[room].add(each)[:n],
        peaks=n_peaks,
        passes=n_passes,
        overflow=lost_edges + jnp.maximum(n_passes - form.passes, 0) + jnp.maximum(n_peaks - n, 0),
    )
