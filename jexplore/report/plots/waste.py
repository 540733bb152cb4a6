"""Ways coloured by what they were worth."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jexplore.report.plot import draw_map, scale_bar, wrapped
from jexplore.report.plots.looks import legend_below, page_of, panels

MOST = 12  # panels
LOOKS = (
    ("#0072b2", "shows something new, or short of a transit"),
    ("#999999", "on the way to something"),
    ("#d55e00", "to a leftover"),
)
"""Colour and meaning of each kind of step, see `statistics.waste`."""


def figure(entries: Sequence[tuple[str, Any, Any, Any, float]]) -> Figure:
    """Draw ways on their maps, one panel each.

    Args:
      entries: `(title, occupied, way, kinds, cell_m)`: `[H, W]` bool, `[n + 1, 2]` int cells, `[n]` int kinds of steps.

    Returns:
      `Figure`; of more than `MOST` entries it shows the first ones.
    """
    entries = list(entries)[:MOST]
    page, n_cols = page_of(len(entries))
    start = []
    for number, ax, _ in panels(page, len(entries), n_cols):
        title, occupied, way, kinds, cell_m = entries[number]
        draw_map(ax, np.where(occupied, 2, 1), cell_m)
        at = (np.asarray(way)[:, ::-1] + 0.5) * cell_m
        pieces = np.stack([at[:-1], at[1:]], axis=1)
        for kind, (colour, _) in enumerate(LOOKS):
            ax.add_collection(
                LineCollection(list(pieces[kinds == kind]), colors=colour, linewidths=1.5, zorder=3 + kind)
            )
        start = ax.plot(*at[0], "o", ms=6, mfc="white", mec="black", mew=1.4, ls="none", zorder=7)
        scale_bar(ax)
        ax.set_title(wrapped(title, 44, max_lines=2), fontsize=8, parse_math=False)
    lines = [Line2D([], [], color=colour, linewidth=2) for colour, _ in LOOKS]
    legend_below(page, [*lines, *start], [*(what for _, what in LOOKS), "start"][: len(lines) + len(start)])
    return page
