"""Episodes of a comparison as a table: means, paired ratios, and warnings about unequal coverage."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from jexplore.config import InputError
from jexplore.report.tables import aligned_table, interval_text, number_text, p_text, ratio_text, spread_text
from jexplore.studies.results.columns import MEANS, SUMMARY_COLUMNS
from jexplore.studies.statistics.paired import NO_RATIO, finite_ratio, holm, mean_interval

DONE = "COMPLETE", "EXPLORED"
LIMITS = "STEP_LIMIT", "PLAN_LIMIT", "PATH_LIMIT", "TIME_LIMIT"
OUTCOMES = *DONE, "BLOCKED", *LIMITS, "STUCK"
PLAN_LIMITS = {
    "saturated": "some cells were too far to plan to",
    "overflow": "a plan had to leave out some frontier clusters, mixed cells, Voronoi nodes or critical points",
}
"""Column that counts plans that met a limit of what they can express or have room for -> the limit."""

EQUAL_SHARE = 0.95
"""Share of the less thorough episode's known cells at which a pair is compared (equal coverage)."""

EQUAL_FRACTION = 0.01
"""Explored fractions that differ by no more are equal."""

_SAME = ("start_row", "start_col", "start_heading_deg", "path_m", "turning_rad", "scans", "plans", "outcome")


def require_once(episodes: pd.DataFrame) -> None:
    """Refuse an episode of a strategy in a world that occurs twice."""
    twice = episodes.duplicated(["world", "strategy", "episode"]).to_numpy()
    if twice.any():
        world, strategy, number = episodes.loc[twice, ["world", "strategy", "episode"]].iloc[0]
        raise InputError(f"{world}, {strategy}: episode {number} must occur once; choose one setting first")


def _groups(episodes) -> dict[str, dict[str, Any]]:
    """Group rows by `{world: {strategy: rows}}` in order of first appearance."""
    require_once(episodes)
    worlds: Any = episodes.groupby("world", sort=False)
    return {world: dict(iter(own.groupby("strategy", sort=False))) for world, own in worlds}


def _pairs(rows, reference):
    """Return the episodes that both tables hold, in one order; refuse pairs whose starts differ."""
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


def _n_different(rows):
    """Count the episodes of one strategy in one world; 1 if they are one episode repeated."""
    return 1 if len(rows) and all(rows[name].nunique() == 1 for name in _SAME) else len(rows)


def summarise(episodes: pd.DataFrame, metrics: Sequence[str] = ()) -> pd.DataFrame:
    """Tabulate one row a world and strategy, in order of first appearance.

    Strategies are compared with the first strategy of the table, over the episodes that both have. In its own rows,
    `ratio` is 1 and `ratio_low`, `ratio_high` and `p` are NaN; in a world without it, so is `ratio`.

    Returns:
      A DataFrame with the columns `SUMMARY_COLUMNS`, then `metrics`: `n` episodes, 1 where one is repeated; `mean`,
        `sd` (divided by n - 1; NaN for one episode) and the interval `ci_low`, `ci_high` of the path length, metres,
        from `mean_interval`; `ratio`, `ratio_low`, `ratio_high`, `p` from `paired_ratio`; `p_holm`, that p corrected
        for as many strategies as are compared in the world (`holm`); the means of `columns.MEANS`; `outcomes`, text
        such as "COMPLETE 98, BLOCKED 2"; means of the metrics.
    """
    first = episodes["strategy"].iloc[0] if len(episodes) else None
    table = []
    for world, strategies in _groups(episodes).items():
        for strategy, rows in strategies.items():
            path_m = rows["path_m"].to_numpy(dtype=np.float64)
            versus = NO_RATIO._replace(ratio=1.0) if strategy == first else NO_RATIO
            if strategy != first and first in strategies:
                versus = finite_ratio(*(own["path_m"] for own in _pairs(rows, strategies[first])))
            n = _n_different(rows)
            row = (world, strategy, n, path_m.mean(), path_m.std(ddof=1) if n > 1 else math.nan)
            row += (*mean_interval(path_m), versus.ratio, versus.low, versus.high, versus.p)
            means = [rows[name].astype("Float64").mean() for name in (*MEANS, *metrics)]
            means = [math.nan if pd.isna(mean) else float(mean) for mean in means]
            means.insert(len(MEANS), _outcomes(rows))
            table.append((*row, math.nan, *means))
    found = pd.DataFrame(table, columns=[*SUMMARY_COLUMNS, *metrics])
    for places in found.groupby("world", sort=False).indices.values():
        found.loc[places, "p_holm"] = holm(found["p"].iloc[places])
    return found


def markdown_table(summary: Any) -> str:
    """Format a summary from `summarise` as one Markdown table; missing values are `-`."""
    widths_m = [high - low for low, high in zip(summary["ci_low"], summary["ci_high"]) if math.isfinite(high - low)]
    decimals = 1 if widths_m and min(widths_m) >= 1 else 2
    head = ["world", "strategy", "n", "path m", "95 % interval", "ratio to the first", "p (Holm)"]
    head += ["plans", "scans", "turning rad", "time s", "energy kJ", "explored", "exhausted", "room entries"]
    metrics = [name for name in summary if name not in SUMMARY_COLUMNS]
    lines = []
    for row in summary.itertuples(index=False):
        path = spread_text(row.mean, row.sd)
        line = [row.world, row.strategy, str(row.n), path, interval_text(row.ci_low, row.ci_high, decimals)]
        line += [ratio_text(row.ratio, row.ratio_low, row.ratio_high), p_text(row.p_holm)]
        line += [number_text(row.plans, 1), number_text(row.scans, 1), number_text(row.turning_rad, 1)]
        line += [number_text(row.time_s, 0), number_text(row.energy_j / 1000, 1)]
        line += [number_text(row.explored_fraction, 3), number_text(row.exhausted, 1), number_text(row.room_entries, 1)]
        line += [f"{getattr(row, name):.4g}".replace("nan", "-") for name in metrics]
        lines.append([*line, row.outcomes])
    return aligned_table([*head, *metrics, "outcomes"], lines, left=("world", "strategy", "outcomes"))


def path_at_equal_coverage(progress: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute path lengths of paired episodes at which both knew equally many cells: two of `[N]` float64, metres.

    Of each pair the one that knew less in the end sets the mark: the last one up to `EQUAL_SHARE` of its own. Paths are
    those that the robots had driven when they first knew as much: recorded, not interpolated; NaN without a mark. The
    arguments are `[N, 100]`, metres: path at each per cent of what can be known, NaN where that was never known.
    """
    marks = np.minimum(*(np.isfinite(metres).sum(axis=1) for metres in (progress, reference)))
    mark = np.floor(EQUAL_SHARE * marks + 1e-9).astype(int) - 1
    row = np.arange(len(mark))
    ours, theirs = (np.where(mark >= 0, metres[row, mark], np.nan) for metres in (progress, reference))
    return ours, theirs


def _ratio_text(values, reference):
    found = finite_ratio(values, reference)
    if not found.n:
        return "no pair to compare"
    if not math.isfinite(found.ratio):
        return "none, for the reference did not move"
    return f"{ratio_text(found.ratio, found.low, found.high)} over {found.n} pair{'s' if found.n > 1 else ''}"


def _unequal(ours, theirs, progress):
    """Describe differences of paired episodes and the ratios at equal coverage, as text; None without any."""
    fraction, fraction_ref = (rows["explored_fraction"].to_numpy(dtype=np.float64) for rows in (ours, theirs))
    ended, ended_ref = ours["outcome"].to_numpy(), theirs["outcome"].to_numpy()
    n_ended, apart = int((ended != ended_ref).sum()), np.abs(fraction - fraction_ref) > EQUAL_FRACTION
    if not n_ended and not apart.any():
        return None
    n, said = len(ours), []
    if n_ended:
        said.append(f"outcomes differ in {n_ended} of {n} pairs ({_outcomes(ours)} against {_outcomes(theirs)})")
    if apart.any():
        means = f"mean {fraction.mean():.3f} against {fraction_ref.mean():.3f}"
        said.append(
            f"explored fractions differ by more than {EQUAL_FRACTION:g} in {apart.sum()} of {n} pairs ({means})"
        )
    whole = _ratio_text(ours["path_m"], theirs["path_m"])
    text = f"{' and '.join(said)}; a truncated path is not a short one: path ratio {whole}; "
    if progress is not None:
        equal = _ratio_text(*path_at_equal_coverage(*progress))
        text += f"at equal coverage ({100 * EQUAL_SHARE:g} % of what the less thorough one of each pair knew) {equal}; "
    complete = (ended == ended_ref) & np.isin(ended, DONE) & ~apart
    at_95 = _ratio_text(*(rows["path_m_at_95"][complete] for rows in (ours, theirs)))
    return f"{text}where both are COMPLETE and equally explored, at path_m_at_95, {at_95}"


def _flaws(episodes):
    """Yield lines on strategies with episodes that a limit ended, with refused steps or targets, or one repeated."""
    groups = [(f"{world}: {name}", rows) for world, own in _groups(episodes).items() for name, rows in own.items()]
    for who, rows in groups:
        if limited := int(rows["outcome"].isin(LIMITS).sum()):
            yield f"{who}: {limited} of {len(rows)} episodes were cut short by a limit"
        if refused := int(rows["refused"].sum()) if "refused" in rows else 0:
            yield f"{who}: {refused} steps were refused, into cells that proved not to be free"
    for who, rows in groups:
        if _n_different(rows) < len(rows):
            yield f"{who}: all {len(rows)} episodes are the same one, which counts once"
    for who, rows in groups:
        for column, what in PLAN_LIMITS.items():
            if count := int((rows[column] > 0).sum()) if column in rows else 0:
                yield f"{who}: in {count} of {len(rows)} episodes {what}"
        if refused := int((rows["outcome"] == "BAD_TARGET").sum()):
            what = "ended because the strategy chose a target that no path leads to, three times in a row"
            yield f"{who}: {refused} of {len(rows)} episodes {what}"


def warnings_of(episodes: pd.DataFrame, progress: Mapping[tuple[str, str], np.ndarray] | None = None) -> list[str]:
    """Describe what makes the comparison with the first strategy unfair, and the ratio at equal coverage.

    Warns where the outcomes of paired episodes differ, or their explored fractions by more than `EQUAL_FRACTION`, or
    where strategies do not have the same episodes. Two ratios are then given in addition to that of the whole paths: at
    equal coverage (`path_at_equal_coverage`), where `progress` is given, over all pairs with a mark; and over the pairs
    that are COMPLETE on both sides with equal explored fractions, at the recorded `path_m_at_95`: pairs that are
    selected by how they ended. Warns also where the episodes of a strategy are one episode repeated.

    `progress` is (world, strategy) -> `[N, 100]`, as in `path_at_equal_coverage`, in the order of the table's rows.
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
            both = None
            if progress:
                both = [
                    progress[world, key][of.set_index("episode").index.get_indexer(some.index)]
                    for of, some, key in ((rows, ours, strategy), (reference, theirs, str(first)))
                ]
            unequal = _unequal(ours, theirs, both) if len(ours) else None
            if unequal:
                found.append(f"{name}: {unequal}")
    return [*found, *_flaws(episodes)]
