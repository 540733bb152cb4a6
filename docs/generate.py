"""Write all pages of the documentation's site, for `mkdocs build`.

    python docs/generate.py --site build/docs

The site has what the pages of the repository leave to the code: the options of every command, tables of strategies,
worlds and leagues, whole docstrings of the Python names. Four files of the repository and the notebooks are pages too.
"""

import argparse
import ast
import base64
import dataclasses
import json
import os
import re
import shutil
import sys
import textwrap
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
TAKEN = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "results/benchmarks.md",
    "benchmarks/RESULTS.md": "results/measured.md",
}
"""Files of the repository that are pages of the site: path there -> path here."""
BY_SUBJECT = "benchmarks/RESULTS.md"
"""A file of the repository of which every second-level heading is a page of the site, below the page of the file."""
SHOWN = (".css", ".png", ".gif", ".bib")
"""Endings of the files of `docs/` that the site has besides pages."""
_LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
_FENCE = re.compile(r"(^ *```.*?^ *```$)", re.MULTILINE | re.DOTALL)
_MARK = re.compile(r"^<!-- (\w+)(?:: ([\w. -]+))? -->$(?!\n```)", re.MULTILINE)
_NAMES = re.compile(r"^Names: (.*(?:\n.+)*)", re.MULTILINE)


def write_site(folder: Path) -> None:
    """Write all pages of the site into a folder, which is emptied.

    Args:
      folder: as `docs_dir` of mkdocs.yml has it.
    """
    shutil.rmtree(folder, ignore_errors=True)
    for name, content in site_files().items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content if isinstance(content, bytes) else content.encode())


def site_files() -> dict[str, str | bytes]:
    """Make all files of the site, path there -> content."""
    files: dict[str, str | bytes] = {}
    for path in sorted(DOCS.rglob("*")):
        name = path.relative_to(DOCS).as_posix()
        if path.suffix == ".md":
            files[name] = rewritten(filled(path.read_text(encoding="utf-8")), f"docs/{name}")
        elif path.suffix in SHOWN:
            files[name] = path.read_bytes()
    for source, page in TAKEN.items():
        text = filled((ROOT / source).read_text(encoding="utf-8"))
        for subject, part in (subjects(text) if source == BY_SUBJECT else {"": text}).items():
            name = f"{page.removesuffix('.md')}/{subject}.md" if subject else page
            files[name] = rewritten(part, source, name)
    for path in notebooks():
        text, pictures = notebook_page(path)
        files[f"notebooks/{path.stem}.md"] = rewritten(text, f"notebooks/{path.name}")
        files |= {f"notebooks/{name}": data for name, data in pictures.items()}
    return files


def subjects(text: str) -> dict[str, str]:
    """Divide a file at its second-level headings.

    Args:
      text: Markdown.

    Returns:
      Anchor of the heading -> its text with all headings raised by a level. The anchor "" has what stands before the
      first heading, and a list of the others.
    """
    first, *parts = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    found, listed = {}, []
    for part in parts:
        heading = part.splitlines()[0].removeprefix("## ")
        listed.append(f"- [{heading}](measured/{anchor_of(heading)}.md)")
        found[anchor_of(heading)] = re.sub(r"^#(#+ )", r"\1", part, flags=re.MULTILINE)
    return {"": "\n".join((first.rstrip(), "", *listed, "")), **found}


def anchor_of(heading: str) -> str:
    """Make the anchor of a heading, as Git hosts and mkdocs do."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def notebook_page(path: Path) -> tuple[str, dict[str, bytes]]:
    """Write a notebook with its outputs as a page.

    Args:
      path: of the notebook.

    Returns:
      Markdown, and its pictures: file name next to the page -> PNG.
    """
    parts, pictures = [], {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = {kind: "".join(text) for kind, text in output.get("data", {}).items()}
            if "image/png" in data:
                name = f"{path.stem}-{len(pictures) + 1}.png"
                pictures[name] = base64.b64decode(data["image/png"])
                parts.append(f"![Output of the cell above]({name})")
            elif "text/markdown" in data:
                parts.append(data["text/markdown"])
            elif "text/html" in data:  # one block, which a blank line would end; tables in the style of the site
                html = re.sub(r"<style.*?</style>|(?<=<table)[^>]*", "", data["text/html"], flags=re.DOTALL)
                parts.append(re.sub(r"\n\s*\n", "\n", f"<div>{html}</div>"))
            else:
                text = data.get("text/plain", "".join(output.get("text", "")))
                parts.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(parts) + "\n", pictures


def filled(text: str) -> str:
    """Fill in what a page leaves to the code: parts where their marks stand, and docstrings of the names that it lists.

    Args:
      text: Markdown. `<!-- NAME: ARGUMENT -->` on a line of its own marks one of `PARTS`; `Names: ` begins a list.
    """
    text = _MARK.sub(lambda mark: PARTS[mark[1]](*(mark[2] or "").split()), text)
    return _NAMES.sub(lambda match: "\n".join(f"::: {name}\n" for name in names_in(match[0])), text)


def names_in(text: str) -> list[str]:
    """Return the Python names in backticks, with `jx` written out."""
    return [re.sub(r"^jx\b", "jexplore", name) for name in re.findall(r"`([\w.]+)`", text)]


def rewritten(text: str, source: str, here: str | None = None) -> str:
    """Rewrite links of a Markdown file to other files of the repository as links to their pages.

    Args:
      text: Markdown. Fenced parts stay.
      source: its path in the repository.
      here: the page that the text is for; by default that of the source.
    """
    here = here or page_of(source)
    assert here is not None, source

    def linked(match):
        target = os.path.normpath(os.path.join(os.path.dirname(source), match[2]))
        page = None if ":" in match[2] else page_of(target, match[3][1:-1])
        return match[0] if page is None else match[1] + os.path.relpath(page, os.path.dirname(here) or ".") + match[3]

    parts = _FENCE.split(text)
    return "".join(part if _FENCE.fullmatch(part) else _LINK.sub(linked, part) for part in parts)


def page_of(path: str, anchor: str = "") -> str | None:
    """Return the site's page of a file of the repository; None without one."""
    if path.startswith("notebooks/") and path.endswith(".ipynb"):
        return path.removesuffix(".ipynb") + ".md"
    if path == BY_SUBJECT and anchor:
        for subject, text in subjects((ROOT / path).read_text(encoding="utf-8")).items():
            if subject and anchor in map(anchor_of, re.findall(r"^#+ (.*)$", text, re.MULTILINE)):
                return f"{TAKEN[path].removesuffix('.md')}/{subject}.md"
    return TAKEN.get(path) or (path.removeprefix("docs/") if path.startswith("docs/") else None)


def generators_table() -> str:
    """Tabulate the generators of worlds and their parameters."""
    from jexplore.worlds import GENERATORS, generator_parameters

    def parameters(name):
        return ", ".join(f"`{key}={str(value).lower()}`" for key, value in generator_parameters(name).items())

    return table_of(["world", "parameters"], [(f"`{name}`", parameters(name)) for name in GENERATORS])


def strategies_table() -> str:
    """Tabulate the strategies and modifiers of this package, their parameters and sources."""
    from jexplore.policies import MODIFIERS
    from jexplore.policies.catalogue.grammar import strategies

    rows = [(f"`{name}`", summary, own.strip("-"), source) for name, summary, own, source in strategies()]
    modifiers = [(f"`+{name}`", text) for name, text in MODIFIERS.items()]
    return "\n".join(
        (
            table_of(["strategy", "goes to", "parameters", "source"], rows),
            table_of(["modifier, after any name", "meaning"], modifiers),
        )
    )


def notebooks() -> list[Path]:
    """List the notebooks of the repository, in order."""
    return sorted((ROOT / "notebooks").glob("*.ipynb"))


def benchmarks_table() -> str:
    """Tabulate the scripts of `benchmarks/` with the first paragraphs of their docstrings."""
    rows = []
    for path in sorted((ROOT / "benchmarks").glob("*.py")):
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        rows.append((f"`{path.name}`", " ".join(text.split("\n\n")[0].split())))
    return table_of(["script", "what it measures"], rows)


def example_code(*names: str) -> str:
    """Show functions and methods of `examples/episode.py`.

    Args:
      *names: of these; `imports` for what stands before the first.
    """
    text = (ROOT / "examples" / "episode.py").read_text(encoding="utf-8").split('"""\n\n', 1)[1]
    found = {"imports": text.split("\n\n\n")[0]}
    for part in re.split(r"\n{2,3}(?=(?: {4})?(?:@|def |class ))", text)[1:]:
        found[re.findall(r"(?:def|class) (\w+)", part)[0]] = part.split("\n\n\n")[0]
    shown = "\n\n".join(found[name] for name in names)
    return f"```python\n{textwrap.dedent(shown)}\n```"


def league_tables(name: str) -> str:
    """Format the standings of the entries of a league."""
    from jexplore.studies.results.league import league_text

    return league_text(ROOT / "leagues" / name, name)


def table_of(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table."""
    lines = [head, ["---"] * len(head), *([_safe(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def commands_text(commands: Mapping[str, type] | None = None) -> str:
    """Write the reference of every command, from the records of their options.

    Args:
      commands: name -> class of its options; by default all.
    """
    from jexplore.cli.main import COMMANDS

    parts: list[str] = []
    shared: dict[str, type] = {}
    for name, kind in (commands or COMMANDS).items():
        parts.append(f"## jexplore {name}\n\n{_summary(kind)}\n\n{_table(kind, '', shared)}")
    left = [*shared.items()]
    for name, kind in left:
        inner: dict[str, type] = {}
        parts.append(f"## Options of {name}\n\n{_summary(kind)}\n\n{_table(kind, name + '.', inner)}")
        left += inner.items()
    return "\n".join(parts)


def _summary(kind):
    return "\n".join(_escaped(line.strip()) for line in (kind.__doc__ or "").strip().splitlines())


def _table(kind, prefix, shared):
    """Tabulate the options of a record; those that are records go to `shared`."""
    from jexplore.cli.options import field_texts, fields_in_order, metavar_of

    texts, hints = field_texts(kind), typing.get_type_hints(kind, include_extras=True)
    rows, more = [], []
    for field in fields_in_order(kind):
        hint, settings = _unwrapped(hints[field.name])
        if dataclasses.is_dataclass(hint):
            shared[field.name] = hint
            more.append(f"[`--{field.name}.*`](#options-of-{field.name})")
            continue
        metavar = metavar_of(field.name, hint)
        option, default = _option(field, hint, settings, metavar, "" if field.metadata.get("short") else prefix)
        text = field.metadata.get("off") if field.default is True else None
        rows.append((f"`{option}`", default, text or texts.get(field.name, "")))
    below = f"\nAlso {', '.join(more)}.\n" if more else ""
    return table_of(["option", "default", "meaning"], rows) + below if rows else "It takes no options.\n"


def _option(field, hint, settings, metavar, prefix):
    """Return the form of an option, and its default."""
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    own = next((one.name for one in settings if getattr(one, "name", None)), field.name)
    name = f"--{prefix}{own}".replace("_", "-")
    if any("Positional" in str(one) for one in settings):
        return metavar or field.name.upper(), _default(default)
    if hint is bool:
        return (f"--{prefix}no-{field.name}".replace("_", "-"), "") if default else (name, "")
    if typing.get_origin(hint) is typing.Literal:
        metavar = "{" + ",".join(map(str, typing.get_args(hint))) + "}"
    kinds = [one for one in typing.get_args(hint) if one is not type(None)] or [hint]
    return f"{name} {metavar or getattr(kinds[0], '__name__', 'value').upper()}", _default(default)


def _unwrapped(hint):
    """Return a type without its annotations, and these: also of the types that it is a choice of."""
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
    """Escape text for a cell of a table."""
    return _escaped(text).replace("|", "\\|")


def _escaped(text):
    """Escape text so that its angle brackets are no HTML; code stays."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else part.replace("<", "&lt;") for part in parts)


PARTS = {
    "benchmarks": benchmarks_table,
    "league": league_tables,
    "generators": generators_table,
    "strategies": strategies_table,
    "commands": commands_text,
    "code": example_code,
}
"""Parts of pages: name in the mark -> function that writes it."""


def main() -> None:
    """Run the command line's request."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--site", type=Path, metavar="DIR", required=True, help="folder for the pages; emptied")
    write_site(parser.parse_args().site)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))  # this checkout's jexplore, not one that is installed
    main()
