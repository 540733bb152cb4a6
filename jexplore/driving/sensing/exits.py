"""Exits of a place: the openings of its search circle, doors partly outside it, and doors of a wide room."""

import dataclasses
import math

import jax
import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import run_if
from jexplore.btm import wrapped
from jexplore.driving.params.tree import P
from jexplore.driving.records import Openings
from jexplore.driving.sensing.openings import (
    BEARINGS,
    find_gaps,
    find_openings,
    first_true,
    polar_points,
    sort_openings,
)

JAMB_DIRECTIONS = 60  # directions in which a door's other jamb is looked for


def find_exits(xy: Array, valid: Array, centre: Array, radius_m: Array | float, width_m: Array | float, *,
             circle: Array | float, size: int, seen_from: Array | None = None,
             farther: Array | bool = False) -> Openings:  # fmt: skip
    """Find the openings of a place, and doors in adjacent walls whose farther jamb lies outside the search circle.

    Two doors that face each other across a passage are rarely opposite to the centimetre. A door whose middle lies in
    the circle belongs to the place, as the one across the passage does; in the circle alone it and the passage are one
    gap. The same holds for a passage and a door farther on in its wall, of which the circle may hold the nearer jamb or
    nothing. Points beyond that gap, the passage's walls and a wall of the room behind the door, can pass for a pocket,
    whose door then is the gap from a jamb to that wall: it lies in the room, outside the circle, leads aside, and hides
    the exit along the passage. The opening straight ahead in a wider circle counts instead. If that circle contains the
    next door of the wall too, all may be one gap again: then the openings of a somewhat wider circle count, which holds
    both jambs of the first door and nothing of the next.

    Args: as for `find_openings`; and
      farther: bool, search doors wall by wall in smaller rooms as well, and farther away. The circles at both ends of a
        long room are one place: one may have a door that the other lacks. Searched everywhere, such doors lead to one
        place from many.

    Returns:
      `Openings`. Their overflow is that of the circle, of a wider circle or of the walls of a wide room, whichever is
        greatest: they mostly overflow together. An opening that did not fit the circle's list but that of a wider one
        may count twice.
    """

    def seen(wider):
        return find_openings(
            xy, valid, centre, radius_m, width_m, circle=circle * wider, size=size, seen_from=seen_from
        )

    views = jax.vmap(seen)(jnp.array([1.0, P.places.somewhat_wider, P.places.wider_circle]))
    found, near, more = (jax.tree.map(lambda a, i=i: a[i], views) for i in range(3))
    found = _divide_by_doors(found, near, more, circle * radius_m)
    askew, off_rad = _askew(found), P.places.merged_rad
    # The walls of a gap wider than half a turn face each other on the other side of the centre: one opening.
    merged = found.valid & (askew > off_rad) & (askew < math.pi - off_rad) & (found.width_m > P.places.door_m)
    kept, inside = found.valid & ~merged, jnp.hypot(*more.middle.T) <= circle * radius_m
    straight = jnp.any(merged) & (_askew(more) < P.places.straight_rad)
    extra = _new_openings(kept, found, more) & ((inside & (more.width_m <= P.places.door_m)) | straight)
    beside = jnp.abs(wrapped(found.bearing[:, None] - more.bearing)) < off_rad
    merged &= jnp.any(extra & beside, axis=1)
    parts = (found.valid & ~merged, found), (extra, more)
    together = [jnp.concatenate(pair) for pair in zip(*((there, a.middle, a.across, a.width_m) for there, a in parts))]

    def with_doors(_):
        offset = xy - centre
        place, _, here = polar_points(offset, jnp.hypot(*offset.T), valid, P.places.max_point_m)
        reach_m = jnp.where(farther, jnp.maximum(P.places.last_resort_radii, circle), circle) * radius_m
        doors, too_many = _wall_doors(place, here, width_m, reach_m, size)
        return _merge_doors(together, doors, radius_m > P.places.wide_place_m), too_many

    none = [jnp.concatenate([a, jnp.zeros_like(a[: 2 * size])]) for a in together], jnp.int32(0)
    from_m = jnp.where(farther, P.places.last_resort_m, P.places.wide_place_m)
    together, too_many = run_if(radius_m > from_m, with_doors, none)
    out = sort_openings(together, found.overflow, size)
    overflow = jnp.maximum(out.overflow, jnp.maximum(jnp.maximum(near.overflow, more.overflow), too_many))
    return dataclasses.replace(out, overflow=overflow)


def _divide_by_doors(found, near, more, reach_m):
    """Return the openings of the circle; where a door in the somewhat wider circle divides one, its own instead.
    Returns `Openings` of 2 K, in no order; the overflow is the circle's."""
    (away_m, at), (near_m, near_at) = ((jnp.hypot(*a.middle.T), _direction(a)) for a in (found, near))
    alike, seen = (
        _match_positions(found, near),
        jnp.any(_match_positions(found, near) | _match_positions(more, near), axis=0),
    )
    door = near.valid & (near.width_m <= P.places.door_m) & (near_m <= reach_m) & ~seen
    # Points seen through a gap, outside the circle, may bear otherwise than the gap.
    outside, straight = away_m > reach_m, _askew(near) < P.places.straight_rad
    half = jnp.where(outside, P.places.merged_rad, jnp.arctan2(found.width_m / 2, away_m))
    within = jnp.abs(wrapped(at[:, None] - near_at)) < half[:, None]
    parted = found.valid & ~jnp.any(alike, axis=1) & jnp.any(within & door, axis=1)
    ahead = jnp.abs(wrapped(at[:, None] - near_at)) < math.pi / 2
    new = near.valid & ((within & ((near_m <= reach_m) | straight)) | (outside[:, None] & ahead & straight))
    # One before or behind another of the place is that one.
    behind = (found.valid & ~parted)[:, None] & (jnp.abs(wrapped(at[:, None] - near_at)) < P.places.behind_rad)
    new &= parted[:, None] & ~jnp.any(alike | behind, axis=0)
    parted, new = parted & jnp.any(new, axis=1), jnp.any(new, axis=0)
    found, near = dataclasses.replace(found, valid=found.valid & ~parted), dataclasses.replace(near, valid=new)
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]) if a.ndim else a, found, near)


def _match_positions(one, other):
    """Match openings by position: `[K, K]` bool."""
    off = jnp.hypot(*jnp.moveaxis(one.middle[:, None] - other.middle, -1, 0))
    return one.valid[:, None] & other.valid & (off < P.places.same_opening_m)


def _direction(found):
    """Return the directions of the middles of openings: `[K]`, radians."""
    return jnp.arctan2(found.middle[:, 1], found.middle[:, 0])


def _askew(found):
    """Return the angle between an opening's passage and the direction of its middle: `[K]`, radians."""
    return jnp.abs(wrapped(found.across - _direction(found)))


def _new_openings(there, found, more):
    """Return the openings of another view that are not among those given: `[K]` bool."""
    off = jnp.hypot(*jnp.moveaxis(more.middle[:, None] - found.middle, -1, 0))
    alike = there & (jnp.abs(wrapped(more.across[:, None] - found.across)) < P.places.same_exit_rad)
    return (
        more.valid
        & (jnp.min(jnp.where(there, off, jnp.inf), axis=1) > P.places.same_opening_m)
        & ~jnp.any(alike, axis=1)
    )


def _merge_doors(found, doors, is_wide):
    """Merge openings and doors: `(valid, middle, across, width)`. A door behind another does not belong to the place,
    nor does one seen through a narrow opening and farther by `through_m`. An opening at a door is that door; in rooms
    that are not wide, only a narrow opening is."""
    away_m, bearing = jnp.hypot(*doors[1].T), jnp.arctan2(doors[1][:, 1], doors[1][:, 0])
    off = jnp.abs(wrapped(bearing[:, None] - bearing))
    order = jnp.arange(len(bearing))
    nearer = (away_m < away_m[:, None]) | ((away_m == away_m[:, None]) & (order < order[:, None]))
    first = doors[0] & ~jnp.any(doors[0] & nearer & (off < P.places.behind_rad), axis=1)
    found_m, towards = jnp.hypot(*found[1].T), jnp.arctan2(found[1][:, 1], found[1][:, 0])
    off, gap = jnp.abs(wrapped(towards[:, None] - bearing)), jnp.arctan2(found[3] / 2, found_m)
    narrow = found[3] <= P.places.most_door_m
    through = (found[0] & narrow)[:, None] & (off < gap[:, None]) & (away_m > found_m[:, None] + P.places.through_m)
    first &= ~jnp.any(through, axis=0)
    alone = found[0] & ~(jnp.any(first & (off < P.places.same_exit_rad / 2), axis=1) & (narrow | is_wide))
    return [jnp.concatenate(pair) for pair in zip((alone, *found[1:]), (first, *doors[1:]))]


def _wall_doors(place, here, width_m, reach_m, size):
    """Find doors in the walls of a wide place: narrow gaps, free behind, from a wall's end to the next wall. Returns
    `((valid, middle, across, width), too_many)`: of 2 K; int32, those that did not fit."""
    mirrored = jnp.array([1.0, -1.0])
    one, n_one = _from_ends(place, here, width_m, reach_m, size)
    other, n_other = _from_ends(place[::-1] * mirrored, here[::-1], width_m, reach_m, size)
    other = other[0], other[1] * mirrored, -other[2], other[3]
    too_many = jnp.maximum(jnp.maximum(n_one, n_other) - size, 0)
    return [jnp.concatenate(pair) for pair in zip(one, other)], too_many


def _from_ends(place, here, width_m, reach_m, size):
    """Find doors as `_wall_doors` does, in one sense of rotation: from a wall's end to the nearest later point. Returns
    `(doors, n)`: `(valid, middle, across, width)` of K; int32, their number."""
    order, ends = jnp.arange(BEARINGS), find_gaps(place, place, here, width_m)[2]
    later = (order[:, None] + 1 + jnp.arange(JAMB_DIRECTIONS)) % BEARINGS
    there = here[later]
    way = place[later] - place[:, None]  # [BEARINGS, JAMB, 2]
    chord = jnp.where(there, jnp.hypot(way[..., 0], way[..., 1]), jnp.inf)
    at = jnp.argmin(chord, axis=1)
    wide, along = chord[order, at], way[order, at]
    out = jnp.stack([along[:, 1], -along[:, 0]], axis=1) / jnp.maximum(wide, 1e-6)[:, None]
    between = jnp.arange(JAMB_DIRECTIONS) < at[:, None]
    deep_m = jnp.where(there, jnp.einsum("bjd,bd->bj", way, out), jnp.inf)
    leads_on = jnp.any(between & (deep_m > P.places.leads_on_m), axis=1)
    middle = place + along / 2
    door = ends & leads_on & (wide > width_m) & (wide <= P.places.most_door_m) & (jnp.hypot(*middle.T) <= reach_m)
    chosen = first_true(door, size)
    first = jnp.argmax(chosen, axis=1)
    doors = jnp.any(chosen, axis=1), middle[first], jnp.arctan2(out[first, 1], out[first, 0]), wide[first]
    return doors, jnp.sum(door, dtype=jnp.int32)
