"""Curves: the explored share along the path, paths over a setting, and training."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jexplore.report.plot import wrapped_text
from jexplore.report.plots.looks import FONT, GREY, curves_page, legend_below, looks_of

TRAINED, CHECKED = "#9ecae1", "#d55e00"
SPREAD, MOST_SPREAD = 0.012, 0.08
"""Strategies stand apart by this share of the axis, all of them by the second, lest their intervals hide each other."""
NUMBERS = 9
"""Up to as many values of a number have a label each."""


def quartiles(progress: Any) -> np.ndarray:
    """Compute quartiles over episodes, `[3, M]`, of the paths at which each share was known; never known counts as inf.

    `progress` is `[N, M]` metres, NaN where an episode never knew that share. Quartiles are not interpolated.
    """
    driven = np.where(np.isnan(progress), np.inf, progress)
    return np.quantile(driven, [0.25, 0.5, 0.75], axis=0, method="inverted_cdf")


def draw_progress(ax: Axes, progress: Any, look: Mapping[str, Any], *, band: float = 0.18) -> Line2D:
    """Draw the known share along the path: the median path to each share, in a band from quartile to quartile.

    The band ends at the share that a quarter of the episodes never knew. `progress` as of `quartiles`.
    """
    low, median, high = quartiles(progress)
    share = np.arange(1, len(median) + 1) * 100 / len(median)
    known = np.isfinite(high)
    ax.fill_betweenx(share[known], low[known], high[known], color=look["color"], alpha=band, linewidth=0)
    style = {"color": look["color"], "linestyle": look["linestyle"], "linewidth": 1.5}
    marked = [i for i in range(len(share) // 4 - 1, len(share), len(share) // 4) if 0 < median[i] < np.inf]
    marks = {"marker": look["marker"], "markevery": marked, "ms": 4.5, "mec": "white", "mew": 0.4}
    (line,) = ax.plot(np.where(np.isfinite(median), median, np.nan), share, **style, **marks)
    return line


def coverage_curves_figure(
    entries: Sequence[tuple[str, Mapping[str, Any]]], *, label: str = "path length (m)"
) -> Figure:
    """Draw the known part of the knowable share along the path, `(world, {strategy: progress})` a panel."""
    looks = looks_of(dict.fromkeys(name for _, known in entries for name in known))
    page, axes = curves_page([world for world, _ in entries], label, "known of what can be known (%)", sharey=True)
    for ax, (_, known) in zip(axes, entries):
        known = {name: np.asarray(progress) for name, progress in known.items() if np.size(progress)}
        driven = [part[np.isfinite(part)] for part in known.values()]
        end_m = max((float(part.max()) for part in driven if part.size), default=1.0) or 1.0
        shown = [quartiles(part)[2] for part in known.values()]
        shown = np.concatenate([part[np.isfinite(part)] for part in shown]) if shown else np.zeros(0)
        end_m = min(end_m, 1.08 * float(shown.max(initial=0.0)) or end_m)
        band = min(0.18, 0.6 / max(len(known), 1))  # bands overlap
        for name, progress in known.items():
            draw_progress(ax, progress, looks[name], band=band).set_label(name)
        ax.set(xlim=(-0.01 * end_m, end_m), ylim=(0, 101))
        if not np.any(shown > 0):
            at = {"ha": "center", "va": "center", "fontsize": FONT, "color": GREY, "transform": ax.transAxes}
            ax.text(0.5, 0.5, "all was known at the start" if shown.size else "no data", **at)
    legend_below(page)
    return page


def draw_response(ax: Axes, x: Any, estimate: Any, low: Any, high: Any, look: Mapping[str, Any]) -> Any:
    """Draw one strategy's line over a setting, with an interval at every value; a NaN has none, or breaks the line."""
    estimate, low, high = (np.asarray(part, np.float64) for part in (estimate, low, high))
    ends = np.nan_to_num(np.maximum(np.stack([estimate - low, high - estimate]), 0.0))
    style = {"ms": 4.5, "mec": "white", "mew": 0.5, "linewidth": 1.5, "elinewidth": 1.1, "capsize": 2.5}
    container = ax.errorbar(x, estimate, yerr=ends, **look, **style)
    container.lines[2][0].set_alpha(0.75)
    return container


def response_curves_figure(table: Any, setting: str, *, averaged: str) -> Figure:
    """Draw curves over a setting, a column of a table from `response.response`: a panel a world, a line a strategy.

    Text or truth values stand side by side in order of first appearance. `averaged` names the averaged settings: a line
    above the panels.
    """
    worlds, strategies, levels = (list(dict.fromkeys(table[key])) for key in ("world", "strategy", setting))
    is_number = np.asarray(table[setting]).dtype.kind in "iuf"
    place = {level: float(level) if is_number else float(i) for i, level in enumerate(levels)}
    first, last = min(place.values()), max(place.values())
    span, looks = last - first or 1.0, looks_of(strategies)
    if not is_number:
        looks = {name: {**look, "linestyle": "none"} for name, look in looks.items()}
    spread = span * min(SPREAD * (len(strategies) - 1), MOST_SPREAD)
    page, axes = curves_page(worlds, setting, "path length (m)", sharex=True)
    for ax, world in zip(axes, worlds):
        own = table[table["world"] == world]
        for name, rows in own.groupby("strategy", sort=False):
            aside = (strategies.index(name) / max(len(strategies) - 1, 1) - 0.5) * spread
            x = np.array([place[level] + aside for level in rows[setting]])
            draw_response(ax, x, rows["estimate"], rows["low"], rows["high"], looks[name]).set_label(name)
        most = float(np.nanmax(own["estimate"]))
        ends = np.minimum(own["high"].to_numpy(np.float64), 1.5 * most)
        ax.set_ylim(0.0, 1.06 * max(most, float(np.nanmax(ends)) if np.isfinite(ends).any() else 0.0) or 1.0)
        if len(levels) <= NUMBERS or not is_number:
            texts = [f"{level:.4g}" if is_number else str(level) for level in levels]
            ax.set_xticks([place[level] for level in levels], texts, parse_math=False)
        ax.set_xlim(first - 0.09 * span, last + 0.09 * span)
    legend_below(page)
    text = wrapped_text(averaged, int(12 * page.get_figwidth()), max_lines=3)
    page.suptitle(text, fontsize=FONT, color=GREY, parse_math=False)
    return page


def training_figure(curve: Any, best: int) -> Figure:
    """Draw ratios of paths to the reference's over the training rounds, in training and on the validation worlds."""
    page = Figure(figsize=(6.4, 3.6), layout="constrained")
    ax = page.add_subplot()
    rounds = curve["round"].to_numpy()
    checked = np.isfinite(curve["validation"].to_numpy())
    ax.axhline(1.0, color="0.6", lw=0.8)
    ax.plot(rounds, curve["ratio"], color=TRAINED, lw=1.2, label="in training")
    ax.plot(rounds[checked], curve["validation"][checked], color=CHECKED, marker="o", ms=3.5, label="validation worlds")
    at = curve.loc[(curve["round"] == best) & checked, "validation"]
    ax.plot([best], at.to_numpy()[:1], marker="o", ms=9, mfc="none", mec=CHECKED, ls="none", label="kept")
    ax.set(xlabel="round", ylabel="path, as a ratio to closest+recheck")
    ax.legend(frameon=False, fontsize=8)
    return page
