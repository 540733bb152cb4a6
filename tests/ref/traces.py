"""Behavioral Trace Maps for tests: made by hand in few words, or at random."""

import dataclasses
import math

from hypothesis import strategies as st

from jexplore.tracemap.record import NOWHERE, OBSTACLE_SHAPES, STATUS, BtmMap, Link, Node, check_map
from jexplore.tracemap.similarity import pieces_of

GOOD = {"length_m": 5.0, "min_width_m": 1.0, "posture_deg": 1.0, "max_roll_deg": 1.0, "max_step_m": 0.0}
TYPES = {"T": "terminal", "D": "divergence", "F": "free_space", "O": "obstacle"}


def node(number, kind="D", x=0.0, y=0.0, **more):
    return Node(number, x, y, TYPES[kind], **more)


def way(number, start, end, bearing, back=None, **more):
    back = (bearing + 180) % 360 if back is None else back
    return Link(number, start, end, "searched", float(bearing), float(back), **more)


def stub(number, start, bearing, **more):
    return Link(number, start, NOWHERE, "un-searched", float(bearing), **more)


def chain(kinds, stubs=()):
    """Nodes along +x, 2 m apart; stubs are `(node, bearing)`."""
    nodes = [node(i, kind, 2.0 * i, obstacle="slope" if kind == "O" else None) for i, kind in enumerate(kinds)]
    links = [way(i, i, i + 1, 0, length_m=2.0) for i in range(len(kinds) - 1)]
    links += [stub(len(links) + i, at, bearing) for i, (at, bearing) in enumerate(stubs)]
    return BtmMap(tuple(nodes), tuple(links))


CRAWLER = chain("TOOODFFDT", [(4, 90), (7, -90)])
WHEELED = chain("TDFFDT", [(1, 90), (4, -90)])
T_LEFT, T_RIGHT = chain("TDT", [(1, 90)]), chain("TDT", [(1, -90)])
SQUARE = BtmMap(
    tuple(node(i, "TDDD"[i]) for i in range(4)),
    (way(0, 0, 1, 0), way(1, 1, 2, 90), way(2, 2, 3, 180), way(3, 3, 0, 270)),
)
# Two robots in one building. The first comes from the west, the second starts south of the corner:
#
#            F4
#            |                         The first knows T0, D1, D2, D3 and a way north of D1,
#   T0 --4-- D1 ---9--- D2             the second T5, D2, D1, F4, D3 and a way west of D1.
#                       |
#                      (T5) 2.5 m below D2
#                       |
#                       D3- 6 m below D2
FIRST = BtmMap(
    (
        node(0, "T", 0, 0),
        node(1, "D", 4, 0),
        node(2, "D", 13, 0, posture_deg=3.0),
        node(3, "D", 13, -6, attributes={"victim": True}),
    ),
    (
        way(0, 0, 1, 0, length_m=4.0, min_width_m=1.5),
        way(1, 1, 2, 0, length_m=9.0, min_width_m=2.2, opening_m=2.3),
        stub(2, 1, 90, opening_m=1.2),
        way(3, 2, 3, 270, length_m=6.0, min_width_m=1.4, max_step_m=0.02),
        stub(4, 3, 0),
    ),
    {"frame": "odom"},
)
SECOND = BtmMap(
    (
        node(0, "T", 13, -2.5),
        node(7, "D", 13, 0, posture_deg=5.0, attributes={"radio_dbm": -61}),
        node(8, "D", 4, 0),
        node(9, "F", 4, 5),
        node(10, "D", 13, -6, attributes={"victim": False}),
    ),
    (
        way(0, 0, 7, 90, length_m=2.5, min_width_m=1.6),
        way(1, 7, 8, 180, length_m=9.0, min_width_m=2.1),
        way(2, 8, 9, 90, length_m=5.0, opening_m=1.2),
        stub(3, 8, 180),
        way(4, 0, 10, 270, length_m=3.5, min_width_m=1.3, posture_deg=2.0),
        stub(5, 10, 0),
        stub(6, 9, 90),
    ),
    {"frame": "odom"},
)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | FINITE | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)
ATTRIBUTES = st.dictionaries(st.text(max_size=5), PLAIN, max_size=2)


@st.composite
def maps(draw, *, cycles=True, measures=False):
    """Up to five nodes in a tree, stubs, links that close cycles; bearings at a node differ."""
    count = draw(st.integers(1, 5))
    ends = [(draw(st.integers(0, i - 1)), i) for i in range(1, count)]
    any_node = st.integers(0, count - 1)
    ends += draw(st.lists(st.tuples(any_node, any_node), max_size=2)) if cycles else []
    ends += [(at, NOWHERE) for at in draw(st.lists(any_node, max_size=3))]
    degree = [sum(pair.count(i) for pair in ends) for i in range(count)]
    free = [draw(st.lists(st.integers(0, 359), min_size=n, max_size=n, unique=True)) for n in degree]
    names = ATTRIBUTES if measures else st.just({})
    number = st.none() | FINITE if measures else st.none()
    length = st.none() | st.floats(0, allow_infinity=False) if measures else st.none()
    nodes = []
    for i in range(count):
        kind = draw(st.sampled_from(sorted(TYPES)))
        shape = draw(st.sampled_from(OBSTACLE_SHAPES)) if kind == "O" else None
        x, y = (draw(FINITE), draw(FINITE)) if measures else (float(i), 0.0)
        more = {"inclination_deg": draw(number), "step_m": draw(length), "posture_deg": draw(number)}
        nodes.append(node(i, kind, x, y, obstacle=shape, attributes=draw(names), **more))
    links = []
    for i, (start, end) in enumerate(ends):
        bearing = float(free[start].pop())
        back = None if end == NOWHERE else float(free[end].pop())
        status = STATUS[end != NOWHERE]
        lengths = {name: draw(length) for name in ("length_m", "min_width_m", "opening_m")}
        more = {"posture_deg": draw(number), "attributes": draw(names), **lengths}
        links.append(Link(i, start, end, status, bearing, back, **more))
    return BtmMap(tuple(nodes), tuple(links), draw(names))


def changed(btm, **by_kind):
    """With fields of the records replaced: `nodes` and `links` are functions of a record that return a dict."""
    parts = {
        name: tuple(dataclasses.replace(item, **by_kind[name](item)) for item in getattr(btm, name)) for name in by_kind
    }
    return dataclasses.replace(btm, **parts)


def are_same(a, b, limit=1e-6):
    """Return whether maps have equal codes and measures that differ by `limit` at most, whatever ids and directions."""
    walks = [list(pieces_of(check_map(btm))) for btm in (a, b)]
    return [text for text, *_ in walks[0]] == [text for text, *_ in walks[1]] and all(
        _are_near(node, match, False, limit) and _are_near(link, other, side != end, limit)
        for (_, node, link, side), (_, match, other, end) in zip(*walks)
    )


def _are_near(item, match, is_turned, limit):
    swap = {"start_bearing_deg": "end_bearing_deg", "end_bearing_deg": "start_bearing_deg"} if is_turned else {}
    for name, x in vars(item).items() if item else ():
        y = getattr(match, swap.get(name, name))
        if not name.endswith(("_m", "_deg")) or (is_turned and name == "opening_m"):
            continue
        away = math.inf if None in (x, y) else abs(x - y)
        away = abs((x - y + 180) % 360 - 180) if name.endswith("bearing_deg") and None not in (x, y) else away
        if x is not y and away > limit:
            return False
    return True
