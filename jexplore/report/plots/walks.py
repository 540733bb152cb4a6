"""Walks on floor plans, with the witnesses of their lower bounds."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jexplore.report.plot import draw_map, draw_path, scale_bar, wrapped_text
from jexplore.report.plots.looks import legend_below, panels, panels_page

MAX_PANELS = 12
WITNESS_COLOUR = "#d55e00"
BOUNDS_LABELS = ("shortest walk found, dark to bright", "start", "end", "cell that the lower bound is made of")


def bounds_figure(found: Any) -> Figure:
    """Draw the walks of the first starts, with the cells that make their lower bounds, on the true floor plans."""
    maps = {str(world.name): world for world in found.worlds}
    rows = found.table.to_dict("records")[:MAX_PANELS]
    page, n_cols = panels_page(len(rows))
    handles = []
    for number, ax, _ in panels(page, len(rows), n_cols):
        row, world = rows[number], maps[str(rows[number]["world"])]
        draw_map(ax, np.where(world.occupied, 2, 1), world.cell_m)
        own = found.walks[found.walks["start"] == number]
        way = own if len(own) else {"row": np.array([row["start_row"]]), "col": np.array([row["start_col"]])}
        handles = draw_path(ax, np.asarray(way["row"]), np.asarray(way["col"]), world.cell_m, width=1.2)
        at = (found.witnesses[number] + 0.5) * world.cell_m
        style: Any = {"ls": "none", "marker": "D", "ms": 3.5, "mfc": WITNESS_COLOUR, "mec": "white", "mew": 0.5}
        handles = [*handles, *ax.plot(at[:, 1], at[:, 0], zorder=5, **style)]
        scale_bar(ax)
        ax.set_title(f"{wrapped_text(row['world'], 40, max_lines=2)}\n{_between(row)}", fontsize=8, parse_math=False)
    legend_below(page, handles, BOUNDS_LABELS[: len(handles)])
    return page


def _between(row):
    """Return the part of a title that states a row's bounds."""
    if not np.isfinite(row["high_m"]):
        return f"{row['status']}, at least {row['low_m']:.1f} m" if row["low_m"] else row["status"]
    return f"{row['low_m']:.1f} to {row['high_m']:.1f} m, {row['status']}"
