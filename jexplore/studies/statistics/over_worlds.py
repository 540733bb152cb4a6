"""Statistics over several worlds: the worlds are the sample, and the kinds of worlds its strata."""

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import stdtr, stdtrit

from jexplore.studies.statistics.by_world import DONE, EQUAL_FRACTION, require_once
from jexplore.studies.statistics.paired import UPPER, PairedRatio, safe_exp, t_interval
from jexplore.worlds import GENERATORS

ALL_WORLDS = "all worlds"
"""Stands for a world's name where a row is about all of them."""


def kind_of(world: object) -> str:
    """Return the generator of a world's name, `furnished` if it has furniture; `maps` for a file or a user's world."""
    match = re.match(r"([A-Za-z_][\w-]*)(#\d+)?(:.*)?$", str(world))
    if match is None or match[1] not in GENERATORS:
        return "maps"
    furnished = re.search(r"[:,]furniture=(?!0*\.?0*(,|$))", match[3] or "")
    return "furnished" if furnished else match[1]


def _mean_and_error(values: np.ndarray, kinds: Sequence[str]) -> tuple[float, float, float, int]:
    """Estimate the mean of `[N]` values, N >= 1, stratified by kind: `(mean, standard error, freedom, most)`.

    The last two are the degrees of freedom of the error, by Satterthwaite 1946, 0 without any spread; and their upper
    limit. With a single value in some stratum, all count as one.
    """
    strata = [values[[one == kind for one in kinds]] for kind in dict.fromkeys(kinds)]
    if min(map(len, strata)) < 2:
        strata = [values]
    squares = [len(some) * some.var(ddof=1) / len(values) ** 2 for some in strata if len(some) > 1]
    terms = sum(square**2 / (len(some) - 1) for square, some in zip(squares, strata))
    error = math.sqrt(sum(squares))
    error = error if error > 1e-12 else 0.0  # rounding is no spread
    return float(values.mean()), error, sum(squares) ** 2 / terms if terms else 0.0, len(values) - len(strata)


def mean_over_worlds(values: ArrayLike, kinds: Sequence[str]) -> tuple[float, float, float, float]:
    """Estimate the mean over worlds drawn from several kinds, in the present shares, and its interval.

    The t interval is for other worlds of the same kinds in the same shares: how much worlds of one kind differ makes it
    wide, how much kinds differ does not. With a single world of some kind, all count as one kind.

    `values` are `[N]` finite numbers, one a world. Returns `(mean, low, high, p)`, p of the hypothesis that the mean is
    0; NaN where there is no value, or no spread.
    """
    values = np.asarray(values, np.float64)
    if not len(values):
        return math.nan, math.nan, math.nan, math.nan
    mean, error, freedom, _ = _mean_and_error(values, kinds)
    return mean, *t_interval(mean, error, freedom)


def ratio_over_worlds(log_ratios: ArrayLike, worlds: Iterable[object]) -> PairedRatio:
    """Return `mean_over_worlds` of logarithms of ratios, one a world of these names, as a ratio."""
    logs = np.asarray(log_ratios, np.float64)
    mean, low, high, p = mean_over_worlds(logs, [kind_of(world) for world in worlds])
    return PairedRatio(safe_exp(mean), safe_exp(low), safe_exp(high), p, len(logs))


def share_over_worlds(values: ArrayLike, kinds: Sequence[str]) -> tuple[float, float, float, float]:
    """Estimate the mean over worlds of a share, such as of starts with a shorter path, and its interval.

    The interval is Wilson's, of as many independent yes or no answers as have the standard error of this mean: many
    where worlds agree, few where they do not. It stays within 0 and 1 and is there even where all worlds say the same.
    `benchmarks/intervals.py --over worlds` measures how often it covers.

    `values` are `[N]` numbers from 0 to 1, one a world. Returns `(mean, low, high, p)`, p of the hypothesis that the
    mean is 1/2: below 0.05 just where the 95 % interval leaves out 1/2. The last three are NaN for fewer than two
    worlds, the mean for none.

    Source:
      Wilson 1927; the effective number, and Student's t for the normal quantile, by Korn and Graubard 1998.
    """
    values = np.asarray(values, np.float64)
    if len(values) < 2:
        return (float(values[0]) if len(values) else math.nan), math.nan, math.nan, math.nan
    mean, error, freedom, most = _mean_and_error(values, kinds)
    mean = min(max(mean, 0.0), 1.0)
    number, freedom = (mean * (1 - mean) / error**2, freedom) if error else (float(len(values)), most)
    t = float(stdtrit(freedom, UPPER))
    centre, wide = mean + t**2 / (2 * number), t * math.sqrt(mean * (1 - mean) / number + (t / number / 2) ** 2)
    low, high = ((centre + side * wide) / (1 + t**2 / number) for side in (-1, 1))
    p = 2 * float(stdtr(freedom, -abs(mean - 0.5) * 2 * math.sqrt(number)))
    return mean, min(max(low, 0.0), mean), max(min(high, 1.0), mean), p  # the mean lies between, rounding aside


def comparable_paths(episodes: pd.DataFrame, column: str = "path_m") -> pd.DataFrame:
    """Return path lengths, or another column, of the starts that every strategy has, infinite for failed episodes.

    An episode that is not COMPLETE has failed if another from the same start is, or, where none is, if it has explored
    less than another, by more than 0.01 of what can be explored.

    Returns:
      A DataFrame: a row a start, indexed by `world` and `episode`, worlds in order of first appearance, and a column a
        strategy, in that order as well.
    """
    require_once(episodes)
    strategies, order = list(dict.fromkeys(episodes["strategy"])), list(dict.fromkeys(episodes["world"]))
    table: Any = episodes
    explored, outcome, paths = (
        table.pivot(index=["world", "episode"], columns="strategy", values=name)[strategies].dropna()
        for name in ("explored_fraction", "outcome", column)
    )
    complete, less = outcome.isin(DONE), explored.lt(explored.max(axis=1) - EQUAL_FRACTION, axis=0)
    failed = ~complete & (less | complete.any(axis=1).to_numpy(bool)[:, None])
    paths = paths.mask(failed, np.inf)
    place = {world: i for i, world in enumerate(order)}
    return paths.iloc[np.argsort([place[world] for world, _ in paths.index], kind="stable")]
