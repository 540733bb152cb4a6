"""Comparisons that end when they are decided: intervals that hold at whatever number of episodes one stops.

An interval for a fixed number of episodes, looked at again and again until it leaves out 1, leaves it out by chance in
the end. A confidence sequence covers at all numbers at once.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import ndtr, stdtrit

from jexplore.config import InputError, shown
from jexplore.report.tables import aligned_table, ratio_text
from jexplore.studies.statistics.paired import PairedRatio, paired_ratio, safe_exp, spread_of

ALPHA = 0.05  # chance that some interval of a world, at some number of episodes, does not cover
TIGHT_AT = 30  # pairs, at which the sequence is tightest
NARROW = 0.02  # half of an interval of the log ratio that is narrow enough
OPEN, SHORTER, LONGER, KNOWN = "undecided", "shorter", "longer", f"known to {100 * NARROW:g} %"


def require_until(until: object) -> None:
    """Refuse all but None and "decided"."""
    if until is not None and not (isinstance(until, str) and until == "decided"):
        raise InputError(f"until must be None or 'decided', got {shown(until)}")


def boundary(n: int, alpha: float = ALPHA) -> float:
    """Return the half width of a confidence sequence at n values of standard deviation 1, times the root of n.

    Source:
      Waudby-Smith, Arbour, Sinha, Kennedy, Ramdas 2024, "Time-uniform central limit theory and asymptotic confidence
      sequences", Annals of Statistics 52(6), theorem 2.2, with the rho that is best at `TIGHT_AT`.
    """
    spread = 2 * math.log(1 / alpha)
    rho2 = n * (spread + math.log(1 + spread)) / TIGHT_AT
    return math.sqrt(2 * (rho2 + 1) / rho2 * math.log(math.sqrt(rho2 + 1) / alpha))


def anytime_ratio(values: ArrayLike, reference: ArrayLike, alpha: float = ALPHA) -> PairedRatio:
    """Estimate a ratio as `paired_ratio`, with an interval of a confidence sequence; p is NaN.

    The interval is `R exp(± b s)`, with s as there. b is the boundary in units of Student's t: the theorem is about
    many pairs, and t is to few what the normal distribution is to many.
    """
    found = paired_ratio(values, reference)
    error, freedom = spread_of(values, reference)
    if not (error > 0 < freedom):
        return found._replace(p=math.nan)
    half = float(stdtrit(freedom, ndtr(boundary(found.n, alpha)))) * error
    return found._replace(low=found.ratio * safe_exp(-half), high=found.ratio * safe_exp(half), p=math.nan)


def verdict_of(found: PairedRatio) -> str:
    """Return what an interval decides."""
    if not math.isfinite(found.low):
        return OPEN
    if found.high < 1 or found.low > 1:
        return SHORTER if found.high < 1 else LONGER
    return KNOWN if math.log(found.high / found.low) <= 2 * NARROW else OPEN


def decisions(episodes: pd.DataFrame, names: Sequence[str] | None = None) -> pd.DataFrame:
    """Tabulate the ratio of each strategy to the first in each world, with an interval that holds at any stopping.

    The intervals of a world cover together: each has its share of `ALPHA`. An episode that not every strategy has
    counts for none; `names` are the strategies, in order, by default those in the table.
    """
    rows, names = [], list(dict.fromkeys(episodes["strategy"])) if names is None else list(names)
    for world, own in episodes.groupby("world", sort=False):
        paths = own.pivot(index="episode", columns="strategy", values="path_m").reindex(columns=names).dropna()
        for name in names[1:] if len(paths) else ():
            found = anytime_ratio(paths[name], paths[names[0]], ALPHA / (len(names) - 1))
            rows.append((world, name, len(paths), *found[:3], verdict_of(found)))
    return pd.DataFrame(rows, columns=["world", "strategy", "n", "ratio", "ratio_low", "ratio_high", "verdict"])


def decided_worlds(names: Sequence[str]) -> Callable[[list[pd.DataFrame]], set[str]]:
    """Return a function of the tables made until now that names the worlds in which every strategy is decided."""

    def settled(tables: list[pd.DataFrame]) -> set[str]:
        if not tables:
            return set()
        every: Any = decisions(pd.concat(tables, ignore_index=True), names)
        wholly = every[every["verdict"] != OPEN].groupby("world").size()
        return {str(world) for world in wholly[wholly == len(names) - 1].index}

    return settled


def decisions_text(episodes: pd.DataFrame, asked: int) -> str:
    """Format `decisions` as Markdown, with the number of episodes spared; `asked`: most episodes."""
    made = len(episodes)
    lines = [
        [row["world"], row["strategy"], str(row["n"]), ratio_text(row["ratio"], row["ratio_low"], row["ratio_high"]),
         row["verdict"]]
        for row in decisions(episodes).to_dict("records")
    ]  # fmt: skip
    head = ["world", "strategy", "n", "ratio to the first", "verdict"]
    return f"""
Decided after {made} of {asked} episodes, {asked - made} spared. Intervals (95 % for each world) hold although the
number of episodes was not fixed; those above do not:

{aligned_table(head, lines, left=["world", "strategy", "verdict"])}"""
