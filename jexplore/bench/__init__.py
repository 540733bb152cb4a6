"""Measurements of whole episodes, by engine and batch size.

`prepare_bench` refuses invalid requests, `run_bench` measures, `tables.bench_tables` shows it.
"""

import contextlib
import functools
import os
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

from jexplore.bench.timing import interleaved, mean_and_se, median_and_min, one_core, speed_clock, surroundings
from jexplore.config import ENGINES, InputError, require_engine, require_setting
from jexplore.engine.backend import use_compilation_cache
from jexplore.engine.runner import find_resources
from jexplore.exploration.batch import Finished, Job, run_jobs
from jexplore.exploration.results import path_m
from jexplore.exploration.state import Outcome, Result
from jexplore.studies.checks import LIDAR, RULES, prepare_jobs
from jexplore.worlds.world import World

SEED = 0
WORLDS, STRATEGIES, BATCHES, REPEAT = ("cave", "office", "hospital"), ("closest+recheck",), (1, 4, 16, 64), 5
QUICK_WORLDS, QUICK_BATCHES, QUICK_REPEAT = ("cave",), (1, 4), 2
BATCHES_ACCELERATOR = (1, 4, 16, 64, 256, 1024, 4096)  # lanes
CELL_M = 0.1
REFILLS = 2  # episodes a lane at least, so that lanes are filled again


class Agenda(NamedTuple):
    """Planned measurements."""

    jobs: list[Job]  # each with as many starts as the largest batch takes
    batches: Mapping[str, tuple[int, ...]]  # by engine
    repeat: int


def has_lanes(engine: str) -> bool:
    """Return whether an engine runs episodes in lanes here."""
    return engine == "jax" and jax.default_backend() != "cpu"


def prepare_bench(
    *, worlds: str | os.PathLike[str] | World | Iterable[str | os.PathLike[str] | World] | None = None,
    strategies: str | Iterable[Any] | None = None, engine: Sequence[str] | None = None,
    batch_sizes: Iterable[int] | None = None, repeat: int | None = None, quick: bool = False,
) -> Agenda:  # fmt: skip
    """Check and load everything, and start JAX with one thread: the options of `jexplore bench`. None: the default."""
    if engine is not None and not engine:
        raise InputError(f"engine must be one or more of {', '.join(ENGINES)}, got none")
    for name in engine or ():
        require_engine(name)
    given = None if batch_sizes is None else [require_setting("batch_sizes", size) for size in batch_sizes]
    if given is not None and (not given or len(set(given)) < len(given)):
        raise InputError(f"batch_sizes must be one or more different integers, got {given}")
    turns: int = require_setting("repeat", (QUICK_REPEAT if quick else REPEAT) if repeat is None else repeat)
    find_resources(in_lanes=False, workers=1)  # starts JAX; part is always measured on the CPU
    own = tuple(sorted(given)) if given else QUICK_BATCHES if quick else None
    batches = {name: own or (BATCHES_ACCELERATOR if has_lanes(name) else BATCHES) for name in engine or ENGINES}
    names = (QUICK_WORLDS if quick else WORLDS) if worlds is None else worlds
    most = max(episodes_of(name, size) for name, sizes in batches.items() for size in sizes)
    how: Any = {"episodes": most, "seed": SEED, "cell_m": CELL_M, "start": "random", "lidar": LIDAR, "rules": RULES}
    return Agenda(prepare_jobs(names, STRATEGIES if strategies is None else strategies, **how), batches, turns)


def episodes_of(engine: str, batch: int) -> int:
    """Return the number of episodes that are run in a batch."""
    return REFILLS * batch if has_lanes(engine) else batch


@contextlib.contextmanager
def _compiling(cache):
    """Compile without reading or keeping programs on disk, unless that is allowed."""
    if cache:
        use_compilation_cache()
        yield
        return
    before = jax.config.values["jax_enable_compilation_cache"]
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    try:
        yield
    finally:
        jax.config.update("jax_enable_compilation_cache", before)
        compilation_cache.reset_cache()


def run_bench(
    plan: Agenda, *, cache: bool = False, on_progress: Callable[[int], Any] = lambda done: None
) -> dict[str, Any]:
    """Measure everything: the report, dicts and lists that JSON can hold.

    `cache`: read compiled programs from disk and keep them there: compile times are then loading times.
    """
    with one_core() as pinned:
        settings = {
            "worlds": list(dict.fromkeys(job.world.name for job in plan.jobs)),
            "strategies": list(dict.fromkeys(job.strategy.name for job in plan.jobs)),
            "batches": plan.batches,
            "repeat": plan.repeat,
            "cached": cache,
            "pinned": pinned,
            "clock": speed_clock(),
        }
    report = {"environment": surroundings(), "settings": settings, "batches": []}
    wanted = [(engine, size) for engine, sizes in plan.batches.items() for size in sizes]
    with _compiling(cache):
        for done, job in enumerate(plan.jobs, start=1):
            report["batches"] += measure_episodes(job, wanted, plan.repeat)
            on_progress(done)
    return report


def measure_episodes(job: Job, wanted: Sequence[tuple[str, int]], repeat: int) -> list[dict[str, Any]]:
    """Time whole episodes, in turns: a dict for each of `wanted`, pairs of engine and batch."""
    counts = [episodes_of(engine, batch) for engine, batch in wanted]
    tasks = {
        i: functools.partial(
            run_once, job._replace(starts=job.starts[:n]), engine, batch if has_lanes(engine) else None
        )
        for i, ((engine, batch), n) in enumerate(zip(wanted, counts))
    }
    firsts = {i: task() for i, task in tasks.items()}  # compiles
    runs = interleaved(tasks, repeat)
    equal = is_equal([found.outcomes[0].result for turns in runs.values() for found, _ in turns])
    rows = []
    for i, ((engine, batch), n) in enumerate(zip(wanted, counts)):
        quality, costs = quality_of(firsts[i].outcomes[0].result, job.world.cell_m), firsts[i].costs
        took = {clock: [getattr(took, clock) / n for _, took in runs[i]] for clock in ("wall", "cpu")}
        seconds = statistics.median(took[speed_clock()])
        rows.append({
            "world": job.world.name, "shape": list(job.world.shape), "strategy": job.strategy.name, "engine": engine,
            "level": ", ".join(costs.levels[job.strategy.name]), "batch": batch, "episodes": n,
            "compile_s": costs.compile_s, "wall_s": median_and_min(took["wall"]), "cpu_s": median_and_min(took["cpu"]),
            "episodes_per_s": 1 / seconds, **{f"{k}_per_s": quality[k] / seconds for k in ("steps", "scans", "plans")},
            "quality": quality, "equal": equal,
        })  # fmt: skip
    return rows


def run_once(job: Job, engine: str, lanes: int | None = None) -> Finished:
    """Run episodes on one core, or in lanes."""
    found = run_jobs([job], LIDAR, RULES, engine=engine, lanes=lanes, workers=1)
    if found.costs.interrupted:
        raise KeyboardInterrupt
    return found


def is_equal(results: Sequence[Result]) -> bool:
    """Return whether `Result`s are equal to the last bit, up to the length of the shortest."""
    n = min(len(result.outcome) for result in results)
    first, *others = ([np.asarray(a)[:n] for a in jax.tree.leaves(result)] for result in results)
    return all(all(np.array_equal(a, b) for a, b in zip(first, other)) for other in others)


def quality_of(result: Result, cell_m: float) -> dict[str, Any]:
    """Return means over episodes, and the standard error of the path."""
    return {
        "path_m": mean_and_se(path_m(result.straight, result.diagonal, cell_m)),
        "explored_fraction": float(np.mean(result.explored / np.maximum(result.explorable, 1))),
        "complete": float(np.mean(result.outcome == Outcome.COMPLETE)),
        "plans": float(np.mean(result.plans)),
        "scans": float(np.mean(result.scans)),
        "steps": float(np.mean(result.straight + result.diagonal)),
    }
