"""Whole episodes: how long they take, on one core and on all, beside what they found; and beside a yardstick.

    python benchmarks/episodes.py --out episodes.json

See README.md in this folder for the columns.
"""

import argparse
import importlib.util
import math
import statistics
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from timing import (
    at_least_one,
    busiest,
    check_out,
    control,
    finish,
    guarded,
    interleaved,
    markdown,
    mean_and_se,
    one_core,
    ratio,
    spread,
    surroundings,
    timed,
)

from jexplore import batch
from jexplore.config import InputError, Lidar, Rules
from jexplore.episode import Outcome
from jexplore.measure import path_m
from jexplore.policies import parse_strategy
from jexplore.world import World, draw_starts
from jexplore.worlds import load_world

SHARED = Path(__file__).resolve().parents[2] / "shared"
YARDSTICK = SHARED / "bench" / "numba_ref.py"
YARDSTICK_MAPS = ("cave_filled.png@16x16", "hospital_section.png@49.3x20.1")
YARDSTICK_STRATEGIES = ("closest", "closest+recheck")  # what it can do
MEMORY_SIDE = 256  # cells
MEMORY_TARGET_MIB = 4.0
MIB = 2**20


class Program(NamedTuple):
    """A compiled program and what compiling took."""

    call: Any
    compile_s: float
    compile_cpu_s: float
    episode_bytes: int  # of one episode under way


class Case(NamedTuple):
    """One strategy in one world, ready to run."""

    world: World
    strategy: Any  # `policies.Strategy`
    program: Program
    fresh: bool  # whether the program was compiled for this case, not for one before it
    arguments: tuple


class Compiler:
    """Compiles cases one after the other; those that differ in numbers only share a program."""

    def __init__(self):
        self.programs = {}

    def case(self, world, strategy):
        """The `Case` of a `World` and a `Strategy`."""
        site = batch.prepare(world, Lidar(), Rules())
        setup, arguments = batch._setup(site, strategy), (site.truth, site.beams, batch._numbers(site, strategy))
        kind = str((setup, site.truth.occupied.shape, jax.tree.map(np.shape, arguments)))
        fresh = kind not in self.programs
        if fresh:
            self.programs[kind] = self._compile(setup, arguments)
        return Case(world, strategy, self.programs[kind], fresh, arguments)

    def _compile(self, setup, arguments):
        starts = np.zeros((batch.CHUNK, 3), np.int32)
        blank = np.uint32(0), np.zeros(batch.CHUNK, np.int32), starts, np.int32(0)
        call, took = timed(lambda: batch.run_chunk.lower(setup, *blank, *arguments).compile())
        # A call holds room for the results of a whole chunk of starts; an episode needs room for one.
        results = jax.tree.leaves(jax.eval_shape(lambda *a: batch.run_chunk(setup, *a), *blank, *arguments)[0])
        a_result = sum(math.prod(leaf.shape) * leaf.dtype.itemsize for leaf in results) // batch.CHUNK
        memory = call.memory_analysis()
        chunk = (batch.CHUNK - 1) * a_result
        return Program(call, took.wall, took.cpu, memory.temp_size_in_bytes + memory.output_size_in_bytes - chunk)


def run_some(case, starts, numbers, seed):
    """Runs up to `batch.CHUNK` episodes in one call: `Result` with a leading axis, numpy."""
    n = len(starts)
    padded = np.zeros((batch.CHUNK, 3), np.int32)
    padded[:n] = starts
    padded[:n, 2] //= 45
    which = np.zeros(batch.CHUNK, np.int32)
    which[:n] = numbers
    results, _ = jax.block_until_ready(case.program.call(np.uint32(seed), which, padded, np.int32(n), *case.arguments))
    return jax.tree.map(lambda a: np.asarray(a)[:n], results)


def run_all(case, starts, workers, pool, seed=0):
    """Runs an episode from every start, in the threads of a pool: `Result` with a leading axis, numpy.

    One thread takes them in calls of a whole chunk; several take a few at a time from one queue, as `batch.run` does.
    """
    n = len(starts)
    size = batch.CHUNK if workers == 1 else max(1, min(batch.CHUNK, n // (4 * workers)))
    parts = [slice(at, at + size) for at in range(0, n, size)]
    pieces = list(pool.map(lambda part: run_some(case, starts[part], np.arange(n)[part], seed), parts))
    return jax.tree.map(lambda *a: np.concatenate(a), *pieces)


def same(results):
    """Whether `Result`s are equal to the last bit."""
    first = jax.tree.leaves(results[0])
    return all(all(np.array_equal(a, b) for a, b in zip(first, jax.tree.leaves(other))) for other in results[1:])


def quality(result, cell_m):
    """What the episodes found: a dict."""
    return {
        "path_m": mean_and_se(path_m(result.straight, result.diagonal, cell_m)),
        "explored_fraction": float(np.mean(result.explored / np.maximum(result.explorable, 1))),
        "complete": float(np.mean(result.outcome == Outcome.COMPLETE)),
        "plans": float(np.mean(result.plans)),
        "scans": float(np.mean(result.scans)),
        "steps": float(np.mean(result.straight + result.diagonal)),
    }


def measure(case, episodes, repeat, workers):
    """Times one case: a dict for the report."""
    starts = draw_starts(case.world, 0, episodes, Rules().clearance_m)
    run_some(case, starts[:1], [0], 0)  # the first call loads what later ones find in place
    pools = {n: ThreadPoolExecutor(n) for n in workers}
    tasks = {n: lambda n=n: busiest(lambda: run_all(case, starts, n, pools[n])) for n in workers}
    tasks |= {("control", n): lambda n=n: control(n) for n in workers}
    runs = interleaved(tasks, repeat)
    for pool in pools.values():
        pool.shutdown()
    free = {n: [took.wall for _, took in runs.pop(("control", n))] for n in workers}
    answers = [answer for turns in runs.values() for (answer, _), _ in turns]
    longest = {n: [thread_s for (_, thread_s), _ in turns] for n, turns in runs.items()}
    found = quality(answers[0], case.world.cell_m)
    wall = {n: [took.wall / episodes for _, took in turns] for n, turns in runs.items()}
    cpu = {n: [took.cpu / episodes for _, took in turns] for n, turns in runs.items()}
    by_workers = {}
    for n in workers:
        episode_s = statistics.median(wall[n])
        by_workers[str(n)] = {
            "s_per_episode": spread(wall[n]),
            "cpu_s_per_episode": spread(cpu[n]),
            "episodes_per_s": 1 / episode_s,
            "steps_per_s": found["steps"] / episode_s,
            "scans_per_s": found["scans"] / episode_s,
            "plans_per_s": found["plans"] / episode_s,
        }
        if n != workers[0]:
            by_workers[str(n)]["speedup"] = ratio(wall[workers[0]], wall[n])
            by_workers[str(n)]["speedup_of_control"] = ratio(free[workers[0]], free[n])
            # What a machine with nothing else to do would give at best: the busiest thread's work against one's whole.
            if None not in longest[n]:
                by_workers[str(n)]["speedup_by_busiest_thread"] = ratio(longest[workers[0]], longest[n])
    return {
        "world": case.world.name,
        "strategy": case.strategy.name,
        "shape": list(case.world.shape),
        "compile_s": case.program.compile_s if case.fresh else None,
        "compile_cpu_s": case.program.compile_cpu_s if case.fresh else None,
        "episode_mib": case.program.episode_bytes / MIB,
        "workers": by_workers,
        "quality": found,
        "quality_equal": same(answers),
    }


def memory_case(compiler, strategy):
    """Memory of one episode on an empty square map: a dict for the report."""
    occupied = np.ones((MEMORY_SIDE, MEMORY_SIDE), bool)
    occupied[1:-1, 1:-1] = False
    case = compiler.case(World(occupied=occupied, name="empty"), strategy)
    mib = case.program.episode_bytes / MIB
    return {
        "shape": list(occupied.shape),
        "episode_mib": mib,
        "target_mib": MEMORY_TARGET_MIB,
        "met": mib < MEMORY_TARGET_MIB,
    }


def load_yardstick(path):
    """The yardstick's module."""
    try:
        spec = importlib.util.spec_from_file_location("yardstick", path)
        if spec is None or spec.loader is None:
            raise InputError(f"--yardstick {path}: must be a Python file")
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
    except (OSError, SyntaxError) as error:
        raise InputError(f"--yardstick {path}: must be a Python file that can be read: {error}") from error
    if not hasattr(module, "Explorer") or not hasattr(module, "pick_starts"):
        raise InputError(f"--yardstick {path}: must define Explorer and pick_starts")
    return module


def beside(case, yardstick, episodes, repeat):
    """Times one case on one core in turns with the yardstick, from the same starts: a dict for the report.

    The yardstick's starts have any heading; ours are rounded to 45 degrees. Its world is ours, cell by cell.
    """
    world, rules = case.world, Rules()
    rows, cols, headings, _ = yardstick.pick_starts(world.occupied, episodes, 0, 0.4 / world.cell_m)
    starts = np.stack([rows, cols, np.rint(np.degrees(headings) / 45).astype(int) % 8 * 45], axis=1).astype(np.int32)
    explorer = yardstick.Explorer(
        world.occupied, world.cell_m, Lidar().range_m, clear_m=rules.clearance_m, near_m=rules.near_m
    )

    def theirs():
        return [explorer.run(*start, recheck=case.strategy.recheck) for start in zip(rows, cols, headings)]

    with ThreadPoolExecutor(1) as pool, one_core() as pinned:

        def ours_all():
            return run_all(case, starts, 1, pool)

        theirs()
        ours_all()
        runs = interleaved({"ours": ours_all, "yardstick": theirs}, repeat)
    wall = {name: [took.wall / episodes for _, took in turns] for name, turns in runs.items()}
    cpu = {name: [took.cpu / episodes for _, took in turns] for name, turns in runs.items()}
    ours, their = runs["ours"][0][0], runs["yardstick"][0][0]
    length = {
        "ours": path_m(ours.straight, ours.diagonal, world.cell_m),
        "yardstick": np.array([episode["length"] for episode in their]),
    }
    counts = {
        "ours": {"plans": float(np.mean(ours.plans)), "scans": float(np.mean(ours.scans))},
        "yardstick": {key: float(np.mean([episode[key] for episode in their])) for key in ("plans", "scans")},
    }
    return {
        "world": world.name,
        "strategy": case.strategy.name,
        "shape": list(world.shape),
        "compile_s": case.program.compile_s if case.fresh else None,
        "compile_cpu_s": case.program.compile_cpu_s if case.fresh else None,
        "pinned": pinned,
        "s_per_episode": {name: spread(values) for name, values in wall.items()},
        "cpu_s_per_episode": {name: spread(values) for name, values in cpu.items()},
        "time_ratio": ratio(wall["ours"], wall["yardstick"]),
        "cpu_time_ratio": ratio(cpu["ours"], cpu["yardstick"]),
        "path_m": {name: mean_and_se(values) for name, values in length.items()},
        "path_m_difference": mean_and_se(length["ours"] - length["yardstick"]),
        **{key: {name: counts[name][key] for name in counts} for key in ("plans", "scans")},
        "complete": float(np.mean(ours.outcome == Outcome.COMPLETE)),
        "quality_equal": same([answer for answer, _ in runs["ours"]]),
    }


def _plus_minus(value):
    return f"{value['mean']:.1f}" + ("" if value["se"] is None else f" ± {value['se']:.1f}")


def tables(report):
    """The report as Markdown."""
    rows = []
    for case in report["cases"]:
        for n, speed in case["workers"].items():
            rows.append([
                case["world"], case["strategy"], case["compile_cpu_s"], n,
                1e3 * speed["s_per_episode"]["median"], 1e3 * speed["s_per_episode"]["min"],
                1e3 * speed["cpu_s_per_episode"]["median"], speed["episodes_per_s"], speed["steps_per_s"],
                speed["scans_per_s"], speed["plans_per_s"], speed.get("speedup"), speed.get("speedup_of_control"),
                speed.get("speedup_by_busiest_thread"),
                _plus_minus(case["quality"]["path_m"]), f"{case['quality']['explored_fraction']:.3f}",
                f"{100 * case['quality']['complete']:.0f} %", "yes" if case["quality_equal"] else "NO",
                case["episode_mib"],
            ])  # fmt: skip
    header = [
        "world", "strategy", "compile, CPU s", "workers", "ms/episode", "least", "CPU ms", "episodes/s", "steps/s",
        "scans/s", "plans/s", "× 1 worker", "× control", "× by thread", "path m", "explored", "COMPLETE", "equal",
        "MiB",
    ]  # fmt: skip
    parts = [markdown(header, rows)]
    if (memory := report["memory"]) is not None:
        verdict = "met" if memory["met"] else "MISSED"
        side = " x ".join(map(str, memory["shape"]))
        mib, limit = memory["episode_mib"], memory["target_mib"]
        parts.append(f"Memory of one episode, {side} cells: {mib:.2f} MiB (under {limit:g}: {verdict})")
    if report["yardstick"]:
        header = [
            "one core", "strategy", "ours, CPU ms", "yardstick", "ratio", "ratio by the clock",
            "path m", "yardstick", "paired difference", "plans", "yardstick", "scans", "yardstick",
        ]  # fmt: skip
        rows = [
            [
                case["world"].rpartition("/")[2], case["strategy"],
                *(1e3 * case["cpu_s_per_episode"][who]["median"] for who in ("ours", "yardstick")),
                case["cpu_time_ratio"], case["time_ratio"],
                *(_plus_minus(case["path_m"][who]) for who in ("ours", "yardstick")),
                _plus_minus(case["path_m_difference"]),
                *(case[key][who] for key in ("plans", "scans") for who in ("ours", "yardstick")),
            ]
            for case in report["yardstick"]
        ]  # fmt: skip
        parts.append(markdown(header, rows))
    return "\n\n".join(parts)


def parse():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", default=["cave", "hospital", "office"], help="as for jexplore compare")
    parser.add_argument("--strategies", nargs="+", default=["closest+recheck"], help="as for jexplore compare")
    parser.add_argument("--episodes", type=at_least_one, default=16, help="of each strategy in each world")
    parser.add_argument("--repeat", type=at_least_one, default=3, help="times that all of them are run")
    parser.add_argument(
        "--workers",
        type=at_least_one,
        nargs="+",
        help="threads; default: 1. XLA fixes its pool at start: one run for each number tells most",
    )
    parser.add_argument("--yardstick", type=Path, help=f"numba simulator to compare with; default {YARDSTICK} if there")
    parser.add_argument("--no-yardstick", action="store_true", help="leave it out")
    parser.add_argument("--no-memory", action="store_true", help=f"leave out the map of {MEMORY_SIDE} x {MEMORY_SIDE}")
    parser.add_argument("--cache", action="store_true", help="reuse compiled programs: compile_s is then loading")
    parser.add_argument("--out", type=Path, help="JSON file")
    return parser.parse_args()


def yardstick_cases(args):
    """The yardstick's module and the maps to compare on: `(None, [])` where it is not wanted or not there."""
    path = args.yardstick or YARDSTICK
    if args.no_yardstick or (args.yardstick is None and not path.is_file()):
        return None, []
    if not path.is_file():
        raise InputError(f"--yardstick {path}: must be a Python file")
    if importlib.util.find_spec("numba") is None:
        if args.yardstick is not None:
            raise InputError(f"--yardstick {path}: needs numba, which the extra bench installs")
        print("The yardstick needs numba (extra bench): left out.", file=sys.stderr)
        return None, []
    worlds = [SHARED / "maps" / "stage" / name for name in YARDSTICK_MAPS]
    worlds = [str(world) for world in worlds if Path(str(world).partition("@")[0]).is_file()]
    if not worlds:
        print(f"The yardstick's maps are not in {SHARED / 'maps' / 'stage'}: left out.", file=sys.stderr)
        return None, []
    return load_yardstick(path), [load_world(world) for world in worlds]


def main():
    args = parse()
    check_out(args.out)
    strategies = [parse_strategy(name) for name in args.strategies]
    worlds = [load_world(name) for name in args.worlds]
    batch.start_backend(max(args.workers or [1]))
    if args.cache:
        batch.use_compilation_cache()
    workers = sorted(set(args.workers or [1]))
    yardstick, yardstick_worlds = yardstick_cases(args)
    report = {"environment": surroundings(), "episodes": args.episodes, "repeat": args.repeat, "cached": args.cache}
    compiler = Compiler()
    cases = [compiler.case(world, strategy) for world in worlds for strategy in strategies]
    report["cases"] = [measure(case, args.episodes, args.repeat, workers) for case in cases]
    report["memory"] = None if args.no_memory else memory_case(compiler, strategies[0])
    report["yardstick"] = [
        beside(compiler.case(world, strategy), yardstick, args.episodes, args.repeat)
        for world in yardstick_worlds
        for strategy in strategies
        if strategy.name in YARDSTICK_STRATEGIES
    ]
    print(tables(report))
    finish(report, args.out)


if __name__ == "__main__":
    guarded(main)
