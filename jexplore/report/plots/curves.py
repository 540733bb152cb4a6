"""Curves: the explored share along the path, and training."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jexplore.report.plot import wrapped_text
from jexplore.report.plots.looks import (
    FONT,
    GREY,
    band_of,
    legend_below,
    looks_of,
    panels,
    panels_page,
    plain_axes,
)

TRAINED, CHECKED = "#9ecae1", "#d55e00"


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
    strategies = list(dict.fromkeys(name for _, known in entries for name in known))
    looks, lines = looks_of(strategies), {}
    page, n_cols = panels_page(len(entries))
    for number, ax, lowest in panels(page, len(entries), n_cols, sharey=True):
        world, known = entries[number]
        driven = [part[np.isfinite(part)] for part in map(np.asarray, known.values())]
        end_m = max((float(part.max()) for part in driven if part.size), default=1.0) or 1.0
        shown = [quartiles(part)[2] for part in known.values() if np.size(part)]
        shown = np.concatenate([part[np.isfinite(part)] for part in shown]) if shown else np.zeros(0)
        end_m = min(end_m, 1.08 * float(shown.max(initial=0.0)) or end_m)
        for name, progress in known.items():
            if np.size(progress):
                lines[name] = draw_progress(ax, progress, looks[name], band=band_of(len(known)))
        ax.set(xlim=(-0.01 * end_m, end_m), ylim=(0, 101))
        if not np.any(shown > 0):
            at = {"ha": "center", "va": "center", "fontsize": FONT, "color": GREY, "transform": ax.transAxes}
            ax.text(0.5, 0.5, "all was known at the start" if shown.size else "no data", **at)
        ax.set_title(wrapped_text(world, 44, max_lines=2), fontsize=9)
        ax.set_xlabel(label if lowest else "")
        ax.set_ylabel("known of what can be known (%)" if number % n_cols == 0 else "")
        plain_axes(ax, grid="both")
    shown = [name for name in strategies if name in lines]
    legend_below(page, [lines[name] for name in shown], shown)
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
