"""Maps for other programs: against the rules of their readers, restated here, and by hand."""

import dataclasses
import json
import math

import networkx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref.refusals import refused
from ref.traces import ATTRIBUTES

from jexplore.config import InputError
from jexplore.report import store
from jexplore.tracemap.export import geojson, graphml
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node

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
    assert {f["properties"].get("frame") for f in geojson(raw, frame="site")["features"]} == {"site", None}
    told = {"frame": [{"from": ["a"], "value": "map"}, {"from": ["b"], "value": "odom"}]}
    disputed = HALL.with_attributes({"conflicts": told})
    assert {f["properties"].get("frame") for f in geojson(disputed)["features"]} == {"odom", None}


@settings(max_examples=25)
@given(maps())
def test_geojson_is_loaded(btm):
    nodes, edges = loaded(json.dumps(store.jsonable(geojson(btm, frame="odom"))))
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
    for write in (geojson, graphml):
        refused(r"link 4 starts at node 8, which is not there$", write, broken)


# The planner of the Route Server, restated: single precision, Dijkstra, an edge costs what the scorers add up to.


# GraphML


def test_graphml_by_hand():
    graph = networkx.parse_graphml(graphml(HALL))
    assert not graph.is_directed()
    extra = {"attribute_victim": '{"heat": 37, "seen": null}'}
    assert dict(graph.nodes(data=True)) == {
        "3": {"x_m": 0.0, "y_m": 0.0, "type": "terminal"} | {"angles_deg": "360.0"},
        "1": {"x_m": 3.0, "y_m": 4.0, "type": "divergence", "posture_deg": 2.0, **extra}
        | {"angles_deg": "233.0 37.0 60.0 30.0", "unsearched_bearings_deg": "0.0 -30.0"},
        "8": {"x_m": 3.0, "y_m": 0.0, "type": "obstacle", "obstacle": "stairs", "step_m": 0.125}
        | {"angles_deg": "360.0"},
    }
    first = {"start": "3", "start_bearing_deg": 53.0, "end_bearing_deg": 233.0, "length_m": 7.5, "min_width_m": 0.75}
    second = {"start": "8", "start_bearing_deg": 90.0, "end_bearing_deg": 270.0, "attribute_run": "2"}
    assert sorted(graph.edges(data=True)) == [("1", "8", {"id": "4", **second}), ("3", "1", {"id": "0", **first})]


@settings(max_examples=25)
@given(maps())
def test_graphml_is_read(btm):
    graph = networkx.parse_graphml(graphml(btm), force_multigraph=True)
    assert list(graph.nodes) == [str(node.id) for node in btm.nodes]
    searched = [link for link in btm.links if link.end != NOWHERE]
    ends = {str(key): {a, b} for a, b, key in graph.edges(keys=True)}
    assert ends == {str(link.id): {str(link.start), str(link.end)} for link in searched}
    for node in btm.nodes:
        found = graph.nodes[str(node.id)]
        assert (found["x_m"], found["y_m"], found["type"]) == (node.x_m, node.y_m, node.type)
        assert found.get("inclination_deg") == node.inclination_deg
        bearings = found.get("unsearched_bearings_deg", "")
        want = [link.start_bearing_deg for link in btm.links if link.end == NOWHERE and link.start == node.id]
        assert [float(text) for text in bearings.split()] == want


def test_graphml_keeps_what_xml_can_hold():
    attributes = {"<&\x00>": 'a\x01<b>&\ud800"ü😀', "n": {"\x02": 1}}
    btm = BtmMap((Node(0, 0, 0, "terminal", attributes=attributes),), ())
    found = networkx.parse_graphml(graphml(btm)).nodes["0"]
    assert found["attribute_<&�>"] == 'a�<b>&�"ü😀'
    assert json.loads(found["attribute_n"]) == {"\x02": 1}
    graphml(btm).encode("utf-8")
    assert len(networkx.parse_graphml(graphml(BtmMap((), ())))) == 0
