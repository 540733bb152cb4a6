"""A finished map as another start would have it: the start's node on its link."""

import dataclasses
import math

from jexplore.config import InputError
from jexplore.tracemap.record import NOWHERE, BtmMap, Node, direction_deg

_SQUARE = 1e-9  # cosine: a heading that is no nearer to one end of the link than to the other


def topology_from(topology: BtmMap, pose: tuple[float, float, float]) -> BtmMap:
    """Return the map that a perfect robot would write, starting at a pose, until nothing is left.

    The start becomes a terminal node on the nearest link, which is split there: the link ahead is the first of the
    result, the one behind the last; all else keeps its order. If the heading is square to the link, its left counts as
    ahead. A start that the map already has, a first node of type terminal with two links, is removed before.

    Links of the whole map must run straight from node to node, as those of a course. The pose is x, y, metres; heading,
    degrees.
    """
    unknown = [link.id for link in topology.links if link.end == NOWHERE or link.length_m is None]
    if unknown or not topology.links:
        what = f"link {unknown[0]} has no end or no length" if unknown else "it has no link"
        raise InputError(f"expected a map whose links have both ends and lengths, got one where {what}")
    nodes, links = _without_start(topology)
    nearest = min(links, key=lambda link: (_distance_m(nodes, link, pose), link.id))
    root = Node(max(nodes) + 1, float(pose[0]), float(pose[1]), "terminal")
    before, after = _split(nodes[nearest.start], nearest, root)
    turn = math.radians(nearest.start_bearing_deg - pose[2])
    onward = math.cos(turn) if abs(math.cos(turn)) > _SQUARE else math.sin(turn)
    ahead, behind = (after, _turned(before)) if onward > 0 else (_turned(before), after)
    number = {old: new for new, old in enumerate((root.id, *nodes))}
    made = (
        dataclasses.replace(link, id=i, start=number[link.start], end=number[link.end])
        for i, link in enumerate((ahead, *(link for link in links if link is not nearest), behind))
    )
    placed = (dataclasses.replace(node, id=number[node.id]) for node in (root, *nodes.values()))
    return BtmMap(tuple(placed), tuple(made))


def _without_start(topology):
    """Return nodes by id and links, without the node where the map was begun."""
    first, *others = topology.nodes
    ends = [link for link in topology.links if first.id in (link.start, link.end)]
    if first.type != "terminal" or len(ends) != 2:
        return {node.id: node for node in topology.nodes}, list(topology.links)
    one = ends[0] if ends[0].end == first.id else _turned(ends[0])
    two = ends[1] if ends[1].start == first.id else _turned(ends[1])
    widths = [link.min_width_m for link in ends if link.min_width_m is not None]
    whole = {"length_m": round(one.length_m + two.length_m, 9), "min_width_m": min(widths, default=None)}
    joined = dataclasses.replace(one, end=two.end, end_bearing_deg=two.end_bearing_deg, **whole)
    return {node.id: node for node in others}, [*(link for link in topology.links if link not in ends), joined]


def _turned(link):
    """Return the link followed the other way."""
    bearings = {"start_bearing_deg": link.end_bearing_deg, "end_bearing_deg": link.start_bearing_deg}
    return dataclasses.replace(link, start=link.end, end=link.start, **bearings)


def _distance_m(nodes, link, pose):
    """Return the distance from a place to the straight way between the nodes of a link."""
    a, b = nodes[link.start], nodes[link.end]
    dx, dy, px, py = b.x_m - a.x_m, b.y_m - a.y_m, pose[0] - a.x_m, pose[1] - a.y_m
    share = min(max((px * dx + py * dy) / max(dx * dx + dy * dy, 1e-12), 0.0), 1.0)
    return math.hypot(px - share * dx, py - share * dy)


def _split(first, link, root):
    """Split a link at the start: the parts before and after."""
    bearing = math.radians(link.start_bearing_deg)
    along = (root.x_m - first.x_m) * math.cos(bearing) + (root.y_m - first.y_m) * math.sin(bearing)
    along = round(min(max(along, 0.0), link.length_m), 9)
    back = direction_deg(link.start_bearing_deg + 180.0)
    before = dataclasses.replace(link, end=root.id, end_bearing_deg=back, length_m=along)
    after = dataclasses.replace(link, start=root.id, length_m=round(link.length_m - along, 9))
    return before, after
