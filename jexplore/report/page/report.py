"""The report of a run: what was asked, tables, plots and replays as one web page that needs no other file."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jexplore.report.page.assemble import assembled, html_text, script_data
from jexplore.report.page.packing import base64_of
from jexplore.report.page.replay import ReplayData, page_data
from jexplore.report.store import jsonable
from jexplore.report.tables import table_cells

MAX_REPORT_BYTES = 10_000_000
MAX_SHOWN_ROWS = 200  # of a table that are shown
MAX_SETTING_CHARS = 400  # characters of a setting
ELSEWHERE = ("summary", "worlds", "warnings", "standings", "tables", "orderings", "measured", "asked")
"""Entries of run.json that a report shows in another form, or not at all."""
PICTURES = {
    "compare.png": "Path lengths of all episodes, means with their intervals, and ratios to the first strategy",
    "coverage.png": "Share of what can be known along the path",
    "paths.png": "The map as each strategy saw it in episode 0, with its path",
    "league.png": "Path lengths as ratios to those of the first strategy, over all worlds",
    "sweep.png": "Path lengths along the first setting that is varied",
    "episode.png": "The known map and the path at the end",
}
"""Captions of a run's pictures."""
FEW_FRAMES = 60  # of a replay; rather than fewer, fewer replays
MANY_FRAMES = 300


def write_report(
    path: Path, record: Mapping[str, Any], tables: Iterable[tuple[str, str]], pictures: Iterable[str],
    replays: Sequence[ReplayData], notes: Iterable[str] = (),
) -> None:  # fmt: skip
    """Write the report of a run from its run.json, tables with headings, and those of its pictures that are there.

    Pictures lie in the folder above that of `path`, in which files are written before they count.
    """
    asked = {key: value for key, value in record.items() if key not in ELSEWHERE}
    files = [file for name in pictures if (file := path.parents[1] / name).is_file()]
    figures = [(file.name, file.read_bytes(), PICTURES.get(file.name, file.stem)) for file in files]
    title = f"jexplore {record['command'][1]}"
    page = report_page(title, asked, tables, figures, replays, record.get("warnings", ()), notes=notes)
    path.write_text(page, encoding="ascii")


def report_page(
    title: str, asked: Mapping[str, Any], tables: Iterable[tuple[str, str]] = (),
    figures: Iterable[tuple[str, bytes, str]] = (), replays: Sequence[ReplayData] = (), warnings: Iterable[str] = (),
    *, notes: Iterable[str] = (), max_bytes: int = MAX_REPORT_BYTES,
) -> str:  # fmt: skip
    """Return the report of a run, one HTML file: no network, no server, no other file; replays need JavaScript.

    Figures take up to half of the page; the largest are left out where they would take more. Where the page would be
    too large, replays lose frames, then the last ones are left out. The page says so. It is plain ASCII, so it may be
    written in any encoding.

    Args:
      asked: name -> value, nested: settings, versions. `command`, a text or a list of words, stands above all else; the
        rest is folded, at the end.
      tables: pairs of a heading and a table as the terminal has it, by `aligned_table`.
      figures: name, the bytes of a PNG or SVG file, and a caption.

    Raises:
      ValueError: a figure that is neither PNG nor SVG, or a page that is too large without any replay.
    """
    replays, warnings, notes = list(replays), list(warnings), list(notes)
    command, settings = _asked(asked)
    shown_tables = "".join(f"<h3>{html_text(heading)}</h3>{_table(heading, found)}" for heading, found in tables)
    above = [command, _section("Warnings", _list(warnings), "warnings"), _section("Tables", shown_tables)]
    above.append(_section("Plots", _plots(figures, max_bytes // 2), "plots"))
    frames, shown = MANY_FRAMES, [replay.thinned(MANY_FRAMES) for replay in replays]
    while True:
        text = _page(title, above, settings, shown, [*notes, *_cut(replays, shown, frames)])
        if len(text) <= max_bytes:
            return text
        if not shown:
            raise ValueError(f"expected a page of at most {max_bytes} bytes, got {len(text)} without any replay")
        if frames > FEW_FRAMES:
            frames = max(FEW_FRAMES, frames // 2)
            shown = [replay.thinned(frames) for replay in replays]
        else:
            shown = shown[:-1]


def _cut(replays, shown, frames):
    """Yield lines about parts of replays left out for lack of room."""
    if len(shown) < len(replays):
        yield f"To keep the page small, the last {len(replays) - len(shown)} of {len(replays)} replays are left out."
    if frames < MANY_FRAMES:
        yield f"To keep the page small, replays have at most {frames} frames."


def _page(title, above, settings, replays, notes):
    below = _list(notes, "notes")
    below = assembled("replays.html", own_controls="", notes=below) if replays else _section("", below)
    sections = "\n".join(filter(None, [*above, below, settings]))
    data = script_data(page_data(replays))
    return assembled("report.html", title=html_text(title), sections=sections, data=data)


def _section(heading, body, kind=""):
    """Return a section of the page, none without a body."""
    own, head = f' class="{kind}"' if kind else "", f"<h2>{heading}</h2>" if heading else ""
    return f"<section{own}>{head}{body}</section>" if body else ""


def _list(lines, kind=""):
    items, own = "".join(f"<li>{html_text(line)}</li>" for line in lines), f' class="{kind}"' if kind else ""
    return f"<ul{own}>{items}</ul>" if items else ""


def _asked(asked):
    """Format the command, and all settings, folded."""
    asked = {str(name): value for name, value in jsonable(dict(asked)).items()}
    command = asked.pop("command", None)
    shown = command if command is None or isinstance(command, str) else " ".join(map(str, command))
    head = "" if shown is None else f"<pre>{html_text(_cut_text(shown))}</pre>"
    entries = list(_flat(asked))
    rows = "".join(
        f"<div><dt>{html_text(name)}</dt><dd>{html_text(_cut_text(text))}</dd></div>"
        for name, text in entries[:MAX_SHOWN_ROWS]
    )
    summary = f"<summary><h2>What was asked, and with what: {len(entries)} entries</h2></summary>"
    folded = f"<details>{summary}<dl>{rows}</dl>{_left_out(entries, 'settings')}</details>"
    return head, _section("", folded if rows else "")


def _left_out(lines, what):
    most = f"The first {MAX_SHOWN_ROWS} of {len(lines)} {what}."
    return f'<p class="soft">{most}</p>' if len(lines) > MAX_SHOWN_ROWS else ""


def _cut_text(text):
    return text if len(text) <= MAX_SETTING_CHARS else text[:MAX_SETTING_CHARS] + "…"


def _flat(value, name=""):
    """Yield nested settings as pairs of dotted names and texts."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flat(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and not any(isinstance(item, (dict, list)) for item in value):
        yield name, ", ".join(_text(item) for item in value) or "-"
    elif isinstance(value, list):
        yield name, json.dumps(value, ensure_ascii=False)
    else:
        yield name, _text(value)


def _table(heading, found):
    head, rows, is_right = table_cells(found)
    kept = rows[:MAX_SHOWN_ROWS]

    def line(tag, cells):
        parts = (f"<{tag}{' class=right' if right else ''}>{cell}</{tag[:2]}>" for cell, right in zip(cells, is_right))
        return f"<tr>{''.join(parts)}</tr>"

    names = line('th scope="col"', map(html_text, head))
    body = "".join(line("td", map(html_text, row)) for row in kept)
    more = _left_out(rows, "rows")
    region = f'<div class="table" tabindex="0" role="region" aria-label="{html_text(heading)}">'
    return f"{region}<table><thead>{names}</thead><tbody>{body}</tbody></table></div>{more}"


def _text(value):
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"
    return str(value)


def _plots(figures, max_bytes):
    made = {name: _figure(name, raw, alt) for name, raw, alt in figures}
    kept = dict(made)
    while sum(map(len, kept.values())) > max_bytes:
        del kept[max(kept, key=lambda name: len(kept[name]))]
    return "".join(kept.get(name, f"<p>The picture {html_text(name)} is too large for this page.</p>") for name in made)


def _figure(name, raw, alt):
    """Embed a picture as an image whose bytes stand in the page: nothing in it is run or fetched."""
    if raw.startswith(b"\x89PNG\r\n\x1a\n"):
        kind = "png"
    elif b"<svg" in raw[:2000]:
        kind = "svg+xml"
    else:
        raise ValueError(f"expected {name} as the bytes of a PNG or SVG file, got {raw[:8]!r}")
    caption = f"<figcaption>{html_text(alt)}</figcaption>"
    image = f'<img src="data:image/{kind};base64,{base64_of(raw)}" alt="{html_text(alt)}">'
    return f'<figure title="{html_text(name)}">{image}{caption}</figure>'
