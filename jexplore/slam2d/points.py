"""The sparse point map of Holz et al.: an unordered point cloud with a minimum distance, and the nearest of its points
for every small cell of a square of the world.
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple, Self

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays.poses import placed, rotated
from jexplore.native import kernels
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.settings import SlamSettings

CELL = 0.7  # edge of a cell in minimum distances: below 1 / sqrt(2), so that a point is the nearest one in its cell
REACH = 6  # cells in every direction whose nearest point a new one may be
PARTS = 256  # of a cell's edge, in which a place in it is told: whole numbers, which no compiler rounds in two ways
SHARES, MOST_SHARES = 2048, 30_000  # of the minimum distance in which it is kept, and at which a distance is cut off
STEPS = 190  # to which a squared distance of 1 cell^2 is rounded: (REACH + 0.5)^2 of them fit above the numbers
NUMBER_BITS = 18  # of a point's number in `near`; its squared distance stands above
NO_POINT = 2**31 - 1
TOGETHER = 32  # points that enter the index at a time


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
    native: str | None = struct.field(pytree_node=False, default=None)  # target of native kernels; None: JAX does it
    replace: ClassVar[Callable[..., Self]]


class New(NamedTuple):
    """Points of a scan that may enter a map."""

    x: Array  # [B] float32, metres
    y: Array  # [B] float32
    normal_x: Array  # [B] float32
    normal_y: Array  # [B] float32
    row: Array  # [B] int32, in parts of a cell
    col: Array  # [B] int32
    inside: Array  # [B] bool, whether the point lies in the rectangle
    scan_x: Array  # [B] float32, in the scanner's frame
    scan_y: Array  # [B] float32
    far2: Array  # [B] float32, squared distance from the scanner


class Partner(NamedTuple):
    """Points of the map, one a query."""

    x: Array  # [B] float32, metres
    y: Array  # [B] float32
    normal_x: Array  # [B] float32
    normal_y: Array  # [B] float32
    d2: Array  # [B] float32, squared distance from the query, m^2; inf without a point


def empty_map(
    shape: tuple[int, int, int], centre: tuple[float, float] | Array = (0.0, 0.0), native: str | None = None
) -> PointMap:
    """Return a map without points.

    Args:
      shape: rows and columns of cells, and points that there is room for, at most 2^18. Static.
      centre: of the rectangle that the cells cover, metres; what lies outside is never stored.
      native: target of native kernels that add points, with the same result; None: JAX does it. Static.
    """
    rows, cols, points = shape
    x, y, normal_x, normal_y = (jnp.zeros(points, jnp.float32) for _ in range(4))  # of their own: they may be donated
    return PointMap(
        x, y, normal_x, normal_y, jnp.int32(0), jnp.full((rows, cols), NO_POINT, jnp.int32),
        jnp.array(centre, jnp.float32), jnp.int32(0), native,
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
    row, col = (jnp.floor(a * PARTS).astype(jnp.int32) for a in cells_of(settings, points, xy[:, 0], xy[:, 1]))
    inside = scan.valid & (row >= 0) & (row < height * PARTS) & (col >= 0) & (col < width * PARTS)
    far2, scale = scan.xy[:, 0] ** 2 + scan.xy[:, 1] ** 2, jnp.float32(SHARES / settings.min_distance_m)
    (x, y), (normal_x, normal_y), (own_x, own_y) = (jnp.unstack(a, axis=1) for a in (xy, normal, scan.xy))
    new = New(x, y, normal_x, normal_y, row, col, inside, own_x, own_y, far2)
    native = kernels.target_of(points.native)
    if native is not None:
        names = "x", "y", "normal_x", "normal_y", "near"
        given_up = *(getattr(points, name) for name in names), kernels.numbers([points.count, points.overflow])
        terms = jnp.stack([*new[:4], own_x, own_y, far2]), jnp.stack([row, col]), inside, scale
        results = [(a.shape, a.dtype) for a in given_up]
        *maps, told = kernels.call(native, "enter", results, *given_up, *terms, in_place=len(given_up))
        return points.replace(**dict(zip(names, maps)), count=told[0], overflow=told[1])
    chosen, first = _chosen(points, new, scale)
    number = points.count + jnp.sum(chosen[None] & first, axis=1, dtype=jnp.int32)
    size = points.x.shape[0]
    fits = chosen & (number < size)
    at = jnp.where(fits, number, size)
    more = {name: getattr(points, name).at[at].set(getattr(new, name), mode="drop") for name in New._fields[:4]}
    near = _near(points.near, new, at, size)
    count = jnp.minimum(points.count + jnp.sum(chosen, dtype=jnp.int32), size)
    overflow = points.overflow + jnp.sum(chosen & ~fits, dtype=jnp.int32)
    return points.replace(**more, near=near, count=count, overflow=overflow)


def _is_near(scale, x, y, other_x, other_y):
    """Return whether points are nearer to each other than the minimum distance, counted in whole shares: bool."""
    dx, dy = (
        jnp.minimum(jnp.abs(jnp.round(a * scale) - jnp.round(b * scale)), MOST_SHARES).astype(jnp.int32)
        for a, b in ((x, other_x), (y, other_y))
    )
    return dx * dx + dy * dy < SHARES**2


def _chosen(points, new, scale):
    """Return which points of a scan enter the map, `[B]`, and which is taken before which: `[B, B]` bool."""
    height, width = points.near.shape
    row, col, free = new.row // PARTS, new.col // PARTS, new.inside
    for up in (-2, -1, 0, 1, 2):  # every stored point is found in its own cell, which is at most two away
        for right in (-2, -1, 0, 1, 2):
            cell = jnp.clip(row + up, 0, height - 1) * width + jnp.clip(col + right, 0, width - 1)
            near = points.near.reshape(-1)[cell]
            at = jnp.minimum(near & (2**NUMBER_BITS - 1), points.x.shape[0] - 1)
            free &= (near == NO_POINT) | ~_is_near(scale, new.x, new.y, points.x[at], points.y[at])
    # Ranks, not ranges, are compared: a fused square rounds in two ways, and two points would wait for each other.
    order = jnp.lexsort((new.scan_y, new.scan_x, new.far2))
    rank = jnp.zeros(len(order), jnp.int32).at[order].set(jnp.arange(len(order), dtype=jnp.int32))
    first = rank[None] < rank[:, None]  # [i, j]: j is taken before i
    rival = first & _is_near(scale, new.x[:, None], new.y[:, None], new.x, new.y)

    def choose(state):
        chosen, left = state
        now = left & ~jnp.any(rival & left[None], axis=1)
        return chosen | now, left & ~now & ~jnp.any(rival & now[None], axis=1)

    # Every round takes one at least: the first in rank.
    chosen, _ = lax.while_loop(lambda state: jnp.any(state[1]), choose, (jnp.zeros_like(free), free))
    return chosen, first


def _near(near, new, at, size):
    """Return the index with points of a scan, `TOGETHER` at a time; `at`: their numbers, `size`: none."""
    height, width = near.shape
    offsets = jnp.arange(-REACH, REACH + 1)
    which = jnp.argsort(at >= size)  # those that enter first; stable
    which = jnp.pad(which, (0, -len(which) % TOGETHER), constant_values=len(which))  # clipped, then dropped

    def enter(state):
        near, k = state
        now = lax.dynamic_slice_in_dim(which, k, TOGETHER)
        number = at.at[now].get(mode="fill", fill_value=size)[:, None, None]
        own_row, own_col = new.row[now][:, None, None], new.col[now][:, None, None]
        rows = own_row // PARTS + offsets[:, None]
        cols = own_col // PARTS + offsets
        d2 = (rows * PARTS + PARTS // 2 - own_row) ** 2 + (cols * PARTS + PARTS // 2 - own_col) ** 2
        is_there = (number < size) & (d2 < (REACH + 0.5) ** 2 * PARTS**2)
        is_there &= (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        packed = (d2 * STEPS // PARTS**2) << NUMBER_BITS | number
        cell = jnp.where(is_there, rows * width + cols, height * width)
        return near.reshape(-1).at[cell].min(packed, mode="drop").reshape(height, width), k + TOGETHER

    n = jnp.sum(at < size)
    return lax.while_loop(lambda state: state[1] < n, enter, (near, jnp.int32(0)))[0]
