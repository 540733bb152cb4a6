"""Candidates that a robot rejects, and the points by which it leaves a place."""

import math

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.driving import links
from jexplore.driving.params.tree import P
from jexplore.driving.records import Arrival, DueNode, Openings, Writer
from jexplore.driving.settings import Tuning
from jexplore.driving.vehicle import rotate_by, towards


def is_rejected(writer: Writer, event: DueNode, measured: tuple[Array, Openings], others: Array, at: Arrival,
              is_divergence: Array, points: tuple[Array, Array], tuning: Tuning) -> tuple[Array, Array]:  # fmt: skip
    """Decide whether to reject a candidate, and which of its openings the robot takes: `(passes, which)`.

    A candidate with two openings in line is a stretch of a passage, unless the link leads to a node there. So is a
    candidate whose only opening lies in line with the way in, if the passage is closed beyond its circle only. A
    candidate with a single opening that lies behind its centre is in the corner of a room.

    Args:
      measured: bearing of the way in, radians, and `Openings` of the place, in the odometry frame.
    """
    back, found = measured
    n, other = jnp.sum(found.valid), jnp.argmax(others)
    straight = jnp.abs(btm.wrapped(found.bearing[other] - back)) > math.pi - P.places.in_line_rad
    followed, to = links.leads_to(writer)
    in_line = (jnp.sum(others) == 1) & straight & ~(at.again & followed & (at.near == to))
    free_m = links.reach_m(points, event.centre, back, event.radius)
    in_line &= (n == 2) | ((n == 1) & (free_m > tuning.circle * event.radius))
    corner = (n == 1) & jnp.any(found.valid & is_behind(found)) & ~at.again
    passes = is_divergence & (in_line | corner)
    return passes, jnp.where(corner, jnp.argmax(found.valid), other)


def beyond_candidate(event: DueNode, measured: tuple[Array, Openings], which: Array, others: Array,
         points: tuple[Array, Array], tuning: Tuning) -> tuple[Array, Array]:  # fmt: skip
    """Return a point beyond a rejected candidate, relative to its centre: `[2]`; and a direction there, radians.

    If the exit is a door of an area beyond its circle, which may be a place itself: straight on, if that is free.
    Arguments as for `is_rejected`; `which`, int32, is its result.
    """
    back, found = measured
    leave_m, on_m, ahead = tuning.leave_m, event.radius + tuning.leave_m, back + math.pi
    far = jnp.any(others) & (jnp.hypot(*found.middle[which]) > tuning.circle * event.radius)
    far &= links.reach_m(points, event.centre, ahead, event.radius) > on_m + leave_m
    target, out = beyond_opening(event, found, found.bearing[which], 0.0, leave_m)
    return jnp.where(far, on_m * towards(ahead), target), jnp.where(far, ahead, out)


def beyond_opening(
    event: DueNode, found: Openings, bearing: Array, turn: Array | float, leave_m: Array | float
) -> tuple[Array, Array]:
    """Return a point beyond the opening in a direction, relative to the centre; straight on where no opening exists.

    Returns:
      `(point, out)`: `[2]`, metres; direction of the opening's passage, radians. `turn` is that of the bearings against
        the odometry, radians; `leave_m` metres.
    """
    off = jnp.where(found.valid, jnp.abs(btm.wrapped(found.bearing - bearing)), jnp.inf)
    which = jnp.argmin(off)
    middle, across = found.middle[which], found.across[which] + turn
    middle = rotate_by(turn)(middle)
    plain = (event.radius + leave_m) * towards(bearing)
    near = (off[which] < math.pi / 4) & ~is_behind(found)[which]
    return jnp.where(near, middle + leave_m * towards(across), plain), jnp.where(near, across, bearing)


def is_behind(found: Openings) -> Array:
    """Return openings whose narrowest place lies behind the centre, so that they have one wall only: `[K]` bool."""
    return found.middle[:, 0] * jnp.cos(found.across) + found.middle[:, 1] * jnp.sin(found.across) < 0
