"""Numbers and tables as text."""

import math
import re
from collections.abc import Collection, Iterable, Sequence


def number_text(value: float, decimals: int) -> str:
    """Format a number with a number of decimals; a missing one is `-`."""
    return "-" if not math.isfinite(value) else f"{value:.{decimals}f}"


def spread_text(mean: float, sd: float) -> str:
    """Format `mean ± sd` with two decimals, without a missing part."""
    return number_text(mean, 2) + (f" ± {sd:.2f}" if math.isfinite(sd) else "")


def interval_text(low: float, high: float, decimals: int) -> str:
    """Format `[low, high]`; one with a missing end is `-`."""
    return "-" if not (math.isfinite(low) and math.isfinite(high)) else f"[{low:.{decimals}f}, {high:.{decimals}f}]"


def p_text(p: float) -> str:
    """Format a p value with three decimals."""
    return "-" if not math.isfinite(p) else "<0.001" if p < 0.001 else f"{p:.3f}"


def ratio_text(ratio: float, low: float = math.nan, high: float = math.nan, decimals: int = 3) -> str:
    """Format a ratio and its interval, without a missing part."""
    texts = number_text(ratio, decimals), interval_text(low, high, decimals)
    return " ".join(text for text in texts if text != "-") or "-"


def aligned_table(head: Sequence[str], lines: Iterable[Sequence[str]], *, left: Collection[str]) -> str:
    """Format texts as one aligned Markdown table, columns named in `left` to the left, the others to the right.

    Bars in texts are escaped.
    """
    is_left = [name in left for name in head]
    head, *lines = ([" ".join(cell.split()).replace("|", "\\|") for cell in line] for line in [head, *lines])
    widths = [max(3, *(len(line[i]) for line in [head, *lines])) for i in range(len(head))]
    rule = ["-" * width if to_left else "-" * (width - 1) + ":" for width, to_left in zip(widths, is_left)]
    text = [
        [cell.ljust(width) if to_left else cell.rjust(width) for cell, width, to_left in zip(line, widths, is_left)]
        for line in [head, rule, *lines]
    ]
    return "".join("| " + " | ".join(line) + " |\n" for line in text)


def table_cells(text: str) -> tuple[list[str], list[list[str]], list[bool]]:
    """Return head, lines and right-aligned columns of one table by `aligned_table`."""
    head, rule, *lines = (re.split(r"(?<!\\)\|", line.strip())[1:-1] for line in text.strip().splitlines())
    head, *lines = ([cell.strip().replace("\\|", "|") for cell in line] for line in [head, *lines])
    return head, lines, [cell.strip().endswith(":") for cell in rule]
