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
from jexplore.driving.mapping import has_left
from jexplore.driving.params.tree import P
from jexplore.driving.records import Ahead, Building, Drive, Latch, RunMode, Senses, State, Surround, Track
from jexplore.driving.sensing import surround
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import ANGLES_RAD, SCAN_RANGE_M, to_robot, touches, towards

HELPS_KEPT = 16  # helps of which place, time and run mode are kept


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
    goes_on: Array  # bool, to another place, or the one that it means
    back: Array  # bool, which is a node that it knows
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
    begins = behaviour.is_believed(track, tuning.votes) & ~ahead.space.inside
    begins &= (drive.latch == Latch.FREE) | _is_on_way(state, track, tuning)
    following = (drive.latch == Latch.APPROACH) | begins
    target = jnp.where(following, track.centre, drive.target)
    distance = _away_m(state, target)
    near = distance < tuning.arrive_m
    lost = (
        (drive.latch == Latch.APPROACH)
        & (track.age == 0)
        & ((distance > track.radius + P.motion.lost_place_m) | ahead.leans)
    )
    late = (drive.latch != Latch.FREE) & (drive.since > P.motion.latch_steps) & ~begins
    shut = (state.mode == RunMode.DEAD_END) | (state.mode == RunMode.CONTACT_GUARD) | state.manoeuvre.backing
    surveys = (drive.latch == Latch.FREE) & ~begins & shut & (state.odometer_m - drive.looked_m > P.motion.survey_m)
    looks, none = drive.latch == Latch.LOOK, (jnp.float32(0), jnp.float32(0))
    left, right = run_if((following & near) | surveys | looks, lambda _: surround.free_turn(around, robot), none)
    may_look = jnp.minimum(left, right) >= math.pi - 1e-3
    look = _look_ends(state, track, looks, left, around, ways_m, placed, tuning, robot)
    ends = look.ends
    small = look.track.radius < jnp.hypot(robot.length_m, robot.width_m) / 2 + P.sensing.outline_margin_m
    arrives = (following & near & ~may_look & ((distance < P.motion.unturned_stop_m) | small)) | (
        ends & ~look.goes_on & look.there_is
    )
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
        known=jnp.where(ends, look.back, drive.known & ~begins),
        since=jnp.where(latch == drive.latch, drive.since + 1, behaviour.latch_start(_away_m(state, target), tuning)),
        surveys=drive.surveys + (ends & look.goes_on),
        looked_m=jnp.where(ends, state.odometer_m, drive.looked_m),
    )
    gives_up = too_late | none
    left = pick(gives_up, behaviour.empty_track(), look.track)
    return Latched(after, left, begins, arrives, gives_up)


def _away_m(state, place):
    return jnp.hypot(*(place - state.estimate[:2]))


def _is_on_way(state, track, tuning):
    """Return whether a place lies on the way to a distant exit of the place being left. A robot that follows a route
    looks for its own places."""
    writer, map_ = state.writer, state.writer.map
    if writer.guide is not None:
        return jnp.bool_(False)
    node = jnp.minimum(writer.node, map_.kind.shape[0] - 1)
    left = jnp.stack([map_.x_m[node], map_.y_m[node], map_.radius_m[node]])
    left = jnp.where(writer.passed[3] > writer.node_m, writer.passed[:3], left)  # a place that was none
    is_out = (_away_m(state, left[:2]) > left[2] + tuning.leave_m) & (state.drive.latch == Latch.LEAVE)
    way = state.drive.target - state.estimate[:2]
    ahead, aside = to_robot(jnp.append(state.estimate[:2], jnp.arctan2(way[1], way[0])))(track.centre)
    on_m = jnp.hypot(*way)
    return is_out & (on_m > P.motion.heed_on_way_m) & (ahead > 0) & (ahead < on_m) & (jnp.abs(aside) < track.radius / 2)


def _look_ends(state, track, looks, left, around, ways_m, placed, tuning, robot):
    """Return the `_Look` of a robot that has looked round; in any other step only its `track` is valid. While it sees
    no place where every scan on the way has shown one, it keeps looking: noise may hide the place briefly."""
    drive, map_, had = state.drive, state.writer.map, track.age > 0
    ends = looks & ((drive.looked >= P.motion.look_rad) | (left < P.motion.look_step_rad))
    node, off_m = btm.nearest_node(map_, track.centre[0], track.centre[1], btm.DIVERGENCE)
    in_map = jnp.stack([map_.x_m[node], map_.y_m[node]]), map_.radius_m[node]
    other, better, there_is, middle = run_if(
        ends,
        lambda _: _surveyed(track, in_map, around, ways_m, placed, tuning, robot),
        (track, jnp.bool_(False), jnp.bool_(False), track.centre),
    )
    may_go = drive.surveys < P.motion.max_surveys
    better &= ~had | may_go
    # A place in the circle of a node is that node, if it is not the one just left: it is looked at from its middle.
    back = ends & ~better & had & there_is & ~drive.known & may_go
    back &= (node != state.writer.node) | has_left(state.writer, state.odometer_m, tuning.leave_m)
    back &= (jnp.hypot(*(middle - track.centre)) > tuning.arrive_m) & (
        off_m < jnp.maximum(jnp.minimum(track.radius, in_map[1]), 0.5)
    )
    kept = track.replace(centre=jnp.where(back, middle, track.centre))
    chosen = pick(ends & better, other, kept)
    there_is = had & (there_is | drive.known)
    # One that looks round where the way is shut may see the place that it means from afar.
    far = ends & there_is & (_away_m(state, chosen.centre) > P.motion.at_place_ratio * tuning.arrive_m)
    goes_on = better | back | (far & may_go)
    looks_on = (drive.looked < P.motion.look_rad + P.motion.look_on_rad) & (left >= P.motion.look_step_rad)
    looks_on &= (behaviour.votes(track) == behaviour.VOTING_SCANS) & ~there_is & ~goes_on
    return _Look(ends & ~looks_on, chosen, goes_on, back, there_is & (~far | may_go))


def _surveyed(track, in_map, around, ways_m, placed, tuning, robot):
    """Find the largest place that the robot sees around itself after looking round. Returns `(track, better, there_is,
    middle)`: whether it is another than the one where the robot is, or the first; whether there is any where the robot
    is; `[2]`, see `_middle`, of the node that lies there in the map."""
    xy, known = surround.known_points(around)
    found = triangles(xy, known, tuning.far_m, tuning)
    distance = jnp.hypot(*found.centre.T)
    bearing = jnp.arctan2(found.centre[:, 1], found.centre[:, 0])
    at = jnp.argmin(jnp.abs(btm.wrapped(bearing[:, None] - surround.DIRECTION)), axis=1)
    free = (ways_m[at] + robot.length_m / 2 > distance) | (distance < tuning.arrive_m)
    had = track.age > 0
    reach = jnp.where(had, jnp.maximum(track.radius, P.motion.survey_m), tuning.far_m)
    radius = jnp.where(found.valid & free & (distance < reach), found.radius, -1)
    best = jnp.argmax(radius)
    centre = placed(found.centre[best])
    other = jnp.hypot(*(centre - track.centre)) > tuning.arrive_m
    better = (radius[best] > 0) & (~had | (other & (radius[best] > P.motion.better_radius_ratio * track.radius)))
    one = jnp.uint32(1)
    off = jnp.hypot(*(placed(found.centre) - track.centre).T)
    there_is = jnp.any(
        found.valid & (off < jnp.maximum(P.motion.same_place_m, P.motion.same_place_radii * track.radius))
    )
    seen = Track(centre, found.radius[best], one, jnp.int32(1))
    return seen, better, there_is, _middle(in_map, placed(found.centre), found)


def _middle(in_map, centres, found):
    """Return the observed centre of a node whose circle the robot is in: `[2]` float32, odometry. Odometry drifts, so
    the node is taken to be at the nearest circle of the same size seen within one radius of its mapped position.
    Without such a circle the mapped position is returned."""
    place, radius_m = in_map
    off_m = jnp.hypot(*(centres - place).T)
    alike = found.valid & (jnp.abs(found.radius - radius_m) < P.motion.same_radius_share * radius_m)
    off_m = jnp.where(alike & (off_m < jnp.maximum(radius_m, P.motion.same_place_m)), off_m, jnp.inf)
    at = jnp.argmin(off_m)
    return jnp.where(off_m[at] < jnp.inf, centres[at], place)


def help_robot(state: State, senses: Senses, makes_node: Array, building: Building, robot: Robot) -> State:
    """Turn a robot that makes no progress, or drives to and fro, towards the longest free way: operator help."""
    on = (state.odometer_m - state.moved_m > P.motion.stuck_m) | makes_node
    moved_m = jnp.where(on, state.odometer_m, state.moved_m)
    moved_step = jnp.where(on, state.step, state.moved_step)
    strays = (jnp.hypot(*(state.estimate[:2] - state.stray_from)) > P.motion.stray_m) | makes_node
    stray_from = jnp.where(strays, state.estimate[:2], state.stray_from)
    stray_step = jnp.where(strays, state.step, state.stray_step)
    helps = (state.step - moved_step >= P.motion.stuck_steps) | (state.step - stray_step >= P.motion.stray_steps)
    told = jnp.stack([*state.estimate[:2], state.step.astype(jnp.float32), state.mode.astype(jnp.float32)])
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
        help_at=state.help_at.at[jnp.where(helps, state.helps, HELPS_KEPT)].set(told, mode="drop"),
    )
