"""Printed output of commands: on a terminal tables that fit its width, in pipes and files the Markdown itself."""

import contextlib
import itertools
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Iterator
from typing import Any, TextIO

from jexplore.config import InputWarning
from jexplore.report.tables import table_cells

COLUMN_GAP = 2  # blank columns of the terminal between two columns of a table
MIN_COLUMNS = 20  # of a table and a line, on a narrower terminal as well
FOLDED_TEXT = 16  # columns that a text keeps while other columns of the table need room
_STEERING = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def show_table(text: str, file: TextIO | None = None) -> None:
    """Print Markdown tables in readable form; text may hold other lines between them.

    In a pipe or a file this is `print`. On a terminal rich draws them: headings and texts fold, numbers do not, and a
    table that is still too wide is cut into parts, which all begin with its first column, or two if these are text.
    `COLUMNS` and `NO_COLOR` count.
    """
    file = file or sys.stdout
    if file is None or not file.isatty():
        print(text, file=file)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(file=file, force_jupyter=False, highlight=False)
    console.width = max(console.width, MIN_COLUMNS)
    for is_table, lines in itertools.groupby(text.split("\n"), lambda line: line.startswith("|")):
        lines = list(lines)
        if is_table:
            _draw_table(console, *table_cells("\n".join(lines)))
            continue
        for line in lines:
            console.print(Text(line.lstrip("# "), style="bold") if line.startswith("#") else Text(line))


def _draw_table(console, head, rows, is_right):
    """Draw a table, in parts of as many columns as fit, all of which begin with its first columns."""
    from rich import box
    from rich.cells import cell_len
    from rich.table import Table
    from rich.text import Text

    columns = [list(column) for column in zip(head, *rows)]
    full = [max(map(cell_len, column)) for column in columns]
    words = [max(map(cell_len, column[0].split()), default=1) for column in columns]
    least = [
        max(word, max(map(cell_len, column[1:]), default=1)) if right else min(whole, FOLDED_TEXT)
        for column, whole, word, right in zip(columns, full, words, is_right)
    ]
    if sum(full) + COLUMN_GAP * (len(full) - 1) <= console.width:
        least = full
    keys = 2 if is_right[:2] == [False, False] and any(is_right) else 1
    rest = list(range(keys, len(columns))) or [0]
    while rest:
        part = [*range(min(keys, rest[0])), rest.pop(0)]
        while rest and sum(least[i] + COLUMN_GAP for i in [*part, rest[0]]) - COLUMN_GAP <= console.width:
            part.append(rest.pop(0))
        table = Table(box=box.SIMPLE_HEAD, padding=(0, COLUMN_GAP - 1, 0, 0), pad_edge=False, show_edge=False)
        most = max(1, (console.width - COLUMN_GAP * (len(part) - 1)) // len(part))  # where nothing else fits
        for i in part:
            width = (least[i] if len(part) > keys + 1 else min(least[i], most)) if is_right[i] else None
            how: Any = {"justify": "right" if is_right[i] else "left", "width": width, "overflow": "fold"}
            table.add_column(Text(columns[i][0]), vertical="top", **how)
        for cells in zip(*(columns[i][1:] for i in part)):
            table.add_row(*map(Text, cells))
        console.print(table)
        if rest:
            console.print()


def show_line(text: str, indent: int = 0) -> None:
    """Print a line; on a narrower terminal it continues below, indented.

    Characters that steer a terminal, line ends among them, and halves of characters become U+FFFD: text may come from
    an untrusted file.
    """
    text = _STEERING.sub("\ufffd", text)
    if sys.stdout is not None and sys.stdout.isatty():
        width = max(shutil.get_terminal_size().columns, MIN_COLUMNS)
        text = textwrap.fill(text, width, subsequent_indent=" " * indent, break_on_hyphens=False)
    print(text)


@contextlib.contextmanager
def plain_warnings() -> Iterator[None]:
    """Print warnings about input within the block as one line each on stderr, and only once."""
    default, said = warnings.showwarning, set()

    def show(message, category, filename, lineno, file=None, line=None):
        text = " ".join(str(message).split())
        if not issubclass(category, InputWarning):
            default(message, category, filename, lineno, file, line)
        elif text not in said and sys.stderr is not None:
            said.add(text)
            print(f"warning: {text}", file=sys.stderr, flush=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = show
        yield
