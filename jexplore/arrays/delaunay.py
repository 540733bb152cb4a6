"""Delaunay triangles of a few points, all at once: every edge looks at every point."""

import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits

NO_POINT = np.int32(2**31 - 1)  # the key of no point
ROW = 64  # triangle slots per row of the search
BETWEEN = -1e30  # a cotangent below all


@struct.dataclass
class Triangles:
    """T = 2 n triangles: n points have fewer than that, unless many of them lie on one circle."""

    corner: Array  # [T, 3] int32, points, ascending
    valid: Array  # [T] bool
    overflow: Array  # int32, triangles that did not fit


def _ordered(values):
    """Return float32 as int32 of the same order."""
    bits = lax.bitcast_convert_type(values, jnp.int32)
    return jnp.where(bits < 0, bits ^ 0x7FFFFFFF, bits)


def delaunay(points: Array, valid: Array) -> Triangles:
    """Compute the Delaunay triangulation.

    On each side of a pair of points the apex is the point that sees them under the largest angle; the pair is an edge
    if both angles together are at most 180 degrees. Of points on one circle all triangles may be valid.

    Args:
      points: `[n, 2]` float32, n from 2 to 256.
      valid: `[n]` bool, points that are there. Those that are must differ.

    Raises:
      ValueError: while tracing, if n is out of bounds.

    Source:
      Delaunay 1934: the empty circle, by the opposite angles of the two triangles at an edge.
    """
    n = points.shape[0]
    if not 2 <= n <= 256:
        raise ValueError(f"expected 2 to 256 points, got {n}")
    first, second = np.triu_indices(n, 1)
    x, y = points[:, 0], points[:, 1]
    apex, there, broken = _apexes(x, y, valid, first, second)

    def cot(k):
        px, py = x[jnp.minimum(k, n - 1)], y[jnp.minimum(k, n - 1)]
        cross = (x[first] - px) * (y[second] - py) - (y[first] - py) * (x[second] - px)
        dot = (x[first] - px) * (x[second] - px) + (y[first] - py) * (y[second] - py)
        return dot / jnp.where(cross == 0, 1, jnp.abs(cross))

    left, right = cot(apex[0]), cot(apex[1])
    both = there[0] & there[1]
    edge = valid[first] & valid[second] & ~broken & (~both | (left + right >= -1e-4 * (jnp.abs(left) + jnp.abs(right))))
    # Each triangle has three edges: it is taken from the one between its two first corners.
    keep = (there & edge & (apex > second)).reshape(-1)
    rows = -(-keep.shape[0] // ROW)
    mask = jnp.pad(keep, (0, rows * ROW - keep.shape[0])).reshape(rows, ROW)
    which = bits.first_cells(bits.pack(mask), 2 * n)
    which = lax.optimization_barrier(which)  # else every use of a corner looks for its triangle anew
    found = which < keep.shape[0]
    which = jnp.where(found, which, 0)
    pair = which % len(first)
    corner = jnp.stack([jnp.asarray(first)[pair], jnp.asarray(second)[pair], apex.reshape(-1)[which]], axis=1)
    return Triangles(
        corner=jnp.where(found[:, None], corner, 0).astype(jnp.int32),
        valid=found,
        overflow=jnp.maximum(jnp.sum(keep, dtype=jnp.int32) - 2 * n, 0),
    )


def circumcircles(points: Array, corner: Array) -> tuple[Array, Array, Array]:
    """Compute circles through three points each: `points` `[n, 2]` float32, `corner` `[T, 3]` int32.

    Returns `(centre, radius, side2)`: `[T, 2]` and `[T]` float32; and `[T, 3]`, squared lengths of the sides opposite
    to the corners. A triangle without area has a radius of inf.
    """
    a, b, c = (points[jnp.minimum(corner[:, i], points.shape[0] - 1)] for i in range(3))
    side2 = jnp.stack([jnp.sum((p - q) ** 2, axis=1) for p, q in ((b, c), (c, a), (a, b))], axis=1)
    u, v = b - a, c - a
    doubled = 2 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    flat = doubled == 0
    per = 1 / jnp.where(flat, 1, doubled)
    to_x = (v[:, 1] * side2[:, 2] - u[:, 1] * side2[:, 1]) * per
    to_y = (u[:, 0] * side2[:, 1] - v[:, 0] * side2[:, 2]) * per
    radius = jnp.where(flat, jnp.inf, jnp.hypot(to_x, to_y))
    return a + jnp.stack([to_x, to_y], axis=1), radius, side2


def _apexes(x, y, valid, first, second):
    """Find the points that see every pair under the largest angle, on either side: `[2, E]` numbers, and whether valid.

    The last of the results, `[E]` bool, tells of a point on the straight line between both.
    """
    n = x.shape[0]
    codes = 1 << max(n - 1, 1).bit_length()
    # Point k's cotangent of the angle under which it sees the pair, and the side on which it lies: [n, E], so that the
    # minimum over k runs along rows, which a CPU does many at a time.
    x1, y1, x2, y2 = lax.optimization_barrier((x[first], y[first], x[second], y[second]))
    ax, ay = x1 - x[:, None], y1 - y[:, None]
    bx, by = x2 - x[:, None], y2 - y[:, None]
    cross, dot = ax * by - ay * bx, ax * bx + ay * by
    between = (cross == 0) & (dot < 0)  # on the straight line between both: the pair is no edge
    here = valid[:, None] & ((cross != 0) | between)
    cotangent = jnp.where(between, BETWEEN, dot / jnp.where(cross == 0, 1, jnp.abs(cross)))
    # The last bits of a cotangent give way to the number of its point, so that one minimum finds both (of 64 points 16
    # bits of its fraction are left, of 256 14); one more to the side, so that both sides fit in one array: on the right
    # the least is the largest negative one.
    key = (_ordered(cotangent) >> 1) + (1 << 30) & ~(codes - 1) | jnp.arange(n, dtype=jnp.int32)[:, None]
    keys = jnp.where(here, jnp.where(cross >= 0, key, ~key), NO_POINT)
    left, right = (
        jnp.min(jnp.where(keys >= 0, keys, NO_POINT), axis=0),
        ~jnp.max(jnp.where(keys < 0, keys, ~NO_POINT), axis=0),
    )
    sides = jnp.stack([left, right])
    apex, there = sides & (codes - 1), sides != NO_POINT
    return apex, there, left < (_ordered(jnp.float32(BETWEEN / 2)) >> 1) + (1 << 30)
