"""Driving along passages: the run mode and the target point.

The modes, highest priority first (Mano et al., section IV.B and Fig. 8; a figure that did not survive): contact guard,
branch selection, dead end run, wall following, central run. All states have a fixed size; all functions are pure.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array, lax

from jexplore.driving.params.tree import P
from jexplore.driving.records import Divergence, Drive, Latch, RunMode, ScanWalls, Track
from jexplore.driving.sensing.surround import DIRECTIONS
from jexplore.driving.settings import WHOLE, Robot, Tuning

VOTING_SCANS = WHOLE["votes"]  # scans that vote


def votes(track: Track) -> Array:
    """Count the scans among the last `VOTING_SCANS` that showed the divergence: int32."""
    return lax.population_count(track.seen)


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
    first = jnp.argmin(jnp.where(found.valid, jnp.sum(found.centre**2, axis=1), jnp.inf)).astype(jnp.int32)
    begins = may_begin & ~hit & (~followed | (votes(track) <= P.motion.replaceable_votes)) & found.valid[first]
    followed &= ~begins
    which = jnp.where(hit, again, first)
    share = jnp.where(hit, 1 / jnp.minimum(track.age + 1.0, VOTING_SCANS), 1.0)
    taken = hit | begins
    seen = jnp.where(followed, (track.seen << 1) & (2**VOTING_SCANS - 1), 0) | taken
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
    inside: Array, border_m: Array, odometer_m: Array, walls: ScanWalls, looks: Array | bool, tuning: Tuning
) -> tuple[Array, Array, Array]:
    """Judge by the walls of one more scan whether the robot is in free space, and where it will cross its border.

    If the free space begins again before the robot has come to its end, it has not ended: a stretch of walls shorter
    than the observed region does not divide it.

    Args:
      inside: bool, whether it was.
      border_m: float32, odometer at the border seen before, inf without one.
      looks: bool; False: nothing changes.

    Returns:
      `(inside, border_m, missed)`: updated; bool, the free space ended before the robot reached its beginning.
    """
    free = is_free_space(*walls.region_sides, tuning.open_m) & (walls.roomy | inside)
    changes, waits, (begin_m, end_m) = looks & (free != inside), jnp.isfinite(border_m), tuning.region
    leaves = changes & inside
    after_m = jnp.where(changes & ~inside, jnp.where(waits, jnp.inf, odometer_m + begin_m), border_m)
    return inside ^ changes, jnp.where(leaves, odometer_m + end_m, after_m), waits & leaves


def choose_mode(
    drive: Drive, inside: Array, walls: ScanWalls, ways_m: Array, tuning: Tuning, robot: Robot
) -> tuple[Array, Drive]:
    """Choose the run mode of this step.

    Returns:
      `(mode, drive)`: `RunMode` as int32; a dead end keeps the side to which it turns until the way is open. It turns
        to the larger side, from a wall near one half of its front to the other.
    """
    left_m, right_m, fronts_m = walls.left_m, walls.right_m, walls.fronts_m
    ahead_m = ways_m[DIRECTIONS // 2]
    guarded = (jnp.minimum(*fronts_m) < robot.length_m / 2) & (ahead_m < P.motion.go_m)
    closed = walls.closed & (ahead_m < P.motion.past_end_m)
    latched = drive.latch != Latch.FREE
    # One scan suffices to drive by, several in a row make a node.
    free = inside | (is_free_space(*walls.region_sides, tuning.open_m) & walls.roomy)
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
