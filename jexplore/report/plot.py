"""Pictures: parts of maps and paths, and one episode.

The `draw_*` functions take arrays and an `Axes` and return the artists, which are labelled for a legend; the `*_figure`
functions compose them into a `Figure` that no window or global state knows of (save it with `save_figure`). Arrays are
`(row, col)` with row 0 at the bottom; axes are in metres from the lower left corner of cell (0, 0). A map state is
uint8: 0 unknown, 1 free, 2 occupied.
"""

import math
import os
import re
import textwrap
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.image import AxesImage
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


class _NameWrapper(textwrap.TextWrapper):
    """Breaks names of worlds and strategies before + : @ / # and after a comma or blank."""

    wordsep_re = re.compile(r"(?=[+:@/#])|(?<=[, ])")


def wrapped_text(text: object, width: int, *, max_lines: int = 3) -> str:
    """Wrap `text` into at most `max_lines` lines of at most `width` characters.

    Lines break as `_NameWrapper` says; what does not fit loses its middle to an ellipsis.
    """
    text = " ".join(str(text).split())
    wrap, keep = _NameWrapper(width).wrap, len(text)
    lines = wrap(text)
    while len(lines) > max_lines:
        keep -= 1
        lines = wrap(text[: keep // 3] + "…" + text[len(text) - keep + keep // 3 :])
    return "\n".join(lines)


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


def draw_map(ax: Axes, state: Any, cell_m: float, origin_m: tuple[float, float] = (0.0, 0.0)) -> AxesImage:
    """Draw the known map: unknown grey, free white, occupied black; its lower left corner lies at `origin_m`.

    The image is RGB, so that a wall thinner than a pixel darkens it instead of vanishing.
    """
    return draw_colours(ax, MAP_RGB[np.asarray(state)], cell_m, origin_m)


def draw_colours(
    ax: Axes, colours: Any, cell_m: float, origin_m: tuple[float, float] = (0.0, 0.0), **properties: Any
) -> AxesImage:
    """Draw cells in colours, `[H, W, 3]` uint8; `properties` are of the image."""
    (x, y), (height, width) = origin_m, colours.shape[:2]
    extent = (x, x + width * cell_m, y, y + height * cell_m)
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
    line = _progress_line(ax, xy, np.cumsum(np.hypot(*(xy[1:] - xy[:-1]).T)), width)
    (start,) = ax.plot(*xy[0], "o", ms=7, mfc="white", mec="black", mew=1.6, zorder=5, label="start")
    (end,) = ax.plot(*xy[-1], "X", ms=8, mfc="black", mec="white", mew=0.9, zorder=6, label="end")
    return line, start, end


def _progress_line(ax, xy, driven, width):
    """Draw a line in the colours of `PROGRESS`, by the way driven at the end of each piece."""
    line = LineCollection(list(np.stack([xy[:-1], xy[1:]], axis=1)), cmap=PROGRESS, linewidths=width, zorder=3)
    line.set(array=driven / max(driven[-1], 1e-12) if len(driven) else driven, clim=(0.0, 1.0), capstyle="round")
    return ax.add_collection(line, autolim=False)


def draw_estimate(ax: Axes, rows: Any, cols: Any, cell_m: float) -> Line2D:
    """Draw the path as the robot takes it to be; return the `Line2D`."""
    xy = _centres_m(cols, cell_m), _centres_m(rows, cell_m)
    (line,) = ax.plot(*xy, color=TARGET, lw=0.8, ls="--", zorder=4, label="estimated path", scalex=False, scaley=False)
    return line


def panel_in(shapes: Any, long_in: float) -> tuple[float, float]:
    """Return width and height, inches, of a panel that holds maps of all `shapes` (rows, cols)."""
    widths = [min(long_in, 1.25 * long_in * cols / rows) for rows, cols in shapes]
    heights = [width * rows / cols for width, (rows, cols) in zip(widths, shapes)]
    return max(*widths, 0.5 * long_in), max(*heights, 0.3 * long_in)


def episode_figure(state: Any, rows: Any, cols: Any, cell_m: float, *,
                   path_m: Any, known_cells: Any, title: str = "", estimate: Any = None) -> Figure:  # fmt: skip
    """Draw one episode: the final map with its path, and the growth of the known area along the path.

    `estimate` are rows and columns of the path as the robot takes it to be, if that differs. `path_m` and `known_cells`
    are the path length at each scan, `[T]`, and the cells known after it.
    """
    width, height = panel_in([np.shape(state)], long_in=5.2)
    figure = Figure(figsize=(width + 4.4, max(height, 3.2) + 0.7), layout="constrained")
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [width, 4.0]})
    draw_map(left, state, cell_m)
    _, *marks = [draw_path(left, *way, cell_m) for way in ways_of(rows, cols)].pop()
    marks += [] if estimate is None else [draw_estimate(left, estimate[0], estimate[1], cell_m)]
    left.set(xlabel="x (m)", ylabel="y (m)")
    figure.legend(handles=marks, loc="outside lower left", ncols=2, frameon=False, fontsize=8)
    draw_coverage(right, path_m, np.asarray(known_cells) * cell_m**2)
    title = wrapped_text(title, int(11 * figure.get_figwidth()), max_lines=2)
    figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def draw_coverage(ax: Any, path_m: Any, known_m2: Any) -> LineCollection:
    """Draw the known area over path length, in colours like the path, with its share of the final area on the right."""
    xy = np.stack([path_m, known_m2], axis=-1).astype(np.float64)
    end_m, final_m2 = max(float(xy[-1, 0]), 1e-9), max(float(xy[-1, 1]), 1e-9)
    line = _progress_line(ax, xy, xy[1:, 0], 2.2)
    ax.set(xlim=(0, 1.02 * end_m), ylim=(0, 1.05 * final_m2), xlabel="path length (m)", ylabel="known area (m²)")
    ax.grid(alpha=0.3)
    ax.spines[["top", "right"]].set_visible(False)
    share = ax.secondary_yaxis("right", functions=(lambda m2: 100 * m2 / final_m2, lambda s: s * final_m2 / 100))
    share.set_yticks([0, 25, 50, 75, 100])
    share.set_ylabel("share of the area known in the end (%)")
    share.spines["right"].set_visible(False)
    return line
