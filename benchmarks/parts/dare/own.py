"""DARE's test maps by this package's own rules: scans after every step, frontier cells, certified lower bounds.

The scanner's range and the cells are DARE's; a robot is a point there, and frontier cells are 4-connected as it needs.
"""

import os
from typing import Any

import numpy as np
from parts.dare import rules, table

from jexplore.report import tables
from jexplore.rules import Lidar, Rules
from jexplore.studies.bounds.beside import with_bound_ratios
from jexplore.studies.bounds.bound import BoundsResult, bound_tasks, run_bounds
from jexplore.studies.comparison import compare
from jexplore.studies.results.columns import RATIO_COLUMNS
from jexplore.studies.results.comparison import ComparisonResult
from jexplore.studies.results.provenance import world_digest
from jexplore.studies.statistics.paired import paired_ratio, safe_exp
from jexplore.worlds.world import World

STRATEGIES = (
    *("closest+recheck", "closest", "small-first+recheck", "distance-advantage+recheck"),
    *("tour+recheck", "learned+recheck", "utility+recheck", "random+recheck"),
)
"""Those of the league `exploration-240`; the others are compared with the first."""
LIDAR = Lidar(n_beams=rules.BEAMS, fov_deg=360, range_m=rules.CELL_M * rules.RANGE)
RULES = Rules(clearance_m=0, near_m=0, frontier_connectivity=4)
SECONDS = 4.0  # for the bounds of a map; most are then the shortest walks


def worlds_of(maps: str | os.PathLike[str], n: int) -> list[World]:
    """Read the first maps as worlds, with the paper's starts.

    Raises:
      InputError: a map that cannot be used, see `rules.read_map`.
    """
    worlds = []
    for number, file in enumerate(table.map_files(maps, n), 1):
        free, (row, col) = rules.read_map(file)
        start = len(free) - 1 - row, col, 0
        worlds.append(World(~free[::-1], start=start, cell_m=rules.CELL_M, name=f"dare {number}"))
    return worlds


def explore_dare(
    maps: str | os.PathLike[str], *, episodes: int, seed: int = 0, workers: int | None = None
) -> tuple[ComparisonResult, BoundsResult]:
    """Run `STRATEGIES` on the first maps and bound the shortest walks that show all."""
    own: Any = {"start": "world", "lidar": LIDAR, "rules": RULES}
    worlds = worlds_of(maps, episodes)
    found = compare(worlds, STRATEGIES, episodes=1, seed=seed, cell_m=rules.CELL_M, workers=workers, **own)
    starts: Any = [(world, world.start) for world in found.worlds]
    return found, run_bounds(bound_tasks(starts, LIDAR, RULES, SECONDS), workers=workers)


def own_text(found: ComparisonResult, bounds: BoundsResult) -> str:
    """Format a row a strategy: its path until COMPLETE and until 99 % is known, over the first's and over the bound.

    Ratios are of means over the maps that both completed, with 95 % intervals. The bound holds for any robot that
    completes; ratios to it are geometric means.
    """
    episodes: Any = with_bound_ratios(found.episodes, bounds.table, {w.name: world_digest(w) for w in found.worlds})
    episodes, rows = episodes.set_index("world"), []
    whole = episodes[episodes["outcome"] == "COMPLETE"]
    for name in STRATEGIES:
        row = [name, f"{(whole['strategy'] == name).sum()} of {(episodes['strategy'] == name).sum()}"]
        own, first = (whole[whole["strategy"] == which] for which in (name, STRATEGIES[0]))
        both = own.index.intersection(first.index)
        for column in ("path_m", "path_m_at_99"):
            row.append(tables.spread_text(own[column].mean(), own[column].std()))
            pairs = own.loc[both, column], first.loc[both, column]
            row.append(tables.ratio_text(*paired_ratio(*pairs)[:3]) if len(both) else "-")
        row.append(tables.number_text(safe_exp(np.log(own[RATIO_COLUMNS[1]]).mean()), 3))
        rows.append([*row, tables.number_text(own[RATIO_COLUMNS[1]].min(), 3)])
    head = ["strategy", "COMPLETE", "path m", "ratio", "path m at 99 %", "ratio at 99 %", "path / bound", "least"]
    known: Any = bounds.table
    exact = (known["status"] == "OPTIMAL").sum()
    note = f"Lower bounds: {known['low_any_m'].mean():.1f} m in the mean, {exact} of {len(known)} exact."
    return f"# DARE's maps by our own rules\n\n{tables.aligned_table(head, rows, left=('strategy',))}\n{note}\n"
