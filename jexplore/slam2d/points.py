"""The sparse point map of Holz et al.: an unordered point cloud with a minimum distance, in cells of fixed size."""

from typing import NamedTuple

import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays.poses import placed, rotated
from jexplore.slam2d.scans import Scan
from jexplore.slam2d.settings import SlamSettings

FAR_M = 1e6  # coordinates of an empty slot


@struct.dataclass
class PointMap:
    """Points in a grid of cells that repeats itself: cell (row, col) stands at (row % H, col % W).

    Points a whole period apart share a cell and are told apart by their coordinates; they only share its slots.
    """

    x: Array  # [H, W, K] float32, metres; `FAR_M` in an empty slot
    y: Array  # [H, W, K] float32
    normal_x: Array  # [H, W, K] float32, of the line through a point, towards the scanner; 0 and 0: on none
    normal_y: Array  # [H, W, K] float32
    count: Array  # [H, W] int32, slots in use
    overflow: Array  # int32, points that found no slot


class Near(NamedTuple):
    """Slots of the 3 x 3 cells round some queries."""

    at: Array  # [B, 9 K] int32, flat slot
    x: Array  # [B, 9 K] float32, metres
    y: Array  # [B, 9 K] float32


class Partner(NamedTuple):
    """Points of the map nearest to queries."""

    xy: Array  # [B, 2] float32
    normal: Array  # [B, 2] float32
    d2: Array  # [B] float32, squared distance, m^2; huge without a point


def empty_map(shape: tuple[int, int, int]) -> PointMap:
    """Return a map without points; `shape`: rows, columns, slots a cell. Static, rows and columns at least 3."""
    x, y = (jnp.full(shape, FAR_M, jnp.float32) for _ in range(2))  # arrays of their own: they may be donated
    normal_x, normal_y = (jnp.zeros(shape, jnp.float32) for _ in range(2))
    return PointMap(x, y, normal_x, normal_y, jnp.zeros(shape[:2], jnp.int32), jnp.zeros((), jnp.int32))


def cell_of(points: PointMap, xy: Array, cell_m: Array | float) -> tuple[Array, Array]:
    """Return row and column of the cells of points `[..., 2]`."""
    cell = jnp.floor(xy / cell_m).astype(jnp.int32)
    return cell[..., 1] % points.count.shape[0], cell[..., 0] % points.count.shape[1]


def near_slots(settings: SlamSettings, points: PointMap, xy: Array) -> Near:
    """Return the slots round queries `[B, 2]`: no point within `map_cell_m` is missing."""
    row, col = cell_of(points, xy, settings.map_cell_m)
    height, width, slots = points.x.shape
    rows = (row[:, None] + jnp.array([-1, 0, 1])) % height
    cols = (col[:, None] + jnp.array([-1, 0, 1])) % width
    cells = (rows[:, :, None] * width + cols[:, None, :]).reshape(len(xy), 9, 1)
    at = (cells * slots + jnp.arange(slots)).reshape(len(xy), 9 * slots)
    return Near(at, points.x.reshape(-1)[at], points.y.reshape(-1)[at])


def nearest(points: PointMap, near: Near, xy: Array) -> Partner:
    """Find the nearest point of every query `[B, 2]` among its slots; of equal ones that in the lowest slot."""
    d2 = (near.x - xy[:, :1]) ** 2 + (near.y - xy[:, 1:]) ** 2
    least = jnp.min(d2, axis=1)
    # Not argmin, which a CPU takes element by element: measured, twice the time.
    best = jnp.min(jnp.where(d2 == least[:, None], near.at, points.x.size - 1), axis=1)
    x, y, normal_x, normal_y = (a.reshape(-1)[best] for a in (points.x, points.y, points.normal_x, points.normal_y))
    return Partner(jnp.stack([x, y], -1), jnp.stack([normal_x, normal_y], -1), least)


def add(settings: SlamSettings, points: PointMap, scan: Scan, pose: Array) -> PointMap:
    """Add the points of a scan that have the minimum distance from all stored ones and from each other.

    Of points of the scan that are too near to each other the one nearer to the scanner is taken first; the order of
    beams does not matter.

    Args:
      pose: `[3]` float32, of the scanner in the map.

    Returns:
      `PointMap`; points that find no slot are counted in `overflow`.

    Source:
      Holz et al. 2010, section 2.1.
    """
    xy, normal = placed(pose, scan.xy), rotated(scan.normal, pose[2])
    free = scan.valid & (nearest(points, near_slots(settings, points, xy), xy).d2 >= settings.min_distance_m**2)
    # Ranks, not ranges, are compared: a fused square rounds in two ways, and two points would wait for each other.
    order = jnp.lexsort((scan.xy[:, 1], scan.xy[:, 0], scan.xy[:, 0] ** 2 + scan.xy[:, 1] ** 2))
    rank = jnp.zeros(len(order), jnp.int32).at[order].set(jnp.arange(len(order), dtype=jnp.int32))
    first = rank[None] < rank[:, None]  # [i, j]: j is taken before i
    off = xy[:, None] - xy[None]
    rival = first & (off[..., 0] ** 2 + off[..., 1] ** 2 < settings.min_distance_m**2)

    def choose(state):
        chosen, left = state
        now = left & ~jnp.any(rival & left[None], axis=1)
        return chosen | now, left & ~now & ~jnp.any(rival & now[None], axis=1)

    # Every round takes one at least: the first in rank.
    chosen, _ = lax.while_loop(lambda state: jnp.any(state[1]), choose, (jnp.zeros_like(free), free))
    row, col = cell_of(points, xy, settings.map_cell_m)
    height, width, slots = points.x.shape
    at = row * width + col
    before = jnp.sum(chosen[None] & first & (at[None] == at[:, None]), axis=1)
    slot = points.count.reshape(-1)[at] + before
    fits = chosen & (slot < slots)
    flat = jnp.where(fits, at * slots + slot, height * width * slots)

    def stored(old, new):
        return old.reshape(-1).at[flat].set(new, mode="drop").reshape(old.shape)

    return PointMap(
        stored(points.x, xy[:, 0]),
        stored(points.y, xy[:, 1]),
        stored(points.normal_x, normal[:, 0]),
        stored(points.normal_y, normal[:, 1]),
        points.count.at[row, col].add(fits),
        points.overflow + jnp.sum(chosen & ~fits, dtype=jnp.int32),
    )
