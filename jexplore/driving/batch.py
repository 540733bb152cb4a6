"""Many runs of one building: on the cores of a CPU one after the other, on an accelerator all at once.

Robot, thresholds and noise differ from run to run as the caller likes: they are arrays, so that a sweep over any of
them is one program.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array

from jexplore.arrays.padding import number
from jexplore.btm import Btm
from jexplore.config import InputError
from jexplore.driving import mission, vehicle
from jexplore.driving.mission import Outcome
from jexplore.driving.terrain import terrain_of
from jexplore.driving.vehicle import Building
from jexplore.driving.walls import walls_of
from jexplore.engine import threads

MAX_STEPS = 6000
CHUNK = 16  # most runs in one call on a CPU
LANES = 4096  # runs in one call on an accelerator
MULTIPLE = 64  # sides of the ground are padded to multiples of this, so that similar buildings share a program


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


class Track(NamedTuple):
    """The way of one run, step by step, on the host."""

    truth: np.ndarray  # [n, 3] float32, x, y, metres; heading, radians
    estimate: np.ndarray  # [n, 3] float32, likewise, odometry
    mode: np.ndarray  # [n] int32, `RunMode`
    pitch: np.ndarray  # [n] float32, measured, radians


class Report(NamedTuple):
    """What `run` returns."""

    result: Result  # numpy, with a leading axis; outcome RUNNING where it was interrupted before
    track: Track | None  # of run 0
    compile_s: float
    run_s: float
    interrupted: bool


def building_of(world, start_pose, goal_m):
    """A world made ready for runs.

    Args:
      world: `World`.
      start_pose: x, y, metres; heading, degrees; in the world's frame.
      goal_m: x, y, metres; None: the run goes on until nothing is left.

    Returns:
      `Building` of numpy arrays, padded; its cell (0, 0) begins at (0, 0).
    """
    height, width = world.shape
    pad = [(0, -n % MULTIPLE) for n in (height, width)]
    elevation = None if world.elevation is None else np.pad(world.elevation, pad, mode="edge")
    x_m, y_m = world.origin_m
    goal = (np.nan, np.nan) if goal_m is None else (goal_m[0] - x_m, goal_m[1] - y_m)
    return Building(
        walls=walls_of(world.occupied, world.cell_m),
        terrain=terrain_of(elevation, world.cell_m),
        start=np.array([start_pose[0] - x_m, start_pose[1] - y_m, np.radians(start_pose[2])], np.float32),  # type: ignore[arg-type]
        goal=np.array(goal, np.float32),  # type: ignore[arg-type]
    )


def require_start(world, building, robot):
    """Refuse a start in a wall, or where the robot does not fit.

    Raises:
      InputError: naming the place.
    """
    x, y = (float(v) for v in building.start[:2])
    place = f"start ({x + world.origin_m[0]:.2f}, {y + world.origin_m[1]:.2f}) m of {world.name or 'world'!r}"
    rows, cols = world.shape
    row, col = int(y // world.cell_m), int(x // world.cell_m)
    if not (0 <= row < rows and 0 <= col < cols):
        raise InputError(f"{place}: lies outside")
    if world.occupied[row, col]:
        raise InputError(f"{place}: lies in a wall; choose a free place")
    heading = float(building.start[2])
    if bool(vehicle.touches(jax.tree.map(jnp.asarray, building), robot, jnp.asarray([x, y, heading]))):
        raise InputError(
            f"{place}: a robot of {robot.length_m:g} x {robot.width_m:g} m does not fit there; "
            "choose another place or a smaller robot"
        )


def numbers_of(record, n):
    """A record of settings as arrays with a leading axis of n: whole numbers int32, others float32."""

    def wide(value):
        value = number(value)
        return np.broadcast_to(value, (n,)) if value.ndim == 0 else value

    return jax.tree.map(wide, record)


def _one(building, settings, seed, which, max_steps, room):
    key = jax.random.fold_in(jax.random.key(seed), which)
    robot, tuning, noise = settings
    state = mission.run(key, building, robot, tuning, noise, max_steps, room=room)
    body = state.body
    result = Result(
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
    return result, (state.truth, state.writer.way.pose, state.writer.way.mode, state.writer.way.pitch)


def _one_after_the_other(building, settings, seed, which, count, max_steps, room):
    """`count` runs on a CPU: results with a leading axis, and the way of the last one."""

    def own(i):
        return _one(building, jax.tree.map(lambda a: a[i], settings), seed, which[i], max_steps, room)

    return threads.in_turn(own, which.shape[0], count)


def _all_at_once(building, settings, seed, which, count, max_steps, room):
    """As many runs as there are lanes, in lockstep; those from `count` on are done for nothing."""
    del count
    one = functools.partial(_one, room=room)
    result, track = jax.vmap(one, (None, 0, None, 0, None))(building, settings, seed, which, max_steps)
    return result, jax.tree.map(lambda a: a[0], track)


CONFIGURATION = ("jax_default_device", "jax_enable_x64", "jax_default_prng_impl", "jax_threefry_partitionable")


@functools.lru_cache(maxsize=16)
def _compiled(function, room, tree, shapes, where):
    """A compiled program and the shapes of what it returns; `where` tells apart what `CONFIGURATION` makes differ."""
    del where
    arguments = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(*shape) for shape in shapes])
    lowered = jax.jit(function, static_argnames=("room",)).lower(*arguments, room=room)
    return lowered.compile(), lowered.out_info


@dataclasses.dataclass(kw_only=True)
class _Runs(threads.Work):
    """Runs on their way; a piece of work is one on a CPU, `LANES` on an accelerator."""

    size: int  # runs in a call, those included that are done for nothing
    group: int  # runs in a piece
    program: Callable
    place: tuple  # building and seed, on the device
    settings: tuple  # `[n]` arrays
    which: np.ndarray  # [n] int32
    limit: np.int32
    results: Result  # numpy, [n]
    track: Track | None = None

    def call(self, first, n):
        rows = slice(first * self.group, min((first + n) * self.group, len(self.which)))
        count = rows.stop - rows.start
        settings, which = jax.tree.map(lambda a: _padded(a[rows], self.size), (self.settings, self.which))
        began = time.perf_counter()
        building, seed = self.place
        found, last = jax.block_until_ready(self.program(building, settings, seed, which, np.int32(count), self.limit))
        seconds = time.perf_counter() - began
        return (rows, found, last), seconds

    def keep(self, first, n, found):
        rows, found, last = found
        found = jax.tree.map(lambda a: np.asarray(a)[: rows.stop - rows.start], found)
        jax.tree.map(lambda all_, new: all_.__setitem__(rows, new), self.results, found)
        if first == 0:
            self.track = Track(*(np.asarray(a)[: int(found.steps[0])] for a in last))


def run(building, robots, tunings, noises, seed, which, *, workers, max_steps=MAX_STEPS, on_progress=lambda n: None):
    """Runs, each with its own robot, thresholds and noise.

    Args:
      building: `Building`.
      robots, tunings, noises: `Robot`, `Tuning`, `Noise` of arrays `[n]`, from `numbers_of`.
      seed: int.
      which: `[n]` int32, numbers of the runs: with the seed they make their keys. Runs of one number draw alike.
      workers: threads, on a CPU.
      max_steps: steps after which a run ends as STEP_LIMIT.
      on_progress: called with the number of runs finished so far.

    Returns:
      `Report`. After Ctrl-C it holds what was finished.
    """
    on_cpu = jax.default_backend() == "cpu"
    n = len(which)
    lanes = max(1, min(LANES, n))
    size, group = (CHUNK, 1) if on_cpu else (lanes, lanes)
    function = _one_after_the_other if on_cpu else _all_at_once
    which = np.asarray(which, np.int32)
    settings = dataclasses.replace(robots, name=""), tunings, noises  # a name would make another program
    place, limit = jax.device_put((building, np.uint32(seed))), np.int32(max_steps)
    blank = jax.tree.map(lambda a: np.zeros(size, a.dtype), settings), np.zeros(size, np.int32)
    leaves, tree = jax.tree.flatten((building, blank[0], np.uint32(seed), blank[1], np.int32(0), limit))
    began = time.perf_counter()
    shapes = tuple((np.shape(a), np.asarray(a).dtype) for a in leaves)
    where = jax.default_backend(), *(jax.config.values[name] for name in CONFIGURATION)
    program, found = _compiled(function, max(max_steps, MAX_STEPS), tree, shapes, where)
    compile_s = time.perf_counter() - began
    runs = _Runs(
        pieces=-(-n // group),
        most=size // group,
        size=size,
        group=group,
        program=program,
        place=place,
        settings=settings,
        which=which,
        limit=limit,
        results=jax.tree.map(lambda a: np.zeros((n, *a.shape[1:]), a.dtype), found[0]),
    )
    began, interrupted = time.perf_counter(), False
    try:
        threads.run([runs], workers if on_cpu else 1, lambda done: on_progress(min(done * group, n)))
    except KeyboardInterrupt:
        interrupted = True
    return Report(runs.results, runs.track, compile_s, time.perf_counter() - began, interrupted)


def _padded(array, size):
    return np.concatenate([array, np.repeat(array[-1:], size - len(array), axis=0)])


def outcome_names(result):
    """Names of the outcomes of a `Result` of many runs: list of text."""
    return [Outcome(int(value)).name for value in result.outcome]
