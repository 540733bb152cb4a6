"""Effect of drift on maps: three measures over every odometry error, and a pair of pictures."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from jexplore.report.plot import PALETTE, wrapped_text
from jexplore.report.plot_traces import draw_building
from jexplore.report.plots.looks import FONT, plain_axes
from jexplore.tracemap.picture import draw_btm
from jexplore.tracemap.record import BtmMap

ERROR_NAMES = {
    "length_scale": "encoder length scale",
    "turn_scale": "encoder turn scale",
    "heading_bias_deg_m": "heading bias (°/m)",
    "heading_deg_sqrt_m": "heading walk (°/√m)",
    "slip": "slip of every turn",
}
BTM, GRID, TWICE = PALETTE[0], PALETTE[5], PALETTE[3]
PANEL_IN = 2.1, 1.6
PICTURE_IN = 5.6  # longest height of the pair
HIT = "#222222"


class Pictures(NamedTuple):
    """A run whose grid map is broken and whose Behavioral Trace Map is right."""

    title: str
    walls: np.ndarray  # [S, 4] x and y of either end, metres, of the true building
    cells: np.ndarray  # [n, 2] centres of the grid map's occupied cells, metres, in the odometry's frame
    cell_m: float
    map: BtmMap  # in the odometry's frame
    placed: BtmMap  # with nodes where they truly lie


def draw_curve(ax: Axes, table: Any, name: str, colour: str, *, scale: float = 1.0, label: str = "") -> Any:
    """Draw a measure over the rising values of one error, in a band from `name_low` to `name_high`."""
    x = table["value"].to_numpy(float)
    low, high = (scale * table[f"{name}_{end}"].to_numpy(float) for end in ("low", "high"))
    ax.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
    (line,) = ax.plot(x, scale * table[name].to_numpy(float), "o-", color=colour, ms=3, lw=1.4, label=label)
    return line


def draw_cells(ax: Axes, centres: Any, cell_m: float) -> PatchCollection:
    """Draw occupied cells, `[n, 2]` centres in metres; return the `PatchCollection`."""
    half = cell_m / 2
    squares = [Rectangle((x - half, y - half), cell_m, cell_m) for x, y in np.asarray(centres)]
    cells = PatchCollection(squares, facecolor=HIT, edgecolor="none", zorder=2, rasterized=True)
    ax.add_collection(cells)
    return cells


def drift_figure(summary: Any, pictures: Pictures | None = None) -> Figure:
    """Draw a column of panels for every error: structure, coordinates, grid map; below two pictures of one run.

    `summary` is from `study.summarised`.
    """
    errors = list(dict.fromkeys(summary["error"]))
    width, below = max(PANEL_IN[0] * len(errors) + 0.6, 6.4), 0.0
    if pictures is not None:
        low, high = _limits(pictures)
        below = float(min(PICTURE_IN, (width / 2) * (high - low)[1] / (high - low)[0] + 0.5))
    page = Figure(figsize=(width, 3 * PANEL_IN[1] + below + 0.5), layout="constrained")
    parts: Any = page.subfigures(2, 1, height_ratios=[3 * PANEL_IN[1], below]) if below else [page]
    upper, *lower = parts
    axes = upper.subplots(3, len(errors), sharey="row", sharex="col", squeeze=False)
    for column, error in zip(axes.T, errors):
        own = summary[summary["error"] == error]
        draw_curve(column[0], own, "true", BTM, scale=100)
        draw_curve(column[1], own, "node_error_m", BTM)
        draw_curve(column[2], own, "on_wall", GRID, scale=100, label="cells on a true wall")
        draw_curve(column[2], own, "doubled", TWICE, scale=100, label="wall drawn twice")
        column[2].set_xlabel(wrapped_text(ERROR_NAMES.get(error, error), 26), fontsize=FONT)
        for ax in column:
            plain_axes(ax, grid="y")
            ax.tick_params(labelsize=7)
    for ax, label in zip(axes[:, 0], ("maps with the true\nstructure (%)", "nodes off by (m)", "grid map (%)")):
        ax.set_ylabel(label, fontsize=FONT)
    for row in (0, 2):
        axes[row, 0].set_ylim(-4, 104)
    axes[1, 0].set_ylim(bottom=0)
    axes[2, -1].legend(fontsize=7, frameon=False, loc="center right")
    if pictures is not None:
        _draw_pair(lower[0], pictures)
    return page


def _limits(pictures):
    """Return the corners of the whole pair, with a margin."""
    nodes = [(n.x_m, n.y_m) for btm in (pictures.map, pictures.placed) for n in btm.nodes]
    points = np.concatenate([pictures.walls.reshape(-1, 2), pictures.cells, np.array(nodes).reshape(-1, 2)])
    return points.min(axis=0) - 0.5, points.max(axis=0) + 0.5


def _draw_pair(page, pictures):
    low, high = _limits(pictures)
    axes = page.subplots(1, 2)
    draw_cells(axes[0], pictures.cells, pictures.cell_m)
    draw_btm(axes[1], pictures.placed)
    draw_building(axes[1], pictures.walls, ())
    axes[1].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=7, frameon=False)
    titles = "grid map, drawn by odometry", "trace map, nodes where they truly lie"
    for ax, title in zip(axes, titles):
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        ax.set_xlabel("x (m)", fontsize=FONT)
        ax.tick_params(labelsize=7)
        ax.set_title(title, fontsize=9)
    axes[0].set_ylabel("y (m)", fontsize=FONT)
    page.suptitle(wrapped_text(f"one run: {pictures.title}", 90, max_lines=2), fontsize=9, parse_math=False)
