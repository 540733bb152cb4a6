"""Pictures: maps with paths, contact sheets.

The `draw_*` functions take arrays and an `Axes` and return the artists; the `*_figure` functions compose
them into a `Figure` that no window or global state knows of (save it with `save_figure`). Arrays are `(row, col)` with
row 0 at the bottom; axes are in metres from the lower left corner of cell (0, 0). A map state is uint8: 0 unknown, 1
free, 2 occupied.
"""

import itertools
import math
import os
import re
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.path import Path as Outline
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from jexplore.config import InputError
from jexplore.report.store import atomic

PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999")
"""Okabe and Ito's colours, told apart by colour-blind readers; a ninth strategy starts over with a hatch."""
MAP_RGB = np.array([[184, 184, 184], [255, 255, 255], [0, 0, 0]], dtype=np.uint8)
"""Colours of the map states unknown, free, occupied."""
FRONTIER, TARGET = "#e01010", "#0072b2"
PROGRESS = ListedColormap(matplotlib.colormaps["plasma"](np.linspace(0.0, 0.85, 256)), name="progress")
"""Start to end of a path; without the pale end, which white floor would swallow."""
ARROW = Outline([(1.0, 0.0), (-0.6, 0.6), (-0.3, 0.0), (-0.6, -0.6), (1.0, 0.0)], closed=True)
"""The robot: an arrow head along x."""


def save_figure(figure: Figure, path: str | os.PathLike[str], *, dpi: float = 150) -> None:
    """Write a figure in the format of the file's ending, whole or not at all: pixels (png) or a vector (svg, pdf).

    Without an ending it is a PNG. Equal figures give equal files. A PDF holds fonts that can be edited (TrueType).
    """
    ending, known = os.path.splitext(path)[1].lstrip(".").lower() or "png", figure.canvas.get_supported_filetypes()
    if ending not in known:
        raise InputError(f"{path} must end in .png, .svg or .pdf, got .{ending}")
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with atomic(path) as part, matplotlib.rc_context({"pdf.fonttype": 42, "svg.hashsalt": "jexplore"}):
        small: Any = {"pil_kwargs": {"optimize": True}} if ending == "png" else {}
        figure.savefig(part, format=ending, dpi=dpi, metadata=dates.get(ending), **small)


def wrapped_text(text: object, width: int, *, max_lines: int = 3) -> str:
    """Wrap `text` into at most `max_lines` lines of at most `width` characters.

    Lines break before + : @ / # and after a comma or blank; what does not fit loses its middle to an ellipsis.
    """
    text = " ".join(str(text).split())
    short, keep = text, len(text)
    while (lines := _filled(short, width)).count("\n") >= max_lines:
        keep -= 1
        short = text[: keep // 3] + "…" + text[len(text) - keep + keep // 3 :]
    return lines


def _filled(text, width):
    lines = [""]
    for piece in re.split(r"(?=[+:@/#])|(?<=[, ])", text):
        if lines[-1] and len(lines[-1]) + len(piece.rstrip()) > width:
            lines.append("")
        lines[-1] += piece
        while len(lines[-1].rstrip()) > width:
            lines[-1:] = [lines[-1][:width], lines[-1][width:]]
    return "\n".join(line.strip() for line in lines)


def _plain(*texts):
    """Show `$` and `_` in names as they are."""
    for text in texts:
        text.set_parse_math(False)


def round_length(most: float) -> float:
    """Return the longest length of 1, 2 or 5 times a power of ten that is not above `most`, for a scale bar."""
    unit = 10.0 ** math.floor(math.log10(most))
    return max(step * unit for step in (1, 2, 5) if step * unit <= most)


def scale_bar(ax: Axes) -> AnchoredSizeBar:
    """Draw a scale bar below a map in metres, at its left end, in place of ticks; at most a third of its width."""
    ax.set(xticks=[], yticks=[])
    length = round_length(abs(np.subtract(*ax.get_xlim())) / 3)
    place: Any = {"loc": "upper left", "bbox_to_anchor": (0.0, 0.0), "bbox_transform": ax.transAxes}
    bar = AnchoredSizeBar(
        ax.transData, length, f"{length:g} m", frameon=False, borderpad=0.5, pad=0, sep=2, label_top=False,
        fontproperties=FontProperties(size=7), **place,
    )  # fmt: skip
    ax.add_artist(bar)
    return bar


def _centres_m(cells, cell_m):
    return (np.asarray(cells, dtype=np.float64) + 0.5) * cell_m


def _grid(count):
    """Return rows and columns for `count` panels."""
    n_cols = count if count <= 3 else min(4, math.ceil(math.sqrt(count)))
    return math.ceil(count / n_cols), n_cols


def draw_map(ax: Axes, state: Any, cell_m: float) -> Any:
    """Draw the known map: unknown grey, free white, occupied black.

    The image is RGB, so that a wall thinner than a pixel darkens it instead of vanishing.
    """
    return _image(ax, MAP_RGB[np.asarray(state)], cell_m)


def _image(ax, colours, cell_m, **properties):
    extent = (0.0, colours.shape[1] * cell_m, 0.0, colours.shape[0] * cell_m)
    return ax.imshow(colours, extent=extent, origin="lower", aspect="equal", **properties)


def ways_of(rows: Any, cols: Any) -> list[tuple[Any, Any]]:
    """Return the paths that are joined in one, with NaN between two robots': pairs of rows and columns."""
    cuts = np.flatnonzero(np.isnan(np.asarray(rows, np.float64)))
    parts = zip([0, *(cuts + 1)], [*cuts, len(rows)])
    return [(rows[begin:end], cols[begin:end]) for begin, end in parts]


def draw_path(ax: Axes, rows: Any, cols: Any, cell_m: float, *, width: float = 1.4) -> tuple[Any, Line2D, Line2D]:
    """Draw the driven path, coloured from start to end by distance driven, the start a ring and the end a cross.

    Return `(line, start, end)`: a `LineCollection` of a segment a step, valued 0 to 1, and two markers.
    """
    xy = np.stack([_centres_m(cols, cell_m), _centres_m(rows, cell_m)], axis=-1)
    if len(xy) == 0:
        raise ValueError("expected a path of one or more cells, got an empty one")
    pieces = np.stack([xy[:-1], xy[1:]], axis=1)
    driven = np.cumsum(np.hypot(*(xy[1:] - xy[:-1]).T))
    line = LineCollection(list(pieces), cmap=PROGRESS, linewidths=width, capstyle="round", zorder=3)
    line.set_array(driven / max(driven[-1], 1e-12) if len(driven) else driven)
    line.set_clim(0.0, 1.0)
    ax.add_collection(line, autolim=False)
    (start,) = ax.plot(*xy[0], "o", ms=7, mfc="white", mec="black", mew=1.6, zorder=5, label="start")
    (end,) = ax.plot(*xy[-1], "X", ms=8, mfc="black", mec="white", mew=0.9, zorder=6, label="end")
    return line, start, end


def draw_estimate(ax: Axes, rows: Any, cols: Any, cell_m: float) -> Line2D:
    """Draw the path as the robot takes it to be; return the `Line2D`."""
    xy = _centres_m(cols, cell_m), _centres_m(rows, cell_m)
    (line,) = ax.plot(*xy, color=TARGET, lw=0.8, ls="--", zorder=4, label="estimated path", scalex=False, scaley=False)
    return line


def _panel_in(shapes, *, long_in):
    """Return width and height, inches, of a panel that holds maps of all `shapes` (rows, cols)."""
    widths = [min(long_in, 1.25 * long_in * cols / rows) for rows, cols in shapes]
    heights = [width * rows / cols for width, (rows, cols) in zip(widths, shapes)]
    return max(*widths, 0.5 * long_in), max(*heights, 0.3 * long_in)


def _path_legend(figure, axes, marks):
    """Draw a colour bar below the panels, and next to it the two marks of `draw_path`."""
    share = min(0.62, 3.6 / figure.get_figwidth())
    place = {"location": "bottom", "shrink": share, "fraction": 0.03, "pad": 0.03, "aspect": 30, "anchor": (0, 0)}
    bar = figure.colorbar(ScalarMappable(cmap=PROGRESS), ax=axes, **place)
    bar.set_ticks([0, 1], labels=["start", "end of the path"], fontsize=8)
    bar.outline.set_visible(False)
    style = {"frameon": False, "fontsize": 8, "ncols": 2, "borderaxespad": 0.0}
    bar.ax.legend(handles=marks, loc="center left", bbox_to_anchor=(1.1, 0.5), **style)


def paths_figure(entries: Sequence[tuple[str, Sequence[tuple[str, Any, Any, Any, float, float]]]]) -> Figure:
    """Draw the map as each strategy saw it with its path: a row, of any length, a world, a column a strategy.

    `entries` are `(world name, panels)`; a panel is `(strategy, state, rows, cols, cell_m, path_m)`: the final map `[H,
    W]` uint8, the cells driven `[N]` (see `ways_of`), the edge of a cell and the path length, metres.
    """
    n_cols = max(len(panels) for _, panels in entries)
    sizes = [_panel_in([np.shape(panel[1]) for panel in panels], long_in=3.0) for _, panels in entries]
    width, heights = max(size[0] for size in sizes), [size[1] for size in sizes]
    tall_in = sum(heights) + 0.65 * len(heights) + 0.6
    figure = Figure(figsize=(max(width * n_cols + 0.5, 3.6), tall_in), layout="constrained")
    grid, marks = figure.subplots(len(entries), n_cols, squeeze=False, gridspec_kw={"height_ratios": heights}), ()
    for line, height, (world, panels) in zip(grid, heights, entries):
        for ax, panel in itertools.zip_longest(line, panels):
            if panel is None:
                ax.set_visible(False)
                continue
            strategy, state, rows, cols, cell_m, path_m = panel
            draw_map(ax, state, cell_m)
            for way in ways_of(rows, cols):
                marks = draw_path(ax, *way, cell_m)[1:]
            scale_bar(ax)
            _plain(ax.set_title(f"{wrapped_text(strategy, int(11 * width), max_lines=2)}\n{path_m:.1f} m", fontsize=9))
        _plain(line[0].set_ylabel(wrapped_text(world, int(12 * height), max_lines=3), fontsize=9))
    _path_legend(figure, list(grid.flat), marks)
    return figure


def episode_figure(state: Any, rows: Any, cols: Any, cell_m: float, *,
                   path_m: Any, known_cells: Any, title: str = "", estimate: Any = None) -> Figure:  # fmt: skip
    """Draw one episode: the final map with its path, and the growth of the known area along the path.

    `estimate` are rows and columns of the path as the robot takes it to be, if that differs. `path_m` and `known_cells`
    are the path length at each scan, `[T]`, and the cells known after it.
    """
    width, height = _panel_in([np.shape(state)], long_in=5.2)
    figure = Figure(figsize=(width + 4.4, max(height, 3.2) + 0.7), layout="constrained")
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [width, 4.0]})
    draw_map(left, state, cell_m)
    _, *marks = [draw_path(left, *way, cell_m) for way in ways_of(rows, cols)].pop()
    marks += [] if estimate is None else [draw_estimate(left, estimate[0], estimate[1], cell_m)]
    left.set(xlabel="x (m)", ylabel="y (m)")
    figure.legend(handles=marks, loc="outside lower left", ncols=2, frameon=False, fontsize=8)
    draw_coverage(right, path_m, np.asarray(known_cells) * cell_m**2)
    _plain(figure.suptitle(wrapped_text(title, int(11 * figure.get_figwidth()), max_lines=2), fontsize=11))
    return figure


def draw_coverage(ax: Any, path_m: Any, known_m2: Any) -> LineCollection:
    """Draw the known area over path length, in colours like the path, with its share of the final area on the right."""
    xy = np.stack([path_m, known_m2], axis=-1).astype(np.float64)
    end_m, final_m2 = max(float(xy[-1, 0]), 1e-9), max(float(xy[-1, 1]), 1e-9)
    line = LineCollection(list(np.stack([xy[:-1], xy[1:]], axis=1)), cmap=PROGRESS, linewidths=2.2, capstyle="round")
    line.set_array(xy[1:, 0] / end_m)
    line.set_clim(0.0, 1.0)
    ax.add_collection(line)
    ax.set(xlim=(0, 1.02 * end_m), ylim=(0, 1.05 * final_m2), xlabel="path length (m)", ylabel="known area (m²)")
    ax.grid(alpha=0.3)
    ax.spines[["top", "right"]].set_visible(False)
    share = ax.secondary_yaxis("right", functions=(lambda m2: 100 * m2 / final_m2, lambda s: s * final_m2 / 100))
    share.set_yticks([0, 25, 50, 75, 100])
    share.set_ylabel("share of the area known in the end (%)")
    share.spines["right"].set_visible(False)
    return line


def worlds_figure(worlds: Sequence[tuple[str, Any]]) -> Figure:
    """Draw a contact sheet of floor plans with their names: rooms, start, free area, number of rooms."""
    n_rows, n_cols = _grid(len(worlds))
    shapes = [world.shape for _, world in worlds]
    sizes = [_panel_in(shapes[i : i + n_cols], long_in=3.0) for i in range(0, len(shapes), n_cols)]
    width, heights = max(size[0] for size in sizes), [size[1] for size in sizes]
    figure = Figure(figsize=(width * n_cols + 0.2, sum(heights) + 0.8 * n_rows), layout="constrained")
    grid = figure.subplots(n_rows, n_cols, squeeze=False, gridspec_kw={"height_ratios": heights})
    for ax, entry in itertools.zip_longest(grid.flat, worlds):
        if entry is None:
            ax.set_visible(False)
            continue
        name, world = entry
        world.plot(ax).set(xlabel="", ylabel="")
        scale_bar(ax)
        n_rooms = 0 if world.rooms is None else len(np.unique(world.rooms[world.rooms >= 0]))
        rooms = f", {n_rooms} room{'s' if n_rooms > 1 else ''}" if n_rooms else ""
        name = wrapped_text(name, int(11 * width), max_lines=2)
        _plain(ax.set_title(f"{name}\n{world.free_m2:.0f} m² free{rooms}", fontsize=9))
    return figure
