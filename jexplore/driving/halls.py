"""Halls: the robot follows their walls, and before each gateway is a place where ways part.

That place and the ways along the wall are the extended Voronoi graph of a space too wide for the sensors, where
distances from its walls stand for a middle line (Beeson, Jong and Kuipers, Towards autonomous topological place
detection using the extended Voronoi graph, 2005).
"""

import math
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import pick, run_if
from jexplore.driving import behaviour, mapping
from jexplore.driving.records import (
    Drive,
    DueNode,
    FreeSpace,
    Latch,
    RunMode,
    ScanWalls,
    State,
    Surround,
    Track,
    Writer,
)
from jexplore.driving.sensing import gateways, surround
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import to_robot, towards

MOUTH_M = 1.0  # before the border of a hall its gateway is narrowest within this
ABEAM_M = 0.4  # m; a gateway is abeam if its middle is no farther ahead or behind
ROUND_M, ROUND_RAD = 6.0, 4.5  # m, rad; a robot back at its starting point after this way and turn has been round
BEGAN_M = 2.0  # within this: it may have begun in a corner
LEAVE_ISLAND_M = 4.0  # m; distance driven away from an island
OUT_COS = 0.7  # of the angle between a way and a gateway's axis from which on it leads out


def sides(within: Array, walls: ScanWalls) -> tuple[Array, Array]:
    """Return the distances of the left and right walls that decide about free space: float32, metres.

    A hall is left where both its walls are abeam of the robot: walls ahead may be those of a corner.

    Args:
      within: bool, whether the robot is in a hall.
    """
    return pick(within, tuple(walls.beside), walls.region_sides)


def coast(mode: Array, side: Array, around: Surround, tuning: Tuning, robot: Robot) -> Array:
    """Return the direction in which the robot follows the wall of a hall: float32, radians; NaN where it follows none."""
    follows = (mode == RunMode.WALL_FOLLOWING) & (tuning.coast_m > 0)
    none = jnp.float32(jnp.nan)
    return run_if(follows, lambda _: surround.wall_direction(around, side, tuning.coast_m, robot), none)


def abeam(
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
    there, middle, out, width_m = gateways.find_gateway(xy, valid, beside, side * math.pi / 2, tuning.width_m)
    found = _before(placed(middle), state.estimate[2] + out, width_m, tuning)
    known = mapping.is_near_known(writer, found.centre[None], state.odometer_m, tuning.leave_m)[0]
    there &= (jnp.abs(middle[0]) < ABEAM_M) & ~known & state.space.inside & (side != 0)
    return pick(there, found, track)


def crossed(writer: Writer, inside: Array, border_m: Array, tuning: Tuning) -> Track:
    """Return the place before the gateway by which the robot has entered or left a hall.

    No place results if the robot has not just passed between walls as near as a gateway's, or if it comes out by a
    gateway before which it has just been.

    Args:
      inside: bool, the robot is in the hall now.
      border_m: float32, odometer where it came to the border.
    """
    way = writer.way
    pose = mapping.pose_at(way, border_m)
    just = (way.odometer_m > border_m - MOUTH_M) & (way.odometer_m <= border_m)
    width_m = jnp.min(jnp.where(just, way.width_m, jnp.inf))
    out = pose[2] + jnp.where(inside, math.pi, 0.0)
    found = _before(pose[:2], out, jnp.minimum(width_m, gateways.MAX_GATEWAY_M), tuning)
    last = jnp.minimum(writer.node, writer.map.kind.shape[0] - 1)
    off_m = jnp.hypot(writer.map.x_m[last] - found.centre[0], writer.map.y_m[last] - found.centre[1])
    none = (width_m > gateways.MAX_GATEWAY_M) | (~inside & (off_m < 2 * tuning.coast_m))
    return pick(none, behaviour.empty_track(), found)


def looked(
    state: State, track: Track, around: Surround, placed: Callable[[Array], Array], tuning: Tuning
) -> tuple[Track, Array]:
    """Return the gateway before which the robot is, once it has looked round: `(track, bool: a gateway exists)`."""
    heading = state.estimate[2]
    out = track.out - heading
    middle = to_robot(state.estimate)(track.centre) + tuning.coast_m * towards(out)
    there, middle, out, width_m = gateways.find_gateway(*surround.known_points(around), middle, out, tuning.width_m)
    found = _before(placed(middle), heading + out, width_m, tuning)
    return pick(there, found, track), there


def _before(middle, out, width_m, tuning):
    """Return a believed `Track` of the place before a gateway, at the distance at which walls are followed."""
    centre = middle - tuning.coast_m * towards(out)
    return behaviour.certain_track(centre, jnp.hypot(tuning.coast_m, width_m / 2), out)


def gone_on(
    state: State,
    space: FreeSpace,
    drive: Drive,
    writer: Writer,
    event: DueNode,
    around: Surround,
    estimate: Array,
    tuning: Tuning,
) -> tuple[FreeSpace, Drive, Writer]:
    """Choose how the robot continues in a hall once a node has been made, or none was due.

    Returns:
      `(space, drive, writer)`: with the hall it stays in and the wall it follows; a hall without a gateway is exhausted
        once the robot has been all round.
    """
    space, drive = from_gateway(space, drive, event.out)
    drive, is_round = circled(state, drive, space, writer, around, estimate, event.kind != btm.NONE, tuning)
    return space, drive, writer.replace(exhausted=writer.exhausted | is_round)


def from_gateway(space: FreeSpace, drive: Drive, out: Array) -> tuple[FreeSpace, Drive]:
    """Decide at a gateway whether the robot stays in the hall, and which wall it follows.

    Args:
      out: float32, radians, direction of the gateway; NaN: the robot is at no gateway.

    Returns:
      `(space, drive)`.
    """
    is_before, to_left = jnp.isfinite(out), jnp.sin(drive.out - out) > 0
    stays = jnp.cos(drive.out - out) < OUT_COS
    after = behaviour.no_free_space().replace(inside=stays)
    space = pick(is_before, after, space)
    side = jnp.where(stays, jnp.where(to_left, -1, 1), 0)  # going to the left, it has the gateway's wall to the right
    return space, drive.replace(side=jnp.where(is_before, side, drive.side).astype(jnp.int32))


def circled(
    state: State,
    drive: Drive,
    space: FreeSpace,
    writer: Writer,
    around: Surround,
    estimate: Array,
    at_node: Array,
    tuning: Tuning,
) -> tuple[Drive, Array]:
    """Continue after a wall has been followed all round without making a node.

    The robot leaves an island in the hall straight across, for another wall. If it knows no place but the hall where it
    began, and follows no route, that hall is exhausted; otherwise it crosses as well.

    Args:
      at_node: bool, a node was made.

    Returns:
      `(drive, is_round)`: bool, the robot has been round the hall where it began and found no exit.
    """
    xy, known = surround.known_points(around)
    beside = jnp.any(known & (jnp.hypot(*xy.T) < 2 * tuning.coast_m))
    follows = space.inside & (state.mode == RunMode.WALL_FOLLOWING) & (drive.latch == Latch.FREE) & beside
    began = jnp.where(at_node | ~space.inside, jnp.nan, drive.began)
    turn = jnp.where(follows, estimate[2] - began[4], 0.0)
    began = began.at[2].add(turn).at[4].set(estimate[2])
    now = jnp.stack([*estimate[:2], 0.0, state.odometer_m, estimate[2]])
    began = jnp.where(follows & jnp.isnan(began[0]) & (tuning.coast_m > 0), now, began)
    gone = estimate[:2] - began[:2]
    passes = gone[0] * jnp.cos(estimate[2]) + gone[1] * jnp.sin(estimate[2]) >= 0
    is_back = follows & passes & (jnp.hypot(*gone) < BEGAN_M) & (state.odometer_m - began[3] > ROUND_M)
    turned = -drive.side * began[2]  # away from the wall, along the inside of a hall
    alone = (writer.node == 0) & (writer.map.n_nodes == 1)
    alone &= jnp.bool_(writer.guide is None)
    is_round = is_back & (turned > ROUND_RAD) & alone
    leaves = is_back & (jnp.abs(turned) > ROUND_RAD) & ~is_round
    out = estimate[2] - drive.side * math.pi / 2
    target = estimate[:2] + LEAVE_ISLAND_M * towards(out)
    after = drive.replace(
        latch=jnp.where(leaves, Latch.LEAVE, drive.latch).astype(jnp.int32),
        target=jnp.where(leaves, target, drive.target),
        out=jnp.where(leaves, out, drive.out),
        since=jnp.where(leaves, behaviour.latch_start(jnp.float32(LEAVE_ISLAND_M), tuning), drive.since),
        aside=drive.aside & ~leaves,
        side=jnp.where(leaves, 0, drive.side).astype(jnp.int32),
        began=jnp.where(leaves, jnp.nan, began),
    )
    return after, is_round
