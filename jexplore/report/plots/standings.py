"""Mean paths of strategies over many worlds, relative to a reference."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from jexplore.report.plot import PALETTE
from jexplore.report.plots.looks import plain_axes, ratio_range, ratio_scale

if TYPE_CHECKING:
    import pandas as pd


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
