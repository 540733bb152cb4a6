"""One autonomous run: a robot drives through a building with height and writes its Behavioral Trace Map.

The building is walls and ground; the robot is a unicycle on two rigid tracks with a scanner that looks ahead, one that
looks down, an attitude sensor and encoders. A run is a program of the engine.
"""

import dataclasses
import enum
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import run_if
from jexplore.btm import Btm
from jexplore.driving import behaviour, ground_profile, mapping, nodes
from jexplore.driving.behaviour import Drive, FreeSpace, Latch, RunMode, Track
from jexplore.driving.events import GOAL_M, KEPT_POINTS, due, kept_points, look_ahead, walls_of_scan
from jexplore.driving.mapping import Writer
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.driving.vehicle import (
    ANGLES_RAD,
    BEAMS,
    RANGE_M,
    Body,
    Building,
    Draws,
    at_rest,
    down_directions,
    draw,
    move,
    sense,
    to_odometry,
    to_robot,
    touches,
)
from jexplore.engine.program import Given, Program

BLOCK = 16  # steps whose random numbers are drawn at once
NODES, LINKS = 32, 64  # most of a map
STUCK_STEPS = 150  # without going on or finding a node: the operator helps
STUCK_M = 0.3
HELPS = 3  # of the operator; then the run ends
BLIND_STEPS = 20  # scans in a row, most of whose beams give no number, that end a run
LOST_M = 0.5  # a divergence farther ahead than this and its radius, and no longer seen, is none


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
    space: FreeSpace
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
    replace: ClassVar[Callable[..., Self]]


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


def at_start(building: Building, robot: Robot, room: int) -> State:
    """The state before the first step, with no random numbers; `room` for so many steps, static."""
    zero, none = jnp.float32(0), jnp.int32(0)
    start = jnp.asarray(building.start, jnp.float32)
    return State(
        body=at_rest(building, robot, start),
        estimate=start,
        odometer_m=zero,
        climbed_m=zero,
        track=behaviour.no_track(),
        space=behaviour.no_free_space(),
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


def step(draws: Draws, building: Building, robot: Robot, tuning: Tuning, noise: Noise, state: State) -> State:
    """One step of a run: sense, perceive, write, decide, move.

    Args:
      draws: `Draws`.
      building, robot, tuning, noise: of the run.
      state: `State`.

    Returns:
      `State`.
    """
    senses = sense(draws, building, robot, noise, state.body)
    walls = walls_of_scan(senses.ranges_m, tuning, robot)
    blind = jnp.where(jnp.sum(jnp.isnan(senses.ranges_m)) > BEAMS / 2, state.blind + 1, 0)
    placed = to_odometry(state.estimate)
    writer = _note(state, senses, walls.beside.sum(), robot)
    ahead = look_ahead(state, writer, walls, senses.pitch, placed, tuning, robot, blind != 0)
    writer = mapping.keep_snapshot(writer, lambda: kept_points(walls.xy, walls.valid, placed, tuning), state.odometer_m)
    drive, begins, arrives = _latched(state, ahead, tuning)
    writer = writer.replace(level=ahead.level, entry=jnp.where(begins, state.estimate[:2], writer.entry))
    early = arrives & jnp.isfinite(ahead.border_m)
    writer = writer.replace(border_m=jnp.where(early, state.odometer_m, ahead.border_m))
    at_goal = jnp.sum((state.body.pose[:2] - building.goal) ** 2) < GOAL_M**2
    event = due(state, writer, ahead, at_goal, _is_open(building), arrives)
    writer, drive, track, estimate = _write(state, writer, drive, ahead.track, event, tuning, robot)

    mode, drive = behaviour.choose_mode(
        drive, ahead.space, walls.region_sides, walls.left_m, walls.right_m, walls.closed, walls.fronts_m, tuning, robot
    )
    target = behaviour.target_of(mode, drive, walls.left_m, walls.right_m, to_robot(estimate), tuning)
    speed = behaviour.steer(mode, drive, target, tuning, robot)
    body, estimate, gone_m = move(draws, building, robot, noise, state.body, estimate, senses, *speed)
    after = state.replace(
        body=body,
        estimate=estimate,
        odometer_m=state.odometer_m + gone_m,
        climbed_m=state.climbed_m - gone_m * jnp.tan(senses.pitch),
        track=track,
        space=ahead.space,
        drive=drive,
        writer=writer.replace(way=writer.way.replace(mode=writer.way.mode.at[state.step].set(mode, mode="drop"))),
        scan_overflow=state.scan_overflow + ahead.scan_overflow,
        mode=mode,
        target=target,
        blocked=jnp.where(event.blocked, 0, ahead.blocked),
        halts=body.refused > state.body.refused,
        blind=blind,
        truth=state.truth.at[state.step].set(state.body.pose, mode="drop"),
        step=state.step + 1,
    )
    return _end(_helped(after, senses, event, building, robot), at_goal & (event.kind == btm.TERMINAL))


def _latched(state, ahead, tuning):
    """A latch begins and ends.

    Returns:
      `(drive, begins, arrives)`: `Drive`; bool, whether it begins to approach a divergence; bool, whether it has
        reached its middle.
    """
    drive, track = state.drive, ahead.track
    believed = behaviour.is_believed(track, tuning.votes)
    begins = believed & (drive.latch == Latch.FREE) & ~ahead.space.inside
    following = (drive.latch == Latch.APPROACH) | begins
    target = jnp.where(following, track.centre, drive.target)
    distance = jnp.hypot(*(target - state.estimate[:2]))
    near = distance < tuning.arrive_m
    lost = (drive.latch == Latch.APPROACH) & (track.age == 0) & (distance > track.radius + LOST_M)
    latch = jnp.where(begins, Latch.APPROACH, drive.latch)
    latch = jnp.where(((drive.latch == Latch.LEAVE) & near) | lost, Latch.FREE, latch)
    return drive.replace(latch=latch.astype(jnp.int32), target=target), begins, following & near


def _note(state, senses, width_m, robot):
    """Keeps what this step measured; no width where the robot turns in place before a wall."""
    way, at = state.writer.way, state.step
    ground_x, ground_z, ground_seen = ground_profile.ground_point(
        senses.down_m,
        down_directions(robot),
        senses.pitch,
        senses.roll,
        (robot.scanner_x_m, robot.scanner_height_m),
        robot.width_m / 2,
    )
    turns = (state.mode == RunMode.DEAD_END) | (state.mode == RunMode.CONTACT_GUARD)
    new = {
        "odometer_m": state.odometer_m,
        "pose": state.estimate,
        "pitch": senses.pitch,
        "posture": jnp.arccos(jnp.cos(senses.pitch) * jnp.cos(senses.roll)),
        "width_m": jnp.where(turns, jnp.inf, width_m),
        "ground_x_m": jnp.where(ground_seen, state.odometer_m + ground_x, jnp.inf),
        "ground_z_m": state.climbed_m + ground_z,
    }
    way = way.replace(**{name: getattr(way, name).at[at].set(value, mode="drop") for name, value in new.items()})
    return state.writer.replace(way=way)


def _write(state, writer, drive, track, event, tuning, robot):
    """Makes the node that is due, if one is: `(writer, drive, track, estimate)`."""

    def made(carry):
        map_part, rest, drive, track, estimate = carry
        whole = writer.replace(map=map_part, **rest)
        whole, latch, target, shift = nodes.write(whole, event, tuning, robot)
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


def begin(setup: Setup, given: Given) -> State:
    """A run before its first step.

    Args:
      setup: `Setup`. Static.
      given: `engine.program.Given`: key of the run, step i takes `draw(fold_in(key, i))`; the scenes are `Building`s;
        the number is the step after which it ends as `STEP_LIMIT`, int32; the task is `(Robot, Tuning, Noise)`, whose
        numbers are arrays.

    Returns:
      `State`.
    """
    block = jax.eval_shape(_draws_from, given.key, 0)
    state = at_start(given.own_scene, given.task[0], setup.room)
    return dataclasses.replace(state, draws=jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), block))


def advance(setup: Setup, given: Given, state: State) -> State:
    """One step of a run: a `State`. Arguments as for `begin`.

    A run that is done writes on beyond its last step, where nobody looks.
    """
    del setup
    building, (robot, tuning, noise) = given.own_scene, given.task
    block = run_if(state.step % BLOCK == 0, lambda _: _draws_from(given.key, state.step), state.draws)
    draws = jax.tree.map(lambda a: a[state.step % BLOCK], block)
    after = step(draws, building, robot, tuning, noise, state.replace(draws=block))
    late = (after.outcome == Outcome.RUNNING) & (after.step >= given.numbers)
    return after.replace(outcome=jnp.where(late, jnp.int32(Outcome.STEP_LIMIT), after.outcome))


def finish(setup: Setup, given: Given, state: State) -> Result:
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


def program_of(room: int) -> Program:
    """A run as a `Program`, with room for so many steps.

    Source:
      Mano et al., sections 2 and 3.
    """
    return Program(Setup(room), begin, advance, _is_done, finish, _keep)
