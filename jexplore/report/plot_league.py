"""A picture of strategies over many worlds: path lengths relative to a reference, with intervals."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from jexplore.report.plot import PALETTE

if TYPE_CHECKING:
    import pandas as pd


def figure(table: "pd.DataFrame") -> Figure:
    """Draw ratios to the reference as dots with intervals, the shortest on top; pale dots are single kinds of worlds.

    Args:
      table: from `league.standings`.

    Returns:
      `Figure`.
    """
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
