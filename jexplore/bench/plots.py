"""A benchmark's report as pictures: how cost grows with batch size and with map size."""

import itertools
from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from jexplore.report.plot import PALETTE, wrapped_text

MARKERS = "osD^vP*X<>"


def _lines(rows, x_of, y_of, name_of):
    """Group points by line: `{name: (xs, ys)}`, in ascending order of x."""
    found = {}
    for row in sorted(rows, key=x_of):
        xs, ys = found.setdefault(name_of(row), ([], []))
        xs.append(x_of(row))
        ys.append(y_of(row))
    return found


def _draw(ax, lines, title, x_label, y_label):
    looks = zip(itertools.cycle(PALETTE), itertools.cycle(MARKERS))
    for (name, (xs, ys)), (colour, marker) in zip(lines.items(), looks):
        label = ax.plot(xs, ys, color=colour, marker=marker, markersize=4, linewidth=1.2)[0]
        label.set_label(wrapped_text(name, 34, max_lines=2).replace("$", r"\$"))
    ax.set_xscale("log", base=2)
    ax.set_yscale("log")
    ticks = sorted({x for xs, _ in lines.values() for x in xs})
    ax.set_xticks(ticks)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_title(title, fontsize=10)
    ax.set_xlabel(x_label)
    ax.set_ylabel(y_label)
    ax.grid(True, which="major", linewidth=0.4, alpha=0.6)
    ax.spines[["top", "right"]].set_visible(False)
    if lines:
        ax.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def figure(report: Mapping[str, Any]) -> Figure:
    """Draw the report as a matplotlib `Figure`."""
    figure = Figure(figsize=(9, 11), layout="constrained")
    by_batch, by_side, by_kernel = figure.subplots(3)

    def case(row):
        return f"{row['world'].rpartition('/')[2]}, {row['strategy']}, {row['engine']}"

    lines = _lines(report["batches"], lambda row: row["batch"], lambda row: row["episodes_per_s"], case)
    _draw(by_batch, lines, "episodes by batch size", "episodes, or lanes", "episodes/s")
    lines = _lines(
        report["sides"], lambda row: max(row["shape"]), lambda row: 1e3 / row["episodes_per_s"],
        lambda row: f"{row['strategy']}, {row['engine']}",
    )  # fmt: skip
    _draw(by_side, lines, f"an episode by map size, {report['settings']['generator']}", "cells a side", "ms/episode")
    rows = [row for row in report["kernels"] if "side" in row]
    lines = _lines(rows, lambda row: row["side"], lambda row: row["us"], lambda row: row["kernel"])
    _draw(by_kernel, lines, "whole-map kernels by map size", "cells a side", "µs")
    return figure
