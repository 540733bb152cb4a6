"""Routes over a map for another robot: by pencil, compared with networkx, laws, and refusals."""

import dataclasses
import functools
import itertools
import json
import math

import networkx
import numpy as np
import pytest
import ref.traces
from hypothesis import given, settings
from hypothesis import strategies as st
from ref.refusals import refused
from ref.traces import GOOD, chain, stub

import jexplore as jx
from jexplore.cli.main import main
from jexplore.driving.settings import ROBOTS
from jexplore.report import store, trace_tables
from jexplore.tracemap import shortest
from jexplore.tracemap.json_form import to_json
from jexplore.tracemap.record import NOWHERE, BtmMap, Node

LIFTED = "no measures of who could not pass; blocked set to false lifts it"
way = functools.partial(ref.traces.way, **GOOD)
KAMUI, WHEELED = ROBOTS["kamui"], ROBOTS["wheeled"]


# A square, 0 below left, 1 right, 2 above, 3 above left, with a short cut from 0 to 2 over a step: link 4.
#
#   3 --2-- 2 -- (5)
#   |     / |
#   3   4   1
#   | /     |
#   0 --0-- 1
SQUARE = BtmMap(
    tuple(Node(i, x, y, "divergence") for i, (x, y) in enumerate([(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)])),
    (
        way(0, 0, 1, 0.0, 180.0),
        way(1, 1, 2, 90.0, 270.0),
        way(2, 2, 3, 180.0, 0.0),
        way(3, 3, 0, 270.0, 90.0, length_m=6.0),
        way(4, 0, 2, 45.0, 225.0, length_m=7.0, max_step_m=0.15),
        stub(5, 2, 0.0, opening_m=0.8),
    ),
)


def changed(btm, number, **values):
    """The map with other values of a link."""
    links = (dataclasses.replace(link, **values) if link.id == number else link for link in btm.links)
    return dataclasses.replace(btm, links=tuple(links))


def line(*kinds, **measures):
    """Nodes in a row, 5 m apart: `None` or an obstacle's name, height or inclination."""
    nodes = []
    for i, kind in enumerate(kinds):
        shape, value = kind or (None, None)
        own = {"stairs": {"step_m": value}, "slope": {"inclination_deg": value}}.get(shape, {})
        nodes.append(Node(i, 5.0 * i, 0.0, "obstacle" if shape else "terminal", shape, **own))
    return BtmMap(tuple(nodes), tuple(way(i, i, i + 1, 0.0, 180.0, **measures) for i in range(len(nodes) - 1)))


# By pencil


def test_the_crawler_takes_the_step_and_the_wheeled_robot_goes_round():
    crawls = jx.btm.route(SQUARE, "kamui", 0, 2)
    assert (crawls.nodes, crawls.links, crawls.length_m) == ((0, 2), (4,), 7.0)
    assert (crawls.refused, crawls.barriers, crawls.unknown, crawls.trouble) == ((), (), (), "")
    rolls = jx.btm.route(SQUARE, "wheeled", 0, 2)
    assert (rolls.nodes, rolls.links, rolls.length_m) == ((0, 1, 2), (0, 1), 10.0)
    assert rolls.refused == ((4, ("step 0.15 m > 0.03 m",)),)
    assert trace_tables.refused_lines(SQUARE, rolls) == ["link 4 (nodes 0 to 2): step 0.15 m > 0.03 m"]
    assert repr(rolls) == "<Route of wheeled: 0 - 1 - 2, 2 links, 10.00 m>"
    assert repr(crawls) == "<Route of kamui: 0 - 2, 1 link, 7.00 m>"


def test_ways_are_counted_counter_clockwise_from_the_way_in():
    # at 1 the only other way is to the left: 270 degrees counter-clockwise from behind
    first, second = jx.btm.route(SQUARE, "wheeled", 0, 2).steps
    assert (first.bearing_deg, first.turn_deg, first.way, first.ways) == (0.0, None, None, 3)
    assert (second.bearing_deg, second.turn_deg, second.way, second.ways) == (90.0, 270.0, 1, 1)
    # from 3 the link comes into 2 at 180; behind it lie, counter-clockwise, 4 at 225, 1 at 270, 5 at 360
    into = jx.btm.route(SQUARE, "wheeled", 3, 1).steps[1]
    assert (into.link, into.turn_deg, into.way, into.ways) == (1, 90.0, 2, 3)
    onward = jx.btm.route(SQUARE, "wheeled", 3, "unsearched").onward
    assert (onward.link, onward.bearing_deg, onward.turn_deg, onward.way, onward.ways) == (5, 0.0, 180.0, 3, 3)


@pytest.mark.parametrize(
    ("measures", "reasons"),
    [
        ({"min_width_m": 0.38}, ["width 0.38 m < 0.39 m"]),
        ({"posture_deg": 5.00002}, ["inclination 5.00002 deg > 5 deg"]),
        ({"attributes": {"blocked": True}}, [f"blocked: {LIFTED}"]),
        ({"attributes": {"blocked": True, "found_by": "scout"}}, [f"blocked, found by scout: {LIFTED}"]),
        (
            {"min_width_m": 0.2, "opening_m": 0.3, "max_step_m": 1.0, "posture_deg": 9.0, "max_roll_deg": 8.0},
            [
                *("width 0.2 m < 0.39 m", "opening 0.3 m < 0.39 m", "step 1 m > 0.03 m"),
                *("inclination 9 deg > 5 deg", "roll 8 deg > 5 deg"),
            ],
        ),
        ({"min_width_m": 0.39, "max_step_m": float(np.float32(0.03)), "posture_deg": 5.0, "max_roll_deg": 5.0}, []),
        ({"attributes": {"blocked": False}}, []),
    ],
)
def test_every_reason_of_a_link(measures, reasons):
    route = jx.btm.route(changed(line(None, None), 0, **measures), "wheeled", 0, 1)
    assert route.refused == (((0, tuple(reasons)),) if reasons else ())
    assert route.is_found == (not reasons)


def test_what_one_robot_could_not_pass_is_left_to_those_that_are_narrower_or_climb_more():
    who = {"name": "scout", "width_m": 0.5, "max_step_m": 0.1, "max_slope_deg": 10.0}
    btm = changed(line(None, None), 0, attributes={"blocked": True, "blocked_for": who})
    scout = dataclasses.replace(WHEELED, name="scout", width_m=0.5, max_step_m=0.1, max_slope_deg=10.0)
    for worse in ({}, {"width_m": 0.8}, {"max_step_m": 0.03}, {"max_slope_deg": 5.0}):
        robot = dataclasses.replace(scout, **worse)
        assert jx.btm.route(btm, robot, 0, 1).refused == ((0, ("blocked for scout",)),), worse
    for better in ({"width_m": 0.49}, {"max_step_m": 0.11}, {"max_slope_deg": 11.0, "width_m": 0.8}):
        robot = dataclasses.replace(scout, **better)
        route = jx.btm.route(btm, robot, 0, 1)
        assert (route.links, route.refused) == ((0,), ()), better
        assert route.unknown == ("link 0 (nodes 0 to 1): blocked for scout",)
        assert jx.btm.route(btm, robot, 0, 1, known_only=True).refused == ((0, ("blocked for scout",)),)
    lifted = jx.btm.route(btm.with_attributes({"blocked": False}, link=0), scout, 0, 1)
    assert (lifted.links, lifted.unknown) == ((0,), ())
    ahead = changed(SQUARE, 5, attributes={"blocked": True, "blocked_for": who})  # un-searched
    assert jx.btm.route(ahead, scout, 0, "unsearched").refused[-1] == (5, ("blocked for scout",))
    assert jx.btm.route(ahead, "kamui", 0, "unsearched").unknown == ("link 5 (node 2, un-searched): blocked for scout",)


def blocked_by(**told):
    """A line whose link maps say different things about: `name=[(map, value), ...]`."""
    told = {name: [{"from": [own], "value": value} for own, value in many] for name, many in told.items()}
    return changed(line(None, None), 0, attributes={"conflicts": told})


def test_what_maps_differ_about_is_a_doubt():
    btm = blocked_by(blocked=[("a", True), ("b", False)])
    route = jx.btm.route(btm, "kamui", 0, 1)
    assert (route.links, route.refused) == ((0,), ())
    assert route.unknown == ("link 0 (nodes 0 to 1): blocked in a, not in b",)
    assert jx.btm.route(btm, "kamui", 0, 1, known_only=True).refused == ((0, ("blocked in a, not in b",)),)
    lifted = btm.with_attributes({"blocked": False}, link=0)
    assert jx.btm.route(lifted, "kamui", 0, 1, known_only=True).unknown == ()
    shut = btm.with_attributes({"blocked": True}, link=0)
    assert jx.btm.route(shut, "kamui", 0, 1).refused == ((0, (f"blocked: {LIFTED}",)),)
    assert not jx.btm.route(blocked_by(blocked=[("a", True), ("b", 1)]), "kamui", 0, 1).is_found
    assert jx.btm.route(blocked_by(blocked=[("a", False), ("b", 0)]), "kamui", 0, 1).unknown == ()


def test_several_robots_that_could_not_pass_are_several_blocks():
    wide = {"name": "wide", "width_m": 0.6, "max_step_m": 0.3, "max_slope_deg": 45.0}
    flat = {"name": "flat", "width_m": 0.3, "max_step_m": 0.1, "max_slope_deg": 10.0}
    btm = blocked_by(blocked_for=[("a", wide), ("b", flat)]).with_attributes({"blocked": True}, link=0)
    robot = dataclasses.replace(WHEELED, width_m=0.5, max_step_m=0.05, max_slope_deg=5.0)
    assert jx.btm.route(btm, robot, 0, 1).refused == ((0, ("blocked for flat",)),)
    low = dataclasses.replace(robot, width_m=0.7)
    assert jx.btm.route(btm, low, 0, 1).refused == ((0, ("blocked for wide", "blocked for flat")),)
    route = jx.btm.route(btm, dataclasses.replace(robot, max_step_m=0.2), 0, 1)
    assert route.unknown == ("link 0 (nodes 0 to 1): blocked for wide, blocked for flat",)
    nobody = blocked_by(blocked_for=[("a", wide), ("b", None)]).with_attributes({"blocked": True}, link=0)
    assert jx.btm.route(nobody, robot, 0, 1).refused == ((0, (f"blocked: {LIFTED}",)),)


@pytest.mark.parametrize(
    "who",
    [
        "scout",
        {"name": "scout", "width_m": 9.0, "max_step_m": 0.0},
        {"name": "scout", "width_m": "9", "max_step_m": 0.0, "max_slope_deg": 0.0},
        {"name": "scout", "width_m": True, "max_step_m": 0.0, "max_slope_deg": 0.0},
    ],
)
def test_a_block_by_nobody_that_one_can_be_held_against_is_for_all(who):
    btm = changed(line(None, None), 0, attributes={"blocked": True, "blocked_for": who})
    assert jx.btm.route(btm, "kamui", 0, 1).refused == ((0, (f"blocked: {LIFTED}",)),)


@pytest.mark.parametrize(("shape", "word", "unit"), [("stairs", "step 0.15 m > 0.03 m", 0.15),
                                                    ("slope", "inclination 10 deg > 5 deg", 10.0)])  # fmt: skip
def test_an_obstacle_may_be_come_to_but_not_passed(shape, word, unit):
    btm = line(None, (shape, unit), None)
    assert jx.btm.route(btm, "kamui", 0, 2).links == (0, 1)
    for start, end in ((0, 1), (2, 1), (1, 0), (1, 2)):  # it stands before the step, on the side where it goes
        assert jx.btm.route(btm, "wheeled", start, end).is_found
    route = jx.btm.route(btm, "wheeled", 0, 2)
    assert (route.nodes, route.links, route.steps, route.length_m) == ((), (), (), math.inf)
    assert (route.refused, route.barriers) == ((), ((1, (word,)),))
    assert route.trouble == "wheeled cannot get from node 0 to node 2"
    assert repr(route) == "<Route of wheeled: none, wheeled cannot get from node 0 to node 2>"
    assert trace_tables.refused_lines(btm, route) == [f"node 1, to pass: {word}"]
    round_ = Node(3, 5.0, 5.0, "divergence"), way(3, 0, 3, 90.0, 180.0), way(4, 3, 2, 0.0, 90.0)  # as long
    ring = BtmMap((*btm.nodes, round_[0]), (*btm.links, *round_[1:]))
    assert jx.btm.route(ring, "wheeled", 0, 2).links == (3, 4)


def test_a_flight_whose_link_says_nothing_has_the_lower_step_of_its_ends():
    # two flights with a landing, 2 to 3: its nodes have the higher step on either side
    btm = line(None, ("stairs", 0.05), ("stairs", 0.15), ("stairs", 0.15), None, max_step_m=None)
    assert jx.btm.route(btm, "wheeled", 1, 2).refused[0] == (1, ("step 0.05 m > 0.03 m",))
    assert jx.btm.route(btm, "wheeled:max_step_m=0.1", 1, 2).links == (1,)
    assert jx.btm.route(btm, "wheeled:max_step_m=0.1", 2, 3).refused == ((2, ("step 0.15 m > 0.1 m",)),)
    level = changed(btm, 2, max_step_m=0.0)  # what was measured counts: a level landing
    assert jx.btm.route(level, "wheeled:max_step_m=0.1", 2, 3).links == (2,)
    slope = line(("slope", 10.0), ("slope", 8.0), posture_deg=None)
    assert jx.btm.route(slope, "wheeled", 0, 1).refused == ((0, ("inclination 8 deg > 5 deg",)),)
    mixed = line(("slope", 10.0), ("stairs", 0.1), posture_deg=None, max_step_m=None)
    assert jx.btm.route(mixed, "wheeled", 0, 1).unknown == ("link 0 (nodes 0 to 1): step unknown, inclination unknown",)


def test_what_is_not_known_is_told_or_refused():
    bare = dict.fromkeys(GOOD)
    btm = line(None, ("stairs", None), None, **bare)
    route = jx.btm.route(btm, "wheeled", 0, 2)
    words = "width unknown, step unknown, inclination unknown, roll unknown"
    long = f"{words}, length unknown, 5.00 m in a straight line"
    assert route.unknown == (f"link 0 (nodes 0 to 1): {long}", f"link 1 (nodes 1 to 2): {long}", "node 1: step unknown")
    assert route.length_m == 10.0
    assert repr(route) == "<Route of wheeled: 0 - 1 - 2, 2 links, 10.00 m, 3 unknown>"
    strict = jx.btm.route(btm, "wheeled", 0, 2, known_only=True)
    assert strict.refused == tuple((i, tuple(words.split(", "))) for i in (0, 1))
    assert strict.barriers == ((1, ("step unknown",)),)
    assert jx.btm.route(line(None, None, length_m=None), "wheeled", 0, 1, known_only=True).is_found  # no limit is on it
    last = dataclasses.replace(
        line(None, ("stairs", None)), links=(way(0, 0, 1, 0.0, 180.0), stub(1, 1, 0.0, opening_m=1))
    )
    assert jx.btm.route(last, "wheeled", 0, 1).unknown == ()  # it stops before the stairs
    assert jx.btm.route(last, "wheeled", 0, "unsearched").unknown == ("node 1: step unknown",)
    assert jx.btm.route(SQUARE, "wheeled", 0, 2, known_only=True) == jx.btm.route(SQUARE, "wheeled", 0, 2)


def test_an_unsearched_link_beyond_a_step_is_refused_with_the_step():
    btm = line(None, ("stairs", 0.15))
    btm = dataclasses.replace(btm, links=(*btm.links, stub(1, 1, 0.0, opening_m=2.0)))
    route = jx.btm.route(btm, "wheeled", 0, "unsearched")
    assert route.refused == ((1, ("step 0.15 m > 0.03 m",)),)
    assert (route.end, route.onward) == (None, None)
    assert route.trouble == "wheeled can get from node 0 to no un-searched link"
    assert jx.btm.route(btm, "kamui", 0, "unsearched").onward.link == 1
    assert jx.btm.route(btm, "wheeled", 0, 1).refused == ()  # an un-searched link is no way to a node


def test_parts_that_nothing_joins_are_said_to_be():
    apart = BtmMap((*line(None, None).nodes, Node(7, 0, 9, "terminal")), line(None, None).links)
    assert jx.btm.route(apart, "kamui", 0, 7).trouble == "nodes 0 and 7 lie in parts of the map that no link joins"
    assert jx.btm.route(apart, "kamui", 0, "unsearched").trouble == "the map has no un-searched link"
    more = dataclasses.replace(apart, links=(*apart.links, stub(3, 7, 0.0)))
    words = "node 0 and the un-searched links lie in parts of the map that no link joins"
    assert jx.btm.route(more, "kamui", 0, "unsearched").trouble == words


def test_of_equal_ways_the_fewest_links_then_the_lowest_ids_count():
    nodes = tuple(Node(i, float(i), 0.0, "divergence") for i in range(4))

    def chosen(*ends, lengths):
        links = tuple(way(i, a, b, 0.0, 180.0, length_m=m) for i, (a, b), m in zip((9, 5, 7, 3, 8), ends, lengths))
        return jx.btm.route(BtmMap(nodes, links), "kamui", 0, 3).links

    assert chosen((0, 1), (1, 3), (0, 3), lengths=(1, 1, 2)) == (7,)
    assert chosen((0, 1), (1, 3), (0, 3), lengths=(1, 1, 2.001)) == (9, 5)
    assert chosen((0, 3), (0, 3), (0, 3), lengths=(2, 2, 2)) == (5,)
    assert chosen((0, 1), (1, 3), (0, 2), (2, 3), lengths=(1, 1, 1, 1)) == (7, 3)  # 7 comes before 9
    assert chosen((0, 1), (1, 3), (0, 1), (1, 3), lengths=(1, 1, 1, 1)) == (7, 3)
    assert chosen((0, 1), (1, 0), (0, 3), lengths=(0, 0, 0)) == (7,)  # links without a length
    assert chosen((0, 1), (1, 2), (2, 3), (0, 0), lengths=(0.0003, 0.0003, 0.0003, 0)) == (9, 5, 7)  # below the unit


# Compared with networkx, and laws


@st.composite
def graphs(draw):
    """Maps of one to seven nodes with any ids, any links, some of them refused, some nodes not to be passed."""
    ids = draw(st.lists(st.integers(0, 99), min_size=1, max_size=7, unique=True))
    nodes = []
    for number in ids:
        step_m = draw(st.sampled_from([None, None, 0.01, 0.1]))
        kind = ("divergence",) if step_m is None else ("obstacle", "stairs")
        nodes.append(Node(number, float(number), 0.0, *kind, step_m=step_m))
    one, links = st.sampled_from(ids), []
    for number in draw(st.lists(st.integers(0, 99), max_size=12, unique=True)):
        length = draw(st.integers(0, 4))
        step_m = draw(st.sampled_from([0.0, 0.0, 0.0, 0.1]))
        if draw(st.integers(0, 5)) == 0:
            links.append(stub(number, draw(one), 0.0, opening_m=draw(st.sampled_from([1.0, 0.1]))))
        else:
            links.append(way(number, draw(one), draw(one), 0.0, 90.0, length_m=float(length), max_step_m=step_m))
    return BtmMap(tuple(nodes), tuple(links))


def oracle(btm, robot, start, end):
    """All shortest ways by networkx: the one with the fewest links and the lowest ids, as `(metres, links)`."""
    graph = networkx.MultiGraph()
    tall = {node.id for node in btm.nodes if node.step_m is not None and node.step_m > robot.max_step_m}
    graph.add_nodes_from(node.id for node in btm.nodes if node.id not in tall - {start, end})
    for link in btm.links:
        there = link.start in graph and link.end in graph
        if link.end != NOWHERE and there and link.max_step_m <= robot.max_step_m:
            graph.add_edge(link.start, link.end, key=link.id, weight=link.length_m)
    if start == end:
        return 0.0, ()
    if not networkx.has_path(graph, start, end):
        return math.inf, None
    metres = networkx.dijkstra_path_length(graph, start, end)
    ways = ([key for *_, key in path] for path in networkx.all_simple_edge_paths(graph, start, end))
    length = {link.id: link.length_m for link in btm.links}
    return metres, min((len(keys), tuple(keys)) for keys in ways if sum(map(length.get, keys)) == metres)[1]


@settings(max_examples=40)
@given(graphs(), st.data())
def test_routes_are_those_of_networkx(btm, data):
    one = st.sampled_from([node.id for node in btm.nodes])
    start, end, robot = data.draw(one), data.draw(one), data.draw(st.sampled_from([KAMUI, WHEELED]))
    route = jx.btm.route(btm, robot, start, end)
    metres, links = oracle(btm, robot, start, end)
    assert route.length_m == metres
    assert route.links == (links or ())
    assert route.is_found == (links is not None)
    assert [step.end for step in route.steps] == list(route.nodes[1:])


@settings(max_examples=20)
@given(graphs(), st.data())
def test_the_unsearched_link_is_the_nearest(btm, data):
    start = data.draw(st.sampled_from([node.id for node in btm.nodes]))
    tall = {node.id for node in btm.nodes if node.step_m is not None and node.step_m > WHEELED.max_step_m}
    ends = {}
    for link in btm.links:
        if link.end == NOWHERE and link.opening_m >= WHEELED.width_m and link.start not in tall:
            metres, links = oracle(btm, WHEELED, start, link.start)
            if links is not None:
                ends[link.id] = metres, len(links), links, link.id
    route = jx.btm.route(btm, "wheeled", start, "unsearched")
    assert route.is_found == bool(ends)
    if ends:
        assert (route.length_m, len(route.links), route.links, route.onward.link) == min(ends.values())


def test_many_are_what_each_is_alone():
    robots = ["kamui", WHEELED, "wheeled:max_step_m=0.2", "kamui:width_m=1.1", "wheeled:width_m=0.9"]
    pairs = [*itertools.product(range(4), range(4)), *((i, "unsearched") for i in range(4))]
    many = jx.btm.routes(SQUARE, robots, pairs)
    assert [len(of) for of in many] == [20] * 5
    for robot, of in zip(robots, many):
        for pair, found in zip(pairs, of):
            assert found == jx.btm.route(SQUARE, robot, *pair)
    assert not any(route.is_found for (a, b), route in zip(pairs, many[3]) if a != b and b != "unsearched")
    assert jx.btm.routes(SQUARE, [], pairs) == []
    assert jx.btm.routes(SQUARE, robots, []) == [[]] * 5


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 40))
def test_many_goals_in_many_parts_are_those_of_networkx(seed, n_nodes):
    rng = np.random.default_rng(seed)
    nodes = tuple(Node(3 * i, float(i), 0.0, "divergence") for i in range(n_nodes))
    ends = 3 * rng.integers(0, n_nodes, (2 * n_nodes, 2))
    links = tuple(
        way(i, int(a), int(b), 0.0, 90.0, length_m=float(rng.integers(0, 9))) for i, (a, b) in enumerate(ends)
    )
    graph = networkx.MultiGraph()
    graph.add_nodes_from(node.id for node in nodes)
    graph.add_edges_from((link.start, link.end, link.id, {"weight": link.length_m}) for link in links)
    pairs = (3 * rng.permutation(np.stack(np.indices((n_nodes, n_nodes)), -1).reshape(-1, 2))).tolist()
    metres = dict(networkx.all_pairs_dijkstra_path_length(graph))
    with pytest.MonkeyPatch.context() as patch:  # 40 goals in three parts, the last one not full
        patch.setattr(shortest, "GOALS_AT_ONCE", 16)
        (found,) = jx.btm.routes(BtmMap(nodes, links), ["kamui"], pairs)
    for (start, end), route in zip(pairs, found):
        assert route.length_m == metres[start].get(end, math.inf)
        assert (route.start, route.end) == (start, end)
        if route.is_found:
            assert (route.nodes[0], route.nodes[-1]) == (start, end)


# Wrong input, and the command


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("kamui", 4, 0), r"^from: there is no node 4: the map has nodes 0, 1, 2, 3$"),
        (("kamui", 0, "-1"), r"^to: there is no node -1: the map has nodes 0, 1, 2, 3$"),
        (("kamui", "a", 0), r"^from must be a node's id or X,Y in metres, got 'a'$"),
        (("kamui", 0, "1,2,3"), r"^to must be a node's id or X,Y in metres, or unsearched, got '1,2,3'$"),
        (("kamui", 0, (1.0, math.nan)), r"^to must be a node's id"),
        (("kamui", "unsearched", 0), r"^from must be a node's id or X,Y in metres, got 'unsearched'$"),
        (("kamui", "9,0", 0), r"^from: the node nearest to 9,0 is 1, 4.00 m away, more than 2 m$"),
        (("hover", 0, 1), r"^robot must be one of kamui, wheeled, got 'hover'$"),
        ((3, 0, 1), r"^robot must be a name such as wheeled, or a jx.btm.Robot, got 3$"),
    ],
)
def test_bad_requests_are_refused(arguments, message):
    refused(message, jx.btm.route, SQUARE, *arguments)


def test_bad_maps_are_refused():
    for btm, start, end, message in (
        (chain("D" * 20), 3, 99, r"^to: there is no node 99: the map has 20 nodes, with ids from 0 to 19$"),
        (BtmMap((), ()), 0, 0, r"^the map has no node: there is nowhere to go$"),
        ("btm.json", 0, 0, r"^btm must be a jx.btm.BtmMap"),
        (changed(SQUARE, 0, length_m=1.1e6), 1, 2, r"^links must be less than 1074 km long in all$"),
    ):
        refused(message, jx.btm.route, btm, "kamui", start, end)
    refused(r"^robots must be a list, got 'kamui'$", jx.btm.routes, SQUARE, "kamui", [(0, 1)])
    refused(r"^within_m must be a number at least 0", jx.btm.route, SQUARE, "kamui", 0, 1, within_m=-1)


@pytest.fixture
def saved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    store.write_json(to_json(SQUARE), "btm.json")
    (tmp_path / "no.json").write_text('{"a": 1}', encoding="utf-8")
    return tmp_path


def test_the_command_prints_a_route_and_writes_it(saved, capsys):
    ask = ["route", "--map", "btm.json", "--robot", "wheeled", "--from", "0", "--to", "2"]
    assert main(ask) == 0
    said = capsys.readouterr().out
    assert said == trace_tables.route_table(jx.btm.route(SQUARE, "wheeled", 0, 2)) + (
        "\nrefused: link 4 (nodes 0 to 2): step 0.15 m > 0.03 m\n"
    )
    assert sorted(path.name for path in saved.iterdir()) == ["btm.json", "no.json"]
    assert main([*ask, "--out", "found"]) == 0
    assert capsys.readouterr().out == said + "wrote route.json, run.json, route.png to found/\n"
    page = json.loads((saved / "found" / "route.json").read_text(encoding="utf-8"))
    assert (page["is_found"], page["nodes"], page["links"], page["length_m"]) == (True, [0, 1, 2], [0, 1], 10.0)
    assert page["refused"] == [{"id": 4, "reasons": ["step 0.15 m > 0.03 m"]}]
    assert (saved / "found" / "route.png").stat().st_size > 5000


def test_without_a_route_the_command_ends_with_1_and_all_reasons(saved, capsys):
    ask = ["route", "--map", "btm.json", "--robot", "kamui:width_m=1.1,max_step_m=0.1", "--to", "2"]
    for more in ([], ["--out", "none"]):
        assert main([*ask, *more]) == 1
        lines = capsys.readouterr().out.splitlines()
        assert lines[0] == "no route: kamui:width_m=1.1,max_step_m=0.1 cannot get from node 0 to node 2"
        assert lines[1] == "refused: link 0 (nodes 0 to 1): width 1 m < 1.1 m"
        assert lines[5] == "refused: link 4 (nodes 0 to 2): width 1 m < 1.1 m, step 0.15 m > 0.1 m"
        assert lines[6:] == (["wrote route.json, run.json, route.png to none/"] if more else [])
    page = json.loads((saved / "none" / "route.json").read_text(encoding="utf-8"))
    assert (page["is_found"], page["length_m"], page["links"]) == (False, None, [])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--map btm.json", "expected --to: jexplore route --map btm.json"),
        ("--to 3", "expected --map: jexplore route --map btm.json"),
        ("--map btm.json --from -3,4 --to 2", "from: the node nearest to -3,4 is 3, 3.16 m away, more than 2 m"),
        ("--map no.json --to 2", '"no.json"'),
        ("--map gone.json --to 2", "'gone.json': there is no such file"),
        ("--map btm.json --to 2 --overwrite", "--overwrite goes with --out DIR"),
    ],
)
def test_bad_input_of_the_command_is_one_line(words, message, saved, refuses):
    refuses(["route", *words.split()], message)
