"""Branch selection: how the robot goes to a place, looks round there, and leaves it by a link.

The scanner sees half of what there is, and from afar a place may seem to be where none is. So the robot goes to the
middle of what it takes for a divergence, turns there by half a turn, and only then judges what lies round it.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import pick, run_if
from jexplore.driving import behaviour
from jexplore.driving.events import triangles
from jexplore.driving.params.tree import P
from jexplore.driving.records import Ahead, Building, Drive, Latch, RunMode, Senses, State, Surround, Track
from jexplore.driving.sensing import surround
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import ANGLES_RAD, SCAN_RANGE_M, touches, towards


class Latched(NamedTuple):
    """Outcome of one step of branch selection."""

    drive: Drive
    track: Track
    begins: Array  # bool, it begins to approach a divergence
    arrives: Array  # bool, it is in its middle and has looked round
    gives_up: Array  # bool, the place does not exist or cannot be reached


class _Look(NamedTuple):
    """Result of looking round at a place."""

    ends: Array  # bool, it has just done so
    track: Track  # the place where it is, or to which it goes
    goes_on: Array  # bool, to a place that it has found
    there_is: Array  # bool, there is a place where it is


def select_branch(
    state: State,
    ahead: Ahead,
    around: Surround,
    ways_m: Array,
    placed: Callable[[Array], Array],
    tuning: Tuning,
    robot: Robot,
) -> Latched:
    """Begin, continue and end a latch of branch selection."""
    drive, track = state.drive, ahead.track
    begins = behaviour.is_believed(track, tuning.votes) & ~ahead.inside
    begins &= drive.latch == Latch.FREE
    following = (drive.latch == Latch.APPROACH) | begins
    target = jnp.where(following, track.centre, drive.target)
    distance = _away_m(state, target)
    near = distance < tuning.arrive_m
    lost = (drive.latch == Latch.APPROACH) & (track.age == 0) & ((distance > track.radius) | ahead.leans)
    late = (drive.latch != Latch.FREE) & (drive.since > P.motion.latch_steps) & ~begins
    shut = (state.mode == RunMode.DEAD_END) | (state.mode == RunMode.CONTACT_GUARD) | state.manoeuvre.backing
    surveys = (drive.latch == Latch.FREE) & ~begins & shut & (state.odometer_m - drive.looked_m > P.motion.survey_m)
    looks, none = drive.latch == Latch.LOOK, (jnp.float32(0), jnp.float32(0))
    left, right = run_if((following & near) | surveys | looks, lambda _: surround.free_turn(around, robot), none)
    may_look = jnp.minimum(left, right) >= math.pi - 1e-3
    look = _look_ends(state, track, looks, left, around, ways_m, placed, tuning, robot)
    ends = look.ends
    arrives = (following & near & ~may_look) | (ends & look.there_is)
    none = ends & ~look.goes_on & (track.age > 0) & ~look.there_is
    too_late = following & late & ~arrives

    latch = jnp.where(begins, Latch.APPROACH, drive.latch)
    latch = jnp.where(((following & near) | surveys) & may_look & ~ahead.leans, Latch.LOOK, latch)
    latch = jnp.where(ends, jnp.where(look.goes_on, Latch.APPROACH, jnp.where(none, Latch.LEAVE, Latch.FREE)), latch)
    aligned = jnp.abs(btm.wrapped(drive.out - state.estimate[2])) < P.motion.taken_rad
    has_left = (drive.latch == Latch.LEAVE) & ((near & aligned) | late)
    turned = lost & ~aligned  # the target does not exist: a turn towards it would send the robot back
    latch = jnp.where(turned, Latch.LEAVE, jnp.where(has_left | lost | too_late, Latch.FREE, latch))
    from_ = jnp.where(turned, state.estimate[:2], track.centre)
    onward = from_ + tuning.leave_m * towards(drive.out)
    target = jnp.where(ends & look.goes_on, look.track.centre, jnp.where(none | turned, onward, target))
    after = drive.replace(
        latch=latch.astype(jnp.int32),
        target=target,
        out=jnp.where(begins, state.estimate[2], drive.out),
        since=jnp.where(latch == drive.latch, drive.since + 1, 0),
        looked_m=jnp.where(ends, state.odometer_m, drive.looked_m),
    )
    gives_up = too_late | none
    left = pick(gives_up, behaviour.empty_track(), look.track)
    return Latched(after, left, begins, arrives, gives_up)


def _away_m(state, place):
    return jnp.hypot(*(place - state.estimate[:2]))


def _look_ends(state, track, looks, left, around, ways_m, placed, tuning, robot):
    """Return the `_Look` of a robot that has looked round; in any other step only its `track` is valid."""
    ends = looks & ((state.drive.looked >= P.motion.look_rad) | (left < P.motion.look_step_rad))
    had = track.age > 0
    other, finds, there_is = run_if(
        ends,
        lambda _: _surveyed(track, around, ways_m, placed, tuning, robot),
        (track, jnp.bool_(False), jnp.bool_(False)),
    )
    goes_on = ~had & finds
    return _Look(ends, pick(ends & goes_on, other, track), goes_on, had & there_is)


def _surveyed(track, around, ways_m, placed, tuning, robot):
    """Find the largest place that the robot sees around itself after looking round. Returns `(track, finds,
    there_is)`: it; whether there is any; whether one lies where the robot takes it to be."""
    xy, known = surround.known_points(around)
    found = triangles(xy, known, tuning.far_m, tuning)
    distance = jnp.hypot(*found.centre.T)
    bearing = jnp.arctan2(found.centre[:, 1], found.centre[:, 0])
    at = jnp.argmin(jnp.abs(btm.wrapped(bearing[:, None] - surround.DIRECTION)), axis=1)
    free = (ways_m[at] + robot.length_m / 2 > distance) | (distance < tuning.arrive_m)
    radius = jnp.where(found.valid & free & (distance < tuning.far_m), found.radius, -1)
    best = jnp.argmax(radius)
    off = jnp.hypot(*(placed(found.centre) - track.centre).T)
    there_is = jnp.any(found.valid & (off < P.motion.same_place_radii * track.radius))
    seen = Track(placed(found.centre[best]), found.radius[best], jnp.uint32(1), jnp.int32(1))
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
        track=pick(helps, behaviour.empty_track(), state.track),
        writer=state.writer.replace(map=map_.replace(intervention=map_.intervention.at[node].add(1, mode="drop"))),
        moved_m=moved_m,
        moved_step=jnp.where(helps, state.step, moved_step),
        stray_from=stray_from,
        stray_step=jnp.where(helps, state.step, stray_step),
        helps=state.helps + helps,
        since_node=jnp.where(makes_node, 0, state.since_node + helps),
    )
