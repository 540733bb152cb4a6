"""By which link a robot that follows a route leaves a place."""

import dataclasses
import functools
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.btm import Btm
from jexplore.driving import links
from jexplore.driving.guiding.guide import BACK_RAD, STRIP_M, is_next, match_place
from jexplore.driving.records import DueNode, Guide, Onward, Openings, Writer
from jexplore.driving.vehicle import to_odometry


class Left(NamedTuple):
    """Direction and link by which a robot leaves a place."""

    guide: Guide | None
    map: Btm
    link: Array  # int32
    bearing: Array  # float32, radians, of the link there
    onward: Onward | None  # what the route says: radians and metres, turned as the map's node has them


def is_off_route(writer: Writer, centre: Array, passes: Array) -> Array:
    """Return whether a robot rejects a candidate, `[2]`, odometry: never where its route has the next place."""
    return passes if writer.guide is None else passes & ~is_next(writer.guide, centre)


def correct_guide(guide: Guide, centre: Array, correction: Array) -> Guide:
    """Apply a correction of the odometry to a guide.

    Args:
      correction: `[3]` float32, metres and radians.
    """
    from_xy = to_odometry(jnp.append(centre, correction[2]))(guide.from_xy - centre) + correction[:2]
    return guide.replace(from_xy=from_xy, turned=guide.turned - correction[2])


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
    (onto, bearing), (turn, correction) = usual, turned
    if writer.guide is None:
        return Left(None, map_, onto, bearing, None)
    free_m = functools.partial(links.reach_m, points, width_m=STRIP_M)
    measured = dataclasses.replace(found, bearing=found.bearing - turn)
    ahead, way = match_place(writer.guide, event.odometer_m, event.centre, measured, is_place, free_m)
    to_node = to_odometry(jnp.append(event.centre, turn))
    way = way._replace(bearing=way.bearing + turn, middle=to_node(way.middle - event.centre))
    ahead = correct_guide(ahead, event.centre, correction)
    link, out, off = links.link_toward(map_, node, way.bearing)
    is_open = jnp.any(found.valid & (jnp.abs(btm.wrapped(found.bearing - way.bearing)) < links.SAME_EXIT_RAD))
    there = jnp.isfinite(off)
    link, out = jnp.where(there, link, onto), jnp.where(there, out, bearing)
    wanted = is_place & (off > links.SAME_EXIT_RAD) & (way.is_free | is_open)
    map_, new = btm.add_link(map_, node, way.bearing, when=wanted)
    is_new = wanted & (new < map_.start.shape[0])
    link, out = jnp.where(is_new, new, link), jnp.where(is_new, way.bearing, out)
    ahead = ahead.replace(steers=ahead.steers | (is_place & (off > BACK_RAD) & ~is_new))
    way = way._replace(is_free=is_new & way.is_free)
    return Left(ahead, map_, jnp.where(is_place, link, onto), jnp.where(is_place, out, bearing), way)
