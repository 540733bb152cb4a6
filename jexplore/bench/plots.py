"""A benchmark's report as pictures: how cost grows with batch size and with map size."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from jexplore.report.plot import wrapped_text
from jexplore.report.plots.looks import looks_of, plain_axes


def _points_by_line(rows, x_name, y_of, names):
    """Group points by line: `{its names: (xs, ys)}`, in ascending order of x."""
    found = {}
    for row in sorted(rows, key=lambda row: row[x_name]):
        xs, ys = found.setdefault(", ".join(str(row[name]).rpartition("/")[2] for name in names), ([], []))
        xs.append(row[x_name])
        ys.append(y_of(row))
    return found


def _draw_lines(ax, lines, title, x_label, y_label):
    looks = looks_of(lines)
    for name, (xs, ys) in lines.items():
        label = wrapped_text(name, 34, max_lines=2).replace("$", r"\$")
        ax.plot(xs, ys, label=label, markersize=4, linewidth=1.2, **looks[name])
    ax.set_xscale("log", base=2)
    ax.set_yscale("log")
    ticks = sorted({x for xs, _ in lines.values() for x in xs})
    ax.set_xticks(ticks)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set(title=title, xlabel=x_label, ylabel=y_label)
    plain_axes(ax, grid="both")
    if lines:
        ax.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def bench_figure(report: Mapping[str, Any]) -> Figure:
    """Draw the report."""
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    by_batch, by_side = figure.subplots(2)
    names = ("world", "strategy", "engine")
    cases = _points_by_line(report["batches"], "batch", lambda row: row["episodes_per_s"], names)
    _draw_lines(by_batch, cases, "episodes by batch size", "episodes, or lanes", "episodes/s")
    cases = _points_by_line(report["sides"], "side", lambda row: 1e3 / row["episodes_per_s"], ("strategy", "engine"))
    title = f"an episode by map size, {report['settings']['generator']}"
    _draw_lines(by_side, cases, title, "cells a side", "ms/episode")
    return figure
