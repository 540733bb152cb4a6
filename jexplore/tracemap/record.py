"""A Behavioral Trace Map on the host: typed nodes where a building has features, and the links between them.

Positions are metres, bearings degrees, counter-clockwise from +x. Plain Python: importing this loads no jax.
"""

import collections
import dataclasses
import functools
import math
import numbers
from collections.abc import Iterable, Mapping
from typing import Any

from jexplore.arrays.files import require_shallow
from jexplore.arrays.pictures import html_of, or_text
from jexplore.config import InputError, checked_names, shown

NODE_TYPES = ("terminal", "divergence", "free_space", "obstacle")
OBSTACLE_SHAPES = ("slope", "stairs")
STATUS = ("un-searched", "searched")
NOWHERE = -1  # end of a link that has not been followed
NODE_MARKS = {"terminal": "□", "divergence": "○", "free_space": "◇", "obstacle": "△"}
MOST_ID = 2**53 - 1  # whole numbers up to it are the same in every reader of JSON
MAX_METRES = 1e6  # what a map says in metres is less, where maps are merged or drawn


@dataclasses.dataclass(frozen=True)
class Node:
    """A place with a feature (Mano et al., Table I)."""

    id: int  # from 0 to `MOST_ID`, unique among the nodes
    x_m: float
    y_m: float
    type: str  # one of `NODE_TYPES`. A divergence is a dead end, a corner, a T or a crossing.
    obstacle: str | None = None  # one of `OBSTACLE_SHAPES`, of an obstacle node
    inclination_deg: float | None = None
    """Steepest inclination of the ground that the robot met there, degrees; of a slope."""
    step_m: float | None = None  # height of the highest step, metres; of stairs
    posture_deg: float | None = None  # largest inclination of the robot's body, degrees
    attributes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Extensions by name, such as `intervention` or `victim`: anything that JSON can hold, kept as it is."""


@dataclasses.dataclass(frozen=True)
class Link:
    """A way between two nodes, or out of one (Mano et al., Table II)."""

    id: int  # from 0 to `MOST_ID`, unique among the links
    start: int  # id of a node
    end: int  # id of a node; `NOWHERE` for a link that has not been followed
    status: str  # one of `STATUS`: searched if and only if it has an end
    start_bearing_deg: float
    """Direction in which the link leaves its first node; what this package writes lies in [0, 360)."""
    end_bearing_deg: float | None = None  # direction in which it leaves its last node; every link with an end has one
    length_m: float | None = None
    min_width_m: float | None = None  # narrowest passage along the link, metres
    posture_deg: float | None = None  # largest inclination of the robot's body along the link, degrees
    max_roll_deg: float | None = None  # largest roll of the robot's body along the link, to either side, degrees
    max_step_m: float | None = None
    """Highest step between the nodes, up or down, metres; 0 where none stands out of the sensors' noise. A single step
    is a node: its height is that node's."""
    opening_m: float | None = None  # width of the opening at the first node, metres
    attributes: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def length_of(link: Link, nodes: Mapping[int, Node]) -> float:
    """Return the length of a searched link, metres: as measured, else the straight line between nodes, by id."""
    if link.length_m is not None:
        return link.length_m
    one, other = nodes[link.start], nodes[link.end]
    return math.dist((one.x_m, one.y_m), (other.x_m, other.y_m))


def closings_of(btm: "BtmMap") -> int:
    """Count the cycles of a map: searched links beyond those of a spanning tree."""
    parts = set(connected_parts((node.id for node in btm.nodes), btm.links).values())
    return sum(link.end != NOWHERE for link in btm.links) - len(btm.nodes) + len(parts)


def connected_parts(nodes: Iterable[int], links: Iterable[Link]) -> dict[int, int]:
    """Return the connected parts of a map: node -> the first node of its part."""
    around, part = {own: [] for own in nodes}, {}
    for link in links:
        if link.end != NOWHERE:
            around[link.start].append(link.end)
            around[link.end].append(link.start)
    for first in around:
        left = [first]
        while left:
            here = left.pop()
            if here not in part:
                part[here] = first
                left += around[here]
    return part


def direction_deg(bearing_deg: float) -> float:
    """Return the bearing in [0, 360): a tiny negative one would round up to 360."""
    bearing_deg %= 360.0
    return 0.0 if bearing_deg == 360.0 else bearing_deg


@checked_names
@dataclasses.dataclass(frozen=True)
class BtmMap:
    """Nodes and links in the order of their making; the first node is where the robot started."""

    nodes: tuple[Node, ...]
    links: tuple[Link, ...]
    attributes: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def bearings_deg(self, node_id: int) -> list[float]:
        """Return bearings of a node's links: sorted list, degrees in [0, 360). A link to itself counts twice."""
        return [bearing for bearing, *_ in self.ends[node_id]]

    @functools.cached_property
    def ends(self) -> Mapping[int, list[tuple[float, int, int, Link]]]:
        """Return ends of links by node, counter-clockwise: `(bearing, id, 0 at the start of the link or 1, link)`."""
        found = collections.defaultdict(list)
        for link in self.links:
            found[link.start].append((direction_deg(link.start_bearing_deg), link.id, 0, link))
            if link.end_bearing_deg is not None:
                found[link.end].append((direction_deg(link.end_bearing_deg), link.id, 1, link))
        for ends in found.values():
            ends.sort(key=lambda end: end[:3])
        return found

    def angles_deg(self, node_id: int) -> list[float]:
        """Return angles between adjacent links of a node, counter-clockwise: as many as links, 360 degrees in all."""
        found = self.bearings_deg(node_id)
        return [after - before for before, after in zip(found, [*found[1:], *(bearing + 360 for bearing in found[:1])])]

    def with_attributes(
        self, attributes: Mapping[str, Any], *, node: int | None = None, link: int | None = None
    ) -> "BtmMap":
        """Return the map with attributes set: of a node, of a link (by id), or of the map if neither is named.

        They are such as `{"victim": True, "radio_dbm": -61}`: anything that JSON can hold.
        """
        if node is not None and link is not None:
            raise InputError("attributes are set of a node or of a link, not of both at once")
        own = _attributes(attributes, "attributes")
        if node is None and link is None:
            return dataclasses.replace(self, attributes={**self.attributes, **own})
        name, number = ("nodes", node) if link is None else ("links", link)
        items = getattr(self, name)
        if number not in {item.id for item in items}:
            raise InputError(f"there is no {name[:-1]} {number}: the map has {len(items)} {name}")
        changed = (
            dataclasses.replace(item, attributes={**item.attributes, **own}) if item.id == number else item
            for item in items
        )
        return dataclasses.replace(self, **{name: tuple(changed)})

    def __repr__(self) -> str:
        searched = sum(link.end != NOWHERE for link in self.links)
        return f"<BtmMap of {len(self.nodes)} nodes and {len(self.links)} links, {searched} of them searched>"

    @or_text
    def _repr_png_(self):
        from jexplore.tracemap.picture import map_png

        return map_png(self)

    @or_text
    def _repr_html_(self):
        kinds = [node.obstacle or node.type for node in self.nodes]
        rows = [
            (NODE_MARKS[n.type], kind.replace("_", " "), str(kinds.count(kind))) for n, kind in zip(self.nodes, kinds)
        ]
        searched = [link.length_m or 0.0 for link in self.links if link.end != NOWHERE]
        rows = [*dict.fromkeys(rows), ("—", f"searched link, {sum(searched):.1f} m in all", str(len(searched)))]
        if len(searched) < len(self.links):
            rows.append(("╌", "un-searched link", str(len(self.links) - len(searched))))
        return html_of(self._repr_png_(), repr(self)[1:-1], ("", "what", "how many"), rows)


def check_map(btm: BtmMap, name: str = '"map"') -> BtmMap:
    """Check the map: with plain Python numbers, lists and dicts, or a refusal.

    Ids are unique and not negative, links join nodes that are there, a link is searched if and only if it has an end
    and has a bearing at each end, types and states are the known ones, numbers are finite, lengths not negative, and
    attributes are what JSON can hold.

    Raises:
      InputError: beginning with `name`, with the node or link, the value and what would be right.
    """
    nodes, links = _records(btm.nodes, "nodes", name), _records(btm.links, "links", name)
    known = {node.id for node in nodes}
    for link in links:
        own, has_end = f"{name}: link {link.id}", link.end != NOWHERE
        if link.start not in known:
            raise InputError(f"{own} starts at node {link.start}, which is not there")
        if has_end and link.end not in known:
            raise InputError(f"{own} ends at node {link.end}, which is not there")
        if link.status != STATUS[has_end]:
            end = f"ends at node {link.end}" if has_end else "has no end"
            raise InputError(f'{own} {end}, so it must be {STATUS[has_end]}, got "{link.status}"')
        if (link.end_bearing_deg is not None) != has_end:
            raise InputError(f"{own} must have an end_bearing_deg if it has an end, and only then")
    return BtmMap(nodes, links, _attributes(btm.attributes, f"{name}: attributes"))


def require_near(btm: BtmMap, name: str) -> None:
    """Refuse places, lengths and widths of 1000 km or more, which no drawing holds: an `InputError` with the name."""
    found = [(f"node {node.id}", value) for node in btm.nodes for value in (node.x_m, node.y_m)]
    for link in btm.links:
        found += [(f"link {link.id}", value or 0.0) for value in (link.length_m, link.min_width_m, link.opening_m)]
    for what, value in found:
        if not abs(value) < MAX_METRES:
            raise InputError(
                f"{name}: {what}: expected places and lengths below {MAX_METRES / 1000:g} km, got {value:g} m"
            )


def item_name(member: str, index: int, number: object) -> str:
    """Return the name of an item of `nodes` or `links` for errors: its id if that is a number, else its index."""
    return f"{member[:-1]} {number}" if type(number) is int else f"{member}[{index}]"


def _records(items, member, name):
    made, taken = [], set()
    for index, item in enumerate(items):
        own = f"{name}: {item_name(member, index, item.id)}"
        values = {field.name: _value(field, getattr(item, field.name), own) for field in dataclasses.fields(item)}
        record = dataclasses.replace(item, **values)
        if record.id in taken:
            raise InputError(f"{name}: {member[:-1]} ids must differ, got {record.id} again")
        taken.add(record.id)
        made.append(record)
    return tuple(made)


_CHOICES = {"type": NODE_TYPES, "obstacle": OBSTACLE_SHAPES, "status": STATUS}
_LENGTHS = ("step_m", "length_m", "min_width_m", "max_step_m", "opening_m")


def _value(field, value, own):
    """Convert a field's value to its declared type; text only to one of its choices."""
    if value is None and field.default is None:
        return None
    if field.name == "attributes":
        return _attributes(value, f"{own}: attributes")
    if field.name in _CHOICES:
        if isinstance(value, str) and value in _CHOICES[field.name]:
            return value
        what = "one of " + ", ".join(_CHOICES[field.name])
    elif field.type is int:
        low = NOWHERE if field.name == "end" else 0
        if isinstance(value, numbers.Integral) and not isinstance(value, bool) and low <= int(value) <= MOST_ID:
            return int(value)
        what = f"an integer from {low} to {MOST_ID}"
    else:
        number = _finite(value)
        if number is not None and (number >= 0 or field.name not in _LENGTHS):
            return number
        what = "a finite number" + (" of at least 0" if field.name in _LENGTHS else "")
    raise InputError(f"{own}: {field.name} must be {what}, got {shown(value)}")


def _finite(value):
    """Convert `value` to a float, None if it is no finite number."""
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _attributes(value, own):
    if not isinstance(value, Mapping):
        raise InputError(f"{own} must be an object, got {shown(value)}")
    require_shallow(value, own)
    return _plain(value, own)


def _plain(value, own) -> Any:
    """Convert an attribute to plain JSON types."""
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    number = _finite(value)
    if number is not None:
        return number
    if isinstance(value, (list, tuple)):
        return [_plain(item, own) for item in value]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: _plain(item, own) for key, item in value.items()}
    raise InputError(f"{own} must be what JSON can hold, with finite numbers, got {shown(value)}")
