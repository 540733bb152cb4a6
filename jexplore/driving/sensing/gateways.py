"""Gateways of a hall: gaps in a wall along which the robot drives, where ways part.

The robot follows the walls of a hall, and before each gateway is a place where ways part. That place and the ways along
the wall are the extended Voronoi graph of a space too wide for the sensors, where distances from its walls stand for a
middle line (Beeson, Jong and Kuipers, Towards autonomous topological place detection using the extended Voronoi graph,
2005).
"""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.arrays.loops import pick
from jexplore.btm import wrapped
from jexplore.driving import behaviour, mapping
from jexplore.driving.params.tree import P
from jexplore.driving.records import Openings, State, Surround, Track, Writer
from jexplore.driving.sensing import openings, surround
from jexplore.driving.settings import Tuning
from jexplore.driving.vehicle import to_robot, towards

TILTS_RAD = np.radians(np.arange(-25, 26, 5)).astype(np.float32)  # by which its direction may be another
OFFSETS_M = np.arange(-8, 9, dtype=np.float32) / 10  # and it may be nearer or farther
MIDDLE_OFFSETS_M = -0.6, -0.3, 0.0, 0.3, 0.6  # m; offsets from the expected middle at which its wall is searched


def find_gateway(
    xy: Array, valid: Array, middle: Array, out: Array, width_m: Array | float
) -> tuple[Array, Array, Array, Array]:
    """Find a gateway near a place.

    Args:
      xy, valid: `[P, 2]` float32, `[P]` bool, points round the robot, robot's frame, metres.
      middle: `[2]` float32, its expected middle.
      out: float32, radians, the direction in which it is expected to lead.

    Returns:
      `(there, middle, out, width_m)`: bool; `[2]` float32, metres; float32, radians, square to the wall; float32,
        metres.
    """
    turned, wall_m = _wall(xy, valid, middle, out)
    v, u = _wall_coordinates(xy, turned)
    at = _wall_coordinates(middle[None], turned)[1][0]
    wall = valid & (jnp.abs(v - wall_m) < P.places.wall_tolerance_m) & (jnp.abs(u - at) < P.places.wall_reach_m)

    def gap(off_m):
        one = jnp.max(jnp.where(wall & (u < at + off_m), u, -jnp.inf))
        other = jnp.min(jnp.where(wall & (u >= at + off_m), u, jnp.inf))
        inside = valid & (v > 0) & (u > one) & (u < other)
        leads = jnp.all(
            ~inside | (v > wall_m + P.places.leads_on_m) | (jnp.minimum(u - one, other - u) < P.places.wall_tolerance_m)
        )
        beyond = (
            valid
            & (v > wall_m + P.places.leads_on_m)
            & (u > one - P.places.wall_tolerance_m)
            & (u < other + P.places.wall_tolerance_m)
        )
        leads &= jnp.any(beyond)  # else nothing is known there
        wide = other - one
        return leads & (wide > width_m) & (wide <= P.places.max_gateway_m), (one + other) / 2, wide

    there, place, wide = jax.vmap(gap)(jnp.array(MIDDLE_OFFSETS_M))
    best = jnp.argmin(jnp.where(there, jnp.abs(place - at), jnp.inf))
    cos, sin = jnp.cos(turned), jnp.sin(turned)
    found = jnp.stack([wall_m * cos - place[best] * sin, wall_m * sin + place[best] * cos])
    is_near = jnp.abs(wrapped(turned - out)) < math.pi / 4
    return there[best] & is_near, jnp.where(there[best], found, middle), turned, jnp.where(there[best], wide[best], 0)


def _wall(xy, valid, middle, out):
    """Find the expected wall of a gateway by a Hough transform: outward direction, radians, and distance, metres."""
    tilts = jnp.asarray(TILTS_RAD)
    v, u = jax.vmap(lambda tilt: _wall_coordinates(xy, out + tilt))(tilts)  # [T, P]
    v_m, u_m = jax.vmap(lambda tilt: _wall_coordinates(middle[None], out + tilt))(tilts)  # [T, 1]
    near = valid & (jnp.abs(u - u_m) < P.places.wall_reach_m)
    away_m = v_m + jnp.asarray(OFFSETS_M)  # [T, O]
    votes = jnp.sum(near[:, None] & (jnp.abs(v[:, None] - away_m[..., None]) < P.places.band_m), axis=2)
    best = jnp.argmax(votes)
    i, wall_m = best // len(OFFSETS_M), away_m.reshape(-1)[best]
    there = near[i] & (jnp.abs(v[i] - wall_m) < 2 * P.places.band_m)
    n = jnp.maximum(jnp.sum(there), 1)
    mean_u, mean_v = (jnp.sum(jnp.where(there, a[i], 0)) / n for a in (u, v))
    du, dv = jnp.where(there, u[i] - mean_u, 0), jnp.where(there, v[i] - mean_v, 0)
    tilt = jnp.arctan(jnp.sum(du * dv) / jnp.maximum(jnp.sum(du * du), 1e-6))
    return out + tilts[i] - tilt, mean_v * jnp.cos(tilt) - mean_u * jnp.sin(tilt)


def _wall_coordinates(xy, out):
    """Return coordinates of points along the exit direction and along the wall: `[P]` each, metres."""
    return tuple(to_robot(jnp.stack([0.0, 0.0, out]))(xy).T)


def gateway_exits(out: Array, radius_m: Array, coast_m: Array | float, size: int) -> Openings:
    """Return the ways from before a gateway of a hall: out, and along the wall to both sides.

    Args:
      out: float32, radians, the direction in which it leads.
      coast_m: how far its middle is.
      size: K, 3 at least. Static.
    """
    across = wrapped(out + jnp.array([0.0, math.pi / 2, -math.pi / 2]))
    away_m = jnp.stack([jnp.float32(1) * coast_m, radius_m, radius_m])
    half_m = jnp.sqrt(jnp.maximum(radius_m**2 - coast_m**2, 0))
    middle = away_m[:, None] * jnp.stack([jnp.cos(across), jnp.sin(across)], axis=1)
    wide = 2 * jnp.stack([half_m, jnp.float32(1) * coast_m, jnp.float32(1) * coast_m])
    together = [
        jnp.pad(a, [(0, size - 3)] + [(0, 0)] * (a.ndim - 1)) for a in (jnp.ones(3, bool), middle, across, wide)
    ]
    return openings.sort_openings(together, jnp.int32(0), size)


def gateway_abeam(
    state: State,
    writer: Writer,
    xy: Array,
    valid: Array,
    track: Track,
    placed: Callable[[Array], Array],
    tuning: Tuning,
) -> Track:
    """Return the place before a gateway in the followed wall, once it is abeam; else the given one."""
    side = state.drive.side
    beside = jnp.stack([0.0, side * tuning.coast_m])
    there, middle, out, width_m = find_gateway(xy, valid, beside, side * math.pi / 2, tuning.width_m)
    found = _place_before(placed(middle), state.estimate[2] + out, width_m, tuning)
    known = mapping.is_near_known(writer, found.centre[None], state.odometer_m, tuning.leave_m)[0]
    there &= (jnp.abs(middle[0]) < P.places.abeam_m) & ~known & state.space.inside & (side != 0)
    return pick(there, found, track)


def gateway_crossed(writer: Writer, inside: Array, border_m: Array, tuning: Tuning) -> Track:
    """Return the place before the gateway by which the robot has entered or left a hall.

    No place results if the robot has not just passed between walls as near as a gateway's, or if it comes out by a
    gateway before which it has just been.
    """
    way = writer.way
    pose = mapping.pose_at(way, border_m)
    just = (way.odometer_m > border_m - P.places.mouth_m) & (way.odometer_m <= border_m)
    width_m = jnp.min(jnp.where(just, way.width_m, jnp.inf))
    out = pose[2] + jnp.where(inside, math.pi, 0.0)
    found = _place_before(pose[:2], out, jnp.minimum(width_m, P.places.max_gateway_m), tuning)
    last = jnp.minimum(writer.node, writer.map.kind.shape[0] - 1)
    off_m = jnp.hypot(writer.map.x_m[last] - found.centre[0], writer.map.y_m[last] - found.centre[1])
    none = (width_m > P.places.max_gateway_m) | (~inside & (off_m < 2 * tuning.coast_m))
    return pick(none, behaviour.empty_track(), found)


def gateway_around(
    state: State, track: Track, around: Surround, placed: Callable[[Array], Array], tuning: Tuning
) -> tuple[Track, Array]:
    """Return the gateway before which the robot is, once it has looked round: `(track, bool: a gateway exists)`."""
    heading = state.estimate[2]
    out = track.out - heading
    middle = to_robot(state.estimate)(track.centre) + tuning.coast_m * towards(out)
    there, middle, out, width_m = find_gateway(*surround.known_points(around), middle, out, tuning.width_m)
    found = _place_before(placed(middle), heading + out, width_m, tuning)
    return pick(there, found, track), there


def _place_before(middle, out, width_m, tuning):
    """Return a believed `Track` of the place before a gateway, at the distance at which walls are followed."""
    centre = middle - tuning.coast_m * towards(out)
    return behaviour.certain_track(centre, jnp.hypot(tuning.coast_m, width_m / 2), out)
