"""A picture of maps in rooms, with doors found and missed, and the Voronoi graph that the paper's variants cut."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from jexplore.arrays.pictures import soft_colours
from jexplore.report.plot import draw_colours
from jexplore.report.plots.looks import legend_below
from jexplore.report.plots.maps import MapPanel, maps_page

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
    width = picture.label.shape[1]
    count = int(picture.label.max()) + 1
    rgb = np.where(picture.free[..., None], _bytes(FLOOR), _bytes(WALL))
    if count:
        colours = np.array(soft_colours(count), np.uint8)
        rooms = picture.label >= 0
        rgb[rooms] = colours[picture.label[rooms]]
    rgb.reshape(-1, 3)[picture.lines] = _bytes(GRAPH)
    artist = draw_colours(ax, rgb, picture.cell_m, interpolation="nearest")
    for colour, label in ((WALL, "wall or unknown"), (FLOOR, "floor of no room")):
        ax.plot([], [], "s", color=colour, label=label)
    if len(picture.lines):
        ax.plot([], [], color=GRAPH, label="Voronoi graph")
    critical = np.stack([picture.critical // width, picture.critical % width], axis=-1)
    dot = {"color": CRITICAL, "markersize": 3}
    ring = {"markerfacecolor": "none", "markersize": 6, "markeredgewidth": 1.3}
    for at, marker, label, style in (
        (critical, "o", "critical point", dot),
        *((getattr(picture.doors, what), marker, label, {"color": colour, **ring})
          for what, marker, colour, label in DOORS),
    ):  # fmt: skip
        row, col = (at.T + 0.5) * picture.cell_m
        ax.plot(col, row, marker, linestyle="", label=label if len(at) else None, **style)
    return artist


def _bytes(colour):
    return np.array([round(255 * value) for value in to_rgb(colour)], np.uint8)


def rooms_figure(pictures: Sequence[Any], scores: Any) -> Figure:
    """Draw pictures and their scores: a row for every map and known share, and a column for every variant."""
    panels = []
    for picture, (_, row) in zip(pictures, scores.iterrows()):
        share = "" if picture.explored == 1 else f", {picture.explored:.0%} known"
        doors = f"doors: {row['doors_missed']:.0f} missed, {row['doors_extra']:.0f} too many"
        agreement = "" if np.isnan(row["mcc"]) else f", MCC {row['mcc']:.2f}\n{doors}"
        title = f"{picture.name}{share}\n{picture.variant}: {int(row['rooms'])} rooms{agreement}"
        panels.append(MapPanel(title, picture.label.shape, functools.partial(draw_segments, picture=picture)))
    page, _ = maps_page(panels, len({picture.variant for picture in pictures}), SIDE_IN)
    legend_below(page)
    return page
