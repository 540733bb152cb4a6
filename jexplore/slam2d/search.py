"""Search for a pose over a window, without a good guess: correlative scan matching at two resolutions."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.poses import rotated, wrapped
from jexplore.native import kernels
from jexplore.slam2d.points import NUMBER_BITS, STEPS, PointMap, cell_m, cells_of
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.settings import SlamSettings

BLOCK = 6  # fine steps to a coarse one
OUTSIDE = 2.0**24  # cells from the picture beyond which a point is anywhere: whole numbers do not wrap
MOST_STEPS = 2**13 - 1  # the largest cost of a point, that of a cell of the index without one


class Window(NamedTuple):
    """Extent of a search on either side; static."""

    blocks: int  # coarse steps of place
    turns: int  # steps of heading
    side: int = 448  # cells of the map that are looked at, of at most as many as it has
    best: int = 32  # coarse steps that are searched finely


class Found(NamedTuple):
    """Result of a search."""

    pose: Array  # [3] float32
    cost: Array  # float32, mean of the points' costs, 0 to `search_cap`
    other: Array  # float32, the least cost found more than a block or two turns away


def step_cost(settings: SlamSettings) -> Array:
    """Return the cost of one of the steps of `picture`: float32. See `SlamSettings.search_blur_m`."""
    return jnp.float32(0.5 * (cell_m(settings) / settings.search_blur_m) ** 2 / STEPS)


def most_steps(settings: SlamSettings) -> Array:
    """Return the cost of a point without any of the map nearby, in steps: int32."""
    return jnp.round(jnp.minimum(settings.search_cap / step_cost(settings), MOST_STEPS)).astype(jnp.int32)


def picture(settings: SlamSettings, points: PointMap, row: Array, col: Array, side: int) -> tuple[Array, Array, Array]:
    """Return the cost of a point in every cell round one: `(cost, row, col)`, `[S, S]` int16, steps; its first cell.

    The square is moved so that it lies within the map. Whole numbers: their sums do not depend on the order.
    """
    size, (row, col) = _square(points, row, col, side)
    near = lax.dynamic_slice(points.near, (row, col), size)
    return jnp.minimum(near >> NUMBER_BITS, most_steps(settings)).astype(jnp.int16), row, col


def _square(points, row, col, side):
    """Return height, width and first cell of the square round a cell."""
    size = tuple(min(side, n) for n in points.near.shape)
    first = (jnp.clip(at - n // 2, 0, m - n) for at, n, m in zip((row, col), size, points.near.shape))
    return size, tuple(first)


def search(settings: SlamSettings, points: PointMap, scan: Scan, start: Array, prior: Array, window: Window) -> Found:
    """Find the pose of the least cost in a window round a guess.

    The cost of a pose is the mean cost of the scan's points there, and log(1 + d^2 / 2) for a distance of d standard
    deviations from the guess, as one of `points / correlation` measurements: odometry errs seldom, but then by much.

    Args:
      start, prior: guess `[3]` and covariance `[3, 3]`.

    Source:
      Olson, Real-time correlative scan matching (2009). Changed: a fixed number of coarse steps is searched finely.
    """
    at = cells_of(settings, points, start[0], start[1])
    row, col = (jnp.floor(a).astype(jnp.int32) for a in at)
    _, (first_row, first_col) = _square(points, row, col, window.side)
    edge_m, turn, sd = cell_m(settings), jnp.radians(settings.search_turn_deg), jnp.sqrt(jnp.diagonal(prior))
    n = jnp.maximum(jnp.sum(scan.valid), 1)
    turns = jnp.arange(-window.turns, window.turns + 1)
    blocks = jnp.arange(-window.blocks, window.blocks) * BLOCK
    arm = rotated(scan.xy, start[2] + turns[:, None] * turn) / edge_m  # [T, B, 2]
    cells = (arm[..., 1] + (at[0] - first_row), arm[..., 0] + (at[1] - first_col))
    cells = jnp.stack([jnp.floor(jnp.clip(a, -OUTSIDE, OUTSIDE)).astype(jnp.int32) + BLOCK for a in cells])

    def guess(k, up, right):
        off2 = (k * turn / sd[2]) ** 2 + (up * edge_m / sd[1])[:, None] ** 2 + (right * edge_m / sd[0])[None, :] ** 2
        # Measured on Freiburg 079: 7 standard deviations where the robot backs out of a room.
        return jnp.log1p(off2 / 2) * settings.correlation / n

    least_off = jnp.maximum(jnp.maximum(blocks, -(blocks + BLOCK - 1)), 0)  # cells of a block's nearest from the guess
    floors, cost = _coarse(settings, points, scan, cells, row, col, window)
    per = step_cost(settings) / n
    bound = floors * per + jax.vmap(lambda k: guess(k, least_off, least_off))(turns)  # [T, N, N]
    # The barrier: XLA on a CPU sorts all of them where a slice of the result is used.
    least, which = lax.optimization_barrier(lax.top_k(-bound.reshape(-1), min(window.best + 1, bound.size)))
    which = jnp.stack(jnp.unravel_index(which[:-1], bound.shape)).astype(jnp.int32)
    sums = _fine(settings, points, scan, cells, cost, which, len(blocks))

    def fine(sums, k, i, j):
        up, right = blocks[i] + jnp.arange(BLOCK), blocks[j] + jnp.arange(BLOCK)
        costs = sums * per + guess(turns[k], up, right)
        at = jnp.argmin(costs)
        return costs.reshape(-1)[at], jnp.stack([right[at % BLOCK], up[at // BLOCK], turns[k]])

    costs, steps = jax.vmap(fine)(sums, *which)
    best = jnp.argmin(costs)
    apart = jnp.any(jnp.abs(steps - steps[best]) > jnp.array([BLOCK, BLOCK, 2]), axis=1)
    pose = start + steps[best] * jnp.stack([edge_m, edge_m, turn]).astype(jnp.float32)
    others = jnp.where(apart, costs, -least[-1])
    return Found(pose.at[2].set(wrapped(pose[2])), costs[best], jnp.min(others))


def _coarse(settings, points, scan, cells, row, col, window):
    """Return sums of the least costs of blocks, `[T, N, N]` int32 steps, and the picture with a margin of a block.

    `cells`: `[2, T, B]` int32, rows and columns of the points in that picture.
    """
    most, n, native = most_steps(settings), 2 * window.blocks, kernels.target_of(points.native)
    if native is not None:
        size, first = _square(points, row, col, window.side)
        results = [((cells.shape[1], n, n), jnp.int32), (tuple(side + 2 * BLOCK for side in size), jnp.int16)]
        terms = kernels.numbers([*first, most])
        return tuple(kernels.call(native, "coarse", results, points.near, cells, scan.valid, terms))
    cost, _, _ = picture(settings, points, row, col, window.side)
    cost = jnp.pad(cost, BLOCK, constant_values=most.astype(jnp.int16))  # or a block across the edge is no bound
    floors, blocks = _block_minima(cost, most.astype(jnp.int16)), jnp.arange(-window.blocks, window.blocks) * BLOCK

    def total(cells):
        return _total(floors, cells[0] + blocks[:, None, None], cells[1] + blocks[None, :, None], scan.valid, most)

    return lax.map(total, cells.swapaxes(0, 1)), cost


def _fine(settings, points, scan, cells, cost, which, n):
    """Return sums of costs in blocks `[3, M]` int32, turn, row and column: `[M, BLOCK, BLOCK]` int32, steps."""
    most, native = most_steps(settings), kernels.target_of(points.native)
    if native is not None:
        result, terms = [((which.shape[1], BLOCK**2), jnp.int32)], kernels.numbers([most, n])
        (sums,) = kernels.call(native, "fine", result, cost, cells, scan.valid, which, terms)
        return sums.reshape(-1, BLOCK, BLOCK)
    inside = jnp.arange(BLOCK)

    def total(k, i, j):
        up, right = (BLOCK * (at - n // 2) + inside for at in (i, j))
        return _total(cost, cells[0, k] + up[:, None, None], cells[1, k] + right[None, :, None], scan.valid, most)

    return jax.vmap(total)(*which)


def _total(costs, row, col, valid, most):
    """Return the sum of the costs of points in cells, over the last axis."""
    height, width = costs.shape
    inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
    each = jnp.where(inside, costs.reshape(-1)[jnp.where(inside, row * width + col, 0)], most)
    return jnp.sum(jnp.where(valid, each, 0), axis=-1, dtype=jnp.int32)


def _block_minima(cost, cap):
    """Return the least cost of the `BLOCK` x `BLOCK` cells from every cell on, up and to the right."""
    for axis in (0, 1):
        for shift in (1, 2, 2):  # 2, 4, 6 cells
            tail = lax.slice_in_dim(cost, shift, cost.shape[axis], axis=axis)
            pad = [(0, shift) if a == axis else (0, 0) for a in (0, 1)]
            cost = jnp.minimum(cost, jnp.pad(tail, pad, constant_values=cap))
    return cost
