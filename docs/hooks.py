"""What mkdocs does besides: pages made from the repository and from the commands' own records, links between them.

Importing this needs no mkdocs.
"""

import dataclasses
import json
import os
import re
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TAKEN = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "results/benchmarks.md",
    "benchmarks/RESULTS.md": "results/measured.md",
}
"""Files of the repository that are pages of the site: path there -> path here."""
COMMANDS_PAGE = "reference/commands.md"
SHARED = ("lidar", "rules", "tuning", "noise", "limits")
"""Fields of options that are records of their own, each described once."""
_LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
_FENCE = re.compile(r"(^ *```.*?^ *```$)", re.MULTILINE | re.DOTALL)


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages that no file of `docs/` holds."""
    from mkdocs.structure.files import File

    from jexplore.cli.main import COMMANDS

    made = {TAKEN[source]: rewritten((ROOT / source).read_text(encoding="utf-8"), source) for source in TAKEN}
    made[COMMANDS_PAGE] = commands_page(COMMANDS)
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    for path in notebooks():
        files.append(File.generated(config, f"notebooks/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Links to files of the repository become links to their pages, and `<!-- name -->` the table of that name."""
    name = page.file.src_uri
    if name in (*TAKEN.values(), COMMANDS_PAGE):
        return markdown
    for mark, table in TABLES.items():
        if mark in markdown:
            markdown = markdown.replace(mark, table())
    return rewritten(markdown, f"docs/{name}")


def rewritten(text: str, source: str) -> str:
    """The Markdown of a file with its links to other files of the repository as links to their pages.

    Args:
      text: Markdown. What is fenced in it stays.
      source: where it stands in the repository.
    """
    here = page_of(source)
    assert here is not None, source

    def linked(match):
        target = os.path.normpath(os.path.join(os.path.dirname(source), match[2]))
        page = None if ":" in match[2] else page_of(target)
        return match[0] if page is None else match[1] + os.path.relpath(page, os.path.dirname(here) or ".") + match[3]

    parts = _FENCE.split(text)
    return "".join(part if _FENCE.fullmatch(part) else _LINK.sub(linked, part) for part in parts)


def page_of(path: str) -> str | None:
    """Where the site has a file of the repository; None where it has not."""
    return TAKEN.get(path) or (path.removeprefix("docs/") if path.startswith("docs/") else None)


def generators_table() -> str:
    """The generators of worlds and their parameters."""
    from jexplore.worlds import GENERATORS, generator_parameters

    def parameters(name):
        return ", ".join(f"`{key}={str(value).lower()}`" for key, value in generator_parameters(name).items())

    return table_of(["world", "parameters"], [(f"`{name}`", parameters(name)) for name in GENERATORS])


def strategies_table() -> str:
    """The strategies and modifiers of this package, their parameters and sources."""
    from jexplore.policies import MODIFIERS
    from jexplore.policies.catalogue.grammar import listing

    rows = [(f"`{one.name}`", one.summary, one.parameters, one.source) for one in listing()]
    modifiers = [(f"`+{name}`", text) for name, text in MODIFIERS.items()]
    return "\n".join(
        (
            table_of(["strategy", "goes to", "parameters", "source"], rows),
            table_of(["modifier, after any name", "meaning"], modifiers),
        )
    )


def notebooks() -> list[Path]:
    """The notebooks of the repository, in order."""
    return sorted((ROOT / "notebooks").glob("*.ipynb"))


def notebooks_table() -> str:
    """The notebooks, and what each says of itself: its first heading and the first paragraph below."""
    rows = []
    for path in notebooks():
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
        heading, *paragraphs = (" ".join(part.split()) for part in text.split("\n\n"))
        rows.append((f"[{path.stem}](../notebooks/{path.name})", f"{heading.lstrip('# ')}. {paragraphs[0]}"))
    return table_of(["notebook", "what it shows"], rows)


TABLES = {
    "<!-- generators -->": generators_table,
    "<!-- strategies -->": strategies_table,
    "<!-- notebooks -->": notebooks_table,
}
"""Marks in the pages -> what makes the table that stands there."""


def table_of(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *([_safe(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def commands_page(commands: Mapping[str, type]) -> str:
    """The reference of every command, from the records of their options.

    Args:
      commands: name -> class of its options.
    """
    parts = [
        "# Commands\n\n"
        "Every command prints its options with `--help`. Wrong input ends with one line that says what would be right\n"
        "and exit status 2; Ctrl-C with 130, SIGTERM with 143, SIGHUP with 129. `jexplore --version` shows the\n"
        "version. With `JEXPLORE_SMALL=1` in the environment default comparisons are small; `NO_COLOR=1` keeps\n"
        "colours away.\n"
    ]
    shared: dict[str, type] = {}
    for name, kind in commands.items():
        parts.append(f"## jexplore {name}\n\n{_summary(kind)}\n\n{_table(kind, '', shared)}")
    for name, kind in shared.items():
        parts.append(f"## Options --{name}.* {{ #{name} }}\n\n{_summary(kind)}\n\n{_table(kind, name + '.', {})}")
    return "\n".join(parts)


def _summary(kind):
    return "\n".join(_escaped(line.strip()) for line in (kind.__doc__ or "").strip().splitlines())


def _table(kind, prefix, shared):
    """The options of a record as a table; those that are records go to `shared`."""
    from jexplore.cli.options import field_texts

    texts, hints = field_texts(kind), typing.get_type_hints(kind, include_extras=True)
    rows, more = [], []
    for field in dataclasses.fields(kind):
        hint, settings = _unwrapped(hints[field.name])
        if dataclasses.is_dataclass(hint):
            shared[field.name] = hint
            more.append(f"[`--{field.name}.*`](#{field.name})")
            continue
        option, default = _option(field, hint, settings, prefix)
        text = field.metadata.get("off") if field.default is True else None
        rows.append((f"`{option}`", default, text or texts.get(field.name, "")))
    below = f"\nAlso {', '.join(more)}.\n" if more else ""
    return table_of(["option", "default", "meaning"], rows) + below if rows else "It takes no options.\n"


def _option(field, hint, settings, prefix):
    """How an option is written, and what it is without."""
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    metavar = next((one.metavar for one in settings if getattr(one, "metavar", None)), None)
    own = next((one.name for one in settings if getattr(one, "name", None)), field.name)
    name = f"--{prefix}{own}".replace("_", "-")
    if any("Positional" in str(one) for one in settings):
        return metavar or field.name.upper(), _default(default)
    if hint is bool:
        return (f"--{prefix}no-{field.name}".replace("_", "-"), "") if default else (name, "")
    if typing.get_origin(hint) is typing.Literal:
        metavar = "{" + ",".join(typing.get_args(hint)) + "}"
    kinds = [one for one in typing.get_args(hint) if one is not type(None)] or [hint]
    return f"{name} {metavar or getattr(kinds[0], '__name__', 'value').upper()}", _default(default)


def _unwrapped(hint):
    """A type without what is said about it, and what is said: also of the types that it is a choice of."""
    if typing.get_origin(hint) is typing.Annotated:
        inner, *settings = typing.get_args(hint)
        deeper, more = _unwrapped(inner)
        return deeper, [*settings, *more]
    return hint, []


def _default(value):
    if value is None or value == () or value == "":
        return ""
    return f"`{' '.join(map(str, value)) if isinstance(value, tuple) else value}`"


def _safe(text):
    """Text for a cell of a table."""
    return _escaped(text).replace("|", "\\|")


def _escaped(text):
    """Text whose angle brackets are no HTML; what is set as code stays."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else part.replace("<", "&lt;") for part in parts)
