"""A route from another robot's map: which way to take at every place, told by the places next to it, never by where the
whole map has it.

A place is a divergence on the route. The robot finds places as one that explores does, and takes one for the next of
its route by where it lies from the last one and by the directions of its ways, which are held against its own heading;
this is put right at every place.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore import btm
from jexplore.driving.params.tree import P
from jexplore.driving.records import Guide, Onward, Openings
from jexplore.driving.vehicle import rotate_by

PLACE_EXITS = 8  # most of a place
OFF_ROUTE_PLACES = 4  # number of nearest places off the route kept for each place on it
NEXT_PLACES = 4  # number of next places that may match the robot's place
STRIP_OFFSETS_M = 0.0, -0.2, 0.2, -0.4, 0.4  # m; offsets of the strip from the middle


def guide_of(
    out: Sequence[float],
    ways: Sequence[Sequence[float]],
    leg: Sequence[tuple[float, float]],
    length_m: Sequence[float],
    *,
    tail_m: float,
    end_leg: tuple[float, float],
    others: Sequence[Sequence[tuple[float, float]]] = (),
    node_xy: tuple[float, float],
    start_m: float,
    size: int,
) -> Guide:
    """Make a `Guide` of numpy arrays for a robot before its first step.

    Args:
      out, ways, leg, length_m: of every place, see `Guide`.
      tail_m, end_leg, others: see `Guide`.
      node_xy: where the route begins, odometry, metres; the odometry's axes are those of the map.
      start_m: how far the robot stands from there.
    """
    n, none = len(out), np.bool_(False)
    angles, legs = np.full((size, PLACE_EXITS), np.nan, np.float32), np.zeros((size, 2), np.float32)
    for place, of_place in zip(angles, ways):
        place[: len(of_place)] = of_place[:PLACE_EXITS]
    legs[:n] = np.reshape(leg, (n, 2))
    elsewhere = np.full((size, OFF_ROUTE_PLACES, 2), np.nan, np.float32)
    for place, of_place in zip(elsewhere, others):
        place[: len(of_place)] = np.reshape(of_place, (-1, 2))[:OFF_ROUTE_PLACES]
    # Ignored types: numpy on the host, where the record says what it is on the device.
    values = {
        "out": np.pad(np.asarray(out, np.float32), (0, size - n)),
        "ways": angles,
        "leg": legs,
        "length_m": np.pad(np.asarray(length_m, np.float32), (0, size - n)),
        "count": np.int32(n),
        "others": elsewhere,
        "tail_m": np.float32(tail_m),
        "end_leg": np.asarray(end_leg, np.float32),
        "at": np.int32(0),
        "from_xy": np.asarray(node_xy, np.float32),
        "from_m": np.float32(-start_m),
        "turned": np.float32(0),
        "seen": np.full((size, PLACE_EXITS), np.nan, np.float32),
        "missed": np.int32(0),
        "extra": np.int32(0),
        "strays": none,
        "arrived": none,
        "lost": none,
        "blocked": none,
        "walled": none,
        "steers": none,
    }
    return Guide(**values)  # type: ignore[arg-type]


def match_place(
    guide: Guide,
    odometer_m: Array,
    centre: Array,
    found: Openings,
    when: Array | bool,
    reach_m: Callable[[Array, Array], Array],
) -> tuple[Guide, Onward]:
    """Match a place to one of the next places of the route, or to none of the map.

    Args:
      reach_m: free length of a strip `strip_m` wide from a point in a direction, odometry, radians: metres.

    Returns:
      `(guide, onward)`: `Onward`: the map's; at a place missing in the map, towards the next mapped one; at the end of
        the route, towards that.
    """
    size = guide.out.shape[0]
    seen = jnp.where(found.valid, found.bearing + guide.turned, jnp.nan)
    near = _next_ones(guide, centre, found, seen, reach_m)
    place, expected, off_m, fits, is_like, last, off_ways, begins, is_free, misfit, way = near
    best = jnp.argmin(jnp.where(fits, off_m + P.route.misfit_m * misfit, jnp.inf))
    is_known, at = when & fits[best], jnp.minimum(place[best], size - 1)
    turn = P.route.heading_share * jnp.clip(
        jnp.nan_to_num(jnp.nanmedian(off_ways[best])), -P.route.max_heading_turn_rad, P.route.max_heading_turn_rad
    )
    toward = _toward(guide, centre)
    # Only back: the way on is closed, unless the route ends there.
    off = jnp.where(found.valid, jnp.abs(btm.wrapped(found.bearing - toward)), jnp.inf)
    walled = when & ~is_known & ~guide.strays & (jnp.sum(found.valid) == 1) & (jnp.min(off) > P.route.back_rad)
    stop, *_, is_end = next_stop(guide)
    walled &= ~is_end | (jnp.hypot(*(stop - centre)) > P.route.next_place_m)
    moved = guide.replace(
        at=jnp.where(is_known, place[best] + 1, guide.at),
        from_xy=jnp.where(is_known, expected[best] + P.route.anchor_share * (centre - expected[best]), guide.from_xy),
        from_m=jnp.where(is_known, odometer_m, guide.from_m),
        turned=guide.turned + jnp.where(is_known, turn, 0),
        seen=guide.seen.at[jnp.where(is_known & is_like[best], at, size)].set(seen[:PLACE_EXITS], mode="drop"),
        missed=guide.missed + jnp.where(is_known, best.astype(jnp.int32), 0),
        extra=guide.extra + (when & ~is_known),
        strays=jnp.where(when, ~is_known, guide.strays),
        lost=guide.lost | walled,
        walled=guide.walled | walled,
    )
    goes_on = is_known & ~last[best]
    bearing = jnp.where(goes_on, way[best] - moved.turned, toward)
    middle = jnp.where(goes_on & is_free[best], begins[best], centre)
    by_strip = jnp.where(goes_on, is_free[best], ~is_known & (reach_m(centre, toward) > P.route.open_strip_m))
    return moved, Onward(bearing, middle, by_strip)


def _toward(guide, centre):
    """Return the bearing of the next place, or of the end, from a point, radians; if that is near, of the one after."""
    n, stops = guide.out.shape[0], guide.at + jnp.arange(2)
    leg = jnp.where((stops == guide.count)[:, None], guide.end_leg, guide.leg[jnp.minimum(stops, n - 1)])
    leg = jnp.where((stops > guide.count)[:, None], 0.0, leg)
    off = guide.from_xy + _to_odometry_axes(guide)(jnp.cumsum(leg, axis=0)) - centre
    ahead = off[jnp.where(jnp.hypot(*off[0]) > P.route.next_place_m, 0, 1)]
    return jnp.arctan2(ahead[1], ahead[0])


class _NextOnes(NamedTuple):
    """Similarity of a place to the next places of the route."""

    place: Array  # [AHEAD] int32
    expected: Array  # [AHEAD, 2] float32, odometry
    off_m: Array  # [AHEAD] float32
    fits: Array  # [AHEAD] bool, it may be that one
    is_like: Array  # [AHEAD] bool, by the observed exits, not by the mapped position alone
    last: Array  # [AHEAD] bool, the route ends there
    off_ways: Array  # [AHEAD, WAYS, V] float32, radians, how ways lie off openings; NaN: another one
    begins: Array  # [AHEAD, 2] float32, odometry, from where the way on is free
    is_free: Array  # [AHEAD] bool, the way on is no opening, but free
    misfit: Array  # [AHEAD] int32, ways that are missing, or too many
    way: Array  # [AHEAD] float32, radians, bearing of the way on, the map's


def _next_ones(guide, centre, found, seen, reach_m):
    """Compute `_NextOnes`; `seen` are the mapped bearings of the openings."""
    place, size = guide.at + jnp.arange(NEXT_PLACES), guide.out.shape[0]
    at = jnp.minimum(place, size - 1)
    length_m, expected = jnp.cumsum(guide.length_m[at]), _expected_positions(guide, at)
    off_m = jnp.hypot(*(expected - centre).T)
    ways, out, after_m, leads = guide.ways[at], guide.out[at], *_bearings_on(guide, at, expected, centre)
    apart = btm.wrapped(ways[:, :, None] - seen)  # [AHEAD, WAYS, V]
    alike = jnp.abs(apart) < P.places.same_exit_rad
    missing = jnp.sum(jnp.isfinite(ways), axis=1) - jnp.sum(jnp.any(alike, axis=2), axis=1)
    more = jnp.sum(found.valid) - jnp.sum(jnp.any(alike, axis=1), axis=1)
    last = (place == guide.count - 1) & (guide.tail_m == 0)
    by_leg, by_map = (
        jnp.any(jnp.abs(btm.wrapped(way[:, None] - seen)) < P.places.same_exit_rad, axis=1) for way in (leads, out)
    )
    is_seen = last | by_leg | by_map
    begins, free_m = _strip(reach_m, expected, out - guide.turned)
    is_free = ~is_seen & (off_m < P.route.at_mapped_m) & (free_m > jnp.minimum(P.route.open_strip_m, after_m))
    others = expected[:, None] + _to_odometry_axes(guide)(guide.others[at])
    other_m = jnp.nan_to_num(jnp.hypot(others[..., 0] - centre[0], others[..., 1] - centre[1]), nan=jnp.inf)
    fits = (off_m <= P.route.match_tolerance[0] * length_m + P.route.match_tolerance[1]) & (missing <= 1) & (more <= 2)
    fits |= (
        (off_m <= P.route.exact_match_tolerance[0] * length_m + P.route.exact_match_tolerance[1])
        & (missing == 0)
        & (more == 0)
    )
    fits &= jnp.min(other_m, axis=1) > P.route.other_place_share * off_m
    is_like = (fits | (off_m < P.route.at_mapped_m)) & (is_seen | is_free) & (place < guide.count)
    fits = is_like | ((off_m < P.route.at_mapped_unseen_m) & (place < guide.count))
    off_ways = jnp.where(alike, apart, jnp.nan)
    way = jnp.where(by_leg, leads, out)
    return _NextOnes(place, expected, off_m, fits, is_like, last, off_ways, begins, is_free, missing + more, way)


def _bearings_on(guide, places, expected, centre):
    """Return distance, metres, and mapped bearing of each place's successor; NaN: the way there is not straight."""
    n, after = guide.out.shape[0], places + 1
    is_place = after < guide.count
    leg = jnp.where(is_place[:, None], guide.leg[jnp.minimum(after, n - 1)], guide.end_leg)
    length_m = jnp.where(is_place, guide.length_m[jnp.minimum(after, n - 1)], guide.tail_m)
    off = expected + _to_odometry_axes(guide)(leg) - centre
    leg_m, bearing = jnp.hypot(*leg.T), jnp.arctan2(off[:, 1], off[:, 0]) + guide.turned
    return leg_m, jnp.where(
        (leg_m > P.route.straight_leg_m) & (length_m < P.route.straight_leg_ratio * leg_m), bearing, jnp.nan
    )


def _strip(reach_m, places, bearings):
    """Find the longest free strip in a direction from each place or from points next to it. Returns `(start, length)`:
    `[A, 2]`, `[A]`, metres."""
    across = jnp.stack([-jnp.sin(bearings), jnp.cos(bearings)], axis=1)
    begins = places[:, None] + jnp.asarray(STRIP_OFFSETS_M)[:, None] * across[:, None]  # [A, S, 2]
    free_m = jax.vmap(jax.vmap(reach_m, (0, None)))(begins, bearings)
    best = jnp.argmax(jnp.minimum(free_m, P.route.open_strip_m + 0.1), axis=1)
    pick = jnp.arange(len(places)), best
    return begins[pick], free_m[pick]


def is_next(guide: Guide, centre: Array) -> Array:
    """Return whether the map has the next place of the route at a point, `[2]`, odometry: bool."""
    return (guide.at < guide.count) & (jnp.hypot(*(next_stop(guide)[0] - centre)) < P.route.at_mapped_m)


def _expected_positions(guide, places):
    """Return the expected positions of the next places, odometry: `[A, 2]`."""
    return guide.from_xy + _to_odometry_axes(guide)(jnp.cumsum(guide.leg[places], axis=0))


def _to_odometry_axes(guide):
    """Return the function that turns a way on the map into the odometry frame."""
    return rotate_by(-guide.turned)


def next_stop(guide: Guide) -> tuple[Array, Array, Array, Array]:
    """Return the next place of the route, or its end.

    Returns:
      `(place, leg_m, length_m, is_end)`: `[2]` float32, odometry; float32, metres, to it in a straight line, and along
        the map; bool, it is the end.
    """
    left, at = guide.count - guide.at, jnp.minimum(guide.at, guide.out.shape[0] - 1)
    leg = jnp.where(left > 0, guide.leg[at], guide.end_leg)
    length_m = jnp.where(left > 0, guide.length_m[at], guide.tail_m)
    is_end = (left <= 0) | ((left == 1) & (guide.tail_m == 0))
    return guide.from_xy + _to_odometry_axes(guide)(leg), jnp.hypot(*leg), length_m, is_end
