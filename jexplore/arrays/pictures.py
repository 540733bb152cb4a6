"""Display of objects in a notebook: small PNG pictures, and HTML of a picture, a line and a table.

Plain Python: importing this loads neither numpy nor Pillow.
"""

import base64
import dataclasses
import functools
import html
import io
import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

LONG_PX = 400  # longer side of a picture of cells, about
MAX_TABLE_ROWS = 24  # of a table that is shown
_GOLDEN = 0.618034  # of a turn: hues of neighbours in number lie far apart


def or_text(method: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Make a method show an object; if it fails it returns None, and a notebook shows the object's text."""

    @functools.wraps(method)
    def shown(self):
        try:
            return method(self)
        except Exception:  # whatever is wrong with an object, it can be looked at
            return None

    return shown


def html_of(picture: bytes, caption: str, head: Sequence[str] = (), lines: Iterable[Sequence[str]] = ()) -> str:
    """Return HTML of a PNG picture, a line below it, and a table of its first `MAX_TABLE_ROWS` lines."""
    source = base64.b64encode(picture).decode("ascii")
    parts = [f'<img src="data:image/png;base64,{source}" alt="{html.escape(caption)}" style="max-width: 100%">']
    parts.append(f"<div>{html.escape(caption)}</div>")
    lines = list(lines)
    if lines:
        rows = [_row("th", head), *(_row("td", line) for line in lines[:MAX_TABLE_ROWS])]
        parts.append(f"<table>{''.join(rows)}</table>")
    if len(lines) > MAX_TABLE_ROWS:
        parts.append(f"<div>... and {len(lines) - MAX_TABLE_ROWS:,} more rows</div>")
    return f"<div>{''.join(parts)}</div>"


@dataclasses.dataclass(frozen=True, repr=False)
class Listing:
    """A table of texts that shows itself, as text as wide as the terminal, in a notebook as HTML."""

    head: tuple[str, ...]  # `[K]` names of columns
    rows: tuple[tuple[str, ...], ...]  # `[N]` rows of `[K]` texts

    def __iter__(self) -> Iterator[tuple[str, ...]]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def to_pandas(self) -> Any:
        """Return the same as a `pandas.DataFrame`."""
        import pandas as pd

        return pd.DataFrame(self.rows, columns=list(self.head))

    def __repr__(self) -> str:
        from rich import box, console, table, text

        drawn = table.Table(table.Column(self.head[0], no_wrap=True), *self.head[1:], box=box.SIMPLE_HEAD)
        for row in self.rows:
            drawn.add_row(*map(text.Text, row))
        page, width = io.StringIO(), shutil.get_terminal_size((120, 24)).columns
        console.Console(file=page, width=width, force_jupyter=False, color_system=None).print(drawn)
        return "\n".join(line.rstrip() for line in page.getvalue().strip("\n").splitlines())

    def _repr_html_(self):
        return f"<table>{_row('th', self.head)}{''.join(_row('td', row) for row in self.rows)}</table>"


def _row(tag, cells):
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"


def axes_of(ax: Any = None) -> Any:
    """Return matplotlib `Axes`: those given, else those of a new figure of pyplot, which a notebook shows."""
    if ax is None:
        from matplotlib import pyplot

        _, ax = pyplot.subplots(layout="constrained")
    return ax


def shown_figure(figure: Any) -> Any:
    """Return a matplotlib `Figure` that a notebook shows at the end of a cell."""
    from matplotlib import pyplot  # noqa: F401  (by which a notebook learns how)

    return figure


def png_of(figure: Any, *, dpi: float = 72) -> bytes:
    """Convert a matplotlib `Figure` to the bytes of a small PNG."""
    from PIL import Image

    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    return written(Image.open(file))


def written(image: Any) -> bytes:
    """Convert a Pillow image to the bytes of a PNG of at most 128 colours."""
    file = io.BytesIO()
    image.convert("RGB").quantize(128, kmeans=1).save(file, format="png", optimize=True)
    return file.getvalue()


def soft_colours(count: int) -> list[tuple[int, int, int]]:
    """Return `count` soft colours, red, green and blue from 0 to 255; neighbours in number are far apart in hue."""
    turns = [[i * _GOLDEN + third / 3 for third in range(3)] for i in range(count)]
    return [tuple(round(215 + 30 * math.cos(math.tau * turn)) for turn in own) for own in turns]  # type: ignore[misc]
