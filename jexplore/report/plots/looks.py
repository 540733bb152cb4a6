"""Common parts of pictures of several strategies: styles, legends, grids of panels, axes of ratios."""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from jexplore.report.plot import PALETTE, wrapped_text

COLOURS = (*PALETTE[:6], "#000000")
"""For lines and points: the palette without its yellow and grey, which thin marks on white would lose."""
LINES = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (5, 1.4, 1.2, 1.4)))
LINE_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
FONT = 8  # points
GREY = "#777777"


def band_of(count: int) -> float:
    """Return the opacity of the bands of a number of strategies; many are more transparent, as they overlap."""
    return min(0.18, 0.6 / max(count, 1))


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


def panels(figure: Figure, count: int, n_cols: int, **how: Any) -> Iterator[tuple[int, Axes, bool]]:
    """Yield `(number, axes, bool: none below)` of `count` panels in rows of `n_cols`; places left over stay empty."""
    n_rows = math.ceil(count / n_cols)
    grid = figure.subplots(n_rows, n_cols, squeeze=False, **how)
    for number, ax in enumerate(grid.flat):
        if number >= count:
            ax.set_visible(False)
            continue
        yield number, ax, number + n_cols >= count


def panels_page(count: int) -> tuple[Figure, int]:
    """Make a page for `count` panels of curves with a legend below, and return how many stand side by side."""
    n_cols = count if count <= 3 else 2 if count == 4 else 3 if count <= 9 else 4
    wide, tall = (3.5, 2.7) if count > 1 else (5.4, 3.6)
    size = (max(wide * n_cols + 0.4, 5.0), tall * math.ceil(count / n_cols) + 0.3)
    return Figure(figsize=size, layout="constrained"), n_cols


def legend_below(figure: Figure, handles: Sequence[Any], labels: Sequence[object]) -> None:
    """Add a legend below the panels, in as many columns as fit; the figure grows by its height."""
    texts = [wrapped_text(label, 38, max_lines=2) for label in labels]
    longest = max((len(line) for text in texts for line in text.split("\n")), default=1)
    n_cols = max(1, min(len(texts), int(figure.get_figwidth() / (0.068 * longest + 0.55))))
    n_rows = math.ceil(len(texts) / n_cols)
    figure.set_figheight(figure.get_figheight() + n_rows * (0.16 + 0.12 * max(text.count("\n") for text in texts)))
    place = {"loc": "outside lower center", "ncols": n_cols, "frameon": False, "fontsize": FONT}
    legend = figure.legend(handles, texts, **place, handlelength=2.6, columnspacing=1.4)
    for text in legend.get_texts():
        text.set_parse_math(False)


def ratio_ticks(low: float, high: float) -> list[float]:
    """Return about four to seven round numbers from `low` to `high`, for an axis of ratios, on a logarithmic scale."""
    for step in (0.01, 0.02, 0.05, 0.1, 0.2, 0.25):
        if (high - low) / step <= 6 and high / low < 3:
            return [round(step * k, 4) for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for digits in ((1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        ticks = [digit * 10.0**decade for decade, digit in itertools.product(decades, digits)]
        ticks = [tick for tick in ticks if low * 0.999 <= tick <= high * 1.001]
        if len(ticks) <= 7:
            return ticks
    return ticks[:: math.ceil(len(ticks) / 6)]


def ratio_scale(ax: Any, name: str, low: float, high: float) -> None:
    """Make the axis "x" or "y" logarithmic, from `low` to `high`, with round numbers."""
    axis = {"x": ax.xaxis, "y": ax.yaxis}[name]
    ax.set(**{f"{name}scale": "log"})
    axis.set_major_locator(FixedLocator(ratio_ticks(low, high)))
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
