"""Measure the effect of a strategy's parameters, on worlds that the league does not have.

    python benchmarks/tuning.py [FIRST] [WORLDS OF EACH KIND]

`small-first+recheck` and `closest+recheck`, six kinds of worlds from #1000 on (or FIRST), one start each: mean ratio of
paths with its standard error over worlds, and by kind. The defaults were chosen by such tables.
"""

import sys

import numpy as np

import jexplore as jx
from jexplore.bench.tables import markdown
from jexplore.studies.statistics.league import FURNISHED, LEAGUE_KINDS, paths_by_world
from jexplore.studies.statistics.over_worlds import kind_of

REFERENCE = "closest+recheck"
SETTINGS = (
    "distance-advantage+recheck:weight=0.5",
    *(f"small-first+recheck:weight={w:g},side_weight={s:g}" for w in (0.3, 0.5, 0.8) for s in (0.0, 0.3, 0.5, 1.0)),
)


def main(arguments):
    first = int(arguments[0]) if arguments else 1000
    n = int(arguments[1]) if len(arguments) > 1 else 14
    seeds = range(first, first + n)
    worlds = [f"{kind}#{seed}" for kind in LEAGUE_KINDS for seed in seeds]
    worlds += [FURNISHED[seed % len(FURNISHED)].format(seed) for seed in seeds]
    ratios = paths_by_world(jx.compare(worlds, [REFERENCE, *SETTINGS], episodes=1).episodes)
    ratios["kind"] = [kind_of(world) for world in ratios["world"]]
    kinds, rows = list(dict.fromkeys(ratios["kind"])), []
    for name in (REFERENCE, *SETTINGS):
        own = ratios[ratios["strategy"] == name]
        of_kind = np.exp(own.groupby("kind")["log_ratio"].mean())
        spread = own["log_ratio"].std() / len(own) ** 0.5
        mean = f"{np.exp(own['log_ratio'].mean()):.3f} ± {spread:.3f}"
        rows.append([name, mean, *(f"{of_kind[kind]:.3f}" for kind in kinds)])
    print(markdown([f"worlds #{first} to #{seeds[-1]}", f"path / {REFERENCE}", *kinds], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
