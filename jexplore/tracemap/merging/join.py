"""One map of two: what they have in common once, everything else as it is."""

import dataclasses
from typing import Any

from jexplore.tracemap.merging.match import Match
from jexplore.tracemap.merging.pair import least_known, most_known
from jexplore.tracemap.merging.rigid import mean_deg, moved_map
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link, Node, direction_deg

FROM = "from"  # attribute of nodes and links: name of a map -> the id that they have there
_EDGE_M = 0.01  # a stop lies no nearer to the end of a whole way


def join(one: BtmMap, other: BtmMap, match: Match) -> BtmMap:
    """Join the second map to the first, in the frame of the first.

    Matched places and bearings are averaged, every map counting once. So are lengths; of widths the least counts, of
    inclinations and steps the most. A searched link wins over an un-searched one. A terminal node of one map on a link
    of the other divides it; both parts have the extremes of the whole. Contradicting ways are both kept.

    The maps' nodes and links have no attribute but `FROM`, by which maps are counted. Ids begin at 0: nodes and links
    of the first map in their order, then those that only the second has.
    """
    other = moved_map(other, match.move)
    first_free = 1 + max((node.id for node in one.nodes), default=-1)
    ids = {node.id: match.nodes.get(node.id, first_free + i) for i, node in enumerate(other.nodes)}
    nodes = {node.id: node for node in one.nodes}
    for node in other.nodes:
        own = ids[node.id]
        nodes[own] = _node(nodes[own], node) if own in nodes else dataclasses.replace(node, id=own)
    links = [{link.id: (side, i) for i, link in enumerate(btm.links)} for side, btm in enumerate((one, other))]
    turned = {link.id: link for link in other.links}
    found, used = [], (set(), set())
    for bundle in _bundles(match.ways):
        strands = [_strand(side, way, *((turned, ids) if side else ({}, {})), is_far) for side, way, is_far in bundle]
        for strand in strands:
            used[strand.side].update(link.id for link, _ in strand.steps)
        found += [(links[side][number], piece) for piece, (side, number) in _pieces(strands)]
    found += [(links[0][link.id], link) for link in one.links if link.id not in used[0]]
    for link in other.links:
        if link.id not in used[1]:
            end = NOWHERE if link.end == NOWHERE else ids[link.end]
            found.append((links[1][link.id], dataclasses.replace(link, start=ids[link.start], end=end)))
    number = {key: i for i, key in enumerate(nodes)}
    found.sort(key=lambda item: item[0])
    return BtmMap(
        tuple(dataclasses.replace(node, id=number[key]) for key, node in nodes.items()),
        tuple(
            dataclasses.replace(link, id=i, start=number[link.start], end=number.get(link.end, NOWHERE))
            for i, (_, link) in enumerate(found)
        ),
    )


def _weight(item):
    return float(len(item.attributes[FROM]))


def _from(*items):
    """Merge the `FROM` of matched items. Pieces of one link count as one."""
    return {FROM: {name: key for item in items for name, key in item.attributes[FROM].items()}}


def _mean(values, weights):
    known = [(value, weight) for value, weight in zip(values, weights) if value is not None]
    return sum(value * weight for value, weight in known) / sum(weight for _, weight in known) if known else None


def _node(a: Node, b: Node) -> Node:
    weights = [_weight(a), _weight(b)]
    values = {name: _mean([getattr(a, name), getattr(b, name)], weights) for name in ("x_m", "y_m")}
    for name in ("inclination_deg", "step_m", "posture_deg"):
        values[name] = most_known([getattr(a, name), getattr(b, name)])
    return dataclasses.replace(a, **values, attributes=_from(a, b))


def _bundles(ways):
    """Bundle equal ways: lists of `(map, way, bool: seen from the far end)`.

    A way that one map has gone along may be known to the other at both ends: these are three then.
    """
    found, long = [], {}
    for pair in ways:
        whole = [side for side in (0, 1) if pair[side].is_whole]
        bundle = [(0, pair[0], False), (1, pair[1], False)]
        if len(whole) == 1:
            key = (whole[0], frozenset(link.id for link, _ in pair[whole[0]].steps))
            if key in long:
                long[key].append((1 - whole[0], pair[1 - whole[0]], True))
                continue
            long[key] = bundle
        found.append(bundle)
    return found


@dataclasses.dataclass
class _Strand:
    """A way of one of the maps, told in ids of the first."""

    side: int
    steps: list[tuple[Link, bool]]
    stops: list[tuple[int, float]]
    is_whole: bool
    is_far: bool
    length_m: float
    start: int


def _strand(side, way, turned, ids, is_far):
    steps = [(turned.get(link.id, link), forward) for link, forward in way.steps]
    link, forward = way.steps[0]
    start = link.start if forward else link.end
    stops = [*way.stops, (way.end, way.length_m)] if way.is_whole else list(way.stops)
    stops = [(ids.get(node, node), at) for node, at in stops]
    return _Strand(side, steps, stops, way.is_whole, is_far, way.length_m, ids.get(start, start))


def _pieces(strands: list[_Strand]):
    """Yield the links of equal ways, outwards, each with its place in the order: `(map, id of a link)`."""
    stops = _common_stops(strands)
    order = {node: k for k, (node, _) in enumerate(stops, 1)}
    covers = [[] for _ in range(len(stops) + 1)]
    for strand in strands:
        at, out = (len(stops), -1) if strand.is_far else (0, 1)
        for m, (link, forward) in enumerate(strand.steps):
            is_known = m < len(strand.stops)
            end = order[strand.stops[m][0]] if is_known else at + out
            end = min(at, end) if strand.is_far else max(at, end)
            low, high = sorted((at, end))
            for k in range(low, high):  # piece k lies between stop k and stop k + 1, stop 0 is the place
                first, last = k == low, k == high - 1
                if strand.is_far:
                    covers[k].append((strand.side, link, not forward, first and is_known, last))
                else:
                    covers[k].append((strand.side, link, forward, first, last and is_known))
            at = end
    here, at, back = strands[0].start, 0.0, None
    for k, cover in enumerate(covers):
        if cover:
            end, there = stops[k] if k < len(stops) else (NOWHERE, at)
            piece, back = _piece(cover, here, end, there - at, back)
            yield piece, (cover[0][0], cover[0][1].id)
            here, at = end, there


def _common_stops(strands):
    """Merge stops of all strands in order: `(node, metres)`; the end of a whole way is the last."""
    whole = [strand for strand in strands if strand.is_whole and strand.length_m > 0]
    weights = [min(_weight(link) for link, _ in strand.steps) for strand in whole]
    length = _mean([strand.length_m for strand in whole], weights)
    last, at = next((strand.stops[-1][0] for strand in strands if strand.is_whole), None), {}
    for strand in strands:
        scale = length / strand.length_m if strand in whole and length is not None else 1.0
        for node, along in strand.stops:
            at.setdefault(node, []).append((length or 0.0) - along if strand.is_far else along * scale)
    found = {node: sum(many) / len(many) for node, many in at.items()}
    if last is not None:
        most_m = max(found[last] - _EDGE_M, 0.0)
        found = {node: along if node == last else min(max(along, 0.0), most_m) for node, along in found.items()}
    return sorted(found.items(), key=lambda item: (item[0] == last, item[1]))


def _piece(cover, start, end, length_m, back_before):
    """Join the links from stop to stop, `(map, link, forward, begins here, ends here)`, in the direction of the first.

    Return the link, and the direction in which it leaves its far end.
    """
    links = [link for _, link, _, _, _ in cover]
    forward = cover[0][2]
    near = [(_near(link, ahead), _weight(link)) for _, link, ahead, begins, _ in cover if begins]
    far = [(_near(link, not ahead), _weight(link)) for _, link, ahead, _, ends in cover if ends]
    out = mean_deg(*map(list, zip(*near))) if near else direction_deg((back_before or 0.0) + 180.0)
    back = mean_deg(*map(list, zip(*far))) if far else direction_deg(out + 180.0)
    is_searched = end != NOWHERE
    measured = any(link.length_m is not None for link in links)
    openings = [
        link.opening_m for _, link, ahead, begins, ends in cover if ahead == forward and (begins if ahead else ends)
    ]
    ends = (start, end, out, back) if forward else (end, start, back, out)
    values: dict[str, Any] = {
        "length_m": length_m if measured and is_searched else None,
        "min_width_m": least_known(link.min_width_m for link in links),
        "opening_m": _mean(openings, [1.0] * len(openings)),
        **{
            name: most_known(getattr(link, name) for link in links)
            for name in ("posture_deg", "max_roll_deg", "max_step_m")
        },
    }
    end_bearing = ends[3] if is_searched else None
    piece = Link(0, ends[0], ends[1], STATUS[is_searched], ends[2], end_bearing, **values, attributes=_from(*links))
    return piece, back


def _near(link, forward):
    """Return the direction in which a link leaves the stop that one comes from."""
    bearing = link.start_bearing_deg if forward else link.end_bearing_deg
    return link.start_bearing_deg if bearing is None else bearing
