"""Mean paths of strategies: over many worlds relative to a reference, and next to those of a paper."""

import itertools
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from jexplore.report.plot import PALETTE, wrapped_text
from jexplore.report.plots.looks import plain_axes, ratio_range, ratio_scale

if TYPE_CHECKING:
    import pandas as pd

PALE: dict[str, Any] = {"facecolor": "white", "edgecolor": "#666666", "hatch": "////"}
PAIR_GAP = 0.4  # between the pairs of bars of two strategies, in thicknesses of a bar


def league_figure(table: "pd.DataFrame") -> Figure:
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


def draw_bars(ax: Axes, at: Any, means: Any, sds: Any, styles: Iterable[Any]) -> Any:
    """Draw mean path lengths as bars with whiskers of one standard deviation and numbers next to them.

    A NaN mean leaves a gap marked "no data", a NaN or zero sd has no whisker.
    """
    at, means, sds = (np.asarray(part, np.float64) for part in (at, means, sds))
    known = np.isfinite(means)
    length, spread = np.where(known, means, 0.0), np.where(known & np.isfinite(sds), sds, 0.0)
    container = ax.barh(at, length, height=0.92, edgecolor="black", linewidth=0.6)
    for bar, style in zip(container, styles):
        bar.set(**style)
    some = spread > 0
    whisker = np.stack([np.minimum(spread, length), spread])[:, some]
    ax.errorbar(length[some], at[some], xerr=whisker, fmt="none", ecolor="black", elinewidth=1, capsize=3)
    longest = float((length + spread).max(initial=0.0)) or 1.0
    for y, mean, sd in zip(at, means, sds):
        text = "no data" if math.isnan(mean) else f"{mean:.1f}" + (f" ± {sd:.1f}" if math.isfinite(sd) else "")
        x = 0.0 if math.isnan(mean) else mean + (sd if math.isfinite(sd) else 0.0)
        ax.text(x + 0.025 * longest, y, text, va="center", ha="left", fontsize=8)
    ax.set_xlim(0, 1.55 * longest)
    ax.tick_params(axis="y", length=0)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=4))
    ax.set_xlabel("path length (m)", fontsize=8)
    return container


def papers_figure(tables: "pd.DataFrame", short: Mapping[str, str]) -> Figure:
    """Draw mean path lengths as bars with whiskers of one standard deviation, one panel an environment.

    Of each strategy our bar stands above the paper's, which is pale and hatched. `short` are labels of strategies, in
    the order of colours.

    Source:
      Holz et al. 2010, Figure 8. Changed: the bars lie, and the paper's own stand below ours.
    """
    panels = list(tables.groupby("environment", sort=False))
    colours = dict(zip(short, itertools.cycle(PALETTE)))
    most = max(len(rows) for _, rows in panels)
    page = Figure(figsize=(0.6 + 3.3 * len(panels), 1.3 + 0.48 * most), layout="constrained")
    for ax, (name, rows) in zip(page.subplots(1, len(panels), squeeze=False).flat, panels):
        labels = [short[strategy] for strategy in rows["strategy"]]
        means = rows[["mean", "paper_mean"]].to_numpy().ravel()
        sds = rows[["sd", "paper_sd"]].to_numpy().ravel()
        styles = []
        for strategy in rows["strategy"]:
            styles += [{"facecolor": colours[strategy]}, {**PALE, "edgecolor": colours[strategy]}]
        title = f"{name}\n" + wrapped_text(f"ours in {rows['world'].iloc[0]}", 38, max_lines=2)
        centres = (2 + PAIR_GAP) * np.arange(len(rows))
        at = (centres[:, None] + [-0.5, 0.5]).ravel()
        draw_bars(ax, at, means, sds, styles)
        ax.set_title(title, fontsize=9)
        ax.set_yticks(centres, labels, fontsize=8)
        plain_axes(ax)
        ax.set_ylim((2 + PAIR_GAP) * (most - 1) + 1.2, -1.2)
    marks = [Patch(facecolor="#666666", edgecolor="black", label="ours"), Patch(**PALE, label="the paper's")]
    page.legend(handles=marks, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return page
