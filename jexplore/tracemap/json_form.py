"""The JSON form of Behavioral Trace Maps. Plain Python: importing this loads no jax."""

import bisect
import dataclasses
import functools
import json
import os
import re
from typing import Any

from jexplore.arrays.files import json_of, read_text
from jexplore.config import InputError, checked_names, shown
from jexplore.tracemap.record import BtmMap, Link, Node, called, check

FORMAT = "behavioral-trace-map"
VERSION = (1, 1)
"""The first number changes where an older reader would go wrong, the second where it would not."""


MOST_BYTES = 2**26
"""Of a file that is read: that of a hundred thousand nodes and links."""
WANTED = "give the btm.json that `jexplore trace` writes"
OTHERS = {
    "features": "GeoJSON, such as the route graph for Nav2",
    "command": "the record of a run",
    "is_found": "a route, the result of `jexplore route`",
}
"""Contents of other files next to a map, by a member that identifies them."""


def to_json(btm: BtmMap) -> dict[str, Any]:
    """Convert the map to nested dicts and lists for `store.write_json`, every number as it is.

    Besides the fields of the records a node has `links`, their number, and `angles_deg`, the angles between adjacent
    ones, as Table I has them; readers take both from the links instead.

    Raises:
      InputError: the map is not a proper one; see `record.check`.
    """
    btm = check(btm)
    nodes = []
    for node in btm.nodes:
        angles, item = btm.angles_deg(node.id), dict(vars(node))
        attributes = item.pop("attributes")
        nodes.append({**item, "links": len(angles), "angles_deg": angles, "attributes": attributes})
    return {
        "format": FORMAT,
        "version": list(VERSION),
        "attributes": btm.attributes,
        "nodes": nodes,
        "links": [dict(vars(link)) for link in btm.links],
    }


@checked_names
def read_btm(path: str | os.PathLike[str]) -> BtmMap:
    """Read the map in a JSON file, such as `btm.json`.

    Args:
      path: the file.

    Returns:
      `BtmMap`.

    Raises:
      InputError: the file cannot be read, is no JSON or no map; with the line.
    """
    path = os.fspath(path)
    if os.path.isdir(path):
        raise InputError(f"{_quoted(path)}: is a directory; {WANTED} in it")
    return parse(read_text(path, MOST_BYTES), path)


def parse(text: str, name: str) -> BtmMap:
    """Parse the text of a JSON file. As `from_json`, and errors name the line.

    Raises:
      InputError: the text is no JSON, or no map.
    """
    if text.lstrip().startswith("<"):
        raise InputError(f"{_quoted(name)}: is XML, such as GraphML; {WANTED}")
    obj = json_of(text, _quoted(name))
    return _read(obj, functools.partial(_where, name, _lines(text) if isinstance(obj, dict) else {}))


def from_json(obj: Any, name: str = "map") -> BtmMap:
    """Convert the result of `to_json` back to the map. Fields that this version does not know are skipped.

    Args:
      obj: nested dicts and lists.
      name: what the user calls it, for errors.

    Raises:
      InputError: another format, a newer major version, or not a proper map; see `record.check`.
    """
    return _read(obj, functools.partial(_where, name, {}))


def _where(name, lines, member, index=None):
    line = lines.get((member, index), lines.get((member, None)))
    return f"{_quoted(name)}: line {line}" if line else _quoted(name)


def _quoted(name):
    """Return a name on one line."""
    return json.dumps(name, ensure_ascii=False)


def _lines(text):
    """Return the line of every outer member, and of its arrays' elements: `{(name, index or None): line}`.

    The text is known to be JSON, so commas and colons need no more care than blanks.
    """
    decode, found = json.JSONDecoder().raw_decode, {}
    newlines = [match.start() for match in re.finditer("\n", text)]

    def past(at):
        while text[at : at + 1] in set(" \t\r\n,:"):
            at += 1
        return at

    def line(at):
        return bisect.bisect(newlines, at) + 1

    at = past(text.index("{") + 1)
    while text[at] != "}":
        member, at = decode(text, at)
        at = past(at)
        found[member, None] = line(at)
        if text[at] == "[":
            at, index = past(at + 1), 0
            while text[at] != "]":
                found[member, index] = line(at)
                at, index = past(decode(text, at)[1]), index + 1
            at = past(at + 1)
        else:
            at = past(decode(text, at)[1])
    return found


def _read(obj, where):
    own = obj if isinstance(obj, dict) else {}
    if own.get("format") != FORMAT:
        got = shown(own.get("format")) if isinstance(obj, dict) else f"a {type(obj).__name__}"
        what = next((f"is {other}" for key, other in OTHERS.items() if key in own), None)
        what = what or f'format must be "{FORMAT}", got {got}'
        raise InputError(f"{where('format')}: {what}; {WANTED}")
    version = obj.get("version")
    pair = version if isinstance(version, list) and [type(part) for part in version] == [int, int] else (0, -1)
    if pair[0] != VERSION[0] or pair[1] < 0:
        raise InputError(
            f"{where('version')}: version must be [{VERSION[0]}, 0] or a later minor one, got {shown(version)}"
        )
    nodes, links = (_records(kind, obj, member, where) for kind, member in ((Node, "nodes"), (Link, "links")))
    return check(BtmMap(nodes, links, obj.get("attributes", {})), where)


def _records(kind, obj, member, where):
    """Make records with values that are not checked yet."""
    items, made = obj.get(member), []
    if not isinstance(items, list):
        raise InputError(f"{where(member)}: {member} must be a list, got {shown(items)}")
    for index, item in enumerate(items):
        if not isinstance(item, dict):
            raise InputError(f"{where(member, index)}: {member}[{index}] must be an object, got {shown(item)}")
        values = {field.name: item[field.name] for field in dataclasses.fields(kind) if field.name in item}
        try:
            made.append(kind(**values))
        except TypeError:
            missing = next(field.name for field in dataclasses.fields(kind) if field.name not in item)
            own = f"{where(member, index)}: {called(member, index, item.get('id'))}"
            raise InputError(f"{own}: {missing} is missing") from None
    return tuple(made)
