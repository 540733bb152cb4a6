"""Many exploration episodes: strategies in worlds, by either engine, with equal results."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np

from jexplore.config import MAX_SEED, InputError, Lidar, Rules, require_whole
from jexplore.engine.runner import Costs, find_resources, run_all
from jexplore.exploration.site import Kernels, kernels_for, line_of, prepare_site
from jexplore.exploration.state import Result
from jexplore.exploration.trail import Final, Record, decode
from jexplore.policies import Strategy
from jexplore.policies.catalogue.joined import joined
from jexplore.policies.closest import is_nearest
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


class Outcomes(NamedTuple):
    """What `run_jobs` returns for one job."""

    result: Result  # numpy, with a leading axis N; outcome RUNNING where the run was interrupted before
    # the map and the way of episode 0, or of the only one; None where that is not here, or was interrupted before
    first: Final | None
    records: dict[int, Record] | None = None  # of every episode that has ended, if they were to be kept


class Finished(NamedTuple):
    """What `run_jobs` returns."""

    outcomes: list[Outcomes]  # in the order of the jobs
    costs: Costs


def run_jobs(
    jobs: Sequence[Job], lidar: Lidar, rules: Rules, *, engine: str | None = None, kernels: Kernels | None = None,
    lanes: int | None = None, workers: int | None = None, on_progress: Callable[[int], object] | None = None,
    only: int | None = None, keep: str | None = None, on_job: Callable[[int, Outcomes], object] | None = None,
    alike: Sequence[tuple[Lidar, Rules]] = (),
) -> Finished:  # fmt: skip
    """Runs every episode of every job.

    An episode's result depends on its world, start, strategy, seed and number, not on what else runs, nor on the
    engine, the kernels, or the number of lanes, cores, devices or processes. Between kinds of devices that holds for a
    scanner without noise and strategies that compare whole numbers (`closest`, `random`): noise is drawn, and the
    others choose, in floating point, which devices may round differently.

    Ctrl-C ends the run early: the report then holds what was finished. Where nothing was, it is raised.

    Args:
      jobs: list of `Job`, each with at least one start. In every process the same.
      lidar: `Lidar`.
      rules: `Rules`.
      engine: one of `runner.ENGINES`; by default the one that is likely to be faster, `runner.faster_engine`.
      kernels: `Kernels`; by default those that suit the engine.
      lanes: lanes on each device in lockstep; by default as many as its memory holds, at most 4096.
      workers: threads of the serial engine on one device; by default the CPU cores that this process may use.
      on_progress: called with the number of episodes finished so far, now and then, from the calling thread.
      only: number of the one episode of every job that is run; None: all are.
      keep: one of `trail.RECORDS`, what is kept of every episode; None: nothing but results.
      on_job: called with the number of a job and its `Outcomes` once all its episodes have ended, soon after, from the
        calling thread.
      alike: scanners and rules of other runs that are to share this one's programs, see `site.prepare_site`.

    Returns:
      `Finished`.

    Raises:
      InputError: a start that is no cell of its world or no multiple of 45 degrees, a seed outside 0 to `MAX_SEED`; an
        engine that does not exist, lanes or workers below 1, lanes for the serial engine; a strategy of a user's that
        does not return what it should; `keep` where several processes share the work.
      InputWarning: robots are driven by JAX, because native code cannot be built; once in a process.
      MemoryError: a device's memory does not suffice, not even for half the lanes.
    """
    runs = sum(len(job.starts) for job in jobs) if only is None else len(jobs)
    resources = find_resources(engine=engine, lanes=lanes, workers=workers, runs=runs)
    if keep is not None and resources.processes > 1:
        raise InputError(f"keep={keep!r} is for one process, and {resources.processes} share the work")
    kernels = kernels or kernels_for(resources.engine, resources.devices[0].platform)
    jobs = [_checked(job) for job in jobs]
    lines = _lines_of(jobs, lidar, rules, resources, kernels, only, keep, alike)
    tell = None if on_job is None else (lambda i: on_job(i, _outcomes(jobs[i], lines[i])))
    costs = run_all(lines, resources, on_progress, tell)
    return Finished([_outcomes(job, line) for job, line in zip(jobs, lines)], costs)


def _programs(jobs, kernels):
    """The strategy of every job as one that shares its program; but for what plans in pieces on its own."""
    alone = [kernels.in_pieces and is_nearest(job.strategy.policy) for job in jobs]
    shared = iter(joined([job.strategy for job, own in zip(jobs, alone) if not own]))
    return [job.strategy if own else next(shared) for job, own in zip(jobs, alone)]


def _lines_of(jobs, lidar, rules, resources, kernels, only, keep, alike):
    """A `Line` for every job. What jobs have in common is made once."""
    settings = [(job.lidar or lidar, job.rules or rules) for job in jobs]
    alike = [*alike, *dict.fromkeys(settings)]
    sites, fitted, lines = {}, {}, []
    for job, strategy, own in zip(jobs, _programs(jobs, kernels), settings):
        place = id(job.world), own
        if place not in sites:
            sites[place] = prepare_site(job.world, *own, kernels, alike=alike)
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
    """The job, its headings from 0 to 315 degrees; refuses starts and a seed that cannot be used."""
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
