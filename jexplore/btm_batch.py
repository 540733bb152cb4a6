"""Many runs of one building: on the cores of a CPU one after the other, on an accelerator all at once.

Robot, thresholds and noise differ from run to run as the caller likes: they are arrays, so that a sweep over any of
them is one program.
"""

import functools
import time
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore import btm_run, vehicle
from jexplore.btm import Btm
from jexplore.btm_run import Outcome
from jexplore.config import InputError
from jexplore.terrain import terrain_of
from jexplore.vehicle import Building
from jexplore.walls import walls_of

MAX_STEPS = 6000
CHUNK = 16  # most runs in one call on a CPU
CHUNK_S = 1.0  # seconds that a call should take there
LANES = 1024  # runs in one call on an accelerator
MULTIPLE = 64  # sides and walls are padded to multiples of this, so that similar buildings share a program


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
        walls=walls_of(world.occupied, world.cell_m, multiple=MULTIPLE),
        terrain=terrain_of(elevation, world.cell_m),
        occupied=np.pad(world.occupied, pad, constant_values=True),  # type: ignore[arg-type]
        cell_m=np.float32(world.cell_m),  # type: ignore[arg-type]
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
        value = np.asarray(value)
        kind = np.int32 if value.dtype.kind in "iu" else np.float32
        return np.broadcast_to(value.astype(kind), (n,)) if value.ndim == 0 else value.astype(kind)

    return jax.tree.map(wide, record)


def _one(building, settings, seed, which, max_steps, room):
    key = jax.random.fold_in(jax.random.key(seed), which)
    robot, tuning, noise = settings
    state = btm_run.run(key, building, robot, tuning, noise, max_steps, room=room)
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

    def one(i, state):
        result, track = own(i)
        return jax.tree.map(lambda all_, new: all_.at[i].set(new), state[0], result), track

    result, track = jax.eval_shape(own, 0)
    results = jax.tree.map(lambda a: jnp.zeros((which.shape[0], *a.shape), a.dtype), result)
    return lax.fori_loop(0, count, one, (results, jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), track)))


def _all_at_once(building, settings, seed, which, count, max_steps, room):
    """As many runs as there are lanes, in lockstep; those from `count` on are done for nothing."""
    del count
    one = functools.partial(_one, room=room)
    result, track = jax.vmap(one, (None, 0, None, 0, None))(building, settings, seed, which, max_steps)
    return result, jax.tree.map(lambda a: a[0], track)


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
    size = CHUNK if on_cpu else min(LANES, len(which))
    function = jax.jit(_one_after_the_other if on_cpu else _all_at_once, static_argnames=("room",))
    which = np.asarray(which, np.int32)
    arrays = (robots, tunings, noises), which
    place, seed = jax.device_put((building, np.uint32(seed)))
    n = len(which)
    blank = jax.tree.map(lambda a: np.zeros((size, *a.shape[1:]), a.dtype), arrays)
    began = time.perf_counter()
    limit, room = np.int32(max_steps), max(max_steps, MAX_STEPS)
    lowered = function.lower(place, blank[0], seed, blank[1], np.int32(0), limit, room=room)
    program = lowered.compile()
    compile_s = time.perf_counter() - began
    results = jax.tree.map(lambda a: np.zeros((n, *a.shape[1:]), a.dtype), lowered.out_info[0])
    track = None

    def call(at, count):
        settings, numbers = jax.tree.map(lambda a: _padded(a[at : at + count], size), arrays)
        start = time.perf_counter()
        found, last = jax.block_until_ready(program(place, settings, seed, numbers, np.int32(count), limit))
        return at, count, jax.tree.map(np.asarray, found), last, time.perf_counter() - start

    began, done, at, run_s, interrupted = time.perf_counter(), 0, 0, None, False
    pool = ThreadPoolExecutor(workers if on_cpu else 1)
    running = set()
    try:
        while at < n or running:
            while at < n and len(running) < (workers if on_cpu else 1):
                count = min(n - at, _calls(size, on_cpu, run_s, n, workers))
                running.add(pool.submit(call, at, count))
                at += count
            ended, running = wait(running, return_when=FIRST_COMPLETED)
            for future in ended:
                begin, count, found, last, seconds = future.result()
                rows = slice(begin, begin + count)
                own = jax.tree.map(lambda a, count=count: a[:count], found)
                jax.tree.map(lambda all_, new, rows=rows: all_.__setitem__(rows, new), results, own)
                if begin == 0:
                    steps = int(np.asarray(found.steps)[0])
                    track = Track(*(np.asarray(a)[:steps] for a in last))
                run_s, done = seconds / count, done + count
            on_progress(done)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return Report(results, track, compile_s, time.perf_counter() - began, interrupted)


def _calls(size, on_cpu, run_s, n, workers):
    """How many runs the next call takes: on a CPU the first only one, whose way is kept, then about a second's."""
    if not on_cpu:
        return size
    if run_s is None:
        return 1
    return max(1, min(size, int(CHUNK_S / max(run_s, 1e-6)), -(-n // workers)))


def _padded(array, size):
    return np.concatenate([array, np.repeat(array[-1:], size - len(array), axis=0)])


def outcome_names(result):
    """Names of the outcomes of a `Result` of many runs: list of text."""
    return [Outcome(int(value)).name for value in result.outcome]
