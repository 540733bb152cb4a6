"""Maps without a common frame become one: by hand, laws, parts of true maps, wrong input, the command."""

import dataclasses
import functools
import itertools
import json
import math
import random

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from ref.parts import EXACT, common, part_of
from ref.refusals import refused
from ref.traces import FIRST, SECOND, are_same, chain, maps, node, stub, way
from scipy.stats import lognorm, multivariate_normal

import jexplore as jx
from jexplore.cli.main import main
from jexplore.tracemap import json_form
from jexplore.tracemap.merging import evidence
from jexplore.tracemap.merging import pair as pair_module
from jexplore.tracemap.merging.limits import Limits
from jexplore.tracemap.merging.match import Merging, match_maps, with_neighbours
from jexplore.tracemap.merging.merge import merge_maps
from jexplore.tracemap.merging.pair import Pair, places_of
from jexplore.tracemap.merging.rigid import Move, fit, mirrored, moved_map
from jexplore.tracemap.record import BtmMap, Link, Node, check_map
from jexplore.tracemap.similarity import code
from jexplore.worlds import load_world

TOGETHER = BtmMap(
    (
        node(0, "T", 0, 0),
        node(1, "D", 4, 0),
        node(2, "D", 13, 0, posture_deg=5.0),
        node(3, "D", 13, -6),
        node(4, "T", 13, -2.5),
        node(5, "F", 4, 5),
    ),
    (
        way(0, 0, 1, 0, length_m=4.0, min_width_m=1.5),
        way(1, 1, 2, 0, length_m=9.0, min_width_m=2.1, opening_m=2.3),
        way(2, 1, 5, 90, length_m=5.0, opening_m=1.2),
        way(3, 2, 4, 270, length_m=2.5, min_width_m=1.4, max_step_m=0.02),
        way(4, 4, 3, 270, length_m=3.5, min_width_m=1.3, max_step_m=0.02, posture_deg=2.0),
        stub(5, 3, 0),
        stub(6, 5, 90),
    ),
)
TIGHT = Limits(angle_deg=1.0, length_share=1e-6, length_m=1e-5, heading_deg=0.0, lost=0)
QUARTER = Move(2.0, -1.0, 90.0)


def merged_of(*given, **options):
    found = merge_maps(given, list("abcdefgh"[: len(given)]), **options)
    check_map(found.map)
    return found


@functools.cache
def truth_of(seed):
    return load_world(f"course#{seed}").course.topology


@pytest.mark.parametrize("move", [Move(), Move(-30, 4, 217)])
def test_two_maps_by_hand(move):
    found = merged_of(FIRST, moved_map(SECOND, move))
    assert found.outcome is Merging.MERGED
    assert found.left == ()
    assert are_same(found.map, TOGETHER)
    assert found.matched == 3
    assert found.nodes == {"a": {0: 0, 1: 1, 2: 2, 3: 3}, "b": {7: 2, 8: 1, 10: 3, 0: 4, 9: 5}}
    x, y = found.moves["b"].place(*move.place(5, 6))
    assert (x, y) == pytest.approx((5, 6))
    assert found.moves["a"] == Move()
    attributes = [item.attributes for item in found.map.nodes]
    assert attributes[2] == {"from": {"a": 2, "b": 7}, "radio_dbm": -61}
    told = [{"from": ["a"], "value": True}, {"from": ["b"], "value": False}]
    assert attributes[3] == {"from": {"a": 3, "b": 10}, "conflicts": {"victim": told}}
    assert [link.attributes["from"] for link in found.map.links] == [
        {"a": 0, "b": 3}, {"a": 1, "b": 1}, {"a": 2, "b": 2}, {"a": 3, "b": 0}, {"a": 3, "b": 4}, {"a": 4, "b": 5},
        {"b": 6},
    ]  # fmt: skip
    assert found.map.attributes == {"frame": "odom", "merged_from": ["a", "b"]}
    assert found.notes == ("node 3: victim is True in a and False in b",)


def test_means_count_every_map_once():
    def shifted(off):
        nodes = [dataclasses.replace(one, x_m=one.x_m + off * (one.id == 2)) for one in FIRST.nodes]
        links = [
            dataclasses.replace(one, length_m=9.0 + off) if one.id == 1 else one for one in FIRST.links
        ]  # fmt: skip
        return BtmMap(tuple(nodes), tuple(links))

    found = merged_of(shifted(0.0), shifted(0.0), shifted(0.3))
    assert found.map.links[1].length_m == pytest.approx(9.1)
    assert found.map.nodes[2].attributes["from"] == {"a": 2, "b": 2, "c": 2}


def test_starts_on_one_way():
    # Both begin in the middle of the way from D1 to D2, 2 and 6 m from D1, and go different ways.
    west = BtmMap(
        (node(0, "T", 6, 0), *FIRST.nodes[1:2], node(9, "F", 4, 5), node(5, "O", 4, 11, obstacle="stairs")),
        (way(0, 0, 1, 180, length_m=2.0), way(1, 1, 9, 90, length_m=5.0, opening_m=1.2), stub(2, 1, 180), stub(3, 0, 0),
         way(4, 9, 5, 90, length_m=6.0), stub(5, 5, 90)),
    )  # fmt: skip
    east = BtmMap((node(0, "T", 10, 0), *west.nodes[1:]), (way(0, 0, 1, 180, length_m=6.0), *west.links[1:]))
    found = merged_of(west, east)
    assert found.outcome is Merging.MERGED
    assert found.matched == 3
    assert code(found.map) == "T(D(F(O:stairs(-)),-),T(-))"
    lengths = {(link.start, link.end): link.length_m for link in found.map.links}
    assert lengths[0, 1] == 2.0
    assert lengths[0, 4] == 4.0  # to the start of the second
    near = merged_of(west, dataclasses.replace(west, nodes=(node(0, "T", 6.2, 0), *west.nodes[1:])))
    assert near.matched == 4
    assert len(near.map.nodes) == 4


def test_starts_are_compared_by_one_scale():
    def scaled(btm, factor):
        links = [dataclasses.replace(one, length_m=one.length_m and one.length_m * factor) for one in btm.links]
        nodes = [dataclasses.replace(one, x_m=one.x_m * factor, y_m=one.y_m * factor) for one in btm.nodes]
        return BtmMap(tuple(nodes), tuple(links))

    links = [way(0, 0, 1, 0, length_m=14.0), *FIRST.links[1:]]
    far = BtmMap((node(0, "T", -10, 0), *FIRST.nodes[1:]), tuple(links))
    assert merged_of(far, scaled(far, 1.08)).matched == 4
    late = dataclasses.replace(far, links=(way(0, 0, 1, 0, length_m=15.2), *far.links[1:]))
    assert merged_of(late, scaled(far, 1.08)).matched == 3


def apart_slowly(a, b):
    return (a - b + 180.0) % 360.0 - 180.0


def aligned_slowly(ways, others, turn_deg, entry=None):
    """Pairs of bearings that are alike after a turn, the nearest first, and the turn: in plain loops."""
    off = {
        (p, q): apart_slowly(way, other + turn_deg)
        for p, way in enumerate(ways)
        for q, other in enumerate(others)
        if entry is None or (p == entry[0]) == (q == entry[1])
    }
    found = []
    for p, q in sorted(off, key=lambda both: abs(off[both])):
        if abs(off[p, q]) <= 30.0 and not any(p == m or q == n for m, n in found):
            found.append((p, q))
    middle = 0.0
    for both in found:
        middle += off[both]
    middle /= max(len(found), 1)
    return tuple(both for both in found if abs(off[both] - middle) <= 15.0), apart_slowly(turn_deg + middle, 0.0)


def star(bearings):
    """Nodes with stubs that leave at these bearings, in order."""
    stubs = [(i, angle) for i, own in enumerate(bearings) for angle in sorted(own)]
    nodes = map(node, range(len(bearings)))
    return places_of(BtmMap(tuple(nodes), tuple(stub(k, *one) for k, one in enumerate(stubs))))


def test_many_places_are_compared_a_part_at_a_time(monkeypatch):
    parts = star([(0, 90, 180), (0, 100, 180, 270)] * 3), star([(10, 100, 190)] * 4)

    def tables():
        return Pair(*parts, Limits()).alike

    expected = tables()
    monkeypatch.setattr(pair_module, "MAX_ANGLES", 20)
    assert expected
    assert tables() == expected


def contradicting():
    """Both have gone north of D1: the first 9 m to F11, the second 5 m to F9. At the stairs east of D2 both were."""
    stairs = (node(12, "O", 20, 0, obstacle="stairs"), node(11, "F", 4, 9))
    ways = (way(13, 0, 12, 0, length_m=7.0), way(12, 1, 11, 90, length_m=9.0, opening_m=1.2))
    first = BtmMap(
        (*FIRST.nodes, *stairs),
        (*(one for one in FIRST.links if one.id != 2), dataclasses.replace(ways[0], start=2), ways[1]),
    )
    return first, BtmMap((*SECOND.nodes, stairs[0]), (*SECOND.links, dataclasses.replace(ways[0], start=7)))


def test_contradictions_are_told():
    first, second = contradicting()
    assert len(match_maps(first, second).contradictions) == 1
    found = merged_of(first, moved_map(second, QUARTER))
    assert found.outcome is Merging.MERGED
    assert len(found.map.bearings_deg(1)) == 4  # both ways north
    assert found.notes[1:] == ("node 1: 1 way leads elsewhere in b than in a; the map has both",)
    again = merged_of(second, first)
    assert again.nodes["a"][8] == 2
    assert again.notes[1:] == ("node 2: 1 way leads elsewhere in b than in a; the map has both",)
    assert match_maps(FIRST, SECOND).contradictions == ()
    apart = merged_of(corridor(9), corridor(8), first, second)
    assert apart.notes[-1] == "node 1: 1 way leads elsewhere in d than in c; the map has both"


def test_each_match_brings_the_next_place_within_reach():
    """Turned by 18 degrees: the next place is 0.63 m off, the next but one 1.25 m, too far."""
    there = chain("D" * 9, [(i, 90) for i in range(9)])
    pair = Pair(places_of(there), places_of(moved_map(there, Move(turn_deg=18.0))), Limits())
    nodes, ways = with_neighbours(pair, {0: 0}, [], {0: 0.0}, Move())
    assert nodes == {i: i for i in range(9)}
    assert len(ways) == len(there.links)


@pytest.mark.parametrize(
    ("apart_m", "upper", "is_one"),
    [(1.2, (0, 90, 180), False), (1.2, (270, 0, 180), False), (1.2, (0, 180, 315), False), (1.2, (270, 180), True),
     (0.5, (0, 90, 180), False), (0.5, (270, 0, 180), True)],
)  # fmt: skip
def test_what_lies_behind_a_wall_is_another_place(apart_m, upper, is_one):
    # Two branches end at a wall: the first map has the lower one to its dead end, the second the upper one. Nearer than
    # walls are thick one way that leaves alike is enough.
    def branches(*more):
        nodes = (*SECOND.nodes[1:], *(one for one in more if isinstance(one, Node)))
        links = (way(1, 7, 8, 180, length_m=9.0), way(2, 8, 9, 90, length_m=5.0), way(4, 7, 10, 270, length_m=6.0))
        stubs = (stub(3, 8, 180), stub(5, 10, 180), stub(6, 9, 90))
        return BtmMap(nodes, (*links, *stubs, *(one for one in more if isinstance(one, Link))))

    low = branches(node(20, "F", 28, -6), node(21, "D", 28, -apart_m), way(20, 10, 20, 0, length_m=15.0),
                   way(21, 20, 21, 90, length_m=6 - apart_m), stub(22, 7, 0))  # fmt: skip
    high = branches(node(20, "D", 28, 0), way(20, 7, 20, 0, 180, length_m=15.0), stub(22, 10, 0),
                    *(stub(30 + i, 20, bearing) for i, bearing in enumerate(upper) if bearing != 180))  # fmt: skip
    found = merged_of(low, high)
    assert found.outcome is Merging.MERGED
    assert found.matched == 4 + is_one
    assert (found.nodes["a"][21] == found.nodes["b"][20]) == is_one
    assert found.notes == ("node 5: one in a and in b by place and bearings alone",) * is_one


def test_merged_with_itself():
    for seed in range(3):
        btm = truth_of(seed)
        shifted = moved_map(btm, Move(1.0))  # no copy: what both have must be found
        found = merged_of(btm, shifted)
        assert found.outcome is Merging.MERGED
        assert found.matched == len(btm.nodes)
        assert are_same(found.map, btm)


def bare(btm):
    return BtmMap(*(tuple(dataclasses.replace(one, attributes={}) for one in of) for of in (btm.nodes, btm.links)))


def with_more(*more):
    return BtmMap(
        (*FIRST.nodes, *(one for one in more if isinstance(one, Node))),
        (*FIRST.links, *(one for one in more if isinstance(one, Link))),
    )


@pytest.mark.parametrize(
    "btm",
    [
        FIRST,
        with_more(node(9, "T", 30, 0), node(8, "T", 35, 0), way(9, 9, 8, 0, length_m=5.0), way(8, 8, 9, 90, 90)),
        with_more(way(9, 1, 1, -30, -80, length_m=15.0), way(8, 1, 2, 0, length_m=9.0)),
    ],
    ids=["course", "ring of starts", "loop, parallel"],
)
def test_a_map_merged_with_a_copy_is_that_map(btm):
    found = merged_of(btm, btm.with_attributes({"seed": 3}))
    assert (found.outcome, found.left, found.notes) == (Merging.MERGED, (), ())
    assert found.matched == len(btm.nodes)
    assert found.moves == {"a": Move(), "b": Move()}
    assert found.map.attributes["merged_from"] == ["a", "b"]
    own = {one.id: one.id for one in btm.nodes}
    assert found.nodes == {"a": own, "b": own}
    assert bare(found.map) == bare(check_map(btm))


def test_copies_say_what_they_say_and_go_on_being_merged():
    found = merged_of(FIRST, FIRST.with_attributes({"victim": False}, node=3), moved_map(SECOND, QUARTER))
    assert found.outcome is Merging.MERGED
    assert found.map.nodes[3].attributes["from"] == {"a": 3, "b": 3, "c": 10}
    assert found.notes == ("node 3: victim is True in a and False in b, c",)
    assert merged_of(chain("T"), chain("T")).outcome is Merging.NOT_ENOUGH_IN_COMMON  # nothing was measured
    marked = [FIRST.with_attributes({"victim": value}, node=3) for value in (True, True, False, 1)]
    told = [{"from": ["a", "b"], "value": True}, {"from": ["c"], "value": False}, {"from": ["d"], "value": 1}]
    assert merged_of(*marked).map.nodes[3].attributes["conflicts"] == {"victim": told}


def test_what_means_something_in_one_run_only_is_left_out():
    def written(btm, seed):
        nodes = (
            dataclasses.replace(one, attributes={**one.attributes, "profile_variance_m2": seed}) for one in btm.nodes
        )
        links = (dataclasses.replace(one, attributes={"moved": [1.0, seed, 0.0]}) for one in btm.links)
        return BtmMap(tuple(nodes), tuple(links), {"frame": "odom", "seed": seed, "overflow": 0, "robot": f"r{seed}"})

    found = merged_of(written(FIRST, 1.0), written(SECOND, 2.0))
    assert found.notes == ("node 3: victim is True in a and False in b",)
    told = [{"from": ["a"], "value": "r1.0"}, {"from": ["b"], "value": "r2.0"}]
    assert found.map.attributes == {"frame": "odom", "merged_from": ["a", "b"], "conflicts": {"robot": told}}
    assert all(one.attributes.keys() == {"from"} for one in found.map.links)
    refused("none has \\(maps that are merged have it no more: correct them before\\)", jx.btm.correct_map, found.map)
    older = found.map.with_attributes({"conflicts": {"moved": TOLD, "victim": TOLD}}, link=0)
    again = merge_maps([older, third()], ["two", "c"])
    assert list(again.map.links[0].attributes["conflicts"]) == ["victim"]


def test_who_found_a_link_blocked_for_all_is_not_forgotten_beside_who_did_for_one():
    who = {"name": "wheeled", "width_m": 0.6, "max_step_m": 0.03, "max_slope_deg": 5.0}
    walled, shut = ({"blocked": True, "found_by": "kamui"}, {"blocked": True, "blocked_for": who})
    for order in ((walled, shut), (shut, walled)):
        maps_ = [FIRST.with_attributes(own, link=1) for own in order]
        both = merged_of(*maps_).map
        (last,) = jx.btm.route(both, "kamui", 1, 2).refused
        assert last[0] == 1
        assert last[1][0].startswith("blocked, found by kamui: no measures")
        assert merge_maps([both, SECOND], ["two", "c"]).map.links[1].attributes == {
            **both.links[1].attributes, "from": {"a": 1, "b": 1, "c": 1}
        }  # fmt: skip
    alone = merged_of(FIRST.with_attributes(walled, link=1), FIRST).map.links[1].attributes
    assert alone == {**walled, "from": {"a": 1, "b": 1}}


def slow_gain(pair, guess):
    """Compute the evidence of a guess, by plain loops over everything unmatched."""

    def lost_of(part, a, i, other, b, j):
        ways, others = ([way.bearing_deg for way in own] for own in (part.ways[a], other.ways[b]))
        found, _ = aligned_slowly(ways, others, apart_slowly(ways[i], others[j]), (i, j))
        lost = len(ways) + len(others) - 2 * len(found)
        is_one = part.nodes[a].type == other.nodes[b].type and part.nodes[a].obstacle == other.nodes[b].obstacle
        return lost if is_one and (i, j) in found and lost <= pair.limits.lost else math.inf

    darts = [(part, a, i) for part in (pair.one, pair.other) for a in part.ways for i in range(len(part.ways[a]))]
    ways = [(a, i, one) for part in (pair.one, pair.other) for a in part.ways for i, one in enumerate(part.ways[a])]
    ways = [one for a, i, one in ways if one.is_whole and (a, i) < (one.end, one.back)]
    first = [(one, other) for one, other in guess.ways if one.is_whole and other.is_whole]
    noise2, scale2 = (pair.limits.length_m / 2) ** 2 + 1e-6, pair.limits.length_share**2 * 2 / 3

    def bell(off, spread):
        return math.exp(-0.5 * min(abs(off / spread), 40.0) ** 2) / (spread * math.sqrt(2 * math.pi))

    def ratio(one, other, spread, span, others):
        if one is None or other is None:
            return 0.0
        known = [value for value in others if value is not None]
        usual = (4 / span + sum(bell(other - value, spread) for value in known)) / (4 + len(known))
        return math.log(0.9 * bell(other - one, spread) / usual + 0.1)

    def without(values, *taken):
        left = list(values)
        for value in taken:
            left.remove(value)
        return left

    total = -5.0 * len(guess.contradictions)
    for a, i, b, j in guess.entries:
        lost = lost_of(pair.one, a, i, pair.other, b, j)
        others = [dart for dart in darts if dart[:2] not in ((pair.one, a), (pair.other, b))]
        alike = sum(lost_of(pair.one, a, i, *dart) <= lost for dart in others)
        total -= math.log((0.6 + alike) / (4 + len(others))) + 2.5 * lost
    spread = np.diag([noise2] * len(first)) + scale2 * np.outer(*2 * [[one.length_m for one, _ in first]])
    if first:
        off = [other.length_m - one.length_m for one, other in first]
        total += multivariate_normal([0.0] * len(first), spread).logpdf(off)
    for a, b in first:
        others = [one.length_m for one in ways if not (twins(one, a) or twins(one, b))]
        at_large = lognorm(0.7, scale=5.0).pdf(max(b.length_m, 0.1))
        dense = 4 * at_large + sum(bell(b.length_m - one, math.sqrt(noise2 + scale2 * one**2)) for one in others)
        total -= math.log(dense / (4 + len(others)))
    openings, measured = [part.ways[a][i].opening_m for part, a, i in darts], []
    for a, b in guess.places.items():
        for m, n in guess.alike[a].ways:
            one, other = pair.one.ways[a][m].opening_m, pair.other.ways[b][n].opening_m
            if one is not None and other is not None:
                measured.append(pair.one.ways[a][m].steps[0][0])
                total += ratio(one, other, 0.1, 3.0, without(openings, one, other))
    for a, b in first:
        if a.steps[0][0] not in measured and a.steps[-1][0] not in measured:
            others = [one.width_m for one in ways if not (twins(one, a) or twins(one, b))]
            total += ratio(a.width_m, b.width_m, 0.1, 3.0, others)
    inclined = [one.inclination_deg for part in (pair.one, pair.other) for one in part.nodes.values()]
    for a, b in guess.places.items():
        one, other = pair.one.nodes[a].inclination_deg, pair.other.nodes[b].inclination_deg
        total += ratio(one, other, 1.0, 30.0, without(inclined, one, other))
    return total


def twins(one, other):
    """Return whether two ways are equal, seen from their ends."""
    return {id(link) for link, _ in one.steps} == {id(link) for link, _ in other.steps}


@pytest.mark.parametrize("seed", range(4))
def test_evidence_is_that_of_plain_loops(seed):
    _, one, other = pair_of(seed)
    pair = Pair(places_of(one.map), places_of(other.map), Limits())
    fast = evidence.Evidence(pair)
    found = sorted(((fast.gain(guess), slow_gain(pair, guess)) for guess in pair.guesses()), reverse=True)
    assert len(found) > 2
    for gain, slow in found:
        assert gain == pytest.approx(slow, abs=1e-6)


def pair_of(seed, errors=None):
    rng, truth = random.Random(seed), truth_of(seed % 7)
    return truth, part_of(truth, rng, errors), part_of(truth, rng, errors)


def place_of(found, name, part):
    """Merged node -> true node, for those that are one."""
    return {found.nodes[name][key]: true for key, true in part.true.items()}


def whole_of(btm, true):
    """Ways between true nodes, in true nodes, and how long they are."""
    places = places_of(btm)
    return {
        (*sorted((true[a], true[one.end])), round(one.length_m, 6))
        for a, ways in places.ways.items()
        for one in ways
        if one.is_whole
    }


def blocks(rng):
    """Nine crossings of six streets, and the ways between them: four cycles."""
    x, y = ([sum(gaps[:i]) for i in range(3)] for gaps in ([rng.uniform(4, 9) for _ in range(3)] for _ in range(2)))
    nodes = [node(3 * i + j, rng.choice("DDF"), x[j], y[i]) for i in range(3) for j in range(3)]
    links = [(3 * i + j, 3 * i + j + 1, 0, x[j + 1] - x[j]) for i in range(3) for j in range(2)]
    links += [(3 * i + j, 3 * i + j + 3, 90, y[i + 1] - y[i]) for i in range(2) for j in range(3)]
    return BtmMap(tuple(nodes), tuple(way(i, *ends, length_m=length) for i, (*ends, length) in enumerate(links)))


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.booleans())
def test_parts_without_errors_make_their_union(seed, has_cycles):
    rng = random.Random(seed)
    truth = blocks(rng) if has_cycles else truth_of(seed % 7)
    one, other = part_of(truth, rng, EXACT), part_of(truth, rng, EXACT)
    found = merged_of(one.map, other.map, limits=TIGHT)
    if found.outcome is not Merging.MERGED:  # in common is too little that tells places apart
        assert len(common(one, other)) < 7
        return
    true = place_of(found, "a", one)
    for key, at in place_of(found, "b", other).items():
        assert true.setdefault(key, at) == at
    assert sorted(true.values()) == sorted({*one.true.values(), *other.true.values()})
    places = {**{found.nodes["a"][k]: p for k, p in one.place.items()},
              **{found.nodes["b"][k]: p for k, p in other.place.items()}}  # fmt: skip
    there = [(node.x_m, node.y_m) for node in found.map.nodes]
    move = fit(there, [places[node.id] for node in found.map.nodes], 0.0)
    for node_ in found.map.nodes:
        assert math.dist(move.place(node_.x_m, node_.y_m), places[node_.id]) < 1e-6
    for key, at in true.items():
        assert len(found.map.bearings_deg(key)) == len(truth.bearings_deg(at))
    both = whole_of(one.map, one.true) | whole_of(other.map, other.true)
    assert {ends[:2] for ends in whole_of(found.map, true)} == {ends[:2] for ends in both}
    assert {ends[2] for ends in whole_of(found.map, true)} <= {ends[2] for ends in both}


def test_most_parts_are_merged():
    answers = []
    for seed in range(40):
        _, one, other = pair_of(seed, None)
        if len(common(one, other)) >= 3:
            found = merged_of(one.map, other.map)
            answers.append(found.outcome is Merging.MERGED)
            back = {at: key for key, at in found.nodes.get("b", {}).items()}
            pairs = [(key, back[at]) for key, at in found.nodes.get("a", {}).items() if at in back]
            assert all(math.dist(one.place[a], other.place[b]) < 1.0 for a, b in pairs)
    assert len(answers) > 20
    assert sum(answers) >= 0.9 * len(answers)


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.floats(0, 360), st.floats(-50, 50))
def test_frames_do_not_matter(seed, turn, shift):
    _, one, other = pair_of(seed)
    found, again = merged_of(one.map, other.map), merged_of(one.map, moved_map(other.map, Move(shift, 7.0, turn)))
    assert (again.outcome, again.nodes) == (found.outcome, found.nodes)
    assert again.evidence == pytest.approx(found.evidence, abs=1e-6)
    if found.outcome is Merging.MERGED:
        assert are_same(again.map, found.map)


@pytest.mark.parametrize("seed", range(8))
def test_neither_map_is_preferred(seed):
    _, one, other = pair_of(seed)
    pairs = match_maps(one.map, other.map), match_maps(other.map, one.map)
    assert pairs[0].outcome is pairs[1].outcome
    assert pairs[0].outcome is Merging.MERGED or len(common(one, other)) < 4
    if pairs[0].outcome is Merging.MERGED:
        assert pairs[0].nodes == {b: a for a, b in pairs[1].nodes.items()}
        back = pairs[0].move.after(pairs[1].move)
        assert back.place(0, 0) == pytest.approx((0, 0), abs=1e-6)
        found, again = merge_maps([one.map, other.map]).map, merge_maps([other.map, one.map]).map
        shape = [sorted((n.type, len(btm.bearings_deg(n.id))) for n in btm.nodes) for btm in (found, again)]
        assert shape[0] == shape[1]
        lengths = [sorted(link.length_m or 0.0 for link in btm.links) for btm in (found, again)]
        assert lengths[0] == pytest.approx(lengths[1], abs=1e-6)


@settings(max_examples=25, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(maps(measures=True), maps(measures=True))
def test_any_two_maps_have_an_outcome(one, other):
    def tamed(item):
        values = {field.name: getattr(item, field.name) for field in dataclasses.fields(item)}
        tame = {name: value % 50 for name, value in values.items() if isinstance(value, float)}
        return dataclasses.replace(item, **tame, attributes={})

    one, other = (BtmMap(tuple(map(tamed, btm.nodes)), tuple(map(tamed, btm.links))) for btm in (one, other))
    found = merged_of(one, other, min_common=1)
    assert found.outcome in Merging
    assert (found.matched > 0) == (found.outcome is Merging.MERGED)
    assert check_map(found.map) == found.map


def corridor(n, *, odd=()):
    """Equal openings at equal distances; some have a way to the other side."""
    stubs = [(i, 90.0) for i in range(n)] + [(i, -90.0) for i in odd] + [(0, 180.0), (n - 1, 0.0)]
    return chain("D" * n, stubs)


def test_passages_that_look_alike_are_refused():
    found = merged_of(corridor(6), corridor(5))
    assert found.outcome in (Merging.AMBIGUOUS, Merging.NOT_ENOUGH_IN_COMMON)
    assert found.left == ("b",)
    assert are_same(found.map, corridor(6), 0)
    assert found.matched == 0
    marked = [
        dataclasses.replace(corridor(n, odd=odd), nodes=tuple(
            dataclasses.replace(one, type="free_space" if one.id in odd else "divergence") for one in corridor(n).nodes
        ))
        for n, odd in ((12, (4, 7)), (11, (3, 6)))
    ]  # fmt: skip
    assert merged_of(*marked).nodes["b"][3] == 4


def test_half_turns_of_a_symmetric_map_are_ambiguous():
    ring = BtmMap(
        (node(0, "D", 0, 0), node(1, "F", 7, 0), node(2, "D", 7, 4), node(3, "F", 0, 4),
         node(4, "O", 3, 0), node(5, "O", 4, 4)),
        (way(0, 0, 4, 0, length_m=3.0), way(1, 4, 1, 0, length_m=4.0), way(2, 1, 2, 90, length_m=4.0),
         way(3, 2, 5, 180, length_m=3.0), way(4, 5, 3, 180, length_m=4.0), way(5, 3, 0, 270, length_m=4.0)),
    )  # fmt: skip
    found = merged_of(ring, moved_map(ring, QUARTER))
    assert found.outcome is Merging.AMBIGUOUS
    assert found.margin == pytest.approx(0.0)
    stubbed = dataclasses.replace(ring, links=(*ring.links, stub(6, 1, 0), stub(7, 0, 180), stub(8, 4, 270)))
    assert merged_of(stubbed, moved_map(stubbed, QUARTER)).outcome is Merging.MERGED


def test_nothing_in_common_is_an_outcome():
    other = BtmMap((node(0, "T"), node(1, "F", 3, 0), node(2, "O", 9, 0, obstacle="stairs")), (
        way(0, 0, 1, 0, length_m=3.0), way(1, 1, 2, 0, length_m=6.0), stub(2, 2, 0)))  # fmt: skip
    start = chain("T")
    for pair in ((FIRST, other), (other, FIRST), (FIRST, start), (start, start), (FIRST, BtmMap((), ()))):
        found = merged_of(*pair)
        assert found.outcome is Merging.NOT_ENOUGH_IN_COMMON
        assert found.matched == 0
        assert found.left == ("b" if len(pair[0].nodes) >= len(pair[1].nodes) else "a",)
    assert merged_of(FIRST, SECOND, min_common=4).outcome is Merging.NOT_ENOUGH_IN_COMMON


def test_parts_of_two_courses_are_not_merged():
    close = 0
    for seed in (*range(6), 1049, 1091, 1113, 1193):
        rng = random.Random(seed)
        one, other = (part_of(truth_of(number), rng, least=0.15).map for number in (seed, seed + 1))
        found = match_maps(one, other)
        close += len(found.nodes) >= 3 and found.margin > 4.6
        assert found.outcome is Merging.NOT_ENOUGH_IN_COMMON
    assert close >= 2  # by chance as many nodes are alike as are asked for, and nothing rivals them


def third():
    """North of F4, of which the first map knows nothing."""
    nodes = (node(0, "D", 4, 0), node(1, "F", 4, 5), node(2, "O", 4, 13, obstacle="slope", inclination_deg=9.0))
    links = (way(0, 0, 1, 90, length_m=5.0, opening_m=1.2), way(1, 1, 2, 90, length_m=8.0), stub(2, 0, 180),
             way(3, 0, 3, 0, length_m=9.0), stub(4, 2, 90), stub(5, 3, 270))  # fmt: skip
    return BtmMap((*nodes, node(3, "D", 13, 0)), links)


def test_three_maps():
    for order in itertools.permutations([FIRST, moved_map(SECOND, QUARTER), moved_map(third(), Move(1, 1, 33))]):
        found = merged_of(*order)
        assert found.outcome is Merging.MERGED
        assert found.left == ()
        assert len(found.map.nodes) == 7
        assert len(found.map.links) == 8
        assert sorted(len(one.attributes["from"]) for one in found.map.nodes) == [1, 1, 1, 2, 2, 3, 3]
        for name, btm in zip("abc", order):
            for one in btm.nodes:
                at = found.map.nodes[found.nodes[name][one.id]]
                assert found.moves[name].place(one.x_m, one.y_m) == pytest.approx((at.x_m, at.y_m), abs=1e-6)
    found = merged_of(FIRST, corridor(9), moved_map(SECOND, QUARTER))
    assert found.left == ("b",)
    assert set(found.nodes) == {"a", "c"}
    assert len(found.map.nodes) == 6
    assert found.outcome is not Merging.MERGED


def test_merged_maps_are_merged_further_and_keep_whom_they_are_of():
    two = merge_maps([FIRST, SECOND], ["a", "b"]).map
    found = merge_maps([json_form.from_json(json_form.to_json(two)), third()], ["two", "c"])
    assert found.map.attributes["merged_from"] == ["a", "b", "c"]
    assert found.map.nodes[1].attributes["from"] == {"a": 1, "b": 8, "c": 0}
    assert found.nodes["two"][5] == 5
    assert found.nodes["c"][1] == 5
    assert found.notes == ("node 3: victim is True in a and False in b",)
    refused("names of maps must differ, got 'b' more than once", merge_maps, [two, third()], ["two", "b"])


TOLD = [{"from": ["a"], "value": 1}, {"from": ["b"], "value": 2}]


@pytest.mark.parametrize(
    ("where", "attributes", "words"),
    [
        *(({}, {"merged_from": bad}, f"two: merged_from: expected a list of names of maps, got {shown}")
          for bad, shown in ((5, "5"), ([], r"\[\]"), (["a", 1], r"\['a', 1\]"))),
        *((where, {"from": bad}, f"two: {name}: expected a from with ids by names in merged_from, got {shown}")
          for where, name, bad, shown in (({"node": 3}, "node 3", None, "None"), ({"link": 4}, "link 4", {}, "{}"),
                                          ({"node": 3}, "node 3", {"a": True}, "{'a': T"),
                                          ({"node": 3}, "node 3", {"z": 3}, "{'z': 3}"))),
        *((where, {"conflicts": bad}, f"two: {name}: expected conflicts with lists of .* by attribute, got ")
          for where, name, bad in (({}, "the map", 5), ({"node": 3}, "node 3", {"victim": 3}),
                                   ({"link": 4}, "link 4", {"victim": []}), ({}, "the map", {"victim": [3]}),
                                   ({}, "the map", {"conflicts": TOLD}), ({}, "the map", {"victim": [{"from": ["a"]}]}),
                                   ({}, "the map", {"victim": [{"from": [1], "value": 1}]}))),
    ],
)  # fmt: skip
def test_what_merging_could_not_have_written_is_refused(where, attributes, words):
    two = merge_maps([FIRST, SECOND], ["a", "b"]).map.with_attributes(attributes, **where)
    refused(words, merge_maps, [two, third()], ["two", "c"])


def test_conflicts_of_a_map_that_was_not_merged():
    told = FIRST.with_attributes({"conflicts": {"victim": TOLD}}, node=1)
    assert merged_of(told, SECOND).map.nodes[1].attributes["conflicts"] == {"victim": TOLD}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: merge_maps([FIRST]), "expected two maps or more, got 1"),
        (lambda: merge_maps([FIRST, SECOND], ["a"]), "expected a name for each of 2 maps"),
        (lambda: merge_maps([FIRST, SECOND], ["a", "a"]), "names of maps must differ, got 'a' more"),
        (lambda: merge_maps([FIRST, SECOND], min_common=0), "min_common must be an integer from 1"),
        (lambda: merge_maps([FIRST, {}]), "a map must be a jx.btm.BtmMap"),
        (lambda: merge_maps([FIRST.with_attributes({"from": 1}, node=0), SECOND]), 'expected no attribute "from"'),
        (
            lambda: merge_maps([FIRST, with_more(node(9, x=1e300))]),
            "1: node 9: expected places and lengths below 1000 km",
        ),
        (lambda: jx.btm.station([]), "expected one map or more, got none"),
        (lambda: Limits(angle_deg=-1), "angle_deg must be a number at least 0"),
    ],
)
def test_wrong_input(call, words):
    refused(words, call)


def saved(folder, btm):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "btm.json").write_text(json.dumps(json_form.to_json(btm)))


def test_a_map_has_one_name_however_its_path_is_typed(files, refuses, capsys, monkeypatch):
    saved(files / "one", FIRST)
    saved(files / "two", moved_map(SECOND, QUARTER))
    assert main(["merge-maps", "one/btm.json", "two/btm.json", "--out", "global.json"]) == 0
    assert json_form.read_btm("global.json").attributes["merged_from"] == ["one", "two"]
    monkeypatch.chdir(files / "two")
    capsys.readouterr()
    for again in ("btm.json", "../two/btm.json", str(files / "two" / "btm.json")):
        refuses(["merge-maps", "../global.json", again], "names of maps must differ, got 'two' more than once")
    saved(files / "other" / "one", moved_map(SECOND, QUARTER))
    both = ["../one/btm.json", "../other/one/btm.json"]
    said = '../one/btm.json and ../other/one/btm.json are both called "one": call them otherwise with --names'
    refuses(["merge-maps", *both], said)
    refuses(["merge-maps", *both, "--names", "a"], "--names: expected a name for each of 2 maps, got 1")
    assert main(["merge-maps", *both, "--names", "a", "b", "--out", "named.json"]) == 0
    assert json_form.read_btm("named.json").attributes["merged_from"] == ["a", "b"]


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, btm in (("a", FIRST), ("b", moved_map(SECOND, QUARTER)), ("c", corridor(4)), ("d", corridor(9))):
        (tmp_path / f"{name}.json").write_text(json.dumps(json_form.to_json(btm)))
    return tmp_path


def test_the_command_writes_one_map(files, capsys):
    assert main(["merge-maps", "a.json", "b.json", "--out", "global.json"]) == 0
    assert are_same(json_form.read_btm("global.json"), TOGETHER)
    out, err = capsys.readouterr()
    assert "| a        |     4 |     5 |             3 | merged |" in out
    assert "| together |     6 |     7 |" in out
    assert "victim is True in a and False in b" in out
    assert out.endswith("wrote global.json\n")
    assert err == ""
    assert main(["merge-maps", "a.json", "b.json"]) == 0
    assert main(["merge-maps", "a.json", "b.json", "--out", "global.json"]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["merge-maps", "b.json", "a.json", "--out", "global.json", "--overwrite"]) == 0
    assert json_form.read_btm("global.json").nodes[0].attributes["from"] == {"b": 0}


def test_the_command_refuses(files, capsys, refuses):
    assert main(["merge-maps", "a.json", "c.json", "--out", "global.json"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("jexplore: not enough in common: c ")
    assert err.count("\n") == 1
    assert not (files / "global.json").exists()
    assert main(["merge-maps", "a.json", "c.json", "--out", "global.json", "--partial"]) == 1
    out, err = capsys.readouterr()
    assert "wrote" not in out
    assert err.endswith("; nothing was written\n")
    assert not (files / "global.json").exists()
    assert main(["merge-maps", "a.json", "c.json", "b.json", "--out", "global.json", "--partial"]) == 1
    assert len(json_form.read_btm("global.json").nodes) == 6
    capsys.readouterr()
    for words, said in (
        (["a.json"], "expected files of two maps or more, got 1"),
        (["a.json", "./a.json"], "expected every map once, got ./a.json again"),
        (["a.json", "nothing.json"], "'nothing.json': there is no such file"),
        (["a.json", "b.json", "--out", "a.json", "--overwrite"], "is one of the maps"),
        (["a.json", "b.json", "--out", "no/global.json"], "there is no folder"),
        (["a.json", "b.json", "--out", "."], "must be a file, and is a folder"),
    ):
        refuses(["merge-maps", *words], said)


def passage():
    """A passage north over a slope; at its ends a T and a corner, whose further ways lead west to what differs."""
    return BtmMap(
        (node(0, "D", 0, 0), node(1, "F", 0, 7), node(2, "O", 0, 12, obstacle="slope"), node(3, "D", 0, 18),
         node(4, "F", -9, 18), node(5, "O", -15, 18, obstacle="stairs"), node(6, "F", -4, 0),
         node(7, "O", 0, 14.5, obstacle="slope"), node(8, "F", 0, 21)),
        (way(0, 0, 1, 90, length_m=7.0), way(1, 1, 2, 90, length_m=5.0), way(2, 2, 7, 90, length_m=2.5),
         way(3, 3, 4, 180, length_m=9.0), way(4, 4, 5, 180, length_m=6.0), way(5, 0, 6, 180, length_m=4.0),
         way(6, 7, 3, 90, length_m=3.5), way(7, 3, 8, 90, length_m=3.0), stub(8, 1, 0), stub(9, 1, 180)),
    )  # fmt: skip


def test_a_building_in_a_mirror_is_another_one():
    # Parts look the same in a mirror, once turned; beyond them ways leave otherwise.
    other = moved_map(mirrored(passage()), QUARTER)
    found = match_maps(passage(), other)
    assert found.outcome is Merging.AMBIGUOUS
    assert (len(found.contradictions), found.margin) == (2, 0.0)
    assert merged_of(passage(), other).left == ("b",)
    assert match_maps(passage(), moved_map(passage(), QUARTER)).outcome is Merging.MERGED
    end = passage()  # without what leads west nothing contradicts: these may be one building
    short = BtmMap((*end.nodes[:4], end.nodes[7]), tuple(end.links[i] for i in (0, 1, 2, 6, 8, 9)))
    assert match_maps(short, mirrored(short)).outcome is Merging.MERGED
