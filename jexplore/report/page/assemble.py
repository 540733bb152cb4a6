"""Pages that are one file: templates, styles and scripts of this folder put together, with what they show."""

import html
import importlib.resources
import json
import re
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
