"""Driving along passages: the run mode and the target point.

The modes, highest priority first (Mano et al., section IV.B and Fig. 8; a figure that did not survive): contact guard,
branch selection, dead end run, wall following, central run. All states have a fixed size; all functions are pure.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array, lax

from jexplore.driving import manoeuvre
from jexplore.driving.params.tree import P
from jexplore.driving.records import (
    Divergence,
    Drive,
    Latch,
    RunMode,
    ScanWalls,
    Track,
)
from jexplore.driving.sensing import perception
from jexplore.driving.settings import Robot, Tuning

VOTING_SCANS = 9  # scans that vote


def empty_track() -> Track:
    """Return a `Track` with nothing ahead."""
    return Track(jnp.zeros(2), jnp.float32(0), jnp.uint32(0), jnp.int32(0))


def votes(track: Track) -> Array:
    """Count the scans among the last `VOTING_SCANS` that showed the divergence: int32."""
    return lax.population_count(track.seen).astype(jnp.int32)


def is_believed(track: Track, needed: Array | int) -> Array:
    """Return whether enough scans have shown the divergence."""
    return (track.age > 0) & (votes(track) >= needed)


def update_track(
    track: Track,
    found: Divergence,
    to_odometry: Callable[[Array], Array],
    same_m: Array | float,
    may_begin: Array | bool,
) -> Track:
    """Update a track with one more scan.

    The largest triangle that is near enough to the one followed goes on with it; else the triangle nearest to the
    robot begins a new one, but not while one is being followed that more than `replaceable_votes` scans have shown. One
    that `VOTING_SCANS` scans have not shown is given up.

    Args:
      found: `records.Divergence`, in the robot's frame, without triangles that are to be ignored.
      to_odometry: function from points `[..., 2]` in the robot's frame to the odometry's.
      same_m: how near, metres.
      may_begin: bool; False: only the one that is followed goes on.
    """
    placed = found.replace(centre=to_odometry(found.centre))
    followed = track.age > 0
    # Noise makes small circles in any passage; of those near enough the largest has three walls.
    near = placed.valid & (jnp.sum((placed.centre - track.centre) ** 2, axis=1) < same_m**2)
    again = jnp.argmax(jnp.where(near, placed.radius, -1)).astype(jnp.int32)
    hit = followed & near[again]
    first, distance = perception.nearest(found, jnp.zeros(2))
    begins = may_begin & ~hit & (~followed | (votes(track) <= P.motion.replaceable_votes)) & (distance < jnp.inf)
    followed &= ~begins
    which = jnp.where(hit, again, first)
    share = jnp.where(hit, 1 / jnp.minimum(track.age + 1.0, VOTING_SCANS), 1.0)
    taken = hit | begins
    seen = jnp.where(followed, (track.seen << 1) & jnp.uint32(2**VOTING_SCANS - 1), 0) | taken.astype(jnp.uint32)
    going = (followed | begins) & (seen != 0)

    def blended(old, new):
        return jnp.where(taken, old + share * (new - old), old)

    return Track(
        centre=blended(track.centre, placed.centre[which]),
        radius=blended(track.radius, found.radius[which]),
        seen=jnp.where(going, seen, 0),
        age=jnp.where(going, jnp.where(followed, track.age + 1, 1), 0),
    )


def is_free_space(left_m: Array | float, right_m: Array | float, open_m: Array | float) -> Array:
    """Return whether walls at these distances to the left and right are those of free space: bool.

    Between them there is room for a circle whose radius is `open_m` [C1].

    Source:
      Mano et al., section III.A.2. Changed: there one wall is farther than C1; a room entered along a wall would be
      free space.
    """
    return jnp.asarray(left_m + right_m > 2 * open_m)


def watch_free_space(
    inside: Array,
    left_m: Array | float,
    right_m: Array | float,
    open_m: Array | float,
    looking: Array | bool,
    roomy: Array | bool = True,
) -> tuple[Array, Array, Array]:
    """Judge by the walls of one more scan whether the robot is in free space.

    Args:
      inside: bool, whether it was.
      looking: bool; False: nothing changes.
      roomy: from `perception.is_roomy`; where it is False, no free space is entered.

    Returns:
      `(inside, enters, leaves)`: bools, the last two true in the step in which it changes.
    """
    free = is_free_space(left_m, right_m, open_m) & (roomy | inside)
    changes = looking & (free != inside)
    return inside ^ changes, changes & ~inside, changes & inside


def border_ahead(
    border_m: Array, odometer_m: Array, enters: Array, leaves: Array, region: tuple[Array | float, Array | float]
) -> tuple[Array, Array]:
    """Track the border of a free space that the robot sees ahead.

    If the free space begins again before the robot has come to its end, it has not ended: a stretch of walls shorter
    than the observed region does not divide it.

    Args:
      border_m: float32, odometer at the border seen before, inf without one.
      odometer_m: float32, now.
      enters, leaves: bools, from `watch_free_space`.
      region: begin and end of the observed region, metres ahead.

    Returns:
      `(border_m, missed)`: updated; bool, the free space ended before the robot reached its beginning.
    """
    waits = jnp.isfinite(border_m)
    after_m = jnp.where(enters, jnp.where(waits, jnp.inf, odometer_m + region[0]), border_m)
    return jnp.where(leaves, odometer_m + region[1], after_m), waits & leaves


def initial_drive() -> Drive:
    """Return an empty memory; passages count as two metres wide until a wall is seen."""
    return Drive(
        latch=jnp.int32(Latch.FREE),
        target=jnp.zeros(2),
        since=jnp.int32(0),
        out=jnp.float32(0),
        looked=jnp.float32(0),
        looked_m=jnp.float32(-jnp.inf),
        turning=jnp.int32(0),
        left_m=jnp.float32(1),
        right_m=jnp.float32(1),
    )


def choose_mode(
    drive: Drive, inside: Array, walls: ScanWalls, ways_m: Array, tuning: Tuning, robot: Robot
) -> tuple[Array, Drive]:
    """Choose the run mode of this step.

    Returns:
      `(mode, drive)`: `RunMode` as int32; a dead end keeps the side to which it turns until the way is open. It turns
        to the larger side, from a wall near one half of its front to the other.
    """
    left_m, right_m, fronts_m = walls.left_m, walls.right_m, walls.fronts_m
    guarded = (jnp.minimum(*fronts_m) < robot.length_m / 2) & ~manoeuvre.is_free_ahead(ways_m, P.motion.go_m)
    closed = walls.closed & ~manoeuvre.is_free_ahead(ways_m, P.motion.past_end_m)
    latched = drive.latch != Latch.FREE
    # One scan suffices to drive by, several in a row make a node.
    free = inside | (is_free_space(walls.region_sides[0], walls.region_sides[1], tuning.open_m) & walls.roomy)
    mode = jnp.where(free, RunMode.WALL_FOLLOWING, RunMode.CENTRAL)
    mode = jnp.where(closed, RunMode.DEAD_END, mode)
    mode = jnp.where(latched, RunMode.BRANCH_SELECTION, mode)
    mode = jnp.where(guarded & (drive.latch != Latch.LOOK), RunMode.CONTACT_GUARD, mode).astype(jnp.int32)
    larger = jnp.where(drive.left_m >= drive.right_m, 1, -1)
    larger = jnp.where(fronts_m[0] != fronts_m[1], jnp.where(fronts_m[0] > fronts_m[1], 1, -1), larger)
    turns = (mode == RunMode.DEAD_END) | (mode == RunMode.CONTACT_GUARD)
    turning = jnp.where(turns, jnp.where(drive.turning == 0, larger, drive.turning), 0)
    by_walls = ~free & ~closed & ~latched
    least_m = jnp.hypot(robot.length_m, robot.width_m) / 2 + P.sensing.outline_margin_m
    return mode, drive.replace(
        turning=turning.astype(jnp.int32),
        left_m=jnp.where(by_walls & (left_m < tuning.open_m), jnp.maximum(left_m, least_m), drive.left_m),
        right_m=jnp.where(by_walls & (right_m < tuning.open_m), jnp.maximum(right_m, least_m), drive.right_m),
    )


def target_point(
    mode: Array,
    drive: Drive,
    left_m: Array,
    right_m: Array,
    edge: tuple[Array, Array],
    to_robot: Callable[[Array], Array],
    tuning: Tuning,
) -> Array:
    """Compute the target point in the robot's frame: `[2]` float32, metres.

    In a passage it lies on the middle between the walls, in free space at the distance from the followed wall that the
    passage before had: the nearer wall, or where both sides are open the one that was nearer last.

    Source:
      Mano et al., equations 3 and 4.
    """
    open_left, open_right = left_m > tuning.open_m, right_m > tuning.open_m
    right = jnp.where(open_left & open_right, drive.right_m < drive.left_m, left_m > right_m)
    lateral = jnp.where(right, drive.right_m - right_m, left_m - drive.left_m)
    lateral = jnp.where(jnp.isfinite(lateral), jnp.clip(lateral, -tuning.ahead_m, tuning.ahead_m), 0)
    wall = jnp.stack([jnp.float32(1) * tuning.ahead_m, lateral])
    along, off_m = edge
    off_m = jnp.clip(off_m, -tuning.ahead_m, tuning.ahead_m)
    cos, sin = jnp.cos(along), jnp.sin(along)
    middle = jnp.stack([tuning.ahead_m * cos + off_m * sin, tuning.ahead_m * sin - off_m * cos])
    ahead = jnp.where((mode == RunMode.WALL_FOLLOWING) | (open_left ^ open_right), wall, middle)
    return jnp.where(mode == RunMode.BRANCH_SELECTION, to_robot(drive.target), ahead)
