"""Many runs of one building, one by one or in lanes, with results that are equal but for rounding.

Robot, thresholds and noise are arrays and may differ between runs: a sweep over any of them takes a single program.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.arrays.padding import number
from jexplore.config import InputError
from jexplore.driving import vehicle
from jexplore.driving.building.terrain import terrain_of
from jexplore.driving.building.walls import walls_of
from jexplore.driving.mission import MAP_SIZE, MissionTask, RunOutcome, RunResult, Setup, mission_program
from jexplore.driving.params.tree import Params
from jexplore.driving.records import Building
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.engine.program import Line
from jexplore.engine.runner import Costs, find_resources, level_of, run_all
from jexplore.worlds.world import World

MAX_STEPS = 6000
# Two thirds of the time of compiling and two fifths of its memory, for steps that take 7 % longer. JAX 0.11.2 and
# later do not have it.
COMPILER_OPTIONS = (("xla_cpu_use_fusion_emitters", False),)
MARKS_MULTIPLE = 64  # numbers of places to visit are padded to multiples of this

_Settings = TypeVar("_Settings", Robot, Tuning, Noise)


class Driven(NamedTuple):
    """Trajectory of one run, step by step, on the host."""

    truth: np.ndarray  # [n, 3] float32, x, y, metres; heading, radians
    estimate: np.ndarray  # [n, 3] float32, as `truth`, by odometry
    mode: np.ndarray  # [n] int32, `RunMode`
    pitch: np.ndarray  # [n] float32, measured, radians


class MissionResults(NamedTuple):
    """Results of `run_missions`."""

    result: RunResult  # numpy, with a leading axis; outcome RUNNING where it was interrupted before, or not asked for
    driven: Driven | None  # the way of run 0, if that was made
    costs: Costs


def building_of(world: World, goal_m: tuple[float, float] | None = None, marks_m: np.ndarray | None = None) -> Building:
    """Prepare a world for runs.

    Args:
      goal_m: x, y, metres, in the world's frame; None: the run goes on until nothing is left.
      marks_m: `[K, 3]`, places whose visits are recorded: x, y, radius, metres, in the world's frame.

    Returns:
      `Building` of numpy arrays, padded; its cell (0, 0) begins at (0, 0).
    """
    elevation = world.elevation
    if elevation is not None and np.any(elevation):  # a square, so that similar buildings share a program
        side = 1 << (max(world.shape) - 1).bit_length()
        elevation = np.pad(elevation, [(0, side - n) for n in world.shape], mode="edge")
    x_m, y_m = world.origin_m
    goal = (np.nan, np.nan) if goal_m is None else (goal_m[0] - x_m, goal_m[1] - y_m)
    marks = np.zeros((0, 3)) if marks_m is None else np.asarray(marks_m) - [x_m, y_m, 0]
    n_marks = MARKS_MULTIPLE * max(1, -(-len(marks) // MARKS_MULTIPLE))
    # Ignored types: numpy on the host, where the record says what it is on the device.
    return Building(
        walls=walls_of(world.occupied, world.cell_m),
        terrain=terrain_of(elevation, world.cell_m),
        goal=np.array(goal, np.float32),  # type: ignore[arg-type]
        marks=np.pad(marks, [(0, n_marks - len(marks)), (0, 0)], constant_values=-1e6).astype(np.float32),  # type: ignore[arg-type]
    )


def pose_in(world: World, start_pose: tuple[float, float, float]) -> np.ndarray:
    """Convert a pose to a building's frame: `[3]` float32, x, y, metres from cell (0, 0); heading, radians.

    Args:
      start_pose: x, y, metres; heading, degrees; in the world's frame.
    """
    x_m, y_m = world.origin_m
    return np.array([start_pose[0] - x_m, start_pose[1] - y_m, np.radians(start_pose[2])], np.float32)


def require_start(world: World, building: Building, robot: Robot, start: np.ndarray) -> None:
    """Refuse a start in a wall, or where the robot does not fit.

    Raises:
      InputError: naming the place.
    """
    if why := why_unfit(world, building, robot, start):
        x_m, y_m = start[:2].astype(float) + world.origin_m
        raise InputError(f"start ({x_m:.2f}, {y_m:.2f}) m of {world.name or 'world'!r}: {why}")


def why_unfit(world: World, building: Building, robot: Robot, start: np.ndarray) -> str:
    """Explain why a robot cannot start at a pose from `pose_in`; empty if it can."""
    x, y = (float(v) for v in start[:2])
    rows, cols = world.shape
    row, col = int(y // world.cell_m), int(x // world.cell_m)
    if not (0 <= row < rows and 0 <= col < cols):
        return "lies outside"
    if world.occupied[row, col]:
        return "lies in a wall; choose a free place"
    if bool(vehicle.touches(jax.tree.map(jnp.asarray, building), robot, jnp.asarray(start))):
        size = f"{robot.length_m:g} x {robot.width_m:g} m"
        return f"a robot of {size} does not fit there; choose another place or a smaller robot"
    return ""


def settings_arrays(record: _Settings, n: int) -> _Settings:
    """Convert a record of settings to arrays with a leading axis of n.

    Fields declared as int become int32, others float32, so that 0 and 0.0 share a program.
    """

    def wide(field):
        value = number(getattr(record, field.name))
        value = value if field.type is int else value.astype(np.float32)
        return np.broadcast_to(value, (n,)) if value.ndim == 0 else value

    fields = [field for field in dataclasses.fields(record) if field.type is not str]
    return dataclasses.replace(record, **{field.name: wide(field) for field in fields})


def run_missions(
    building: Building,
    robots: Robot,
    tunings: Tuning,
    noises: Noise,
    starts: np.ndarray,
    seed: int,
    draws: np.ndarray,
    *,
    params: Params | None = None,
    engine: str = "auto",
    lanes: int | None = None,
    workers: int | None = None,
    max_steps: int = MAX_STEPS,
    size: tuple[int, int] = MAP_SIZE,
    on_progress: Callable[[int], object] | None = None,
    blocks: Sequence[tuple[int, int]] | None = None,
    on_block: Callable[[int, RunResult, Driven | None], object] | None = None,
    ways: bool = False,
) -> MissionResults:
    """Make runs, each with its own robot, thresholds and noise.

    Args:
      robots, tunings, noises: `Robot`, `Tuning`, `Noise` of arrays `[n]`, from `settings_arrays`.
      starts: `[n, 3]` float32, from `pose_in`.
      draws: `[n]` int32: with the seed they make the runs' keys. Runs of one number draw alike.
      params: `Params` of arrays `[n]`; None: the defaults, compiled in as constants.
      engine, lanes, workers: see `runner.find_resources`.
      max_steps: steps after which a run ends as STEP_LIMIT.
      size: most nodes and links of a map; static.
      on_progress: called with the number of finished runs.
      blocks: list of `(first, n)`: the runs that are to be made, in this order; by default all.
      on_block: called with the number of a block, its `RunResult` and the way of run 0, if it has it, once its runs
        have ended, soon after, from the calling thread.
      ways: whether `on_block` gets the way of the first run of every block: with blocks of one run, of every run.

    Returns:
      `MissionResults`. After Ctrl-C it holds what was finished.

    Raises:
      InputError: an engine that does not exist, lanes or workers out of range, lanes where there are none to set.
      KeyboardInterrupt: after Ctrl-C, where nothing was finished.
      MemoryError: a device's memory does not suffice, not even for half the lanes.
    """
    draws = np.asarray(draws, np.int32)
    resources = find_resources(engine=engine, lanes=lanes, workers=workers)
    unnamed = dataclasses.replace(robots, name="")  # a name would make another program
    settings = MissionTask(unnamed, tunings, noises, np.asarray(starts, np.float32), params)  # type: ignore[arg-type]
    program = mission_program(Setup(step_slots(max_steps), *size))._replace(cpu_options=COMPILER_OPTIONS)
    limit, lines = np.int32(max_steps), []
    for phase, (first, n) in enumerate([(0, len(draws))] if blocks is None else blocks):
        own = jax.tree.map(lambda a, at=slice(first, first + n): a[at], (settings, draws))
        what = program, (), building, limit, seed, own[0], np.arange(n)
        lines.append(Line(*what, detailed=0 if ways or first == 0 else -1, draws=own[1], phase=phase))
    tell = None if on_block is None else (lambda i: on_block(i, lines[i].results, _driven(lines[i])))
    costs = run_all(lines, resources, on_progress, tell)
    costs.engine, costs.levels = engine, {robots.name: [level_of(lines[0], resources)]}
    return _merge_blocks(lines, blocks or [(0, len(draws))], len(draws), costs)


def step_slots(max_steps: int) -> int:
    """Round a number of steps up to one of few buffer sizes, so that buildings share programs."""
    return MAX_STEPS << ((max_steps - 1) // MAX_STEPS).bit_length()


def _merge_blocks(lines, blocks, n, costs):
    """Merge the results of blocks of n runs."""
    result = jax.tree.map(lambda a: np.zeros((n, *a.shape[1:]), a.dtype), lines[0].results)
    for (first, some), line in zip(blocks, lines):
        jax.tree.map(lambda whole, own, at=slice(first, first + some): whole.__setitem__(at, own), result, line.results)
    driven = [_driven(line) for (first, _), line in zip(blocks, lines) if first == 0]
    return MissionResults(result, driven[0] if driven else None, costs)


def _driven(line):
    """Return the trajectory of run 0; None if the group does not hold it or it was interrupted before."""
    if line.detail is None:
        return None
    return Driven(*(np.asarray(a)[: int(line.results.steps[0])] for a in line.detail))


def outcome_names(result: RunResult) -> list[str]:
    """Return the names of the outcomes of a `RunResult` of many runs."""
    return [RunOutcome(int(value)).name for value in result.outcome]
