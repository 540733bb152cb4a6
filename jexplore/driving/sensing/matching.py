"""Motion of the robot by scan matching, point to line.

Tracks slip where they turn, and encoders do not notice; walls stay where they are.
"""

import math

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import pick, run_if
from jexplore.driving.params.tree import P
from jexplore.driving.records import KeyScan
from jexplore.driving.vehicle import ANGLES_RAD, BEAMS, to_odometry, to_robot
from jexplore.slam2d.matching import inverted
from jexplore.slam2d.scans import fit_lines
from jexplore.slam2d.settings import SlamSettings

MATCH = SlamSettings(way_m=0.01, turn_deg=0.5, turn_share=0.1, min_share=0.6)
"""Tracks slip by up to two fifths of a turn (four standard deviations), and otherwise err by less than a rolling base.
At 5 cm of range noise 96 % of the maps are true (`benchmarks/btm.py --parts sensors`), 90 % with the defaults of way
and turn. At a slip of two fifths all are (`benchmarks/drift.py`), none with the default share of turns. A scan with a
smaller share of matched points than `min_share` becomes the reference; bounds of way and turn add drift."""
ROUNDS = 6  # of a match


def _ends(ranges_m):
    """Return the ends of a scan's beams: `(x, y, valid)`, `[B]` each, 0 where invalid."""
    valid = jnp.isfinite(ranges_m)
    r = jnp.where(valid, ranges_m, 0)
    return r * jnp.cos(ANGLES_RAD), r * jnp.sin(ANGLES_RAD), valid


def match_scans(before_m: Array, ranges_m: Array, moved: Array, since: Array) -> tuple[Array, Array]:
    """Estimate the motion between two scans.

    Args:
      before_m, ranges_m: `[B]` float32, the first scan and the last one; inf: no return; NaN: no reading.
      moved: `[3]` float32, predicted motion: x, y, metres, and turn, radians, in the frame of the first.
      since: `[3]` float32, the part of `moved` by encoders alone.

    Returns:
      `(found, share)`: `[3]` float32, motion that brings the points of the last scan nearest to lines of the first,
        close to `moved`; `moved` itself where too few points match or the result is far from it; float32, share of
        matched points, then 0.

    Source:
      Censi, An ICP variant using a point-to-line metric (2008). Changed: beams find their partners by their bearing.
    """
    (mean_x, mean_y), (normal_x, normal_y), there = fit_lines(MATCH, *_ends(before_m))
    x, y, valid = _ends(ranges_m)
    way, turn = jnp.hypot(since[0], since[1]), jnp.abs(since[2])
    place_sd = MATCH.way_m + MATCH.way_share * way
    turn_sd = MATCH.turn_share * turn + math.radians(1) * (MATCH.turn_deg + MATCH.turn_deg_m * way)
    sd = jnp.stack([place_sd, place_sd, turn_sd])
    prior = 1 / sd**2

    def nearer(i, carry):
        found, _ = carry
        cos, sin = jnp.cos(found[2]), jnp.sin(found[2])
        px, py = found[0] + cos * x - sin * y, found[1] + sin * x + cos * y
        beam = jnp.round((jnp.arctan2(py, px) + math.pi / 2) * ((BEAMS - 1) / math.pi)).astype(jnp.int32)
        at = jnp.clip(beam, 0, BEAMS - 1)
        nx, ny = normal_x[at], normal_y[at]
        off = nx * (px - mean_x[at]) + ny * (py - mean_y[at])
        counts = valid & there[at] & (beam == at) & (jnp.abs(off) < jnp.where(i < 2, MATCH.gate_m, MATCH.fine_gate_m))
        weight = jnp.where(counts, 1 / MATCH.noise_m**2, 0)
        by_turn = nx * (-sin * x - cos * y) + ny * (cos * x - sin * y)
        rows = jnp.stack([nx, ny, by_turn])
        matrix = (rows * weight) @ rows.T + jnp.diag(prior)
        vector = -(rows * weight) @ off + prior * (moved - found)
        n = jnp.sum(counts)
        return jnp.where(n >= MATCH.min_points, found + inverted(matrix) @ vector, found), n

    found, n = lax.fori_loop(0, ROUNDS, nearer, (moved, jnp.int32(0)))
    sure = (n >= MATCH.min_points) & jnp.all(jnp.abs(found - moved) < MATCH.max_deviations * sd)
    return jnp.where(sure, found, moved), jnp.where(sure, n / jnp.maximum(jnp.sum(valid), 1), 0.0)


def no_key(pose: Array) -> KeyScan:
    """Return a state without a scan; the first one becomes it. `pose`: `[3]`."""
    far = pose + jnp.array([0.0, 0.0, 10.0])
    return KeyScan(jnp.full(BEAMS, jnp.nan), jnp.zeros(2), far, far)


def relative_pose(one: Array, other: Array) -> Array:
    """Return the second pose in the frame of the first: `[3]`."""
    return jnp.stack([*to_robot(one)(other[:2]), other[2] - one[2]])


def correct_odometry(
    key: KeyScan, odometry: Array, estimate: Array, ranges_m: Array, lean: Array
) -> tuple[KeyScan, Array, Array]:
    """Correct both poses, without and with corrections at nodes, by scan matching, if the robot has moved on.

    A scan serves for as long as `min_share` of each new one matches it: every change to another adds an error.

    Args:
      lean: `[2]` float32, radians, of the ground, see `mapping.slope_under`; a scan is not matched with one of another
        plane, nor where the robot leans much.

    Returns:
      `(key, odometry, estimate)`: both poses are moved alike.
    """
    since = relative_pose(key.last, odometry)
    is_due = (jnp.hypot(since[0], since[1]) >= P.sensing.every_m) | (jnp.abs(since[2]) >= P.sensing.every_rad)

    def right(carry):
        key, odometry, estimate = carry
        moved = relative_pose(key.pose, odometry)
        found, share = match_scans(key.ranges_m, ranges_m, moved, since)
        in_plane = (jnp.hypot(*(lean - key.lean)) < P.sensing.plane_rad) & (jnp.hypot(*lean) < P.sensing.tilt_rad)
        found, share = jnp.where(in_plane, found, moved), jnp.where(in_plane, share, 0.0)
        after = jnp.concatenate([to_odometry(key.pose)(found[:2]), key.pose[2:] + found[2:]])
        step, turn = to_robot(odometry)(after[:2]), after[2] - odometry[2]
        estimate = jnp.concatenate([to_odometry(estimate)(step), estimate[2:] + turn])
        fresh = KeyScan(ranges_m, lean, after, after)
        old = key.replace(last=after)
        return pick(share < MATCH.min_share, fresh, old), after, estimate

    return run_if(is_due, right, (key, odometry, estimate))
