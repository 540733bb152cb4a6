"""Paired statistics of episodes: intervals, ratios, tables, and warnings about unequal coverage.

numpy at import; scipy and pandas are imported by the functions that need them (together they take a second).
"""

import dataclasses
import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from jexplore.config import InputError
from jexplore.report.tables import aligned_table, interval_text, number_text, p_text, ratio_text, spread_text

if TYPE_CHECKING:
    import pandas as pd

OUTCOMES = ("COMPLETE", "BLOCKED", "STEP_LIMIT", "PLAN_LIMIT", "STUCK")

MARKS = (0.50, 0.90, 0.95, 0.99)
"""Shares of the cells known in the end at which an episode records its path length, in the columns `MARK_COLUMNS`."""
MARK_COLUMNS = tuple(f"path_m_at_{round(100 * mark)}" for mark in MARKS)

EQUAL_SHARE = 0.95
"""Where paths are compared at equal coverage: this share of the smaller explored fraction of a pair."""

_MEANS = ("plans", "scans", "turning_rad", "explored_fraction", "exhausted", "room_entries")
SUMMARY_COLUMNS = (
    *("world", "strategy", "n", "mean", "sd", "ci_low", "ci_high", "ratio", "ratio_low", "ratio_high", "p"),
    *_MEANS,
    "outcomes",
)


@dataclasses.dataclass(frozen=True)
class PairedRatio:
    """Ratio of two means over paired episodes."""

    ratio: float  # mean(values) / mean(reference); NaN if the latter is 0
    low: float  # interval; NaN where none can be given
    high: float
    p: float  # two-sided Wilcoxon signed-rank; NaN for one pair
    n: int  # pairs


def _vector(values, name):
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 1 or values.size == 0 or not np.isfinite(values).all():
        raise ValueError(f"expected {name} as a vector of one or more finite numbers, got shape {values.shape}")
    return values


def _bca(columns, statistic, *, confidence, n_resamples, seed):
    """BCa interval of `statistic` over paired `columns`, widened where rounding would leave the estimate outside.

    BCa counts the resamples below the estimate, so statistics are rounded, to 2**-40 of it, for equal ones to tie.
    """
    from scipy import stats

    if not 0 < confidence < 1:
        raise ValueError(f"expected confidence between 0 and 1, got {confidence!r}")
    n = len(columns[0])
    estimate = float(statistic(*columns))
    quantum = 2.0 ** (math.frexp(estimate)[1] - 40)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        interval = stats.bootstrap(
            columns,
            lambda *samples, axis: np.rint(statistic(*samples, axis=axis) / quantum) * quantum,
            paired=True,
            vectorized=True,
            n_resamples=n_resamples,
            batch=max(1, 2**21 // n),
            confidence_level=confidence,
            method="BCa",
            rng=np.random.default_rng(seed),
        ).confidence_interval
    if not (math.isfinite(interval.low) and math.isfinite(interval.high)):
        return math.nan, math.nan
    return min(float(interval.low), estimate), max(float(interval.high), estimate)


def bootstrap_ci(
    values: ArrayLike, *, confidence: float = 0.95, n_resamples: int = 9999, seed: int = 0
) -> tuple[float, float]:
    """Bootstrap interval of the mean.

    BCa rather than percentile: path lengths are skewed (a random walk has a long right tail, a good strategy a hard
    floor), and BCa corrects for that to second order. Both are somewhat narrow below twenty values. The values are
    sorted first, so the interval does not depend on their order. One value has no interval: (NaN, NaN). Equal values
    `v` have (v, v).

    Args:
      values: `[N]` finite numbers, N >= 1.
      confidence: nominal coverage.
      n_resamples: bootstrap samples.
      seed: of the resampling.

    Returns:
      `(low, high)`, floats in the unit of `values`, with low <= mean <= high.

    Raises:
      ValueError: not a vector, empty, not finite, or a confidence outside (0, 1).

    Source:
      Efron 1987, "Better bootstrap confidence intervals", as in `scipy.stats.bootstrap`.
    """
    values = np.sort(_vector(values, "values"))
    if len(values) == 1:
        return math.nan, math.nan
    if values[0] == values[-1]:
        return float(values[0]), float(values[0])
    return _bca((values,), np.mean, confidence=confidence, n_resamples=n_resamples, seed=seed)


def _ratio_of_means(values, reference, axis=-1):
    return np.mean(values, axis=axis) / np.mean(reference, axis=axis)


def paired_ratio(
    values: ArrayLike, reference: ArrayLike, *, confidence: float = 0.95, n_resamples: int = 9999, seed: int = 0
) -> PairedRatio:
    """Ratio of the means of paired samples, with an interval and a test.

    The interval resamples pairs (BCa, see `bootstrap_ci`) and does not depend on their order; where every value is the
    same multiple of its reference it is that multiple twice. It is NaN for one pair, and where a resample of the
    reference has the mean 0.

    The test is Wilcoxon's signed-rank test of the differences, two-sided, with Pratt's treatment of zero differences:
    strategies often drive the very same path, and Pratt lets such pairs count as evidence for "no difference" where
    Wilcoxon's own rule drops them. Differences are rounded to 1e-12 of the largest value, so that equal differences
    tie. p is not corrected for many comparisons. All pairs equal: p = 1. One pair: p = NaN.

    Args:
      values, reference: `[N]` finite numbers, N >= 1, the same episodes in the same order.
      confidence, n_resamples, seed: of the interval.

    Returns:
      `PairedRatio`.

    Raises:
      ValueError: not vectors, lengths that differ, empty, not finite, or a confidence outside (0, 1).
    """
    values, reference = _vector(values, "values"), _vector(reference, "reference")
    if len(values) != len(reference):
        raise ValueError(f"expected as many values as references, got {len(values)} and {len(reference)}")
    order = np.lexsort((values, reference))
    values, reference = values[order], reference[order]
    n, scale = len(values), max(np.abs(values).max(), np.abs(reference).max())
    p = _signed_rank_p(np.round((values - reference) / scale, 12) if scale > 0 else np.zeros(n))
    if reference.mean() == 0:
        return PairedRatio(math.nan, math.nan, math.nan, p, n)
    ratio = float(_ratio_of_means(values, reference))
    if n == 1:
        low = high = math.nan
    elif np.abs(values - ratio * reference).max() <= 1e-12 * scale:
        low = high = ratio
    else:
        low, high = _bca(
            (values, reference), _ratio_of_means, confidence=confidence, n_resamples=n_resamples, seed=seed
        )
    return PairedRatio(ratio, low, high, p, n)


def _signed_rank_p(differences):
    if len(differences) == 1:
        return math.nan
    if not differences.any():
        return 1.0
    from scipy import stats

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return float(np.asarray(stats.wilcoxon(differences, zero_method="pratt"))[1])


def _groups(episodes):
    """`{world: {strategy: rows}}` in order of first appearance; refuses an episode that occurs twice."""
    groups = {}
    for (world, strategy), rows in episodes.groupby(["world", "strategy"], sort=False):
        twice = rows["episode"][rows["episode"].duplicated()]
        if len(twice):
            raise InputError(f"{world}, {strategy}: episode {twice.iloc[0]} must occur once, got it more than once")
        groups.setdefault(world, {})[strategy] = rows
    return groups


def _pairs(rows, reference):
    """The episodes that both tables hold, in one order; refuses pairs whose starts differ."""
    rows, reference = rows.set_index("episode"), reference.set_index("episode")
    common = rows.index.intersection(reference.index)
    rows, reference = rows.loc[common], reference.loc[common]
    for column in ("start_row", "start_col", "start_heading_deg"):
        other = rows[column].to_numpy() != reference[column].to_numpy()
        if other.any():
            name = f"{rows['world'].iloc[0]}, {rows['strategy'].iloc[0]}, episode {common[other][0]}"
            want, got = reference[column].iloc[int(other.argmax())], rows[column].iloc[int(other.argmax())]
            raise InputError(f"{name}: paired episodes must start alike, but {column} is {got}, not {want}")
    return rows, reference


def _outcomes(rows):
    counts = rows["outcome"].value_counts().to_dict()
    names = [name for name in OUTCOMES if name in counts] + sorted(set(counts) - set(OUTCOMES))
    return ", ".join(f"{name} {counts[name]}" for name in names)


def summarise(
    episodes: "pd.DataFrame", *, confidence: float = 0.95, n_resamples: int = 9999, seed: int = 0
) -> "pd.DataFrame":
    """One row a world and strategy, in order of first appearance.

    Strategies are compared with the first strategy of the table, over the episodes that both have. In its own rows,
    `ratio` is 1 and `ratio_low`, `ratio_high` and `p` are NaN; in a world without it, so is `ratio`.

    Args:
      episodes: the table of episodes, a pandas DataFrame.
      confidence, n_resamples, seed: of the bootstrap intervals.

    Returns:
      A DataFrame with the columns `SUMMARY_COLUMNS`: `n` episodes; `mean`, `sd` (divided by n - 1; NaN for one episode)
        and the interval `ci_low`, `ci_high` of the path length, metres; `ratio`, `ratio_low`, `ratio_high`, `p` from
        `paired_ratio`; the means of `plans`, `scans`, `turning_rad`, `explored_fraction`, `exhausted` and
        `room_entries` (NaN without rooms); `outcomes`, text such as "COMPLETE 98, BLOCKED 2".

    Raises:
      InputError: an episode occurs twice, or paired episodes start differently.
    """
    import pandas as pd

    bootstrap = {"confidence": confidence, "n_resamples": n_resamples, "seed": seed}
    first = episodes["strategy"].iloc[0] if len(episodes) else None
    table = []
    for world, strategies in _groups(episodes).items():
        for strategy, rows in strategies.items():
            path_m = rows["path_m"].to_numpy(dtype=np.float64)
            versus = PairedRatio(math.nan, math.nan, math.nan, math.nan, 0)
            if strategy == first:
                versus = dataclasses.replace(versus, ratio=1.0)
            elif first in strategies:
                ours, theirs = _pairs(rows, strategies[first])
                if len(ours):
                    versus = paired_ratio(ours["path_m"], theirs["path_m"], **bootstrap)
            row = (world, strategy, len(path_m), path_m.mean(), path_m.std(ddof=1) if len(path_m) > 1 else math.nan)
            row += (*bootstrap_ci(path_m, **bootstrap), versus.ratio, versus.low, versus.high, versus.p)
            means = [rows[name].astype("Float64").mean() for name in _MEANS]
            row += tuple(math.nan if pd.isna(mean) else float(mean) for mean in means)
            table.append((*row, _outcomes(rows)))
    return pd.DataFrame(table, columns=list(SUMMARY_COLUMNS))


def markdown_table(summary: Any, *, confidence: float = 0.95) -> str:
    """A summary as one aligned Markdown table.

    Args:
      summary: from `summarise`.
      confidence: that of its intervals, for the heading.

    Returns:
      Text that ends with a newline. Missing values are `-`; bars in names are escaped.
    """
    widths_m = [high - low for low, high in zip(summary["ci_low"], summary["ci_high"]) if math.isfinite(high - low)]
    decimals = 1 if widths_m and min(widths_m) >= 1 else 2
    head = ["world", "strategy", "n", "path m", f"{100 * confidence:g} % interval", "ratio to the first", "p"]
    head += ["plans", "scans", "turning rad", "explored", "exhausted", "room entries", "outcomes"]
    lines = []
    for row in summary.itertuples(index=False):
        path = spread_text(row.mean, row.sd)
        line = [row.world, row.strategy, str(row.n), path, interval_text(row.ci_low, row.ci_high, decimals)]
        line += [ratio_text(row.ratio, row.ratio_low, row.ratio_high), p_text(row.p)]
        line += [number_text(row.plans, 1), number_text(row.scans, 1), number_text(row.turning_rad, 1)]
        line += [number_text(row.explored_fraction, 3), number_text(row.exhausted, 1), number_text(row.room_entries, 1)]
        lines.append([*line, row.outcomes])
    return aligned_table(head, lines, left=("world", "strategy", "outcomes"))


def path_at_fraction(episodes: "pd.DataFrame", fraction: ArrayLike) -> np.ndarray:
    """Path length at which each episode had explored a given fraction.

    An episode records its path length at 50, 90, 95 and 99 % of the cells that *it* knew in the end, so `path_m_at_95`
    of two episodes is comparable only if they ended at the same explored fraction. Here the marks are placed at their
    share of the episode's own explored fraction, and the path length is interpolated linearly between them.

    Args:
      episodes: N rows of the table of episodes.
      fraction: `[N]` float, explored fraction asked for.

    Returns:
      `[N]` float64, metres; NaN where the fraction lies below the first mark or above the last.
    """
    explored = episodes["explored_fraction"].to_numpy(dtype=np.float64)
    share = np.divide(fraction, explored, out=np.full(len(explored), np.nan), where=explored > 0)
    marks, path_m = np.asarray(MARKS), episodes[list(MARK_COLUMNS)].to_numpy(dtype=np.float64)
    left = np.clip(np.searchsorted(marks, share, side="right") - 1, 0, len(marks) - 2)
    row = np.arange(len(explored))
    along = (share - marks[left]) / (marks[left + 1] - marks[left])
    value = path_m[row, left] + along * (path_m[row, left + 1] - path_m[row, left])
    return np.where((share >= marks[0] - 1e-9) & (share <= marks[-1] + 1e-9), value, np.nan)


def _ratio_text(values, reference, keep):
    if not keep.any():
        return "no pair to compare"
    found = paired_ratio(values[keep], reference[keep])
    return f"{ratio_text(found.ratio, found.low, found.high)} over {found.n} pair{'s' if found.n > 1 else ''}"


def _unequal(ours, theirs, tolerance):
    """What is unequal between paired episodes and the ratios at equal coverage, as text; None if nothing is."""
    fraction, fraction_ref = (rows["explored_fraction"].to_numpy(dtype=np.float64) for rows in (ours, theirs))
    ended, ended_ref = ours["outcome"].to_numpy(), theirs["outcome"].to_numpy()
    n_ended, apart = int((ended != ended_ref).sum()), np.abs(fraction - fraction_ref) > tolerance
    if not n_ended and not apart.any():
        return None
    n, said = len(ours), []
    if n_ended:
        said.append(f"outcomes differ in {n_ended} of {n} pairs ({_outcomes(ours)} against {_outcomes(theirs)})")
    if apart.any():
        means = f"mean {fraction.mean():.3f} against {fraction_ref.mean():.3f}"
        said.append(f"explored fractions differ by more than {tolerance:g} in {apart.sum()} of {n} pairs ({means})")
    everything = np.ones(n, dtype=bool)
    whole = _ratio_text(ours["path_m"].to_numpy(), theirs["path_m"].to_numpy(), everything)
    level = EQUAL_SHARE * np.minimum(fraction, fraction_ref)
    path_m, path_ref_m = path_at_fraction(ours, level), path_at_fraction(theirs, level)
    equal = _ratio_text(path_m, path_ref_m, np.isfinite(path_m) & np.isfinite(path_ref_m))
    complete = (ended == "COMPLETE") & (ended_ref == "COMPLETE") & ~apart
    at_95 = _ratio_text(ours["path_m_at_95"].to_numpy(), theirs["path_m_at_95"].to_numpy(), complete)
    return (
        f"{' and '.join(said)}; a truncated path is not a short one: path ratio {whole}; at equal coverage "
        f"({100 * EQUAL_SHARE:g} % of the smaller explored fraction of each pair) {equal}; "
        f"where both are COMPLETE and equally explored, at path_m_at_95, {at_95}"
    )


def _cut_short(episodes):
    """A line for every strategy in a world with episodes that a limit ended, or with refused steps."""
    for world, strategies in _groups(episodes).items():
        for strategy, rows in strategies.items():
            limited = int(rows["outcome"].isin(["STEP_LIMIT", "PLAN_LIMIT"]).sum())
            if limited:
                yield f"{world}: {strategy}: {limited} of {len(rows)} episodes were cut short by a limit"
            refused = int(rows["refused"].sum()) if "refused" in rows else 0
            if refused:
                yield f"{world}: {strategy}: {refused} steps were refused, into cells that proved not to be free"


def warnings_of(episodes: "pd.DataFrame", *, tolerance: float = 0.01) -> list[str]:
    """What makes the comparison with the first strategy unfair, and the ratio at equal coverage.

    Warns where the outcomes of paired episodes differ, or their explored fractions by more than `tolerance`, or where
    strategies do not have the same episodes. Two ratios then stand beside that of the whole paths. The first uses every
    pair: both paths are taken at 95 % of the smaller explored fraction, interpolated (`path_at_fraction`); pairs in
    which one episode explored less than about half of what the other did drop out. The second uses the pairs that are
    COMPLETE on both sides with equal explored fractions, at the recorded `path_m_at_95`: nothing is interpolated, but
    the pairs are selected by how they ended.

    Args:
      episodes: the table of episodes.
      tolerance: difference of explored fractions that is still equal coverage.

    Returns:
      A list of lines, one or two a world and strategy; empty if all is well.

    Raises:
      InputError: an episode occurs twice, or paired episodes start differently.
    """
    found = []
    first = episodes["strategy"].iloc[0] if len(episodes) else None
    for world, strategies in _groups(episodes).items():
        if first not in strategies:
            found.append(f"{world}: no episode of {first}, so nothing to compare with")
            continue
        reference = strategies.pop(first)
        for strategy, rows in strategies.items():
            ours, theirs = _pairs(rows, reference)
            name = f"{world}: {strategy} against {first}"
            if not len(ours) == len(rows) == len(reference):
                have = f"{len(rows)} and {len(reference)} episodes"
                found.append(f"{name}: {have} make {len(ours)} pairs; only pairs are compared")
            unequal = _unequal(ours, theirs, tolerance) if len(ours) else None
            if unequal:
                found.append(f"{name}: {unequal}")
    return found + list(_cut_short(episodes))
