"""What a trace is asked: a building, a robot, thresholds and noise, and which of them are swept."""

import dataclasses
import itertools
import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from jexplore.config import MAX_SEED, InputError, require_number, require_whole
from jexplore.driving import vehicle
from jexplore.driving.batch import MAX_STEPS, building_of, require_start
from jexplore.driving.settings import ROBOTS, Noise, Robot, Tuning, require_noise, require_robot, require_tuning
from jexplore.studies import checks
from jexplore.worlds.starts import draw_start
from jexplore.worlds.world import World

MAX_RUNS = 1_000_000
NOISE = "noise."  # names of noise begin so in a sweep


@dataclasses.dataclass(frozen=True)
class TraceJob:
    """Runs that are to be made."""

    world: World
    building: vehicle.Building
    robot: Any
    tuning: Tuning
    """Numbers, or arrays `[S]` where a threshold is swept."""
    noise: Noise
    runs: int
    """Of every setting."""
    seed: int
    swept: dict[str, np.ndarray]
    """Name of a threshold -> `[S]` values."""
    settings: int
    max_steps: int

    def first_settings(self) -> tuple[Any, Tuning, Noise]:
        """Robot, thresholds and noise of run 0: `(Robot, Tuning, Noise)`."""
        own = {name: int(v[0]) if name == "votes" else float(v[0]) for name, v in self.swept.items()}
        return self.robot, *with_values(self.tuning, self.noise, own)


def robot_of(name: str) -> Robot:
    """A robot by name, with other measures where they are given: `kamui`, `kamui:width_m=0.6`.

    Raises:
      InputError: no such robot or measure, or a value out of range.
    """
    base, _, rest = name.partition(":")
    if base not in ROBOTS:
        raise InputError(f"robot must be one of {', '.join(ROBOTS)}, got {base!r}")
    changed = {}
    numbers = [field.name for field in dataclasses.fields(ROBOTS[base]) if field.name != "name"]
    for part in rest.split(",") if rest else ():
        key, _, value = part.partition("=")
        if key not in numbers:
            raise InputError(f"robot {name!r}: there is no {key!r}; there are {', '.join(numbers)}")
        try:
            changed[key] = float(value)
        except ValueError:
            raise InputError(f"robot {name!r}: {key} must be a number, got {value!r}") from None
    robot = dataclasses.replace(ROBOTS[base], name=name, **changed)
    require_robot(robot)
    return robot


def swept_values(sweep: Sequence[str], settings: int, seed: int) -> dict[str, np.ndarray]:
    """Values of thresholds to be swept.

    Lists alone make every combination; with a range among them, `settings` draws by Latin hypercube.

    Args:
      sweep: list of text: `votes=1,3,5` a list, `circle=1.1:2.0` a range.
      settings: how many draws, where there is a range.
      seed: of the draws.

    Returns:
      `{name: [S] values}`, S = 1 without a sweep.

    Raises:
      InputError: no such threshold, or a value that is none.
    """
    known = {field.name: field.type for field in dataclasses.fields(Tuning)} | {
        f"{NOISE}{field.name}": field.type for field in dataclasses.fields(Noise)
    }
    lists, ranges = {}, {}
    for text in sweep:
        name, equals, values = text.partition("=")
        if name in lists or name in ranges:
            raise InputError(f"sweep names {name} more than once")
        if name not in known or not equals:
            names = ", ".join(known)
            raise InputError(f"sweep must be NAME=A,B,... or NAME=LOW:HIGH, got {text!r}; there are {names}")
        try:
            if ":" in values:
                low, high = (float(v) for v in values.split(":", 1))
                if not low < high:
                    raise InputError(f"sweep {text!r}: a range must rise, as in {name}={high:g}:{low:g}")
                ranges[name] = (low, high)
            else:
                lists[name] = [float(v) for v in values.split(",")]
                if name == "votes" and any(value != int(value) for value in lists[name]):
                    raise InputError(f"sweep {text!r}: votes must be integers")
        except InputError:
            raise
        except (ValueError, OverflowError):
            raise InputError(f"sweep {text!r}: values must be numbers") from None
    if not ranges:
        if math.prod(len(values) for values in lists.values()) > MAX_RUNS:
            raise InputError(f"sweep: more than {MAX_RUNS} combinations; use fewer values")
        rows = list(itertools.product(*lists.values()))
        return {name: np.array([row[i] for row in rows]) for i, name in enumerate(lists)}
    from scipy.stats import qmc

    names = [*ranges, *lists]
    draws = qmc.LatinHypercube(len(names), rng=np.random.default_rng(seed)).random(settings)
    values = {name: low + draws[:, i] * (high - low) for i, (name, (low, high)) in enumerate(ranges.items())}
    for i, (name, given) in enumerate(lists.items(), len(ranges)):
        values[name] = np.asarray(given)[np.minimum((draws[:, i] * len(given)).astype(int), len(given) - 1)]
    return {name: np.round(value) if name == "votes" else value for name, value in values.items()}


def prepare_trace(
    world: str | os.PathLike[str] | World = "course",
    *,
    robot: str | Robot = "kamui",
    runs: int = 1,
    seed: int = 0,
    tuning: Tuning | None = None,
    noise: Noise | None = None,
    start: tuple[float, float, float] | None = None,
    sweep: Sequence[str] = (),
    settings: int = 100,
    cell_m: float = 0.1,
    max_steps: int = MAX_STEPS,
) -> TraceJob:
    """Checks everything before anything is compiled.

    Args:
      world: name or `World`. A course has its own start and goal; in others the robot starts at `start` and the run
        ends when nothing is left to follow.
      robot: name, see `robot_of`.
      runs: of every setting.
      seed: of the draws; run i of every setting draws alike.
      tuning, noise: `Tuning`, `Noise`.
      start: x, y, metres; heading, degrees; by default the world's own, else drawn.
      sweep, settings: see `swept_values`.
      cell_m: edge of a cell, metres.
      max_steps: steps after which a run ends as STEP_LIMIT.

    Returns:
      `TraceJob`.

    Raises:
      InputError: what cannot be run, in one line.
    """
    (world,) = checks.ready_worlds([world], cell_m)
    runs = require_whole("runs", runs, 1, MAX_RUNS)
    seed = require_whole("seed", seed, 0, MAX_SEED)
    settings = require_whole("settings", settings, 1, MAX_RUNS)
    max_steps = require_whole("max_steps", max_steps, 100, 100_000)
    robot = robot_of(robot) if isinstance(robot, str) else robot
    tuning, noise = tuning or Tuning(), noise or Noise()
    require_robot(robot)
    require_tuning(tuning)
    require_noise(noise)
    swept = swept_values(sweep, settings, seed)
    count = len(next(iter(swept.values()))) if swept else 1
    if count * runs > MAX_RUNS:
        raise InputError(f"{count} settings x {runs} runs are more than {MAX_RUNS}; use fewer")
    for i in range(count):
        own = {name: int(v[i]) if name == "votes" else float(v[i]) for name, v in swept.items()}
        tuned, noisy = with_values(tuning, noise, own)
        require_tuning(tuned)
        require_noise(noisy)
    pose, goal = _ends(world, start, seed)
    building = building_of(world, pose, goal)
    require_start(world, building, robot)
    return TraceJob(world, building, robot, tuning, noise, runs, seed, swept, count, max_steps)


def with_values(tuning, noise, values):
    """Thresholds and noise with some values replaced; those of the noise have names like `noise.range_m`."""
    thresholds = {name: value for name, value in values.items() if not name.startswith(NOISE)}
    errors = {name.removeprefix(NOISE): value for name, value in values.items() if name.startswith(NOISE)}
    return dataclasses.replace(tuning, **thresholds), dataclasses.replace(noise, **errors)


def _ends(world, start, seed) -> tuple[Any, Any]:
    """Where a run starts and ends, in the world's frame."""
    goal = None if world.course is None else world.course.goal_m
    if start is not None:
        for name, value in zip(("x", "y", "heading"), start):
            require_number(f"start {name}", value, low=-1e6, high=1e6)
        return tuple(start), goal
    if world.course is not None:
        return world.course.start_pose, goal
    row, col, heading = world.start or draw_start(world, seed, 0, 0.5)
    x_m, y_m = world.origin_m
    return (x_m + (col + 0.5) * world.cell_m, y_m + (row + 0.5) * world.cell_m, float(heading)), goal
