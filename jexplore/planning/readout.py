"""The way to a cell, read off a reachability map: motion by motion back from the target, by a pinned rule."""

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import one_kernel, repeat
from jexplore.grid import beside, bordered
from jexplore.reach import FAR, MOTIONS, NO_MOTION, STEPS

# For `lay_route` beside each method of `reach`: in lockstep a look costs more than a motion.
STRIDES = {"sweeps": 1, "wave": 8}
STORED = 16  # one cell of so many of a way that is looked up motion by motion


def _last_motion(cost, ways_in, steps=STEPS):
    """The pinned predecessor rule, for cells given with their 3 x 3 neighbourhoods.

    Args:
      cost: `[3][3]` of `[...]`, of the cell (in the middle) and its neighbours; none is more than where no path leads,
        which is what stands outside the map.
      ways_in: five of `[...]` bool, whether the cell can be entered, and by each diagonal motion.
      steps: what a straight and a diagonal step cost. Static.

    Returns:
      `[...]` int8: the first of `MOTIONS` by which the cell's cost arises; -1 where there is none.
    """
    motion = jnp.full_like(cost[1][1], NO_MOTION, jnp.int8)
    for i, (drow, dcol) in reversed(list(enumerate(MOTIONS))):
        step = steps[1] if drow and dcol else steps[0]
        matches = (cost[1 - drow][1 - dcol] + step == cost[1][1]) & ways_in[max(i - 3, 0)]
        motion = jnp.where(matches, jnp.int8(i), motion)
    return motion


def _enterable(traversable):
    """`ways_in` of cells given with their neighbourhoods: `[3][3]` of `[...]` bool, False outside the map."""
    own = traversable[1][1]
    return [own, *(own & traversable[1 - drow][1] & traversable[1][1 - dcol] for drow, dcol in MOTIONS[4:])]


def _near(bordered_array):
    """Neighbourhoods of all cells: `[3][3]` of `[H, W]`."""
    return [[beside(bordered_array, i, j) for j in (-1, 0, 1)] for i in (-1, 0, 1)]


def last_motions(cost: Array, traversable: Array) -> Array:
    """The last motion of the path to every cell, `[H, W]` int8, NO_MOTION where there is none.

    Costs and cells as for `lay_route`.
    """
    return _last_motion(_near(bordered(cost, FAR)), _enterable(_near(bordered(traversable, False))))


def last_motions_by(cost: Array, shut: Array, steps: tuple[int, int], far: int) -> Array:
    """`last_motions` of costs of any steps, for many robots on an accelerator.

    Args:
      cost: `[H, W]` of whole numbers.
      shut: `[H, W]` uint8, from `waves.shut_ways`; higher bits do not matter.
      steps: what a straight and a diagonal step cost. Static.
      far: what stands where no path leads. Static.
    """
    # Put in a border once, and not looked up in one that each of nine reads asks for.
    near = _near(lax.optimization_barrier(bordered(cost, far)))
    return _last_motion(near, [shut >> i & 1 == 0 for i in range(5)], steps)


def lay_route(
    route: Array,
    cost: Array,
    traversable: Array,
    start: tuple[Array | int, ...],
    target: tuple[Array | int, ...],
    origin: tuple[Array | int, ...],
    *,
    stride: int = 1,
) -> Array:
    """Writes the way from the start to a target into a map of motions: the path read-out.

    Args:
      route: `[H, W]` int8, index into `MOTIONS`; at each cell of the path the motion to its next cell is written, the
        rest stays.
      cost: `[h, w]` int32, from `reach`, of a window of the map or of all of it.
      traversable: `[h, w]` bool, what `cost` was made from.
      start, target: `(row, col)` int32, in the map; both inside the window, `target` with a final cost.
      origin: `(row, col)` int32 of the window's cell (0, 0) in the map.
      stride: motions between two looks at whether the start is reached. Static.

    Returns:
      `route`: `[H, W]` int8. Following it from the start ends at the target, after at most h * w motions.
    """

    def lay(route, cost, traversable, start, target, origin):
        cost, traversable = jnp.pad(cost, 1, constant_values=FAR), jnp.pad(traversable, 1)
        return _walk_back(route, cost, traversable, start, target, origin)

    if stride == 1:
        return one_kernel(lay, route, cost, traversable, start, target, origin)
    motions = last_motions(cost, traversable)

    def lay_more(state):
        n, at, route = state
        at, way = way_by_steps(motions, at, origin, route.shape[0], n=stride)
        return n + stride, at, laid(route, way)

    def under_way(state):
        n, at, _ = state
        return ((at[0] != start[0]) | (at[1] != start[1])) & (n < cost.size)

    with jax.named_scope("route"):
        return repeat(under_way, lay_more, (jnp.int32(0), target, route))[2]


@struct.dataclass
class Way:
    """Motions of a way, the last one first, and the cells in which they are made."""

    rows: Array  # [n] int32; each its own beyond the last row of the map where there is no motion
    cols: Array  # [n] int32
    motions: Array  # [n] int8, index into `MOTIONS`

    def first(self, row: Array | int, col: Array | int) -> Array:
        """The motion in a cell, which the way leaves once: int32; 0 where it does not come there."""
        return jnp.sum(jnp.where((self.rows == row) & (self.cols == col), self.motions, 0), dtype=jnp.int32)


def laid(route: Array, way: Way) -> Array:
    """A map of motions with a `Way` written into it."""
    return route.at[way.rows, way.cols].set(way.motions, mode="drop", unique_indices=True)


def _back(width):
    """By how much each motion back changes a flat index; that of NO_MOTION, the last, by nothing: `[9]` int32."""
    return jnp.asarray([-drow * width - dcol for drow, dcol in MOTIONS] + [0], jnp.int32)


def _before(motions):
    """The flat cell from which each cell is entered, its own where no motion leads there: `[h * w]` int16 or int32."""
    height, width = motions.shape
    dtype = jnp.int16 if motions.size < 2**15 else jnp.int32
    return (lax.iota(jnp.int32, height * width) + _back(width)[motions.reshape(-1)]).astype(dtype)


def _way(cells, motions, origin, height):
    """The `Way` that enters some cells, `[n + 1]` flat, one after the other, as far as there are motions."""
    made = motions.reshape(-1).at[cells[:-1]].get(mode="promise_in_bounds")
    beyond = height + lax.iota(jnp.int32, made.shape[0])
    rows, cols = cells[1:] // motions.shape[1] + origin[0], cells[1:] % motions.shape[1] + origin[1]
    return Way(jnp.where(made == NO_MOTION, beyond, rows), cols, made)


def way_by_doubling(
    motions: Array, target: tuple[Array, Array], origin: tuple[Array | int, ...], height: int, *, n: int
) -> Way:
    """The last n motions of the way to a cell, in few steps: after each twice as many.

    Args:
      motions: `[h, w]` int8, from `last_motions`, of a window.
      target: `(row, col)` int32, in the window.
      origin: `(row, col)` int32, of the window in the map.
      height: rows of the map. Static.
      n: static.
    """
    before = lax.optimization_barrier(_before(motions))  # else made anew for every step that is looked up
    cells = jnp.asarray(target[0] * motions.shape[1] + target[1], jnp.int32)[None]
    while cells.shape[0] <= n:
        cells = jnp.concatenate([cells, before.at[cells].get(mode="promise_in_bounds").astype(jnp.int32)])
        if cells.shape[0] <= n:
            before = before.at[before].get(mode="promise_in_bounds")
    return _way(cells[: n + 1], motions, origin, height)


def way_by_steps(
    motions: Array, at: tuple[Array, Array], origin: tuple[Array | int, ...], height: int, *, n: int
) -> tuple[tuple[Array, Array], Way]:
    """The last n motions of the way to a cell, one by one.

    Args:
      motions, origin, height, n: as for `way_by_doubling`.
      at: `(row, col)` int32, the cell, in the map.

    Returns:
      `(at, Way)`: where these motions begin.
    """
    width, flat = motions.shape[1], motions.reshape(-1)
    back, cells = _back(width), [(at[0] - origin[0]) * width + at[1] - origin[1]]
    for i in range(n):
        # Each motion is looked up from the last cell that is stored, which is not far back.
        cells[-1] = cells[-1] if i % STORED else lax.optimization_barrier(cells[-1])
        cells.append(cells[-1] + back[flat.at[cells[-1]].get(mode="promise_in_bounds")])
    way = _way(jnp.stack(cells), motions, origin, height)
    return (cells[-1] // width + origin[0], cells[-1] % width + origin[1]), way


def _walk_back(route, cost, traversable, start, target, origin):
    """`lay_route` with cost and traversable cells in a border, motion by motion."""
    motions = jnp.asarray(MOTIONS, jnp.int32)

    def under_way(state):
        n, row, col, _ = state
        return ((row != start[0]) | (col != start[1])) & (n < cost.size)

    def back(state):
        n, row, col, route = state
        going = under_way(state)
        corner = row - origin[0], col - origin[1]
        near, can = (lax.dynamic_slice(a, corner, (3, 3)) for a in (cost, traversable))
        motion = _last_motion(near, _enterable(can))
        motion = jnp.where(going, motion, route[row, col])
        row, col = (jnp.where(going, at - motions[motion, axis], at) for axis, at in enumerate((row, col)))
        return n + going, row, col, lax.dynamic_update_slice(route, motion[None, None], (row, col))

    return repeat(under_way, back, (jnp.int32(0), target[0], target[1], route))[3]
