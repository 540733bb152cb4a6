"""Paired samples: ratios of means with intervals, and p values corrected for their number."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtr, stdtrit

UPPER = 0.5 + 0.95 / 2
"""Quantile at the upper end of all intervals, which are of 95 %."""
MIN_PAIRS = 6
"""Fewer pairs decide nothing, whatever their interval."""


class PairedRatio(NamedTuple):
    """Ratio of two means over paired episodes."""

    ratio: float  # mean(values) / mean(reference); NaN if the latter is 0
    low: float  # interval; NaN where none can be given
    high: float
    p: float  # two-sided, of the hypothesis that the ratio of the means is 1; NaN where there is no interval
    n: int  # pairs; 1 if all pairs are identical


NO_RATIO = PairedRatio(math.nan, math.nan, math.nan, math.nan, 0)


def _vector(values, name):
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 1 or values.size == 0 or not np.isfinite(values).all() or values.min() < 0:
        raise ValueError(f"expected {name} as a vector of finite numbers from 0, got shape {values.shape} of {values}")
    return values


def t_interval(estimate: float, standard_error: float, freedom: float) -> tuple[float, float, float]:
    """Compute the interval `estimate ± t standard_error`: `(low, high, p)`, p of the hypothesis that the value is 0.

    NaN where the standard error is 0 or not finite, or there are no degrees of `freedom`.
    """
    if not (math.isfinite(estimate) and 0 < standard_error < math.inf and freedom > 0):
        return math.nan, math.nan, math.nan
    half = float(stdtrit(freedom, UPPER)) * standard_error
    return estimate - half, estimate + half, 2 * float(stdtr(freedom, -abs(estimate) / standard_error))


def _standard_error(relative):
    """Return the standard error of the mean of two or more numbers about 1; rounding does not count as spread."""
    error = float(relative.std(ddof=1)) / math.sqrt(len(relative))
    return error if error > 1e-12 else 0.0


def safe_exp(value: float) -> float:
    """Compute the exponential; infinity if it is too large."""
    with np.errstate(over="ignore"):
        return float(np.exp(value))


def paired_ratio(values: ArrayLike, reference: ArrayLike) -> PairedRatio:
    """Estimate the ratio R of the means of paired samples, `[N]` numbers from 0, with an interval and a test.

    The interval is `R exp(± t s)`, where `s` is the standard error of the logarithm of R by the delta method: the
    standard deviation of `v / mean(v) - r / mean(r)` over the pairs `(v, r)`, divided by the root of their number; t is
    Student's. It is about the ratio of the means, not the mean (or geometric mean) of the ratios;
    `benchmarks/intervals.py` measures how often it covers. p tests the hypothesis R = 1, by the same t: it is below
    0.05 exactly if the 95 % interval leaves out 1. It is not corrected for many comparisons.

    Pairs of equal members carry no spread: together they count once in the degrees of freedom. Identical pairs (one
    episode repeated) count as a single pair. One pair, or pairs without any spread, have no interval and no p.

    Source:
      The delta method for a ratio of means, on the logarithm; Fieller 1954 treats the same problem.
    """
    values, reference = _vector(values, "values"), _vector(reference, "reference")
    if len(values) != len(reference):
        raise ValueError(f"expected as many values as references, got {len(values)} and {len(reference)}")
    order = np.lexsort((values, reference))
    values, reference = values[order], reference[order]
    n = 1 if np.ptp(values) == 0 == np.ptp(reference) else len(values)
    mean, mean_reference = values.mean(), reference.mean()
    ratio = float(mean / mean_reference) if mean_reference > 0 else math.nan
    has_spread = n > 1 and min(mean, mean_reference) > 0
    error = _standard_error(values / mean - reference / mean_reference) if has_spread else 0.0
    freedom = n - max(int((values == reference).sum()), 1)
    low, high, p = t_interval(math.log(ratio) if error else math.nan, error, freedom)
    return PairedRatio(ratio, safe_exp(low), safe_exp(high), p, n)


def finite_ratio(values: ArrayLike, reference: ArrayLike) -> PairedRatio:
    """Estimate `paired_ratio` of the pairs that are finite; `NO_RATIO` without any."""
    both = np.asarray([values, reference], np.float64)
    both = both[:, np.isfinite(both).all(axis=0)]
    return paired_ratio(*both) if both.size else NO_RATIO


def mean_interval(values: ArrayLike) -> tuple[float, float]:
    """Compute the interval of a mean, `mean exp(± t s)`, as in `paired_ratio`: `(low, high)` in the unit of `values`.

    s is the standard error of the logarithm of the mean, with n - 1 degrees of freedom. Never below 0; skewed as path
    lengths are. NaN for one value, or values that are all the same.
    """
    values = np.sort(_vector(values, "values"))
    mean, n = values.mean(), len(values)
    error = _standard_error(values / mean) if n > 1 and mean > 0 else 0.0
    low, high, _ = t_interval(math.log(mean) if error else math.nan, error, n - 1)
    return safe_exp(low), safe_exp(high)


def holm(p: ArrayLike) -> np.ndarray:
    """Correct p values of several hypotheses for their number: `[N]` float64. NaN stays, and does not count.

    Source:
      Holm 1979: below 0.05 wherever the chance of even one false rejection is to stay below 0.05.
    """
    p = np.asarray(p, np.float64)
    order = np.argsort(p)[: np.isfinite(p).sum()]
    found = np.full(len(p), np.nan)
    found[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)), 1.0)
    return found
