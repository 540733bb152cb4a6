"""Whole episodes by both engines: what each runs is made once and run many times, on the CPU, or in lanes on a GPU."""

import functools
import math
import os
import statistics
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jexplore.bench.timing import compiled, interleaved, mean_and_se, speed_clock, spread
from jexplore.config import Lidar, Rules
from jexplore.engine import one_by_one
from jexplore.engine.lanes import Group
from jexplore.engine.runner import Costs, find_resources
from jexplore.exploration.native import ON_CPU, chooser_of, is_native, native_world, result_of
from jexplore.exploration.results import path_m
from jexplore.exploration.site import drive_for, line_of, prepare_site, tasks_of
from jexplore.exploration.state import Outcome, Result
from jexplore.native.episodes import load
from jexplore.policies import Strategy
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World, ring_of

LIDAR, RULES = Lidar(), Rules()
SEED = 0
MEMORY_SHARE = 0.8  # of the free memory that lanes may take
REFILLS = 2  # episodes a lane at least, so that lanes are filled again


class Run(NamedTuple):
    """Results of a program."""

    result: object  # `Result`, numpy, `[N]`
    last: object = None  # what `trail.kept` has of the last episode; of programs one by one only
    useful: float | None = None  # as in `runner.Costs`


class Compiled(NamedTuple):
    """A compiled program, or native code, with its arguments."""

    run: Callable[[np.ndarray], Run]  # `[N, 3]` starts, heading in degrees, to `Run`
    about: dict[str, Any]  # for the report
    lanes: int | None = None  # None where episodes come one after the other
    episodes: int | None = None  # N that it is for; None for any


def size_of(tree: Any) -> int:
    """Return the bytes of a pytree of arrays, or of their shapes."""
    return sum(math.prod(leaf.shape) * np.dtype(leaf.dtype).itemsize for leaf in jax.tree.leaves(tree))


def free_bytes() -> int | None:
    """Return free memory of the first device, else of the machine; None if neither is known."""
    stats = jax.local_devices()[0].memory_stats()
    if stats:
        return stats["bytes_limit"] - stats["bytes_in_use"]
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def _memory(program):
    """Return bytes by the compiler's own account; None without one."""
    found = program.memory_analysis()
    names = ("argument", "output", "temp", "alias")
    return None if found is None else {name: int(getattr(found, f"{name}_size_in_bytes")) for name in names}


class Compiler:
    """Compiles programs one after the other; cases that differ in numbers only share one."""

    made: dict[Any, Any]
    programs: list[dict[str, Any]]

    def __init__(self) -> None:
        self.made = {}
        self.programs = []  # what every compiled program took

    def _program(self, key, about, lowering, lane_bytes, device, options):
        """Return the compiled program of a key and its costs; `lane_bytes` computes a lane's share."""
        if key not in self.made:
            program, took = compiled(lowering, options, device.platform)
            memory = _memory(program)
            lane = None if memory is None else int(lane_bytes(memory))
            about = {**about, **took, "memory": memory, "lane_bytes": lane}
            self.programs.append(about)
            self.made[key] = program, about
        return self.made[key]

    def one_by_one(self, world: World, strategy: Strategy, native: str | None = None) -> Compiled:
        """Compile a world and a strategy for the CPU; `native` as for `prepare_site`."""
        site, line = _line(world, strategy, native, np.zeros((1, 3), np.int32))
        n, scenes = one_by_one.CHUNK, jax.tree.map(lambda a: a[None], line.scene)
        device = find_resources(in_lanes=False, workers=1).devices[0]
        shared = jax.device_put((scenes, line.shared, line.numbers), device)
        blank = np.zeros(n, np.int32), np.zeros((n, 3), np.int32), np.int32(0), np.uint32(SEED)
        function = functools.partial(one_by_one.chunk, line.program)

        def one_episode(memory):
            """Return the size of an episode's buffers, without the results of the rest of a chunk."""
            results = jax.eval_shape(function, *blank, *shared)[0]
            return memory["temp"] + memory["output"] - (n - 1) * size_of(results) // n

        with jax.default_device(device):  # may be a CPU although an accelerator exists
            call, about = self._program(
                str(("one by one", line.program, jax.tree.map(np.shape, shared))),
                _about("native driving" if native else "JAX", world, strategy, site),
                lambda: jax.jit(function).lower(*blank, *shared),
                one_episode,
                device,
                line.program.cpu_options,
            )

        def run(starts):
            parts, last, starts = [], None, tasks_of(starts, site.ring)
            for first in range(0, len(starts), n):
                some = starts[first : first + n]
                which, padded = np.zeros(n, np.int32), np.zeros((n, 3), np.int32)
                which[: len(some)], padded[: len(some)] = np.arange(first, first + len(some)), some
                called = call(which, padded, np.int32(len(some)), np.uint32(SEED), *shared)
                (found, _), last = jax.block_until_ready(called)
                parts.append(jax.tree.map(np.asarray, found))
            return Run(jax.tree.map(lambda *a: np.concatenate(a)[: len(starts)], *parts), last)

        return Compiled(run, about)

    def in_lanes(self, world: World, strategy: Strategy, n_lanes: int, episodes: int) -> Compiled:
        """Compile a number of episodes in a number of lanes, by default as many as the memory holds."""
        device = jax.local_devices()[0]
        site, line = _line(world, strategy, None, np.zeros((episodes, 3), np.int32))
        group = Group([line], [device])
        estimate, free = group.lane_bytes(), free_bytes()
        if free is not None:
            n_lanes = max(1, min(n_lanes, int(MEMORY_SHARE * free / estimate)))
        about = _about("JAX in lanes", world, strategy, site) | {"lanes": n_lanes, "lane_bytes_estimate": estimate}

        def compile_one(function, name, arguments, devices, donate=(), cpu_options=()):
            def lowering():
                return jax.jit(function, donate_argnums=donate).lower(*arguments)

            if name[0] != "go_on":
                program, _ = self._untold(str((name, n_lanes)), lowering)
            else:
                of_lane = functools.partial(_lane_of, n_lanes)
                program, own = self._program(str((name, n_lanes)), about, lowering, of_lane, device, cpu_options)
                about.update(own)
            return program, program.out_info

        programs = group.compile(n_lanes, compile_one)

        def run(starts):
            line.tasks, costs = tasks_of(starts, site.ring), Costs()
            line.finished[:] = False
            group.run(n_lanes, costs, lambda done: None, programs)
            return Run(jax.tree.map(np.array, line.results), useful=costs.useful)

        return Compiled(run, about, n_lanes, episodes)

    def _untold(self, key, lowering):
        """Return a stand-in for a program too small for a report."""
        if key not in self.made:
            self.made[key] = compiled(lowering)
        return self.made[key]


def _line(world, strategy, native, starts):
    """Return a world's `Site` and the `Line` of a strategy's episodes in it."""
    site = prepare_site(world, LIDAR, RULES, native=native)
    return site, line_of(site, site.with_strategy(strategy), starts, SEED, np.arange(len(starts)))


def _lane_of(n_lanes, memory):
    return (memory["temp"] + memory["output"]) / n_lanes


def _about(level, world, strategy, site):
    return {
        "level": level,
        "world": world.name,
        "strategy": strategy.name,
        "padded_shape": list(site.truth.occupied.shape),
        "lanes": None,
        "lane_bytes_estimate": None,
    }


def has_lanes(engine: str) -> bool:
    """Tell whether an engine runs episodes in lanes here."""
    return engine == "jax" and jax.default_backend() != "cpu"


def _native(loaded, world, strategy):
    """Return the `Compiled` of native code, on a core of the CPU."""
    chooser = chooser_of(strategy)
    assert chooser is not None
    place = native_world(loaded, world, chooser, LIDAR, RULES, recheck=strategy.recheck)
    ring, stop = ring_of(world.occupied), np.zeros(1, np.int32)

    def run(starts):
        tasks = place.tasks(tasks_of(starts, ring), SEED, np.arange(len(starts), dtype=np.int32))
        return Run(result_of(place.play(tasks, stop).results))

    return Compiled(run, {"level": ON_CPU, "lane_bytes": None, "lane_bytes_estimate": None})


def program_of(
    compiler: Compiler, engine: str, world: World, strategy: Strategy, batch: int, episodes: int
) -> Compiled:
    """Compile what an engine runs, for a number of episodes or lanes."""
    if has_lanes(engine):
        return compiler.in_lanes(world, strategy, batch, max(episodes, REFILLS * batch))
    if engine == "jax":
        made = compiler.one_by_one(world, strategy)
    elif is_native(strategy, LIDAR) and (found := load()).loaded is not None:
        made = _native(found.loaded, world, strategy)
    else:
        made = compiler.one_by_one(world, strategy, drive_for("cpu").name)
    return made._replace(episodes=batch)


def same(results: Sequence[Result]) -> bool:
    """Return whether `Result`s are equal to the last bit, up to the length of the shortest."""
    n = min(len(result.outcome) for result in results)
    first, *others = ([np.asarray(a)[:n] for a in jax.tree.leaves(result)] for result in results)
    return all(all(np.array_equal(a, b) for a, b in zip(first, other)) for other in others)


def quality(result: Result, cell_m: float) -> dict[str, Any]:
    """Return the measured quality of episodes, a dict."""
    return {
        "path_m": mean_and_se(path_m(result.straight, result.diagonal, cell_m)),
        "explored_fraction": float(np.mean(result.explored / np.maximum(result.explorable, 1))),
        "complete": float(np.mean(result.outcome == Outcome.COMPLETE)),
        "plans": float(np.mean(result.plans)),
        "scans": float(np.mean(result.scans)),
        "steps": float(np.mean(result.straight + result.diagonal)),
    }


def measure_episodes(
    compiler: Compiler, world: World, strategy: Strategy, wanted: Sequence[tuple[str, int]], episodes: int, repeat: int
) -> list[dict[str, Any]]:
    """Time whole episodes of a world and a strategy: a list of dicts, one for each of `wanted`.

    Args:
      compiler: `Compiler`.
      world, strategy: `World`, `Strategy`.
      wanted: list of `(engine, batch)`.
      episodes: least number of episodes in lanes.
      repeat: turns.
    """
    programs: list[Any] = [program_of(compiler, *kind, batch, episodes) for kind, batch in
                (((engine, world, strategy), batch) for engine, batch in wanted)]  # fmt: skip
    starts = draw_starts(world, SEED, max(program.episodes for program in programs), RULES.clearance_m)
    tasks = {i: functools.partial(p.run, starts[: p.episodes]) for i, p in enumerate(programs)}
    for task in tasks.values():  # the first call loads what later ones find in place
        task()
    runs = interleaved(tasks, repeat)
    results = [turn.result for turns in runs.values() for turn, _ in turns]
    equal = same(results)  # across engines and batches
    rows = []
    for (engine, batch), (i, program) in zip(wanted, enumerate(programs)):
        n, found = program.episodes, quality(runs[i][0][0].result, world.cell_m)
        wall = [took.wall / n for _, took in runs[i]]
        cpu = [took.cpu / n for _, took in runs[i]]
        seconds = statistics.median({"wall": wall, "cpu": cpu}[speed_clock()])
        rows.append({
            "world": world.name, "shape": list(world.shape), "strategy": strategy.name,
            "engine": engine, "level": program.about["level"], "batch": batch, "lanes": program.lanes, "episodes": n,
            "wall_s": spread(wall), "cpu_s": spread(cpu), "episodes_per_s": 1 / seconds,
            **{f"{name}_per_s": found[name] / seconds for name in ("steps", "scans", "plans")},
            "useful": runs[i][0][0].useful,
            "lane_bytes": program.about["lane_bytes"], "lane_bytes_estimate": program.about["lane_bytes_estimate"],
            "quality": found, "equal": equal,
        })  # fmt: skip
    return rows
