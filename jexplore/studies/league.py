"""Strategies over many worlds: how long their paths are beside a reference, and how they rank."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from jexplore.report.tables import aligned_table, interval_text, number_text, p_text, ratio_text
from jexplore.studies.stats import TOLERANCE, t_interval
from jexplore.worlds import GENERATORS
from jexplore.worlds.generators.variants import FURNISHED_CELL_M

if TYPE_CHECKING:
    import pandas as pd

LEAGUE_KINDS = ("cave", "office", "hospital", "maze", "rooms")
LEAGUE_SEEDS = 8
FURNISHED = (
    "office#{}:furniture=1,wide_openings=0.1,max_loops=5,corridor_m=2.2,corridor_sd_m=0.4,room_m=5.5",
    "hospital#{}:furniture=1,wide_openings=0.1,max_loops=5,corridor_m=2.6,corridor_sd_m=0.4,room_m=6",
    "rooms#{}:furniture=1,wide_openings=0.1,max_loops=5,room_m=3.6",
)
"""Furnished buildings, in numbers like real ones (`jexplore worlds --geometry`); the braces are for a seed."""
STANDINGS = (
    *("strategy", "worlds", "paired", "ratio", "ratio_low", "ratio_high", "p", "rank", "rank_low", "rank_high"),
    *("best", "complete", "failed"),
)
"""Columns of a table of standings, before those of single kinds of worlds."""
LEAGUE_STRATEGIES = (
    *("closest+recheck", "closest", "closest+recheck+segment", "closest+recheck+segment=auto"),
    *("distance-advantage+recheck", "distance-advantage+recheck:weight=0.5", "tour+recheck"),
    *("utility+recheck", "gain-rate+recheck"),
    *("decision-theoretic+recheck", "decision-theoretic", "mcdm", "random+recheck", "random"),
)
"""Every strategy, with re-checking except where its source has none; the first is what the others are compared with."""


def league_worlds(cell_m: float = 0.1) -> tuple[str, ...]:
    """Names of the league's worlds, 8 of each kind: those of the generators, and, in cells up to `FURNISHED_CELL_M`,
    furnished buildings.
    """
    plain = [f"{kind}#{seed}" for kind in LEAGUE_KINDS for seed in range(LEAGUE_SEEDS)]
    furnished = [FURNISHED[seed % len(FURNISHED)].format(seed) for seed in range(LEAGUE_SEEDS)]
    return (*plain, *furnished) if cell_m <= FURNISHED_CELL_M else tuple(plain)


def kind_of(world: object) -> str:
    """The generator of a world's name, `furnished` if it has furniture; `maps` for a file or a world of one's own."""
    match = re.match(r"([A-Za-z_][\w-]*)(#\d+)?(:.*)?$", str(world))
    if match is None or match[1] not in GENERATORS:
        return "maps"
    furnished = re.search(r"[:,]furniture=(?!0*\.?0*(,|$))", match[3] or "")
    return "furnished" if furnished else match[1]


def mean_over_worlds(values: ArrayLike, kinds: Sequence[str]) -> tuple[float, float, float, float]:
    """Mean over worlds drawn from several kinds, in the shares that the kinds have here, and its interval.

    The interval (95 %, t) is for other worlds of the same kinds in the same shares: how much worlds of one kind differ
    makes it wide, how much kinds differ does not. With a single world of some kind, all count as one kind.

    Args:
      values: `[N]` float, one a world.
      kinds: `[N]`, the kind of each world.

    Returns:
      `(mean, low, high, p)`, p of the hypothesis that the mean is 0; NaN where there is no value, or no spread.

    Source:
      The stratified mean; degrees of freedom by Satterthwaite 1946.
    """
    values = np.asarray(values, np.float64)
    if not len(values):
        return math.nan, math.nan, math.nan, math.nan
    strata = [values[[one == kind for one in kinds]] for kind in dict.fromkeys(kinds)]
    if min(map(len, strata)) < 2:
        strata = [values]
    squares = [len(some) * some.var(ddof=1) / len(values) ** 2 for some in strata if len(some) > 1]
    terms = sum(square**2 / (len(some) - 1) for square, some in zip(squares, strata))
    mean = float(values.mean())
    return mean, *t_interval(mean, math.sqrt(sum(squares)), sum(squares) ** 2 / terms if terms else 0.0)


def holm(p: ArrayLike) -> np.ndarray:
    """p values of several hypotheses, corrected for their number: `[N]` float64. NaN stays, and does not count.

    Source:
      Holm 1979: below 0.05 wherever the chance of even one false rejection is to stay below 0.05.
    """
    p = np.asarray(p, np.float64)
    order = np.argsort(p)[: np.isfinite(p).sum()]
    found = np.full(len(p), np.nan)
    found[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)), 1.0)
    return found


def _table_of(episodes, value, strategies):
    """One value of the episodes that every strategy has: rows (world, episode), columns strategies."""
    table: Any = episodes.pivot(index=["world", "episode"], columns="strategy", values=value)
    return table[strategies].dropna()


def standings(episodes: "pd.DataFrame") -> "pd.DataFrame":
    """One row a strategy, the best ranks first.

    An episode that is not COMPLETE has failed if another from the same start is, or, where none is, if it has explored
    less than another, by more than 0.01 of what can be explored: its path is no short one. It ranks behind all that
    have not failed.

    Ranks are by path from each start, averaged over starts, then worlds; equal paths share the mean of their ranks. The
    ratio is, in every world, the mean path over that of the first strategy of the table, over the starts from which
    neither failed. Worlds count the same, whatever their size: ratios are averaged as logarithms. Intervals are by
    `mean_over_worlds`: they speak of other worlds of the same kinds in the same shares, not of other kinds. `p` is that
    of the ratio being 1, corrected for as many strategies as there are (`holm`). Worlds in which a strategy saw all
    from the start have no ratio.

    Args:
      episodes: the table of episodes of a comparison, a pandas DataFrame.

    Returns:
      A DataFrame: `strategy`; `worlds`, in which all ran; `paired`, worlds in which there is a ratio; `ratio`,
        `ratio_low`, `ratio_high`, `p`; `rank`, `rank_low`, `rank_high`; `best`, worlds in which its mean path is no
        longer than any other's; `complete`, share of its episodes that ended COMPLETE; `failed`, share that failed; and
        `ratio of K` for every kind of world K.
    """
    import pandas as pd

    strategies = list(dict.fromkeys(episodes["strategy"]))
    paths = _table_of(episodes, "path_m", strategies)
    explored, outcome = (_table_of(episodes, name, strategies) for name in ("explored_fraction", "outcome"))
    order = list(dict.fromkeys(episodes["world"]))
    complete, less = outcome == "COMPLETE", explored.lt(explored.max(axis=1) - TOLERANCE, axis=0)
    failed = ~complete & (less | complete.any(axis=1).to_numpy(bool)[:, None])
    ranks = paths.mask(failed, np.inf).rank(axis=1).groupby(level="world").mean().reindex(order).dropna()
    means = paths.mask(failed, np.inf).groupby(level="world").mean().reindex(order).dropna()
    rows = []
    for name in strategies:
        pairs = ~failed[name] & ~failed[strategies[0]]
        both = paths.loc[pairs, [strategies[0]]].assign(own=paths.loc[pairs, name])
        both = both.groupby(level="world").mean().reindex(order).dropna()
        both = both[(both > 0).all(axis=1)]
        logs, kinds = np.log((both["own"] / both[strategies[0]]).to_numpy()), [kind_of(world) for world in both.index]
        log_ratio, low, high, p = mean_over_worlds(logs, kinds)
        rank, *ends, _ = mean_over_worlds(ranks[name], [kind_of(world) for world in ranks.index])
        rank_low, rank_high = (min(max(end, 1.0), len(strategies)) for end in ends)  # NaN stays
        best = int((np.isfinite(means[name]) & (means[name] <= means.min(axis=1))).sum())
        row = {"strategy": name, "worlds": len(ranks), "paired": len(both)}
        row |= {"ratio": math.exp(log_ratio), "ratio_low": math.exp(low), "ratio_high": math.exp(high), "p": p}
        row |= {"rank": rank, "rank_low": rank_low, "rank_high": rank_high, "best": best}
        row |= {
            "complete": float((episodes.loc[episodes["strategy"] == name, "outcome"] == "COMPLETE").mean()),
            "failed": float(failed[name].mean()),
        }
        for kind in dict.fromkeys(map(kind_of, order)):
            of_kind = logs[[one == kind for one in kinds]]
            row[f"ratio of {kind}"] = float(np.exp(of_kind.mean())) if len(of_kind) else math.nan
        rows.append(row)
    table = pd.DataFrame(rows, columns=list(rows[0]) if rows else list(STANDINGS))
    table["p"] = holm(table["p"])
    return table.sort_values(["rank", "ratio"], kind="stable", ignore_index=True)


def _verdict(row):
    if not math.isfinite(row["p"]):
        return "-"
    return "not distinguishable" if row["p"] >= 0.05 else "shorter" if row["ratio"] < 1 else "longer"


def standings_table(table: "pd.DataFrame", plan_ms: Mapping[str, float] | None = None) -> str:
    """Standings as one aligned Markdown table. The reference is told from at the 5 % level of the corrected p.

    Args:
      table: from `standings`.
      plan_ms: `{strategy: milliseconds a plan}`, or None.
    """
    kinds = [name for name in table.columns if name.startswith("ratio of ")]
    kinds = kinds if len(kinds) > 1 else []
    head = ["strategy", "ratio to the reference", "p", "", "mean rank", "best in"]
    head += [*(k.removeprefix("ratio of ") for k in kinds), "COMPLETE"] + (["ms a plan"] if plan_ms else [])
    lines = []
    for row in table.to_dict("records"):
        rank = [number_text(row["rank"], 1), interval_text(row["rank_low"], row["rank_high"], 1)]
        line = [row["strategy"], ratio_text(row["ratio"], row["ratio_low"], row["ratio_high"]), p_text(row["p"])]
        line += [
            _verdict(row),
            " ".join(part for part in rank if part != "-") or "-",
            f"{row['best']} of {row['worlds']}",
        ]
        line += [*(number_text(row[k], 3) for k in kinds), f"{row['complete']:.0%}"]
        lines.append(line + ([number_text(plan_ms.get(row["strategy"], math.nan), 2)] if plan_ms else []))
    return aligned_table(head, lines, left=["strategy", ""])
