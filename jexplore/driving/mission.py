"""One autonomous run: a robot drives through a building with height and writes its Behavioral Trace Map.

The building is walls and ground; the robot is a unicycle on two rigid tracks with a scanner that looks ahead, one that
looks down, an attitude sensor and encoders. A run is a program of the engine.
"""

import dataclasses
import enum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore import btm
from jexplore.arrays.loops import run_if
from jexplore.btm import Btm
from jexplore.driving import approach, behaviour, manoeuvre, mapping, nodes
from jexplore.driving.events import due_node, look_ahead, walls_of_scan
from jexplore.driving.params.tree import P, Params, using
from jexplore.driving.records import Building, Draws, Latch, Senses, State
from jexplore.driving.sensing import matching, smoothing, surround
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.driving.vehicle import BEAMS, draw, initial_body, level_scan, move, read_sensors, to_odometry, to_robot
from jexplore.engine.program import Given, Program

DRAWN_STEPS = 16  # steps whose random numbers are drawn at once
MAP_SIZE = 32, 64  # most nodes and links of a map


class RunOutcome(enum.IntEnum):
    """Outcome of a run."""

    RUNNING = 0
    GOAL = 1
    """The goal's beacon is within half a metre."""
    EXHAUSTED = 2
    """No link is left that could be followed."""
    STUCK = 3
    """The operator has helped in vain: `Tuning.helps` times since the last node."""
    BLIND = 4
    """The scanner gives no numbers."""
    STEP_LIMIT = 5
    MAP_FULL = 6
    """A node did not fit into the map."""


BROKEN_OFF = (RunOutcome.STUCK, RunOutcome.BLIND, RunOutcome.STEP_LIMIT)
"""A run that ends so ends at a node of type terminal, if it was on a link that it had not searched."""


class Setup(NamedTuple):
    """Static config of a run. Hashable."""

    room: int  # T, steps that there is room for
    n_nodes: int = MAP_SIZE[0]  # N, most of a map
    n_links: int = MAP_SIZE[1]


class MissionTask(NamedTuple):
    """Settings and start of one run; numbers are arrays."""

    robot: Robot
    tuning: Tuning
    noise: Noise
    start: Array  # [3] float32, building's frame
    params: Params | None  # None: the defaults, as constants


class RunResult(struct.PyTreeNode):
    """Result of a run; fields that `State` has as well are those of its end."""

    map: Btm
    outcome: Array  # int32, `RunOutcome`
    steps: Array  # int32, of `vehicle.DT_S` seconds
    path_m: Array  # float32, way in the plane
    contacts: Array  # int32, steps refused because of a wall
    refused: Array  # int32, steps refused because of the ground
    interventions: Array  # int32, of the operator
    node_at: Array
    mistaken: Array
    met: Array
    scan_overflow: Array
    drift_m: Array  # float32, how far the odometry was off in the end
    end: Array  # [3] float32, where the robot truly was in the end


def _is_open(building):
    """Return whether a run has no goal: it continues until nothing is left, behind its start as well."""
    return jnp.isnan(building.goal[0])


def initial_state(setup: Setup, building: Building, robot: Robot, start: Array) -> State:
    """Return the state before the first step, without random numbers. `setup` static; `start` from `batch.pose_in`."""
    start = jnp.asarray(start, jnp.float32)
    return State(
        body=initial_body(building, robot, start),
        estimate=start,
        odometry=start,
        scanned=start,
        key=matching.no_key(start),
        manoeuvre=manoeuvre.initial_manoeuvre(start),
        writer=mapping.begin_map(setup.room, setup.n_nodes, setup.n_links, start, _is_open(building)),
        stray_from=start[:2],
        node_at=jnp.full((setup.n_nodes, 2), jnp.nan).at[0].set(start[:2]),
        met=jnp.zeros(building.marks.shape[0], bool),
        truth=jnp.zeros((setup.room, 3)),
    )


def smooth_senses(senses: Senses, robot: Robot) -> tuple[Senses, Array]:
    """Return the forward scan in the plane with its noise averaged: see `vehicle.level_scan`."""
    return level_scan(senses.replace(ranges_m=smoothing.smooth_ranges(senses.ranges_m)), robot)


def make_step(draws: Draws, building: Building, robot: Robot, tuning: Tuning, noise: Noise, state: State) -> State:
    """Make one step of a run: sense, perceive, write, decide, move."""
    before, senses = state, read_sensors(draws, building, robot, noise, state.body)
    is_blind = jnp.sum(jnp.isnan(senses.ranges_m)) > BEAMS / 2
    senses, is_ground = smooth_senses(senses, robot)
    walls = walls_of_scan(senses.ranges_m, tuning, robot)
    state = _localised(state.replace(blind=jnp.where(is_blind, state.blind + 1, 0)), senses, is_ground, tuning)
    ways_m = surround.free_lengths(state.around, robot)
    state = state.replace(writer=mapping.record_step(state, senses, walls.beside.sum(), robot))
    state, ahead = look_ahead(state, walls, tuning, robot)
    state, arrives = approach.select_branch(state, ahead, ways_m, tuning, robot)
    at_goal = senses.beacon_m < P.graph.goal_m
    event = due_node(state, ahead, at_goal, _is_open(building), arrives)
    state = nodes.make_due_node(state, event, tuning, robot)
    node_at, is_elsewhere = mapping.record_truth(state.node_at, before.writer, state.writer, state.body.pose[:2])
    state, *speed = _driven(state, walls, ways_m, tuning, robot)
    state = _moved(draws, building, robot, noise, state, senses, speed)
    turn, gone_m = state.odometry[2] - before.odometry[2], state.odometer_m - before.odometer_m
    drive = state.drive
    state = state.replace(
        manoeuvre=manoeuvre.extend_trail(state.manoeuvre, state.odometry),
        climbed_m=state.climbed_m - gone_m * jnp.sign(speed[0]) * jnp.tan(senses.pitch),
        drive=drive.replace(looked=jnp.where(drive.latch == Latch.LOOK, drive.looked + jnp.abs(turn), 0.0)),
        node_at=node_at,
        mistaken=state.mistaken + is_elsewhere,
        step=state.step + 1,
    )
    state = approach.help_robot(state, senses, event.kind != btm.NONE, building, robot)
    return _end(state, at_goal & (event.kind == btm.TERMINAL), tuning)


def _localised(state, senses, is_ground, tuning):
    """Correct the odometry by the scan, and add it to the points around: the state."""
    lean = mapping.slope_under(senses.pitch, senses.roll, state.odometry[2])
    key, odometry, estimate = matching.correct_odometry(
        state.key, state.odometry, state.estimate, senses.ranges_m, lean
    )
    around = surround.move_surround(state.around, *matching.relative_pose(state.scanned, odometry), far_m=tuning.far_m)
    around = surround.add_scan(around, jnp.where(is_ground, jnp.inf, senses.ranges_m))
    return state.replace(key=key, odometry=odometry, estimate=estimate, around=around, scanned=odometry)


def _driven(state, walls, ways_m, tuning, robot):
    """Choose run mode, target point and speed: `(state, v, omega)`."""
    mode, drive = behaviour.choose_mode(state.drive, state.inside, walls, ways_m, tuning, robot)
    edge, own = surround.voronoi_edge(state.around), to_robot(state.estimate)
    target = behaviour.target_point(mode, drive, walls.left_m, walls.right_m, edge, own, tuning)
    at_target = (drive.latch == Latch.LEAVE) & (jnp.hypot(*target) < tuning.arrive_m)
    bearing = jnp.where(at_target, btm.wrapped(drive.out - state.estimate[2]), jnp.arctan2(target[1], target[0]))
    turning = jnp.where(drive.latch == Latch.LOOK, 2, drive.turning)
    after, *speed = manoeuvre.avoid_obstacles(
        state.manoeuvre, state.around, ways_m, state.odometry, bearing, turning, state.touched, tuning, robot
    )
    way = state.writer.way
    writer = state.writer.replace(way=way.replace(mode=way.mode.at[state.step].set(mode, mode="drop")))
    return state.replace(mode=mode, drive=drive, target=target, manoeuvre=after, writer=writer), *speed


def _moved(draws, building, robot, noise, state, senses, speed):
    """Return the state once the robot has moved: its body and its odometry."""
    estimate = state.estimate
    body, gone_to, gone_m = move(draws, building, robot, noise, state.body, estimate, senses, speed[0], speed[1])
    step_m, turn = to_robot(estimate)(gone_to[:2]), gone_to[2] - estimate[2]
    return state.replace(
        odometry=jnp.append(to_odometry(state.odometry)(step_m), state.odometry[2] + turn),
        touched=body.contacts > state.body.contacts,
        body=body,
        estimate=gone_to,
        odometer_m=state.odometer_m + gone_m,
        halts=body.refused > state.body.refused,
        truth=state.truth.at[state.step].set(state.body.pose, mode="drop"),
        met=state.met | (jnp.sum((building.marks[:, :2] - body.pose[:2]) ** 2, axis=1) < building.marks[:, 2] ** 2),
    )


def _end(state, at_end, tuning):
    ends = [
        (state.blind >= P.graph.blind_steps, RunOutcome.BLIND),
        (state.since_node >= tuning.helps, RunOutcome.STUCK),
        (state.writer.exhausted, RunOutcome.EXHAUSTED),
        (state.writer.full, RunOutcome.MAP_FULL),
        (at_end, RunOutcome.GOAL),
    ]
    outcome = state.outcome
    for ended, name in ends:
        outcome = jnp.where(ended, jnp.int32(name), outcome)
    return state.replace(outcome=outcome)


def _draws_from(key, first, noise):  # of `DRAWN_STEPS` steps
    return draw(jax.vmap(lambda i: jax.random.fold_in(key, i))(first + jnp.arange(DRAWN_STEPS)), noise)


def begin(setup: Setup, given: Given) -> State:
    """Return the state of a run before its first step.

    Args:
      setup: `Setup`. Static.
      given: `engine.program.Given`: key of the run, step i draws by `fold_in(key, i)`; the scenes are `Building`s;
        the number is the step after which it ends as `STEP_LIMIT`, int32; the task is a
        `MissionTask`.
    """
    task: MissionTask = given.task
    block = jax.eval_shape(_draws_from, given.key, 0, task.noise)
    state = initial_state(setup, given.own_scene, task.robot, task.start)
    return dataclasses.replace(state, draws=jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), block))


def advance(setup: Setup, given: Given, state: State) -> State:
    """Make one step of a run: a `State`. Arguments as for `begin`.

    A run that is done writes on beyond its last step, where nobody looks.
    """
    del setup
    building: Building = given.own_scene
    task: MissionTask = given.task
    block = run_if(state.step % DRAWN_STEPS == 0, lambda _: _draws_from(given.key, state.step, task.noise), state.draws)
    draws = jax.tree.map(lambda a: a[state.step % DRAWN_STEPS], block)
    with using(task.params):
        after = make_step(draws, building, task.robot, task.tuning, task.noise, state.replace(draws=block))
    late = (after.outcome == RunOutcome.RUNNING) & (after.step >= given.numbers)
    return after.replace(outcome=jnp.where(late, jnp.int32(RunOutcome.STEP_LIMIT), after.outcome))


def finish(setup: Setup, given: Given, state: State) -> RunResult:
    """Return the `RunResult` of a run that has ended. Arguments as for `begin`."""
    del setup
    body, breaks_off = state.body, jnp.isin(state.outcome, jnp.array(BROKEN_OFF, jnp.int32))
    with using(given.task.params):
        map_, node = mapping.end_broken_off(state.writer, state.estimate, state.odometer_m, state.step, breaks_off)
    return RunResult(
        map=map_,
        outcome=state.outcome,
        steps=state.step,
        path_m=body.path_m,
        contacts=body.contacts,
        refused=body.refused,
        interventions=state.helps,
        node_at=state.node_at.at[node].set(body.pose[:2], mode="drop"),
        mistaken=state.mistaken,
        met=state.met,
        scan_overflow=state.scan_overflow,
        drift_m=jnp.hypot(*(body.pose[:2] - state.estimate[:2])),
        end=body.pose,
    )


def _keep(state):
    """Return the way of a run, step by step: poses, estimates, run modes, pitch."""
    return state.truth, state.writer.way.pose, state.writer.way.mode, state.writer.way.pitch


def _is_done(state):
    return state.outcome != RunOutcome.RUNNING


def mission_program(setup: Setup) -> Program:
    """Return a run as a `Program`.

    Source:
      Mano et al., sections 2 and 3.
    """
    return Program(setup, begin, advance, _is_done, finish, _keep)
