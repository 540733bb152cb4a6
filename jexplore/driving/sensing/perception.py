"""Perception of one scan: walls along the way, triangles at divergences, openings round a place.

Scans are in the robot's frame: x forward, y left, metres. A beam without a reading is no point; NaN counts as none.
"""

import jax.numpy as jnp
from jax import Array, lax
from jax.typing import ArrayLike

from jexplore.arrays.delaunay import circumcircles, delaunay
from jexplore.arrays.loops import stored
from jexplore.driving.params.tree import P
from jexplore.driving.records import Divergence
from jexplore.driving.settings import Tuning
from jexplore.driving.vehicle import BEAM_SPACING_RAD

SCAN_POINTS = 64  # of a scan that are made into triangles
SMOOTHED_BEAMS = 6  # beams on either side that a point is smoothed with
BRIDGED_BEAMS = 3  # beams without a reading that are bridged
CLEARANCE_BEAMS = 3  # beams on either side that the width of a passage is the mean of
ROOMY_BACK_RADII = 0.0, 0.2, 0.4, 0.6  # radii by which that may begin nearer


def beam_points(ranges_m: Array, angles_rad: ArrayLike) -> tuple[Array, Array]:
    """Convert ranges to points.

    Args:
      ranges_m: `[B]` float32; inf: no return; NaN: no reading.
      angles_rad: `[B]` float32.

    Returns:
      `(xy, valid)`: `[B, 2]` float32, 0 where invalid; `[B]` bool. Up to `BRIDGED_BEAMS` beams without a reading
        between two that nearly agree are given the mean of these.
    """
    before = after = ranges_m
    missed = -jnp.ones_like(ranges_m)
    for k in range(1, BRIDGED_BEAMS + 1):
        missed = missed + jnp.isnan(before) + jnp.isnan(after)
        before = jnp.where(jnp.isnan(before), jnp.pad(ranges_m, (k, 0), constant_values=jnp.nan)[:-k], before)
        after = jnp.where(jnp.isnan(after), jnp.pad(ranges_m, (0, k), constant_values=jnp.nan)[k:], after)
    bridged = jnp.isnan(ranges_m) & (missed <= BRIDGED_BEAMS)
    ranges_m = jnp.where(bridged, (before + after) / 2, ranges_m)
    valid = jnp.isfinite(ranges_m)
    r = jnp.where(valid, ranges_m, 0)
    return jnp.stack([r * jnp.cos(angles_rad), r * jnp.sin(angles_rad)], axis=1), valid


def smooth_points(xy: Array, valid: Array, reach_m: Array | float) -> Array:
    """Move every point to the mean of its wall's points near it: many close by, few far away.

    Args:
      reach_m: how near, metres; float32.
    """
    n = xy.shape[0]
    x, y = (jnp.pad(xy[:, i], SMOOTHED_BEAMS) for i in range(2))
    there = jnp.pad(valid, SMOOTHED_BEAMS)
    here = xy[:, 0], xy[:, 1]

    def added(k, sums):
        *other, known = (lax.dynamic_slice(a, (k,), (n,)) for a in (x, y, there))
        near = (other[0] - here[0]) ** 2 + (other[1] - here[1]) ** 2 <= reach_m**2
        weight = (near & known).astype(jnp.float32)
        return [total + weight * value for total, value in zip(sums, (*other, 1.0))]

    sums = lax.fori_loop(0, 2 * SMOOTHED_BEAMS + 1, added, [jnp.zeros(n)] * 3)
    count = jnp.maximum(sums[2], 1)
    return jnp.where(valid[:, None], jnp.stack([sums[0] / count, sums[1] / count], axis=1), xy)


def sides(xy: Array, valid: Array, from_m: Array | float, to_m: Array | float) -> tuple[Array, Array]:
    """Compute the least distance to the walls on both sides, in a region of fixed length before the robot.

    Returns:
      `(left_m, right_m)`: float32, inf where the side is open.

    Source:
      Mano et al., section III.A and Fig. 3. Changed: left is left (the text names both the other way round).
    """
    within = valid & (xy[:, 0] >= from_m) & (xy[:, 0] <= to_m)
    y = xy[:, 1]
    left = jnp.min(jnp.where(within & (y >= 0), y, jnp.inf))
    right = jnp.min(jnp.where(within & (y <= 0), -y, jnp.inf))
    return left, right


def is_roomy(
    xy: Array, valid: Array, from_m: Array | float, left_m: Array, right_m: Array, open_m: Array | float
) -> Array:
    """Return whether a circle as large as free space fits next to the nearer wall somewhere ahead: bool.

    Args:
      from_m: begin of the circle, metres before the robot, or nearer by up to `ROOMY_BACK_RADII` of its radius: an
        obstacle abeam may have hidden it earlier.
    """
    at_left = left_m > right_m
    wall = jnp.minimum(jnp.minimum(left_m, right_m), open_m)
    aside = jnp.where(at_left, 1, -1) * (open_m - wall)
    ahead = from_m + open_m * (1 - jnp.asarray(ROOMY_BACK_RADII))  # [K]
    off2 = (xy[:, 0] - ahead[:, None]) ** 2 + (xy[:, 1] - aside) ** 2
    return jnp.any(~jnp.any(valid & (off2 < open_m**2), axis=1))


def clearances(xy: Array, valid: Array, to_m: Array | float) -> tuple[Array, Array]:
    """Compute distances of the walls on both sides: the least mean of neighbouring beams, which noise hardly biases.

    Points more ahead than aside are left out.

    Returns:
      `(left_m, right_m)`: float32, inf where the side is open.
    """
    within = valid & (xy[:, 0] >= 0) & (xy[:, 0] <= jnp.minimum(to_m, jnp.abs(xy[:, 1])))
    n, y = xy.shape[0], jnp.where(within, xy[:, 1], jnp.inf)
    padded = jnp.pad(y, CLEARANCE_BEAMS, constant_values=jnp.inf)

    def added(k, sums):
        other = lax.dynamic_slice(padded, (k,), (n,))
        near = jnp.isfinite(other) & (other * y > 0)
        return sums[0] + jnp.where(near, other, 0), sums[1] + near

    total, count = lax.fori_loop(0, 2 * CLEARANCE_BEAMS + 1, added, (jnp.zeros(n), jnp.zeros(n)))
    mean = jnp.where(within, total / jnp.maximum(count, 1), jnp.inf)
    left = jnp.min(jnp.where(y >= 0, mean, jnp.inf))
    right = jnp.min(jnp.where(y <= 0, -mean, jnp.inf))
    return left, right


def front(xy: Array, valid: Array, width_m: Array | float) -> tuple[Array, Array]:
    """Return distances of the nearest points ahead of the left and right halves: float32, metres; inf for none."""
    ahead = valid & (jnp.abs(xy[:, 1]) <= width_m / 2) & (xy[:, 0] > 0)
    left = jnp.min(jnp.where(ahead & (xy[:, 1] >= 0), xy[:, 0], jnp.inf))
    right = jnp.min(jnp.where(ahead & (xy[:, 1] <= 0), xy[:, 0], jnp.inf))
    return left, right


def resample_walls(
    xy: Array,
    valid: Array,
    near_m: Array | float,
    far_m: Array | float,
    aside_m: Array | float,
    spacing_m: Array | float,
    *,
    size: int,
) -> tuple[Array, Array, Array, Array]:
    """Place points at even distances along the walls that a scan shows, and at both ends of every wall.

    Args:
      near_m, far_m: only points with near < x < far.
      aside_m: only points with abs(y) < aside.
      spacing_m: distance along a wall, metres; more where the points would not fit.
      size: n, most points; a quarter of them for ends of walls. Static.

    Returns:
      `(points, valid, spacing_m, overflow)`: `[n, 2]` float32, `[n]` bool; the distance taken; ends that did not fit.
    """
    inside = valid & (xy[:, 0] > near_m) & (xy[:, 0] < far_m) & (jnp.abs(xy[:, 1]) < aside_m)
    step = jnp.hypot(*jnp.diff(xy, axis=0).T)
    # A wall goes on from beam to beam; it does not where a beam is missing or points lie two spacings apart.
    jump = ~(inside[1:] & inside[:-1]) | (step > 1 / P.places.spacing_widths * spacing_m)
    edge = jnp.ones(1, bool)
    ends = inside & (jnp.concatenate([edge, jump]) | jnp.concatenate([jump, edge]))
    along = jnp.cumsum(jnp.concatenate([jnp.zeros(1), jnp.where(jump, 0, step)]))
    n_ends = size // 4
    n_ticks = size - n_ends
    spacing = jnp.maximum(spacing_m, along[-1] / n_ticks)

    tick = (jnp.arange(n_ticks, dtype=jnp.float32) + 0.5) * spacing
    before = jnp.sum(along <= tick[:, None], axis=1, dtype=jnp.int32) - 1  # the beam before each tick
    on_wall = tick < along[-1]
    before = jnp.where(on_wall, before, 0)
    share = jnp.where(on_wall, (tick - along[before]) / jnp.where(step > 0, step, 1)[before], 0)
    ticks = xy[before] + share[:, None] * (xy[before + 1] - xy[before])
    place = jnp.where(ends, jnp.cumsum(ends) - 1, n_ends)
    ended = jnp.zeros((n_ends, 2)).at[place].set(xy, mode="drop")
    there = jnp.concatenate([on_wall, jnp.arange(n_ends) < jnp.sum(ends)])
    overflow = jnp.maximum(jnp.sum(ends, dtype=jnp.int32) - n_ends, 0)
    return jnp.concatenate([ticks, ended]), there, spacing, overflow


def far_bound(
    far_m: Array | float, width_m: Array | float, beam_spacing_rad: Array | float, wall_m: Array | float
) -> Array:
    """Compute the distance up to which neighbouring beams on a wall lie closer than the least opening: metres."""
    return jnp.minimum(far_m, 0.95 * jnp.sqrt(width_m * jnp.minimum(wall_m, far_m) / beam_spacing_rad))


def find_divergences(xy: Array, valid: Array, wall_m: Array | float, tuning: Tuning) -> Divergence:
    """Find triangles that touch three walls: between them the way divides, bends or ends.

    Args:
      xy, valid: `[B, 2]`, `[B]`, points around the robot, `wall_m` from the nearer wall.

    Source:
      Mano et al., section III.A.1; Silver et al. 2004. Changed: the tolerance (a dead end's triangle has a right angle,
      so that half of all scans would lose it), and circles in free space are left out.
    """
    width_m, open_m = tuning.width_m, tuning.open_m
    far_m = far_bound(tuning.far_m, width_m, BEAM_SPACING_RAD, wall_m)
    # Beams far aside meet a wall next to a tilted robot too far apart, however near ahead.
    valid &= jnp.sum(xy**2, axis=1) < far_m**2
    xy = smooth_points(xy, valid, width_m / 4)
    chosen, there, spacing, overflow = resample_walls(
        xy, valid, -far_m, far_m, open_m, P.places.spacing_widths * width_m, size=SCAN_POINTS
    )
    triangles = delaunay(chosen, there)
    centre, radius, side2 = circumcircles(chosen, triangles.corner)
    longest = jnp.max(side2, axis=1)
    product = jnp.sqrt(side2[:, 0] * side2[:, 1] * side2[:, 2] / jnp.maximum(longest, 1e-12))  # of the shorter sides
    cosine = (jnp.sum(side2, axis=1) - 2 * longest) / jnp.maximum(2 * product, 1e-12)  # of the largest angle
    # Two points with one between them on a wall make no side: noise may push that one out of the circle.
    side = jnp.maximum(width_m, spacing / P.places.spacing_widths)
    keep = triangles.valid & (jnp.min(side2, axis=1) > side**2) & (radius < open_m)
    keep &= cosine >= -jnp.sin(jnp.radians(tuning.obtuse_tol_deg))
    keep &= ~_on_one_wall(chosen, there, centre, triangles.corner, P.places.recess_widths * width_m)
    corners = chosen[jnp.minimum(triangles.corner, SCAN_POINTS - 1)]
    return Divergence(corners=corners, centre=centre, radius=radius, valid=keep, overflow=overflow + triangles.overflow)


def _on_one_wall(xy, valid, centre, corner, recess_m):
    """Return which circles touch one wall twice: `[T]` bool. Between two corners the points follow the chord
    closely."""
    n = xy.shape[0]
    corner = jnp.minimum(corner, n - 1)

    def corners():  # counter-clockwise
        (ax, ay), (bx, by), (cx, cy) = (xy[corner[:, i]].T for i in range(3))
        is_left = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) >= 0
        second, third = (jnp.where(is_left, bx, cx), jnp.where(is_left, by, cy)), jnp.where(is_left, cx, bx)
        return ((ax, ay), second, (third, jnp.where(is_left, cy, by))), (centre[:, 0], centre[:, 1]), corner

    # Stored, so that no corner is looked up anew for every point.
    place, (mid_x, mid_y), corner = stored(recess_m >= 0, corners)
    place = [(x - mid_x, y - mid_y) for x, y in place]
    # [n, T], so that sums over the points run along rows, which a CPU does many at a time.
    x, y = xy[:, 0, None] - mid_x, xy[:, 1, None] - mid_y
    number = jnp.arange(n)[:, None]
    is_other = valid[:, None] & (number != corner[:, 0]) & (number != corner[:, 1]) & (number != corner[:, 2])
    one_wall = jnp.zeros(centre.shape[0], bool)
    for side in range(3):
        (from_x, from_y), (to_x, to_y) = place[side], place[(side + 1) % 3]
        chord_x, chord_y = to_x - from_x, to_y - from_y
        chord_m = jnp.maximum(jnp.hypot(chord_x, chord_y), 1e-9)
        is_beyond = (x - from_x) * chord_y - (y - from_y) * chord_x > recess_m * chord_m
        between = is_other & (_turned_left(from_x, from_y, x, y) < _turned_left(from_x, from_y, to_x, to_y))
        one_wall |= ~jnp.any(between & is_beyond, axis=0)
    return one_wall


def _turned_left(x, y, to_x, to_y):
    """Return a monotonic measure, 0 to 4, of the counter-clockwise angle from one direction to another."""
    dot, cross = x * to_x + y * to_y, x * to_y - y * to_x
    share = cross / jnp.maximum(jnp.abs(dot) + jnp.abs(cross), 1e-30)
    return jnp.where(dot < 0, 2 - share, jnp.where(cross < 0, 4 + share, share))
