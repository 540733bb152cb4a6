"""Curves of training, and the dependence of a model's score on its features."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

TRAINED, CHECKED = "#9ecae1", "#d55e00"
FEATURES_ACROSS = 5  # panels


def training_figure(curve: Any, best: int) -> Figure:
    """Draw ratios of paths to the reference's over the training rounds, in training and on the validation worlds.

    Args:
      curve: table with the columns `round`, `ratio` and `validation`.
    """
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


def dependence_figure(table: Any) -> Figure:
    """Draw the score as a function of each feature: a curve for each, the most influential first.

    Args:
      table: from `learn.dependence.dependence`.
    """
    spread = table.groupby("feature")["score"].agg(lambda a: a.max() - a.min()).sort_values(ascending=False)
    rows = -(-len(spread) // FEATURES_ACROSS)
    page = Figure(figsize=(9.0, 1.9 * rows), layout="constrained")
    axes = page.subplots(rows, FEATURES_ACROSS, sharey=True, squeeze=False)
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
