"""Table I of DARE again: planners on its 100 test maps, next to its figures."""

import concurrent.futures
import dataclasses
import functools
import math
import multiprocessing
import os
from typing import Any

import numpy as np
import pandas as pd
from parts.dare import planners, rules
from scipy import stats

from jexplore.config import InputError, require_whole
from jexplore.report import tables
from jexplore.studies.statistics.paired import t_interval

MAPS = 100
DECISIONS = 128  # of an episode at most
PUBLISHED = {
    "nearest": (652.0, 76.0),
    "utility": (585.0, 79.0),
    "nbvp": (645.0, 109.0),
    "tare-local": (558.0, 67.0),
    "ariadne": (579.0, 82.0),
    "dare": (563.0, 71.0),
    "tour": (499.0, 61.0),
}
"""Mean and standard deviation of the path over the 100 maps, metres: Table I of Cao et al., ICRA 2025."""
NOTE = "Learned planners stand as printed; p is Welch's, of ours against theirs as if on different maps."


def map_files(folder: str | os.PathLike[str], n: int = MAPS) -> list[str]:
    """Return the files of the first test maps: `1.png` and on in the folder, or in its `maps_test`.

    Raises:
      InputError: a number of maps that there cannot be, no such folder, or no such file.
    """
    require_whole("episodes", n, 1, MAPS)
    folder = os.path.expanduser(folder)
    inner = os.path.join(folder, "maps_test")
    folder = inner if os.path.isdir(inner) else folder
    files = [os.path.join(folder, f"{i}.png") for i in range(1, n + 1)]
    for file in files:
        if not os.path.isfile(file):
            raise InputError(f"maps must be a folder that holds 1.png to {n}.png of DARE; there is no file {file}")
    return files


def run_map(file: str, seed: int, most: int = DECISIONS, *, scanner: str = "dare") -> list[dict[str, Any]]:
    """Run every planner in one map: a row of results each."""
    free, start = rules.read_map(file)
    rows, name = [], os.path.splitext(os.path.basename(file))[0]
    for planner, build in planners.PLANNERS.items():
        explorer, plan = rules.explorer(free, start, rules.SCANNERS[scanner]), build()
        rng = np.random.default_rng((seed, int(name)))
        while (left := bool(explorer.utility.any())) and explorer.moves < most:
            node = plan(explorer, rng)
            if node is None:
                break
            explorer.move(node)
        explored = float((explorer.belief[explorer.truth] == rules.FREE).mean())
        found = {"map": int(name), "planner": planner, "path_m": explorer.path_m, "decisions": explorer.moves}
        rows.append({**found, "complete": not left, "explored_fraction": explored})
    return rows


@dataclasses.dataclass(frozen=True)
class DareResult:
    """Table I of DARE and ours."""

    episodes: pd.DataFrame
    """One row a map and planner: path, decisions, whether no node counts anything at the end, explored share."""

    @functools.cached_property
    def table(self) -> pd.DataFrame:
        """Tabulate one row a planner: the paper's mean and spread, ours with its 95 % interval, ratio, Welch's p."""
        rows = []
        for planner, (mean, sd) in PUBLISHED.items():
            row = {"planner": planner, "paper_mean": mean, "paper_sd": sd, "n": 0}
            ours: Any = self.episodes[self.episodes["planner"] == planner]
            if len(ours):
                paths, n = ours["path_m"].to_numpy(float), len(ours)
                sd_ours = float(paths.std(ddof=1)) if n > 1 else math.nan
                own: dict[str, Any] = {"n": n, "mean": float(paths.mean()), "sd": sd_ours, "ratio": paths.mean() / mean}
                own["low"], own["high"], _ = t_interval(own["mean"], own["sd"] / math.sqrt(n), n - 1)
                welch = stats.ttest_ind_from_stats(own["mean"], own["sd"], n, mean, sd, MAPS, equal_var=False)
                own |= {"p": float(welch.pvalue) if n > 1 else math.nan, "complete": int(ours["complete"].sum())}
                row |= {**own, "explored_fraction": ours["explored_fraction"].mean()}
            rows.append(row)
        return pd.DataFrame(rows)

    def to_markdown(self) -> str:
        """Format the table, with the note that goes with it."""
        head = ["planner", "paper m", "n", "ours m", "95 % interval", "ours / paper", "p", "complete", "explored"]
        lines = []
        for row in self.table.to_dict("records"):
            line = [row["planner"], tables.spread_text(row["paper_mean"], row["paper_sd"]), str(row["n"])]
            if row["n"]:
                line += [tables.spread_text(row["mean"], row["sd"]), tables.interval_text(row["low"], row["high"], 1)]
                line += [tables.number_text(row["ratio"], 3), tables.p_text(row["p"]), str(int(row["complete"]))]
                line += [tables.number_text(row["explored_fraction"], 4)]
            lines.append(line + ["-"] * (len(head) - len(line)))
        return f"# DARE, Table I\n\n{NOTE}\n\n{tables.aligned_table(head, lines, left=('planner',))}"


def reproduce_dare(
    maps: str | os.PathLike[str], *, episodes: int = MAPS, seed: int = 0, scanner: str = "dare",
    workers: int | None = None,
) -> DareResult:  # fmt: skip
    """Run the planners of Table I on DARE's test maps.

    Args:
      maps: folder of the maps.
      episodes: number of maps, from the first.
      seed: all draws come from it and from the number of the map.
      scanner: one of `rules.SCANNERS`.
      workers: processes; by default one a core that this process may use.
    """
    files = map_files(maps, episodes)
    for file in files:
        rules.read_map(file)
    workers = workers or len(os.sched_getaffinity(0))
    run = functools.partial(run_map, seed=seed, scanner=scanner)
    with concurrent.futures.ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        found = list(map(run, files) if workers == 1 else pool.map(run, files))
    return DareResult(pd.DataFrame([row for rows in found for row in rows]))
