"""Comments behind fields for mkdocstrings: the reference shows them for fields without a docstring."""

from typing import Any

import griffe

_NOT_FOR_READERS = ("noqa", "type:", "pyright:")


class Comments(griffe.Extension):
    """Gives fields of classes their comments as docstrings."""

    def on_attribute_instance(self, *, attr: griffe.Attribute, **more: Any) -> None:
        """Take the comment of an attribute, for every attribute that is found."""
        file, last = attr.filepath, attr.endlineno
        if attr.docstring is not None or attr.parent is None or not attr.parent.is_class or last is None:
            return
        assert not isinstance(file, list)  # as it is for a package without files
        text = comment_of(attr.lines_collection[file], attr.lineno or last, last)
        if text:
            attr.docstring = griffe.Docstring(text, parent=attr)


def comment_of(lines: list[str], first: int, last: int) -> str:
    """Return the comment behind a statement, else the comment lines above it; without its `#`.

    Args:
      lines: of the file.
      first, last: of the statement, from 1.
    """
    behind = lines[last - 1].partition("  # ")[2].strip()
    if behind and not behind.startswith(_NOT_FOR_READERS):
        return behind
    above = []
    for line in reversed(lines[: first - 1]):
        if not line.strip().startswith("# "):
            break
        above.insert(0, line.strip()[2:])
    return " ".join(above)
