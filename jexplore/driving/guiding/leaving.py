"""Candidates that a robot rejects, and the links and points by which it leaves a place."""

import dataclasses
import functools
import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.btm import Btm
from jexplore.driving import links
from jexplore.driving.guiding.guide import is_next, match_place
from jexplore.driving.params.tree import P
from jexplore.driving.records import Arrival, DueNode, Guide, Onward, Openings, Writer
from jexplore.driving.settings import Tuning
from jexplore.driving.vehicle import rotate_by, to_odometry, towards


class Left(NamedTuple):
    """Direction and link by which a robot leaves a place."""

    guide: Guide | None
    map: Btm
    link: Array  # int32
    bearing: Array  # float32, radians, of the link there
    onward: Onward | None  # what the route says: radians and metres, turned as the map's node has them


def leave_place(
    map_: Btm,
    writer: Writer,
    event: DueNode,
    node: Array,
    found: Openings,
    is_place: Array,
    points: tuple[Array, Array],
    usual: tuple[Array, Array],
    turned: tuple[Array, Array],
) -> Left:
    """Choose where a robot that follows a route goes on.

    If no link leads there, a new one is made if the way is open or free; if no exit at all leads that way, the robot
    steers for the next place.

    Args:
      is_place: bool, whether it is a divergence.
      usual: `(link, bearing)`: int32, link chosen without a route; float32, its bearing in the node's frame, radians.
      turned: `(turn, correction)`: float32, rotation of the node's bearings (also of `found` and `usual`) against the
        odometry in which they were measured, radians; `[3]` float32, correction of the odometry by a share of that
        turn, metres and radians, see `correct_guide`.

    Returns:
      `Left`; without a route, the given values. `onward` is the guide's, turned by `turn` about `event.centre`;
        `is_free`: the new link starts at no opening.
    """
    (onto, bearing), (turn, shift) = usual, turned
    if writer.guide is None:
        return Left(None, map_, onto, bearing, None)
    free_m = functools.partial(links.reach_m, points, width_m=P.route.strip_m)
    measured = dataclasses.replace(found, bearing=found.bearing - turn)
    ahead, way = match_place(writer.guide, event.odometer_m, event.centre, measured, is_place, free_m)
    to_node = to_odometry(jnp.append(event.centre, turn))
    way = way._replace(bearing=way.bearing + turn, middle=to_node(way.middle - event.centre))
    ahead = ahead.replace(from_xy=ahead.from_xy + shift)
    link, out, off = links.link_toward(map_, node, way.bearing)
    is_open = jnp.any(found.valid & (jnp.abs(btm.wrapped(found.bearing - way.bearing)) < P.places.same_exit_rad))
    there = jnp.isfinite(off)
    link, out = jnp.where(there, link, onto), jnp.where(there, out, bearing)
    wanted = is_place & (off > P.places.same_exit_rad) & (way.is_free | is_open)
    map_, new = btm.add_link(map_, node, way.bearing, when=wanted)
    is_new = wanted & (new < map_.start.shape[0])
    link, out = jnp.where(is_new, new, link), jnp.where(is_new, way.bearing, out)
    ahead = ahead.replace(steers=ahead.steers | (is_place & (off > P.route.back_rad) & ~is_new))
    way = way._replace(is_free=is_new & way.is_free)
    return Left(ahead, map_, jnp.where(is_place, link, onto), jnp.where(is_place, out, bearing), way)


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
    if writer.guide is not None:  # never where the route has the next place
        passes &= ~is_next(writer.guide, event.centre)
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
