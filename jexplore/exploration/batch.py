"""Many exploration episodes: strategies in worlds, in native code where it can and in JAX, with equal results."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np

from jexplore.config import MAX_SEED, InputError, Lidar, Rules, require_engine, require_setting, require_whole
from jexplore.engine.runner import Costs, find_resources, level_of, own_cores, require_32_bits, run_all
from jexplore.exploration.metrics import Metric
from jexplore.exploration.native import NativeRun, chooser_of, is_native, parts_of, play_all, result_of
from jexplore.exploration.site import drive_for, line_of, prepare_site
from jexplore.exploration.state import Result
from jexplore.exploration.trail import Final, Record, decode
from jexplore.native.build import Library, warn_once
from jexplore.native.episodes import RESULT, load
from jexplore.native.episodes import World as NativeWorld
from jexplore.policies import Strategy
from jexplore.policies.catalogue.joined import join_strategies
from jexplore.worlds.world import World, ring_of

NO_RUN = -1  # number of a run that none has


class Job(NamedTuple):
    """Episodes of one strategy in one world."""

    world: World
    strategy: Strategy
    starts: np.ndarray  # [N, 3] int, row, col, heading_deg (multiples of 45)
    seed: int = 0  # with the number of the episode (its place in `starts`, plus `first`) it fixes every draw
    first: int = 0  # number of the first of these episodes
    lidar: Lidar | None = None  # None: that of the run
    rules: Rules | None = None  # None: those of the run
    turn: int = 0  # jobs of a later turn are begun when all of this one have been
    metrics: Mapping[str, Metric] = MappingProxyType({})  # name of a column -> what it holds


class Outcomes(NamedTuple):
    """Results of `run_jobs` for one job."""

    result: Result  # numpy, with a leading axis N; outcome RUNNING where the run was interrupted before
    # the map and the way of episode 0, or of the only one; None where that is not here, or was interrupted before
    first: Final | None
    records: dict[int, Record] | None = None  # of every episode that has ended, if they were to be kept


class Finished(NamedTuple):
    """Result of `run_jobs`."""

    outcomes: list[Outcomes]  # in the order of the jobs
    costs: Costs


def run_jobs(
    jobs: Sequence[Job], lidar: Lidar, rules: Rules, *, engine: str = "auto",
    lanes: int | None = None, workers: int | None = None, in_lanes: bool | None = None,
    on_progress: Callable[[int], object] | None = None, only: int | None = None,
    keep: str | None = None, on_job: Callable[[int, Outcomes], object] | None = None,
    alike: Sequence[tuple[Lidar, Rules]] = (),
) -> Finished:  # fmt: skip
    """Run every episode of every job.

    An episode's result depends on its world, start, strategy, seed and number, not on others, nor on the
    engine, or the number of lanes, cores, devices or processes. Between kinds of devices that holds for a
    scanner without noise and strategies that compare whole numbers (`closest`, `random`): noise is drawn, and the
    others choose, in floating point, which devices may round differently.

    Ctrl-C ends the run early: the report then holds the finished episodes; without any, the interruption is raised.

    Args:
      jobs: list of `Job`, each with at least one start. In every process the same.
      lidar: `Lidar`.
      rules: `Rules`.
      engine: "auto": whole episodes in native code where it can; for the rest JAX, with native driving on a CPU.
        "jax": no native code; on the devices that JAX puts first.
      lanes, workers, in_lanes: of what runs in JAX, see `runner.find_resources`; native code has `workers` threads.
      on_progress: called with the number of finished episodes, now and then, from the calling thread.
      only: number of the one episode of every job that is run; None: all are.
      keep: one of `trail.RECORDS`, the record of every episode; None: results only.
      on_job: called with the number of a job and its `Outcomes` once all its episodes have ended, soon after, from the
        calling thread.
      alike: scanners and rules of other runs that are to share this one's programs, see `site.prepare_site`.

    Returns:
      `Finished`.

    Raises:
      InputError: a start that is no cell of its world or no multiple of 45 degrees, a seed outside 0 to `MAX_SEED`; an
        engine that does not exist, lanes or workers out of range, lanes where there are none to set; a strategy of a
        user's that does not return what it should; `keep` where several processes share the work.
      InputWarning: robots are driven by JAX, because native code cannot be built; once in a process.
      MemoryError: a device's memory does not suffice, not even for half the lanes.
    """
    require_32_bits()
    require_engine(engine, lanes)
    if workers is not None:
        require_setting("workers", workers)
    jobs = [_checked(job) for job in jobs]
    why_not: list[str] = []
    runs = _native_runs(jobs, lidar, rules, only, keep, why_not) if engine == "auto" else {}
    rest = [i for i in range(len(jobs)) if i not in runs]
    how = {"engine": engine, "lanes": lanes, "workers": workers, "in_lanes": in_lanes}
    resources, lines = None, []
    if rest:  # made before anything runs, as a user's strategy may be refused
        resources, lines = _in_jax([jobs[i] for i in rest], lidar, rules, only, keep, alike, how, why_not)
    costs = Costs(why_not=why_not).plus(_play(jobs, runs, workers or own_cores(), on_progress, on_job))
    if lines and not costs.interrupted:
        costs = _run_rest(jobs, rest, lines, resources, costs, on_progress, on_job)
    costs.engine = engine
    found = {i: Outcomes(run.results, run.final, run.records) for i, run in runs.items()}
    found |= {i: _outcomes(jobs[i], line) for i, line in zip(rest, lines) if line.results is not None}
    return Finished([found.get(i) or _nothing(job) for i, job in enumerate(jobs)], costs)


def _run_rest(jobs, rest, lines, resources, costs, on_progress, on_job):
    """Run the jobs without native code; `Costs` of all."""
    done = sum(len(job.starts) for i, job in enumerate(jobs) if i not in rest)
    progress = None if on_progress is None else (lambda n: on_progress(done + n))
    tell = None if on_job is None else (lambda i: on_job(rest[i], _outcomes(jobs[rest[i]], lines[i])))
    try:
        own = run_all(lines, resources, progress, tell)
        own.levels = _levels_of((jobs[i], level_of(line, resources)) for i, line in zip(rest, lines))
        return costs.plus(own)
    except KeyboardInterrupt:
        if not done:
            raise
        return dataclasses.replace(costs, interrupted=True)


def _levels_of(pairs):
    """Name of a strategy -> what ran it, in words, of pairs of a job and a level."""
    found = {}
    for job, level in pairs:
        found.setdefault(job.strategy.name, {})[level] = None
    return {name: list(levels) for name, levels in found.items()}


def _nothing(job):
    """Return the empty outcomes of a job of which no episode was run."""
    blank = result_of(np.zeros((len(job.starts), RESULT), np.int32))
    zeros = np.zeros(len(job.starts), np.int32)
    return Outcomes(blank.replace(metrics=(zeros,) * len(job.metrics)), None, {})


def _native_runs(jobs, lidar, rules, only, keep, why_not):
    """Return a `NativeRun` for every job that native code can do, by its number; adds why there is no such code."""
    can = [i for i, job in enumerate(jobs) if is_native(job.strategy, job.lidar or lidar) and not job.metrics]
    if not can or jax.config.values["jax_disable_jit"] or jax.process_count() > 1:
        return {}
    found = load()
    if found.loaded is None:
        warn_once(found.why_not)
        why_not.append(found.why_not)
        return {}
    places, runs = {}, {}
    for i in can:
        job = jobs[i]
        own = job.lidar or lidar, job.rules or rules
        place = id(job.world), job.strategy.policy.select, job.strategy.recheck, *own
        if place not in places:
            chooser, recheck = chooser_of(job.strategy), job.strategy.recheck
            assert chooser is not None
            parts = parts_of(job.world, chooser, *own, recheck=recheck)
            places[place] = NativeWorld(found.loaded, *parts), parts
        runs[i] = NativeRun(
            place=places[place][0],
            parts=places[place][1],
            world=job.world,
            starts=job.starts,
            seed=job.seed,
            first=job.first,
            which=np.arange(len(job.starts), dtype=np.int32) if only is None else np.array([only], np.int32),
            keeps=only or (0 if job.first == 0 else NO_RUN),
            keep=keep,
            turn=job.turn,
        )
    return runs


def _play(jobs, runs, workers, on_progress, on_job):
    """Run what native code can do; `Costs`. Raises KeyboardInterrupt where nothing was finished."""
    numbers, costs = list(runs), Costs(lanes=workers)
    if not runs:
        return costs

    def tell(i):
        if on_job is not None:
            run = runs[numbers[i]]
            on_job(numbers[i], Outcomes(run.results, run.final, run.records))

    began = time.perf_counter()
    try:
        why_not = play_all(list(runs.values()), workers, on_progress or (lambda _: None), tell)
        costs.why_not += [why_not] if why_not else []
    except KeyboardInterrupt:
        if not any(run.has_some for run in runs.values()):
            raise
        costs.interrupted = True
    costs.run_s = time.perf_counter() - began
    costs.levels = _levels_of((jobs[i], level) for i, run in runs.items() for level in sorted(run.levels))
    return costs


def _in_jax(jobs, lidar, rules, only, keep, alike, how, why_not):
    """Prepare jobs for JAX: `(resources, lines)`; adds why JAX has to drive as well."""
    resources = find_resources(**how)
    if keep is not None and resources.processes > 1:
        raise InputError(f"keep={keep!r} is for one process, and {resources.processes} share the work")
    is_driven = how["engine"] == "auto" and not resources.in_lanes
    native = drive_for(resources.devices[0].platform) if is_driven else Library(None)
    why_not += [native.why_not] if native.why_not else []
    measured = {name: metric for job in jobs for name, metric in job.metrics.items()}
    at_end = [name for name, metric in measured.items() if not metric.reduce]
    moving = [name for name in measured if name not in at_end]
    why_not += [f"JAX makes episodes with metrics: {', '.join(at_end)}"] if at_end else []
    why_not += [f"JAX drives, for metrics after every motion: {', '.join(moving)}"] if moving else []
    return resources, _lines_of(jobs, lidar, rules, resources, native.name, only, keep, alike)


def _lines_of(jobs, lidar, rules, resources, native, only, keep, alike):
    """Make a `Line` for every job. Common parts are made once."""
    settings = [(job.lidar or lidar, job.rules or rules) for job in jobs]
    alike = [*alike, *dict.fromkeys(settings)]
    sites, fitted, lines = {}, {}, []
    for job, strategy, own in zip(jobs, join_strategies([job.strategy for job in jobs]), settings):
        metrics = tuple(job.metrics.values())
        place = id(job.world), own, metrics
        if place not in sites:
            sites[place] = prepare_site(job.world, *own, native=native, alike=alike, metrics=metrics)
        if (place, id(job.strategy)) not in fitted:
            fitted[place, id(job.strategy)] = sites[place].with_strategy(strategy)
        which = resources.own(len(job.starts)) if only is None else [only] * (resources.process == 0)
        keeps = only or (0 if job.first == 0 else NO_RUN)
        numbers = fitted[place, id(job.strategy)]
        line = line_of(sites[place], numbers, job.starts, job.seed, which, keeps=keeps, keep=keep)
        line.draws, line.turn = line.draws + np.int32(job.first), job.turn
        lines.append(line)
    return lines


def _checked(job):
    """Check the job's starts and seed; headings become 0 to 315 degrees."""
    seed, starts = require_whole("seed", job.seed, 0, MAX_SEED), np.asarray(job.starts)
    if starts.ndim != 2 or starts.shape[1] != 3 or not len(starts) or starts.dtype.kind not in "iu":
        form = "[N, 3] integers (row, col, heading_deg), N >= 1"
        raise InputError(f"starts must be {form}, got {starts.dtype} of shape {starts.shape}")
    height, width = job.world.shape
    row, col, heading = starts.T.astype(np.int64)
    for bad, what in (
        ((row < 0) | (row >= height) | (col < 0) | (col >= width), f"lies outside {height} x {width} cells"),
        (heading % 45 != 0, "has a heading that is no multiple of 45 degrees"),
    ):
        if bad.any():
            number = int(bad.argmax())
            raise InputError(f"start {number} of {job.world.name!r}, {starts[number].tolist()}, {what}")
    return job._replace(starts=np.stack([row, col, heading % 360], axis=1).astype(np.int32), seed=seed)


def _outcomes(job, line):
    if line.kept is None:  # interrupted before
        return Outcomes(line.results, None, line.records)
    one = jax.tree.map(lambda a: a[line.keeps], line.results)
    kept, ring = jax.tree.map(np.asarray, line.kept), ring_of(job.world.occupied)
    return Outcomes(line.results, decode(kept, one, job.world.shape, ring), line.records)
