"""Strategies over many worlds: how long their paths are beside a reference, and how they rank."""

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jexplore.report.tables import aligned_table, interval_text, number_text, ratio_text
from jexplore.studies.stats import bootstrap_ci

if TYPE_CHECKING:
    import pandas as pd

LEAGUE_KINDS = ("cave", "office", "hospital", "maze", "rooms")
LEAGUE_SEEDS = 8
LEAGUE_STRATEGIES = (
    *("closest+recheck", "closest", "closest+recheck+segment", "closest+recheck+segment=auto"),
    *("distance-advantage+recheck", "distance-advantage+recheck:weight=0.5", "tour+recheck"),
    *("utility+recheck", "gain-rate+recheck"),
    *("decision-theoretic+recheck", "decision-theoretic", "mcdm", "random+recheck", "random"),
)
"""Every strategy, with re-checking except where its source has none; the first is what the others are compared with."""


def league_worlds() -> tuple[str, ...]:
    """Names of the league's worlds, 8 of each kind."""
    return tuple(f"{kind}#{seed}" for kind in LEAGUE_KINDS for seed in range(LEAGUE_SEEDS))


def kind_of(world: object) -> str:
    """The generator of a world's name; the name itself of a file."""
    return re.split(r"[#:]", str(world))[0] if re.match(r"[A-Za-z_][\w-]*([#:]|$)", str(world)) else str(world)


def _over_worlds(values):
    """Mean over worlds, and its interval; NaN without any."""
    if not len(values):
        return math.nan, math.nan, math.nan
    return (float(np.mean(values)), *bootstrap_ci(values))


def standings(episodes: "pd.DataFrame") -> "pd.DataFrame":
    """One row a strategy, the shortest paths first.

    In every world a strategy's mean path is divided by that of the first strategy of the table, over the starts that
    both have. Worlds count the same, whatever their size: ratios are averaged as logarithms. Intervals (95 %, BCa)
    resample worlds, not episodes, because the question is what to expect in a world that is not among them. Ranks are
    by mean path in each world; strategies with equal means share the mean of their ranks. Worlds in which a strategy
    saw all from the start are left out.

    Args:
      episodes: the table of episodes of a comparison, a pandas DataFrame.

    Returns:
      A DataFrame: `strategy`; `worlds`, in which it ran beside the first; `ratio`, `ratio_low`, `ratio_high`; `rank`,
        `rank_low`, `rank_high`; `best`, worlds in which no other is shorter; `complete`, share of episodes that ended
        COMPLETE; and `ratio of K` for every kind of world K.
    """
    import pandas as pd
    from scipy.stats import rankdata

    strategies = list(dict.fromkeys(episodes["strategy"]))
    worlds = list(dict.fromkeys(episodes["world"]))
    paths: Any = episodes.pivot_table(index=["world", "episode"], columns="strategy", values="path_m")[strategies]
    means = paths.dropna().groupby(level="world", sort=False).mean().reindex(worlds).dropna()
    means = means[(means > 0).all(axis=1)]  # where someone saw all from the start there is no ratio
    ratios = means.div(means[strategies[0]], axis=0)
    ranks = pd.DataFrame(rankdata(means.to_numpy(), axis=1, method="average"), index=means.index, columns=means.columns)
    kinds = [kind_of(world) for world in means.index]
    complete: Any = (episodes["outcome"] == "COMPLETE").groupby(episodes["strategy"]).mean()
    rows = []
    for name in strategies:
        logs = np.log(ratios[name].to_numpy())
        row = dict(zip(("ratio", "ratio_low", "ratio_high"), np.exp(_over_worlds(logs)).tolist()))
        row |= dict(zip(("rank", "rank_low", "rank_high"), _over_worlds(ranks[name].to_numpy())))
        if name == strategies[0]:
            row |= {"ratio_low": math.nan, "ratio_high": math.nan}
        best = int((means[name] <= means.min(axis=1)).sum())
        row = {"strategy": name, "worlds": len(means), **row, "best": best, "complete": float(complete[name])}
        for kind in dict.fromkeys(kinds):
            row[f"ratio of {kind}"] = float(np.exp(logs[[k == kind for k in kinds]].mean()))
        rows.append(row)
    return pd.DataFrame(rows).sort_values("ratio", kind="stable", ignore_index=True)


def standings_table(table: "pd.DataFrame", plan_ms: Mapping[str, float] | None = None) -> str:
    """Standings as one aligned Markdown table.

    Args:
      table: from `standings`.
      plan_ms: `{strategy: milliseconds a plan}`, or None.
    """
    kinds = [name for name in table.columns if name.startswith("ratio of ")]
    head = ["strategy", "ratio to the reference", "mean rank", "best in", *(k.removeprefix("ratio of ") for k in kinds)]
    head += ["COMPLETE"] + (["ms a plan"] if plan_ms else [])
    lines = []
    for row in table.to_dict("records"):
        rank = f"{row['rank']:.1f} {interval_text(row['rank_low'], row['rank_high'], 1)}"
        line = [row["strategy"], ratio_text(row["ratio"], row["ratio_low"], row["ratio_high"]), rank]
        line += [
            f"{row['best']} of {row['worlds']}",
            *(number_text(row[k], 3) for k in kinds),
            f"{row['complete']:.0%}",
        ]
        lines.append(line + ([number_text(plan_ms.get(row["strategy"], math.nan), 2)] if plan_ms else []))
    return aligned_table(head, lines, left=["strategy"])
