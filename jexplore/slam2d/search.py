"""Search for a pose over a window, without a good guess: correlative scan matching at two resolutions."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.poses import rotated, wrapped
from jexplore.slam2d.points import NO_POINT, NUMBER_BITS, STEPS, PointMap, cell_m, cells_of
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.settings import SlamSettings

BLOCK = 6  # fine steps to a coarse one
BEST = 32  # coarse steps that are searched finely


class Window(NamedTuple):
    """Extent of a search on either side; static."""

    blocks: int  # coarse steps of place
    turns: int  # steps of heading
    side: int = 448  # cells of the map that are looked at, of at most as many as it has


class Found(NamedTuple):
    """Result of a search."""

    pose: Array  # [3] float32
    cost: Array  # float32, mean of the points' costs, 0 to `search_cap`
    other: Array  # float32, the least cost found more than a block or two turns away
    is_best: Array  # bool, no pose of the window costs less


def picture(settings: SlamSettings, points: PointMap, row: Array, col: Array, side: int) -> tuple[Array, Array, Array]:
    """Return the cost of a point in every cell round one: `(cost, row, col)`, `[S, S]` float32 and its first cell.

    The square is moved so that it lies within the map. Cost: see `SlamSettings.search_blur_m`.
    """
    height, width = points.near.shape
    rows, cols = min(side, height), min(side, width)
    first = jnp.clip(row - rows // 2, 0, height - rows), jnp.clip(col - cols // 2, 0, width - cols)
    near = lax.dynamic_slice(points.near, first, (rows, cols))
    scale = 0.5 * (cell_m(settings) / settings.search_blur_m) ** 2 / STEPS
    cost = jnp.minimum((near >> NUMBER_BITS).astype(jnp.float32) * scale, settings.search_cap)
    return jnp.where(near == NO_POINT, settings.search_cap, cost), *first


def search(settings: SlamSettings, points: PointMap, scan: Scan, start: Array, prior: Array, window: Window) -> Found:
    """Find the pose of the least cost in a window round a guess.

    The cost of a pose is the mean cost of the scan's points there, and log(1 + d^2 / 2) for a distance of d standard
    deviations from the guess, as one of `points / correlation` measurements: odometry errs seldom, but then by much.

    Args:
      start, prior: guess `[3]` and covariance `[3, 3]`.

    Source:
      Olson, Real-time correlative scan matching (2009). Changed: a fixed number of coarse steps is searched finely;
      `is_best` tells whether they sufficed.
    """
    at = cells_of(settings, points, start[0], start[1])
    row, col = (jnp.floor(a).astype(jnp.int32) for a in at)
    cost, first_row, first_col = picture(settings, points, row, col, window.side)
    at = at[0] - first_row + BLOCK, at[1] - first_col + BLOCK
    cost = jnp.pad(cost, BLOCK, constant_values=settings.search_cap)  # or a block across the edge is no bound
    (height, width), floor_ = cost.shape, _block_minima(cost, settings.search_cap)
    edge_m, turn, sd = cell_m(settings), jnp.radians(settings.search_turn_deg), jnp.sqrt(jnp.diagonal(prior))
    n = jnp.maximum(jnp.sum(scan.valid), 1)

    def total(costs, row, col):
        inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
        each = jnp.where(inside, costs.reshape(-1)[jnp.where(inside, row * width + col, 0)], settings.search_cap)
        return jnp.sum(jnp.where(scan.valid, each, 0), axis=-1) / n

    def cells(k):
        arm = rotated(scan.xy, start[2] + k * turn) / edge_m
        return tuple(jnp.floor(arm[..., axis] + own).astype(jnp.int32) for axis, own in zip((1, 0), at))

    def guess(k, up, right):
        off2 = (k * turn / sd[2]) ** 2 + (up * edge_m / sd[1])[:, None] ** 2 + (right * edge_m / sd[0])[None, :] ** 2
        # Measured on Freiburg 079: 7 standard deviations where the robot backs out of a room.
        return jnp.log1p(off2 / 2) * settings.correlation / n

    turns = jnp.arange(-window.turns, window.turns + 1)
    blocks = jnp.arange(-window.blocks, window.blocks) * BLOCK
    least_off = jnp.maximum(jnp.maximum(blocks, -(blocks + BLOCK - 1)), 0)  # cells of a block's nearest from the guess

    def coarse(k):
        row, col = cells(k)
        return total(floor_, row + blocks[:, None, None], col + blocks[None, :, None]) + guess(k, least_off, least_off)

    bound = lax.map(coarse, turns)  # [T, N, N]
    least, which = lax.top_k(-bound.reshape(-1), min(BEST + 1, bound.size))

    def fine(k, i, j):
        row, col = cells(turns[k])
        up, right = blocks[i] + jnp.arange(BLOCK), blocks[j] + jnp.arange(BLOCK)
        costs = total(cost, row + up[:, None, None], col + right[None, :, None]) + guess(turns[k], up, right)
        at = jnp.argmin(costs)
        return costs.reshape(-1)[at], jnp.stack([right[at % BLOCK], up[at // BLOCK], turns[k]])

    costs, steps = jax.vmap(fine)(*jnp.unravel_index(which[:-1], bound.shape))
    best = jnp.argmin(costs)
    apart = jnp.any(jnp.abs(steps - steps[best]) > jnp.array([BLOCK, BLOCK, 2]), axis=1)
    pose = start + steps[best] * jnp.stack([edge_m, edge_m, turn]).astype(jnp.float32)
    others = jnp.where(apart, costs, -least[-1])
    return Found(pose.at[2].set(wrapped(pose[2])), costs[best], jnp.min(others), costs[best] <= -least[-1])


def _block_minima(cost, cap):
    """Return the least cost of the `BLOCK` x `BLOCK` cells from every cell on, up and to the right."""
    for axis in (0, 1):
        for shift in (1, 2, 2):  # 2, 4, 6 cells
            tail = lax.slice_in_dim(cost, shift, cost.shape[axis], axis=axis)
            pad = [(0, shift) if a == axis else (0, 0) for a in (0, 1)]
            cost = jnp.minimum(cost, jnp.pad(tail, pad, constant_values=cap))
    return cost
