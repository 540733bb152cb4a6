"""Runs that write Behavioral Trace Maps: how many alike, how near to the truth, over which settings."""

import dataclasses
import json
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
import pandas as pd

from jexplore import btm
from jexplore.config import InputError, __version__, checked_names, require_engine
from jexplore.driving import vehicle
from jexplore.driving.batch import Driven, outcome_names
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.engine.runner import Costs
from jexplore.report import store
from jexplore.report.ledger import Ledger, Work
from jexplore.studies.results.details import packed, unpacked
from jexplore.studies.results.progress import progress_bar
from jexplore.studies.results.provenance import world_digest
from jexplore.studies.results.units import MAX_UNITS_OF_JOB, MIN_UNIT_EPISODES
from jexplore.studies.traces.job import AUTO, TraceJob, prepare_trace
from jexplore.studies.traces.recording import scans_of
from jexplore.studies.traces.truth import false_divergences
from jexplore.tracemap import json_form
from jexplore.tracemap.passable import BLOCKED, blocked_for
from jexplore.tracemap.record import BtmMap, closings_of
from jexplore.tracemap.similarity import code
from jexplore.worlds.readers.scans import ScanLog
from jexplore.worlds.world import World

ODOMETRY_FRAME = "odom"  # of a run's map: places as by the odometry, corrected by scans and at nodes met again
FIRST = "_first"  # column of a unit's file: map and way of run 0


@checked_names
@dataclasses.dataclass(frozen=True)
class TraceResult:
    """Result of `trace`."""

    plan: TraceJob
    table: Any
    """pandas DataFrame, a row a run."""
    first: BtmMap
    """Map of run 0."""
    driven: Driven
    """Way of run 0."""
    costs: Costs
    """Costs of the runs that were made here."""
    maps: dict[int, BtmMap] = dataclasses.field(default_factory=dict)
    """Number of a run, in the order of the table -> its map; of the runs that were made here."""
    resumed: int = 0
    """Runs that were there before, with which this one went on."""

    @property
    def truth(self) -> BtmMap | None:
        """Return the true map: see `TraceJob.topology`."""
        return self.plan.topology

    def scans(self) -> ScanLog:
        """Return the scans of run 0 along its way: see `recording.scans_of`."""
        return scans_of(self.plan, self.driven)


def run_blocks(plan: TraceJob) -> list[tuple[int, int]]:
    """Return the units of a plan: `(first run, number of runs)`."""
    n = plan.runs * plan.settings
    # With a local map a run takes tens of seconds: after Ctrl-C each is kept.
    size = max(1 if plan.perception == "map" else MIN_UNIT_EPISODES, -(-n // MAX_UNITS_OF_JOB))
    return [(first, min(size, n - first)) for first in range(0, n, size)]


def asked_of_runs(plan: TraceJob) -> dict[str, Any]:
    """Return all that the results of a plan depend on, as plain values."""
    return {
        "version": __version__,
        "world": os.fspath(plan.world.name),
        **{name: getattr(plan, name) for name in ("robot", "tuning", "noise", "runs", "seed", "swept", "max_steps")},
        **{name: getattr(plan, name) for name in ("size", "perception", "attributes")},
        "starts": plan.begins,
        "digest": world_digest(plan.world),
    }


def execute(
    plan: TraceJob, *, engine: str = "auto", lanes: int | None = None, workers: int | None = None,
    on_progress: Callable[[int], Any] | None = None, ledger: Ledger | None = None,
) -> TraceResult:  # fmt: skip
    """Make the runs of a plan that the ledger does not have.

    `on_progress` is called with the number of finished runs, including earlier ones. After Ctrl-C the result holds what
    was finished.

    Raises:
      KeyboardInterrupt: the first unit has not been finished.
    """
    if plan.perception == "map" and (engine, lanes) != ("auto", None):
        raise InputError("engine and lanes go with perception triangles: a local map runs on the CPU")
    blocks, (setting, which) = run_blocks(plan), plan.all_runs()
    work = Work(range(len(blocks)), ledger)
    resumed, costs, maps = sum(map(len, work.done.values())), Costs(), {}

    def put(place, result, driven):
        first, n = blocks[work.left[place]]
        own, runs = setting[first : first + n], which[first : first + n]
        table, found = trace_table(plan, result, own, runs, plan.chosen(own))
        maps.update(enumerate(found, first))
        if first == 0:
            page = json.dumps(store.jsonable(json_form.to_json(found[0])))
            table = table.assign(**{FIRST: [packed(map=page, **driven._asdict()), *[None] * (n - 1)]})
        work.put(work.left[place], table)

    if work.left:
        moved = None if on_progress is None else (lambda done: on_progress(done + resumed))
        how = {"engine": engine, "lanes": lanes, "workers": workers, "on_progress": moved}
        if plan.perception == "map":
            how = {"workers": workers, "on_progress": moved}
        try:
            costs = plan.run(setting, which, blocks=[blocks[i] for i in work.left], on_block=put, **how).costs
        except KeyboardInterrupt:
            costs = Costs(interrupted=True)
    if 0 not in work.done:
        raise KeyboardInterrupt
    table = pd.concat(work.results, ignore_index=True)
    way = unpacked(table.pop(FIRST).iloc[0])
    first = json_form.parse_map(way.pop("map"), "the map of run 0")
    return TraceResult(plan, table, first, Driven(**way), costs, maps, resumed)


@checked_names
def trace(
    world: str | os.PathLike[str] | World = "course", *,
    robot: str | Robot = "kamui", runs: int | None = None, starts: int | None = None, seed: int = 0,
    tuning: Tuning | Mapping[str, Any] | None = None, noise: Noise | Mapping[str, Any] | None = None,
    start: tuple[float, float, float] | None = None, sweep: Sequence[str] = (), settings: int = 100,
    cell_m: float = 0.1, max_steps: int | None = None, attributes: Sequence[str] = (),
    nodes: int | None = None, links: int | None = None, perception: str = AUTO,
    engine: str = "auto", lanes: int | None = None, workers: int | None = None,
    on_progress: Callable[[int], Any] | None = None, progress: bool | None = None,
) -> TraceResult:  # fmt: skip
    """Let a robot drive through a building and write its trace map, once or many times.

    Args:
      world, robot, runs, starts, seed, tuning, noise, start: see `prepare_trace`.
      sweep, settings, cell_m, max_steps, attributes, nodes, links, perception: see `prepare_trace`.
      engine, lanes, workers: see `runner.find_resources`; results are equal but for rounding.
      on_progress: called with the number of finished runs.
      progress: show a bar; by default in notebooks.
    """
    require_engine(engine, lanes)
    plan = prepare_trace(
        world, robot=robot, runs=runs, starts=starts, seed=seed, tuning=tuning, noise=noise, start=start, sweep=sweep,
        settings=settings, cell_m=cell_m, max_steps=max_steps, attributes=attributes, nodes=nodes, links=links,
        perception=perception,
    )  # fmt: skip
    with progress_bar(progress, plan.settings * plan.runs, "runs", on_progress) as moved:
        return execute(plan, engine=engine, lanes=lanes, workers=workers, on_progress=moved)


def map_of(plan: TraceJob, result: Any, i: int) -> BtmMap:
    """Return the map of run i of a `Result` as the robot wrote it."""
    about = {"world": plan.world.name, "robot": plan.robot.name, "seed": plan.seed, "frame": ODOMETRY_FRAME}
    found = btm.to_map(jax.tree.map(lambda a: a[i], result.map), origin_m=plan.world.origin_m, **about)
    for link in found.links:
        if link.attributes.get(BLOCKED):
            found = found.with_attributes(blocked_for(plan.robot), link=link.id)
    at = result.node_at[i][: len(found.nodes)] + np.asarray(plan.world.origin_m)
    for name, value, place in plan.attributes if found.nodes else ():
        node = int(np.nanargmin(np.hypot(*(at - place).T)))
        found = found.with_attributes({name: value}, node=node)
    return found


def trace_table(
    plan: TraceJob, result: Any, setting: np.ndarray, which: np.ndarray, chosen: Mapping[str, Any]
) -> tuple[Any, list[BtmMap]]:
    """Return the table of finished runs, and all their maps.

    `setting` and `which` are `[n]` int, numbers of setting and run; `chosen` are further columns, name -> `[n]`.
    """
    maps = [map_of(plan, result, i) for i in range(len(which))]
    codes, truths = list(map(code, maps)), [set(map(code, own)) for own in plan.truths]
    own_truths = [truths[run % len(truths)] for run in which]
    marks, is_door = result.met[:, : len(plan.truth.marks)], plan.truth.is_door
    node_at = result.node_at + np.asarray(plan.world.origin_m)

    def largest(name):
        values = ([getattr(node, name) for node in own.nodes] for own in maps)
        return [max((value for value in own if value is not None), default=np.nan) for own in values]

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
            **{name: getattr(result, name) for name in ("path_m", "contacts", "refused", "interventions")},
            "junctions": int((~is_door).sum()),
            "junctions_reached": marks[:, ~is_door].sum(axis=1),
            "doors": int(is_door.sum()),
            "doors_reached": marks[:, is_door].sum(axis=1),
            "divergences": [sum(node.type == "divergence" for node in m.nodes) for m in maps],
            "false_divergences": [false_divergences(m, at, plan.truth) for m, at in zip(maps, node_at)],
            "drift_m": result.drift_m,
            "nodes": [len(m.nodes) for m in maps],
            "links": [len(m.links) for m in maps],
            "unsearched": [sum(link.status == "un-searched" for link in m.links) for m in maps],
            "inclination_deg": largest("inclination_deg"),
            "step_m": largest("step_m"),
            "closings": list(map(closings_of, maps)),
            "mistaken": result.mistaken,
            "overflow": result.map.overflow,
            "scan_overflow": result.scan_overflow,
            "code": codes,
            "true": pd.array([one in own if own else None for one, own in zip(codes, own_truths)], dtype="boolean"),
        }
    )
    return table, maps
