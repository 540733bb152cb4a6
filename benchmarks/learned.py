"""Compare a learned strategy with every other one of a comparison: where it loses, and the remaining gap.

    python benchmarks/learned.py DIR [STRATEGY]

DIR: what `jexplore compare` wrote, best of many worlds, with `--bounds` for the last table. Prints ratios of the paths
of STRATEGY (default learned+recheck) to those of every other strategy there, over worlds and by kind, with 95 %
intervals; the worlds in which it loses most against the best of the others; and all compared with the shortest walk
found with the map.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from jexplore.bench.tables import markdown
from jexplore.report.tables import ratio_text
from jexplore.studies.bounds.beside import START
from jexplore.studies.statistics.league import paths_by_world
from jexplore.studies.statistics.over_worlds import comparable_paths, kind_of, mean_over_worlds


def beside(episodes, name, other):
    """Compute logarithms of one strategy's mean paths relative to another's: a Series by world."""
    some = pd.concat([episodes[episodes["strategy"] == one] for one in (other, name)])
    found = paths_by_world(some)
    return found[found["strategy"] == name].set_index("world")["log_ratio"]


def main(arguments):
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
