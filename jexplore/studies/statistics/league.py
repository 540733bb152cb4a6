"""Strategies over many worlds: path lengths relative to a reference, and ranks."""

import math
from typing import Any

import numpy as np
import pandas as pd

from jexplore.config import require_whole
from jexplore.report.tables import aligned_table, number_text, p_text, ratio_text
from jexplore.studies.statistics.by_world import DONE
from jexplore.studies.statistics.over_worlds import (
    comparable_paths,
    kind_of,
    mean_over_worlds,
    ratio_over_worlds,
    share_over_worlds,
)
from jexplore.studies.statistics.paired import holm
from jexplore.worlds.bounds import FURNISHED_CELL_M

LEAGUE_KINDS = ("cave", "office", "hospital", "maze", "rooms")
LEAGUE_SEEDS = 8
MOST_SEEDS = 1000  # of each kind; tuning uses other ones
FURNISHED = (
    "office#{}:furniture=1,wide_openings=0.1,max_loops=5,corridor_m=2.2,corridor_sd_m=0.4,room_m=5.5",
    "hospital#{}:furniture=1,wide_openings=0.1,max_loops=5,corridor_m=2.6,corridor_sd_m=0.4,room_m=6",
    "rooms#{}:furniture=1,wide_openings=0.1,max_loops=5,room_m=3.6",
)
"""Furnished buildings, in numbers like real ones (`jexplore worlds --geometry`); the braces are for a seed."""
LEAGUE_STRATEGIES = (
    *("closest+recheck", "closest", "closest+recheck+segment", "closest+recheck+segment=auto"),
    *("small-first+recheck", "small-first", "distance-advantage+recheck", "distance-advantage+recheck:weight=0.5"),
    *("tour+recheck", "consistent-tour+recheck", "learned+recheck"),
    *("utility+recheck", "gain-rate+recheck", "revenue+recheck"),
    *("mutual-information+recheck", "exploration-transform+recheck"),
    *("decision-theoretic+recheck", "decision-theoretic", "random-tree", "nearest-region"),
    *("mcdm", "random+recheck", "random"),
)
"""Every strategy, with re-checking except where its source has none; the first is what the others are compared with."""


def league_worlds(cell_m: float = 0.1, seeds: int = LEAGUE_SEEDS, first: int = 0) -> tuple[str, ...]:
    """Return names of worlds, kind by kind: `seeds` of each generator, and of furnished buildings in fine cells.

    Those of the league begin at the seed 0.
    """
    numbers = range(first, first + require_whole("league_seeds", seeds, 1, MOST_SEEDS))
    plain = [f"{kind}#{seed}" for kind in LEAGUE_KINDS for seed in numbers]
    furnished = [FURNISHED[seed % len(FURNISHED)].format(seed) for seed in numbers]
    return (*plain, *furnished) if cell_m <= FURNISHED_CELL_M else tuple(plain)


def paths_by_world(episodes: pd.DataFrame, column: str = "path_m") -> pd.DataFrame:
    """Compute mean paths in every world of a strategy and of the first one, over the starts from which neither failed.

    Or means of another `column` that grows with the path.

    Returns:
      A DataFrame with the columns `world`, `strategy`, `mean`, `reference`, metres, and `log_ratio`, the logarithm of
        their ratio: a row for every strategy and world in which both have moved, in order of first appearance.
    """
    paths: Any = comparable_paths(episodes, column)
    tables = []
    for name in paths.columns:
        both: Any = pd.DataFrame({"mean": paths[name], "reference": paths.iloc[:, 0]})
        both = both[np.isfinite(both).all(axis=1)].groupby(level="world", sort=False).mean()
        both = both[(both > 0).all(axis=1)].reset_index()
        tables.append(both.assign(strategy=name, log_ratio=np.log(both["mean"] / both["reference"])))
    found = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    return found.reindex(columns=["world", "strategy", "mean", "reference", "log_ratio"])


def standings(episodes: pd.DataFrame) -> pd.DataFrame:
    """Tabulate one row a strategy, the best ranks first.

    An episode that has failed (see `comparable_paths`) has no short path: it ranks behind all that have not failed.

    Ranks are by path from each start, averaged over starts, then worlds; equal paths share the mean of their ranks. The
    ratio is, in every world, the mean path over that of the first strategy of the table, over the starts from which
    neither failed. Worlds count the same, whatever their size: ratios are averaged as logarithms. Intervals are by
    `mean_over_worlds`: they speak of other worlds of the same kinds in the same shares, not of other kinds. Worlds in
    which a strategy saw all from the start have no ratio.

    Returns:
      A DataFrame: `strategy`; `worlds`, in which all ran; `paired`, worlds in which there is a ratio; `ratio`,
        `ratio_low`, `ratio_high`; `p`, that of the ratio being 1, and `p_holm`, corrected for as many strategies as
        there are (`holm`); `shorter`, `shorter_low`, `shorter_high`, the share of starts with a shorter path than the
        reference's, equal ones by half (in a single world the starts are the sample); `rank`, `rank_low`, `rank_high`;
        `best`, worlds in which its mean path is no longer than any other's; `complete`, share of its episodes that
        ended COMPLETE; `failed`, share that failed; and `ratio of K` for every kind of world K.
    """
    tables: Any = comparable_paths(episodes), paths_by_world(episodes)
    paths, ratios = tables
    ranks, means = (table.groupby(level="world", sort=False).mean() for table in (paths.rank(axis=1), paths))
    kinds, rows = [kind_of(world) for world in ranks.index], []
    for i, name in enumerate(paths.columns):
        own = ratios[ratios["strategy"] == name]
        logs, of_kind = own["log_ratio"].to_numpy(), [kind_of(world) for world in own["world"]]
        found = ratio_over_worlds(logs, own["world"])
        rank, *ends, _ = mean_over_worlds(ranks[name], kinds)
        rank_low, rank_high = (min(max(end, 1.0), len(paths.columns)) for end in ends)  # NaN stays
        best = int((np.isfinite(means[name]) & (means[name] <= means.min(axis=1))).sum())
        row = {"strategy": name, "worlds": len(ranks), "paired": len(own)}
        row |= {"ratio": found.ratio, "ratio_low": found.low, "ratio_high": found.high, "p": found.p}
        shares = _shorter(paths[name], paths.iloc[:, 0]) if i else [math.nan] * 3
        row |= {"p_holm": math.nan, **dict(zip(("shorter", "shorter_low", "shorter_high"), shares))}
        row |= {"rank": rank, "rank_low": rank_low, "rank_high": rank_high, "best": best}
        ended = episodes.loc[episodes["strategy"] == name, "outcome"]
        row |= {"complete": float(ended.isin(DONE).mean()), "failed": float(np.isinf(paths[name]).mean())}
        for kind in dict.fromkeys(map(kind_of, episodes["world"].unique())):
            some = logs[[one == kind for one in of_kind]]
            row[f"ratio of {kind}"] = math.exp(some.mean()) if len(some) else math.nan
        rows.append(row)
    table = pd.DataFrame(rows)
    table["p_holm"] = holm(table["p"])
    return table.sort_values(["rank", "ratio"], kind="stable", ignore_index=True)


def _shorter(paths, reference):
    """Return the share of starts with a shorter path, equal ones by half, with its interval: `share_over_worlds`.

    Source:
      Agarwal et al. 2021, probability of improvement. Changed: paired by start, and the sample are worlds.
    """
    wins = (paths < reference) + 0.5 * (paths == reference)
    shares = wins.groupby(level="world", sort=False).mean()
    if len(shares) < 2:
        return share_over_worlds(wins, ["start"] * len(wins))[:3]
    return share_over_worlds(shares, [kind_of(world) for world in shares.index])[:3]


def _verdict(row):
    if not math.isfinite(row["p_holm"]):
        return "-"
    return "not distinguishable" if row["p_holm"] >= 0.05 else "shorter" if row["ratio"] < 1 else "longer"


def standings_table(table: pd.DataFrame) -> str:
    """Format `standings` as one aligned Markdown table. The reference differs at the 5 % level of the corrected p."""
    kinds = [name for name in table.columns if name.startswith("ratio of ")]
    kinds = kinds if len(kinds) > 1 else []
    head = ["strategy", "ratio to the reference", "p (Holm)", "", "shorter, % of starts", "mean rank"]
    head += ["best in", *(k.removeprefix("ratio of ") for k in kinds), "COMPLETE"]
    lines = []
    for row in table.to_dict("records"):
        line = [row["strategy"], ratio_text(row["ratio"], row["ratio_low"], row["ratio_high"]), p_text(row["p_holm"])]
        share = (100 * row[key] for key in ("shorter", "shorter_low", "shorter_high"))
        line += [_verdict(row), ratio_text(*share, decimals=0)]
        rank = ratio_text(row["rank"], row["rank_low"], row["rank_high"], 1)
        line += [rank, f"{row['best']} of {row['worlds']}"]
        lines.append([*line, *(number_text(row[k], 3) for k in kinds), f"{row['complete']:.0%}"])
    return aligned_table(head, lines, left=["strategy", ""])


def over_worlds_text(table: pd.DataFrame) -> str:
    """Summarise a comparison over two worlds or more, from `standings`, as Markdown, with how to read it."""
    worlds = max(table["worlds"], default=0)
    return f"""\
Over {worlds} worlds, which count the same; intervals (95 %) are for other worlds like these:

{standings_table(table)}
*shorter*: starts from which the path is shorter than the reference's, equal ones by half. *best in*: worlds without a
shorter mean path.
"""
