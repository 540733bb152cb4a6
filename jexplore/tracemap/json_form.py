"""The JSON form of Behavioral Trace Maps. Plain Python: importing this loads no jax."""

import dataclasses
import json
import os
from typing import Any

from jexplore.arrays.files import json_of, read_text
from jexplore.config import InputError, checked_names, shown
from jexplore.tracemap.record import BtmMap, Link, Node, check_map, item_name

MAP_FORMAT = "behavioral-trace-map"
VERSION = (1, 1)  # the first number changes where an older reader would go wrong, the second where it would not
MAX_MAP_BYTES = 2**26  # of a file that is read: that of a hundred thousand nodes and links
WANTED = "give the btm.json that `jexplore trace` writes"
OTHER_FILES = {
    "command": "the record of a run",
    "is_found": "a route, the result of `jexplore route`",
}
"""Contents of other files next to a map, by a member that identifies them."""


def to_json(btm: BtmMap) -> dict[str, Any]:
    """Convert the map to nested dicts and lists for `store.write_json`, every number as it is.

    Besides the fields of the records a node has `links`, their number, and `angles_deg`, the angles between adjacent
    ones, as Table I has them; readers take both from the links instead.

    Raises:
      InputError: the map is not a proper one; see `record.check_map`.
    """
    btm = check_map(btm)
    nodes = [dict(vars(node)) for node in btm.nodes]
    for node in nodes:
        attributes, angles = node.pop("attributes"), btm.angles_deg(node["id"])
        node |= {"links": len(angles), "angles_deg": angles, "attributes": attributes}
    head = {"format": MAP_FORMAT, "version": list(VERSION), "attributes": btm.attributes}
    return {**head, "nodes": nodes, "links": [dict(vars(link)) for link in btm.links]}


@checked_names
def read_btm(path: str | os.PathLike[str]) -> BtmMap:
    """Read the map in a JSON file, such as `btm.json`.

    Raises:
      InputError: the file cannot be read, is no JSON or no map.
    """
    path = os.fspath(path)
    if os.path.isdir(path):
        raise InputError(f"{_quoted(path)}: is a directory; {WANTED} in it")
    return parse_map(read_text(path, MAX_MAP_BYTES), path)


def parse_map(text: str, name: str) -> BtmMap:
    """Parse the text of a JSON file. As `from_json`."""
    return from_json(json_of(text, _quoted(name)), name)


def from_json(obj: Any, name: str = "map") -> BtmMap:
    """Convert the result of `to_json` back to the map. Fields that this version does not know are skipped.

    Raises:
      InputError: another format, a newer major version, or not a proper map; see `record.check_map`.
    """
    own, told = obj if isinstance(obj, dict) else {}, _quoted(name)
    if own.get("format") != MAP_FORMAT:
        got = shown(own.get("format")) if isinstance(obj, dict) else f"a {type(obj).__name__}"
        what = next((f"is {other}" for key, other in OTHER_FILES.items() if key in own), None)
        what = what or f'format must be "{MAP_FORMAT}", got {got}'
        raise InputError(f"{told}: {what}; {WANTED}")
    version = own.get("version")
    pair = version if isinstance(version, list) and [type(part) for part in version] == [int, int] else (0, -1)
    if pair[0] != VERSION[0] or pair[1] < 0:
        raise InputError(f"{told}: version must be [{VERSION[0]}, 0] or a later minor one, got {shown(version)}")
    nodes, links = _records(Node, own, "nodes", told), _records(Link, own, "links", told)
    return check_map(BtmMap(nodes, links, own.get("attributes", {})), told)


def _quoted(name):
    return json.dumps(name, ensure_ascii=False)


def _records(kind, obj, member, name):
    """Make records with values that are not checked yet."""
    items, made = obj.get(member), []
    if not isinstance(items, list):
        raise InputError(f"{name}: {member} must be a list, got {shown(items)}")
    for index, item in enumerate(items):
        if not isinstance(item, dict):
            raise InputError(f"{name}: {member}[{index}] must be an object, got {shown(item)}")
        values = {field.name: item[field.name] for field in dataclasses.fields(kind) if field.name in item}
        try:
            made.append(kind(**values))
        except TypeError:
            missing = next(field.name for field in dataclasses.fields(kind) if field.name not in item)
            own = f"{name}: {item_name(member, index, item.get('id'))}"
            raise InputError(f"{own}: {missing} is missing") from None
    return tuple(made)
