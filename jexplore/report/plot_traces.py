"""Pictures of Behavioral Trace Maps with a route, or with the building and the run."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from jexplore.report.plot import PALETTE, wrapped_text
from jexplore.report.plots.looks import legend_below, plain_axes
from jexplore.tracemap.picture import STUB_M, draw_btm, link_lines
from jexplore.tracemap.record import BtmMap
from jexplore.tracemap.route import Route

MODE_COLOURS = tuple(PALETTE[i] for i in (0, 1, 2, 5, 7, 3, 4, 6))
"""Of run modes, those first that no type of node has; a ninth mode starts over."""
WALL, POINT = "#dddddd", "#555555"
WAY, REFUSED = PALETTE[0], "#e01010"
OUTCOME_MARKS = {
    "MERGED": ("*", "#f0e442"),
    "AMBIGUOUS": ("^", "#ffffff"),
    "NOT_ENOUGH_IN_COMMON": ("X", "#ffffff"),
}
"""Of attempts to merge maps: marker and colour."""
LONG_IN, LEGEND_IN = 8.0, 1.9
FIRST_PASS_M = 0.25  # by which a first pass of a node may be farther than the nearest


def draw_route(ax: Axes, btm: BtmMap, route: Route) -> None:
    """Draw a route as a broad band, refused links with a red cross, nodes not to be passed in red rings."""
    places, lines = {node.id: (node.x_m, node.y_m) for node in btm.nodes}, link_lines(btm)
    band = [lines[own] for own in (*route.links, *([] if route.onward is None else [route.onward.link]))]
    if band:
        style: dict[str, Any] = {"alpha": 0.45, "linewidth": 7, "capstyle": "round", "zorder": 3}
        ax.add_collection(LineCollection(band, colors=WAY, label=f"route of {route.robot}", **style))
    crosses = [np.mean([lines[own][0], lines[own][-1]], axis=0) for own, _ in route.refused]
    rings = [places[own] for own, _ in route.barriers]
    for at, marker, size, label in ((crosses, "x", 9, "refused link"), (rings, "o", 15, "not to be passed")):
        if len(at):
            style = {"linestyle": "none", "markersize": size, "markeredgecolor": REFUSED, "markeredgewidth": 2}
            ax.plot(*np.transpose(at), marker=marker, markerfacecolor="none", zorder=5, label=label, **style)


def draw_trail(ax: Axes, trail: ArrayLike, modes: ArrayLike, mode_names: Sequence[str]) -> None:
    """Draw the robot's way in the colour of its mode, a ring at the start and a cross at the end.

    `trail` is `[T, 3]` x and y, metres, and heading, which is not drawn; `modes` are `[T]` int, index into
    `mode_names`: of the piece that leads to this pose.
    """
    xy, modes = np.asarray(trail, float).reshape(-1, 3)[:, :2], np.asarray(modes, int)
    if len(xy) != len(modes):
        raise ValueError(f"expected a mode for every pose, got {len(modes)} for {len(xy)}")
    pieces = np.stack([xy[:-1], xy[1:]], axis=1)
    for mode in np.unique(modes):
        style = {"colors": MODE_COLOURS[mode % len(MODE_COLOURS)], "capstyle": "round", "label": mode_names[mode]}
        ax.add_collection(LineCollection(list(pieces[modes[1:] == mode]), linewidths=3.4, zorder=3, **style))
    for label, place, marker, face, size in (("start", xy[:1], "o", "none", 13), ("end", xy[-1:], "x", "black", 11)):
        if len(place):
            style = {"linestyle": "none", "markerfacecolor": face, "markersize": size, "markeredgecolor": "black"}
            ax.plot(*place.T, marker=marker, markeredgewidth=1.4, zorder=5, label=label, **style)


def draw_pitch(ax: Axes, btm: BtmMap, trail: ArrayLike, pitch_deg: Any) -> Line2D:
    """Draw the body's inclination, `[T]`, over the driven way; lines with ids mark where it first came to the nodes."""
    xy = np.asarray(trail, float)[:, :2]
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    (line,) = ax.plot(driven, pitch_deg, color="black", linewidth=1.2)
    now, above, taken = 0, ax.get_xaxis_transform(), [-math.inf] * 3
    for node in btm.nodes:
        apart = np.hypot(*(xy[now:] - (node.x_m, node.y_m)).T)
        near = np.append(apart <= apart.min() + FIRST_PASS_M, False)  # later passes count no more than the first
        first = int(np.argmax(near))
        now += first + int(np.argmin(apart[first : first + int(np.argmin(near[first:]))]))
        ax.axvline(driven[now], color="#999999", linewidth=0.8, linestyle=":", zorder=0)
        need = 0.022 * driven[-1]  # width of an id
        row = next((i for i, last in enumerate(taken) if driven[now] - last > need), len(taken) - 1)
        taken[row] = driven[now]
        style = {"ha": "center", "va": "bottom", "fontsize": 7, "transform": above}
        ax.text(driven[now], 1.03 + 0.14 * row, str(node.id), **style)
    ax.set_xlim(0, max(driven[-1], 1e-9))
    ax.set(xlabel="way driven (m), nodes above", ylabel="pitch (°)")
    plain_axes(ax)
    return line


def team_figure(
    walls: ArrayLike, ways: Sequence[ArrayLike], attempts: Sequence[tuple[float, float, str]], btm: BtmMap, title: str
) -> Figure:
    """Draw a page with the robots' true ways and where they tried to merge their maps, and the merged map, over a plan.

    `walls` as of `trace_figure`; `ways` are `[n, 2]`, metres, of each robot; `attempts` are x, y, metres, and the
    outcome; `btm` is drawn below.
    """
    walls = np.asarray(walls, float)
    width, height = np.ptp(walls.reshape(-1, 2), axis=0)
    wide = min(LONG_IN, 1.2 * LONG_IN * width / height)
    page = Figure(figsize=(wide + 1.0, 2 * wide * height / width + 1.6), layout="constrained")
    above, below = page.subplots(2, 1, sharex=True, sharey=True)
    for i, way in enumerate(ways):
        xy, colour = np.asarray(way), PALETTE[i % len(PALETTE)]
        above.plot(*xy.T, color=colour, linewidth=1.6, alpha=0.7, label=f"way of robot-{i}")
        above.plot(*xy[0], marker="o", color=colour, markeredgecolor="black", markersize=9, zorder=5)
    for outcome, (marker, colour) in OUTCOME_MARKS.items():
        at = np.array([(x, y) for x, y, own in attempts if own == outcome]).reshape(-1, 2)
        if len(at):
            style: dict[str, Any] = {"linestyle": "none", "marker": marker, "markersize": 7, "zorder": 6}
            style |= {"color": colour, "markeredgecolor": "black", "label": outcome.lower().replace("_", " ")}
            above.plot(*at.T, **style)
    draw_btm(below, btm)
    for ax, name in ((above, title), (below, f"map of most robots: {len(btm.nodes)} nodes, {len(btm.links)} links")):
        draw_building(ax, walls, ())
        ax.set(aspect="equal", ylabel="y (m)")
        ax.set_title(wrapped_text(name, int(11 * wide), max_lines=2), fontsize=10, parse_math=False)
    below.set_xlabel("x (m)")
    legend_below(page)
    return page


def draw_building(ax: Axes, walls: Any, points: Any) -> None:
    """Draw walls and scan points."""
    if len(walls):
        lines = list(walls.reshape(-1, 2, 2))
        ax.add_collection(LineCollection(lines, colors=WALL, linewidths=3, zorder=1, label="building"))
    if len(points):
        dot = {"color": POINT, "marker": ".", "linestyle": "none", "markeredgewidth": 0, "markersize": 1.4}
        ax.plot(points[:, 0], points[:, 1], zorder=2, rasterized=True, label="scan point", **dot)


def _limits(btm, walls, trail, points):
    """Return the corners of the drawing, with a margin."""
    nodes = np.array([(node.x_m, node.y_m) for node in btm.nodes]).reshape(-1, 2)
    everything = np.concatenate([walls.reshape(-1, 2), points, trail[:, :2], nodes])
    low, high = (everything.min(0), everything.max(0)) if len(everything) else (np.zeros(2), np.ones(2))
    return low - 1.5 * STUB_M, high + 1.5 * STUB_M


def trace_figure(
    btm: BtmMap, walls: ArrayLike | None, trail: ArrayLike | None = None, points: ArrayLike | None = None,
    modes: ArrayLike = (), mode_names: Sequence[str] = (), title: str = "", *, pitch_deg: ArrayLike | None = None,
    route: Route | None = None,
) -> Figure:  # fmt: skip
    """Draw a page with the building, the run through it and the resulting map.

    Args:
      walls: `[S, 4]` x and y of either end, metres, of the true building; None leaves it out.
      trail: `[T, 3]` x and y, metres, and heading; None leaves it out.
      points: `[P, 2]` points of scans, metres; None leaves them out.
      modes: `[T]` int, index into `mode_names`.
      pitch_deg: `[T]` inclination of the body, degrees: a panel below the map. None for none.
      route: a `Route` over the map, drawn with it. None for none.

    Source:
      The resulting map of Mano et al., whose figure is lost: drawn after its description.
    """
    walls, points, trail = (
        np.zeros((0, n)) if own is None else np.asarray(own, float).reshape(-1, n)
        for own, n in ((walls, 4), (points, 2), (trail, 3))
    )
    low, high = _limits(btm, walls, trail, points)
    pitched = pitch_deg is not None and len(trail) > 0
    width, height = (high - low) * LONG_IN / max(high - low)
    width, height = max(width, 4.0), max(height, 2.6)
    lower = 1.3 if pitched else 0.0
    page = Figure(figsize=(width + LEGEND_IN + 0.7, height + lower + 0.9), layout="constrained")
    axes = page.subplots(1 + pitched, 1, squeeze=False, height_ratios=[height, lower][: 1 + pitched])[:, 0]
    ax = axes[0]
    draw_btm(ax, btm)
    if route is not None:
        draw_route(ax, btm, route)
    draw_building(ax, walls, points)
    draw_trail(ax, trail, modes, mode_names)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    for axis, long_in in ((ax.xaxis, width), (ax.yaxis, height)):  # not left to the layout, which would chase its ticks
        axis.set_major_locator(MaxNLocator(nbins=max(2, round(long_in)), steps=[1, 2, 5, 10]))
    ax.set_xlabel("x (m)", fontsize=8)
    ax.set_ylabel("y (m)", fontsize=8)
    ax.tick_params(labelsize=8)
    if title:
        ax.set_title(wrapped_text(title, int(11 * width), max_lines=2), fontsize=10, parse_math=False)
    if handles := ax.get_legend_handles_labels()[0]:
        page.legend(handles=handles, loc="outside right upper", fontsize=8, frameon=False)
    if pitched:
        draw_pitch(axes[1], btm, trail, pitch_deg)
    page.draw_without_rendering()  # with equal scales the layout needs a first guess
    return page
