"""A picture of a paper's path lengths and ours."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jexplore.report.plot import bars, style_of, wrapped

if TYPE_CHECKING:
    import pandas as pd

PALE: dict[str, Any] = {"facecolor": "white", "edgecolor": "#666666", "hatch": "////"}
GAP = 0.4
"""Between the pairs of bars of two strategies, in thicknesses of a bar."""


def figure(tables: "pd.DataFrame", short: Mapping[str, str]) -> Figure:
    """Draw mean path lengths as bars with whiskers of one standard deviation, one panel an environment.

    Of each strategy our bar stands above the paper's, which is pale and hatched.

    Args:
      tables: columns `environment`, `world`, `strategy`, `mean`, `sd`, `paper_mean`, `paper_sd`; one row or more.
      short: `{strategy: label}`, in the order of colours.

    Returns:
      `Figure`.

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
        title = f"{name}\n" + wrapped(f"ours in {rows['world'].iloc[0]}", 38, max_lines=2)
        centres = (2 + GAP) * np.arange(len(rows))
        at = (centres[:, None] + [-0.5, 0.5]).ravel()
        bars(ax, [""] * len(means), means, sds, title, styles=styles, at=at, thickness=0.92)
        ax.set_yticks(centres, labels, fontsize=8)
        ax.set_ylim((2 + GAP) * (most - 1) + 1.2, -1.2)
    marks = [Patch(facecolor="#666666", edgecolor="black", label="ours"), Patch(**PALE, label="the paper's")]
    page.legend(handles=marks, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return page
