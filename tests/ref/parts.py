"""Parts of true Behavioral Trace Maps as robots would write them, each with a start, a frame and a drift of its own."""

import collections
import dataclasses
import math

from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link, Node

EXACT = {"scale": 0.0, "walk_deg": 0.0, "place_m": 0.0, "bearing_deg": 0.0, "width_m": 0.0}
DRIFT = {"scale": 0.05, "walk_deg": 2.0, "place_m": 0.05, "bearing_deg": 2.0, "width_m": 0.05}


@dataclasses.dataclass(frozen=True)
class Part:
    """Part of a true map written by one robot."""

    map: BtmMap
    true: dict[int, int]
    """Node -> node of the true map; a start on a link has none."""
    place: dict[int, tuple[float, float]]
    """Node -> where it truly lies."""


def part_of(truth, rng, errors=None, least=0.3):
    """A connected part of a true map, from a random start to a random extent, with errors: a `Part`."""
    errors = DRIFT if errors is None else errors
    divided, start = _started(truth, rng)
    nodes, ends = {node.id: node for node in divided.nodes}, collections.defaultdict(list)
    for link in divided.links:
        ends[link.start].append((link, True))
        if link.end != NOWHERE:
            ends[link.end].append((link, False))
    scale = 1 + rng.uniform(-1, 1) * errors["scale"]
    poses = {start: (0.0, 0.0, rng.uniform(0, 360))}  # metres, and by how much bearings are turned
    searched = {}
    wanted = max(1, round(rng.uniform(least, 1.0) * sum(link.end != NOWHERE for link in divided.links)))
    while len(searched) < wanted:
        open_ways = [
            (at, *end) for at in poses for end in ends[at] if end[0].id not in searched and end[0].end != NOWHERE
        ]
        if not open_ways:
            break
        at, link, forward = rng.choice(open_ways)
        far = link.end if forward else link.start
        length = link.length_m * scale + rng.gauss(0, errors["place_m"])
        searched[link.id] = max(length, 0.1)
        if far not in poses:
            poses[far] = _driven(nodes, at, far, poses[at], scale, errors["walk_deg"] * math.sqrt(link.length_m), rng)
    return _written(divided, truth, start, poses, searched, errors, rng)


def _started(truth, rng):
    """The map with a terminal node where a robot starts: on a link, or one that is there."""
    terminals = [node.id for node in truth.nodes if node.type == "terminal"]
    long = [link for link in truth.links if link.end != NOWHERE and link.length_m > 2]
    if terminals and rng.random() < 0.2:
        return truth, rng.choice(terminals)
    link, along = rng.choice(long), rng.uniform(0.2, 0.8)
    nodes = {node.id: node for node in truth.nodes}
    a, b = nodes[link.start], nodes[link.end]
    new = max(nodes) + 1
    middle = Node(new, a.x_m + along * (b.x_m - a.x_m), a.y_m + along * (b.y_m - a.y_m), "terminal")
    back = (link.start_bearing_deg + 180) % 360
    last = max(one.id for one in truth.links) + 1
    first = dataclasses.replace(link, end=new, end_bearing_deg=back, length_m=along * link.length_m)
    second = dataclasses.replace(
        link,
        id=last,
        start=new,
        start_bearing_deg=(link.end_bearing_deg + 180) % 360,
        length_m=(1 - along) * link.length_m,
    )
    links = [first if one is link else one for one in truth.links]
    return BtmMap((*truth.nodes, middle), (*links, second)), new


def _driven(nodes, at, far, pose, scale, walk_deg, rng):
    x, y, turn = pose
    off = rng.gauss(0, 1) * walk_deg
    angle = math.radians(turn + off / 2)
    dx, dy = scale * (nodes[far].x_m - nodes[at].x_m), scale * (nodes[far].y_m - nodes[at].y_m)
    cos, sin = math.cos(angle), math.sin(angle)
    return x + cos * dx - sin * dy, y + sin * dx + cos * dy, turn + off


def _written(divided, truth, start, poses, searched, errors, rng):
    nodes, order = {node.id: node for node in divided.nodes}, {key: i for i, key in enumerate(poses)}

    def seen_m(value):
        return None if value is None else max(0.0, value + rng.gauss(0, errors["width_m"]))

    def bearing(at, value):
        return (value + poses[at][2] + rng.gauss(0, errors["bearing_deg"])) % 360

    made = []
    for key, (x, y, _) in poses.items():
        place = (x + rng.gauss(0, errors["place_m"]), y + rng.gauss(0, errors["place_m"]))
        made.append(dataclasses.replace(nodes[key], id=order[key], x_m=place[0], y_m=place[1]))
    links = []
    for link in divided.links:
        ways = [(link.start, link.end, link.start_bearing_deg, link.end_bearing_deg)]
        if link.id not in searched and link.end != NOWHERE:
            ways.append((link.end, link.start, link.end_bearing_deg, link.start_bearing_deg))
        for a, b, out, back in ways:
            if a not in poses:
                continue
            followed = link.id in searched
            width = seen_m(link.min_width_m) if followed else None
            ends = (order[a], order[b] if followed else NOWHERE, STATUS[followed], bearing(a, out))
            rest = (bearing(b, back), searched[link.id]) if followed else (None, None)
            links.append(Link(len(links), *ends, *rest, min_width_m=width, opening_m=seen_m(link.opening_m)))
    own = {node.id for node in truth.nodes}
    true = {i: key for key, i in order.items() if key in own}
    return Part(
        BtmMap(tuple(made), tuple(links)), true, {i: (nodes[key].x_m, nodes[key].y_m) for key, i in order.items()}
    )


def common(one, other):
    """True nodes that both have."""
    return set(one.true.values()) & set(other.true.values())
