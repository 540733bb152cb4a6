"""A benchmark's report as Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jexplore.report.tables import aligned_table

MIB = 2**20


def markdown(header: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Format a Markdown table.

    Args:
      header: column names.
      rows: lists of text and numbers; None becomes a dash, a float three significant digits.
    """

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


def percent(value: float | None) -> str | None:
    """Format a share."""
    return None if value is None else f"{100 * value:.0f} %"


def _mib(n_bytes):
    return None if n_bytes is None else n_bytes / MIB


def kernels(rows: Iterable[Mapping[str, Any]]) -> str:
    """Tabulate kernels and their references: a row each."""
    header = [
        "kernel", "on", "compile s", "CPU µs", "least", "µs by the clock", "floor µs", "k", "reference",
        "its CPU µs", "ratio", "equal",
    ]  # fmt: skip
    lines = []
    for row in rows:
        own = [
            row["kernel"], row["on"], row["trace_s"] + row["compile_s"], row["cpu_us"]["median"], row["cpu_us"]["min"],
            row["wall_us"]["median"], row["floor_us"], row["k"],
        ]  # fmt: skip
        for i, other in enumerate(row["references"]):
            cpu_us = other["cpu_us"] and other["cpu_us"]["median"]
            lines.append([*(own if i == 0 else [""] * len(own)), other["reference"], cpu_us, other["ratio"],
                          other["equal"]])  # fmt: skip
    return markdown(header, lines)


def episodes(rows: Iterable[Mapping[str, Any]]) -> str:
    """Tabulate whole episodes: a row each."""
    header = [
        "world", "cells", "strategy", "engine", "level", "batch", "lanes", "episodes", "ms/episode", "CPU ms",
        "episodes/s", "steps/s", "useful", "path m", "explored", "COMPLETE", "MiB", "estimated", "equal",
    ]  # fmt: skip
    return markdown(header, [
        [
            row["world"].rpartition("/")[2], "{} x {}".format(*row["shape"]), row["strategy"], row["engine"],
            row["level"], row["batch"], row["lanes"], row["episodes"], 1e3 * row["wall_s"]["median"],
            1e3 * row["cpu_s"]["median"], row["episodes_per_s"], row["steps_per_s"], percent(row["useful"]),
            plus_minus(row["quality"]["path_m"]), f"{row['quality']['explored_fraction']:.3f}",
            percent(row["quality"]["complete"]), _mib(row["lane_bytes"]), _mib(row["lane_bytes_estimate"]),
            row["equal"],
        ]
        for row in rows
    ])  # fmt: skip


def programs(rows: Iterable[Mapping[str, Any]]) -> str:
    """Compile times, a row for each program."""
    header = ["level", "first for", "strategy", "padded", "lanes", "trace s", "compile s", "CPU s", "temporary MiB"]
    return markdown(header, [
        [row["level"], row["world"].rpartition("/")[2], row["strategy"], "{} x {}".format(*row["padded_shape"]),
         row["lanes"], row["trace_s"], row["compile_s"], row["cpu_s"],
         None if row["memory"] is None else row["memory"]["temp"] / MIB]
        for row in rows
    ])  # fmt: skip


def tables(report: Mapping[str, Any]) -> str:
    """Format the whole report."""
    parts = [
        ("Kernels", kernels(report["kernels"])),
        ("Episodes by batch size", episodes(report["batches"])),
        ("Episodes by map size", episodes(report["sides"])),
        ("Programs", programs(report["programs"])),
    ]
    return "\n\n".join(f"{title}:\n\n{text}" for title, text in parts if text)
