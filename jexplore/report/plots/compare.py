"""Path lengths of every strategy, episode by episode, with means, intervals, and ratios to the first strategy."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jexplore.report.plot import PALETTE, wrapped_text
from jexplore.report.plots.looks import FONT, GREY, looks_of, plain_axes, ratio_range, ratio_scale

GOLDEN_RATIO_PART = 0.6180339887
LABEL_CHARS = 38  # characters of a strategy's name in a line
ONE_COLUMN_PANELS = 4  # more panels than this stand in two columns


class Estimates(NamedTuple):
    """Numbers of K strategies with their intervals."""

    values: Any  # [K] float, NaN if missing
    low: Any  # [K] float, NaN where there is no interval
    high: Any


class ComparisonPanel(NamedTuple):
    """Content of one pair of axes: one world, or all of them."""

    title: str
    label: str  # of the axis on the left
    points: Sequence[Any]  # K arrays: the path of every episode, or another number; may be empty
    ended_well: Sequence[Any]  # K bool arrays of the same lengths: other points are crosses
    means: Estimates  # of the points
    shares: bool  # bool, points are shares in per cent, with a line at 50
    ratio_points: Sequence[Any]  # K arrays: ratios that the estimate on the right is made of; may be empty
    ratios: Estimates  # to the first strategy


def _spread(count, width):
    """Return `[count]` places within `± width`, neighbours in number far apart."""
    return (np.arange(1, count + 1) * GOLDEN_RATIO_PART % 1.0 - 0.5) * 2 * width


def draw_points(ax: Axes, points: Sequence[Any], estimates: Estimates, looks: Sequence[dict[str, Any]], *,
                ended_well: Sequence[Any] | None = None) -> list[Any]:  # fmt: skip
    """Draw a row for each strategy, the first on top: its numbers as pale dots, their mean and its interval on them.

    Numbers that are not among `ended_well`, K bool arrays, are crosses. Return K error bars, None without a mean.
    """
    bars = []
    for row, (some, look) in enumerate(zip(points, looks)):
        some = np.asarray(some, np.float64)
        well = np.ones(len(some), bool) if ended_well is None else np.asarray(ended_well[row], bool)
        at = row + _spread(len(some), 0.3)
        size = 3.8 if len(some) <= 40 else 2.4 if len(some) <= 300 else 1.2
        pale = {"ls": "none", "color": look["color"], "mew": 0, "alpha": 0.5, "rasterized": len(some) > 500}
        ax.plot(some[well], at[well], "o", ms=size, **pale)
        ax.plot(some[~well], at[~well], "x", **{**pale, "ms": size + 1, "mew": 0.9, "alpha": 0.8})
        value, low, high = (part[row] for part in estimates)
        bars.append(_estimate(ax, row, value, low, high, look))
    ax.set_ylim(len(points) - 0.45, -0.55)
    ax.set_yticks(range(len(points)), [""] * len(points))
    ax.tick_params(axis="y", length=0)
    return bars


def _estimate(ax, row, value, low, high, look):
    if not math.isfinite(value):
        return None
    ends = [[max(value - low, 0.0)], [max(high - value, 0.0)]] if math.isfinite(low) and math.isfinite(high) else None
    style = {"ecolor": "black", "elinewidth": 1.3, "capsize": 3, "capthick": 1.1, "zorder": 5}
    style |= {"color": look["color"], "ms": 5.5, "mec": "black", "mew": 0.7}
    return ax.errorbar([value], [row], xerr=ends, fmt=look["marker"], **style)


def draw_ratios(ax: Axes, estimates: Estimates, looks: Sequence[dict[str, Any]], points: Sequence[Any]) -> list[Any]:
    """Draw a row for each strategy: its ratio to the first one with the interval, on a logarithmic axis.

    The axis shows all ratios; an interval that goes on beyond it ends in an arrow head. `points` are K arrays of single
    ratios, drawn pale. Return K error bars, None where there is no ratio.
    """
    ax.axvline(1.0, color=GREY, linewidth=1, zorder=0)
    bars = draw_points(ax, points, estimates, looks)
    shown = np.concatenate([np.ravel(estimates.values), *map(np.ravel, points)])
    low, high = ratio_range(shown, np.concatenate([np.ravel(estimates.low), np.ravel(estimates.high)]))
    ratio_scale(ax, "x", low, high)
    _beyond(ax, estimates, low, high)
    return bars


def _beyond(ax, estimates, low, high):
    """Draw arrow heads on intervals that the axis cuts off."""
    for row, (start, end) in enumerate(zip(estimates.low, estimates.high)):
        for beyond, at, mark in ((start < low, low, "<"), (end > high, high, ">")):
            if beyond:
                ax.plot([at], [row], mark, color="black", ms=5, clip_on=False, zorder=6)


def draw_panel(ax: Axes, panel: ComparisonPanel, strategies: Sequence[str]) -> list[Any]:
    """Draw the left part of a panel, with the names of the strategies; return K error bars, None without a mean."""
    bars = _left(ax, panel, list(looks_of(strategies).values()))
    ax.set_yticks(range(len(strategies)), [wrapped_text(name, LABEL_CHARS) for name in strategies])
    ax.set_xlabel(panel.label)
    ax.set_title(wrapped_text(panel.title, 62, max_lines=2), fontsize=9, loc="left").set_parse_math(False)
    plain_axes(ax, grid="x")
    return bars


def comparison_figure(panels: Sequence[ComparisonPanel], strategies: Sequence[str]) -> Figure:
    """Draw paths episode by episode, and next to them the ratios to the first strategy; a pair of axes a panel.

    Strategies, the reference first, stand in the order given; one that did not run in a world leaves its row empty.

    Source:
      Holz et al. 2010, Figure 8, shows means and standard deviations. Changed: every episode, intervals, paired ratios.
    """
    labels = [wrapped_text(name, LABEL_CHARS) for name in strategies]
    looks = list(looks_of(strategies).values())
    n_cols = 1 if len(panels) <= ONE_COLUMN_PANELS else 2
    n_rows = math.ceil(len(panels) / n_cols)
    pitch = 0.09 + 0.14 * max(label.count("\n") + 1 for label in labels)
    names_in = 0.068 * max(len(line) for label in labels for line in label.split("\n")) + 0.25
    tall = max(0.85 + max(pitch, 0.24) * len(labels), 1.25)
    page = Figure(figsize=(names_in + 5.6 * n_cols, n_rows * tall + 0.45), layout="constrained")
    grid = page.subplots(n_rows, 2 * n_cols, squeeze=False, gridspec_kw={"width_ratios": [1.15, 1.0] * n_cols})
    for number in range(n_rows * n_cols):
        left, right = grid[number // n_cols, number % n_cols * 2 : number % n_cols * 2 + 2]
        if number >= len(panels):
            left.set_visible(False)
            right.set_visible(False)
            continue
        panel, lowest = panels[number], number + n_cols >= len(panels)
        draw_panel(left, panel, strategies)
        draw_ratios(right, panel.ratios, looks, panel.ratio_points)
        if number % n_cols > 0:
            left.set_yticklabels([])
        same_below = not lowest and panels[number + n_cols].label == panel.label
        left.set_xlabel("" if same_below else panel.label)
        right.set_xlabel(wrapped_text(f"ratio to {strategies[0]}", 34, max_lines=2) if lowest else "")
        plain_axes(right, grid="x")
    _legend(page, panels)
    return page


def _left(ax, panel, looks):
    """Draw the numbers of one panel, on an axis from 0."""
    bars = draw_points(ax, panel.points, panel.means, looks, ended_well=panel.ended_well)
    for row, some in enumerate(panel.points):
        if not len(some) and not math.isfinite(panel.means.values[row]):
            text = "the reference" if panel.shares and row == 0 else "no data"
            ax.text(0.02, row, text, va="center", fontsize=FONT, color=GREY, transform=ax.get_yaxis_transform())
    if panel.shares:
        ax.axvline(50, color=GREY, linewidth=1, zorder=0)
        ax.set_xlim(-3, 103)
        ax.set_xticks([0, 25, 50, 75, 100])
        return bars
    numbers = np.concatenate([np.ravel(part) for part in (*panel.points, panel.means.values)])
    longest = float(numbers[np.isfinite(numbers)].max(initial=0.0)) or 1.0
    ends = panel.means.high[np.isfinite(panel.means.high)]
    longest = max(longest, float(np.minimum(ends, 1.5 * longest).max(initial=0.0)))
    ax.set_xlim(-0.02 * longest, 1.04 * longest)
    _beyond(ax, panel.means, -math.inf, 1.04 * longest)
    return bars


_POINTS = {"an episode": lambda panel: panel.points, "a world": lambda panel: panel.ratio_points}


def _legend(page, panels):
    single = [any(len(some) for panel in panels for some in points(panel)) for points in _POINTS.values()]
    what = " or ".join(name for name, there in zip(_POINTS, single) if there)
    marks = [Line2D([], [], color=GREY, ls="none", marker="o", ms=3.8, alpha=0.6, label=what)] if what else []
    if not all(np.all(well) for panel in panels for well in panel.ended_well):
        marks.append(Line2D([], [], color=GREY, ls="none", marker="x", ms=4.5, label="one that is not COMPLETE"))
    marks.append(Line2D([], [], color="black", marker="o", ms=5.5, mfc="white", label="mean or ratio, 95 % interval"))
    page.legend(handles=marks, loc="outside lower center", ncols=3, frameon=False, fontsize=FONT)


def league_figure(table: Any) -> Figure:
    """Draw `league.standings`: ratios as dots with intervals, the shortest on top; pale dots are kinds of worlds."""
    kinds = [name for name in table.columns if name.startswith("ratio of ")]
    at = np.arange(len(table))
    page = Figure(figsize=(8.4, 1.2 + 0.34 * len(table)), layout="constrained")
    ax = page.subplots()
    ax.axvline(1.0, color="#999999", linewidth=1)
    for kind, colour in zip(kinds, PALETTE * (1 + len(kinds) // len(PALETTE))):
        ax.plot(table[kind], at, "o", color=colour, markersize=4, alpha=0.6, label=kind.removeprefix("ratio of "))
    low, high = table["ratio"] - table["ratio_low"], table["ratio_high"] - table["ratio"]
    ax.errorbar(
        table["ratio"], at, xerr=np.nan_to_num(np.stack([low, high])), fmt="D", color="black", markersize=5, capsize=3,
        label="all worlds, 95 %",
    )  # fmt: skip
    ax.set_yticks(at, table["strategy"])
    ax.invert_yaxis()
    ratio_scale(ax, "x", *ratio_range(table[["ratio", *kinds]]))
    ax.set_xlabel("path length over the reference's (log scale)")
    plain_axes(ax, grid="x")
    page.legend(loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    return page
