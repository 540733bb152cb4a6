"""Many exploration episodes: strategies in worlds, in native code where it can and in JAX, with equal results."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import numpy as np

from jexplore.config import require_engine
from jexplore.engine.program import Line
from jexplore.engine.runner import Costs, Resources, find_resources, level_of, on_cores, require_32_bits, run_all
from jexplore.exploration.metrics import Metric
from jexplore.exploration.native import NativePlace, NativeRun, is_native, native_place, play_on_gpu
from jexplore.exploration.site import ROBOT, Site, drive_for, line_of, prepare_site
from jexplore.exploration.state import Numbers, Result, Setup
from jexplore.exploration.team.episode import decode as decode_team
from jexplore.exploration.team.episode import team_line
from jexplore.exploration.team.starts import place_teams
from jexplore.exploration.team.team import Team
from jexplore.exploration.trail import Final, Record, decode
from jexplore.native.build import Library, warn_once
from jexplore.native.episodes import load_episodes
from jexplore.policies import Strategy
from jexplore.policies.catalogue.joined import join_strategies
from jexplore.rules import Lidar, Robot, Rules
from jexplore.worlds.world import World, ring_of

NO_RUN = -1  # number of a run that none has


class Job(NamedTuple):
    """Episodes of one strategy in one world."""

    world: World
    strategy: Strategy
    starts: np.ndarray  # [N, 3] int, row, col, heading_deg (multiples of 45), clear cells of the world
    seed: int = 0  # with the number of the episode (its place in `starts`, plus `first`) it fixes every draw
    first: int = 0  # number of the first of these episodes
    lidar: Lidar | None = None  # None: that of the run
    rules: Rules | None = None  # None: those of the run
    phase: int = 0  # jobs of a later phase are begun when all of this one have been
    metrics: Mapping[str, Metric] = MappingProxyType({})  # name of a column -> what it holds
    robot: Robot = ROBOT
    team: Team | None = None  # of which `starts` are the first robot's; None: one robot


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
    shared_with: Sequence[tuple[Lidar, Rules]] = (),
) -> Finished:  # fmt: skip
    """Run every episode of every job.

    Jobs are made in the order given, in native code or not; `runner.run_all` says where it is not so, and
    `threads.share_out` cuts them into calls. A study makes its units (`studies/results/units.py`) jobs before.
    An episode's result depends on its world, start, strategy, seed and number, not on others, nor on the engine, or the
    number of lanes or cores. Between kinds of devices that holds for a scanner without noise and
    strategies that compare whole numbers (`closest`, `random`): noise is drawn, and the others choose, in floating
    point, which devices may round differently. Ctrl-C ends the run early, see `runner.run_all`.

    Args:
      jobs: list of `Job`, each with at least one start.
      engine: "auto": whole episodes in native code where it can; for the rest JAX, with native driving on a CPU.
        "jax": no native code; on the devices that JAX puts first.
      lanes, workers, in_lanes: of what runs in JAX, see `runner.find_resources`; native code has `workers` threads.
      on_progress: called with the number of finished episodes, now and then, from the calling thread.
      only: number of the one episode of every job that is run; None: all are.
      keep: one of `trail.RECORDS`, the record of every episode; None: results only.
      on_job: called with the number of a job and its `Outcomes` soon after all its episodes have ended.
      shared_with: scanners and rules of other runs that are to share this one's programs, see `site.prepare_site`.

    Raises:
      InputError: an engine that does not exist, lanes or workers out of range, lanes where there are none to set; a
        strategy of a user's that does not return what it should.
      InputWarning: robots are driven by JAX, because native code cannot be built; once in a process.
      MemoryError: see `runner.run_all`.
    """
    require_32_bits()
    require_engine(engine, lanes)
    resources = on_cores(workers)
    wanted = [_want(job, lidar, rules, only) for job in jobs]
    why_not: list[str] = []
    native = _native_runs(wanted, keep, why_not) if engine == "auto" else {}
    work: dict[int, NativeRun | Line] = {**native}
    rest = {i: own for i, own in enumerate(wanted) if i not in work}
    if rest:  # made before anything runs, as a user's strategy may be refused
        resources = find_resources(engine=engine, lanes=lanes, workers=workers, in_lanes=in_lanes)
        work |= _lines(rest, keep, shared_with, engine, resources, why_not)
    runs = [work[i] for i in range(len(wanted))]

    told = None if on_job is None else (lambda i: on_job(i, _outcomes(wanted[i].job, runs[i])))

    def use_gpu(tell: Callable[[], object]) -> None:
        why_not.extend(play_on_gpu([*native.values()], lambda _: tell()))

    costs = run_all(runs, resources, on_progress, told, first=use_gpu)
    costs.engine, costs.why_not = engine, list(dict.fromkeys(why_not))
    for own, each in zip(wanted, runs):
        levels = sorted(each.levels) if isinstance(each, NativeRun) else [level_of(each, resources)]
        if each.n_finished:
            name = own.job.strategy.name
            costs.levels[name] = list(dict.fromkeys([*costs.levels.get(name, ()), *levels]))
    return Finished([_outcomes(own.job, each) for own, each in zip(wanted, runs)], costs)


class _Wanted(NamedTuple):
    """Episodes of a job that are to be run, with all its settings."""

    job: Job
    lidar: Lidar
    rules: Rules
    which: np.ndarray  # [n] int, numbers of the episodes
    detailed: int  # number of the one of which the map and the way are kept


def _want(job: Job, lidar: Lidar, rules: Rules, only: int | None) -> _Wanted:
    starts = np.array(job.starts, np.int32)
    starts[:, 2] %= 360
    job = job._replace(starts=starts)
    which = np.arange(len(job.starts)) if only is None else np.array([only])
    return _Wanted(job, job.lidar or lidar, job.rules or rules, which, only or (0 if job.first == 0 else NO_RUN))


def _native_runs(wanted: Sequence[_Wanted], keep: str | None, why_not: list[str]) -> dict[int, NativeRun]:
    """Return a `NativeRun` for every job that native code can do, by its number; adds why there is no such code."""
    ready = [
        is_native(own.job.strategy, own.lidar, own.rules) and not own.job.metrics and own.job.team is None
        for own in wanted
    ]
    can = [i for i, is_ready in enumerate(ready) if is_ready]
    if not can or jax.config.values["jax_disable_jit"]:
        return {}
    found = load_episodes()
    if found.loaded is None:
        warn_once(found.why_not)
        why_not.append(found.why_not)
        return {}
    places: dict[Any, NativePlace] = {}
    runs: dict[int, NativeRun] = {}
    for i in can:
        job, lidar, rules, which, detailed = wanted[i]
        key = id(job.world), job.strategy.policy.select, job.strategy.recheck, lidar, rules, job.robot
        if key not in places:
            places[key] = native_place(found.loaded, job.world, job.strategy, lidar, rules, job.robot)
        runs[i] = NativeRun(places[key], job.starts, job.seed, job.first, which, detailed, keep, job.phase)
    return runs


def _lines(
    wanted: Mapping[int, _Wanted],
    keep: str | None,
    shared_with: Sequence[tuple[Lidar, Rules]],
    engine: str,
    resources: Resources,
    why_not: list[str],
) -> dict[int, Line]:
    """Return a `Line` for every job, by its number; adds why JAX has to drive as well."""
    is_driven = engine == "auto" and not resources.in_lanes
    native = drive_for(resources.device.platform) if resources.device and is_driven else Library(None)
    given = [own for own in wanted.values() if own.rules.on_lattice]
    measured = {name: metric.reduce for own in given for name, metric in own.job.metrics.items()}
    at_end, moving = (", ".join(name for name in measured if bool(measured[name]) == moves) for moves in (False, True))
    why_not += filter(None, [
        native.why_not,
        f"JAX makes episodes with metrics: {at_end}" * bool(at_end),
        "JAX drives differential drives, and robots whose pose is not given" * (len(given) < len(wanted)),
        f"JAX drives, for metrics after every motion: {moving}" * bool(moving),
        "JAX drives teams with strategies of view points"
        * any(own.job.team is not None and own.job.strategy.policy.live is not None for own in wanted.values()),
    ])  # fmt: skip
    everyone = [*shared_with, *dict.fromkeys((own.lidar, own.rules) for own in wanted.values())]
    sites: dict[Any, Site] = {}
    fitted: dict[Any, tuple[Setup, Numbers]] = {}
    lines: dict[int, Line] = {}
    strategies = join_strategies([own.job.strategy for own in wanted.values()])
    for (i, (job, lidar, rules, which, detailed)), strategy in zip(wanted.items(), strategies):
        metrics = tuple(job.metrics.values())
        place = id(job.world), lidar, rules, job.robot, metrics
        if place not in sites:
            shared: Any = {"native": native.name, "shared_with": everyone, "metrics": metrics, "robot": job.robot}
            sites[place] = prepare_site(job.world, lidar, rules, **shared)
        key = place, id(job.strategy)
        if key not in fitted:
            fitted[key] = sites[place].with_strategy(strategy)
        if job.team is None:
            line = line_of(sites[place], fitted[key], job.starts, job.seed, which, detailed=detailed, keep=keep)
        else:
            starts = place_teams(job.world, job.starts, job.team, rules)
            line = team_line(sites[place], fitted[key], job.team, lidar, starts, job.seed, which, detailed)
        line.draws, line.phase = line.draws + np.int32(job.first), job.phase
        lines[i] = line
    return lines


def _outcomes(job: Job, work: NativeRun | Line) -> Outcomes:
    if isinstance(work, NativeRun):
        return Outcomes(work.results, work.final, work.records)
    if work.detail is None:  # interrupted before
        return Outcomes(work.results, None, work.records)
    one = jax.tree.map(lambda a: a[work.detailed], work.results)
    detail, ring = jax.tree.map(np.asarray, work.detail), ring_of(job.world.occupied)
    if job.team is not None:
        return Outcomes(work.results, decode_team(detail, job.world.shape, ring))
    return Outcomes(work.results, decode(detail, one, job.world.shape, ring), work.records)
