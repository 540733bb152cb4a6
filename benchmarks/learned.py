"""Compare a learned strategy with every other one of a comparison: where it loses, and the remaining gap.

    python benchmarks/learned.py DIR [STRATEGY]
    python benchmarks/learned.py --seeds DIR...
    python benchmarks/learned.py --models DIR

DIR: what `jexplore compare` wrote, best of many worlds, with `--bounds` for the last table. Prints ratios of the paths
of STRATEGY (default learned+recheck) to those of every other strategy there, over worlds and by kind, with 95 %
intervals; the worlds in which it loses most against the best of the others; and all compared with the shortest walk
found with the map. With --seeds, all strategies but the first are one, trained with several seeds: the ratio of its
paths to those of the first, with an interval over other seeds and other worlds of these kinds. With --models, ratios of
all strategies but the first to it: paths and times to shares of the cells known, areas above the curves, energy, turns.
"""

import math
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from jexplore.bench.tables import markdown
from jexplore.report.tables import ratio_text
from jexplore.studies.bounds.beside import START
from jexplore.studies.statistics.league import paths_by_world
from jexplore.studies.statistics.over_worlds import comparable_paths, kind_of, mean_over_worlds
from jexplore.studies.statistics.paired import t_interval

SHARES = {f"path_m_at_{share}": f"{share} %" for share in (50, 90, 95, 99)} | {"path_m": "100 %"}
MEASURES = {column: f"path to {share}" for column, share in SHARES.items()} | {"area_m": "area, path"}
MEASURES |= {column.replace("path_m", "time_s"): f"time to {share}" for column, share in SHARES.items()}
MEASURES |= {"area_s": "area, time", "energy_j": "energy", "turning_rad": "turns"}


def beside(episodes, name, other, column="path_m"):
    """Compute logarithms of one strategy's mean paths, or another column, relative to another's: a Series by world."""
    some = pd.concat([episodes[episodes["strategy"] == one] for one in (other, name)])
    found = paths_by_world(some, column)
    return found[found["strategy"] == name].set_index("world")["log_ratio"]


def over_seeds_and_worlds(values, kinds):
    """Estimate the mean of `[S, W]` values of crossed random seeds and worlds, worlds in kinds: `(mean, low, high)`.

    Its variance is that of two crossed random factors without replication, from mean squares (Cornfield and Tukey
    1956), at least what either factor alone gives; degrees of freedom by Satterthwaite 1946.
    """
    (n_seeds, n_worlds), n_kinds = values.shape, len(set(kinds))
    of_seed, of_world = values.mean(axis=1), pd.Series(values.mean(axis=0))
    own = of_world - of_world.groupby(kinds).transform("mean")
    rest = values - of_seed[:, None] - of_world.to_numpy() + values.mean()
    free = np.array([n_seeds - 1, n_worlds - n_kinds, (n_seeds - 1) * (n_worlds - 1)])
    sums = np.array([n_worlds * of_seed.var() * n_seeds, n_seeds * (own**2).sum(), (rest**2).sum()])
    squares = sums / free * [1, 1, -1]
    total = max(squares.sum(), *squares[:2])
    low, high, _ = t_interval(values.mean(), math.sqrt(total / values.size), total**2 / (squares**2 / free).sum())
    return values.mean(), low, high


def seeds(episodes):
    """Tabulate ratios of a strategy of several seeds to the first one, by share of the cells known in the end."""
    first, *models = episodes["strategy"].unique()
    rows = []
    for column, share in SHARES.items():
        table = pd.concat([beside(episodes, name, first, column) for name in models], axis=1).dropna()
        logs, kinds = table.to_numpy().T, [kind_of(world) for world in table.index]
        ratio = ratio_text(*np.exp(over_seeds_and_worlds(logs, kinds)))
        rows.append([share, len(kinds), ratio, *(f"{np.exp(one.mean()):.3f}" for one in logs)])
    names = [name.rpartition("/")[2] for name in models]
    return markdown(["known", "worlds", f"over {first}", *names], rows)


def models(episodes):
    """Tabulate ratios of strategies to the first one, by measure, with intervals over worlds of these kinds."""
    first, *names = episodes["strategy"].unique()
    rows = []
    for column, told in MEASURES.items():
        rows.append([told])
        for name in names:
            own = beside(episodes, name, first, column).dropna()
            rows[-1].append(ratio_text(*np.exp(mean_over_worlds(own, [kind_of(world) for world in own.index])[:3])))
    return markdown([f"over {first}", *(name.rpartition("/")[2] for name in names)], rows)


def main(arguments):
    if arguments[0] == "--seeds":
        read = pd.concat(pd.read_parquet(Path(folder) / "episodes.parquet") for folder in arguments[1:])
        print(seeds(read.drop_duplicates(["world", "strategy", "episode"])))
        return
    if arguments[0] == "--models":
        print(models(pd.read_parquet(Path(arguments[1]) / "episodes.parquet")))
        return
    folder, name = Path(arguments[0]), arguments[1] if len(arguments) > 1 else "learned+recheck"
    episodes = pd.read_parquet(folder / "episodes.parquet")
    others = [one for one in episodes["strategy"].unique() if one != name]
    kinds = list(dict.fromkeys(map(kind_of, episodes["world"].unique())))
    rows, logs = [], {other: beside(episodes, name, other) for other in others}
    for other, own in logs.items():
        of_kind = [kind_of(world) for world in own.index]
        mean, low, high, _ = mean_over_worlds(own, of_kind)
        each = own.groupby(of_kind).mean()
        rows.append(
            [other, len(own), ratio_text(*np.exp([mean, low, high])), *(f"{np.exp(each[k]):.3f}" for k in kinds)]
        )
    print(markdown([f"{name} beside", "worlds", "ratio", *kinds], rows))
    best = max(others, key=lambda other: logs[other].mean())  # the one that it gains least upon
    print(f"\nWhere it loses most against {best}, the best of the others:\n")
    most = logs[best].sort_values(ascending=False)[:8]
    print(markdown(["world", "ratio"], [[world, f"{np.exp(value):.3f}"] for world, value in most.items()]))
    print(f"\nLonger than {best} in {(logs[best] > 0).sum()} of {len(logs[best])} worlds.")
    if (folder / "bounds.parquet").exists():
        print("\n" + competitive(episodes, pd.read_parquet(folder / "bounds.parquet"), [name, *others]))


def competitive(episodes, bounds, names):
    """Compute paths relative to the shortest walks found with the map, where known."""
    paths = comparable_paths(episodes).reset_index()
    keys = ["world", *START]
    starts = episodes.drop_duplicates(["world", "episode"])[["episode", *keys]]
    both = paths.merge(starts, on=["world", "episode"]).merge(bounds.drop_duplicates(keys), on=keys)
    both = both[np.isfinite(both[["high_m", *names]]).all(axis=1) & (both["high_m"] > 0)]
    rows = []
    for one in names:
        logs = np.log(both[one] / both["high_m"])
        of_world = logs.groupby(both["world"]).mean()
        mean, low, high, _ = mean_over_worlds(of_world, [kind_of(world) for world in of_world.index])
        rows.append([one, len(of_world), ratio_text(*np.exp([mean, low, high]))])
    return markdown(["strategy", "worlds", "path / shortest walk found"], rows)


if __name__ == "__main__":
    main(sys.argv[1:])
