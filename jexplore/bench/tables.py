"""A benchmark's report as Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jexplore.report.tables import aligned_table


def markdown(header: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Format a Markdown table; None becomes a dash, a float three significant digits."""

    def text(value):
        if value is None:
            return "–"
        if isinstance(value, bool):
            return "yes" if value else "NO"
        if not isinstance(value, float):
            return str(value)
        return f"{value:.0f}" if abs(value) >= 100 else f"{value:#.3g}".rstrip(".")

    return aligned_table(header, [[text(value) for value in row] for row in rows], left=header[:1]).rstrip("\n")


def plus_minus(value: Mapping[str, Any]) -> str:
    """Format mean and standard error."""
    return f"{value['mean']:.1f}" + ("" if value["se"] is None else f" ± {value['se']:.1f}")


def bench_tables(report: Mapping[str, Any]) -> str:
    """Format the whole report: a row an engine and batch size."""
    header = [
        "world", "cells", "strategy", "engine", "level", "batch", "episodes", "compile s", "ms/episode", "CPU ms",
        "episodes/s", "steps/s", "ms/plan", "path m", "explored", "COMPLETE", "equal",
    ]  # fmt: skip
    return markdown(header, [
        [
            row["world"].rpartition("/")[2], "{} x {}".format(*row["shape"]), row["strategy"], row["engine"],
            row["level"], row["batch"], row["episodes"], row["compile_s"] or None, 1e3 * row["wall_s"]["median"],
            1e3 * row["cpu_s"]["median"], row["episodes_per_s"], row["steps_per_s"],
            1e3 / row["plans_per_s"] if row["plans_per_s"] else None, plus_minus(row["quality"]["path_m"]),
            f"{row['quality']['explored_fraction']:.3f}", f"{row['quality']['complete']:.0%}", row["equal"],
        ]
        for row in report["batches"]
    ])  # fmt: skip
