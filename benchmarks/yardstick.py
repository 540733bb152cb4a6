"""Compare whole episodes with a yardstick: a simulator written by hand in numba, from the same starts on one core.

    python benchmarks/yardstick.py --out yardstick.json

See README.md in this folder for the columns.
"""

import argparse
import importlib.util
import sys
from pathlib import Path

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

from jexplore.bench.engines import LIDAR, RULES, Compiler, same
from jexplore.bench.tables import markdown, plus_minus
from jexplore.bench.timing import interleaved, mean_and_se, one_core, ratio, spread, surroundings
from jexplore.config import InputError, require_whole
from jexplore.engine.backend import start_backend
from jexplore.exploration.results import path_m
from jexplore.exploration.site import drive_for
from jexplore.exploration.state import Outcome
from jexplore.report import store
from jexplore.studies.checks import ready_strategies, ready_worlds

SHARED = Path(__file__).resolve().parents[2] / "shared"
YARDSTICK = SHARED / "bench" / "numba_ref.py"
MAPS = ("cave_filled.png@16x16", "hospital_section.png@49.3x20.1")
STRATEGIES = ("closest", "closest+recheck")  # what it can do
WALL_M = 0.4  # distance of the yardstick's starts from walls


def load_yardstick(path):
    """Load the yardstick's module by its file's own name: numba's cache then serves its command line as well."""
    try:
        spec = importlib.util.spec_from_file_location(Path(path).stem, path)
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


def beside(compiler, world, strategy, native, yardstick, episodes, repeat):
    """Times one case on one core in turns with the yardstick, from the same starts: a dict for the report.

    The yardstick's starts have any heading; ours are rounded to 45 degrees. Its world is ours, cell by cell.
    """
    program = compiler.one_by_one(world, strategy, native)
    rows, cols, headings, _ = yardstick.pick_starts(world.occupied, episodes, 0, WALL_M / world.cell_m)
    starts = np.stack([rows, cols, np.rint(np.degrees(headings) / 45).astype(int) % 8 * 45], axis=1).astype(np.int32)
    explorer = yardstick.Explorer(
        world.occupied, world.cell_m, LIDAR.range_m, clear_m=RULES.clearance_m, near_m=RULES.near_m
    )

    def ours():
        return program.run(starts).result

    def theirs():
        return [explorer.run(*start, recheck=strategy.recheck) for start in zip(rows, cols, headings)]

    theirs()
    ours()
    runs = interleaved({"ours": ours, "yardstick": theirs}, repeat)
    wall = {name: [took.wall / episodes for _, took in turns] for name, turns in runs.items()}
    cpu = {name: [took.cpu / episodes for _, took in turns] for name, turns in runs.items()}
    our, their = runs["ours"][0][0], runs["yardstick"][0][0]
    length = {
        "ours": path_m(our.straight, our.diagonal, world.cell_m),
        "yardstick": np.array([episode["length"] for episode in their]),
    }
    counts = {
        "ours": {"plans": float(np.mean(our.plans)), "scans": float(np.mean(our.scans))},
        "yardstick": {key: float(np.mean([episode[key] for episode in their])) for key in ("plans", "scans")},
    }
    return {
        "world": world.name,
        "strategy": strategy.name,
        "native": native is not None,
        "shape": list(world.shape),
        "s_per_episode": {name: spread(values) for name, values in wall.items()},
        "cpu_s_per_episode": {name: spread(values) for name, values in cpu.items()},
        "time_ratio": ratio(wall["ours"], wall["yardstick"]),
        "cpu_time_ratio": ratio(cpu["ours"], cpu["yardstick"]),
        "path_m": {name: mean_and_se(values) for name, values in length.items()},
        "path_m_difference": mean_and_se(length["ours"] - length["yardstick"]),
        **{key: {name: counts[name][key] for name in counts} for key in ("plans", "scans")},
        "complete": float(np.mean(our.outcome == Outcome.COMPLETE)),
        "equal": same([answer for answer, _ in runs["ours"]]),
    }


def table(cases):
    """The cases as Markdown."""
    header = [
        "one core", "strategy", "driven by", "ours, CPU ms", "yardstick", "ratio", "ratio by the clock",
        "path m", "yardstick", "paired difference", "plans", "yardstick", "scans", "yardstick", "equal",
    ]  # fmt: skip
    return markdown(header, [
        [
            case["world"].rpartition("/")[2], case["strategy"], "C++" if case["native"] else "JAX",
            *(1e3 * case["cpu_s_per_episode"][who]["median"] for who in ("ours", "yardstick")),
            case["cpu_time_ratio"], case["time_ratio"],
            *(plus_minus(case["path_m"][who]) for who in ("ours", "yardstick")),
            plus_minus(case["path_m_difference"]),
            *(case[key][who] for key in ("plans", "scans") for who in ("ours", "yardstick")), case["equal"],
        ]
        for case in cases
    ])  # fmt: skip


def parse():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--yardstick", type=Path, default=YARDSTICK, help="numba simulator; default %(default)s")
    parser.add_argument("--worlds", nargs="+", help=f"default: Stage's {' and '.join(MAPS)}")
    parser.add_argument("--strategies", nargs="+", default=["closest+recheck"], help=f"among {', '.join(STRATEGIES)}")
    parser.add_argument("--episodes", type=int, default=16, help="of each strategy in each world")
    parser.add_argument("--repeat", type=int, default=5, help="turns of ours and the yardstick")
    parser.add_argument("--out", type=Path, help="JSON file")
    return parser.parse_args()


def main():
    args = parse()
    for name in ("episodes", "repeat"):
        require_whole(f"--{name}", getattr(args, name), 1, 1_000_000)
    if args.out is not None and not args.out.resolve().parent.is_dir():
        raise InputError(f"--out {args.out}: its folder must exist")
    strategies = ready_strategies(args.strategies)
    for strategy in strategies:
        if strategy.name not in STRATEGIES:
            raise InputError(f"--strategies must be among {', '.join(STRATEGIES)}, got {strategy.name!r}")
    if importlib.util.find_spec("numba") is None:
        raise InputError(f"--yardstick {args.yardstick}: needs numba, which the extra bench installs")
    yardstick = load_yardstick(args.yardstick)
    targets = list(dict.fromkeys([None, drive_for("cpu").name]))
    worlds = ready_worlds(args.worlds or [str(SHARED / "maps" / "stage" / name) for name in MAPS], 0.1)
    start_backend(1)
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    report = {"environment": surroundings(), "episodes": args.episodes, "repeat": args.repeat}
    with one_core() as report["pinned"]:
        pass
    compiler = Compiler()
    report["cases"] = [
        beside(compiler, world, strategy, own, yardstick, args.episodes, args.repeat)
        for world in worlds
        for strategy in strategies
        for own in targets
    ]
    report["programs"] = compiler.programs
    print(table(report["cases"]))
    if args.out is not None:
        store.write_json(report, args.out)
        print(f"\nwrote {args.out}")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(f"{Path(sys.argv[0]).name}: error: {error}", file=sys.stderr)
        sys.exit(2)
