"""Pages that are one file: templates, styles and scripts of this folder put together, with what they show."""

import html
import importlib.resources
import json
import re
from collections.abc import Sequence
from typing import Any


def html_text(text: object) -> str:
    """Escape any text for HTML, in plain ASCII, so that a page may be written in any encoding."""
    return html.escape(str(text)).encode("ascii", "xmlcharrefreplace").decode("ascii")


def script_data(found: Any) -> str:
    """Format JSON for a script of a page: no text in it can end the script."""
    text = json.dumps(found, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def map_page(kind: str, title: str, data: Any, scripts: Sequence[str], **parts: str) -> str:
    """Return a page of Behavioral Trace Maps: one HTML file that needs no network, no server and no other file.

    Args:
      kind: "station" or "trace": names the body and the style.
      data: for the scripts, plain JSON types.
      scripts: names of files, in order; they follow replay.js and tracemap.js in one scope.
      **parts: HTML of the body by name.
    """
    return assembled(
        "map.html",
        title=html_text(title),
        own_style=assembled(f"{kind}.css"),
        own_body=assembled(f"{kind}.html", **parts),
        own_script="\n".join(map(assembled, scripts)),
        data=script_data(data),
    )


def assembled(template: str, **parts: str) -> str:
    """Fill in a file of this folder at the names in double braces.

    Args:
      **parts: HTML by name, inserted as it is. Any other name is that of another file of this folder, filled in the
        same way.
    """

    def fill(match):
        return parts[match[1]] if match[1] in parts else assembled(match[1], **parts)

    text = importlib.resources.files("jexplore.report.page").joinpath(template).read_text(encoding="utf-8")
    return re.sub(r"\{\{([a-z][a-z._]*)\}\}", fill, text.rstrip("\n"))
