"""A route from another robot's map: which way to take at every place, told by the places next to it, never by where the
whole map has it.

A place is a divergence on the route. The robot finds places as one that explores does, and takes one for the next of
its route by where it lies from the last one and by the directions of its ways, which are held against its own heading;
this is put right at every place.
"""

import math
from collections.abc import Callable, Sequence
from typing import ClassVar, Self

import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array

from jexplore import btm
from jexplore.driving.sensing.openings import Openings
from jexplore.driving.vehicle import to_odometry

WAYS = 8  # most of a place
AHEAD = 4  # so many of the next places may be the one at which the robot is
SURE = 0.1, 1.0  # a place lies where the map has it within this share of the way, and so many metres
NEAR = 0.2, 1.5  # and within these where it has the very ways that the map has
THERE_M = 0.7  # one that is so near is it, if only the way on is there; at the last, the robot has arrived
ALIKE_RAD = math.radians(40)  # ways that lie no farther apart are one
BACK_RAD = math.radians(120)  # a way on that bears farther from where it should is none
TOWARD_M = 1.5  # at a place that the map does not have, the robot turns to the next if that is farther than this
HEADING_SHARE = 0.5  # of what the ways of a place say of the heading
LOST = 1.5, 5.0  # none of the next places within so many times the way and so many metres more: the robot is lost
END_M = 0.3  # a route that ends on a link ends so far before the length that the map has


@struct.dataclass
class Guide:
    """A route of at most K places, and how far the robot has come on it. Bearings are the map's."""

    out: Array  # [K] float32, radians, bearing of the way on
    ways: Array  # [K, WAYS] float32, radians, of all ways of the place; NaN: none
    leg: Array  # [K, 2] float32, metres, from the place before
    length_m: Array  # [K] float32, of the way from the place before
    count: Array  # int32, places
    tail_m: Array  # float32, way from the last place to the end; 0: the route ends there
    at: Array  # int32, the place ahead
    from_xy: Array  # [2] float32, odometry, of the place before
    from_m: Array  # float32, odometer there
    turned: Array  # float32, radians, the map's bearings less those of the odometry
    seen: Array  # [K, WAYS] float32, radians, bearings of the ways that were found; NaN: none
    missed: Array  # int32, places that were not found
    extra: Array  # int32, places that the map does not have
    strays: Array  # bool, the last place was such a one
    arrived: Array  # bool
    lost: Array  # bool, it is where the map does not help it on
    blocked: Array  # bool, because it cannot pass what lies before it
    walled: Array  # bool, because there is a wall
    replace: ClassVar[Callable[..., Self]]


def guide_of(
    out: Sequence[float],
    ways: Sequence[Sequence[float]],
    leg: Sequence[tuple[float, float]],
    length_m: Sequence[float],
    *,
    tail_m: float,
    node_xy: tuple[float, float],
    start_m: float,
    size: int,
) -> Guide:
    """A `Guide` of numpy arrays for a robot before its first step.

    Args:
      out, ways, leg, length_m: of every place, see `Guide`.
      tail_m: see `Guide`.
      node_xy: where the route begins, odometry, metres; the odometry's axes are those of the map.
      start_m: how far the robot stands from there.
      size: K, as many places or more.
    """
    n, none = len(out), np.bool_(False)
    angles, legs = np.full((size, WAYS), np.nan, np.float32), np.zeros((size, 2), np.float32)
    for place, of_place in zip(angles, ways):
        place[: len(of_place)] = of_place[:WAYS]
    legs[:n] = np.reshape(leg, (n, 2))
    # Ignored types: numpy on the host, where the record says what it is on the device.
    values = {
        "out": np.pad(np.asarray(out, np.float32), (0, size - n)),
        "ways": angles,
        "leg": legs,
        "length_m": np.pad(np.asarray(length_m, np.float32), (0, size - n)),
        "count": np.int32(n),
        "tail_m": np.float32(tail_m),
        "at": np.int32(0),
        "from_xy": np.asarray(node_xy, np.float32),
        "from_m": np.float32(-start_m),
        "turned": np.float32(0),
        "seen": np.full((size, WAYS), np.nan, np.float32),
        "missed": np.int32(0),
        "extra": np.int32(0),
        "strays": none,
        "arrived": none,
        "lost": none,
        "blocked": none,
        "walled": none,
    }
    return Guide(**values)  # type: ignore[arg-type]


def at_place(
    guide: Guide, odometer_m: Array, centre: Array, found: Openings, when: Array | bool
) -> tuple[Guide, Array]:
    """Takes a place for one of the next of the route, or for one that the map does not have.

    Args:
      guide: `Guide`.
      odometer_m: float32, at the place.
      centre: `[2]` float32, of the place, odometry.
      found: `Openings` of it.
      when: bool, whether the robot is at a place at all.

    Returns:
      `(guide, bearing)`: of the way on, odometry, radians: the map's; at a place that the map does not have, towards
        the next one that it has.
    """
    size = guide.out.shape[0]
    seen = jnp.where(found.valid, found.bearing + guide.turned, jnp.nan)
    place = guide.at + jnp.arange(AHEAD)
    at = jnp.minimum(place, size - 1)
    length_m, expected = jnp.cumsum(guide.length_m[at]), _expected(guide, at)
    off_m = jnp.hypot(*(expected - centre).T)
    ways, out = guide.ways[at], guide.out[at]  # [AHEAD, WAYS], [AHEAD]
    apart = btm.wrapped(ways[:, :, None] - seen)  # [AHEAD, WAYS, V]
    alike = jnp.abs(apart) < ALIKE_RAD
    missing = jnp.sum(jnp.isfinite(ways), axis=1) - jnp.sum(jnp.any(alike, axis=2), axis=1)
    more = jnp.sum(found.valid) - jnp.sum(jnp.any(alike, axis=1), axis=1)
    last = (place == guide.count - 1) & (guide.tail_m == 0)
    leads_on = last | jnp.any(jnp.abs(btm.wrapped(out[:, None] - seen)) < ALIKE_RAD, axis=1)
    fits = (off_m <= SURE[0] * length_m + SURE[1]) & (missing <= 1) & (more <= 2)
    fits |= (off_m <= NEAR[0] * length_m + NEAR[1]) & (missing == 0) & (more == 0)
    fits = (fits | (off_m < THERE_M)) & leads_on & (place < guide.count)
    best = jnp.argmin(jnp.where(fits, off_m, jnp.inf))
    is_known = when & fits[best]
    own = jnp.where(is_known, at[best], size)
    turn = jnp.where(alike[best], apart[best], 0)
    turn = HEADING_SHARE * jnp.sum(turn) / jnp.maximum(jnp.sum(alike[best]), 1)
    ahead = expected[jnp.where(off_m[0] > TOWARD_M, 0, 1)] - centre
    toward = jnp.arctan2(ahead[1], ahead[0])
    # Only back: the way on is closed.
    off = jnp.where(found.valid, jnp.abs(btm.wrapped(found.bearing - toward)), jnp.inf)
    walled = when & ~is_known & ~guide.strays & (jnp.sum(found.valid) == 1) & (jnp.min(off) > BACK_RAD)
    moved = guide.replace(
        at=jnp.where(is_known, place[best] + 1, guide.at),
        from_xy=jnp.where(is_known, centre, guide.from_xy),
        from_m=jnp.where(is_known, odometer_m, guide.from_m),
        turned=guide.turned + jnp.where(is_known, turn, 0),
        seen=guide.seen.at[own].set(seen[:WAYS], mode="drop"),
        missed=guide.missed + jnp.where(is_known, best.astype(jnp.int32), 0),
        extra=guide.extra + (when & ~is_known),
        strays=jnp.where(when, ~is_known, guide.strays),
        arrived=guide.arrived | (is_known & last[best]),
        lost=guide.lost | walled,
        walled=guide.walled | walled,
    )
    return moved, jnp.where(is_known, out[best] - moved.turned, toward)


def _expected(guide, places):
    """Where the next places lie, odometry: `[A, 2]`."""
    return guide.from_xy + to_odometry(jnp.stack([0.0, 0.0, -guide.turned]))(jnp.cumsum(guide.leg[places], axis=0))


def on_the_way(guide: Guide, odometer_m: Array, position: Array, is_blocked: Array) -> Guide:
    """Looks whether the route's end has been reached, or the robot is lost.

    Args:
      guide: `Guide`.
      odometer_m: float32.
      position: `[2]` float32, odometry.
      is_blocked: bool, whether the robot has just found that it cannot pass what lies before it.

    Returns:
      `Guide`.
    """
    gone_m, left = odometer_m - guide.from_m, guide.count - guide.at
    place = jnp.minimum(guide.at + jnp.arange(AHEAD), guide.out.shape[0] - 1)
    off_m = jnp.hypot(*(_expected(guide, place[:1])[0] - position))
    ends = (left == 1) & (guide.tail_m == 0) & (off_m < THERE_M)
    ends |= (left <= 0) & (gone_m >= guide.tail_m - END_M)
    arrived = guide.arrived | ends
    length_m = jnp.sum(jnp.where(jnp.arange(AHEAD) < left, guide.length_m[place], 0))
    length_m += jnp.where(left < AHEAD, guide.tail_m, 0)
    blocked = guide.blocked | (is_blocked & ~arrived)
    too_far = gone_m > LOST[0] * length_m + LOST[1]
    return guide.replace(arrived=arrived, lost=guide.lost | (~arrived & too_far) | blocked, blocked=blocked)
