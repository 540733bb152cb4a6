"""Write what the documentation has from the code: tables, the commands' options, what the Python names mean.

    python docs/generate.py                     the pages of the repository; a test tells when they are stale
    python docs/generate.py --site build/docs   all pages of the site, for `mkdocs build`

The site has four files of the repository as pages, one of them by subject, the notebooks with their outputs, and the
whole docstring of every Python name.
"""

import argparse
import ast
import base64
import dataclasses
import itertools
import json
import os
import re
import shutil
import sys
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
COMMANDS_PAGE = "reference/commands.md"
SHOWN = (".css", ".png", ".gif")
"""Endings of the files of `docs/` that the site has besides pages."""
_LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
_FENCE = re.compile(r"(^ *```.*?^ *```$)", re.MULTILINE | re.DOTALL)
_PART = re.compile(r"<!-- begin (\w+)(?:: ([\w. -]+))? -->\n.*?<!-- end -->\n", re.DOTALL)


def generated() -> dict[str, str]:
    """Return the pages with generated parts, path below `docs/` -> text, as they should be."""
    from jexplore.cli.main import COMMANDS

    pages = {COMMANDS_PAGE: commands_page(COMMANDS)}
    for path in sorted(DOCS.rglob("*.md")):
        text = path.read_text(encoding="utf-8")
        if _PART.search(text):
            pages[path.relative_to(DOCS).as_posix()] = _PART.sub(_filled, text)
    return pages


def _filled(part):
    """Fill in a part of a page between its two marks."""
    name, given = part[1], (part[2] or "").split()
    begin = part[0].splitlines()[0]
    return f"{begin}\n\n{PARTS[name](*given)}\n<!-- end -->\n"


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
            files[name] = rewritten(_PART.sub(_whole, path.read_text(encoding="utf-8")), f"docs/{name}")
        elif path.suffix in SHOWN:
            files[name] = path.read_bytes()
    for source, page in TAKEN.items():
        text = (ROOT / source).read_text(encoding="utf-8")
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


def _whole(part):
    """Return the directives for whole docstrings, in place of the repository's line for every name."""
    if part[1] != "api":
        return part[0]
    return "\n\n".join(f"::: jexplore.{name}" for name in part[2].split()) + "\n"


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


def notebooks_table() -> str:
    """Tabulate the notebooks with their first heading and the question in bold below."""
    rows = []
    for path in notebooks():
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
        heading, question = re.findall(r"^# (.+)|\*\*([^*]+)\*\*", text, re.MULTILINE)[:2]
        rows.append((f"[{path.stem}](../../notebooks/{path.name})", heading[0], " ".join(question[1].split())))
    return table_of(["notebook", "subject", "question"], rows)


def api_table(*names: str) -> str:
    """Tabulate Python names, the modules that define them, and the first sentence of their docstrings.

    Args:
      *names: below `jexplore`, dotted where they are not the package's own.
    """
    import jexplore as jx

    home = jx._LAZY.module_of | {f"btm.{name}": module for name, module in jx.btm._LAZY.module_of.items()}
    rows = []
    for name in names:
        module, own = home.get(name, name.rpartition(".")[0]), name.rpartition(".")[2]
        path, text = defined(f"jexplore.{module}", own)
        meaning = " ".join((text or "").split("\n\n")[0].split())
        where = f"../../../{path.relative_to(ROOT).as_posix()}"
        rows.append((f"[`{'jx.' if name in home else 'jexplore.'}{name}`]({where})", meaning))
    return table_of(["name", "meaning"], rows)


def defined(module: str, name: str) -> tuple[Path, str | None]:
    """Return the file that defines a name of a module, and its docstring there; nothing is imported.

    Args:
      module: dotted.
      name: a function, a class, a value or a module below it; what the module imports is followed.

    Raises:
      KeyError: the module has no such name.
    """
    for at in (f"{module}.{name}", module):
        file = ROOT.joinpath(*at.split("."))
        file = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
        if file.exists():
            break
    tree = ast.parse(file.read_text(encoding="utf-8"))
    if at != module:
        return file, ast.get_docstring(tree)
    for after, node in itertools.pairwise([ast.Pass(), *reversed(tree.body)]):  # the last one, not its overloads
        if getattr(node, "name", None) == name:
            return file, ast.get_docstring(node)  # pyright: ignore[reportArgumentType]
        if isinstance(node, ast.ImportFrom) and name in (alias.name for alias in node.names):
            return defined(node.module or "", name)
        targets = getattr(node, "targets", [getattr(node, "target", None)])
        if any(isinstance(target, ast.Name) and target.id == name for target in targets):
            return file, ast.get_docstring(ast.Module([after], []))
    raise KeyError(f"{module} has no {name}")


def league_tables(name: str) -> str:
    """Format the standings of the entries of a league."""
    from jexplore.studies.results.league import league_text

    return league_text(ROOT / "leagues" / name, name)


PARTS = {
    "league": league_tables,
    "generators": generators_table,
    "strategies": strategies_table,
    "notebooks": notebooks_table,
    "api": api_table,
}
"""Parts of pages: what stands between `<!-- begin NAME -->` and `<!-- end -->`."""


def table_of(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table."""
    lines = [head, ["---"] * len(head), *([_safe(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def commands_page(commands: Mapping[str, type]) -> str:
    """Write the reference of every command, from the records of their options.

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
    from jexplore.cli.options import field_texts, fields_in_order

    texts, hints = field_texts(kind), typing.get_type_hints(kind, include_extras=True)
    rows, more = [], []
    for field in fields_in_order(kind):
        hint, settings = _unwrapped(hints[field.name])
        if dataclasses.is_dataclass(hint):
            shared[field.name] = hint
            more.append(f"[`--{field.name}.*`](#options-of-{field.name})")
            continue
        option, default = _option(field, hint, settings, "" if field.metadata.get("short") else prefix)
        text = field.metadata.get("off") if field.default is True else None
        rows.append((f"`{option}`", default, text or texts.get(field.name, "")))
    below = f"\nAlso {', '.join(more)}.\n" if more else ""
    return table_of(["option", "default", "meaning"], rows) + below if rows else "It takes no options.\n"


def _option(field, hint, settings, prefix):
    """Return the form of an option, and its default."""
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    metavar = next((one.metavar for one in settings if getattr(one, "metavar", None)), None)
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


def main() -> None:
    """Run the command line's request."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--site", type=Path, metavar="DIR", help="all pages of the site into this folder")
    site = parser.parse_args().site
    if site is not None:
        write_site(site)
        return
    for name, text in generated().items():
        (DOCS / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))  # this checkout's jexplore, not one that is installed
    main()
