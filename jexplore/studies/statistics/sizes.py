"""Number of episodes, or worlds, that a comparison needs for an interval of a wanted width; from a smaller one."""

import bisect
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import fdtri, stdtrit

from jexplore.config import InputError, require_number
from jexplore.studies.statistics.by_world import summarise
from jexplore.studies.statistics.league import paths_by_world
from jexplore.studies.statistics.over_worlds import ALL_WORLDS, kind_of, mean_and_error, mean_over_worlds
from jexplore.studies.statistics.paired import UPPER, safe_exp

SIZES_COLUMNS = ("world", "strategy", "unit", "n", "within", "needed")
MAX_NEEDED = 10**9
"""No more are ever asked for."""


def _smallest(spread, freedom, freedom_of, *, within, assurance):
    """Return the least n with, by the assurance, `t(freedom_of(n)) spread / sqrt(n)` within `log(1 + within)`.

    The spread of n new ones is that of the pilot times the root of an F of both degrees of freedom.
    """

    def is_enough(n):
        left = freedom_of(n)
        if left <= 0:
            return False
        wide = stdtrit(left, UPPER) * spread * math.sqrt(fdtri(left, freedom, assurance) / n)
        return wide <= math.log1p(within)

    return bisect.bisect_left(range(MAX_NEEDED), True, lo=2, key=is_enough)


def _checked(**shares):
    for name, value in shares.items():
        require_number(name, value, low=0.0, high=1.0, low_open=True, high_open=True)
    return shares


def sample_size(values: ArrayLike, reference: ArrayLike, *, within: float = 0.02, assurance: float = 0.8) -> int:
    """Compute how many pairs of episodes give a ratio of means an interval of `± within`, from the pairs of a pilot.

    The interval is that of `paired_ratio`: it then ends at most at `(1 + within)` times the ratio, and at `1 / (1 +
    within)` times it. The spread of a pilot is itself uncertain, and that of the new episodes varies: the number is
    large enough that, with the `assurance`, the new interval is as narrow for a normal spread; with skewed ratios of
    paths this holds less often. `benchmarks/intervals.py --over sizes` measures how often. Returns 2 or more;
    `MAX_NEEDED` if it takes more.

    Source:
      Kupper and Hafner 1989, assurance of the width of an interval; here with the uncertainty of the pilot.
    """
    how = _checked(within=within, assurance=assurance)
    values, reference = np.asarray(values, np.float64), np.asarray(reference, np.float64)
    if values.ndim != 1 or values.shape != reference.shape or len(values) < 2:
        raise InputError(f"expected two vectors of one length, 2 or more, got {values.shape} and {reference.shape}")
    if not np.isfinite([values, reference]).all() or min(values.min(), reference.min()) < 0:
        raise InputError("values and reference must be finite numbers from 0")
    if not (values.any() and reference.any()):
        raise InputError("values and reference must have a path that is longer than 0")
    spread, n = float((values / values.mean() - reference / reference.mean()).std(ddof=1)), len(values)
    equal = int((values == reference).sum())
    if spread < 1e-12:
        raise InputError("pairs must differ in their ratios: without any spread there is nothing to plan with")
    return _smallest(spread, n - max(equal, 1), lambda m: m - max(equal / n * m, 1.0), **how)


def worlds_needed(log_ratios: ArrayLike, kinds: Sequence[str], *, within: float = 0.02, assurance: float = 0.8) -> int:
    """Compute how many worlds, of the same kinds in the same shares, give the mean ratio an interval of `± within`.

    They have as many episodes each as in the pilot, whose worlds have these `[N]` logarithms of ratios, N >= 2, from
    `league.paths_by_world`. `within` and `assurance` are as for `sample_size`.
    """
    how = _checked(within=within, assurance=assurance)
    logs = np.asarray(log_ratios, np.float64)
    if logs.ndim != 1 or len(logs) < 2 or len(logs) != len(kinds) or not np.isfinite(logs).all():
        raise InputError(f"log_ratios must be finite, two or more, one for each of {len(kinds)} kinds, got {logs}")
    _, error, freedom, most = mean_and_error(logs, kinds)
    if not error:
        raise InputError("worlds must differ in their ratios: without any spread there is nothing to plan with")
    return _smallest(error * math.sqrt(len(logs)), freedom, lambda m: m - (len(logs) - most), **how)


def sample_sizes(episodes: pd.DataFrame, *, within: float = 0.02, assurance: float = 0.8) -> pd.DataFrame:
    """Compute the episodes in each world, and the worlds, needed to know every ratio to the first strategy `± within`.

    Returns:
      A DataFrame with the columns `SIZES_COLUMNS`, a row a world and strategy but the first, and, with two worlds or
        more, a row a strategy for `ALL_WORLDS`: `unit`, "episodes" or "worlds"; `n` of the pilot; `within`, its present
        interval, as a share of the ratio; `needed`, <NA> where the pilot shows no spread.
    """
    how, rows = _checked(within=within, assurance=assurance), []
    now: Any = summarise(episodes)
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
        mean, _, high, _ = mean_over_worlds(logs, kinds)
        half = safe_exp(high - mean) - 1
        rows.append((ALL_WORLDS, name, "worlds", len(logs), half, _or_none(worlds_needed, logs, kinds, **how)))
    return pd.DataFrame(rows, columns=list(SIZES_COLUMNS)).astype({"needed": "Int64", "within": float})


def _or_none(function, *pilot, **how):
    """Return the number, or None if the pilot gives none."""
    try:
        return function(*pilot, **how)
    except InputError:
        return None
