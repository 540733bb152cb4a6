"""Paths as functions of settings: curves over one, maps of colours over two."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from jexplore.report.plot import wrapped_text
from jexplore.report.plots.looks import (
    FONT,
    GREY,
    legend_below,
    looks_of,
    panels,
    panels_page,
    plain_axes,
    ratio_range,
    ratio_scale,
    ratio_ticks,
)

SPREAD, MOST_SPREAD = 0.012, 0.08
"""Strategies stand apart by this share of the axis, all of them by the second, lest their intervals hide each other."""
LENGTHS, RATIOS = "cividis", "RdBu_r"
"""Colours of numbers, and of ratios; both are told apart by colour-blind readers."""
MOST_COLUMNS = 5
"""Of maps side by side."""
NUMBERS = 9
"""A map of more columns than this has no numbers in its cells."""


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


def response_curves_figure(
    table: Any, setting: str, *, label: str = "path length (m)", ratio: bool = False, averaged: str = ""
) -> Figure:
    """Draw curves over a setting, a column of a table from `response.response`: a panel a world, a line a strategy.

    Text or truth values stand side by side in order of first appearance. A `ratio` has a logarithmic axis with a line
    at 1. `averaged` names the averaged settings: a line above the panels.
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
        _y_axis(ax, own, ratio)
        if len(levels) <= NUMBERS or not is_number:
            ax.set_xticks([place[level] for level in levels], [_text(level) for level in levels])
        ax.set_xlim(min(place.values()) - 0.09 * span, max(place.values()) + 0.09 * span)
        ax.set_title(wrapped_text(worlds[number], 44, max_lines=2), fontsize=9)
        ax.set_xlabel(setting if lowest else "")
        ax.set_ylabel(wrapped_text(label, 40, max_lines=2) if number % n_cols == 0 else "")
        plain_axes(ax, grid="both")
    legend_below(page, [lines[name] for name in lines], list(lines))
    _above(page, averaged)
    return page


def _above(page, text):
    if text:
        text = wrapped_text(text, int(12 * page.get_figwidth()), max_lines=3)
        page.suptitle(text, fontsize=FONT, color=GREY, parse_math=False)


def _y_axis(ax, rows, ratio):
    if ratio:
        ax.axhline(1.0, color=GREY, linewidth=1, zorder=0)
        ratio_scale(ax, "y", *ratio_range(rows["estimate"], rows[["low", "high"]]))
        return
    most = float(np.nanmax(rows["estimate"]))
    ends = np.minimum(rows["high"].to_numpy(np.float64), 1.5 * most)
    ax.set_ylim(0.0, 1.06 * max(most, float(np.nanmax(ends)) if np.isfinite(ends).any() else 0.0) or 1.0)


def draw_heat(ax: Axes, values: Any, norm: Normalize, *, ratio: bool, decimals: int = 2) -> AxesImage:
    """Draw a matrix as colours with its numbers, if it is small: bright is long, or blue below and red above 1."""
    values = np.asarray(values, np.float64)
    image = ax.imshow(values, origin="lower", aspect="auto", cmap=RATIOS if ratio else LENGTHS, norm=norm)
    if values.shape[1] > NUMBERS or values.shape[0] > 2 * NUMBERS:
        return image
    style = {"ha": "center", "va": "center", "fontsize": 7}
    for (row, col), value in np.ndenumerate(values):
        if math.isfinite(value):
            red, green, blue, _ = image.cmap(norm(value))
            dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.55
            ax.text(col, row, f"{value:.{decimals}f}", color="white" if dark else "black", **style)
    return image


def _norm(values, ratio) -> Any:
    some = values[np.isfinite(values) & (values > 0)] if ratio else values[np.isfinite(values)]
    if ratio:
        far = max(float(np.exp(np.abs(np.log(some)).max(initial=0.0))), 1.05)
        return LogNorm(1 / far, far)
    low, high = (float(some.min()), float(some.max())) if some.size else (0.0, 1.0)
    return Normalize(low, high if high > low else low + 1.0)


def heat_maps_figure(
    table: Any, x: str, y: str, *, label: str = "path length (m)", ratio: bool = False, averaged: str = ""
) -> Figure:
    """Draw colours over two settings of a table from `response.response`: a row of panels a world, one a strategy.

    All have one colour scale, and every value a place of its own, whatever lies between. A `ratio` is blue below 1, red
    above. `averaged` names the averaged settings: a line above the panels.
    """
    worlds, strategies = (list(dict.fromkeys(table[key])) for key in ("world", "strategy"))
    across, up = _levels(table[x]), _levels(table[y])
    norm = _norm(table["estimate"].to_numpy(np.float64), ratio)
    decimals = 2 if ratio or norm.vmax < 10 else 1 if norm.vmax < 100 else 0
    wide = min(max(0.42 * len(across) + 0.7, 2.3), 4.5)
    tall = min(max(0.3 * len(up) + 0.8, 1.9), 4.5)
    n_cols = min(len(strategies), MOST_COLUMNS)
    n_lines = math.ceil(len(strategies) / n_cols)  # of panels, for each world
    size = (max(wide * n_cols + 1.2, 4.2), tall * n_lines * len(worlds) + 0.4)
    page: Any = Figure(figsize=size, layout="constrained")
    grid = page.subplots(n_lines * len(worlds), n_cols, squeeze=False)
    for number, ax in enumerate(grid.flat):
        line, col = divmod(number, n_cols)
        world, place = worlds[line // n_lines], line % n_lines * n_cols + col
        own = table[(table["world"] == world) & (table["strategy"] == strategies[min(place, len(strategies) - 1)])]
        if place >= len(strategies) or not len(own):
            ax.set_visible(False)
            continue
        cells = np.full((len(up), len(across)), np.nan)
        cells[[up.index(v) for v in own[y]], [across.index(v) for v in own[x]]] = own["estimate"]
        draw_heat(ax, cells, norm, ratio=ratio, decimals=decimals)
        _ticks(ax, across, up, int(wide / 0.42), int(tall / 0.24))
        ax.set_title(wrapped_text(strategies[place], int(12 * wide), max_lines=2), fontsize=9)
        ax.set_xlabel(x if line // n_lines == len(worlds) - 1 and place + n_cols >= len(strategies) else "")
        ax.set_ylabel(f"{wrapped_text(world, int(10 * tall), max_lines=2)}\n{y}" if col == 0 else "")
        plain_axes(ax)
        ax.spines[:].set_visible(False)
    colours = ScalarMappable(norm, RATIOS if ratio else LENGTHS)
    bar = page.colorbar(colours, ax=list(grid.flat), fraction=0.05, shrink=0.9, pad=0.02)
    bar.set_label(label, fontsize=FONT, parse_math=False)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=FONT, which="both")
    if ratio:
        ticks = ratio_ticks(norm.vmin, norm.vmax)
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        bar.minorticks_off()
    _above(page, averaged)
    return page


def _ticks(ax, across, up, most_across, most_up):
    """Label the values along a matrix, every second, third, ... of many."""
    for levels, most, axis in ((across, most_across, ax.xaxis), (up, most_up, ax.yaxis)):
        step = math.ceil(len(levels) / max(most, 1))
        axis.set_ticks(range(0, len(levels), step), [_text(level) for level in levels[::step]])
        axis.set_tick_params(length=0)
