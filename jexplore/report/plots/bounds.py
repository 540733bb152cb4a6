"""Walks and witnesses of lower bounds on floor plans."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jexplore.report.plot import draw_map, draw_path, wrapped
from jexplore.report.plots.looks import page_of, panels

MOST = 12  # panels
WITNESS = "#d55e00"


def figure(found: Any) -> Figure:
    """The walks of the first starts, with the cells that make their lower bounds, on the true floor plans.

    Args:
      found: `Bounds`.

    Returns:
      `Figure`.
    """
    maps = {str(world.name): world for world in found.worlds}
    rows = found.table.to_dict("records")[:MOST]
    page, _ = page_of(len(rows))
    for number, ax, _lowest in panels(page, len(rows), page_of(len(rows))[1]):
        row, world = rows[number], maps[str(rows[number]["world"])]
        draw_map(ax, np.where(world.occupied, 2, 1), world.cell_m)
        own = found.walks[found.walks["start"] == number]
        way = own if len(own) else {"row": np.array([row["start_row"]]), "col": np.array([row["start_col"]])}
        draw_path(ax, np.asarray(way["row"]), np.asarray(way["col"]), world.cell_m, width=1.2)
        at = (found.witnesses[number] + 0.5) * world.cell_m
        ax.plot(at[:, 1], at[:, 0], ls="none", marker="D", ms=3.5, mfc=WITNESS, mec="white", mew=0.5, zorder=5)
        ax.set(xticks=[], yticks=[])
        ax.set_title(f"{wrapped(row['world'], 40, max_lines=2)}\n{_between(row)}", fontsize=8, parse_math=False)
    return page


def _between(row):
    """What a title says of a row's bounds."""
    if not np.isfinite(row["high_m"]):
        return f"{row['status']}, at least {row['low_m']:.1f} m" if row["low_m"] else row["status"]
    return f"{row['low_m']:.1f} to {row['high_m']:.1f} m, {row['status']}"
