"""Compare whole episodes with a yardstick: a simulator written by hand in numba, from the same starts on one core.

    python benchmarks/yardstick.py --out yardstick.json

See README.md in this folder for the columns.
"""

import argparse
import functools
import importlib.util
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.experimental.compilation_cache import compilation_cache

from jexplore.bench import LIDAR, RULES, is_equal, run_once
from jexplore.bench.tables import markdown, plus_minus
from jexplore.bench.timing import interleaved, mean_and_se, median_and_min, one_core, surroundings
from jexplore.config import ENGINES, InputError, require_whole
from jexplore.engine.backend import start_backend
from jexplore.exploration.batch import Job
from jexplore.exploration.results import path_m
from jexplore.exploration.state import Outcome
from jexplore.grid import is_known
from jexplore.planning import View
from jexplore.policies import Strategy
from jexplore.policies.catalogue.adapt import policy_from
from jexplore.reach import MOTIONS
from jexplore.report import store
from jexplore.studies.checks import ready_strategies, ready_worlds

SHARED = Path(__file__).resolve().parents[2] / "shared"
YARDSTICK = SHARED / "bench" / "numba_ref.py"
MAPS = ("cave_filled.png@16x16", "hospital_section.png@49.3x20.1")
OWN = "own"  # strategy that is `near_and_open`
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


def near_and_open(view: View) -> Array:
    """Score cells as a user may: near, and with unknown cells all round."""
    open_ = jnp.sum(jnp.stack([jnp.roll(~is_known(view.belief.grid), (r, c), (0, 1)) for r, c in MOTIONS]), axis=0)
    return open_ - view.path_m


def beside(world, strategy, yardstick, n, repeat):
    """Time one strategy's episodes on one core, by all that can run them, in turns with the yardstick, from the same
    starts: a dict for the report.

    The yardstick's starts have any heading; ours are rounded to 45 degrees. Its world is ours, cell by cell. It goes to
    the closest frontier whatever the strategy.
    """
    rows, cols, headings, _ = yardstick.pick_starts(world.occupied, n, 0, WALL_M / world.cell_m)
    starts = np.stack([rows, cols, np.rint(np.degrees(headings) / 45).astype(int) % 8 * 45], axis=1).astype(np.int32)
    explorer = yardstick.Explorer(
        world.occupied, world.cell_m, LIDAR.range_m, clear_m=RULES.clearance_m, near_m=RULES.near_m
    )

    def theirs():
        return [explorer.run(*start, recheck=strategy.recheck) for start in zip(rows, cols, headings)]

    tasks = {engine: functools.partial(run_once, Job(world, strategy, starts), engine) for engine in ENGINES}
    tasks |= {"yardstick": theirs}
    for task in tasks.values():
        task()
    runs = interleaved(tasks, repeat)
    cpu = {name: [took.cpu / n for _, took in turns] for name, turns in runs.items()}
    their = runs.pop("yardstick")[0][0]
    found = [turns[0][0].outcomes[0].result for turns in runs.values()]
    our = found[-1]
    our_m = path_m(our.straight, our.diagonal, world.cell_m)
    their_m = np.array([episode["length"] for episode in their])
    return {
        "world": world.name,
        "strategy": strategy.name,
        "shape": list(world.shape),
        "cpu_s_per_episode": {name: median_and_min(values) for name, values in cpu.items()},
        "beside_yardstick": {
            name: float(np.median(np.divide(values, cpu["yardstick"]))) for name, values in cpu.items()
        },
        "path_m": {"ours": mean_and_se(our_m), "yardstick": mean_and_se(their_m)},
        "path_m_difference": mean_and_se(our_m - their_m),
        **{
            key: {"ours": float(np.mean(getattr(our, key))), "yardstick": float(np.mean([one[key] for one in their]))}
            for key in ("plans", "scans")
        },
        "complete": float(np.mean(our.outcome == Outcome.COMPLETE)),
        "equal": is_equal(found),
    }  # fmt: skip


def table(cases):
    """Return the cases as Markdown."""
    header = [
        "one core", "strategy", "engine", "CPU ms", "of the yardstick", "path m", "plans", "scans", "equal",
    ]  # fmt: skip
    return markdown(header, [
        [
            case["world"].rpartition("/")[2], case["strategy"], name, 1e3 * took["median"],
            case["beside_yardstick"][name], plus_minus(case["path_m"][who]), case["plans"][who], case["scans"][who],
            "" if who == "yardstick" else case["equal"],
        ]
        for case in cases
        for name, took in case["cpu_s_per_episode"].items()
        for who in ("yardstick" if name == "yardstick" else "ours",)
    ])  # fmt: skip


def parse():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--yardstick", type=Path, default=YARDSTICK, help="numba simulator; default %(default)s")
    parser.add_argument("--worlds", nargs="+", help=f"default: Stage's {' and '.join(MAPS)}")
    parser.add_argument("--strategies", nargs="+", default=["closest+recheck", "distance-advantage+recheck", OWN],
                        help=f"names of strategies; {OWN}: a score of this script's")  # fmt: skip
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
    strategies = [
        Strategy(OWN, policy_from(near_and_open, {}), True) if name == OWN else ready_strategies([name])[0]
        for name in args.strategies
    ]
    if importlib.util.find_spec("numba") is None:
        raise InputError(f"--yardstick {args.yardstick}: needs numba, which the extra bench installs")
    yardstick = load_yardstick(args.yardstick)
    worlds = ready_worlds(args.worlds or [str(SHARED / "maps" / "stage" / name) for name in MAPS], 0.1)
    start_backend(1)
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    report = {"environment": surroundings(), "episodes": args.episodes, "repeat": args.repeat}
    with one_core() as report["pinned"]:
        pass
    report["cases"] = [
        beside(world, strategy, yardstick, args.episodes, args.repeat) for world in worlds for strategy in strategies
    ]
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
