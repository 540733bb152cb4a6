"""Many episodes: on the cores of a CPU one after the other, on an accelerator in lockstep, with equal results.

An episode is serial and full of decisions. A CPU core runs episodes one at a time with true control flow (engine
"serial"): threads share one compiled program, and XLA releases the interpreter lock. An accelerator needs thousands of
episodes at once (engine "lockstep"). Several devices share the work through `shard_map`, each with its own
part and no word between them; several processes (`jax.distributed`) do as well.
"""

import contextlib
import os
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from jexplore.config import InputError
from jexplore.engine import lockstep, serial
from jexplore.exploration.episode import Result, Track
from jexplore.exploration.site import ENGINES, line_of, prepare
from jexplore.policies import Strategy
from jexplore.worlds.world import World


class Final(NamedTuple):
    """An episode's last map and its way there, on the host, without padding."""

    hits: np.ndarray  # [H, W] int32
    misses: np.ndarray  # [H, W] int32
    rows: np.ndarray  # [n + 1] int32, the robot's cell at the start and after each of n steps
    cols: np.ndarray  # [n + 1] int32
    target_rows: np.ndarray  # [n + 1] int32; -1 for none
    target_cols: np.ndarray  # [n + 1] int32; -1 for none
    looked: np.ndarray  # [n + 1] int32, scans made in place there
    known: np.ndarray  # [n + 1] int32, known cells then


class Job(NamedTuple):
    """Episodes of one strategy in one world."""

    world: World
    strategy: Strategy
    starts: np.ndarray  # [N, 3] int, row, col, heading_deg (multiples of 45)
    seed: int = 0  # with the number of the episode (its place in `starts`) it fixes every draw


class Outcomes(NamedTuple):
    """What `run` returns for one job."""

    result: Result  # numpy, with a leading axis N; outcome RUNNING where the run was interrupted before
    first: Final | None  # the map and the way of episode 0; None where the run was interrupted before


class Report(NamedTuple):
    """What `run` returns."""

    outcomes: list[Outcomes]  # in the order of the jobs
    compile_s: float  # seconds spent compiling, or loading compiled programs
    run_s: float  # seconds in which compiled programs ran
    engine: str = "serial"
    devices: int = 1
    lanes: int = 1  # most episodes at a time on one device; in the serial engine one a worker
    useful: float | None = None  # share of the lanes that made a step, over all turns; None in the serial engine
    useful_plans: float | None = None  # share of the places in planning groups that were taken, likewise
    interrupted: bool = False  # whether Ctrl-C ended it early; what was finished then is there


def start_backend(workers):
    """Starts JAX with as many threads as there are to be workers.

    XLA runs programs on a pool of its own, which must have a thread for every worker. It also splits operations of a
    few thousand elements over the threads of that pool, which costs a lone worker more than it gains (measured: a tenth
    of an episode's time on a quiet machine, a third beside other work): so one worker gets one thread. The size of the
    pool is read from the variable NPROC when JAX starts; this must come before JAX is first used, and changes nothing
    later, as in a notebook that has used JAX before: that costs speed, never results.

    Args:
      workers: threads that will call compiled programs at the same time.
    """
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = str(workers)
    try:
        jax.local_devices()
    finally:
        if before is None:
            del os.environ["NPROC"]
        else:
            os.environ["NPROC"] = before


def use_compilation_cache():
    """Keeps compiled programs on disk, so that a later process need not compile them again.

    In `$JAX_COMPILATION_CACHE_DIR` if that is set, else in `$XDG_CACHE_HOME/jexplore` (`~/.cache/jexplore`). A folder
    that cannot be written means no cache.
    """
    if jax.config.values["jax_compilation_cache_dir"] is None:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jexplore"
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def _final(hits, misses, trail, steps, world):
    """The host's view of the last map and trail."""
    height, width = world.shape
    trail = trail[: steps + 1]
    row, col = np.divmod(trail[:, Track.SPOT] // 4, hits.shape[1])
    target = trail[:, Track.TARGET]
    target_row, target_col = np.where(target < 0, -1, np.divmod(target, hits.shape[1]))
    return Final(
        hits=hits[:height, :width],
        misses=misses[:height, :width],
        rows=row,
        cols=col,
        target_rows=target_row,
        target_cols=target_col,
        looked=trail[:, Track.SPOT] % 4,
        known=trail[:, Track.KNOWN],
    )


def _across_processes(lines):
    """What all processes found, in every process."""
    from jax.experimental import multihost_utils

    for line in lines:
        parts = multihost_utils.process_allgather(line.results)  # every episode ran in one process, zeros elsewhere
        line.results = jax.tree.map(lambda a: np.asarray(a).sum(axis=0, dtype=a.dtype), parts)
        shape, trail = line.site.truth.occupied.shape, (line.setup.capacity + 1, len(Track))
        first = line.first or (*np.zeros((2, *shape), np.int32), np.zeros(trail, np.int32))
        line.first = multihost_utils.broadcast_one_to_all(first)  # from the first process, which runs episode 0


def run(jobs, lidar, rules, *, engine=None, kernels=None, lanes=None, workers=None, on_progress=None):
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
      engine: one of `ENGINES`; by default serial on a CPU, else lockstep.
      kernels: `Kernels`; by default those that suit the engine.
      lanes: lanes on each device in lockstep; by default as many as its memory holds, at most 4096.
      workers: threads of the serial engine on one device; by default the CPU cores that this process may use.
      on_progress: called with the number of episodes finished so far, now and then, from the calling thread.

    Returns:
      `Report`.

    Raises:
      InputError: an engine that does not exist, lanes or workers below 1, lanes for the serial engine.
      MemoryError: a device's memory does not suffice, not even for half the lanes.
    """
    if engine is not None and engine not in ENGINES:
        raise InputError(f"engine must be one of {', '.join(ENGINES)}, got {engine!r}")
    for name, value in (("lanes", lanes), ("workers", workers)):
        if value is not None and value < 1:
            raise InputError(f"{name} must be at least 1, got {value}")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    start_backend(workers or cores)  # before anything else asks JAX for its devices
    devices = jax.local_devices()
    engine = engine or ("serial" if devices[0].platform == "cpu" else "lockstep")
    if lanes is not None and engine == "serial":
        raise InputError(f"lanes are for the engine lockstep, got {lanes} for serial")
    here, processes = jax.process_index(), jax.process_count()
    sites, lines = {}, []
    for job in jobs:
        site = sites.setdefault(id(job.world), None) or prepare(job.world, lidar, rules)
        sites[id(job.world)] = site
        which = np.arange(here, len(job.starts), processes)
        lines.append(line_of(site, job.strategy, job.starts, job.seed, kernels or ENGINES[engine], which))
    tally = lockstep.Tally()
    report_progress = on_progress or (lambda done: None)
    interrupted = False
    try:
        if engine == "serial":
            tally.lanes = workers = (workers or cores) if len(devices) == 1 else 1
            serial.run(lines, devices, workers, tally, report_progress)
        else:
            lockstep.run(lines, devices, lanes, tally, report_progress)
    except KeyboardInterrupt:
        if processes > 1 or not any(line.results.outcome.any() for line in lines):
            raise
        interrupted = True
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" in str(error):
            raise MemoryError(str(error)) from error
        raise
    if processes > 1:
        _across_processes(lines)
    return Report(
        outcomes=[_outcomes(job, line) for job, line in zip(jobs, lines)],
        compile_s=tally.compile_s,
        run_s=tally.run_s,
        engine=engine,
        devices=len(devices) * processes,
        lanes=tally.lanes,
        useful=tally.useful,
        useful_plans=tally.useful_plans,
        interrupted=interrupted,
    )


def _outcomes(job, line):
    result = line.results
    if line.first is None:  # interrupted before
        return Outcomes(result, None)
    hits, misses, trail = (np.asarray(a) for a in line.first)
    return Outcomes(result, _final(hits, misses, trail, int(result.straight[0] + result.diagonal[0]), job.world))
