"""Summaries of many episodes in one number: chances of a shorter path, interquartile means.

With two worlds or more, worlds are the sample: all count the same, however many episodes they have, and intervals, of
95 %, are for other worlds of the same kinds in the same shares. In a single world the starts are.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from jexplore.config import InputError
from jexplore.studies.statistics.over_worlds import comparable_paths, kind_of, mean_over_worlds, share_over_worlds
from jexplore.studies.statistics.paired import NO_RATIO, safe_exp


class Estimate(NamedTuple):
    """A number with its interval."""

    value: float  # NaN where there is nothing to estimate from
    low: float  # interval; NaN where none can be given
    high: float
    p: float  # two-sided, of the hypothesis that nothing differs; NaN where there is no interval
    n: int  # worlds; starts where there is a single world


def _checked(values, worlds, name):
    """Check `values`: as `[N]` float64 and the `[N]` numbers of their units, and the kinds of the units."""
    values = np.asarray(values, np.float64)
    worlds = ["one"] * values.size if worlds is None else [str(world) for world in worlds]
    if values.ndim != 1 or np.isnan(values).any() or (values < 0).any():
        raise InputError(f"{name} must be a vector of numbers from 0, inf for a failure, got {values}")
    if len(worlds) != len(values):
        raise InputError(f"worlds must be as many as the {name}, {len(values)}, got {len(worlds)}")
    names = list(dict.fromkeys(worlds))
    if len(names) < 2:
        return values, np.arange(len(values)), ["start"] * len(values)
    number = {world: i for i, world in enumerate(names)}
    return values, np.array([number[world] for world in worlds]), [kind_of(world) for world in names]


def _unit_means(values, unit, kinds):
    """Average `[N, ...]` numbers of episodes over every unit: `[U, ...]`."""
    sums = np.zeros((len(kinds), *values.shape[1:]))
    np.add.at(sums, unit, values)
    return sums / np.bincount(unit, minlength=len(kinds)).reshape(-1, *[1] * (values.ndim - 1))


def improvement(values: ArrayLike, reference: ArrayLike, worlds: Iterable[object] | None = None) -> Estimate:
    """Estimate the chance that a path is shorter than the reference's from the same start; equal ones count half.

    `values` and `reference` are `[N]` path lengths of the same starts, inf for an episode that has failed; two that
    have failed are equal. `worlds` are the world of each, None for a single one. p is of the chance being 1/2. No
    interval for fewer than two worlds, or two starts in a single one.

    Source:
      Agarwal et al. 2021, probability of improvement. Changed: paired by start, and the sample are worlds.
    """
    values, unit, kinds = _checked(values, worlds, "values")
    reference, *_ = _checked(reference, worlds, "reference")
    if len(values) != len(reference):
        raise InputError(f"reference must be as many as the values, {len(values)}, got {len(reference)}")
    wins = (values < reference) + 0.5 * (values == reference)
    return Estimate(*share_over_worlds(_unit_means(wins, unit, kinds), kinds), len(kinds))


def interquartile_mean(scores: ArrayLike, worlds: Iterable[object] | None = None) -> Estimate:
    """Compute the mean of the middle half of scores, robust against a few lost or lucky episodes.

    Scores are `[N]` ratios of paths, from `scores_of`; `worlds` are as of `improvement`. Scores that lie across a
    quartile count with the part that is inside. The interval is `M exp(± t s / M)`, s the standard error over worlds of
    the scores pulled in to the quartiles, divided by the half that is kept. `benchmarks/intervals.py --over worlds`
    measures how often it covers. p is of the mean being 1. The mean is infinite if more than a quarter has failed; no
    interval then, for fewer than two worlds (starts in a single one), or without any spread.

    Source:
      Agarwal et al. 2021; the standard error of a trimmed mean by Tukey and McLaughlin 1963. Changed: worlds weigh the
      same.
    """
    scores, unit, kinds = _checked(scores, worlds, "scores")
    if not len(scores):
        return Estimate(*NO_RATIO)
    weights = 1.0 / np.bincount(unit)[unit]
    order = np.argsort(scores, kind="stable")
    ends = np.cumsum(weights[order]) / weights.sum()
    inside = np.minimum(ends, 0.75) - np.maximum(np.concatenate([[0.0], ends[:-1]]), 0.25)
    kept = inside > 1e-12
    mean = float(scores[order][kept] @ inside[kept] / inside[kept].sum())
    low, high = scores[order][np.searchsorted(ends * (1 + 1e-12), (0.25, 0.75))]
    if not (0 < mean < math.inf and high < math.inf):
        return Estimate(mean, math.nan, math.nan, math.nan, len(kinds))
    pulled = _unit_means(np.clip(scores, low, high), unit, kinds)
    logs = math.log(mean) + (pulled - pulled.mean()) / (0.5 * mean)
    _, low, high, p = mean_over_worlds(logs, kinds)
    return Estimate(mean, safe_exp(low), safe_exp(high), p, len(kinds))


def scores_of(episodes: pd.DataFrame) -> pd.DataFrame:
    """Compute path lengths over those of the first strategy, of the starts that every strategy has.

    Two paths of no length have the ratio 1. The ratio of an episode that has failed (see `comparable_paths`) is
    infinite; where the one that it is divided by has failed, it is 0, or NaN if both have.

    Returns:
      A DataFrame of ratios: a row a start, indexed by `world` and `episode`, and a column a strategy.
    """
    paths = comparable_paths(episodes)
    if not len(paths.columns):
        return paths
    by = paths.iloc[:, 0]
    nothing = (paths == 0).mul(by == 0, axis=0)
    return paths.div(by, axis=0).mask(nothing.astype(bool), 1.0)


def aggregates(episodes: pd.DataFrame) -> pd.DataFrame:
    """Tabulate one row a strategy: chance of a shorter path than the first one's, and the middle of their ratios.

    Returns:
      A DataFrame: `strategy`; `units`, worlds, or starts in a single world; `shorter`, `shorter_low`, `shorter_high`,
        `shorter_p` from `improvement`, NaN for the first strategy; `iqm`, `iqm_low`, `iqm_high` from
        `interquartile_mean` of `scores_of` without those that have none.
    """
    tables: Any = comparable_paths(episodes), scores_of(episodes)
    paths, scores = tables
    worlds, rows = paths.index.get_level_values("world"), []
    for name in paths.columns:
        *better, units = improvement(paths[name], paths.iloc[:, 0], worlds)
        if name == paths.columns[0]:
            better = [math.nan] * 4
        there = scores[name].notna().to_numpy(bool)
        middle = interquartile_mean(scores[name][there], worlds[there])
        rows.append((name, units, *better, middle.value, middle.low, middle.high))
    columns = ["strategy", "units", "shorter", "shorter_low", "shorter_high", "shorter_p", "iqm", "iqm_low", "iqm_high"]
    return pd.DataFrame(rows, columns=columns)
