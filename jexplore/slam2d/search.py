"""Search for a pose over a window, without a good guess: correlative scan matching at two resolutions."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.poses import rotated, wrapped
from jexplore.slam2d.points import PointMap
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.settings import SlamSettings

BLOCK = 4  # fine steps to a coarse one
BEST = 32  # coarse steps that are searched finely
BLUR_CELLS = 4  # as far as a point of the picture is felt


class Window(NamedTuple):
    """Extent of a search on either side; static."""

    blocks: int  # coarse steps of place
    turns: int  # steps of heading
    side: int  # of the picture of the map, cells
    cells: int  # of the map's index that cover it


class Found(NamedTuple):
    """Result of a search."""

    pose: Array  # [3] float32
    cost: Array  # float32, mean of the points' costs, 0 to `search_cap`
    other: Array  # float32, the least cost found more than a block or two turns away
    is_best: Array  # bool, no pose of the window costs less


def draw_points(settings: SlamSettings, xy: Array, valid: Array, centre: Array, side: int) -> Array:
    """Return the cost of a point in every cell round a centre: `[side, side]` float32, row 0 at the bottom.

    Args:
      xy: `[N, 2]` float32, points of the map, `valid` `[N]` bool.
      centre: `[2]` float32, the middle of the picture.
    """
    cell = jnp.floor((xy - centre) / settings.search_cell_m).astype(jnp.int32) + side // 2
    there = valid & jnp.all((cell >= 0) & (cell < side), axis=1)
    at = jnp.where(there, cell[:, 1] * side + cell[:, 0], side * side)
    cap = jnp.float32(settings.search_cap)
    cost = jnp.full(side * side, cap).at[at].min(0.0, mode="drop").reshape(side, side)
    step = 0.5 * (settings.search_cell_m / settings.search_blur_m) ** 2
    for axis in (0, 1):
        wide = jnp.pad(cost, [(BLUR_CELLS, BLUR_CELLS) if a == axis else (0, 0) for a in (0, 1)], constant_values=cap)
        for k in range(-BLUR_CELLS, BLUR_CELLS + 1):
            cost = jnp.minimum(
                cost, lax.slice_in_dim(wide, BLUR_CELLS + k, BLUR_CELLS + k + side, axis=axis) + step * k * k
            )
    return jnp.minimum(cost, cap)


def draw_map(settings: SlamSettings, points: PointMap, centre: Array, side: int, cells: int) -> Array:
    """Do the same for the points of a map, of `cells` x `cells` of its cells; static, no more than it has."""
    first = jnp.floor(centre / settings.map_cell_m).astype(jnp.int32) - cells // 2
    height, width, _ = points.x.shape
    rows, cols = (first[1] + jnp.arange(cells)) % height, (first[0] + jnp.arange(cells)) % width
    x, y = (a[rows[:, None], cols[None, :]].reshape(-1) for a in (points.x, points.y))
    xy = jnp.stack([x, y], -1)
    return draw_points(settings, xy, jnp.ones(len(xy), bool), centre, side)


def search(settings: SlamSettings, cost: Array, scan: Scan, start: Array, prior: Array, window: Window) -> Found:
    """Find the pose of the least cost in a window round a guess in the middle of the picture.

    The cost of a pose is the mean cost of the scan's points there, and log(1 + d^2 / 2) for a distance of d standard
    deviations from the guess, as one of `points / correlation` measurements: odometry errs seldom, but then by much.

    Args:
      cost: `[S, S]` float32, see `draw_points`; its centre is the guess's place.
      start, prior: guess `[3]` and covariance `[3, 3]`.

    Returns:
      `Found`.

    Source:
      Olson, Real-time correlative scan matching (2009). Changed: a fixed number of coarse steps is searched finely;
      `is_best` tells whether they sufficed.
    """
    cost = jnp.pad(cost, BLOCK, constant_values=settings.search_cap)  # or a block across the edge is no bound
    side, floor_ = cost.shape[0], _block_minima(cost, settings.search_cap)
    cell_m, turn, sd = settings.search_cell_m, jnp.radians(settings.search_turn_deg), jnp.sqrt(jnp.diagonal(prior))
    n = jnp.maximum(jnp.sum(scan.valid), 1)

    def total(picture, row, col):
        inside = (row >= 0) & (row < side) & (col >= 0) & (col < side)
        each = jnp.where(inside, picture.reshape(-1)[jnp.where(inside, row * side + col, 0)], settings.search_cap)
        return jnp.sum(jnp.where(scan.valid, each, 0), axis=-1) / n

    def cells(k):
        cell = jnp.floor(rotated(scan.xy, start[2] + k * turn) / cell_m).astype(jnp.int32) + side // 2
        return cell[..., 1], cell[..., 0]

    def guess(k, up, right):
        off2 = (k * turn / sd[2]) ** 2 + (up * cell_m / sd[1])[:, None] ** 2 + (right * cell_m / sd[0])[None, :] ** 2
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
    at = jnp.argmin(costs)
    apart = jnp.any(jnp.abs(steps - steps[at]) > jnp.array([BLOCK, BLOCK, 2]), axis=1)
    pose = start + steps[at] * jnp.stack([jnp.float32(cell_m), jnp.float32(cell_m), turn])
    others = jnp.where(apart, costs, -least[-1])
    return Found(pose.at[2].set(wrapped(pose[2])), costs[at], jnp.min(others), costs[at] <= -least[-1])


def _block_minima(cost, cap):
    """Return the least cost of the `BLOCK` x `BLOCK` cells from every cell on, up and to the right."""
    side = cost.shape[0]
    for axis in (0, 1):
        for shift in (1, 2):  # doubling: 4 cells
            tail = lax.slice_in_dim(cost, shift, side, axis=axis)
            pad = [(0, shift) if a == axis else (0, 0) for a in (0, 1)]
            cost = jnp.minimum(cost, jnp.pad(tail, pad, constant_values=cap))
    return cost
