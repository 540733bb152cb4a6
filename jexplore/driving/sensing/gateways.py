"""Gateways of a hall: gaps in a wall along which the robot drives, where ways part."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.btm import wrapped
from jexplore.driving.records import Openings
from jexplore.driving.sensing import openings
from jexplore.driving.vehicle import to_robot

WALL_REACH_M = 3.5  # m; length of wall considered to each side
TILTS_RAD = np.radians(np.arange(-25, 26, 5)).astype(np.float32)  # by which its direction may be another
OFFSETS_M = np.arange(-8, 9, dtype=np.float32) / 10  # and it may be nearer or farther
BAND_M = 0.1  # points so near to a line vote for it
WALL_TOLERANCE_M = 0.2  # m; tolerance before and behind the wall's line
GATEWAY_DEPTH_M = 0.6  # m; a gateway is free this far behind the wall
MAX_GATEWAY_M = 4.5  # and is no wider
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
    wall = valid & (jnp.abs(v - wall_m) < WALL_TOLERANCE_M) & (jnp.abs(u - at) < WALL_REACH_M)

    def gap(off_m):
        one = jnp.max(jnp.where(wall & (u < at + off_m), u, -jnp.inf))
        other = jnp.min(jnp.where(wall & (u >= at + off_m), u, jnp.inf))
        inside = valid & (v > 0) & (u > one) & (u < other)
        leads = jnp.all(~inside | (v > wall_m + GATEWAY_DEPTH_M) | (jnp.minimum(u - one, other - u) < WALL_TOLERANCE_M))
        beyond = valid & (v > wall_m + GATEWAY_DEPTH_M) & (u > one - WALL_TOLERANCE_M) & (u < other + WALL_TOLERANCE_M)
        leads &= jnp.any(beyond)  # else nothing is known there
        wide = other - one
        return leads & (wide > width_m) & (wide <= MAX_GATEWAY_M), (one + other) / 2, wide

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
    near = valid & (jnp.abs(u - u_m) < WALL_REACH_M)
    away_m = v_m + jnp.asarray(OFFSETS_M)  # [T, O]
    votes = jnp.sum(near[:, None] & (jnp.abs(v[:, None] - away_m[..., None]) < BAND_M), axis=2)
    best = jnp.argmax(votes)
    i, wall_m = best // len(OFFSETS_M), away_m.reshape(-1)[best]
    there = near[i] & (jnp.abs(v[i] - wall_m) < 2 * BAND_M)
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
