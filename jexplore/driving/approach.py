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
from jexplore.driving.records import Ahead, Building, Latch, RunMode, Senses, State, Track
from jexplore.driving.sensing import perception, surround
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import ANGLES_RAD, SCAN_RANGE_M, to_odometry, touches, towards


def select_branch(state: State, ahead: Ahead, ways_m: Array, tuning: Tuning, robot: Robot) -> tuple[State, Array]:
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
    shut = (state.mode == RunMode.DEAD_END) | (state.mode == RunMode.CONTACT_GUARD) | state.manoeuvre.backing
    surveys = (drive.latch == Latch.FREE) & ~begins & shut & (state.odometer_m - drive.looked_m > P.motion.survey_m)
    looks, none = drive.latch == Latch.LOOK, (jnp.float32(0), jnp.float32(0))
    left, right = run_if((following & near) | surveys | looks, lambda _: surround.free_turn(state.around, robot), none)
    may_look = jnp.minimum(left, right) >= math.pi - 1e-3
    ends = looks & ((drive.looked >= P.motion.look_rad) | (left < P.motion.look_step_rad))
    nothing = track, jnp.bool_(False), jnp.bool_(False)
    found, finds, there_is = run_if(ends, lambda _: _surveyed(state, ways_m, tuning, robot), nothing)
    had = track.age > 0
    goes_on, arrives = ~had & finds, (following & near & ~may_look) | (had & there_is)
    none, too_late = ends & ~goes_on & had & ~there_is, following & late & ~arrives

    latch = jnp.where(begins, Latch.APPROACH, drive.latch)
    latch = jnp.where(((following & near) | surveys) & may_look & ~ahead.leans, Latch.LOOK, latch)
    latch = jnp.where(ends, jnp.where(goes_on, Latch.APPROACH, jnp.where(none, Latch.LEAVE, Latch.FREE)), latch)
    aligned = jnp.abs(btm.wrapped(drive.out - state.estimate[2])) < P.motion.taken_rad
    has_left = (drive.latch == Latch.LEAVE) & ((near & aligned) | late)
    turned = lost & ~aligned  # the target does not exist: a turn towards it would send the robot back
    latch = jnp.where(turned, Latch.LEAVE, jnp.where(has_left | lost | too_late, Latch.FREE, latch))
    onward = jnp.where(turned, here, track.centre) + tuning.leave_m * towards(drive.out)
    gives_up, early = too_late | none, arrives & jnp.isfinite(writer.border_m)
    left_off = jnp.stack([*track.centre, track.radius, state.odometer_m])
    sets_off = begins | ((latch == Latch.APPROACH) & looks)
    drive = drive.replace(
        latch=latch.astype(jnp.int32),
        target=jnp.where(goes_on, found.centre, jnp.where(none | turned, onward, target)),
        out=jnp.where(begins, state.estimate[2], drive.out),
        since=jnp.where(latch == drive.latch, drive.since + 1, 0),
        looked_m=jnp.where(ends, state.odometer_m, drive.looked_m),
    )
    writer = writer.replace(
        passed=jnp.where(gives_up, left_off, writer.passed),
        entry=jnp.where(sets_off, here, writer.entry),
        border_m=jnp.where(early, state.odometer_m, writer.border_m),
    )
    track = pick(gives_up, Track(), pick(goes_on, found, track))
    return state.replace(drive=drive, track=track, writer=writer), arrives


def _surveyed(state, ways_m, tuning, robot):
    """Find the largest place that the robot sees around itself after looking round. Returns `(track, finds,
    there_is)`: it; whether there is any; whether one lies where the robot takes it to be."""
    placed = to_odometry(state.estimate)
    found = perception.find_divergences(*surround.known_points(state.around), tuning.far_m, tuning)
    distance = jnp.hypot(*found.centre.T)
    bearing = jnp.arctan2(found.centre[:, 1], found.centre[:, 0])
    at = jnp.argmin(jnp.abs(btm.wrapped(bearing[:, None] - surround.DIRECTION)), axis=1)
    free = (ways_m[at] + robot.length_m / 2 > distance) | (distance < tuning.arrive_m)
    radius = jnp.where(found.valid & free & (distance < tuning.far_m), found.radius, -1)
    best = jnp.argmax(radius)
    off = jnp.hypot(*(placed(found.centre) - state.track.centre).T)
    there_is = jnp.any(found.valid & (off < P.motion.same_place_radii * state.track.radius))
    seen = Track(placed(found.centre[best]), found.radius[best], jnp.int32(1), jnp.int32(1))
    return seen, radius[best] > 0, there_is


def help_robot(state: State, senses: Senses, makes_node: Array, building: Building, robot: Robot) -> State:
    """Turn a robot that makes no progress, or drives to and fro, towards the longest free way: operator help."""
    on = (state.odometer_m - state.moved_m > P.motion.stuck_m) | makes_node
    moved_m = jnp.where(on, state.odometer_m, state.moved_m)
    moved_step = jnp.where(on, state.step, state.moved_step)
    strays = (jnp.hypot(*(state.estimate[:2] - state.stray_from)) > P.motion.stray_m) | makes_node
    stray_from = jnp.where(strays, state.estimate[:2], state.stray_from)
    stray_step = jnp.where(strays, state.step, state.stray_step)
    helps = (state.step - moved_step >= P.motion.stuck_steps) | (state.step - stray_step >= P.motion.stray_steps)
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
        stray_from=stray_from,
        stray_step=jnp.where(helps, state.step, stray_step),
        helps=state.helps + helps,
        since_node=jnp.where(makes_node, 0, state.since_node + helps),
    )
