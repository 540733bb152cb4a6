"""Perception ahead of the robot, and the node of the map that is due."""

import jax.numpy as jnp
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import pick, run_if
from jexplore.driving import behaviour, links, mapping
from jexplore.driving.params.tree import P
from jexplore.driving.records import Ahead, DueNode, Latch, LoneStep, ScanWalls, State, Track
from jexplore.driving.sensing import ground_profile, perception, surround
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import ANGLES_RAD, to_odometry, to_robot

PROFILE_STEPS = 64  # steps whose profile of the ground is looked at


def walls_of_scan(ranges_m: Array, tuning: Tuning, robot: Robot) -> ScanWalls:
    """Find the `ScanWalls` of a scan: `[B]` float32 ranges, NaN for none."""
    xy, valid = perception.beam_points(ranges_m, ANGLES_RAD)
    region_sides = perception.sides(xy, valid, *tuning.region)
    closed = sum(perception.sides(xy, valid, 0, tuning.ahead_m)) <= tuning.dead_end_m
    fronts_m = perception.front(xy, valid, robot.width_m)
    # Walls are steered by as far as the way is free: one that crosses it lies on both sides.
    until_m = jnp.clip(jnp.maximum(*fronts_m), robot.length_m / 2, tuning.ahead_m)
    left_m, right_m = perception.sides(xy, valid, 0, until_m)
    beside = jnp.stack(perception.clearances(xy, valid, robot.length_m / 2))
    roomy = perception.is_roomy(xy, valid, tuning.region[0], *region_sides, tuning.open_m)
    return ScanWalls(region_sides, roomy, closed, fronts_m, left_m, right_m, beside)


def look_ahead(state: State, walls: ScanWalls, tuning: Tuning, robot: Robot) -> tuple[State, Ahead]:
    """Look for divergences, free space and obstacles."""
    writer, is_free, looks = state.writer, state.drive.latch == Latch.FREE, state.blind == 0
    lean, lean_m = mapping.slope_at(writer.way, state.step)
    last, age = mapping.last_steps(writer.way, state.step, PROFILE_STEPS)
    x, z = jnp.where(age >= 0, last.ground_x_m, jnp.inf), last.ground_z_m  # in the order of time
    rise, stops, beyond = _ground_ahead(x, z, robot, state)
    # Points seen from ground of another inclination, or where the ground rises, may be ground.
    tips = jnp.hypot(*(lean - writer.level.even)) > jnp.radians(tuning.inclination_deg)
    leans = tips | (rise > P.ground.stairs_rise_m)
    state = _watch(state, walls.beside.min(), leans, tuning)
    inside, border_m, missed = behaviour.watch_free_space(
        state.inside, writer.border_m, state.odometer_m, walls, is_free & looks, tuning
    )
    level, changed, crease_m, steepest = mapping.update_slope(
        writer.level, lean, lean_m, jnp.radians(tuning.inclination_deg), P.ground.even_lengths * robot.length_m
    )
    blocked = stops & (is_free | state.halts)
    ground = x, z, last.posture
    lone_step, is_lone, after = _lone_step(state, ground, tips, level, changed, crease_m, blocked, robot)
    writer = writer.replace(level=level, lone_step=after, border_m=border_m)
    ahead = Ahead(leans, missed, changed, crease_m, steepest, blocked, beyond, lone_step, is_lone)
    return state.replace(inside=inside, writer=writer), ahead


def _lone_step(state, ground, tips, level, changed, crease_m, blocked, robot):
    """Return `(lone_step, is_lone, after)`: two of `Ahead`, and the remaining `LoneStep` once the node is made; a
    change of the ground's inclination makes the node itself."""
    # What it saw as it tipped over the last step is off.
    writer, map_ = state.writer, state.writer.map
    is_step = map_.obstacle[jnp.minimum(writer.node, map_.kind.shape[0] - 1)] == btm.STAIRS
    is_step &= ~jnp.any(map_.blocked & (map_.start == writer.node))  # from which the robot has turned back
    beyond_m = jnp.where(is_step, writer.node_m + P.ground.together_m, -jnp.inf)
    x_m, z_m, posture = ground
    ground = jnp.where((posture < P.ground.level_rad) & (x_m > beyond_m), x_m, jnp.inf), z_m
    is_level = jnp.hypot(*level.even) < P.ground.level_rad
    is_on = state.odometer_m + robot.length_m / 2 > writer.lone_step.from_m
    looks = is_level & ~tips & ~is_on & (state.drive.latch != Latch.LOOK) & ~state.manoeuvre.backing
    near = jnp.isfinite(ground[0]) & (ground[0] > state.odometer_m)
    span_m = jnp.max(jnp.where(near, ground[1], -jnp.inf)) - jnp.min(jnp.where(near, ground[1], jnp.inf))
    now = run_if(
        looks & (span_m > P.ground.step_m),
        lambda _: ground_profile.update_step(writer.lone_step, *ground),
        writer.lone_step,
    )
    passed = ground_profile.has_passed(now, state.odometer_m, robot.length_m) & ~tips & is_level
    is_lone = run_if(passed, lambda _: ground_profile.has_tipped(now, writer.way, robot.length_m), jnp.bool_(False))
    is_lone &= (now.from_m + now.to_m) / 2 > writer.node_m
    gone = passed | state.manoeuvre.backing | (changed & (crease_m > now.from_m - P.ground.together_m / 2)) | blocked
    return now, is_lone & ~changed, pick(gone, LoneStep(), now)


def _watch(state, wall_m, leans, tuning):
    """Search triangles, in every `search_every_steps`-th step: the state with its `Track` and overflow."""
    approaches, turns = state.drive.latch == Latch.APPROACH, state.drive.latch == Latch.LOOK
    placed = to_odometry(state.estimate)
    # Once the robot is in the circle that it approaches, a wall touched by the circle lies abeam or behind.
    is_in = approaches & (jnp.hypot(*(state.track.centre - state.estimate[:2])) < state.track.radius)

    def looked(carry):
        found = perception.find_divergences(*surround.known_points(state.around), wall_m, tuning)
        known = mapping.is_near_known(state.writer, placed(found.centre), state.odometer_m, tuning.leave_m)
        found = found.replace(valid=found.valid & ~known & (found.centre[:, 0] > 0))
        return behaviour.update_track(carry[0], found, placed, tuning.same_m, ~approaches), found.overflow

    # There are no divergences in free space; where the robot turns on a slope, it leans otherwise for a moment.
    forgets = (state.inside | leans) & ~turns
    track = pick(forgets, Track(), state.track)
    looks = (state.step % P.graph.search_every_steps == 0) & ~is_in & ~turns & ~forgets
    track, overflow = run_if(looks, looked, (track, jnp.int32(0)))
    return state.replace(track=track, scan_overflow=state.scan_overflow + overflow)


def _ground_ahead(x, z, robot, state):
    """Return the rise of the ground ahead, whether it stops the robot, as seen or just experienced, and `beyond`: the
    height of the step that does, 0 for none, and the inclination of the slope, radians, 0 for none, NaN if unseen."""
    nose = state.odometer_m + robot.length_m / 2
    ahead = (x > nose) & (x < nose + P.ground.look_m)
    behind = (x <= nose) & (x > nose - P.ground.look_m)
    foot = jnp.max(jnp.where(behind, z, -jnp.inf))
    rise = jnp.where(jnp.isfinite(foot), jnp.max(jnp.where(ahead, z, -jnp.inf)) - foot, 0)
    slope_m = P.ground.look_m * jnp.tan(jnp.radians(robot.max_slope_deg)) + 0.02

    def judged(_):
        near, beyond = ground_profile.profile(x, z, ahead | behind), ground_profile.profile(x, z, ahead)
        step_m = near.step_m
        is_step = ((step_m > robot.max_step_m + P.ground.step_slack_m) | state.halts) & (step_m > P.ground.step_m)
        # Two steps that it climbs one by one rise more than a slope that it climbs.
        sudden = ground_profile.steepest_rise(x, z, ahead | behind) > P.ground.step_m
        gentle = sudden & (near.slope <= jnp.tan(jnp.radians(robot.max_slope_deg)))
        stops = is_step | ((rise > slope_m) & ~gentle) | state.halts
        slope = jnp.where(beyond.count < 3, jnp.nan, jnp.abs(jnp.arctan(beyond.slope)))
        return stops, (jnp.where(is_step, step_m, 0.0), jnp.where(stops & ~is_step, slope, 0.0))

    high = (rise > jnp.minimum(slope_m, robot.max_step_m)) | state.halts
    return rise, *run_if(high, judged, (jnp.bool_(False), (jnp.float32(0), jnp.float32(0))))


def _passes_start(state):
    """Return whether the robot has passed its start node since the last node, along its link. A start in the circle of
    a divergence is on no link; nor is a robot that leaves a rejected candidate."""
    map_ = state.writer.map
    followed, to, there = links.led_to(state.writer)
    is_led, gone_m = followed & (to == 0), state.odometer_m - state.writer.node_m
    place = to_robot(state.estimate)(jnp.where(is_led, there, jnp.stack([map_.x_m[0], map_.y_m[0]])))
    within_m = P.graph.same_node_m + jnp.where(is_led, P.graph.drift_share * gone_m, 0.0)
    within = jnp.hypot(map_.x_m - map_.x_m[0], map_.y_m - map_.y_m[0]) < map_.radius_m
    on_link = ~jnp.any(within & (map_.kind == btm.DIVERGENCE)) & (state.drive.latch != Latch.LOOK)
    on_link &= (state.drive.latch != Latch.LEAVE) | (state.writer.passed[3] <= state.writer.node_m)
    return (
        on_link
        & (state.writer.node != 0)
        & (place[0] <= 0)
        & (jnp.hypot(*place) < within_m)
        & (gone_m > P.graph.same_node_m)
    )


def due_node(state: State, ahead: Ahead, at_goal: Array, is_open: Array, arrives: Array) -> DueNode:
    """Return the node that is due, a `DueNode`; of several the one that lies first on the way.

    Args:
      at_goal: bool, whether the robot is at its goal.
      is_open: bool, whether the run has no goal.
      arrives: bool, whether the robot is at the middle of a divergence.
    """
    writer, here, now_m, step = state.writer, state.estimate, state.odometer_m, ahead.lone_step
    returns, crosses = is_open & _passes_start(state), ahead.missed | (now_m >= writer.border_m)
    crease_m = jnp.maximum(ahead.crease_m, writer.node_m)
    step_m = jnp.maximum((step.from_m + step.to_m) / 2, writer.node_m)

    def there(when, odometer_m):
        return run_if(when, lambda _: mapping.pose_at(writer.way, odometer_m), here)

    order = [
        (at_goal | returns, btm.TERMINAL, now_m, here),
        (arrives & ~crosses, btm.DIVERGENCE, now_m, here),
        (ahead.blocked, btm.OBSTACLE, now_m, here),
        (crosses, btm.FREE_SPACE, now_m, here),
        (ahead.is_lone, btm.OBSTACLE, step_m, there(ahead.is_lone, step_m)),
        (ahead.changed, btm.OBSTACLE, crease_m, there(ahead.changed, ahead.crease_m)),
    ]
    kind, odometer_m, pose = jnp.int32(btm.NONE), now_m, here
    for due, *values in order:  # the last that is due wins
        kind, odometer_m, pose = (jnp.where(due, new, old) for new, old in zip(values, (kind, odometer_m, pose)))
    is_divergence = kind == btm.DIVERGENCE
    is_blocked = ahead.blocked & (kind == btm.OBSTACLE) & ~ahead.changed & ~ahead.is_lone
    return DueNode(
        kind=kind.astype(jnp.int32),
        odometer_m=odometer_m,
        pose=pose,
        centre=jnp.where(is_divergence, state.track.centre, pose[:2]),
        radius=jnp.where(is_divergence, state.track.radius, 0.0),
        posture=writer.way.posture[jnp.minimum(state.step, writer.way.posture.shape[0] - 1)],
        steepest=jnp.where(is_blocked, ahead.beyond[1], ahead.steepest),
        step_m=jnp.where(is_blocked, ahead.beyond[0], jnp.where(ahead.is_lone, step.height_m, 0.0)),
        blocked=is_blocked,
        returns=returns & ~at_goal & (kind == btm.TERMINAL),
    )
