"""Number of episodes, or worlds, that a comparison needs for an interval of a wanted width; from a smaller one.

pandas and scipy are imported by the functions that need them.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from jexplore.config import InputError, require_number
from jexplore.report.tables import aligned_table
from jexplore.studies.statistics.by_world import summarise
from jexplore.studies.statistics.league import paths_by_world
from jexplore.studies.statistics.over_worlds import ALL_WORLDS, kind_of, mean_over_worlds, moments
from jexplore.studies.statistics.paired import safe_exp

if TYPE_CHECKING:
    import pandas as pd

SIZES_COLUMNS = ("world", "strategy", "unit", "n", "within", "needed")
MOST = 10**9
"""No more are ever asked for."""


def _smallest(spread, freedom, freedom_of, *, within, confidence, assurance):
    """Return the least n with, by the assurance, `t(freedom_of(n)) spread / sqrt(n)` within `log(1 + within)`.

    The spread of n new ones is that of the pilot times the root of an F of both degrees of freedom.
    """
    from scipy.special import fdtri, stdtrit

    def is_enough(n):
        left = freedom_of(n)
        if left <= 0:
            return False
        wide = stdtrit(left, 0.5 + confidence / 2) * spread * math.sqrt(fdtri(left, freedom, assurance) / n)
        return wide <= math.log1p(within)

    high = 2
    while not is_enough(high) and high < MOST:
        high *= 2
    low = high // 2  # not enough, or 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if is_enough(middle) else (middle, high)
    return min(high, MOST)


def _checked(**shares):
    for name, value in shares.items():
        require_number(name, value, low=0.0, high=1.0, low_open=True, high_open=True)
    return shares


def sample_size(
    values: ArrayLike,
    reference: ArrayLike,
    *,
    within: float = 0.02,
    confidence: float = 0.95,
    assurance: float = 0.8,
) -> int:
    """Compute how many pairs of episodes give a ratio of means an interval of `± within`, from the pairs of a pilot.

    The interval is that of `paired_ratio`: it then ends at most at `(1 + within)` times the ratio, and at `1 / (1 +
    within)` times it. The spread of a pilot is itself uncertain, and that of the new episodes varies: the number is
    large enough that, with the `assurance`, the new interval is as narrow for a normal spread; with skewed ratios of
    paths this holds less often. `benchmarks/intervals.py --over sizes` measures how often.

    Args:
      values, reference: `[N]` path lengths of a pilot, the same starts in the same order, N >= 2.
      within: wanted half of the width, as a share of the ratio.
      confidence: of the interval.
      assurance: chance that the interval comes out as narrow; 0.5 is an even chance.

    Returns:
      The number of pairs, 2 or more; `MOST` if it takes more.

    Raises:
      InputError: not two vectors of finite numbers from 0, of one length, 2 or more, that differ; no spread in the
        pilot; a share out of range.

    Source:
      Kupper and Hafner 1989, assurance of the width of an interval; here with the uncertainty of the pilot.
    """
    how = _checked(within=within, confidence=confidence, assurance=assurance)
    values, reference = np.asarray(values, np.float64), np.asarray(reference, np.float64)
    if values.ndim != 1 or values.shape != reference.shape or len(values) < 2:
        raise InputError(
            f"values and reference must be vectors of one length, 2 or more, got {values.shape} and {reference.shape}"
        )
    if not np.isfinite([values, reference]).all() or min(values.min(), reference.min()) < 0:
        raise InputError("values and reference must be finite numbers from 0")
    if values.mean() == 0 or reference.mean() == 0:
        raise InputError("values and reference must have a path that is longer than 0")
    spread = float((values / values.mean() - reference / reference.mean()).std(ddof=1))
    equal = int((values == reference).sum())
    if spread < 1e-12:
        raise InputError("pairs must differ in their ratios: without any spread there is nothing to plan with")
    share, n = equal / len(values), len(values)
    freedom = n - max(equal, 1)
    return _smallest(spread, freedom, lambda m: m - max(share * m, 1.0), **how)


def worlds_needed(
    log_ratios: ArrayLike,
    kinds: Sequence[str],
    *,
    within: float = 0.02,
    confidence: float = 0.95,
    assurance: float = 0.8,
) -> int:
    """Compute how many worlds, of the same kinds in the same shares, give the mean ratio an interval of `± within`.

    Args:
      log_ratios: `[N]` logarithms of the ratios in a pilot's worlds, N >= 2: `league.paths_by_world`.
      kinds: `[N]`, the kind of each.
      within, confidence, assurance: as for `sample_size`.

    Returns:
      The number of worlds, with as many episodes each as in the pilot.

    Raises:
      InputError: fewer than two worlds, not finite, no spread, or a share out of range.
    """
    how = _checked(within=within, confidence=confidence, assurance=assurance)
    logs = np.asarray(log_ratios, np.float64)
    if logs.ndim != 1 or len(logs) < 2 or len(logs) != len(kinds) or not np.isfinite(logs).all():
        raise InputError(
            f"log_ratios must be two or more finite numbers, one for each of {len(kinds)} kinds, got {logs}"
        )
    _, error, freedom, most = moments(logs, kinds)
    if not error:
        raise InputError("worlds must differ in their ratios: without any spread there is nothing to plan with")
    strata = len(logs) - most
    spread = error * math.sqrt(len(logs))
    return _smallest(spread, freedom, lambda m: m - strata, **how)


def sample_sizes(
    episodes: "pd.DataFrame", *, within: float = 0.02, confidence: float = 0.95, assurance: float = 0.8
) -> "pd.DataFrame":
    """Compute the episodes in each world, and the worlds, needed to know every ratio to the first strategy `± within`.

    Args:
      episodes: the table of episodes of a pilot comparison, a pandas DataFrame.
      within, confidence, assurance: as for `sample_size`.

    Returns:
      A DataFrame with the columns `SIZES_COLUMNS`, a row a world and strategy but the first, and, with two worlds or
        more, a row a strategy for `ALL_WORLDS`: `unit`, "episodes" or "worlds"; `n` of the pilot; `within`, its present
        interval, as a share of the ratio; `needed`, <NA> where the pilot shows no spread.

    Raises:
      InputError: a share out of range, an episode that occurs twice, or paired episodes that start differently.
    """
    import pandas as pd

    how, rows = _checked(within=within, confidence=confidence, assurance=assurance), []
    now: Any = summarise(episodes, confidence=confidence)
    first = episodes["strategy"].iloc[0] if len(episodes) else None
    tables = {
        world: some.pivot(index="episode", columns="strategy", values="path_m")
        for world, some in episodes.groupby("world", sort=False)
    }
    for row in now[(now["strategy"] != first) & now["ratio"].notna()].itertuples(index=False):
        both = tables[row.world][[row.strategy, first]].dropna().to_numpy()
        half = row.ratio_high / row.ratio - 1 if row.ratio else math.nan  # zero: one that never set out
        rows.append((row.world, row.strategy, "episodes", len(both), half, _or_none(sample_size, *both.T, **how)))
    ratios: Any = paths_by_world(episodes) if len(tables) > 1 else now[:0]
    for name, own in ratios[ratios["strategy"] != first].groupby("strategy", sort=False):
        logs, kinds = own["log_ratio"].to_numpy(), [kind_of(world) for world in own["world"]]
        mean, _, high, _ = mean_over_worlds(logs, kinds, confidence=confidence)
        half = safe_exp(high - mean) - 1
        rows.append((ALL_WORLDS, name, "worlds", len(logs), half, _or_none(worlds_needed, logs, kinds, **how)))
    return pd.DataFrame(rows, columns=list(SIZES_COLUMNS)).astype({"needed": "Int64", "within": float})


def _or_none(function, *pilot, **how):
    """Return the number, or None if the pilot gives none."""
    try:
        return function(*pilot, **how)
    except InputError:
        return None


def sizes_table(table: "pd.DataFrame") -> str:
    """Format needed numbers as one aligned Markdown table.

    Args:
      table: from `sample_sizes`.
    """
    lines = []
    for row in table.to_dict("records"):
        now = f"± {100 * row['within']:.1f} %" if math.isfinite(row["within"]) else "-"
        needed = f"{row['needed']:,}" if isinstance(row["needed"], int) else "-"
        lines.append([row["world"], row["strategy"], f"{row['n']} {row['unit']}", now, needed])
    return aligned_table(["world", "strategy", "now", "interval", "needed"], lines, left=("world", "strategy"))
