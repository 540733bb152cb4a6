"""A picture of maps in rooms, with doors found and missed, and the Voronoi graph that the paper's variants cut."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jexplore.arrays.pictures import soft_colours
from jexplore.report.plot import scale_bar, wrapped_text
from jexplore.report.plots.looks import legend_below

SIDE_IN = 4.2  # of a panel, the longer side
CRITICAL = "#d00000"
WALL, FLOOR, GRAPH = "#3c3c3c", "#ebebeb", "#5a5a5a"
DOORS = (  # what, marker, colour, for the legend
    ("found", "o", "#007a33", "door found"),
    ("missed", "s", "#d00000", "door missed"),
    ("extra", "x", "#c04000", "rooms touch where no door is"),
)


def draw_segments(ax: Axes, picture: Any) -> AxesImage:
    """Draw rooms in colours; rings at found doors, squares at missed ones, crosses at contacts without a door.

    The paper's variants also show the Voronoi graph as thin lines, critical points as dots.
    """
    height, width = picture.label.shape
    count = int(picture.label.max()) + 1
    rgb = np.where(picture.free[..., None], _bytes(FLOOR), _bytes(WALL))
    if count:
        colours = np.array(soft_colours(count), np.uint8)
        rooms = picture.label >= 0
        rgb[rooms] = colours[picture.label[rooms]]
    rgb.reshape(-1, 3)[picture.lines] = _bytes(GRAPH)
    extent = (0, width * picture.cell_m, 0, height * picture.cell_m)
    artist = ax.imshow(rgb, origin="lower", extent=extent, interpolation="nearest")
    rows, cols = picture.critical // width, picture.critical % width
    ax.plot((cols + 0.5) * picture.cell_m, (rows + 0.5) * picture.cell_m, "o", color=CRITICAL, markersize=3)
    for what, marker, colour, _ in DOORS:
        row, col = (getattr(picture.doors, what).T + 0.5) * picture.cell_m
        ax.plot(col, row, marker, color=colour, markerfacecolor="none", markersize=6, markeredgewidth=1.3, linestyle="")
    scale_bar(ax)
    return artist


def _bytes(colour):
    return np.array([round(255 * value) for value in to_rgb(colour)], np.uint8)


def rooms_figure(pictures: Sequence[Any], scores: Any) -> Figure:
    """Draw pictures and their scores: a row for every map and known share, and a column for every variant."""
    variants = list(dict.fromkeys(picture.variant for picture in pictures))
    n_rows = math.ceil(len(pictures) / len(variants))
    tallest = max(p.label.shape[0] / max(p.label.shape) for p in pictures)
    page = Figure(figsize=(SIDE_IN * len(variants), (SIDE_IN * tallest + 0.7) * n_rows), layout="constrained")
    axes = page.subplots(n_rows, len(variants), squeeze=False)
    for ax, picture, (_, row) in zip(axes.flat, pictures, scores.iterrows()):
        draw_segments(ax, picture)
        share = "" if picture.explored == 1 else f", {picture.explored:.0%} known"
        doors = f"doors: {row['doors_missed']:.0f} missed, {row['doors_extra']:.0f} too many"
        agreement = "" if np.isnan(row["mcc"]) else f", MCC {row['mcc']:.2f}, {doors}"
        title = f"{wrapped_text(picture.name, 40, max_lines=1)}{share}\n"
        ax.set_title(f"{title}{picture.variant}: {int(row['rooms'])} rooms{agreement}", fontsize=8, parse_math=False)
    handles = _handles(pictures)
    legend_below(page, handles, [handle.get_label() for handle in handles])
    return page


def _handles(pictures):
    """Return the entries of a legend of everything that some picture shows."""
    handles: list[Any] = [Patch(color=WALL, label="wall or unknown"), Patch(color=FLOOR, label="floor of no room")]
    if any(len(picture.lines) for picture in pictures):
        handles.append(Line2D([], [], color=GRAPH, label="Voronoi graph"))
    if any(len(picture.critical) for picture in pictures):
        handles.append(Line2D([], [], ls="none", marker="o", ms=3, color=CRITICAL, label="critical point"))
    for what, marker, colour, label in DOORS:
        if any(len(getattr(picture.doors, what)) for picture in pictures):
            style: dict[str, Any] = {"marker": marker, "markeredgecolor": colour, "markerfacecolor": "none"}
            handles.append(Line2D([], [], linestyle="none", markersize=6, markeredgewidth=1.3, label=label, **style))
    return handles
