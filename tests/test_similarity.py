"""Codes of Behavioral Trace Maps: by hand, and laws."""

import dataclasses
import math

from hypothesis import given, settings
from hypothesis import strategies as st
from ref.traces import CRAWLER, SQUARE, T_LEFT, T_RIGHT, WHEELED, are_same, chain, changed, maps, node, stub, way

from jexplore.tracemap.record import NOWHERE, BtmMap
from jexplore.tracemap.similarity import code


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


@settings(max_examples=30)
@given(maps(), st.integers(-720, 720))
def test_codes_do_not_turn(btm, turn):
    cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))

    def turned(link):
        back = None if link.end_bearing_deg is None else link.end_bearing_deg + turn
        return {"start_bearing_deg": link.start_bearing_deg + turn, "end_bearing_deg": back}

    def placed(item):
        return {"x_m": cos * item.x_m - sin * item.y_m + 3, "y_m": sin * item.x_m + cos * item.y_m}

    assert code(changed(btm, links=turned, nodes=placed)) == code(btm)


@settings(max_examples=30)
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
    assert are_same(btm, other, 0.0)


def test_type_shape_order_and_status_count():
    others = [
        changed(CRAWLER, nodes=lambda item: {"type": "free_space"} if item.id == 4 else {}),
        changed(CRAWLER, nodes=lambda item: {"obstacle": "stairs"} if item.id == 2 else {}),
        changed(CRAWLER, links=lambda link: {"start_bearing_deg": -90.0} if link.id == 8 else {}),
    ]
    assert len({code(btm) for btm in (CRAWLER, *others)}) == 4
    end = node(3, "T")
    searched = dataclasses.replace(T_LEFT, nodes=(*T_LEFT.nodes, end), links=(*T_LEFT.links[:2], way(2, 1, 3, 90)))
    assert (code(T_LEFT), code(searched)) == ("T(D(T,-))", "T(D(T,T))")
