"""Comparison of Behavioral Trace Maps: by hand, laws, and the edit distance from its definition."""

import dataclasses
import functools
import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref.traces import CRAWLER, SQUARE, T_LEFT, T_RIGHT, WHEELED, chain, changed, maps, node, stub, way

from jexplore.tracemap.record import NOWHERE, BtmMap
from jexplore.tracemap.similarity import code, differences, distance, same


def test_codes_by_hand():
    assert code(BtmMap((), ())) == ""
    assert code(chain("T")) == "T"
    assert code(chain("TD")) == "T(D)"  # a dead end
    assert (code(T_LEFT), code(T_RIGHT)) == ("T(D(T,-))", "T(D(-,T))")  # from the entry at the back, right comes first
    assert code(chain("TDT", [(1, 90), (1, -90)])) == "T(D(-,T,-))"
    assert code(SQUARE) == "T(D(D(D(=1))),=1)"
    assert code(CRAWLER) == "T(O:slope(O:slope(O:slope(D(F(F(D(-,T))),-)))))"
    assert code(WHEELED) == "T(D(F(F(D(-,T))),-))"
    assert code(BtmMap((node(0), node(1)), (way(0, 0, 1, 0), way(1, 0, 1, 90, 90), way(2, 1, 1, 10, 20)))) == (
        "D(D(=1,=1,=2),=2)"  # at the second node 10, 20 and 90 degrees follow the entry at 180
    )
    assert code(BtmMap((node(0, "T"), node(1, "F")), (stub(0, 1, 0),))) == "T + F(-)"


def test_the_walk_starts_with_the_link_first_followed():
    links = (stub(0, 0, 0), way(2, 0, 1, 90), way(1, 0, 2, 180))
    assert code(BtmMap((node(0, "T"), node(1, "F"), node(2, "D")), links)) == "T(D,-,F)"


def test_links_of_one_bearing_count_in_order_of_ids():
    nodes = (node(0, "T"), node(1, "F"), node(2, "D"))
    links = [way(0, 0, 1, 45), way(1, 0, 2, 45), stub(2, 0, 45)]
    assert code(BtmMap(nodes, tuple(links))) == code(BtmMap(nodes, tuple(links[::-1]))) == "T(F,D,-)"
    assert code(BtmMap(nodes, (links[2], dataclasses.replace(links[0], id=5), links[1]))) == "T(D,-,F)"


def test_a_long_chain():
    assert code(chain("T" * 3000)) == "T" + "(T" * 2999 + ")" * 2999


@given(maps(), st.integers(-720, 720))
def test_codes_do_not_turn(btm, turn):
    cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))

    def turned(link):
        back = None if link.end_bearing_deg is None else link.end_bearing_deg + turn
        return {"start_bearing_deg": link.start_bearing_deg + turn, "end_bearing_deg": back}

    def placed(item):
        return {"x_m": cos * item.x_m - sin * item.y_m + 3, "y_m": sin * item.x_m + cos * item.y_m}

    assert code(changed(btm, links=turned, nodes=placed)) == code(btm)


@given(maps(), st.data())
def test_codes_do_not_know_ids_and_directions(btm, data):
    at_root = [link for link in btm.links if 0 in (link.start, link.end)]
    first = min(at_root, key=lambda link: (link.end == NOWHERE, link.id), default=None)
    others = [link.id for link in btm.links if link is not first]
    ids = dict(zip(others, data.draw(st.permutations(range(10, 10 + len(others))))))
    if first:
        ids[first.id] = 3
    names = dict(zip(range(5), data.draw(st.permutations(range(5))))) | {NOWHERE: NOWHERE}

    def renamed(link):
        ends = {"id": ids[link.id], "start": names[link.start], "end": names[link.end]}
        if link.end in (NOWHERE, link.start) or not data.draw(st.booleans()):
            return ends
        turned = {"start_bearing_deg": link.end_bearing_deg, "end_bearing_deg": link.start_bearing_deg}
        return {**ends, "start": ends["end"], "end": ends["start"], **turned}

    other = changed(btm, links=renamed, nodes=lambda item: {"id": names[item.id]})
    other = dataclasses.replace(other, links=tuple(data.draw(st.permutations(other.links))))
    assert code(other) == code(btm)
    assert same(btm, other, 0.0, 0.0)
    assert distance(btm, other) == 0


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("type", {"nodes": lambda item: {"type": "free_space"} if item.id == 4 else {}}),
        ("shape", {"nodes": lambda item: {"obstacle": "stairs"} if item.id == 2 else {}}),
        ("order", {"links": lambda link: {"start_bearing_deg": -90.0} if link.id == 8 else {}}),
    ],
)
def test_labels_and_order_count(what, changes):
    other = changed(CRAWLER, **changes)
    assert not same(CRAWLER, other)
    assert distance(CRAWLER, other) == {"type": 1, "shape": 1, "order": 2}[what]


def test_status_counts():
    searched = dataclasses.replace(
        T_LEFT, nodes=(*T_LEFT.nodes, node(3, "T")), links=(*T_LEFT.links[:2], way(2, 1, 3, 90))
    )
    assert (code(searched), distance(T_LEFT, searched)) == ("T(D(T,T))", 1)


def test_differences_of_codes_by_hand():
    assert differences(CRAWLER, WHEELED) == [
        "the first map has 3 obstacle nodes, the second 0",
        "after T, the first map has O:slope (obstacle node) at node 0, the second D (divergence node) at node 0",
    ]
    assert differences(T_LEFT, T_RIGHT, 0.0, 0.0) == [
        "after T D, the first map has T (terminal node) at node 1, the second - (un-searched link) at node 1"
    ]
    assert differences(chain("T"), chain("TD")) == [
        "the first map has 0 divergence nodes, the second 1",
        "after T, the first map has no more, the second D (divergence node) at node 0",
    ]
    assert differences(BtmMap((), ()), chain("T"))[1:] == [
        "after nothing, the first map has no more, the second T (terminal node) to begin with"
    ]
    assert differences(SQUARE, chain("TDDD"))[0] == ("the first map has 2 cycle-closing link ends, the second 0")


@pytest.mark.parametrize(
    ("kind", "number", "fields", "limits", "told"),
    [
        ("nodes", 1, {"x_m": 2.5}, (0.6, None), []),
        ("nodes", 1, {"x_m": 2.5}, (None, 0.0), []),
        ("nodes", 1, {"x_m": 2.5}, (0.4, None), ["node 1 and node 1: x_m is 2 and 2.5, 0.4 m are allowed"]),
        ("nodes", 1, {"posture_deg": 3.0}, (9.0, None), []),
        (
            "nodes",
            1,
            {"posture_deg": 3.0},
            (None, 9.0),
            ["node 1 and node 1: posture_deg is unknown and 3, 9 degrees .*"],
        ),
        ("nodes", 1, {"attributes": {"victim": 1}}, (0.0, 0.0), []),
        ("links", 0, {"start_bearing_deg": 359.5}, (0.0, 0.5), []),
        ("links", 0, {"start_bearing_deg": -1.0}, (0.0, 0.5), ["link 0 and link 0: start_bearing_deg is 0 and -1, .*"]),
        (
            "links",
            2,
            {"opening_m": 1.0},
            (0.0, 0.0),
            ["link 2 and link 2: opening_m is unknown and 1, 0 m are allowed"],
        ),
        ("links", 1, {"min_width_m": 1.0}, (0.0, None), ["link 1 and link 1: min_width_m .*"]),
    ],
)
def test_measures_within_tolerance(kind, number, fields, limits, told):
    other = changed(T_LEFT, **{kind: lambda item: fields if item.id == number else {}})
    found = differences(T_LEFT, other, *limits)
    assert len(found) == len(told)
    for text, want in zip(found, told):
        assert re.fullmatch(want, text)
    assert same(T_LEFT, other, *limits) == (not told)
    assert len(differences(other, T_LEFT, *limits)) == len(told)


def test_a_link_followed_the_other_way_has_its_bearings_turned():
    there = BtmMap((node(0), node(1)), (way(0, 0, 1, 10, 200, opening_m=1.0),))
    back = BtmMap((node(0), node(1)), (way(0, 1, 0, 200, 10, opening_m=2.0),))
    assert same(there, back, 0.0, 0.0)
    assert len(differences(there, BtmMap(there.nodes, (way(0, 1, 0, 10, 200),)), None, 1.0)) == 2


def test_closing_links_are_compared_once():
    other = changed(SQUARE, links=lambda link: {"length_m": 1.0} if link.id == 3 else {})
    assert differences(SQUARE, other, 0.0) == ["link 3 and link 3: length_m is unknown and 1, 0 m are allowed"]


# Distance


def forest(text):
    """A code as nested tuples `(label, children)`, read by hand."""
    stack, label = [[]], ""

    def close():
        nonlocal label
        if label:
            stack[-1].append((label, ()))
        label = ""

    for mark in text.replace(" + ", ","):
        if mark == "(":
            stack += [[label], []]
            label = ""
        elif mark == ",":
            close()
        elif mark == ")":
            close()
            children, (name,) = stack.pop(), stack.pop()
            stack[-1].append((name, tuple(children)))
        else:
            label += mark
    close()
    return tuple(stack[0])


@functools.cache
def literal(one, other):
    """Edit distance of forests from its definition, by what becomes of the last trees' roots."""
    if not one and not other:
        return 0
    found = []
    if one:
        found.append(literal(one[:-1] + one[-1][1], other) + 1)
    if other:
        found.append(literal(one, other[:-1] + other[-1][1]) + 1)
    if one and other:
        changed_label = one[-1][0] != other[-1][0]
        found.append(literal(one[:-1], other[:-1]) + literal(one[-1][1], other[-1][1]) + changed_label)
    return min(found)


def test_distances_by_hand():
    assert distance(CRAWLER, WHEELED) == 3  # the slope's nodes
    assert distance(T_LEFT, T_RIGHT) == 2  # the stub goes and comes
    assert distance(T_LEFT, chain("TDT")) == 1
    assert distance(SQUARE, chain("TDDD")) == 2  # both ends of the link that closes the cycle
    assert distance(BtmMap((), ()), T_LEFT) == 4
    assert distance(chain("TFT"), chain("TOT")) == 1


@settings(max_examples=60)
@given(maps(), maps())
def test_distance_is_the_literal_one(a, b):
    assert distance(a, b) == literal(forest(code(a)), forest(code(b)))


@settings(max_examples=60)
@given(maps(), maps(), maps(cycles=False))
def test_distance_is_a_metric(a, b, c):
    assert (distance(a, b) == 0) == (code(a) == code(b)) == same(a, b)
    assert distance(a, b) == distance(b, a)
    assert distance(a, a) == 0
    assert distance(a, b) <= distance(a, c) + distance(c, b)
