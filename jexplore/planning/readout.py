"""The way to a cell, read off a reachability map: motion by motion back from the target, by a pinned rule."""

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import one_kernel, repeat
from jexplore.grid import beside, bordered
from jexplore.reach import DIAGONAL, FAR, MOTIONS, NO_MOTION, STRAIGHT

# For `lay_route` beside each method of `reach`: in lockstep a look costs more than a motion.
STRIDES = {"sweeps": 1, "wave": 8}


def _last_motion(cost, traversable):
    """The pinned predecessor rule, for cells given with their 3 x 3 neighbourhoods.

    Args:
      cost: `[3][3]` of `[...]` int32, of the cell (in the middle) and its neighbours; FAR outside the map.
      traversable: `[3][3]` of `[...]` bool; False outside the map.

    Returns:
      `[...]` int8: the first of `MOTIONS` by which the cell's cost arises; -1 where there is none.
    """
    motion = jnp.full_like(cost[1][1], NO_MOTION, jnp.int8)
    for i, (drow, dcol) in reversed(list(enumerate(MOTIONS))):
        before = cost[1 - drow][1 - dcol]
        step = DIAGONAL if drow and dcol else STRAIGHT
        beside = traversable[1 - drow][1] & traversable[1][1 - dcol] if drow and dcol else True
        matches = (before < FAR) & (before + step == cost[1][1]) & traversable[1][1] & beside
        motion = jnp.where(matches, jnp.int8(i), motion)
    return motion


def last_motions(cost: Array, traversable: Array) -> Array:
    """The last motion of the path to every cell, `[H, W]` int8, for `lay_some`; costs and cells as for `lay_route`."""
    pairs = (bordered(cost, FAR), bordered(traversable, False))
    return _last_motion(*([[beside(a, i, j) for j in (-1, 0, 1)] for i in (-1, 0, 1)] for a in pairs))


def lay_route(
    route: Array,
    cost: Array,
    traversable: Array,
    start: tuple[Array | int, ...],
    target: tuple[Array | int, ...],
    origin: tuple[Array | int, ...],
    *,
    stride: int = 1,
    within: int | None = None,
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
      within: motions, at most, of any way, if that is known: a loop of known length. Static; not for stride 1.

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
        return n + stride, *lay_some(route, motions, start, at, origin, n=stride)

    def under_way(state):
        n, at, _ = state
        return ((at[0] != start[0]) | (at[1] != start[1])) & (n < cost.size)

    with jax.named_scope("route"):
        state = jnp.int32(0), target, route
        if within is not None:
            return lax.fori_loop(0, -(-within // stride), lambda _, state: lay_more(state), state)[2]
        return repeat(under_way, lay_more, state)[2]


def lay_some(
    route: Array,
    motions: Array,
    start: tuple[Array | int, ...],
    at: tuple[Array, ...],
    origin: tuple[Array | int, ...],
    *,
    n: int,
) -> tuple[tuple[Array, Array], Array]:
    """The last motions of the way from the start to a cell, for `lay_route`.

    Args:
      route, start, origin: as for `lay_route`.
      motions: `[h, w]` int8, from `last_motions`.
      at: `(row, col)` int32, the cell.
      n: motions, at most. Static.

    Returns:
      `(at, route)`: where these motions begin, and the map with them, written together: fewer kernels.
    """
    moves, (row, col), made = jnp.asarray(MOTIONS, jnp.int32), at, []
    for k in range(n):
        going = (row != start[0]) | (col != start[1])
        motion = motions[row - origin[0], col - origin[1]]
        row, col = (jnp.where(going, at - moves[motion, axis], at) for axis, at in enumerate((row, col)))
        made.append((jnp.where(going, row, route.shape[0] + k), col, motion))  # beyond the last row: dropped
    rows, cols, values = map(jnp.stack, zip(*made))
    return (row, col), route.at[rows, cols].set(values, mode="drop", unique_indices=True)


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
        motion = _last_motion(*(lax.dynamic_slice(a, corner, (3, 3)) for a in (cost, traversable)))
        motion = jnp.where(going, motion, route[row, col])
        row, col = (jnp.where(going, at - motions[motion, axis], at) for axis, at in enumerate((row, col)))
        return n + going, row, col, lax.dynamic_update_slice(route, motion[None, None], (row, col))

    return repeat(under_way, back, (jnp.int32(0), target[0], target[1], route))[3]
