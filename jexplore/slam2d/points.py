"""The sparse point map of Holz et al.: an unordered point cloud with a minimum distance, and the nearest of its points
for every small cell of a square of the world.
"""

import math
from collections.abc import Callable
from typing import ClassVar, NamedTuple, Self

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays.poses import placed, rotated
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.settings import SlamSettings

CELL = 0.7  # edge of a cell in minimum distances: below 1 / sqrt(2), so that a point is the nearest one in its cell
REACH = 6  # cells in every direction whose nearest point a new one may be
STEPS = 190  # to which a squared distance of 1 cell^2 is rounded: (REACH + 0.5)^2 of them fit above the numbers
NUMBER_BITS = 18  # of a point's number in `near`; its squared distance stands above
NO_POINT = 2**31 - 1
TOGETHER = 32  # points that enter the index at a time
GATE = REACH + 0.5 - 1 / math.sqrt(2)  # cells from a query within which no point is missing


@struct.dataclass
class PointMap:
    """Points within a rectangle of the world, with an index of cells of `CELL` minimum distances."""

    x: Array  # [N] float32, metres
    y: Array  # [N] float32
    normal_x: Array  # [N] float32, of the line through a point, towards the scanner; 0 and 0: on none
    normal_y: Array  # [N] float32
    count: Array  # int32, points
    near: Array  # [H, W] int32, the point nearest to a cell's middle and its distance^2; NO_POINT: none within `REACH`
    centre: Array  # [2] float32, the middle of the rectangle, metres
    overflow: Array  # int32, points within the rectangle for which there was no room
    replace: ClassVar[Callable[..., Self]]


class Partner(NamedTuple):
    """Points of the map, one a query."""

    x: Array  # [B] float32, metres
    y: Array  # [B] float32
    normal_x: Array  # [B] float32
    normal_y: Array  # [B] float32
    d2: Array  # [B] float32, squared distance from the query, m^2; inf without a point


def empty_map(shape: tuple[int, int, int], centre: tuple[float, float] | Array = (0.0, 0.0)) -> PointMap:
    """Return a map without points.

    Args:
      shape: rows and columns of cells, and points that there is room for, at most 2^18. Static.
      centre: of the rectangle that the cells cover, metres; what lies outside is never stored.
    """
    rows, cols, points = shape
    x, y, normal_x, normal_y = (jnp.zeros(points, jnp.float32) for _ in range(4))  # of their own: they may be donated
    return PointMap(
        x, y, normal_x, normal_y, jnp.int32(0), jnp.full((rows, cols), NO_POINT, jnp.int32),
        jnp.array(centre, jnp.float32), jnp.int32(0),
    )  # fmt: skip


def cell_m(settings: SlamSettings) -> Array | float:
    """Return the edge of a cell, metres."""
    return CELL * settings.min_distance_m


def cells_of(settings: SlamSettings, points: PointMap, x: Array, y: Array) -> tuple[Array, Array]:
    """Return rows and columns of places, float32, with a fraction; they may lie outside."""
    height, width = points.near.shape
    per = 1 / cell_m(settings)
    return (y - points.centre[1]) * per + height / 2, (x - points.centre[0]) * per + width / 2


def partners(points: PointMap, row: Array, col: Array, x: Array, y: Array) -> Partner:
    """Return for every query `[B]` the point nearest to the middle of its cell; cells as of `cells_of`.

    That point is at most `CELL` * sqrt(2) minimum distances farther than the nearest one. Outside of the map the cell
    at its edge stands for all.
    """
    height, width = points.near.shape
    row = jnp.clip(row, 0, height - 1).astype(jnp.int32)
    col = jnp.clip(col, 0, width - 1).astype(jnp.int32)
    near = points.near.reshape(-1)[row * width + col]
    at = jnp.minimum(near & (2**NUMBER_BITS - 1), points.x.shape[0] - 1)
    found_x, found_y, normal_x, normal_y = (a[at] for a in (points.x, points.y, points.normal_x, points.normal_y))
    d2 = jnp.where(near == NO_POINT, jnp.inf, (found_x - x) ** 2 + (found_y - y) ** 2)
    return Partner(found_x, found_y, normal_x, normal_y, d2)


def add(settings: SlamSettings, points: PointMap, scan: Scan, pose: Array) -> PointMap:
    """Add the points of a scan that have the minimum distance from all stored ones and from each other.

    Of points of the scan that are too near to each other the one nearer to the scanner is taken first; the order of
    beams does not matter.

    Args:
      pose: `[3]` float32, of the scanner in the map.

    Returns:
      `PointMap`; points that find no room are counted in `overflow`.

    Source:
      Holz et al. 2010, section 2.1.
    """
    xy, normal = placed(pose, scan.xy), rotated(scan.normal, pose[2])
    height, width = points.near.shape
    (row, col), least2 = cells_of(settings, points, xy[:, 0], xy[:, 1]), settings.min_distance_m**2
    inside = scan.valid & (row >= 0) & (row < height) & (col >= 0) & (col < width)
    free = inside
    for up in (-2, -1, 0, 1, 2):  # every stored point is found in its own cell, which is at most two away
        for right in (-2, -1, 0, 1, 2):
            free &= partners(points, row + up, col + right, xy[:, 0], xy[:, 1]).d2 >= least2
    # Ranks, not ranges, are compared: a fused square rounds in two ways, and two points would wait for each other.
    order = jnp.lexsort((scan.xy[:, 1], scan.xy[:, 0], scan.xy[:, 0] ** 2 + scan.xy[:, 1] ** 2))
    rank = jnp.zeros(len(order), jnp.int32).at[order].set(jnp.arange(len(order), dtype=jnp.int32))
    first = rank[None] < rank[:, None]  # [i, j]: j is taken before i
    off = xy[:, None] - xy[None]
    rival = first & (off[..., 0] ** 2 + off[..., 1] ** 2 < least2)

    def choose(state):
        chosen, left = state
        now = left & ~jnp.any(rival & left[None], axis=1)
        return chosen | now, left & ~now & ~jnp.any(rival & now[None], axis=1)

    # Every round takes one at least: the first in rank.
    chosen, _ = lax.while_loop(lambda state: jnp.any(state[1]), choose, (jnp.zeros_like(free), free))
    number = points.count + jnp.sum(chosen[None] & first, axis=1, dtype=jnp.int32)
    size = points.x.shape[0]
    fits = chosen & (number < size)
    n, before = jnp.minimum(points.count + jnp.sum(chosen, dtype=jnp.int32), size), points.count
    at = jnp.where(fits, number, size)

    def stored(old, new):
        return old.at[at].set(new, mode="drop")

    points = points.replace(
        x=stored(points.x, xy[:, 0]),
        y=stored(points.y, xy[:, 1]),
        normal_x=stored(points.normal_x, normal[:, 0]),
        normal_y=stored(points.normal_y, normal[:, 1]),
        count=n,
        overflow=points.overflow + jnp.sum(chosen & ~fits, dtype=jnp.int32),
    )
    return points.replace(near=_near(settings, points, before))


def _near(settings, points, first):
    """Return the index with the points from one number on."""
    height, width = points.near.shape
    offsets = jnp.arange(-REACH, REACH + 1)

    def enter(state):
        near, k = state
        new = k + jnp.arange(TOGETHER)
        row, col = cells_of(settings, points, points.x[new], points.y[new])  # clipped beyond the last, then dropped
        rows = jnp.floor(row).astype(jnp.int32)[:, None, None] + offsets[:, None]
        cols = jnp.floor(col).astype(jnp.int32)[:, None, None] + offsets
        d2 = (rows + 0.5 - row[:, None, None]) ** 2 + (cols + 0.5 - col[:, None, None]) ** 2
        is_there = (new < points.count)[:, None, None] & (d2 < (REACH + 0.5) ** 2)
        is_there &= (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        packed = (d2 * STEPS).astype(jnp.int32) << NUMBER_BITS | new[:, None, None]
        at = jnp.where(is_there, rows * width + cols, height * width)
        return near.reshape(-1).at[at].min(packed, mode="drop").reshape(height, width), k + TOGETHER

    return lax.while_loop(lambda state: state[1] < points.count, enter, (points.near, first))[0]
