"""Pictures of a Behavioral Trace Map: links as lines, nodes as marks with their ids."""

import math
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from jexplore.arrays.pictures import LONG_PX, png_of

NODE_STYLES = {
    "terminal": {"marker": "s", "markerfacecolor": "white"},
    "divergence": {"marker": "o", "markerfacecolor": "#f0e442"},
    "free_space": {"marker": "D", "markerfacecolor": "#56b4e9"},
    "obstacle": {"marker": "^", "markerfacecolor": "#cc79a7"},
}
LINK = "black"
STUB_M = 0.8  # drawn length of a link that nobody has followed
_HALO: Any = (patheffects.withStroke(linewidth=2.2, foreground="white"),)
_DPI = 72


def map_png(btm: Any) -> bytes:
    """Draw a map of one node or more as the bytes of a PNG, `LONG_PX` on its longer side."""
    xy = np.array([(node.x_m, node.y_m) for node in btm.nodes])
    low, high = xy.min(axis=0) - 1.5 * STUB_M, xy.max(axis=0) + 1.5 * STUB_M
    figure = Figure(figsize=(high - low) * (LONG_PX / _DPI / max(high - low)))
    ax = figure.add_axes((0, 0, 1, 1))
    draw_btm(ax, btm)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    ax.set_axis_off()
    return png_of(figure, dpi=_DPI)


def draw_btm(ax: Axes, btm: Any) -> None:
    """Draw searched links as straight lines, un-searched ones as short dashed lines, and nodes with their ids.

    The artists of every type of node and state of a link that the map has are labelled for a legend.
    """
    places = {node.id: (node.x_m, node.y_m) for node in btm.nodes}
    lines_of = link_lines(btm)
    for is_stub, style, label in ((False, "-", "searched link"), (True, (0, (2, 1)), "un-searched link")):
        lines = [lines_of[link.id] for link in btm.links if (link.end < 0) == is_stub]
        if lines:
            how: Any = {"colors": LINK, "linewidths": 1.1, "linestyles": [style], "zorder": 4, "label": label}
            ax.add_collection(LineCollection(lines, **how))
    for kind in NODE_STYLES:
        xy = np.array([places[node.id] for node in btm.nodes if node.type == kind]).reshape(-1, 2)
        if len(xy):
            style = {"linestyle": "none", "markersize": 7, "markeredgecolor": "black", **NODE_STYLES[kind]}
            ax.plot(xy[:, 0], xy[:, 1], zorder=6, label=f"{kind.replace('_', ' ')} node", **style)
    for node in btm.nodes:
        x, y = _free_side(btm, node)
        place = {"xytext": (12 * x, 12 * y), "textcoords": "offset points", "ha": "center", "va": "center"}
        text = ax.annotate(str(node.id), places[node.id], fontsize=7, zorder=7, **place)
        text.set_path_effects(_HALO)
    ax.autoscale_view()


def link_lines(btm: Any) -> dict[int, list[tuple[float, float]]]:
    """Return the lines of links by id: from node to node, as stubs where a link has no end or leads back."""
    places, lines = {node.id: (node.x_m, node.y_m) for node in btm.nodes}, {}
    for link in btm.links:
        start, end = places[link.start], places.get(link.end)
        if end is not None and link.start != link.end:
            lines[link.id] = [start, end]
            continue
        bearings = [link.start_bearing_deg] if end is None else [link.start_bearing_deg, link.end_bearing_deg]
        lines[link.id] = [_beside(start, bearing) for bearing in bearings]
        lines[link.id].insert(0 if end is None else 1, start)
    return lines


def _beside(place, bearing_deg):
    angle = math.radians(bearing_deg)
    return place[0] + STUB_M * math.cos(angle), place[1] + STUB_M * math.sin(angle)


def _free_side(btm, node):
    """Return the direction of a node's id, a unit vector: above, or else 45 degrees off its links."""
    links = btm.bearings_deg(node.id)

    def off(angle):
        return min((abs((angle - bearing + 180) % 360 - 180) for bearing in links), default=180.0)

    best = math.radians(max((90, 45, 135, 0, 180, 315, 225, 270), key=lambda angle: min(round(off(angle)), 45)))
    return math.cos(best), math.sin(best)
