"""Two maps of one log, by odometry and as found, each with its way."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jexplore.report.plot import PALETTE, scale_bar
from jexplore.report.plots.looks import FONT

PANEL_IN = 5.0  # longest side
GREYS = 0.85, 0.0, 1.0  # of unknown, occupied and free cells


def draw_scan_map(ax: Axes, drawn: Any, way: Any, *, p_free: float = 0.25) -> Any:
    """Draw a `ScanMap` and a way, `[N, 2]` or more columns, metres; return the image."""
    hits, misses = np.asarray(drawn.grid.hits), np.asarray(drawn.grid.misses)
    n = hits + misses
    grey = np.where(n == 0, GREYS[0], np.where(hits > p_free * n, GREYS[1], GREYS[2]))
    (x, y), (height, width) = drawn.origin_m, n.shape
    extent = x, x + width * drawn.cell_m, y, y + height * drawn.cell_m
    image = ax.imshow(grey, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="antialiased")
    way = np.asarray(way)
    ax.plot(way[:, 0], way[:, 1], color=PALETTE[3], linewidth=0.6)
    ax.set_aspect("equal")
    scale_bar(ax)
    return image


def maps_figure(before: Any, odometry: Any, after: Any, poses: Any) -> Figure:
    """Draw the map by odometry next to the map found."""
    shapes = [np.array(drawn.grid.hits.shape) * drawn.cell_m for drawn in (before, after)]
    widths = [shape[1] / max(shape.max() for shape in shapes) for shape in shapes]
    page = Figure(figsize=(PANEL_IN * sum(widths) + 0.6, PANEL_IN + 0.6), layout="constrained")
    axes = page.subplots(1, 2, width_ratios=widths)
    for ax, drawn, way, title in zip(axes, (before, after), (odometry, poses), ("odometry alone", "matched scans")):
        draw_scan_map(ax, drawn, way)
        ax.set_title(title, fontsize=FONT)
    return page
