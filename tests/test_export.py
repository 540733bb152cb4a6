"""Maps for other programs: against the rules of their readers, restated here, and by hand."""

import dataclasses
import heapq
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref.refusals import refused
from ref.traces import ATTRIBUTES

import jexplore as jx
from jexplore.config import InputError
from jexplore.report import store
from jexplore.tracemap.export import geojson
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node

TRACED = Path(__file__).parent / "ref" / "course_run.json"  # by `jexplore trace --world course --robot kamui`
FINITE = st.floats(-1e6, 1e6)
HALL = BtmMap(
    (
        Node(3, 0.0, 0.0, "terminal"),
        Node(1, 3.0, 4.0, "divergence", posture_deg=2.0, attributes={"victim": {"heat": 37, "seen": None}}),
        Node(8, 3.0, 0.0, "obstacle", "stairs", step_m=0.125),
    ),
    (
        Link(0, 3, 1, "searched", 53.0, 233.0, length_m=7.5, min_width_m=0.75),
        Link(4, 8, 1, "searched", 90.0, 270.0, attributes={"run": 2}),
        Link(2, 1, NOWHERE, "un-searched", 0.0, opening_m=0.5),
        Link(5, 1, NOWHERE, "un-searched", -30.0),
    ),
)


@st.composite
def maps(draw):
    """One to four nodes of any ids, any links among them, one searched link or more."""
    ids = draw(st.lists(st.integers(0, 60_000), min_size=1, max_size=4, unique=True))
    some = st.none() | FINITE
    nodes = [Node(i, draw(FINITE), draw(FINITE), "obstacle", "slope", draw(some), posture_deg=draw(some)) for i in ids]
    nodes = [dataclasses.replace(node, attributes=draw(ATTRIBUTES)) for node in nodes]
    one = st.sampled_from(ids)
    length = st.none() | st.floats(0, 1e6)
    pairs = draw(st.lists(st.tuples(one, one), min_size=1, max_size=4))
    links = [
        Link(n, a, b, "searched", draw(FINITE), draw(FINITE), draw(length), draw(length), attributes=draw(ATTRIBUTES))
        for n, (a, b) in enumerate(pairs)
    ]
    stubs = draw(st.lists(one, max_size=2))
    links += [Link(100 + n, a, NOWHERE, "un-searched", draw(FINITE)) for n, a in enumerate(stubs)]
    return BtmMap(tuple(nodes), tuple(links))


class Whole(int):
    """A number that is written without point and exponent."""


def refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


def check_plain(value):
    """Check a value as a reader of metadata takes it, alone or as an element of a list."""
    assert isinstance(value, (str, bool, float)), f"cannot be converted: {value!r}"
    assert not isinstance(value, float) or abs(value) < 3.4e38


def check_metadata(metadata):
    assert isinstance(metadata, dict)
    for value in metadata.values():
        if isinstance(value, dict):
            check_metadata(value)
        elif isinstance(value, list):
            for item in value:
                check_plain(item)
        else:
            check_plain(value)


def loaded(text):
    """Nodes and edges, properties by id, as the Route Server's loader reads them. Whatever it stumbles over fails."""
    obj = json.loads(text, parse_int=Whole, parse_constant=refuse)
    assert obj["type"] == "FeatureCollection"
    nodes, edges, taken = {}, {}, set()
    for feature in obj["features"]:
        properties, geometry = feature["properties"], feature["geometry"]
        own = properties["id"]
        assert feature["type"] == "Feature"
        assert isinstance(own, Whole)
        assert 0 <= own < 65536
        assert own not in taken, "ids of nodes and edges must differ"
        taken.add(own)
        check_metadata(properties.get("metadata", {}))
        assert "speed_limit" not in properties["metadata"]
        if geometry["type"] == "Point":
            assert not edges, "nodes come first"
            assert isinstance(properties["frame"], str)
            x, y = geometry["coordinates"]
            assert isinstance(x, float)
            assert isinstance(y, float)
            nodes[own] = {"x": x, "y": y, **properties}
        else:
            assert geometry["type"] in ("LineString", "MultiLineString")
            assert properties["startid"] in nodes
            assert properties["endid"] in nodes
            assert isinstance(properties["cost"], float)
            assert properties["cost"] > 0
            assert properties["overridable"] is True
            edges[own] = {**properties, "line": geometry["coordinates"]}
    assert nodes
    assert edges
    return nodes, edges


def written(obj, folder):
    store.write_json(obj, folder / "route.geojson")
    return (folder / "route.geojson").read_text(encoding="utf-8")


def test_geojson_by_hand(tmp_path):
    nodes, edges = loaded(written(geojson(HALL), tmp_path))
    assert nodes == {
        3: {
            **{"x": 0.0, "y": 0.0, "id": 3, "frame": "map"},
            "metadata": {
                **{"class": "terminal", "type": "terminal"},
                **{"angles_deg": [360.0], "unsearched_bearings_deg": []},
            },
        },
        1: {
            **{"x": 3.0, "y": 4.0, "id": 1, "frame": "map"},
            "metadata": {
                **{"class": "divergence", "type": "divergence", "posture_deg": 2.0},
                **{"angles_deg": [233.0, 37.0, 60.0, 30.0], "unsearched_bearings_deg": [0.0, -30.0]},
                "attributes": {"victim": {"heat": 37.0, "seen": "null"}},
            },
        },
        8: {
            **{"x": 3.0, "y": 0.0, "id": 8, "frame": "map"},
            "metadata": {
                **{"class": "stairs", "type": "obstacle", "obstacle": "stairs", "step_m": 0.125},
                **{"angles_deg": [360.0], "unsearched_bearings_deg": []},
            },
        },
    }
    # the first link is 7.5 m for a straight line of 5 m, the second is as long as its line of 4 m
    long = {"cost": 7.5, "overridable": True}
    long |= {"metadata": {"penalty": 2.5, "length_m": 7.5, "min_width_m": 0.75, "link": 0.0}}
    short = {"cost": 4.0, "overridable": True}
    short |= {"metadata": {"penalty": 0.0, "link": 4.0, "attributes": {"run": 2.0}}}
    assert edges == {
        9: {"id": 9, "startid": 3, "endid": 1, "line": [[0.0, 0.0], [3.0, 4.0]], **long},
        10: {"id": 10, "startid": 1, "endid": 3, "line": [[3.0, 4.0], [0.0, 0.0]], **long},
        11: {"id": 11, "startid": 8, "endid": 1, "line": [[3.0, 0.0], [3.0, 4.0]], **short},
        12: {"id": 12, "startid": 1, "endid": 8, "line": [[3.0, 4.0], [3.0, 0.0]], **short},
    }


def test_the_frame_is_that_of_the_map():
    assert {f["properties"].get("frame") for f in geojson(HALL)["features"]} == {"map", None}
    raw = HALL.with_attributes({"frame": "odom"})
    assert {f["properties"].get("frame") for f in geojson(raw)["features"]} == {"odom", None}
    told = {"frame": [{"from": ["a"], "value": "map"}, {"from": ["b"], "value": "odom"}]}
    disputed = HALL.with_attributes({"conflicts": told})
    assert {f["properties"].get("frame") for f in geojson(disputed)["features"]} == {"odom", None}


@settings(max_examples=25)
@given(maps())
def test_geojson_is_loaded(btm):
    nodes, edges = loaded(json.dumps(store.jsonable(geojson(btm.with_attributes({"frame": "odom"})))))
    assert list(nodes) == [node.id for node in btm.nodes]
    assert {node["frame"] for node in nodes.values()} == {"odom"}
    searched = [link for link in btm.links if link.end != NOWHERE]
    there = [(edge["startid"], edge["endid"]) for edge in edges.values()]
    assert there == [pair for link in searched for pair in ((link.start, link.end), (link.end, link.start))]
    for link, edge in zip((link for link in searched for _ in range(2)), edges.values()):
        a, b = nodes[link.start], nodes[link.end]
        chord = math.hypot(a["x"] - b["x"], a["y"] - b["y"])
        want = max(chord, chord if link.length_m is None else link.length_m, 0.001)
        assert chord + edge["metadata"]["penalty"] == pytest.approx(want)  # distance and penalty scorers together
    stubs = sum(len(node["metadata"]["unsearched_bearings_deg"]) for node in nodes.values())
    assert stubs == len(btm.links) - len(searched)


@pytest.mark.parametrize(
    ("value", "want"),
    [
        (True, True),
        (3, 3.0),
        (10**400, "1" + "0" * 400),
        (1e300, "1e+300"),
        (None, "null"),
        ([1, None, "ü"], [1.0, "null", "ü"]),
        ([[1, "ü"], 2], ['[1, "ü"]', 2.0]),
        ([{"a": 1}], '[{"a": 1}]'),
        ({"a": {"b": [0]}, "c": {}}, {"a": {"b": [0.0]}, "c": {}}),
    ],
)
def test_attributes_in_metadata(value, want):
    btm = dataclasses.replace(
        HALL, nodes=(dataclasses.replace(HALL.nodes[0], attributes={"x": value}), *HALL.nodes[1:])
    )
    found = geojson(btm)["features"][0]["properties"]["metadata"]["attributes"]["x"]
    assert (found, type(found)) == (want, type(want))
    loaded(json.dumps(geojson(btm)))


def test_an_attribute_cannot_hide_a_measure():
    attributes = {"type": "mine", "penalty": -1}
    btm = BtmMap((Node(0, 0, 0, "terminal", attributes=attributes),), (Link(0, 0, 0, "searched", 0, 90, 2, None),))
    node, edge = (feature["properties"]["metadata"] for feature in geojson(btm)["features"][:2])
    assert (node["type"], node["attributes"], edge["penalty"]) == ("terminal", {"type": "mine", "penalty": -1.0}, 2.0)


def test_what_the_route_server_would_refuse_is_refused():
    stub = Link(0, 0, NOWHERE, "un-searched", 0.0)
    for btm in (BtmMap((), ()), BtmMap((Node(0, 0, 0, "terminal"),), (stub,))):
        refused(r"^a route graph must have an edge: the map has no searched link$", geojson, btm)
    loop = (Link(0, 65533, 65533, "searched", 0, 90),)
    loaded(json.dumps(geojson(BtmMap((Node(65533, 0, 0, "terminal"),), loop))))
    loop = (Link(0, 65534, 65534, "searched", 0, 90),)
    with pytest.raises(InputError, match=r"must lie below 65536, those of this map would reach 65536$"):
        geojson(BtmMap((Node(65534, 0, 0, "terminal"),), loop))
    broken = dataclasses.replace(HALL, nodes=HALL.nodes[:2])
    refused(r"link 4 starts at node 8, which is not there$", geojson, broken)


# The planner of the Route Server, restated: single precision, Dijkstra, an edge costs what the scorers add up to.


def scored(nodes, edge):
    """Return the scores of an edge by the distance and the penalty scorer, both of weight 1."""
    a, b = (nodes[edge[end]] for end in ("startid", "endid"))
    chord = np.hypot(np.float32(b["x"]) - np.float32(a["x"]), np.float32(b["y"]) - np.float32(a["y"]))
    return chord + np.float32(edge["metadata"].get("penalty", 0.0))


def own_cost(nodes, edge):
    """Return the cost of an edge without scorers; the planner gives up over one without cost."""
    assert edge["cost"] > 0
    return np.float32(edge["cost"])


def planned(nodes, edges, start, goal, cost_of):
    """Return the cost of the cheapest way and its edges; None without one, as the planner reports."""
    cost, parent, queue = {start: np.float32(0)}, {}, [(np.float32(0), start)]
    while queue:
        here_cost, here = heapq.heappop(queue)
        if here == goal:
            break
        for edge in edges.values():
            if here_cost == cost[here] and edge["startid"] == here:
                found = here_cost + cost_of(nodes, edge)
                if found < cost.get(edge["endid"], np.float32(np.finfo(np.float32).max)):
                    cost[edge["endid"]], parent[edge["endid"]] = found, edge
                    heapq.heappush(queue, (found, edge["endid"]))
    if goal not in parent:
        return None
    way, at = [], goal
    while at != start:
        way.append(parent[at])
        at = parent[at]["startid"]
    return float(cost[goal]), way[::-1]


def agrees(btm, cost_of):
    """Every route between two nodes costs on the Route Server what its links are long."""
    nodes, edges = loaded(json.dumps(store.jsonable(geojson(btm))))
    pairs = list(itertools.permutations(nodes, 2))
    (routes,) = jx.btm.routes(btm, ["kamui"], pairs)
    for (start, goal), route in zip(pairs, routes):
        found = planned(nodes, edges, start, goal, cost_of)
        assert route.is_found == (found is not None)
        if found is not None:
            assert found[0] == pytest.approx(route.length_m, rel=1e-5, abs=2e-3 * len(edges))
            places = [start, *(edge["endid"] for edge in found[1])]
            links = {link.id: {link.start, link.end} for link in btm.links}
            for edge, ends in zip(found[1], itertools.pairwise(places)):
                assert links[int(edge["metadata"]["link"])] == set(ends)


@st.composite
def walked(draw):
    """Maps whose links no robot is refused, and are as long as the straight line or longer."""
    ids = draw(st.lists(st.integers(0, 60_000), min_size=2, max_size=6, unique=True))
    side = st.integers(-400, 400).map(lambda tenth: tenth / 10)
    nodes = {i: Node(i, draw(side), draw(side), "divergence") for i in ids}
    links, one = [], st.sampled_from(ids)
    for number in range(draw(st.integers(1, 9))):
        start, end, more_m = draw(one), draw(one), draw(st.none() | st.integers(0, 90))
        a, b = nodes[start], nodes[end]
        length_m = None if more_m is None else math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) + more_m
        links.append(Link(number, start, end, "searched", 0.0, 90.0, length_m))
    return BtmMap(tuple(nodes.values()), tuple(links))


@settings(max_examples=20)
@given(walked(), st.sampled_from([scored, own_cost]))
def test_the_route_server_finds_routes_of_the_same_length(btm, cost_of):
    agrees(btm, cost_of)


def test_the_map_of_a_run_is_planned_over_alike():
    btm = jx.btm.read_btm(TRACED)
    nodes, edges = loaded(json.dumps(geojson(btm)))
    assert {node["frame"] for node in nodes.values()} == {"odom"}  # places of the odometry
    assert len(edges) == 2 * sum(link.end != NOWHERE for link in btm.links)
    route = jx.btm.route(btm, "kamui", 0, 8)
    for cost_of in (scored, own_cost):
        cost, way = planned(nodes, edges, 0, 8, cost_of)
        assert [int(edge["metadata"]["link"]) for edge in way] == list(route.links)
        if cost_of is own_cost:
            assert cost == pytest.approx(route.length_m, rel=1e-5)
