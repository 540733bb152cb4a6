"""The openings of a search circle: gaps between the walls in it, and doors in the walls of pockets beyond these."""

import math

import jax.numpy as jnp
from jax import Array

from jexplore.btm import wrapped
from jexplore.driving.params.tree import P
from jexplore.driving.records import Openings
from jexplore.driving.sensing.perception import running_sum

BEARINGS = 240  # directions round a place in which its nearest point is looked for
WALL = 40  # directions on either side of a gap in which its walls are looked at


def _next(here):
    """Return the next direction, counter-clockwise and round the circle, that has a point: `[BEARINGS]` int32."""
    order = jnp.arange(BEARINGS)
    later = jnp.where(here, order, 2 * BEARINGS)
    twice = jnp.concatenate([later, later + BEARINGS])
    later = jnp.where(twice[:, None] > order, twice[:, None], 4 * BEARINGS)
    return jnp.min(later, axis=0) % BEARINGS


def find_gaps(point: Array, last: Array, here: Array, width_m: Array | float) -> tuple[Array, Array, Array]:
    """Find gaps from every direction to the next, counter-clockwise and round the circle, that has a point.

    Args:
      point, last: `[BEARINGS, 2]` float32, the nearest and the farthest point in every direction.
      here: `[BEARINGS]` bool, whether there is any.

    Returns:
      `(after, width, is_gap)`: `[BEARINGS, 2]`, the point where it ends; `[BEARINGS]`, how wide it is, and whether that
        is an opening.
    """
    following = _next(here)
    after, last_after = point[following], last[following]
    apart = jnp.stack([after, last_after])[:, None] - jnp.stack([point, last])
    width = jnp.min(jnp.hypot(apart[..., 0], apart[..., 1]), axis=(0, 1))
    return after, width, here & ((width > width_m) | (jnp.sum(here) == 1))


def _grazes(point, after, here, centre, seen_from):
    """Return whether a gap of less than half a turn begins and ends in nearly one direction from the robot."""
    if seen_from is None:
        return jnp.zeros_like(here)
    one, other = (place + centre - seen_from for place in (point, after))
    apart = jnp.arctan2(one[:, 1], one[:, 0]) - jnp.arctan2(other[:, 1], other[:, 0])
    span = (_next(here) - jnp.arange(BEARINGS)) % BEARINGS  # 0: the gap is all there is
    return (jnp.abs(wrapped(apart)) < P.places.graze_rad) & (span > 0) & (span < BEARINGS // 2)


def polar_points(offset: Array, distance: Array, inside: Array, most_m: Array | float) -> tuple[Array, Array, Array]:
    """Find the nearest point in every direction and the farthest, for a wall may lead straight outward.

    Args:
      offset, distance: `[P, 2]`, `[P]` float32, of points from the centre.
      inside: `[P]` bool, which of them count.
      most_m: none of those lies farther away.

    Returns:
      `(point, last, here)`: `[BEARINGS, 2]` each; `[BEARINGS]` bool, whether there is any.
    """
    sector = jnp.floor((jnp.arctan2(offset[:, 1], offset[:, 0]) + math.pi) * (BEARINGS / (2 * math.pi)))
    sector = jnp.where(inside, jnp.clip(sector.astype(jnp.int32), 0, BEARINGS - 1), BEARINGS)
    # Distance and number of a point in one integer.
    bits = max(offset.shape[0] - 1, 1).bit_length()
    share = jnp.where(inside, jnp.minimum(distance / jnp.maximum(most_m, 1e-6), 1), 0)
    code = (share * (2 ** (30 - bits) - 1)).astype(jnp.int32) << bits | jnp.arange(offset.shape[0])
    least = jnp.full(BEARINGS, 2**31 - 1, jnp.int32).at[sector].min(code, mode="drop")
    most = jnp.full(BEARINGS, -1, jnp.int32).at[sector].max(code, mode="drop")
    here = most >= 0
    point, last = (offset[jnp.where(here, code, 0) & (2**bits - 1)] for code in (least, most))
    return point, last, here


def _leads_out(distance, here, whole):
    """Return directions after which a gap leads on, other than a corner outside the circle: `[BEARINGS]` bool."""
    order, following = jnp.arange(BEARINGS), _next(here)
    reach_m = jnp.where(whole[2], jnp.hypot(*whole[0].T), jnp.inf)
    later = (order - order[:, None]) % BEARINGS
    between = (later > 0) & (later < ((following - order) % BEARINGS)[:, None])
    ends_m = jnp.maximum(distance, distance[following])
    return jnp.any(between & (reach_m > ends_m[:, None] + P.places.leads_on_m), axis=1)


def _pockets(point, whole, first, last, valid, width_m):
    """Classify the area beyond gaps of a circle: a passage that leads on, or a pocket whose walls are all in sight.
    Returns `(stays, door, following)`: `[K]` bool, gaps that are exits themselves; `[BEARINGS]` bool, directions after
    which a door opens in the wall of a pocket; `[BEARINGS]` int32, its end."""
    one, other = point[first], point[last]
    along = other - one
    chord = jnp.maximum(jnp.hypot(*along.T), 1e-6)
    outward = jnp.stack([along[:, 1], -along[:, 0]], axis=1) / chord[:, None]
    place, far, here = whole
    between = (jnp.arange(BEARINGS) - first[:, None]) % BEARINGS < ((last - first) % BEARINGS)[:, None]  # [K, BEARINGS]
    depth = jnp.einsum("bd,kd->kb", place, outward) - jnp.sum(one * outward, axis=1)[:, None]
    known = between & here
    ordered = jnp.sort(jnp.where(known, depth, jnp.inf), axis=1)
    n = jnp.sum(known, axis=1)
    seen = n > P.places.seen * jnp.sum(between, axis=1)
    deep = ordered[jnp.arange(len(first)), jnp.minimum((P.places.deep * n).astype(jnp.int32), BEARINGS - 1)]
    pocket = valid & seen & (deep < P.places.pocket * chord)
    # A piece of wall all of which lies beyond is seen through a door.
    ends = find_gaps(place, place, here, width_m)[2]
    piece = (running_sum(ends.astype(jnp.float32)) - ends) % jnp.maximum(jnp.sum(ends), 1)
    least = jnp.min(jnp.where((piece[:, None] == piece) & known[:, None, :], depth[:, None, :], jnp.inf), axis=2)
    beyond = known & (least > deep[:, None] + P.places.beyond_pocket_m) & pocket[:, None]
    ring = here & ~jnp.any(beyond, axis=0)
    open_, after = find_gaps(place, far, ring, width_m)[2], _next(ring)
    # Where a wall is seen from the side its points lie far apart, in directions next to each other: no door.
    open_ &= (after - jnp.arange(BEARINGS)) % BEARINGS >= P.places.door
    # Nor where a passage is not known farther: its ends lie beyond the points taken for its wall.
    flat = depth <= deep[:, None] + P.places.beyond_pocket_m
    inside = between & pocket[:, None] & flat & flat[:, after]
    door = open_ & jnp.any(inside, axis=0)
    has_door = jnp.any(inside & open_, axis=1)
    return valid & ~(pocket & (has_door | (deep < P.places.corner_depth * chord))), door, after


def find_openings(xy: Array, valid: Array, centre: Array, radius_m: Array | float, width_m: Array | float, *,
             circle: Array | float, size: int, seen_from: Array | None = None) -> Openings:  # fmt: skip
    """Find gaps between neighbouring points in a circle, seen from its centre, that a robot fits through.

    Args:
      circle: radius of the search circle [k], in `radius_m`; points beyond it are left out.
      size: K, most openings. Static.
      seen_from: `[2]` float32, position of the robot: a gap narrower than `graze_rad` from there is a wall seen at a
        grazing angle. None keeps all.

    Returns:
      `Openings`; empty without a point in the circle.

    Source:
      Mano et al., section III.B and Fig. 2(f). Changed: points in polar order about the centre; the paper takes those
      of one scan, in polar order about the robot, which does not see behind it. A wall no nearer to the centre than
      `near_wall_radii` radii (or as many distances of the nearest wall, if larger) does not divide an opening, unless
      that leaves a gap as narrow as a door which leads on. Where a gap leads into a pocket whose walls are all in
      sight, the doors in these count instead; a corner does not, unless there is no other exit.
    """
    offset = xy - centre
    search_m = circle * radius_m
    distance = jnp.hypot(*offset.T)
    point, last, here = polar_points(offset, distance, valid & (distance <= search_m), search_m)
    whole = polar_points(offset, distance, valid, P.places.max_point_m)
    # A wall is what lies between two gaps.
    after, gap_m, gap_here = find_gaps(point, last, here, width_m)
    gap_here &= ~_grazes(point, after, here, centre, seen_from)
    wall = (running_sum(gap_here.astype(jnp.float32)) - gap_here) % jnp.maximum(jnp.sum(gap_here), 1)
    distance = jnp.where(here, jnp.hypot(*point.T), jnp.inf)
    nearest_m = jnp.min(jnp.where(wall[:, None] == wall, distance[:, None], jnp.inf), axis=0)
    door = (
        gap_here
        & (gap_m < jnp.maximum(P.places.narrow * radius_m, P.places.door_m))
        & _leads_out(distance, here, whole)
    )
    beside = jnp.any(door & ((wall[:, None] == wall) | (wall[:, None] == wall[_next(here)])), axis=1)
    here &= (nearest_m <= P.places.near_wall_radii * jnp.maximum(radius_m, jnp.min(distance))) | beside
    after, width, gap_here = find_gaps(point, last, here, width_m)
    gap_here &= ~_grazes(point, after, here, centre, seen_from)
    only = jnp.sum(here) == 1
    chosen = first_true(gap_here, size)
    valid = jnp.any(chosen, axis=1)
    begins = jnp.argmax(chosen, axis=1)
    order = (begins[:, None] + 1 + jnp.arange(BEARINGS)) % BEARINGS
    ends = order[jnp.arange(size), jnp.argmax(here[order], axis=1)]
    stays, door, door_end = _pockets(point, whole, begins, ends, valid & ~only, width_m)
    middle, across, narrowest = _narrowest(point, here, gap_here, begins, ends, radius_m)
    middle = jnp.where(only, -point[jnp.argmax(here)], middle)
    across = jnp.where(only, jnp.arctan2(middle[:, 1], middle[:, 0]), across)
    wide = jnp.where(only, jnp.sum(jnp.where(gap_here, width, 0)), narrowest)
    doors = _pocket_doors(whole[0], door, door_end, size)
    stays |= valid & only
    own = jnp.where(jnp.any(stays) | jnp.any(doors[0]), stays, valid), middle, across, wide
    more = jnp.sum(gap_here, dtype=jnp.int32) - size, jnp.sum(door, dtype=jnp.int32) - size
    together = [jnp.concatenate(pair) for pair in zip(own, doors)]
    return sort_openings(together, jnp.maximum(more[0], 0) + jnp.maximum(more[1], 0), size)


def first_true(mask: Array, size: int) -> Array:
    """Return which value each of the first K True ones of a mask is: `[K, N]` bool."""
    number = running_sum(mask.astype(jnp.float32)).astype(jnp.int32) - 1
    return mask & (number == jnp.arange(size)[:, None])


def _pocket_doors(place, door, door_end, size):
    """Find doors in the walls of pockets: `(valid, middle, across, width)` of as many."""
    chosen = first_true(door, size)
    at = jnp.argmax(chosen, axis=1)
    one, other = place[at], place[door_end[at]]
    along = other - one
    return jnp.any(chosen, axis=1), (one + other) / 2, jnp.arctan2(-along[:, 0], along[:, 1]), jnp.hypot(*along.T)


def sort_openings(together, more, size):
    """Sort `Openings` counter-clockwise, of which some did not fit before."""
    valid, middle, across, wide = together
    # The direction of its passage, if from the centre it looks much like that and no other opening does.
    towards = jnp.arctan2(middle[:, 1], middle[:, 0])
    off = jnp.abs(wrapped(across[:, None] - across))
    alone = jnp.sum(valid & (off < P.places.same_exit_rad), axis=1) == 1
    away = jnp.abs(wrapped(across - towards))
    # Of a gap wider than half a turn the narrowest place lies on the other side of the centre.
    bearing = jnp.where((alone & (away < P.places.straight_rad)) | (away > math.pi / 2), across, towards)
    order = jnp.argsort(jnp.where(valid, towards, jnp.inf))[:size]
    more += jnp.maximum(jnp.sum(valid, dtype=jnp.int32) - size, 0)
    there = valid[order]
    return Openings(
        bearing=jnp.where(there, bearing[order], 0),
        middle=jnp.where(there[:, None], middle[order], 0),
        across=jnp.where(there, across[order], 0),
        width_m=jnp.where(there, wide[order], 0),
        valid=there,
        overflow=more,
    )


def _narrowest(point, here, gap_here, first, last, radius_m):
    """Find the narrowest place between the walls on both sides of gaps. Returns `(middle, across, width)`: `[K, 2]`;
    `[K]`, direction square to the connection, outward; its length. Nearly as short connections are averaged too,
    against noise on even walls."""
    before = (first[:, None] - jnp.arange(WALL)) % BEARINGS
    # No gap lies between a point of the wall before and the gap: none has begun on the way back from it.
    begun = jnp.cumsum(gap_here[before], axis=1) - 1
    is_before = here[before] & (begun == 0)
    after = (last[:, None] + jnp.arange(WALL)) % BEARINGS
    begun = jnp.cumsum(gap_here[after], axis=1) - gap_here[after]
    is_after = here[after] & (begun == 0)
    left, right = point[before], point[after]  # [K, WALL, 2] each
    length = jnp.hypot(left[:, :, None, 0] - right[:, None, :, 0], left[:, :, None, 1] - right[:, None, :, 1])
    ends = left[:, 0], right[:, 0]
    along = ends[1] - ends[0]
    outward = jnp.stack([along[:, 1], -along[:, 0]], axis=1) / jnp.maximum(jnp.hypot(*along.T), 1e-6)[:, None]
    out = jnp.einsum("kid,kd->ki", left, outward)[:, :, None] + jnp.einsum("kjd,kd->kj", right, outward)[:, None, :]
    beside = out / 2 >= P.places.ahead_radii * radius_m
    # With one wall only, both its ends are meant, not two places in its middle.
    steps = jnp.arange(WALL)[:, None] + jnp.arange(WALL)
    apart = steps < P.places.both_ends * ((first - last) % BEARINGS)[:, None, None]
    meant = is_before[:, :, None] & is_after[:, None, :] & beside & apart
    length = jnp.where(meant, length, jnp.inf)
    least = jnp.min(length, axis=(1, 2), keepdims=True)
    chord = (ends[0] + ends[1]) / 2, jnp.arctan2(outward[:, 1], outward[:, 0]), jnp.hypot(*along.T)
    weight = jnp.where(length < least + 6 * P.places.alike_m, jnp.exp(-(length - least) / P.places.alike_m), 0)
    total = jnp.maximum(jnp.sum(weight, axis=(1, 2)), 1e-9)
    ends = [
        jnp.einsum("kij,kid->kd", weight, left) / total[:, None],
        jnp.einsum("kij,kjd->kd", weight, right) / total[:, None],
    ]
    middle, along = (ends[0] + ends[1]) / 2, ends[1] - ends[0]
    found = middle, jnp.arctan2(-along[:, 0], along[:, 1]), least[:, 0, 0]
    there = least[:, 0, 0] < jnp.inf  # else the gap itself is the narrowest place
    return tuple(jnp.where(there[:, None] if one.ndim > 1 else there, one, two) for one, two in zip(found, chord))
