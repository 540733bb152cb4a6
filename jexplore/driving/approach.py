"""Branch selection: how the robot goes to a place, looks round there, and leaves it by a link.

The scanner sees half of what there is, and from afar a place may seem to be where none is. So the robot goes to the
middle of what it takes for a divergence, turns there by half a turn, and only then judges what lies round it.
"""

import math

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import pick, run_if
from jexplore.driving import behaviour
from jexplore.driving.params.tree import P
from jexplore.driving.records import Ahead, Building, Latch, Senses, State, Track
from jexplore.driving.sensing import surround
from jexplore.driving.sensing.perception import find_divergences
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import ANGLES_RAD, SCAN_RANGE_M, to_odometry, touches, towards


def select_branch(state: State, ahead: Ahead, tuning: Tuning, robot: Robot) -> tuple[State, Array]:
    """Begin, continue and end a latch of branch selection.

    Returns:
      `(state, arrives)`: bool, it is in the middle of a divergence and has looked round.
    """
    drive, track, writer, here = state.drive, state.track, state.writer, state.estimate[:2]
    begins = behaviour.is_believed(track, tuning.votes) & ~state.inside & (drive.latch == Latch.FREE)
    following = (drive.latch == Latch.APPROACH) | begins
    target = jnp.where(following, track.centre, drive.target)
    distance = jnp.hypot(*(target - here))
    near = distance < tuning.arrive_m
    lost = (drive.latch == Latch.APPROACH) & (track.age == 0) & ((distance > track.radius) | ahead.leans)
    late = (drive.latch != Latch.FREE) & (drive.since > P.motion.latch_steps) & ~begins
    looks, none = drive.latch == Latch.LOOK, (jnp.float32(0), jnp.float32(0))
    left, right = run_if((following & near) | looks, lambda _: surround.free_turn(state.around, robot), none)
    may_look = jnp.minimum(left, right) >= math.pi - 1e-3
    ends = looks & ((drive.looked >= P.motion.look_rad) | (left < P.motion.look_step_rad))
    had, there_is = track.age > 0, run_if(ends, lambda _: _is_there(state, tuning), jnp.bool_(False))
    arrives = (following & near & ~may_look) | (had & there_is)
    none, too_late = ends & had & ~there_is, following & late & ~arrives

    latch = jnp.where(begins, Latch.APPROACH, drive.latch)
    latch = jnp.where(following & near & may_look & ~ahead.leans, Latch.LOOK, latch)
    latch = jnp.where(ends, jnp.where(none, Latch.LEAVE, Latch.FREE), latch)
    aligned = jnp.abs(btm.wrapped(drive.out - state.estimate[2])) < P.motion.taken_rad
    has_left = (drive.latch == Latch.LEAVE) & ((near & aligned) | late)
    turned = lost & ~aligned  # the target does not exist: a turn towards it would send the robot back
    latch = jnp.where(turned, Latch.LEAVE, jnp.where(has_left | lost | too_late, Latch.FREE, latch))
    onward = jnp.where(turned, here, track.centre) + tuning.leave_m * towards(drive.out)
    gives_up, early = too_late | none, arrives & jnp.isfinite(writer.border_m)
    left_off = jnp.stack([*track.centre, track.radius, state.odometer_m])
    drive = drive.replace(
        latch=latch.astype(jnp.int32),
        target=jnp.where(none | turned, onward, target),
        out=jnp.where(begins, state.estimate[2], drive.out),
        since=jnp.where(latch == drive.latch, drive.since + 1, 0),
    )
    writer = writer.replace(
        passed=jnp.where(gives_up, left_off, writer.passed),
        entry=jnp.where(begins, here, writer.entry),
        border_m=jnp.where(early, state.odometer_m, writer.border_m),
    )
    return state.replace(drive=drive, track=pick(gives_up, Track(), track), writer=writer), arrives


def _is_there(state, tuning):
    """Return whether a robot that has looked round sees a place where it takes one to be."""
    found = find_divergences(*surround.known_points(state.around), tuning)
    off = jnp.hypot(*(to_odometry(state.estimate)(found.centre) - state.track.centre).T)
    return jnp.any(found.valid & (off < P.motion.same_place_radii * state.track.radius))


def help_robot(state: State, senses: Senses, makes_node: Array, building: Building, robot: Robot) -> State:
    """Turn a robot that makes no progress towards the longest free way: operator help."""
    on = (state.odometer_m - state.moved_m > P.motion.stuck_m) | makes_node
    moved_m = jnp.where(on, state.odometer_m, state.moved_m)
    moved_step = jnp.where(on, state.step, state.moved_step)
    helps = state.step - moved_step >= P.motion.stuck_steps
    ranges = jnp.where(jnp.isnan(senses.ranges_m), 0, jnp.minimum(senses.ranges_m, SCAN_RANGE_M))

    def fitting(_):  # a robot that does not fit when it is turned stays as it is
        longest = jnp.asarray(ANGLES_RAD)[jnp.argmax(ranges)]
        return jnp.where(touches(building, robot, state.body.pose.at[2].add(longest)), 0.0, longest)

    turn = run_if(helps, fitting, jnp.float32(0))
    map_ = state.writer.map
    node = jnp.where(helps, state.writer.node, map_.kind.shape[0])
    return state.replace(
        body=state.body.replace(pose=state.body.pose.at[2].add(turn)),
        estimate=state.estimate.at[2].add(turn),
        odometry=state.odometry.at[2].add(turn),
        drive=state.drive.replace(latch=jnp.where(helps, Latch.FREE, state.drive.latch).astype(jnp.int32)),
        track=pick(helps, Track(), state.track),
        writer=state.writer.replace(map=map_.replace(intervention=map_.intervention.at[node].add(1, mode="drop"))),
        moved_m=moved_m,
        moved_step=jnp.where(helps, state.step, moved_step),
        helps=state.helps + helps,
        since_node=jnp.where(makes_node, 0, state.since_node + helps),
    )
