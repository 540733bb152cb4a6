"""One autonomous run: a robot drives through a building with height and writes its Behavioral Trace Map.

The building is walls and ground; the robot is a unicycle on two rigid tracks with a scanner that looks ahead, one that
looks down, an attitude sensor and encoders. One jitted function of building, robot, thresholds, noise and key.
"""

import dataclasses
import enum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore import btm
from jexplore.arrays.loops import run_if
from jexplore.btm import Btm
from jexplore.driving import behaviour, ground_profile, mapping, perception
from jexplore.driving.behaviour import Drive, Hall, Latch, RunMode, Track
from jexplore.driving.mapping import Event, Writer
from jexplore.driving.vehicle import (
    ANGLES_RAD,
    BEAM_SPACING_RAD,
    BEAMS,
    RANGE_M,
    Body,
    at_rest,
    down_directions,
    draw,
    move,
    sense,
    to_odometry,
    to_robot,
    touches,
)
from jexplore.engine.program import Program

DRIVE = 1.5  # length of the stretch in which walls are steered by, in look-aheads
CROSSING_M = 0.1  # but no nearer than this to a wall across the way
BLOCK = 16  # steps whose random numbers are drawn at once
EVERY = 2  # steps between two looks for triangles
SCAN_POINTS = 48  # of a scan that are made into triangles
KEPT_POINTS = 96  # of a scan that are kept for the openings of the next divergence
NODES, LINKS = 32, 64  # most of a map
GOAL_M = 0.5  # a run ends within this of its goal
STUCK_STEPS = 150  # without going on or finding a node: the operator helps
STUCK_M = 0.3
HELPS = 3  # of the operator; then the run ends
BLIND_STEPS = 20  # scans in a row, most of whose beams give no number, that end a run
LOST_M = 0.5  # a divergence farther ahead than this and its radius, and no longer seen, is none
LOOK_M = 0.30  # of the profile ahead, in which a robot finds that it cannot climb
RECENT = 64  # steps whose profile is looked at for that
SURE = 3  # steps in a row that it finds so


class Outcome(enum.IntEnum):
    """How a run ended."""

    RUNNING = 0
    GOAL = 1
    """Within half a metre of the goal."""
    EXHAUSTED = 2
    """No link is left that could be followed."""
    STUCK = 3
    """The operator has helped three times."""
    BLIND = 4
    """The scanner gives no numbers."""
    STEP_LIMIT = 5
    MAP_FULL = 6
    """A node did not fit into the map."""


@struct.dataclass
class State:
    """A run in progress."""

    body: Body
    estimate: Array  # [3] float32, odometry
    odometer_m: Array  # float32
    climbed_m: Array  # float32, height above the start as the attitude has it
    track: Track
    hall: Hall
    drive: Drive
    writer: Writer
    scan_overflow: Array  # int32, ends of walls that a scan had more than there is room for
    mode: Array  # int32
    target: Array  # [2] float32, target point in the robot's frame
    blocked: Array  # int32, steps in a row with ground ahead that the robot cannot climb
    halts: Array  # bool, the ground has just refused a step
    blind: Array  # int32, scans in a row without numbers
    moved_m: Array  # float32, odometer when it last got on
    moved_step: Array  # int32, and the step
    helps: Array  # int32
    truth: Array  # [T, 3] float32, true poses
    step: Array  # int32
    outcome: Array  # int32
    draws: Any  # `vehicle.Draws` of `BLOCK` steps


class Setup(NamedTuple):
    """What is fixed before a run is compiled. Hashable."""

    room: int  # T, steps that there is room for


@struct.dataclass
class Result:
    """What is kept of a run."""

    map: Btm
    outcome: Array  # int32, `Outcome`
    steps: Array  # int32, of `vehicle.DT_S` seconds
    path_m: Array  # float32, way in the plane
    contacts: Array  # int32, steps refused because of a wall
    refused: Array  # int32, steps refused because of the ground
    interventions: Array  # int32, of the operator
    scan_overflow: Array  # int32, ends of walls that did not fit into a scan's points
    drift_m: Array  # float32, how far the odometry was off in the end


def _is_open(building):
    """Whether a run has no goal: it goes on until nothing is left, behind its start as well."""
    return jnp.isnan(building.goal[0])


def at_start(building, robot, room):
    """The state before the first step, with no random numbers; `room` for so many steps, static."""
    zero, none = jnp.float32(0), jnp.int32(0)
    start = jnp.asarray(building.start, jnp.float32)
    return State(
        body=at_rest(building, robot, start),
        estimate=start,
        odometer_m=zero,
        climbed_m=zero,
        track=behaviour.no_track(),
        hall=behaviour.no_hall(),
        drive=behaviour.at_rest(),
        writer=mapping.begin(room, KEPT_POINTS, NODES, LINKS, start, _is_open(building)),
        scan_overflow=none,
        mode=none,
        target=jnp.zeros(2),
        blocked=none,
        halts=jnp.bool_(False),
        blind=none,
        moved_m=zero,
        moved_step=none,
        helps=none,
        truth=jnp.zeros((room, 3)),
        step=none,
        outcome=jnp.int32(Outcome.RUNNING),
        draws=(),
    )


def look(xy, valid, wall_m, tuning):
    """The triangles of a scan, `wall_m` from the nearer wall: `perception.Divergence`."""
    far_m = perception.far_bound(tuning.far_m, tuning.width_m, BEAM_SPACING_RAD, wall_m)
    return perception.divergences(
        xy,
        valid,
        near_m=tuning.near_m,
        far_m=far_m,
        width_m=tuning.width_m,
        obtuse_tol_deg=tuning.obtuse_tol_deg,
        open_m=tuning.open_m,
        size=SCAN_POINTS,
    )


def step(draws, building, robot, tuning, noise, state):
    """One step of a run: sense, perceive, write, decide, move.

    Args:
      draws: `Draws`.
      building, robot, tuning, noise: of the run.
      state: `State`.

    Returns:
      `State`.
    """
    body, drive = state.body, state.drive
    senses = sense(draws, building, robot, noise, body)
    xy, valid = perception.points(senses.ranges_m, ANGLES_RAD)
    region = tuning.ahead_m / 2, tuning.ahead_m / 2 + tuning.region_m
    hall_sides = perception.sides(xy, valid, *region)
    closed = sum(perception.sides(xy, valid, 0, tuning.ahead_m)) <= tuning.dead_end_m
    fronts_m = perception.front(xy, valid, robot.width_m)
    # Walls are steered by as far as the way is free: one that crosses it lies on both sides.
    until_m = jnp.clip(jnp.maximum(*fronts_m) - CROSSING_M, robot.length_m / 2, DRIVE * tuning.ahead_m)
    left_m, right_m = perception.sides(xy, valid, 0, until_m)
    beside = jnp.stack(perception.clearances(xy, valid, robot.length_m / 2))
    blind = jnp.where(jnp.sum(jnp.isnan(senses.ranges_m)) > BEAMS / 2, state.blind + 1, 0)
    placed = to_odometry(state.estimate)

    # The way so far.
    ground_x, ground_z, ground_seen = ground_profile.ground_point(
        senses.down_m,
        down_directions(robot),
        senses.pitch,
        senses.roll,
        (robot.scanner_x_m, robot.scanner_height_m),
        robot.width_m / 2,
    )
    ground_x, ground_z = state.odometer_m + ground_x, state.climbed_m + ground_z
    writer = _note(state, senses, beside.sum(), jnp.where(ground_seen, ground_x, jnp.inf), ground_z)

    # What lies ahead.
    track, overflow = _watch(state, writer, xy, valid, beside.min(), placed, tuning)
    writer = mapping.keep_snapshot(writer, lambda: _kept_points(xy, valid, placed, tuning), state.odometer_m)
    hall, enters, leaves = behaviour.watch_hall(
        state.hall, *hall_sides, state.odometer_m, tuning.open_m, (drive.latch == Latch.FREE) & (blind == 0)
    )
    border_m = jnp.where(enters, hall.since_m + region[0], writer.border_m)
    border_m = jnp.where(leaves, hall.since_m + region[1], border_m)
    missed = jnp.isfinite(writer.border_m) & (enters | leaves)  # the last border was not reached before the next
    level, changed, crease_m, steepest = mapping.watch_level(
        writer.level,
        senses.pitch,
        state.odometer_m,
        jnp.radians(tuning.inclination_deg),
        mapping.EVEN_LENGTHS * robot.length_m,
    )
    stops, ahead_step_m, ahead_slope = _cannot_climb(writer.way, robot, state)
    blocked = jnp.where(stops & ((drive.latch == Latch.FREE) | state.halts), state.blocked + 1, 0)

    # A latch begins and ends.
    believed = behaviour.is_believed(track, tuning.votes)
    begins = believed & (drive.latch == Latch.FREE) & ~hall.inside
    following = (drive.latch == Latch.APPROACH) | begins
    target = jnp.where(following, track.centre, drive.target)
    distance = jnp.hypot(*(target - state.estimate[:2]))
    near = distance < tuning.arrive_m
    lost = (drive.latch == Latch.APPROACH) & (track.age == 0) & (distance > track.radius + LOST_M)
    arrives = following & near
    latch = jnp.where(begins, Latch.APPROACH, drive.latch)
    latch = jnp.where(((drive.latch == Latch.LEAVE) & near) | lost, Latch.FREE, latch)
    drive = drive.replace(latch=latch.astype(jnp.int32), target=target)
    writer = writer.replace(level=level, entry=jnp.where(begins, state.estimate[:2], writer.entry))

    # A node that is due.
    at_goal = jnp.sum((body.pose[:2] - building.goal) ** 2) < GOAL_M**2
    early = arrives & jnp.isfinite(border_m)
    writer = writer.replace(border_m=jnp.where(early, state.odometer_m, border_m))
    crosses = missed | (state.odometer_m >= writer.border_m)
    stops = blocked >= SURE
    beyond = ahead_step_m, ahead_slope
    returns = _is_open(building) & _passes_start(state)
    event = _event(state, writer, track, at_goal, returns, changed, crease_m, steepest, crosses, arrives, stops, beyond)
    writer, drive, track, estimate = _write(state, writer, drive, track, event, tuning, robot)
    blocked = jnp.where(event.blocked, 0, blocked)

    # Where to.
    mode, drive = behaviour.choose_mode(drive, hall, hall_sides, left_m, right_m, closed, fronts_m, tuning, robot)
    target = behaviour.target_of(mode, drive, left_m, right_m, to_robot(estimate), tuning)
    v, omega = behaviour.steer(mode, drive, target, tuning, robot)
    writer = writer.replace(way=writer.way.replace(mode=writer.way.mode.at[state.step].set(mode, mode="drop")))
    body, estimate, gone_m = move(draws, building, robot, noise, body, estimate, senses, v, omega)
    odometer_m = state.odometer_m + gone_m
    after = state.replace(
        body=body,
        estimate=estimate,
        odometer_m=odometer_m,
        climbed_m=state.climbed_m - gone_m * jnp.tan(senses.pitch),
        track=track,
        hall=hall,
        drive=drive,
        writer=writer,
        scan_overflow=state.scan_overflow + overflow,
        mode=mode,
        target=target,
        blocked=blocked,
        halts=body.refused > state.body.refused,
        blind=blind,
        truth=state.truth.at[state.step].set(state.body.pose, mode="drop"),
        step=state.step + 1,
    )
    return _end(_helped(after, senses, event, building, robot), at_goal & (event.kind == btm.TERMINAL))


def _note(state, senses, width_m, ground_x, ground_z):
    """Keeps what this step measured; no width where the robot turns in place before a wall."""
    way, at = state.writer.way, state.step
    turns = (state.mode == RunMode.DEAD_END) | (state.mode == RunMode.CONTACT_GUARD)
    new = {
        "odometer_m": state.odometer_m,
        "pose": state.estimate,
        "pitch": senses.pitch,
        "posture": jnp.arccos(jnp.cos(senses.pitch) * jnp.cos(senses.roll)),
        "width_m": jnp.where(turns, jnp.inf, width_m),
        "ground_x_m": ground_x,
        "ground_z_m": ground_z,
    }
    way = way.replace(**{name: getattr(way, name).at[at].set(value, mode="drop") for name, value in new.items()})
    return state.writer.replace(way=way)


def _watch(state, writer, xy, valid, wall_m, placed, tuning):
    """Looks for triangles, in every `EVERY`-th step: `(track, overflow)`."""
    approaches = state.drive.latch == Latch.APPROACH
    # Once the robot is in the circle that it approaches, a wall that the circle touches lies beside or behind it.
    is_in = approaches & (jnp.hypot(*(state.track.centre - state.estimate[:2])) < state.track.radius)

    def looked(carry):
        found = look(xy, valid, wall_m, tuning)
        known = mapping.is_near_known(writer, placed(found.centre), state.odometer_m, tuning.leave_m)
        found = dataclasses.replace(found, valid=found.valid & ~known)
        return behaviour.follow(carry[0], found, placed, tuning.same_m, ~approaches), found.overflow

    forgets = state.hall.inside  # there are no divergences in free space
    track = jax.tree.map(lambda none, old: jnp.where(forgets, none, old), behaviour.no_track(), state.track)
    looks = (state.step % EVERY == 0) & ~is_in & ~state.hall.inside
    return run_if(looks, looked, (track, jnp.int32(0)))


def _kept_points(xy, valid, placed, tuning):
    """Points of a scan for the openings of the next divergence: `(points, there)`, in the odometry's frame."""
    even = perception.smoothed(xy, valid, tuning.width_m / 4)
    bounds = tuning.near_m, tuning.far_m, tuning.open_m
    points, there, *_ = perception.resampled(even, valid, *bounds, tuning.width_m / 4, size=KEPT_POINTS)
    return placed(points), there


def _cannot_climb(way, robot, state):
    """Whether the ground ahead is more than the robot can climb, as it looks or as the robot has just found.

    Returns:
      `(stops, step_m, slope)`: bool; height of the step that stops it, 0 for none; inclination of the slope that does,
        radians, 0 for none, NaN where it was not seen.
    """
    first = jnp.clip(state.step + 1 - RECENT, 0, way.ground_x_m.shape[0] - RECENT)
    x, z = (lax.dynamic_slice(array, (first,), (RECENT,)) for array in (way.ground_x_m, way.ground_z_m))
    x = jnp.where(first + jnp.arange(RECENT) <= state.step, x, jnp.inf)
    nose = state.odometer_m + robot.length_m / 2
    ahead = (x > nose) & (x < nose + LOOK_M)
    behind = (x <= nose) & (x > nose - LOOK_M)
    foot = jnp.max(jnp.where(behind, z, -jnp.inf))
    rise = jnp.where(jnp.isfinite(foot), jnp.max(jnp.where(ahead, z, -jnp.inf)) - foot, 0)
    slope_m = LOOK_M * jnp.tan(jnp.radians(robot.max_slope_deg)) + 0.02

    def judged(_):
        step_m, beyond = ground_profile.profile(x, z, ahead | behind).step_m, ground_profile.profile(x, z, ahead)
        is_step = ((step_m > robot.max_step_m) | state.halts) & (step_m > mapping.STEP_M)
        stops = is_step | (rise > slope_m) | state.halts
        slope = jnp.where(beyond.count < 3, jnp.nan, jnp.abs(jnp.arctan(beyond.slope)))
        return stops, jnp.where(is_step, step_m, 0.0), jnp.where(stops & ~is_step, slope, 0.0)

    high = (rise > jnp.minimum(slope_m, robot.max_step_m)) | state.halts
    return run_if(high, judged, (jnp.bool_(False), jnp.float32(0), jnp.float32(0)))


def _passes_start(state):
    """Whether the robot has come by the node where it started since it was at another one."""
    map_ = state.writer.map
    place = to_robot(state.estimate)(jnp.stack([map_.x_m[0], map_.y_m[0]]))
    return (state.writer.node != 0) & (place[0] <= 0) & (jnp.hypot(*place) < mapping.SAME_NODE_M)


def _event(state, writer, track, at_goal, returns, changed, crease_m, steepest, crosses, arrives, stops, beyond):
    """The node that is due; of several the one that lies first on the way."""
    here = state.estimate
    crease = run_if(changed, lambda _: mapping.pose_at(writer.way, crease_m), here)
    crease_m = jnp.maximum(crease_m, writer.node_m)
    order = [
        (at_goal | returns, btm.TERMINAL, state.odometer_m, here, here[:2]),
        (arrives & ~crosses, btm.DIVERGENCE, state.odometer_m, here, track.centre),
        (stops, btm.OBSTACLE, state.odometer_m, here, here[:2]),
        (crosses, btm.FREE_SPACE, state.odometer_m, here, here[:2]),
        (changed, btm.OBSTACLE, crease_m, crease, crease[:2]),
    ]
    kind, odometer_m, pose, centre = jnp.int32(btm.NONE), state.odometer_m, here, here[:2]
    for due, *values in order:  # the last that is due wins
        kind, odometer_m, pose, centre = (
            jnp.where(due, new, old) for new, old in zip(values, (kind, odometer_m, pose, centre))
        )
    is_blocked = stops & (kind == btm.OBSTACLE) & ~changed
    return Event(
        kind=kind.astype(jnp.int32),
        odometer_m=odometer_m,
        pose=pose,
        centre=centre,
        radius=jnp.where(kind == btm.DIVERGENCE, track.radius, 0.0),
        posture=writer.way.posture[jnp.minimum(state.step, writer.way.posture.shape[0] - 1)],
        steepest=jnp.where(is_blocked, beyond[1], steepest),
        step_m=jnp.where(is_blocked, beyond[0], 0.0),
        blocked=is_blocked,
        returns=returns & ~at_goal & (kind == btm.TERMINAL),
    )


def _write(state, writer, drive, track, event, tuning, robot):
    """Makes the node that is due, if one is: `(writer, drive, track, estimate)`."""

    def made(carry):
        map_part, rest, drive, track, estimate = carry
        whole = writer.replace(map=map_part, **rest)
        whole, latch, target, shift = mapping.write(whole, event, tuning, robot)
        estimate = estimate.at[:2].add(shift)
        is_divergence = event.kind == btm.DIVERGENCE
        latches = is_divergence | event.blocked
        drive = drive.replace(
            latch=jnp.where(latches, latch, drive.latch), target=jnp.where(latches, target, drive.target)
        )
        track = jax.tree.map(lambda none, old: jnp.where(latches, none, old), behaviour.no_track(), track)
        return whole.map, {name: getattr(whole, name) for name in rest}, drive, track, estimate

    names = ("node", "node_m", "link", "left_bearing", "border_m", "snapshot_there", "exhausted", "full")
    rest = {name: getattr(writer, name) for name in names}
    map_, rest, drive, track, estimate = run_if(
        event.kind != btm.NONE, made, (writer.map, rest, drive, track, state.estimate)
    )
    return writer.replace(map=map_, **rest), drive, track, estimate


def _helped(state, senses, event, building, robot):
    """Where the robot has not got on for long the operator turns it to where the way is longest."""
    on = (state.odometer_m - state.moved_m > STUCK_M) | (event.kind != btm.NONE)
    moved_m = jnp.where(on, state.odometer_m, state.moved_m)
    moved_step = jnp.where(on, state.step, state.moved_step)
    helps = state.step - moved_step >= STUCK_STEPS
    ranges = jnp.where(jnp.isnan(senses.ranges_m), 0, jnp.minimum(senses.ranges_m, RANGE_M))

    def fitting(_):  # a robot that does not fit when it is turned stays as it is
        longest = jnp.asarray(ANGLES_RAD)[jnp.argmax(ranges)]
        return jnp.where(touches(building, robot, state.body.pose.at[2].add(longest)), 0.0, longest)

    turn = run_if(helps, fitting, jnp.float32(0))
    map_ = state.writer.map
    node = jnp.where(helps, state.writer.node, map_.kind.shape[0])
    return state.replace(
        body=state.body.replace(pose=state.body.pose.at[2].add(turn)),
        estimate=state.estimate.at[2].add(turn),
        drive=state.drive.replace(latch=jnp.where(helps, Latch.FREE, state.drive.latch).astype(jnp.int32)),
        track=jax.tree.map(lambda fresh, old: jnp.where(helps, fresh, old), behaviour.no_track(), state.track),
        writer=state.writer.replace(map=map_.replace(intervention=map_.intervention.at[node].add(1, mode="drop"))),
        moved_m=moved_m,
        moved_step=jnp.where(helps, state.step, moved_step),
        helps=state.helps + helps,
    )


def _end(state, at_end):
    ends = [
        (state.blind >= BLIND_STEPS, Outcome.BLIND),
        (state.helps >= HELPS, Outcome.STUCK),
        (state.writer.exhausted, Outcome.EXHAUSTED),
        (state.writer.full, Outcome.MAP_FULL),
        (at_end, Outcome.GOAL),
    ]
    outcome = state.outcome
    for ended, name in ends:
        outcome = jnp.where(ended, jnp.int32(name), outcome)
    return state.replace(outcome=outcome)


def _draws_from(key, first):
    """The random numbers of `BLOCK` steps from one on."""
    return jax.vmap(lambda i: draw(jax.random.fold_in(key, i)))(first + jnp.arange(BLOCK))


def begin(setup, given):
    """A run before its first step.

    Args:
      setup: `Setup`. Static.
      given: `engine.Given`: key of the run, step i takes `draw(fold_in(key, i))`; the scenes are `Building`s; the
        number is the step after which it ends as `STEP_LIMIT`, int32; the task is `(Robot, Tuning, Noise)`, whose
        numbers are arrays.

    Returns:
      `State`.
    """
    block = jax.eval_shape(_draws_from, given.key, 0)
    state = at_start(given.own_scene, given.task[0], setup.room)
    return state.replace(draws=jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), block))


def advance(setup, given, state):
    """One step of a run: a `State`. Arguments as for `begin`."""
    del setup
    building, (robot, tuning, noise) = given.own_scene, given.task
    block = run_if(state.step % BLOCK == 0, lambda _: _draws_from(given.key, state.step), state.draws)
    draws = jax.tree.map(lambda a: a[state.step % BLOCK], block)
    after = step(draws, building, robot, tuning, noise, state.replace(draws=block))
    late = (after.outcome == Outcome.RUNNING) & (after.step >= given.numbers)
    return after.replace(outcome=jnp.where(late, jnp.int32(Outcome.STEP_LIMIT), after.outcome))


def finish(setup, given, state):
    """The `Result` of a run that has ended. Arguments as for `begin`."""
    del setup, given
    body = state.body
    return Result(
        map=state.writer.map,
        outcome=state.outcome,
        steps=state.step,
        path_m=body.path_m,
        contacts=body.contacts,
        refused=body.refused,
        interventions=state.helps,
        scan_overflow=state.scan_overflow,
        drift_m=jnp.hypot(*(body.pose[:2] - state.estimate[:2])),
    )


def _keep(state):
    """The way of a run, step by step: poses, estimates, run modes, pitch."""
    return state.truth, state.writer.way.pose, state.writer.way.mode, state.writer.way.pitch


def _is_done(state):
    return state.outcome != Outcome.RUNNING


def program_of(room):
    """A run as a `Program`, with room for so many steps.

    Source:
      Mano et al., sections 2 and 3.
    """
    return Program(Setup(room), begin, advance, _is_done, finish, _keep)
