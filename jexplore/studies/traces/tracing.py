"""Runs that write Behavioral Trace Maps: how many alike, how near to the truth, over which settings."""

import dataclasses
import itertools
import math
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jexplore import btm
from jexplore.config import MAX_SEED, InputError, require_number, require_whole
from jexplore.driving import batch, vehicle
from jexplore.driving.batch import (
    MAX_STEPS,
    Driven,
    Finished,
    building_of,
    numbers_of,
    outcome_names,
    require_start,
)
from jexplore.driving.settings import ROBOTS, Noise, Robot, Tuning, require_noise, require_robot, require_tuning
from jexplore.studies import checks
from jexplore.tracemap.record import BtmMap
from jexplore.tracemap.similarity import code
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
        return self.robot, *_with(self.tuning, self.noise, own)


@dataclasses.dataclass(frozen=True)
class Traced:
    """What `trace` found."""

    plan: TraceJob
    table: Any
    """pandas DataFrame, a row a run."""
    first: BtmMap
    """Map of run 0."""
    driven: Driven | None
    """Way of run 0."""
    report: Finished

    @property
    def truth(self) -> BtmMap | None:
        """The world's true topology, a `BtmMap`; None where it has none."""
        course = self.plan.world.course
        return None if course is None else course.topology


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
        tuned, noisy = _with(tuning, noise, own)
        require_tuning(tuned)
        require_noise(noisy)
    pose, goal = _ends(world, start, seed)
    building = building_of(world, pose, goal)
    require_start(world, building, robot)
    return TraceJob(world, building, robot, tuning, noise, runs, seed, swept, count, max_steps)


def _with(tuning, noise, values):
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


def execute(
    plan: TraceJob,
    *,
    engine: str | None = None,
    lanes: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], Any] | None = None,
) -> Traced:
    """Makes the runs of a plan.

    Args:
      plan: `TraceJob`.
      engine, lanes, workers: see `runner.find_resources`; results are equal.
      on_progress: called with the number of runs finished so far.

    Returns:
      `Traced`.
    """
    n = plan.runs * plan.settings
    setting = np.repeat(np.arange(plan.settings), plan.runs)
    which = np.tile(np.arange(plan.runs, dtype=np.int32), plan.settings)
    chosen = {name: values[setting] for name, values in plan.swept.items()}
    if "votes" in chosen:
        chosen["votes"] = chosen["votes"].astype(np.int32)
    tuning, noise = _with(plan.tuning, plan.noise, chosen)
    report = batch.run_missions(
        plan.building,
        numbers_of(plan.robot, n),
        numbers_of(tuning, n),
        numbers_of(noise, n),
        plan.seed,
        which,
        engine=engine,
        lanes=lanes,
        workers=workers,
        max_steps=plan.max_steps,
        on_progress=on_progress,
    )
    table, first = _table(plan, report.result, setting, which, chosen)
    return Traced(plan, table, first, report.driven, report)


def trace(
    world: str | os.PathLike[str] | World = "course",
    *,
    engine: str | None = None,
    lanes: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], Any] | None = None,
    **options: Any,
) -> Traced:
    """Lets a robot drive through a building and write its Behavioral Trace Map, once or many times.

    Args:
      world: name or `World`.
      engine, lanes, workers: see `runner.find_resources`; results are equal.
      on_progress: called with the number of runs finished so far.
      **options: see `prepare_trace`.

    Returns:
      `Traced`.

    Raises:
      InputError: what cannot be run, in one line.
    """
    plan = prepare_trace(world, **options)
    return execute(plan, engine=engine, lanes=lanes, workers=workers, on_progress=on_progress)


def map_of(plan: TraceJob, result: Any, i: int) -> BtmMap:
    """The map of run i of a `Result`: `BtmMap`."""
    import jax

    own = jax.tree.map(lambda a: a[i], result.map)
    about = {"world": plan.world.name, "robot": plan.robot.name, "seed": plan.seed}
    return btm.to_map(own, origin_m=plan.world.origin_m, **about)


def _table(plan, result, setting, which, chosen):
    import pandas as pd

    maps = [map_of(plan, result, i) for i in range(len(which))]
    codes = [code(found) for found in maps]
    course = plan.world.course
    truth = None if course is None else code(course.topology)
    slopes = [[n.inclination_deg for n in m.nodes if n.inclination_deg is not None] for m in maps]
    steps = [[n.step_m for n in m.nodes if n.step_m is not None] for m in maps]
    table = pd.DataFrame(
        {
            "world": plan.world.name,
            "robot": plan.robot.name,
            "setting": setting,
            "run": which,
            **chosen,
            "outcome": outcome_names(result),
            "steps": result.steps,
            "time_s": result.steps * vehicle.DT_S,
            "path_m": result.path_m,
            "contacts": result.contacts,
            "refused": result.refused,
            "interventions": result.interventions,
            "drift_m": result.drift_m,
            "nodes": [len(m.nodes) for m in maps],
            "links": [len(m.links) for m in maps],
            "unsearched": [sum(link.status == "un-searched" for link in m.links) for m in maps],
            "inclination_deg": [max(s, default=np.nan) for s in slopes],
            "step_m": [max(s, default=np.nan) for s in steps],
            "overflow": result.map.overflow,
            "scan_overflow": result.scan_overflow,
            "code": codes,
            "true": pd.array([None if truth is None else found == truth for found in codes], dtype="boolean"),
        }
    )
    return table[table["outcome"] != "RUNNING"].reset_index(drop=True), maps[0]
