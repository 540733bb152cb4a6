"""Curves of training."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

TRAINED, CHECKED = "#9ecae1", "#d55e00"


def training_figure(curve: Any, best: int) -> Figure:
    """Draw ratios of paths to the reference's over the training rounds, in training and on the validation worlds."""
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
