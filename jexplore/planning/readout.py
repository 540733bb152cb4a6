"""The way to a cell, read off a reachability map: motion by motion back from the target, by a pinned rule."""

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import one_kernel, repeat
from jexplore.reach import FAR, MOTIONS, NO_MOTION, STEPS


def _last_motion(cost, ways_in):
    """Return the first of `MOTIONS` by which cells' costs arise, -1 without one: int8.

    `cost`: `[3][3]` of `[...]`, of cells and their neighbours, FAR outside the map; `ways_in`: from `_enterable`.
    """
    motion = jnp.full_like(cost[1][1], NO_MOTION, jnp.int8)
    for i, (drow, dcol) in reversed(list(enumerate(MOTIONS))):
        step = STEPS[bool(drow and dcol)]
        matches = (cost[1 - drow][1 - dcol] + step == cost[1][1]) & ways_in[max(i - 3, 0)]
        motion = jnp.where(matches, jnp.int8(i), motion)
    return motion


def _enterable(traversable):
    """Return `ways_in` of cells given with their neighbourhoods: `[3][3]` of `[...]` bool, False outside the map."""
    own = traversable[1][1]
    return [own, *(own & traversable[1 - drow][1] & traversable[1][1 - dcol] for drow, dcol in MOTIONS[4:])]


def lay_route(
    route: Array,
    cost: Array,
    traversable: Array,
    start: tuple[Array | int, ...],
    target: tuple[Array | int, ...],
    origin: tuple[Array | int, ...],
) -> Array:
    """Write the path from the start to a target into a map of motions.

    Args:
      route: `[H, W]` int8, index into `MOTIONS`; at each cell of the path the motion to its next cell is written, the
        rest stays.
      cost: `[h, w]` int32, from `reach`, of a window of the map or of the whole map.
      traversable: `[h, w]` bool, input of `cost`.
      start, target: `(row, col)` int32, in the map; both inside the window, `target` with a final cost.
      origin: `(row, col)` int32 of the window's cell (0, 0) in the map.

    Returns:
      `route`: `[H, W]` int8. Following it from the start ends at the target, after at most h * w motions.
    """

    def lay(route, cost, traversable, start, target, origin):
        cost, traversable = jnp.pad(cost, 1, constant_values=FAR), jnp.pad(traversable, 1)
        return _walk_back(route, cost, traversable, start, target, origin)

    return one_kernel(lay, route, cost, traversable, start, target, origin)


def _walk_back(route, cost, traversable, start, target, origin):
    """Run `lay_route` with cost and traversable cells in a border, motion by motion."""
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
