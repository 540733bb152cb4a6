"""Settings of a trace: a building, a robot, thresholds and noise, and which of them are swept."""

import dataclasses
import functools
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jexplore.config import MAX_RUNS, NUMBER_BOUNDS, InputError, as_record, checked_names, require_setting
from jexplore.driving import batch
from jexplore.driving.batch import MAX_STEPS, building_of, pose_in, require_start, settings_arrays
from jexplore.driving.local.batch import run_missions as run_by_map
from jexplore.driving.local.batch import tasks_of
from jexplore.driving.local.window import LocalTask
from jexplore.driving.mission import MAP_SIZE
from jexplore.driving.params.groups import default_numbers
from jexplore.driving.params.tree import Params, params_with
from jexplore.driving.records import Building
from jexplore.driving.settings import (
    BY_WORLD,
    MOST_NODES,
    WHOLE,
    Noise,
    Robot,
    Tuning,
    for_world,
    require_robot,
    require_tuning,
    robot_of,
)
from jexplore.studies import checks
from jexplore.studies.traces.options import NOISE, attributes_of, require_start_pose, swept_values
from jexplore.studies.traces.truth import TraceTruth, maps_from, truth_of
from jexplore.tracemap.record import BtmMap
from jexplore.worlds.regions import warn_of_outside
from jexplore.worlds.starts import draw_starts, start_region
from jexplore.worlds.world import World, with_ring

MAX_TRACE_STEPS = int(NUMBER_BOUNDS["max_steps"][1])
STEPS_M2 = 100  # steps of 4 cm for each square metre of free area: four metres of way
PERCEPTIONS = "triangles", "map"
AUTO = "auto"
"""Triangles on courses and uneven ground, the local map elsewhere."""
OF_MAP = "width_m", "open_m", "speed_m_s", "turn_gain"  # thresholds that count with the second
START_CLEARANCE_M = 0.5  # of starts that are drawn
MIN_NODES = 128  # most nodes of a map of a building, at least
SPARE = 2  # default room for nodes, for each node of the true map
LOCAL_SPARE = 4  # the same with a local map: drift doubles nodes, and room costs nothing


@dataclasses.dataclass(frozen=True)
class TraceJob:
    """Runs that are to be made."""

    world: World
    building: Building
    truth: TraceTruth
    begins: np.ndarray
    """`[S, 3]` float32, poses in the building: run i of every setting begins at i modulo S."""
    robot: Robot
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
    size: tuple[int, int] = MAP_SIZE
    """Most nodes and links of a map; see `map_room`."""
    perception: str = PERCEPTIONS[0]
    attributes: tuple[tuple[str, Any, tuple[float, float]], ...] = ()
    """Name, value and place, metres: the node of every run's map that is nearest to the place in truth gets it."""

    @property
    def places(self) -> int:
        """Return the nodes of the true map, or of its part that the robot can reach."""
        return len(self.truth.map.nodes)

    def settings_of(self, setting: np.ndarray) -> tuple[Robot, Tuning, Noise]:
        """Return robot, thresholds and noise of runs by the numbers of their settings: arrays `[n]`."""
        records = self.robot, *with_values(self.tuning, self.noise, self.chosen(setting))
        return tuple(settings_arrays(record, len(setting)) for record in records)  # type: ignore[return-value]

    def params_of(self, setting: np.ndarray) -> Params | None:
        """Return the numbers of runs by the numbers of their settings, None where none is swept: `params_with`."""
        chosen = self.chosen(setting)
        return params_with({name: chosen[name] for name in default_numbers() if name in chosen}, len(setting))

    def chosen(self, setting: np.ndarray) -> dict[str, np.ndarray]:
        """Return the swept values of runs by the numbers of their settings."""
        return {name: values[setting] for name, values in self.swept.items()}

    def all_runs(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the numbers of settings and of runs of all runs, `[n]` each: a setting after the other."""
        setting, which = np.arange(self.settings), np.arange(self.runs, dtype=np.int32)
        return np.repeat(setting, self.runs), np.tile(which, self.settings)

    def run(self, setting: np.ndarray, which: np.ndarray, **how: Any) -> batch.MissionResults:
        """Make runs `[n]`, by numbers of settings and of runs; `how` as of `batch.run_missions`."""
        if self.perception == "map":
            return run_by_map(self.local_tasks(setting, which), size=self.size, **how)
        how = {"max_steps": self.max_steps, "size": self.size, "params": self.params_of(setting), **how}
        return batch.run_missions(*self._what(setting, which), **how)

    def _what(self, setting, which):
        return self.building, *self.settings_of(setting), self.starts_of(which), self.seed, which

    def local_tasks(self, setting: np.ndarray, which: np.ndarray) -> list[LocalTask]:
        """Return runs `[n]` of robots with a local map, by numbers of settings and of runs."""
        return tasks_of(*self._what(setting, which), self.max_steps)

    def starts_of(self, which: np.ndarray) -> np.ndarray:
        """Return the starts of runs by their numbers: `[n, 3]` float32."""
        return self.begins[which % len(self.begins)]

    @functools.cached_property
    def truths(self) -> tuple[tuple[BtmMap, ...], ...]:
        """Return the correct maps of a run from every start: see `truth.maps_from`."""
        x_m, y_m = self.world.origin_m
        poses = [(float(x) + x_m, float(y) + y_m, math.degrees(heading)) for x, y, heading in self.begins]
        return tuple(maps_from(self.world, self.truth, pose) for pose in poses)

    @property
    def topology(self) -> BtmMap | None:
        """Return the true map of run 0; None if unknown."""
        return next(iter(self.truths[0]), None)


@functools.partial(checked_names, own="trace")
def prepare_trace(
    world: str | os.PathLike[str] | World = "course", *,
    robot: str | Robot = "kamui", runs: int | None = None, starts: int | None = None, seed: int = 0,
    tuning: Tuning | Mapping[str, Any] | None = None, noise: Noise | Mapping[str, Any] | None = None,
    start: tuple[float, float, float] | None = None, sweep: Sequence[str] = (), settings: int = 100,
    cell_m: float = 0.1, max_steps: int | None = None, attributes: Sequence[str] = (),
    nodes: int | None = None, links: int | None = None, perception: str = AUTO,
) -> TraceJob:  # fmt: skip
    """Check everything before anything is compiled.

    Args:
      world: name or `World`. A course has its own start, and mostly a goal; in others the robot starts at `start`.
        Without a goal the run ends when nothing is left to follow.
      robot: name, see `robot_of`.
      runs: of every setting; by default one a start.
      starts: n: run i begins at draw i modulo n of the seed; by default all begin at one place.
      seed: of the draws; run i of every setting draws alike.
      tuning, noise: `Tuning`, `Noise`, or mappings of some of their fields.
      start: x, y, metres; heading, degrees; by default the world's own, else drawn.
      sweep, settings: see `swept_values`. What there is to find is told by the thresholds that are not swept.
      cell_m: edge of a cell, metres.
      max_steps: steps after which a run ends as STEP_LIMIT; by default `MAX_STEPS`, in buildings more by free area.
      attributes: see `attributes_of`.
      nodes, links: most of a map; a run that needs more ends as MAP_FULL. By default see `map_room`.
      perception: `triangles` of single scans, as in the paper; `map`: a local map, on level ground; `auto`: triangles
        on courses and uneven ground, else the map.
    """
    (world,) = checks.ready_worlds([world], cell_m)
    if start is None and world.course is None and (starts or world.start is None):
        warn_of_outside(world, start_region(world, START_CLEARANCE_M))
    world = with_ring(world)
    perception = _perception_of(world, perception)
    if starts is not None and start is not None:
        raise InputError("start and starts exclude each other: give one of them")
    starts = None if starts is None else require_setting("starts", starts)
    n_runs: int = require_setting("runs", (starts or 1) if runs is None else runs)
    seed, settings = require_setting("seed", seed), require_setting("settings", settings)
    most: int = require_setting("max_steps", _enough(world) if max_steps is None else max_steps)
    robot = robot_of(robot) if isinstance(robot, str) else robot
    tuning, noise = as_record("tuning", tuning or {}, Tuning), as_record("noise", noise or {}, Noise)
    tuning = for_world(tuning, is_course=world.course is not None)
    require_robot(robot)
    own, swept = for_world(Tuning(), is_course=world.course is not None), swept_values(sweep, settings, seed)
    _require_perception(perception, tuning, own, swept)
    for name in BY_WORLD.keys() & swept.keys():  # 0 stands for the world's own number
        swept[name] = np.where(swept[name] == 0, getattr(own, name), swept[name])
    count = len(next(iter(swept.values()))) if swept else 1
    if count * n_runs > MAX_RUNS:
        raise InputError(f"{count} settings x {n_runs} runs are more than {MAX_RUNS}; use fewer")
    require_tuning(tuning)
    for i in range(count):
        own_values = {name: int(v[i]) if name in WHOLE else float(v[i]) for name, v in swept.items()}
        require_tuning(with_values(tuning, noise, own_values)[0])
    places = _placed(world, _ends(world, start, starts, seed), robot, tuning)
    size = map_room(world, places[1], nodes, links, LOCAL_SPARE if perception == "map" else SPARE)
    found = robot, tuning, noise, n_runs, seed, swept, count, most, size
    return TraceJob(world, *places, *found, perception, attributes_of(attributes))


def _perception_of(world, perception):
    """Return what `AUTO` stands for in a world; refuse a local map on uneven ground."""
    is_level = world.elevation is None or not np.any(world.elevation)
    if perception == "map" and not is_level:
        raise InputError("perception map: the ground must be level; use --perception triangles")
    if perception == AUTO:
        return "map" if world.course is None and is_level else "triangles"
    return perception


def _require_perception(perception, tuning, own, swept):
    """Refuse an unknown perception, and thresholds other than the world's `own` that do not count with it."""
    if perception not in PERCEPTIONS:
        raise InputError(f"perception must be one of {AUTO}, {', '.join(PERCEPTIONS)}, got {perception!r}")
    given = {f"tuning.{name}": name for name, value in vars(tuning).items() if value != getattr(own, name)}
    given |= {f"sweep: {name}": name for name in swept if not name.startswith(NOISE)}
    unused = [told for told, name in given.items() if name not in OF_MAP]
    if perception == "map" and unused:
        raise InputError(f"{unused[0]} goes with perception triangles; with map {', '.join(OF_MAP)} and noise count")


def map_room(
    world: World, truth: TraceTruth, nodes: int | None = None, links: int | None = None, spare: int = SPARE
) -> tuple[int, int]:
    """Return the most nodes and links of a map.

    By default `MAP_SIZE` of a course; where there is no goal `spare` nodes for each one of the true map, on a course
    that many at least, elsewhere `MIN_NODES`, in doublings, so that similar buildings share a program. Two links a
    node.
    """
    wanted = max(spare * len(truth.map.nodes), MIN_NODES if world.course is None else MAP_SIZE[0])
    room = MAP_SIZE[0] if _has_goal(world) else 1 << (min(wanted, MOST_NODES) - 1).bit_length()
    room = require_setting("nodes", room if nodes is None else nodes)
    return room, require_setting("links", 2 * room if links is None else links)


def _has_goal(world):
    return world.course is not None and world.course.goal_m is not None


def _enough(world):
    """Return the steps that suffice for a world, in whole `MAX_STEPS`."""
    wanted = MAX_STEPS if _has_goal(world) else STEPS_M2 * world.free_m2
    return int(min(-(-max(wanted, MAX_STEPS) // MAX_STEPS) * MAX_STEPS, MAX_TRACE_STEPS))


def _placed(world, poses, robot, tuning):
    """Return `(building, truth, begins)`: see `TraceJob`."""
    goal = world.course and world.course.goal_m
    begins = np.stack([pose_in(world, pose) for pose in poses])
    building = building_of(world, goal)
    for pose in begins:
        require_start(world, building, robot, pose)
    x_m, y_m = begins[0, :2]
    at = int(y_m / world.cell_m), int(x_m / world.cell_m)
    truth = truth_of(world, at, robot.width_m, tuning.open_m)
    return building_of(world, goal, truth.marks), truth, begins


def with_values(tuning, noise, values):
    """Replace values of thresholds and, by names like `noise.range_m`, of noise; others are left out."""
    values = {name: v.astype(np.int32) if name in WHOLE and np.ndim(v) else v for name, v in values.items()}
    thresholds = {name: value for name, value in values.items() if "." not in name}
    errors = {name.removeprefix(NOISE): value for name, value in values.items() if name.startswith(NOISE)}
    return dataclasses.replace(tuning, **thresholds), dataclasses.replace(noise, **errors)


def _ends(world, start, starts, seed) -> list[Any]:
    """Return the starts of runs, a list of poses in the world's frame."""
    if start is not None:
        require_start_pose(start)
        return [tuple(start)]
    if world.course is not None and starts is None:
        return [world.course.start_pose]
    is_own, half = world.start and starts is None, world.cell_m / 2
    cells = [world.start] if is_own else draw_starts(world, seed, starts or 1, START_CLEARANCE_M)
    x_m, y_m = world.origin_m
    return [(x_m + c * world.cell_m + half, y_m + r * world.cell_m + half, float(deg)) for r, c, deg in cells]
