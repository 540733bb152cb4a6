"""Common parts of pictures of several strategies: styles, legends, grids of panels, axes of ratios."""

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from jexplore.report.plot import PALETTE, wrapped_text

COLOURS = (*PALETTE[:6], "#000000")
"""For lines and points: the palette without its yellow and grey, which thin marks on white would lose."""
LINES = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (5, 1.4, 1.2, 1.4)))
LINE_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
FONT = 8  # points
GREY = "#777777"


def looks_of(strategies: Iterable[Any]) -> dict[Any, dict[str, Any]]:
    """Return `{strategy: line properties}` in the order given: a colour, a mark, and from the eighth on another line.

    No two of the first 28 look alike, in grey neither: marks and lines tell them apart.
    """
    return {
        name: {
            "color": COLOURS[i % len(COLOURS)],
            "linestyle": LINES[i // len(COLOURS) % len(LINES)],
            "marker": LINE_MARKERS[(i + i // len(COLOURS)) % len(LINE_MARKERS)],
        }
        for i, name in enumerate(strategies)
    }


def plain_axes(ax: Axes, *, grid: Any = None) -> None:
    """Style axes: small numbers, no upper and right edge, a pale grid along `grid`, no mathematics in names."""
    ax.tick_params(labelsize=FONT)
    ax.spines[["top", "right"]].set_visible(False)
    for label in (ax.xaxis.label, ax.yaxis.label):
        label.set_fontsize(FONT)
    for text in (ax.title, ax.xaxis.label, ax.yaxis.label, *ax.get_yticklabels(), *ax.get_xticklabels()):
        text.set_parse_math(False)
    if grid:
        ax.grid(axis=grid, color="#e4e4e4", linewidth=0.7)
        ax.set_axisbelow(True)


def curves_page(titles: Sequence[object], xlabel: str, ylabel: str, **how: Any) -> tuple[Figure, list[Axes]]:
    """Make a page with a panel of curves for every title; return it and the panels' axes, styled.

    The axes have labels at the edge of the page only. `how` is of `Figure.subplots`: which axes are shared.
    """
    count = len(titles)
    n_cols = count if count <= 3 else 2 if count == 4 else 3 if count <= 9 else 4
    wide, tall = (3.5, 2.7) if count > 1 else (5.4, 3.6)
    n_rows = math.ceil(count / n_cols)
    page = Figure(figsize=(max(wide * n_cols + 0.4, 5.0), tall * n_rows + 0.3), layout="constrained")
    grid = page.subplots(n_rows, n_cols, squeeze=False, **how).ravel()
    for number, (ax, title) in enumerate(itertools.zip_longest(grid, titles)):
        if number >= count:
            ax.set_visible(False)
            continue
        ax.set_title(wrapped_text(title, 44, max_lines=2), fontsize=9)
        ax.set_xlabel(xlabel if number + n_cols >= count else "")
        ax.set_ylabel(ylabel if number % n_cols == 0 else "")
        plain_axes(ax, grid="both")
    return page, list(grid[:count])


def legend_below(page: Figure) -> None:
    """Add a legend of all labelled artists below the panels, in columns that fit; the page grows by its height."""
    found = {}
    for ax in page.axes:
        for handle, label in zip(*ax.get_legend_handles_labels()):
            found.setdefault(label, handle)
    texts = [wrapped_text(label, 38, max_lines=2) for label in found]
    longest = max((len(line) for text in texts for line in text.split("\n")), default=1)
    n_cols = max(1, min(len(texts), int(page.get_figwidth() / (0.068 * longest + 0.55))))
    n_rows = math.ceil(len(texts) / n_cols)
    page.set_figheight(page.get_figheight() + n_rows * (0.16 + 0.12 * max(text.count("\n") for text in [*texts, ""])))
    place = {"loc": "outside lower center", "ncols": n_cols, "frameon": False, "fontsize": FONT}
    legend = page.legend(found.values(), texts, **place, handlelength=2.6, columnspacing=1.4)
    for text in legend.get_texts():
        text.set_parse_math(False)


def ratio_scale(ax: Any, name: str, low: float, high: float) -> None:
    """Make the axis "x" or "y" logarithmic, from `low` to `high`, with some five round numbers."""
    axis = {"x": ax.xaxis, "y": ax.yaxis}[name]
    ax.set(**{f"{name}scale": "log"})
    decades = math.log10(high / low)
    wide = LogLocator(subs=(1, 1.5, 2, 3, 5, 7) if decades < 1 else (1, 2, 5) if decades < 3 else (1,), numticks=7)
    axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]) if high < 3 * low else wide)
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    ax.set(**{f"{name}lim": (low, high)})


def ratio_range(estimates: Any, ends: Any = ()) -> tuple[float, float]:
    """Return the range of an axis of ratios: all estimates and 1, and interval ends within a factor of two of these."""
    some = np.concatenate([np.ravel(np.asarray(estimates, np.float64)), [1.0]])
    some = some[np.isfinite(some) & (some > 0)]
    low, high = float(some.min()), float(some.max())
    ends = np.ravel(np.asarray(ends, np.float64))
    ends = np.clip(ends[np.isfinite(ends) & (ends > 0)], low / 2, high * 2)
    low, high = min([low, *ends.tolist()]), max([high, *ends.tolist()])
    margin = max(high / low, 1.1) ** 0.06
    return low / margin, high * margin
