"""Printed output of commands: on a terminal tables that fit its width, in pipes and files the Markdown itself."""

import contextlib
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any, TextIO

from jexplore.config import InputWarning

GAP = 2  # blank columns between two columns of a table
NARROW = 12  # text is folded to no fewer columns than this while another part of the table can take the rest
FEW = NARROW // 2  # text that lacks no more than this is rather not folded
_STEERING = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_PIECE = re.compile(r"\s+|[,:;+/-]*[^\s,:;+/-]+[,:;+/-]*|[,:;+/-]+")  # text is folded between such pieces


def show_table(
    table: Any,
    rows: Iterable[Sequence[Any]] | None = None,
    *,
    left: Collection[str] | None = None,
    file: TextIO | None = None,
) -> None:
    """Print tables in readable form.

    In a pipe or a file this is `print` of the Markdown. On a terminal every table is drawn to fit the width: headings
    fold first, then columns of text, never numbers, and a first cell that repeats the row above is left blank; a table
    that is still too wide is cut into parts below each other, which all begin with the first column, or two if these
    are text. `COLUMNS` and `NO_COLOR` count.

    Args:
      table: Markdown text, which may hold other lines between its tables; or a data frame; or, with `rows`, headings.
      rows: lists of cells, one for each heading.
      left: headings of the columns that are aligned to the left, where `table` is no text; by default those that hold
        nothing but text.
      file: where to; by default the standard output.
    """
    file = file or sys.stdout
    text = table if isinstance(table, str) else _markdown(table, rows, left)
    if file is None or not file.isatty():
        print(text, file=file)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(file=file, force_jupyter=False, highlight=False)
    for part in _parts(text):
        if isinstance(part, str):
            line = part.lstrip("#").lstrip() if part.startswith("#") else part
            console.print(Text(line, style="bold" if part.startswith("#") else ""))
        else:
            rows, is_left = part
            for i, block in enumerate(_blocks(rows, is_left, console.width)):
                if i:
                    console.print()
                console.print(_drawn(*block))
    console.print()


def show_line(text: str, indent: int = 0) -> None:
    """Print a line; on a narrower terminal it continues below, indented.

    Characters that steer a terminal, line ends among them, and halves of characters become U+FFFD: text may come from
    an untrusted file.
    """
    text = _STEERING.sub("\ufffd", text)
    if sys.stdout is not None and sys.stdout.isatty():
        width = shutil.get_terminal_size().columns
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


def _markdown(table, rows, left):
    from jexplore.report.tables import aligned_table

    head, rows = (table.columns, table.itertuples(index=False)) if rows is None else (table, rows)
    head, rows = [str(name) for name in head], [list(row) for row in rows]
    if left is None:
        left = [name for i, name in enumerate(head) if all(isinstance(row[i], str) for row in rows)]
    return aligned_table(head, [[_cell(value) for value in row] for row in rows], left=left)


def _cell(value):
    if value is None or value != value:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _parts(text) -> Iterator[Any]:
    """Yield lines of Markdown, and its tables: `(rows of cells, headings first; whether columns go to the left)`."""
    lines = text.split("\n")
    i = 0
    while i < len(lines):
        n = 0
        while i + n < len(lines) and lines[i + n].startswith("|"):
            n += 1
        rows = [_cells(line) for line in lines[i : i + n]]
        if n >= 2 and len({len(row) for row in rows}) == 1 and all(re.fullmatch(":?-+:?", cell) for cell in rows[1]):
            yield [rows[0], *rows[2:]], [not cell.endswith(":") for cell in rows[1]]
            i += n
        else:
            yield lines[i]
            i += 1


def _cells(line):
    cells = re.split(r"(?<!\\)\|", line.strip().removeprefix("|").removesuffix("|"))
    return [cell.strip().replace("\\|", "|") for cell in cells]


def _blocks(rows, is_left, width):
    """Yield the parts of a table below each other, each no wider than `width`: `(rows, is_left, widths)`."""
    from rich.cells import cell_len

    texts = list(zip(*rows))
    full = [max(map(cell_len, column)) for column in texts]
    least = []  # what a column needs
    for column, whole, to_left in zip(texts, full, is_left):
        cells = max((cell_len(cell) for cell in column[1:]), default=0)
        word = max((cell_len(word) for word in column[0].split()), default=0)
        least.append(max(1, min(whole, max(word, min(cells, NARROW) if to_left else cells))))
    parts = [list(range(len(least)))]
    if sum(full) + GAP * (len(full) - 1) > width and is_left[0]:
        rows = [rows[0], *_once(rows[1:])]
    if sum(least) + GAP * (len(least) - 1) > width:
        keys = 2 if is_left[:2] == [True, True] and not all(is_left) else 1
        whole_keys = full[:keys] + least[keys:]
        parts, roomy = _cut(least, keys, width), _cut(whole_keys, keys, width)
        if len(roomy) == len(parts):  # then there is no need to fold them
            parts, least = roomy, whole_keys
    for columns in parts:
        widths = _shared([least[i] for i in columns], [full[i] for i in columns], width - GAP * (len(columns) - 1))
        yield [[row[i] for i in columns] for row in rows], [is_left[i] for i in columns], widths


def _cut(least, keys, width):
    """Divide columns into parts: the first `keys` of the table and as many others as fit, at least one."""
    parts = []
    rest = list(range(keys, len(least))) or [0]
    while rest:
        part = [*range(min(keys, rest[0])), rest.pop(0)]
        while rest and sum(least[i] + GAP for i in [*part, rest[0]]) - GAP <= width:
            part.append(rest.pop(0))
        while len(part) > 1 and len(part) * (1 + GAP) - GAP > width:  # a terminal of a few columns
            part.pop(0)
        parts.append(part)
    return parts


def _once(rows):
    """Yield the same rows, the first cell left blank if it equals that of the row above."""
    before = None
    for row in rows:
        yield ["" if row[0] == before else row[0], *row[1:]]
        before = row[0]


def _shared(least, full, width):
    """Distribute the width over columns: their full width if possible.

    The rest goes to texts that would then not have to be folded, and to the narrowest columns.
    """
    widths = list(least)
    while sum(widths) > max(width, len(widths)):
        widths[widths.index(max(widths))] -= 1
    for i, lacks in enumerate(whole - has for whole, has in zip(full, widths)):
        if widths[i] == NARROW and lacks <= min(FEW, width - sum(widths)):
            widths[i] += lacks
    for _ in range(width - sum(widths)):
        wanting = [i for i in range(len(widths)) if widths[i] < full[i]]
        if not wanting:
            break
        widths[min(wanting, key=widths.__getitem__)] += 1
    return widths


def _fold(text, width):
    """Fold a text into lines of at most `width` columns: cut after spaces and separators, or anywhere without them."""
    from rich.cells import cell_len, chop_cells

    lines = [""]
    for piece in _PIECE.findall(text):
        if cell_len(lines[-1] + piece.rstrip()) > width:
            lines.append("")
        chopped = chop_cells(piece, width) if cell_len(piece.rstrip()) > width else [piece]
        lines[-1:] = [lines[-1] + chopped[0], *chopped[1:]]
    return "\n".join(line.strip() for line in lines if line.strip())


def _drawn(rows, is_left, widths):
    """Make a table of rich, folded already."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    head, *body = [[Text(_fold(cell, width)) for cell, width in zip(row, widths)] for row in rows]
    table = Table(box=box.SIMPLE_HEAD, padding=(0, GAP - 1, 0, 0), pad_edge=False, show_edge=False)
    for cell, to_left, width in zip(head, is_left, widths):
        table.add_column(cell, justify="left" if to_left else "right", vertical="top", width=width, no_wrap=True)
    for row in body:
        table.add_row(*row)
    return table
