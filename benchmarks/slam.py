"""Localisation and mapping: recorded logs against their corrected poses, the time of one match, and episodes of robots
that do not know their pose.

    python benchmarks/slam.py LOGS                       # a folder of CARMEN logs, each without and with loop closing
    python benchmarks/slam.py LOGS --only intel --draw pictures
    taskset -c 0 python benchmarks/slam.py --matches 100000
    python benchmarks/slam.py --episodes 134 --worlds MAPS/stage/cave_filled.png@16x16 office hospital
                                                         # closest+recheck by pose, from the same starts
    python benchmarks/slam.py --study 8                  # what drift does to strategies, 8 worlds of each of five kinds
    python benchmarks/slam.py --study 20 --first 1000 --kinds cave --strategies closest+recheck --poses icp --off 0.5
                                                         # the pose is exact, and the map's cells lie half a cell aside

Settings were chosen on Intel and Freiburg 079, those of searches without odometry on Orebro; all other logs are held
out. A log's corrected poses come from another SLAM: errors say how far both agree. Relations: see
`jexplore.studies.slam.errors.relations_between`.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy.stats import kendalltau

import jexplore as jx
from jexplore.bench.tables import markdown
from jexplore.engine.backend import use_compilation_cache
from jexplore.exploration.uncertain import looking
from jexplore.report.tables import ratio_text
from jexplore.slam2d.matching import Outcome, match
from jexplore.slam2d.points import add, empty_map
from jexplore.slam2d.scans import read_scan
from jexplore.slam2d.settings import SlamSettings
from jexplore.studies.statistics.league import LEAGUE_KINDS, paths_by_world
from jexplore.studies.statistics.paired import paired_ratio

CHOSEN_ON = ("intel", "freiburg-079", "orebro")  # the last for searches without odometry
HEAD = (
    "log",
    "closing",
    "scans",
    "way m",
    "local m",
    "sd",
    "local deg",
    "revisit m",
    "global m",
    "ate m",
    "loops",
    "lost",
    "ambiguous",
    "s",
)
WORLDS = ("cave", "office", "hospital")
ODOMETRY = jx.Odometry(length=0.05, length_scale=1.05, heading_deg_sqrt_m=2.0)
STRATEGIES = (
    *("closest+recheck", "closest", "small-first+recheck", "learned+recheck", "distance-advantage+recheck"),
    *("tour+recheck", "utility+recheck", "random+recheck"),
)
LEVELS = {
    "2 %, 0.5": jx.Odometry(length=0.02, length_scale=1.02, heading_deg_sqrt_m=0.5),
    "5 %, 2": ODOMETRY,
    "10 %, 5": jx.Odometry(length=0.1, length_scale=1.1, heading_deg_sqrt_m=5.0),
}
"""Length, in error and in spread, and degrees per root metre."""
BEAMS, ROOM_M = 181, (6.0, 4.0)
BATCH = 10_000  # random matches at a time


def log_row(path, closing, folder):
    began = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = jx.slam(path, closing=closing)
    spent_s = time.process_time() - began
    name = path.name.split(".")[0].removesuffix("-corrected")
    if folder is not None:
        from jexplore.report.plot import save_figure

        folder.mkdir(parents=True, exist_ok=True)
        save_figure(found.figure(), folder / f"{name}-{'closing' if closing else 'open'}.png")
    errors = {} if found.errors.empty else found.errors.set_index("relations").to_dict("index")

    def of(kind, what="place_m"):
        return f"{errors[kind][what]:.3f}" if kind in errors else "-"

    way_m = np.hypot(*np.diff(found.poses[:, :2], axis=0).T).sum()
    told = name if name in CHOSEN_ON else f"{name} (held out)"
    return [
        told, "yes" if closing else "no", str(len(found.poses)), f"{way_m:.0f}", of("local"), of("local", "place_sd_m"),
        of("local", "turn_deg"), of("revisit"), of("global"), f"{found.ate_m:.3f}", str(len(found.loops)),
        str(int((found.outcomes >= Outcome.FAR).sum())), str(int((found.outcomes == Outcome.AMBIGUOUS).sum())),
        f"{spent_s:.0f}",
    ]  # fmt: skip


def ranges_in_room(pose, angles):
    """Ranges from poses `[..., 3]` in a rectangular room."""
    heading = pose[..., 2:] + angles
    dx, dy = np.cos(heading), np.sin(heading)
    with np.errstate(divide="ignore"):
        x = np.where(dx > 0, ROOM_M[0] - pose[..., :1], -pose[..., :1]) / dx
        y = np.where(dy > 0, ROOM_M[1] - pose[..., 1:2], -pose[..., 1:2]) / dy
    return np.float32(np.minimum(x, y))


def matches(n, seed):
    """Time one match, and count numbers that are not finite in random matches."""
    own, rng = jax.tree.map(np.float32, SlamSettings()), np.random.default_rng(seed)
    angles = np.radians(np.linspace(-90, 90, BEAMS, dtype=np.float32))
    pose, points = np.array([3.0, 2.0, 0.5]), empty_map((512, 512, 4096), (3, 2))
    for turn in (0, 2, 4):
        at = np.float32(pose + np.array([0, 0, turn]))
        points = add(own, points, read_scan(own, ranges_in_room(at, angles), angles, 80.0), at)
    prior = np.diag(np.float32([0.05, 0.05, 0.03]) ** 2)
    true = np.array([3.1, 2.1, 0.4])
    scan = read_scan(own, ranges_in_room(true, angles) + np.float32(rng.normal(0, 0.01, BEAMS)), angles, 80.0)
    starts = np.float32(true + rng.normal(0, 1, (1000, 3)) * [0.04, 0.04, 0.02])
    in_turn = jax.jit(lambda points, starts: lax.map(lambda start: match(own, points, scan, start, prior), starts))
    found, took = jax.block_until_ready(in_turn(points, starts)), []
    for _ in range(10):
        began = time.process_time()
        jax.block_until_ready(in_turn(points, starts))
        took.append(1e6 * (time.process_time() - began) / len(starts))
    off_m = np.hypot(*(np.array(found.pose) - true)[:, :2].T)
    print(markdown(["one match of many in turn, 181 beams", "value"], [
        ["median us of processor time", f"{np.median(took):.1f}"],
        ["least us", f"{np.min(took):.1f}"],
        ["farthest from the truth, m", f"{off_m.max():.4f}"],
    ]))  # fmt: skip

    def random_match(key):
        keys = jax.random.split(key, 5)
        near = jax.random.normal(keys[0], (3,)) * jnp.array([0.1, 0.1, 0.05])
        anywhere = jax.random.uniform(keys[0], (3,), minval=-4.0, maxval=8.0)
        is_room = jax.random.bernoulli(keys[4])  # else ranges of no room, from anywhere
        start = jnp.where(is_room, true + near, anywhere)
        ranges = jax.random.uniform(keys[1], (BEAMS,), maxval=90.0) * jax.random.uniform(keys[2], (BEAMS,))
        noisy = ranges_in_room(true, angles) + 0.02 * jax.random.normal(keys[1], (BEAMS,))
        ranges = jnp.where(is_room, noisy, ranges)
        odd = jax.random.choice(keys[3], jnp.array([jnp.nan, jnp.inf, -1.0, 0.0, 81.0, 2.0, 3.0]), (BEAMS,))
        ranges = jnp.where(jax.random.uniform(keys[4], (BEAMS,)) < 0.2, odd, ranges)
        spread = jnp.exp(jax.random.uniform(keys[2], (), minval=-14.0, maxval=3.0)) * jnp.eye(3)
        return match(own, points, read_scan(own, ranges, angles, 80.0), start, spread)

    together = jax.jit(lambda keys: lax.map(random_match, keys))
    bad, counts = 0, np.zeros(len(Outcome), int)
    for batch in range(-(-n // BATCH)):
        made = together(jax.random.split(jax.random.key(seed + batch), BATCH))
        bad += sum(int((~np.isfinite(a)).sum()) for a in made)
        counts += np.bincount(made.outcome, minlength=len(Outcome))
    told = ", ".join(f"{n} {Outcome(k).name.lower()}" for k, n in enumerate(counts))
    print(f"{counts.sum()} random matches: {bad} numbers not finite; {told}")


def timed(world, n, **how):
    """Run episodes, compiled before: the comparison, and processor time of an episode, seconds."""
    jx.compare(world, "closest+recheck", episodes=1, workers=1, **how)
    began = time.process_time()
    found = jx.compare(world, "closest+recheck", episodes=n, workers=1, **how)
    return found, (time.process_time() - began) / n


def episodes(worlds, poses, n, seed):
    """Run episodes by true and by estimated pose; path and time are over those of a given pose."""
    head = ["world", "pose", "COMPLETE", "others", "ATE m", "largest", "end m", "end deg", "free IoU", "least", "bumps"]
    head += ["loops", "path over true (95 %)", "ms an episode", "over true, native", "over true, JAX"]
    rows = []
    for world in worlds:
        given, native_s = timed(world, n, seed=seed)
        _, jax_s = timed(world, n, seed=seed, engine="jax")
        for pose in poses:
            found, own_s = timed(world, n, seed=seed, pose=pose, odometry=ODOMETRY)
            table, others = found.episodes, found.episodes["outcome"].value_counts().drop("COMPLETE", errors="ignore")
            ratio = paired_ratio(table["path_m"], given.episodes["path_m"])
            rows.append([
                world, pose, f"{(table['outcome'] == 'COMPLETE').mean():.0%}",
                ", ".join(f"{n} {name}" for name, n in others.items()) or "-",
                f"{table['ate_m'].mean():.3f}", f"{table['ate_m'].max():.3f}", f"{table['end_error_m'].mean():.3f}",
                f"{table['end_error_deg'].mean():.2f}", f"{table['free_iou'].mean():.3f}",
                f"{table['free_iou'].min():.3f}", str(table["bumps"].sum()), f"{table['loops'].mean():.1f}",
                ratio_text(*ratio[:3]), f"{1e3 * own_s:.0f}", f"{own_s / native_s:.1f}", f"{own_s / jax_s:.1f}",
            ])  # fmt: skip
            print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
    print(markdown(head, rows))


def lie_aside(cells):
    """Make robots that match scans know their pose exactly, in maps whose cells lie off those of the world.

    They lie `cells` to the left and 0.6 of that below, so that walls along both axes run through cells.
    """

    def shifted(given, poses, heading, reading, cell_m):
        estimate = poses.true + jnp.float32([cells, 0.6 * cells, 0])
        return poses.replace(estimate=estimate, covariance=0 * poses.covariance), jnp.bool_(False)

    looking._matched = shifted


def study(worlds, strategies, poses, levels, starts, seed, folder):
    """Run strategies by given and estimated pose, and by noise; ratios are paths over those of the first strategy in
    the same setting.
    """

    def run(name, **pose):
        kept = {} if folder is None else {"out": folder / name, "resume": True}
        made = jx.compare(worlds, strategies, episodes=starts, seed=seed, **pose, **kept)
        print(name, f"{made.run_s:.0f} s", file=sys.stderr, flush=True)
        return made

    found = {("true", "-"): run("true")}
    for pose in poses:
        for level, odometry in levels.items():
            found[pose, level] = run(f"{pose} {level}", pose=pose, odometry=odometry)
    ratios = {
        setting: paths_by_world(one.episodes).groupby("strategy")["log_ratio"].agg(["mean", "sem"])
        for setting, one in found.items()
    }
    order = ratios["true", "-"]["mean"]
    paths, own = [], []
    for name in strategies:
        row = [name]
        for setting in found:
            mean, sem = ratios[setting].loc[name]
            row.append(ratio_text(*np.exp([mean, mean - 1.96 * sem, mean + 1.96 * sem])))
        paths.append(row)
    together = [f"{kendalltau(order, one['mean'].reindex(order.index))[0]:.2f}" for one in ratios.values()]
    paths.append(["Kendall's tau with true", *together])
    for (pose, level), one in found.items():
        for name in strategies if pose != "true" else ():
            table = one.episodes[one.episodes["strategy"] == name]
            given = found["true", "-"].episodes.query("strategy == @name")
            more = paired_ratio(table["path_m"].to_numpy(), given["path_m"].to_numpy())
            own.append([
                pose, level, name, f"{(table['outcome'] == 'COMPLETE').mean():.0%}",
                str((table["outcome"] == "LOST").sum()), ratio_text(*more[:3]), f"{table['ate_m'].mean():.3f}",
                f"{table['ate_m'].max():.2f}", f"{table['free_iou'].mean():.3f}", f"{table['loops'].mean():.1f}",
            ])  # fmt: skip
    print(markdown(["strategy", *(" ".join(setting) for setting in found)], paths), "\n")
    head = ["pose", "noise", "strategy", "COMPLETE", "LOST", "path over true", "ATE m", "largest", "free IoU", "loops"]
    print(markdown(head, own), "\n")
    estimated = [setting for setting in found if setting[0] != "true"]
    kinds = []
    for kind in dict.fromkeys(world.partition("#")[0] for world in worlds):
        kinds.append([kind])
        for setting in estimated:
            table = found[setting].episodes
            table = table[table["world"].str.startswith(f"{kind}#") & (table["strategy"] != "random+recheck")]
            kinds[-1].append(f"{(table['outcome'] == 'COMPLETE').mean():.0%}, {table['ate_m'].mean():.3f}")
    print(markdown(["COMPLETE, ATE m; without random", *(" ".join(setting) for setting in estimated)], kinds))


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="?", type=Path)
    parser.add_argument("--only", nargs="+", default=[""], help="logs whose names begin so")
    parser.add_argument("--closing", choices=("no", "yes", "both"), default="both")
    parser.add_argument("--draw", type=Path, metavar="DIR", help="write pictures into this folder")
    parser.add_argument("--matches", type=int, default=0, help="random matches; also times one")
    parser.add_argument("--episodes", type=int, default=0, help="episodes in each of the worlds, by each of the poses")
    parser.add_argument("--worlds", nargs="+", default=WORLDS)
    parser.add_argument("--poses", nargs="+", default=("icp", "icp+closing"))
    parser.add_argument("--study", type=int, default=0, help="worlds of each kind, see `study`")
    parser.add_argument("--first", type=int, default=0, help="number of the first world of each kind")
    parser.add_argument("--kinds", nargs="+", default=LEAGUE_KINDS, help="of worlds of the study")
    parser.add_argument("--levels", nargs="+", choices=LEVELS, default=LEVELS, help="of noise in the study")
    parser.add_argument("--strategies", nargs="+", default=STRATEGIES, help="of the study; ratios are to the first")
    parser.add_argument("--off", type=float, metavar="CELLS", help="in the study, see `lie_aside`")
    parser.add_argument("--starts", type=int, default=2, help="in each world of the study")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep episodes of the study here, and go on with them")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    use_compilation_cache()
    if options.logs is not None:
        rows = []
        for path in sorted(options.logs.glob("*.log*")):
            if any(path.name.startswith(name) for name in options.only):
                for closing in {"no": (False,), "yes": (True,), "both": (False, True)}[options.closing]:
                    rows.append(log_row(path, closing, options.draw))
                    print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
        print(markdown(HEAD, rows))
    if options.matches:
        matches(options.matches, options.seed)
    levels = {name: LEVELS[name] for name in options.levels}
    if options.off is not None:
        lie_aside(options.off)
        levels = {f"exact, {options.off:g}": jx.Odometry(length=0, turn=0, heading_deg_sqrt_m=0, slip=0)}
    if options.episodes:
        episodes(options.worlds, options.poses, options.episodes, options.seed)
    if options.study:
        numbers = range(options.first, options.first + options.study)
        worlds = [f"{kind}#{number}" for kind in options.kinds for number in numbers]
        study(worlds, options.strategies, options.poses, levels, options.starts, options.seed, options.out)


if __name__ == "__main__":
    main()
