"""Maps laid out by the odometry along their links, and links that lead through a node: cases by pencil."""

import dataclasses
import math

import numpy as np
import pytest

from jexplore.config import InputError
from jexplore.tracemap.corrected import correct_map
from jexplore.tracemap.merging.rigid import apart_deg
from jexplore.tracemap.record import BtmMap, Link, Node
from jexplore.tracemap.repaired import repaired
from jexplore.tracemap.similarity import code

SQUARE = ((0, 0), (4, 0), (4, 4), (0, 4))


def a_map(places, ways, stubs=()):
    """Divergences at places, straight links between them, and un-searched links `(node, bearing)`.

    A way is `(start, end)` or `(start, end, moved)`; without, the odometry says what the places do.
    """
    nodes = [Node(i, float(x), float(y), "divergence") for i, (x, y) in enumerate(places)]
    links = []
    for start, end, *moved in ways:
        x, y = np.subtract(places[end], places[start]).astype(float)
        bearing = math.degrees(math.atan2(y, x))
        back = (bearing + 360) % 360 - 180
        attributes = {"moved": list(moved[0]) if moved else [x, y, 0.0]}
        length = {"length_m": math.hypot(x, y), "attributes": attributes}
        links.append(Link(len(links), start, end, "searched", bearing, back, **length))
    for node, bearing in stubs:
        links.append(Link(len(links), node, -1, "un-searched", bearing))
    return BtmMap(tuple(nodes), tuple(links), {"frame": "odom"})


def places(btm):
    return np.array([(node.x_m, node.y_m) for node in btm.nodes])


def ends(btm):
    return [(link.start, link.end) for link in btm.links]


# Places that fit the odometry


def test_what_the_last_link_of_a_square_lacks_every_link_takes_a_quarter_of():
    """The odometry is 0.4 m short on the way back: so says the last link alone; all places lie where it had them."""
    found = correct_map(a_map(SQUARE, [(0, 1), (1, 2), (2, 3), (3, 0, (0.0, -3.6))]))
    steps = np.diff(places(found), axis=0, append=[[0, 0]])
    assert found.attributes["frame"] == "map"
    np.testing.assert_allclose(places(found)[0], (0, 0), atol=1e-6)
    assert 3.6 < -steps[3, 1] < 3.95
    assert 3.6 < steps[1, 1] < 3.95
    assert steps.sum() == pytest.approx(0, abs=1e-4)


def test_bearings_turn_with_the_frames_of_their_nodes():
    line = a_map([(0, 0), (4, 0), (8, 0)], [(0, 1, (4.0, 0.0, 90.0)), (1, 2, (4.0, 0.0, 0.0))], [(2, 170.0)])
    found = correct_map(line)
    np.testing.assert_allclose(places(found), [(0, 0), (4, 0), (4, 4)], atol=1e-3)
    bearings = [link.start_bearing_deg for link in found.links]
    np.testing.assert_allclose(bearings, [0, 90, -100], atol=1e-2)
    np.testing.assert_allclose([link.end_bearing_deg for link in found.links[:2]], [-90, -90], atol=1e-2)
    assert found.links[2].end_bearing_deg is None


def test_a_corrected_map_corrected_again_stays_as_it_is():
    ways = [(0, 1, (4.0, 0.3, 8.0)), (1, 2, (0.1, 4.2, -5.0)), (3, 2, (4.1, 0.0)), (3, 0, (0.2, -3.6, 3.0)), (2, 2)]
    once = correct_map(a_map(SQUARE, ways, [(1, -30.0)]))
    assert max(abs(link.start_bearing_deg - was) for link, was in zip(once.links, (0, 90, 0, -90))) > 2
    again = correct_map(once)
    np.testing.assert_allclose(places(again), places(once), atol=1e-3)
    for one, other in zip(again.links, once.links):
        assert apart_deg(one.start_bearing_deg, other.start_bearing_deg) == pytest.approx(0, abs=0.02)
        if other.end >= 0:
            assert apart_deg(one.end_bearing_deg, other.end_bearing_deg) == pytest.approx(0, abs=0.02)
            np.testing.assert_allclose(one.attributes["moved"], other.attributes["moved"], atol=0.02)
            assert len(one.attributes["moved"]) == (2 if other.id == 2 else 3)


def test_moves_turn_with_the_frames_of_their_nodes():
    line = a_map([(0, 0), (4, 0), (8, 0)], [(0, 1, (4.0, 0.0, 90.0)), (1, 2, (4.0, 0.0, 30.0))])
    found = correct_map(line)
    np.testing.assert_allclose(found.links[0].attributes["moved"], [4, 0, 0], atol=1e-2)
    np.testing.assert_allclose(found.links[1].attributes["moved"], [0, 4, 0], atol=1e-2)


def test_a_map_that_nothing_contradicts_keeps_its_places_and_bearings():
    square = a_map(SQUARE, [(0, 1), (1, 2), (2, 3), (3, 0)], [(0, -90.0)])
    found = correct_map(square)
    np.testing.assert_allclose(places(found), SQUARE, atol=1e-4)
    for one, other in zip(found.links, square.links):
        assert apart_deg(one.start_bearing_deg, other.start_bearing_deg) == pytest.approx(0, abs=1e-3)


def test_a_map_without_searched_links_has_nothing_to_correct():
    found = correct_map(a_map([(1, 2)], [], [(0, 30.0)]))
    np.testing.assert_allclose(places(found), [(1, 2)], atol=1e-6)
    assert found.links[0].start_bearing_deg == pytest.approx(30)
    assert correct_map(BtmMap((), ())) == BtmMap((), (), {"frame": "map"})


@pytest.mark.parametrize(
    ("moved", "line"),
    [
        (None, "to correct a map its links must have the attribute moved"),
        ([1.0], r"link 0: the attribute moved must be \[x_m, y_m\]"),
        ("far", r"link 0: the attribute moved must be \[x_m, y_m\]"),
        ([1.0, True], r"link 0: the attribute moved must be \[x_m, y_m\]"),
    ],
)
def test_a_map_without_moves_is_refused(moved, line):
    attributes = {} if moved is None else {"moved": moved}
    line_map = a_map([(0, 0), (4, 0)], [(0, 1)])
    broken = dataclasses.replace(line_map, links=(dataclasses.replace(line_map.links[0], attributes=attributes),))
    with pytest.raises(InputError, match=line) as error:
        correct_map(broken)
    assert "\n" not in str(error.value)


# Links that lead through a node

ROW = ((0, 0), (6, 0), (14, 0))


def test_a_link_past_a_node_goes_where_known_links_lead_on():
    """0 to 2 in one, though 1 lies on the way; links both ways about."""
    for ways in ([(0, 1), (1, 2), (0, 2)], [(1, 0), (2, 1), (0, 2)], [(0, 2), (2, 1), (0, 1)]):
        found = repaired(a_map(ROW, ways))
        assert {frozenset(pair) for pair in ends(found.map)} == {frozenset((0, 1)), frozenset((1, 2))}
        assert (found.closings, found.contradicted, found.left) == (0, 1, 0)


def test_a_link_past_a_node_begins_at_its_un_searched_opening():
    found = repaired(a_map(ROW, [(0, 1), (0, 2)], [(1, 90.0), (1, 10.0)]))
    assert found[1:] == (0, 1, 0)
    assert ends(found.map) == [(0, 1), (1, -1), (1, 2)]
    begun = found.map.links[2]
    assert (begun.id, begun.status, begun.start_bearing_deg, begun.end_bearing_deg) == (3, "searched", 10, -180)
    assert begun.length_m == pytest.approx(8)
    assert begun.attributes["moved"] == pytest.approx([8, 0, 0])


def test_a_place_that_is_there_twice_is_one():
    """Nodes 1 and 3: what one has searched the other has not; node 3 has a frame of its own, turned by 90 degrees."""
    double = a_map([*ROW, (6.3, 0.2), (6, 9)], [(0, 1), (0, 3, (6.3, 0.2, 90.0)), (1, 2)], [(1, 90.0)])
    north = Link(9, 3, 4, "searched", 0.0, -90.0, length_m=9.0, attributes={"moved": [9.0, 0.0, -90.0]})
    east, to_3 = Link(10, 3, -1, "un-searched", -90.0), dataclasses.replace(double.links[1], end_bearing_deg=90.0)
    double = dataclasses.replace(double, links=(double.links[0], to_3, *double.links[2:], north, east))
    found = repaired(double)
    assert found[1:] == (0, 1, 0)
    assert [node.id for node in found.map.nodes] == [0, 1, 2, 4]
    assert ends(found.map) == [(0, 1), (1, 2), (1, 4)]
    joined = found.map.links[2]
    assert joined.start_bearing_deg == pytest.approx(90)
    assert joined.attributes["moved"] == pytest.approx([0, 9, 0], abs=1e-6)
    assert repaired(found.map).map == found.map


def test_two_places_of_two_types_are_two():
    double = a_map([*ROW, (6.3, 0.2)], [(0, 1), (0, 3), (1, 2)])
    other = dataclasses.replace(double.nodes[3], type="terminal")
    double = dataclasses.replace(double, nodes=(*double.nodes[:3], other))
    assert repaired(double) == (double, 0, 0, 1)


def test_a_link_that_is_there_twice_is_one():
    found = repaired(a_map(ROW, [(0, 1), (1, 2), (1, 0)]))
    assert ends(found.map) == [(0, 1), (1, 2)]
    assert found.contradicted == 1


def test_a_link_may_lead_past_two_nodes():
    found = repaired(a_map([*ROW, (20, 3)], [(0, 1), (1, 2), (2, 3), (0, 3)]))
    assert ends(found.map) == [(0, 1), (1, 2), (2, 3)]


def test_frames_that_are_turned_are_counted_in():
    """Node 1 has its own frame turned by 90 degrees; what it says of the way on is said in that."""
    ways = [(0, 1, (6.0, 0.0, 90.0)), (1, 2, (0.0, -8.0, -90.0)), (0, 2)]
    assert repaired(a_map(ROW, ways)).contradicted == 1
    assert repaired(a_map(ROW, [(0, 1, (6.0, 0.0, 90.0)), (1, 2, (8.0, 0.0, 0.0)), (0, 2)])).contradicted == 0


@pytest.mark.parametrize(
    ("there", "ways", "stubs", "left"),
    [
        (ROW, [(0, 1), (0, 2)], [], 1),  # nothing leads on
        (ROW, [(0, 1), (0, 2)], [(1, 90.0)], 1),  # nor there
        (((0, 0), (6, 0), (6, 8)), [(0, 1), (1, 2), (0, 2)], [], 0),  # 53 degrees apart: two openings
        (((0, 0), (6, 0), (6, 9), (14, 9), (14, 0)), [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4)], [], 1),  # a longer way
    ],
)
def test_what_nothing_explains_stays_and_is_counted(there, ways, stubs, left):
    before = a_map(there, ways, stubs)
    found = repaired(before)
    assert found.map == before
    assert (found.contradicted, found.left) == (0, left)


def test_a_sound_map_stays_and_its_ways_round_are_counted():
    eight = a_map([*SQUARE, (8, 0), (8, 4)], [(0, 1), (1, 2), (2, 3), (3, 0), (1, 4), (4, 5), (5, 2)])
    found = repaired(eight)
    assert found.map == eight
    assert found[1:] == (2, 0, 0)
    assert repaired(BtmMap((), ()))[1:] == (0, 0, 0)
    plain = dataclasses.replace(eight, links=tuple(dataclasses.replace(link, attributes={}) for link in eight.links))
    assert repaired(plain).map == plain


def test_repairing_twice_is_repairing_once():
    once = repaired(a_map(ROW, [(0, 1), (1, 2), (0, 2)])).map
    assert repaired(once).map == once
    assert code(once) == code(a_map(ROW, [(0, 1), (1, 2)]))
