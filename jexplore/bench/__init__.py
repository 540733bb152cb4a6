"""Measurements: kernels, whole episodes by both engines, memory, compiling.

`prepare_bench` refuses invalid requests, `run_bench` measures, `tables.tables` and `plots.figure` show the results.
"""

import contextlib
import dataclasses
import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
from jax.experimental.compilation_cache import compilation_cache

from jexplore.bench import beliefs, engines, kernels, plans, rates
from jexplore.bench.engines import LIDAR, RULES
from jexplore.bench.timing import one_core, speed_clock, surroundings
from jexplore.config import ENGINES, InputError, require_engine, require_setting
from jexplore.engine.backend import use_compilation_cache
from jexplore.engine.runner import find_resources
from jexplore.policies import Strategy, parse_strategy
from jexplore.studies.checks import ready_starts, ready_strategies, ready_worlds, require_memory
from jexplore.worlds.world import World, with_ring

DEFAULT: dict[str, Any] = {
    "worlds": ("cave", "office", "hospital"),
    "strategies": ("closest+recheck",),
    "batches": (1, 4, 16, 64),
    "sides": (64, 128, 256, 512),
    "episodes": 16,
    "repeat": 5,
}
BATCHES_ACCELERATOR = (1, 4, 16, 64, 256, 1024, 4096)  # lanes
QUICK: dict[str, Any] = {"worlds": ("cave",), "batches": (1, 4), "sides": (64, 128), "episodes": 4, "repeat": 2}
GENERATOR, LEAST_M, CELL_M = "cave", 6.4, 0.1  # of the worlds of a given side


@dataclasses.dataclass(frozen=True)
class Agenda:
    """Planned measurements."""

    worlds: list[World]
    strategies: list[Strategy]
    engines: tuple[str, ...]
    batches: dict[str, tuple[int, ...]]  # by engine
    sized: list[World]  # one for each side
    sides: tuple[int, ...]
    episodes: int
    repeat: int

    @property
    def total(self) -> int:
        """Return the number of measurements that `run_bench` reports one by one."""
        return 1 + len(self.sized) + (len(self.worlds) + len(self.sized)) * len(self.strategies)


def sized_name(side: int) -> tuple[str, float]:
    """Return the name of a world with a number of cells a side, and the edge of its cells in metres."""
    cell_m = max(CELL_M, LEAST_M / side)
    return f"{GENERATOR}:width_m={side * cell_m:g},height_m={side * cell_m:g}", cell_m


def _numbers(name, values) -> tuple[int, ...]:
    values = tuple(require_setting(name, value) for value in values)
    if not values or len(set(values)) < len(values):
        raise InputError(f"{name} must be one or more different integers, got {list(values)}")
    return tuple(sorted(values))


def _worlds_of(names, cell_m):
    """Load worlds that episodes can be run in."""
    worlds = [with_ring(world) for world in ready_worlds(names, cell_m)]
    for world in worlds:
        require_memory(world, LIDAR, RULES)
        ready_starts(world, "random", 1, seed=engines.SEED, rules=RULES)
    return worlds


def prepare_bench(
    *,
    worlds: str | os.PathLike[str] | World | Iterable[str | os.PathLike[str] | World] | None = None,
    strategies: str | Iterable[Any] | None = None,
    engine: Sequence[str] | None = None,
    batch_sizes: Iterable[int] | None = None,
    sides: Iterable[int] | None = None,
    episodes: int | None = None,
    repeat: int | None = None,
    quick: bool = False,
) -> Agenda:
    """Check and load everything, and start JAX with one thread. None means the default.

    Args:
      worlds, strategies: names.
      engine: names of engines; by default all.
      batch_sizes: episodes, or lanes of the engine jax on an accelerator.
      sides: of the maps by which cost is measured, cells.
      episodes: by map size; in lanes the least number.
      repeat: turns of every measurement.
      quick: bool, use small defaults.

    Returns:
      `Agenda`.

    Raises:
      InputError: anything that cannot be measured.
    """
    default = DEFAULT | (QUICK if quick else {})
    if engine is not None and not engine:
        raise InputError(f"engine must be one or more of {', '.join(ENGINES)}, got none")
    for name in engine or ():
        require_engine(name)
    given = None if batch_sizes is None else _numbers("batch_sizes", batch_sizes)
    sides = _numbers("sides", default["sides"] if sides is None else sides)
    numbers = {"episodes": episodes, "repeat": repeat}
    counts = {name: require_setting(name, default[name] if value is None else value) for name, value in numbers.items()}
    strategies = ready_strategies(default["strategies"] if strategies is None else strategies)
    worlds = _worlds_of(default["worlds"] if worlds is None else worlds, CELL_M)
    sized = [world for side in sides for world in _worlds_of(*sized_name(side))]
    find_resources(in_lanes=False, workers=1)  # starts JAX; part is always measured on the CPU
    chosen = tuple(dict.fromkeys(engine or ENGINES))
    batches = {
        name: given or (BATCHES_ACCELERATOR if engines.has_lanes(name) and not quick else default["batches"])
        for name in chosen
    }
    return Agenda(worlds, strategies, chosen, batches, sized, sides, **counts)


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
    """Measure everything.

    Args:
      plan: `Agenda`.
      cache: bool, read compiled programs from disk and keep them there: compile times are then loading times.
      on_progress: called with the number of finished measurements.

    Returns:
      The report: dicts and lists that JSON can hold.
    """
    report: dict[str, Any] = {"environment": surroundings(), "settings": _settings(plan, cache)}
    report |= {"kernels": [], "batches": [], "sides": []}
    compiler, done = engines.Compiler(), 0

    def one_more():
        nonlocal done
        done += 1
        on_progress(done)

    with _compiling(cache):
        _episodes(plan, compiler, report, one_more)
        _along(plan, compiler, report)
        one_more()
        for side, world in zip(plan.sides, plan.sized):
            made = (kernels.measure_kernel(kernel, plan.repeat) for kernel in kernels.whole_map(world))
            report["kernels"] += [{**row, "side": side} for row in made]
            one_more()
        report["rates"] = rates.rates()
    report["programs"] = compiler.programs
    return report


def _settings(plan, cache):
    with one_core() as pinned:
        return {
            "worlds": [world.name for world in plan.worlds],
            "strategies": [strategy.name for strategy in plan.strategies],
            "engines": list(plan.engines),
            "batches": {name: list(sizes) for name, sizes in plan.batches.items()},
            "sides": list(plan.sides),
            "generator": GENERATOR,
            "episodes": plan.episodes,
            "repeat": plan.repeat,
            "cached": cache,
            "pinned": pinned,
            "clock": speed_clock(),
        }


def _episodes(plan: Agenda, compiler, report, one_more):
    """Measure whole episodes by world and batch size, and by map size."""
    for world, strategy in itertools.product(plan.worlds, plan.strategies):
        wanted = [(engine, size) for engine in plan.engines for size in plan.batches[engine]]
        report["batches"] += engines.measure_episodes(compiler, world, strategy, wanted, plan.episodes, plan.repeat)
        one_more()
    for (side, world), strategy in itertools.product(zip(plan.sides, plan.sized), plan.strategies):
        wanted = [
            (engine, plan.batches[engine][-1] if engines.has_lanes(engine) else plan.episodes)
            for engine in plan.engines
        ]
        rows = engines.measure_episodes(compiler, world, strategy, wanted, plan.episodes, plan.repeat)
        report["sides"] += [{**row, "side": side} for row in rows]
        one_more()


def _along(plan, compiler, report):
    """Measure kernels along an episode of `closest` in the first world."""
    seen = beliefs.record(compiler, plan.worlds[0], parse_strategy("closest+recheck"))
    report["kernels"] += [kernels.measure_kernel(kernel, plan.repeat) for kernel in kernels.scans(seen)]
    report["kernels"].append(plans.measure_nearest(seen, plan.repeat))
