"""Dependence of a model's score on its features, as a picture."""

from typing import Any

from matplotlib.figure import Figure

COLUMNS = 5


def figure(table: Any) -> Figure:
    """Draw the score as a function of each feature: a curve for each, the most influential first.

    Args:
      table: from `learn.dependence.dependence`.

    Returns:
      `Figure`.
    """
    spread = table.groupby("feature")["score"].agg(lambda a: a.max() - a.min()).sort_values(ascending=False)
    rows = -(-len(spread) // COLUMNS)
    page = Figure(figsize=(9.0, 1.9 * rows), layout="constrained")
    axes = page.subplots(rows, COLUMNS, sharey=True, squeeze=False)
    for ax, name in zip(axes.flat, spread.index):
        own = table[table["feature"] == name]
        ax.axhline(0.0, color="0.8", lw=0.8)
        ax.plot(own["value"], own["score"], color="#d55e00", marker="o", ms=2.5, lw=1.2)
        ax.set_title(name, fontsize=8)
        ax.tick_params(labelsize=7)
    for ax in axes.flat[len(spread) :]:
        ax.set_visible(False)
    for row in axes:
        row[0].set_ylabel("score", fontsize=8)
    page.supxlabel("value of the feature", fontsize=8)
    return page
