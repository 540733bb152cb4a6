"""Mean paths of strategies: over many worlds relative to a reference, and next to those of a paper."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jexplore.report.plot import PALETTE, bars, style_of, wrapped_text

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
    ax.set_yticks(at, [str(name).replace("$", r"\$") for name in table["strategy"]], fontsize=8)
    ax.invert_yaxis()
    ax.set_xscale("log")
    ticks = [t for t in (0.5, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0) if _spans(table, kinds, t)]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks], fontsize=8)
    ax.minorticks_off()
    ax.set_xlabel("path length beside the reference's (log scale)", fontsize=8)
    ax.grid(axis="x", color="#e0e0e0")
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    page.legend(loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    return page


def _spans(table, kinds, tick):
    values = table[["ratio", *kinds]].to_numpy()
    if not np.isfinite(values).any():
        return False
    return 0.93 * np.nanmin(values) <= tick <= 1.08 * np.nanmax(values)


def papers_figure(tables: "pd.DataFrame", short: Mapping[str, str]) -> Figure:
    """Draw mean path lengths as bars with whiskers of one standard deviation, one panel an environment.

    Of each strategy our bar stands above the paper's, which is pale and hatched. `short` are labels of strategies, in
    the order of colours.

    Source:
      Holz et al. 2010, Figure 8. Changed: the bars lie, and the paper's own stand below ours.
    """
    panels, colours = list(tables.groupby("environment", sort=False)), style_of(short)
    most = max(len(rows) for _, rows in panels)
    page = Figure(figsize=(0.6 + 3.3 * len(panels), 1.3 + 0.48 * most), layout="constrained")
    for ax, (name, rows) in zip(page.subplots(1, len(panels), squeeze=False).flat, panels):
        labels = [short[strategy] for strategy in rows["strategy"]]
        means = rows[["mean", "paper_mean"]].to_numpy().ravel()
        sds = rows[["sd", "paper_sd"]].to_numpy().ravel()
        styles = []
        for strategy in rows["strategy"]:
            styles += [colours[strategy], {**PALE, "edgecolor": colours[strategy]["facecolor"]}]
        title = f"{name}\n" + wrapped_text(f"ours in {rows['world'].iloc[0]}", 38, max_lines=2)
        centres = (2 + PAIR_GAP) * np.arange(len(rows))
        at = (centres[:, None] + [-0.5, 0.5]).ravel()
        bars(ax, [""] * len(means), means, sds, title, styles=styles, at=at, thickness=0.92)
        ax.set_yticks(centres, labels, fontsize=8)
        ax.set_ylim((2 + PAIR_GAP) * (most - 1) + 1.2, -1.2)
    marks = [Patch(facecolor="#666666", edgecolor="black", label="ours"), Patch(**PALE, label="the paper's")]
    page.legend(handles=marks, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return page
