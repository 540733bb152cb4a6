"""Paths as functions of a setting."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jexplore.report.plot import wrapped_text
from jexplore.report.plots.looks import (
    FONT,
    GREY,
    legend_below,
    looks_of,
    panels,
    panels_page,
    plain_axes,
)

SPREAD, MOST_SPREAD = 0.012, 0.08
"""Strategies stand apart by this share of the axis, all of them by the second, lest their intervals hide each other."""
NUMBERS = 9
"""Up to as many values of a number have a label each."""


def _levels(column):
    """Return the values of a setting in order: numbers rising, others by first appearance."""
    values = list(dict.fromkeys(column))
    return sorted(values) if np.asarray(column).dtype.kind in "iufb" else values


def _text(value):
    return f"{value:.4g}" if isinstance(value, (int, float, np.number)) and not isinstance(value, bool) else str(value)


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
    worlds, strategies = (list(dict.fromkeys(table[key])) for key in ("world", "strategy"))
    levels = _levels(table[setting])
    is_number = np.asarray(table[setting]).dtype.kind in "iuf"
    place = {level: float(level) if is_number else float(i) for i, level in enumerate(levels)}
    span = max(place.values()) - min(place.values()) or 1.0
    looks, lines = looks_of(strategies), {}
    if not is_number:
        looks = {name: {**look, "linestyle": "none"} for name, look in looks.items()}
    spread = span * min(SPREAD * (len(strategies) - 1), MOST_SPREAD)
    page, n_cols = panels_page(len(worlds))
    for number, ax, lowest in panels(page, len(worlds), n_cols, sharex=True):
        own = table[table["world"] == worlds[number]]
        for name, rows in own.groupby("strategy", sort=False):
            aside = (strategies.index(name) / max(len(strategies) - 1, 1) - 0.5) * spread
            x = np.array([place[level] + aside for level in rows[setting]])
            lines[name] = draw_response(ax, x, rows["estimate"], rows["low"], rows["high"], looks[name])
        most = float(np.nanmax(own["estimate"]))
        ends = np.minimum(own["high"].to_numpy(np.float64), 1.5 * most)
        ax.set_ylim(0.0, 1.06 * max(most, float(np.nanmax(ends)) if np.isfinite(ends).any() else 0.0) or 1.0)
        if len(levels) <= NUMBERS or not is_number:
            ax.set_xticks([place[level] for level in levels], [_text(level) for level in levels])
        ax.set_xlim(min(place.values()) - 0.09 * span, max(place.values()) + 0.09 * span)
        ax.set_title(wrapped_text(worlds[number], 44, max_lines=2), fontsize=9)
        ax.set_xlabel(setting if lowest else "")
        ax.set_ylabel("path length (m)" if number % n_cols == 0 else "")
        plain_axes(ax, grid="both")
    legend_below(page, [lines[name] for name in lines], list(lines))
    text = wrapped_text(averaged, int(12 * page.get_figwidth()), max_lines=3)
    page.suptitle(text, fontsize=FONT, color=GREY, parse_math=False)
    return page
