"""How far the robot has moved, by what it sees: two scans laid over each other, point to line.

Tracks slip where they turn, and encoders do not notice; walls stay where they are.
"""

import math

import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import run_if
from jexplore.driving.vehicle import ANGLES_RAD, BEAMS, to_odometry, to_robot

KEY_M, KEY_RAD = 0.2, 0.25  # scans are matched after so much way or turn
NEIGHBOURS = 5  # beams on either side through whose points a line is laid
REACH_M = 0.3  # as far as they are this near
EVEN = 0.04  # a line is even across which its points vary by no more than this share of along it
ROUNDS = 6
GATE_M = 0.3, 0.1  # a point farther from its line than this counts not, in the first round and from the third on
RANGE_SD_M = 0.03  # of a point from its line
DOUBT = 0.1  # of way and turn: standard deviation of what the encoders say, beside
DOUBT_M, DOUBT_RAD = 0.01, math.radians(0.5)  # these
LEAST = 30  # points that must lie on lines


def _lines(ranges_m):
    """A line through every point of a scan and its neighbours: `(mean, normal, there)`."""
    valid = jnp.isfinite(ranges_m)
    r = jnp.where(valid, ranges_m, 0)
    x, y = r * jnp.cos(ANGLES_RAD), r * jnp.sin(ANGLES_RAD)
    wide = [jnp.pad(a, NEIGHBOURS) for a in (x, y)]
    known = jnp.pad(valid, NEIGHBOURS)
    n = ranges_m.shape[0]
    moments = [jnp.zeros(n)] * 6
    for k in range(2 * NEIGHBOURS + 1):
        dx, dy = wide[0][k : k + n] - x, wide[1][k : k + n] - y
        weight = (known[k : k + n] & valid & (dx * dx + dy * dy < REACH_M**2)).astype(jnp.float32)
        terms = weight, weight * dx, weight * dy, weight * dx * dx, weight * dx * dy, weight * dy * dy
        moments = [total + term for total, term in zip(moments, terms)]
    count, sx, sy, sxx, sxy, syy = moments
    per = 1 / jnp.maximum(count, 1)
    mx, my = sx * per, sy * per
    cxx, cxy, cyy = sxx * per - mx * mx, sxy * per - mx * my, syy * per - my * my
    half, root = (cxx + cyy) / 2, jnp.hypot((cxx - cyy) / 2, cxy)
    along = 0.5 * jnp.arctan2(2 * cxy, cxx - cyy)
    there = valid & (count >= NEIGHBOURS) & (half - root < EVEN * (half + root))
    return (x + mx, y + my), (-jnp.sin(along), jnp.cos(along)), there


def match(before_m: Array, ranges_m: Array, moved: Array) -> Array:
    """Motion between two scans.

    Args:
      before_m, ranges_m: `[B]` float32, the first scan and the last one; inf: no return; NaN: no reading.
      moved: `[3]` float32, what the encoders say: x, y, metres, and turn, radians, in the frame of the first.

    Returns:
      `[3]` float32, likewise, where the points of the last scan lie nearest to lines of the first, not far from what
      the encoders say; that itself where too few points lie on lines.

    Source:
      Censi, An ICP variant using a point-to-line metric (2008). Changed: beams find their partners by their bearing.
    """
    (mean_x, mean_y), (normal_x, normal_y), there = _lines(before_m)
    valid = jnp.isfinite(ranges_m)
    r = jnp.where(valid, ranges_m, 0)
    x, y = r * jnp.cos(ANGLES_RAD), r * jnp.sin(ANGLES_RAD)
    way, turn = jnp.hypot(moved[0], moved[1]), jnp.abs(moved[2])
    sd = jnp.stack([DOUBT_M + DOUBT * way, DOUBT_M + DOUBT * way, DOUBT_RAD + DOUBT * turn])
    prior = 1 / sd**2
    found = moved
    for i in range(ROUNDS):
        cos, sin = jnp.cos(found[2]), jnp.sin(found[2])
        px, py = found[0] + cos * x - sin * y, found[1] + sin * x + cos * y
        beam = jnp.round((jnp.arctan2(py, px) + math.pi / 2) * ((BEAMS - 1) / math.pi)).astype(jnp.int32)
        at = jnp.clip(beam, 0, BEAMS - 1)
        nx, ny = normal_x[at], normal_y[at]
        off = nx * (px - mean_x[at]) + ny * (py - mean_y[at])
        counts = valid & there[at] & (beam == at) & (jnp.abs(off) < GATE_M[0 if i < 2 else 1])
        weight = jnp.where(counts, 1 / RANGE_SD_M**2, 0)
        by_turn = nx * (-sin * x - cos * y) + ny * (cos * x - sin * y)
        rows = jnp.stack([nx, ny, by_turn])
        matrix = (rows * weight) @ rows.T + jnp.diag(prior)
        vector = -(rows * weight) @ off + prior * (moved - found)
        step = _solved(matrix, vector)
        found = jnp.where(jnp.sum(counts) >= LEAST, found + step, found)
    return found


def _solved(a, b):
    """The solution of three equations whose matrix is symmetric and positive: `[3]`."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] ** 2
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    per = 1 / (a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02)
    c11, c12 = a[0, 0] * a[2, 2] - a[0, 2] ** 2, a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    c22 = a[0, 0] * a[1, 1] - a[0, 1] ** 2
    rows = jnp.stack([jnp.stack([c00, c01, c02]), jnp.stack([c01, c11, c12]), jnp.stack([c02, c12, c22])])
    return rows @ b * per


def put_right(
    key_m: Array, key_pose: Array, odometry: Array, estimate: Array, ranges_m: Array
) -> tuple[Array, Array, Array, Array]:
    """Puts the odometry right by what the robot sees, where it has moved on since the last time.

    Args:
      key_m, key_pose: `[B]` scan of the last time; `[3]`, where it was taken, odometry without corrections at nodes.
      odometry, estimate: `[3]`, poses without and with these.
      ranges_m: `[B]` float32, the last scan.

    Returns:
      `(key_m, key_pose, odometry, estimate)`: the last scan, if it was matched, and both poses moved alike.
    """
    moved = jnp.stack([*to_robot(key_pose)(odometry[:2]), odometry[2] - key_pose[2]])
    is_due = (jnp.hypot(moved[0], moved[1]) >= KEY_M) | (jnp.abs(moved[2]) >= KEY_RAD)

    def right(carry):
        _, key, odometry, estimate = carry
        found = match(key_m, ranges_m, moved)
        after = jnp.concatenate([to_odometry(key)(found[:2]), key[2:] + found[2:]])
        step, turn = to_robot(odometry)(after[:2]), after[2] - odometry[2]
        return ranges_m, after, after, jnp.concatenate([to_odometry(estimate)(step), estimate[2:] + turn])

    return run_if(is_due, right, (key_m, key_pose, odometry, estimate))
