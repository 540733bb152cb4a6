"""Points around the robot: the last scan ahead, and behind it those of earlier scans.

The scanner looks ahead; turning, and leaving a narrow place, depend on obstacles abeam and behind. So the nearest point
in every direction is kept while the robot moves on.
"""

import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.arrays import vectorised
from jexplore.btm import wrapped
from jexplore.driving.params.tree import P
from jexplore.driving.records import SECTORS, Surround
from jexplore.driving.settings import Robot
from jexplore.driving.vehicle import ANGLES_RAD, to_robot

DIRECTIONS = 72  # in which the way is looked at
TURN_STEPS = DIRECTIONS // 2  # of half a turn each way

DIRECTION = np.radians(np.arange(DIRECTIONS) * (360 / DIRECTIONS) - 180).astype(np.float32)
_SWEEP = np.radians(np.arange(1, TURN_STEPS + 1) * (180 / TURN_STEPS)).astype(np.float32)


def known_points(around: Surround) -> tuple[Array, Array]:
    """Return `(xy, known)`: `[SECTORS, 2]` float32, metres, 0 where nothing is known; `[SECTORS]` bool."""
    known = jnp.isfinite(around.x_m)
    return jnp.where(known[:, None], jnp.stack([around.x_m, around.y_m], axis=1), 0), known


def move_surround(
    around: Surround, ahead_m: Array, aside_m: Array, turn: Array, *, far_m: Array | float = math.inf
) -> Surround:
    """Return the same points after the robot has moved.

    Args:
      ahead_m, aside_m: how far, in its old frame.
      turn: counter-clockwise, radians.
      far_m: points farther away are forgotten, metres; inf: none.
    """
    xy, known = known_points(around)
    x, y = to_robot(jnp.stack([ahead_m, aside_m, turn]))(xy).T
    known &= x * x + y * y < far_m**2
    return Surround(jnp.where(known, x, jnp.inf), jnp.where(known, y, jnp.inf))


def add_scan(around: Surround, ranges_m: Array) -> Surround:
    """Add one more scan: ahead it replaces everything where its beams gave numbers.

    Args:
      ranges_m: `[181]` float32, beams from -90 to 90 degrees; inf: no return; NaN: no reading.
    """
    xy, known = known_points(around)
    first = SECTORS // 4
    scan = jnp.pad(ranges_m, (first, SECTORS - first - len(ranges_m)), constant_values=jnp.nan)
    fresh = ~jnp.isnan(scan)
    sector = jnp.round(vectorised.arctan2(xy[:, 1], xy[:, 0]) * (SECTORS / (2 * math.pi)) + SECTORS / 2).astype(
        jnp.int32
    )
    sector = jnp.where(known, sector % SECTORS, SECTORS)
    # Of the points that were known the nearest in every direction: distance and number in one integer.
    millimetres = (1000 * jnp.hypot(xy[:, 0], xy[:, 1])).astype(jnp.int32)
    none = np.iinfo(np.int32).max
    code = jnp.full(SECTORS, none).at[sector].min(millimetres * 512 + jnp.arange(SECTORS), mode="drop")
    there = code != none
    at = jnp.where(there, code % 512, 0)
    angle = jnp.asarray(np.pad(ANGLES_RAD, (first, SECTORS - first - len(ANGLES_RAD))))
    returns = jnp.isfinite(scan)
    r = jnp.where(returns, scan, 0)

    def either(function, axis):
        old = jnp.where(there, xy[at, axis], jnp.inf)
        return jnp.where(fresh, jnp.where(returns, r * function(angle), jnp.inf), old)

    return Surround(either(jnp.cos, 0), either(jnp.sin, 1))


def voronoi_edge(around: Surround) -> tuple[Array, Array]:
    """Return the edge of the generalised Voronoi graph between the nearest point and the nearest on the other side.

    Returns:
      `(along, off_m)`: float32, radians, direction of the edge ahead; metres, offset of the edge to the right: half the
        difference of the distances on the right and left.

    Source:
      Choset and Nagatani, Topological simultaneous localization and mapping (2001): tracing an edge.
    """
    xy, known = known_points(around)
    range_m = jnp.hypot(xy[:, 0], xy[:, 1])

    def nearest(side):
        there = jnp.where(known & side, range_m, jnp.inf)
        at = vectorised.argmin(there)
        return there[at], jnp.arctan2(xy[at, 1], xy[at, 0])

    one_m, one = nearest(True)
    # The nearest of another wall lies in quite another direction.
    other_m, other = nearest(xy[:, 0] * jnp.cos(one) + xy[:, 1] * jnp.sin(one) < 0)
    both = jnp.isfinite(one_m) & jnp.isfinite(other_m)
    along = (one + other) / 2  # square to the difference of both directions
    along = wrapped(jnp.where(jnp.cos(along) < 0, along + math.pi, along))
    off_m = jnp.where(jnp.sin(one - along) > 0, 1, -1) * (other_m - one_m) / 2
    return jnp.where(both, along, 0.0), jnp.where(both, off_m, 0.0)


def free_turn(around: Surround, robot: Robot, margin_m: Array | float | None = None) -> tuple[Array, Array]:
    """Compute the angle by which the robot can turn in place before its outline meets a point.

    Args:
      margin_m: kept between wall and outline; None: `sensing.outline_margin_m`.

    Returns:
      `(left, right)`: float32, radians, pi at most.
    """
    margin_m = P.sensing.outline_margin_m if margin_m is None else margin_m
    length, width = robot.length_m / 2 + margin_m, robot.width_m / 2 + margin_m
    xy, known = known_points(around)
    x, y = xy[:, 0], xy[:, 1]
    near = known & (x * x + y * y < length**2 + width**2)
    cos, sin = jnp.cos(_SWEEP)[:, None], jnp.sin(_SWEEP)[:, None]

    def free(sign):
        along, across = x * cos + sign * y * sin, y * cos - sign * x * sin
        meets = jnp.any(near & (jnp.abs(along) < length) & (jnp.abs(across) < width), axis=1)
        return jnp.where(jnp.any(meets), jnp.argmax(meets) * (math.pi / TURN_STEPS), math.pi)

    return free(1), free(-1)


def free_lengths(around: Surround, robot: Robot) -> Array:
    """Compute the free length in every direction of `DIRECTION`, before the robot's front: `[DIRECTIONS]` float32."""
    xy, known = known_points(around)
    x, y = xy[:, 0], xy[:, 1]
    cos, sin = np.cos(DIRECTION)[:, None], np.sin(DIRECTION)[:, None]
    along, aside = x * cos + y * sin, y * cos - x * sin
    meets = known & (along > 0) & (jnp.abs(aside) < robot.width_m / 2 + P.sensing.outline_margin_m)
    return jnp.min(jnp.where(meets, along, jnp.inf), axis=1) - robot.length_m / 2
