"""The openings of a search circle: gaps between the walls in it."""

import math

import jax.numpy as jnp
from jax import Array

from jexplore.btm import wrapped
from jexplore.driving.params.tree import P
from jexplore.driving.records import Openings

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


def find_openings(
    xy: Array, valid: Array, centre: Array, radius_m: Array | float, width_m: Array | float, *,
    circle: Array | float, size: int, seen_from: Array | None = None,
) -> Openings:  # fmt: skip
    """Find gaps between neighbouring points in the search circle, seen from its centre, that a robot fits through.

    Args:
      circle: radius of the search circle [k], in `radius_m`; points beyond it are left out.
      size: K, most openings. Static.
      seen_from: `[2]` float32, position of the robot: a gap narrower than `graze_rad` from there is a wall seen at a
        grazing angle. None keeps all.

    Returns:
      `Openings`; empty without a point in the circle.

    Source:
      Mano et al., section III.B and Fig. 2(f). Changed: points in polar order about the centre; the paper takes those
      of one scan, in polar order about the robot, which does not see behind it.
    """
    offset, search_m = xy - centre, circle * radius_m
    distance = jnp.hypot(*offset.T)
    point, last, here = polar_points(offset, distance, valid & (distance <= search_m), search_m)
    after, width, gap_here = find_gaps(point, last, here, width_m)
    if seen_from is not None:
        gap_here &= ~_grazes(point, after, here, centre, seen_from)
    (begins,) = jnp.nonzero(gap_here, size=size, fill_value=BEARINGS)
    there, begins = begins < BEARINGS, jnp.minimum(begins, BEARINGS - 1)
    middle, bearing, narrowest = _narrowest(point, here, gap_here, begins, _next(here)[begins], radius_m)
    only = jnp.sum(here) == 1
    middle = jnp.where(only, -point[jnp.argmax(here)], middle)
    towards = jnp.arctan2(middle[:, 1], middle[:, 0])
    order = jnp.argsort(jnp.where(there, towards, jnp.inf))
    there, own = there[order], there[order][:, None]
    return Openings(
        bearing=jnp.where(there, jnp.where(only, towards, bearing)[order], 0),
        middle=jnp.where(own, middle[order], 0),
        width_m=jnp.where(there, jnp.where(only, jnp.sum(jnp.where(gap_here, width, 0)), narrowest)[order], 0),
        valid=there,
        overflow=jnp.maximum(jnp.sum(gap_here, dtype=jnp.int32) - size, 0),
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
    meant = is_before[:, :, None] & is_after[:, None, :] & beside
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
