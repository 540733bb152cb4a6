"""Maps laid out by the odometry along their links, and links that lead through a node: cases by pencil."""

import dataclasses
import math

import numpy as np
import pytest

from jexplore.config import InputError
from jexplore.tracemap.corrected import correct_map
from jexplore.tracemap.merging.rigid import apart_deg
from jexplore.tracemap.record import BtmMap, Link, Node
from jexplore.tracemap.repairing.repaired import repaired

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


@pytest.mark.jit
def test_what_the_last_link_of_a_square_lacks_every_link_takes_a_quarter_of():
    """The odometry is 0.4 m short on the way back: so says the last link alone; all places lie where it had them."""
    found = correct_map(a_map(SQUARE, [(0, 1), (1, 2), (2, 3), (3, 0, (0.0, -3.6))]))
    steps = np.diff(places(found), axis=0, append=[[0, 0]])
    assert found.attributes["frame"] == "map"
    np.testing.assert_allclose(places(found)[0], (0, 0), atol=1e-6)
    assert 3.6 < -steps[3, 1] < 3.95
    assert 3.6 < steps[1, 1] < 3.95
    assert steps.sum() == pytest.approx(0, abs=1e-4)


@pytest.mark.jit
def test_bearings_turn_with_the_frames_of_their_nodes():
    line = a_map([(0, 0), (4, 0), (8, 0)], [(0, 1, (4.0, 0.0, 90.0)), (1, 2, (4.0, 0.0, 0.0))], [(2, 170.0)])
    found = correct_map(line)
    np.testing.assert_allclose(places(found), [(0, 0), (4, 0), (4, 4)], atol=1e-3)
    np.testing.assert_allclose([one.attributes["moved"] for one in found.links[:2]], [[4, 0, 0], [0, 4, 0]], atol=0.02)
    bearings = [*(link.start_bearing_deg for link in found.links), *(link.end_bearing_deg for link in found.links[:2])]
    assert all(0 <= bearing < 360 for bearing in bearings)
    off = [apart_deg(bearing, wanted) for bearing, wanted in zip(bearings, (0, 90, 260, 270, 270))]
    np.testing.assert_allclose(off, 0, atol=1e-2)
    assert found.links[2].end_bearing_deg is None


@pytest.mark.jit
def test_a_corrected_map_corrected_again_stays_as_it_is():
    ways = [(0, 1, (4.0, 0.3, 8.0)), (1, 2, (0.1, 4.2, -5.0)), (3, 2, (4.1, 0.0)), (3, 0, (0.2, -3.6, 3.0)), (2, 2)]
    once = correct_map(a_map(SQUARE, ways, [(1, -30.0)]))
    assert max(abs(apart_deg(link.start_bearing_deg, was)) for link, was in zip(once.links, (0, 90, 0, -90))) > 2
    again = correct_map(once)
    np.testing.assert_allclose(places(again), places(once), atol=1e-3)
    for one, other in zip(again.links, once.links):
        assert apart_deg(one.start_bearing_deg, other.start_bearing_deg) == pytest.approx(0, abs=0.02)
        if other.end >= 0:
            assert apart_deg(one.end_bearing_deg, other.end_bearing_deg) == pytest.approx(0, abs=0.02)
            np.testing.assert_allclose(one.attributes["moved"], other.attributes["moved"], atol=0.02)
            assert len(one.attributes["moved"]) == (2 if other.id == 2 else 3)


@pytest.mark.jit
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
    """0 to 2 in one, though 1 lies on the way; links both ways about. Or past two nodes."""
    assert ends(repaired(a_map([*ROW, (20, 3)], [(0, 1), (1, 2), (2, 3), (0, 3)])).map) == [(0, 1), (1, 2), (2, 3)]
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


# Duplicates


def a_link(number, start, end, bearing, back, length_m, *moved):
    return Link(number, start, end, "searched", bearing, back, length_m=length_m, attributes={"moved": list(moved)})


def test_a_link_on_which_the_robot_turned_back_goes():
    """It has left node 1 northwards and come back by the same opening, dropped if another link leaves by it."""
    line = a_map(ROW, [(0, 1), (1, 2)])
    back = a_link(5, 1, 1, 90.0, 95.0, 6.0, 0.4, -0.3, 2.0)
    found = repaired(dataclasses.replace(line, links=(*line.links, back)))
    assert (ends(found.map), found.contradicted) == ([(0, 1), (1, 2), (1, -1)], 1)
    assert found.map.links[2].start_bearing_deg == 90
    east = dataclasses.replace(back, start_bearing_deg=-5.0, end_bearing_deg=8.0)
    assert repaired(dataclasses.replace(line, links=(*line.links, east))).map == line


@pytest.mark.parametrize(
    ("change", "goes"),
    [
        ({"end_bearing_deg": 130.0}, False),  # a way round, 6 m
        ({"end_bearing_deg": 130.0, "length_m": 2.5}, True),
        ({"end_bearing_deg": 170.0}, True),  # it ends by the opening of another link
        ({"end_bearing_deg": 170.0, "attributes": {"moved": [3.0, 0.0, 0.0]}}, False),
    ],
)
def test_which_links_lead_back_to_their_node(change, goes):
    line = a_map(ROW, [(0, 1), (1, 2)])
    back = dataclasses.replace(a_link(5, 1, 1, 90.0, 95.0, 6.0, 0.4, -0.3, 2.0), **change)
    ring = dataclasses.replace(line, links=(*line.links, back))
    assert ((1, 1) not in ends(repaired(ring).map)) == goes


def test_a_node_to_which_the_robot_turned_back_is_the_one_that_it_left():
    """Node 3 is node 1, its frame turned by 20 degrees: what leads north there bears 70."""
    line = a_map([*ROW, (6.4, 0.3), (6, 9)], [(0, 1), (1, 2)])
    back, north = a_link(5, 1, 3, 90.0, 75.0, 6.0, 0.4, 0.3, 20.0), a_link(6, 3, 4, 70.0, -90.0, 9.0, 3.1, 8.5, -20.0)
    east = Link(7, 3, -1, "un-searched", -15.0)
    found = repaired(dataclasses.replace(line, links=(*line.links, back, north, east)))
    assert ends(found.map) == [(0, 1), (1, 2), (1, 4)]
    assert found.map.links[2].start_bearing_deg == pytest.approx(90)
    np.testing.assert_allclose(found.map.links[2].attributes["moved"], [0, 9, 0], atol=0.1)
    assert [node.id for node in found.map.nodes] == [0, 1, 2, 4]


@pytest.mark.parametrize(
    ("gap_m", "is_linked"),
    [
        (3.0, True),
        (3.0, False),  # nobody has gone the short way yet
        (1.8, True),  # that says how far apart they lie
    ],
)
def test_two_junctions_that_a_long_way_joins_are_two(gap_m, is_linked):
    """It leaves both of them eastwards and turns after 13 m."""
    row, long = [(0, -5), (0, 0), (0, gap_m), (0, gap_m + 5)], [(13, 0), (13, gap_m)]
    for ways in ([(1, 2, *long), (2, 1)], [(1, 2), (2, 1, *long[::-1])]):
        short = () if is_linked else ((1, 90.0), (2, -90.0))
        ways = [way for way in ways if len(way) > 2 or is_linked]
        both = a_bent_map(row, (0, 1), *ways, (2, 3), stubs=short)
        assert repaired(both).map == both


def test_a_way_that_was_followed_from_both_ends_is_one():
    """Each link begins by the opening that it was seen to leave, and ends by one that it does not."""
    links = a_link(0, 0, 1, 0.0, -90.0, 6.2, 6.0, 0.0, 0.0), a_link(1, 1, 0, 180.0, 90.0, 6.0, -6.2, 0.3, 0.0)
    found = repaired(dataclasses.replace(a_map(ROW[:2], []), links=links))
    assert ends(found.map) == [(0, 1)]
    assert (found.map.links[0].start_bearing_deg, found.map.links[0].end_bearing_deg) == (0, 180)
    assert found[1:] == (0, 1, 0)


@pytest.mark.parametrize(
    "change",
    [
        {"start": 0, "end": 1, "attributes": {"moved": [6.0, 0.0, 0.0]}},  # both lead the same way about
        {"length_m": 8.0},
        {"attributes": {"moved": [-6.0, 1.5, 0.0]}},
    ],
)
def test_two_ways_between_two_nodes_are_two(change):
    first = a_link(0, 0, 1, 60.0, 120.0, 6.2, 6.0, 0.0, 0.0)
    second = dataclasses.replace(a_link(1, 1, 0, -120.0, -60.0, 6.0, -6.0, 0.0, 0.0), **change)
    ring = dataclasses.replace(a_map(ROW[:2], []), links=(first, second))
    assert repaired(ring).map == ring


def a_bent(number, start, end, *corners):
    """A link along straight pieces from one place to another."""
    corners = np.array(corners, float)
    pieces = np.diff(corners, axis=0)
    there, back = (math.degrees(math.atan2(y, x)) for x, y in (pieces[0], -pieces[-1]))
    moved = (corners[-1] - corners[0]).tolist()
    return a_link(number, start, end, there, back, float(np.hypot(*pieces.T).sum()), *moved, 0.0)


def a_bent_map(places_, *ways, stubs=()):
    """Divergences at places, links that lead by corners: `(start, end, corner, ...)`; un-searched `(node, bearing)`."""
    plain = a_map(places_, [], stubs)
    stubs_ = [dataclasses.replace(link, id=100 + link.id) for link in plain.links]
    links = [a_bent(i, a, b, places_[a], *by, places_[b]) for i, (a, b, *by) in enumerate(ways)]
    return dataclasses.replace(plain, links=(*links, *stubs_))


@pytest.mark.parametrize(
    ("length_m", "out", "aside_m"),
    [
        (30, 0, 3),  # a ring 30 m long and 6 m wide, a junction in the middle of either short side: 36 m for 30
        (16, 0, 1.5),
        (10, 1, 1),  # an eye: both arms leave at 45 degrees
        (20, 1, 1),  # each is 20.8 m long: as good as straight
    ],
)
def test_two_arms_that_are_long_and_narrow_are_two_ways(length_m, out, aside_m):
    a, b = (0, 0), (length_m, 0)
    north, south = [(out, aside_m), (length_m - out, aside_m)], [(length_m - out, -aside_m), (out, -aside_m)]
    row = [a, b, (-5, 0), (length_m + 5, 0)]
    ring = a_bent_map(row, (2, 0), (0, 1, *north), (1, 0, *south), (1, 3))
    assert repaired(ring).map == ring


@pytest.mark.parametrize(
    "block",
    [
        # each way leaves along a long side, toward the other junction, and comes in by a short one: 17 m for 14.3
        a_bent_map([(-5, 0), (0, 0), (14, 3), (19, 3)], (0, 1), (1, 2, (14, 0)), (2, 1, (0, 3)), (2, 3)),
        # along the farther sides of a block: it goes on as if straight, but comes in by the short side
        *(
            a_bent_map(
                [(-5, 0), (0, 0), (x, 0), (x, y), (x + 5, y), (x, -5)],
                *((0, 1), (1, 2), (2, 3), (3, 1, (0, y)), (3, 4), (2, 5)),
            )
            for x, y in ((14, 3), (30, 6))
        ),
        # two halves of a ring: as long as each other, but not straight: 9.4 m for 6
        dataclasses.replace(
            a_map(ROW[:2], []),
            links=(a_link(0, 0, 1, 90, 90, 9.4, 6.0, 0.0, 0.0), a_link(1, 1, 0, -90, -90, 9.4, -6.0, 0.0, 0.0)),
        ),
    ],
)
def test_ways_round_a_block_are_two(block):
    assert repaired(block).map == block


WEST_OF = ((14, 0), (6, 0), (6, -9), (0, 0), (0, -9))
"""Node 1 was made from node 0; the robot comes to it from node 3 in the west."""


def test_an_opening_toward_a_place_to_which_another_one_leads_has_not_been_searched():
    """From 4 the robot came 9 m west and 2 m south, by the opening in the north; what waits eastwards is another."""
    row = [(-5, 0), (0, 0), (0, -8), (9, -8), (9, 2), (14, 2)]
    round_ = a_bent_map(row, (0, 1), (1, 2), (2, 3), (3, 4), (4, 1, (0, 2)), (4, 5), stubs=[(1, -10.0)])
    assert repaired(round_).map == round_


def coming(back_deg, *stubs, length_m=6.0):
    line = a_map(WEST_OF, [(0, 1), (1, 2), (2, 4), (4, 3), (3, 1)], stubs)
    wrong = dataclasses.replace(line.links[4], end_bearing_deg=back_deg, length_m=length_m)
    return dataclasses.replace(line, links=(*line.links[:4], wrong, *line.links[5:]))


@pytest.mark.parametrize(
    ("back_deg", "stub_deg", "length_m", "mended"),
    [
        (-80.0, 170.0, 6.0, True),  # it says that it came by the opening of the link south, one in the west waits
        (-80.0, 170.0, 9.0, True),
        (60.0, 170.0, 6.0, True),  # by none that there was
        (60.0, 170.0, 9.0, False),  # and round a corner: there may be one
        (-80.0, 100.0, 6.0, False),  # what waits lies elsewhere
        (-140.0, 170.0, 6.0, False),  # it came by one that lies toward where it came from
    ],
)
def test_a_link_ends_by_the_opening_toward_which_it_came(back_deg, stub_deg, length_m, mended):
    before = coming(back_deg, (1, stub_deg), length_m=length_m)
    found = repaired(before)
    assert found.contradicted == mended
    assert (found.map.links[4].end_bearing_deg == stub_deg) == mended
    assert ((1, -1) in ends(found.map)) != mended


def test_the_way_by_which_a_node_was_made_ends_where_it_did():
    line = a_map(ROW, [(0, 1), (1, 2)], [(1, 170.0)])
    line = dataclasses.replace(line, links=(dataclasses.replace(line.links[0], end_bearing_deg=60.0), *line.links[1:]))
    assert repaired(line).map == line


def test_a_link_past_a_node_begins_where_the_next_one_comes_in_once_that_has_the_right_end():
    """2 to 3 leads through 1; 0 to 1 ends by a wrong opening, or that would have been seen."""
    places_ = ((0, 9), (0, 0), (6, 0), (0, -8))
    ways = [(0, 2), (2, 1), (1, 3), (0, 1), (0, 3)]
    line = a_map(places_, ways)
    own = {i: dataclasses.replace(line.links[i], id=i) for i in range(5)}
    own[3] = dataclasses.replace(own[3], end_bearing_deg=150.0)
    own[4] = dataclasses.replace(own[4], start=3, end=0, start_bearing_deg=90.0, end_bearing_deg=-45.0)
    own[4] = dataclasses.replace(own[4], attributes={"moved": [0.0, 17.0, 0.0]})
    found = repaired(dataclasses.replace(line, links=tuple(own.values())))
    assert sorted(map(sorted, ends(found.map))) == [[0, 1], [0, 2], [1, 2], [1, 3]]


# Hypotheses that the next nodes decide: three pairs or more that are one


def a_chain(shift, *, last=(20, 1), link=True, wait=4):
    """Nodes 1 to 3 in a row behind 0, and nodes 4 to 6, `shift` from them, to which the robot came back by 7 and 8.

    `wait` of 1, 4, 2 and 5 have an opening southwards.
    """
    row = [(6, 0), (12, 0), (18, 0)]
    again = [(x + shift[0], y + shift[1]) for x, y in row[:2]] + [last]
    ways = [(0, 1), (1, 2), (2, 3), (3, 7), (7, 8), (8, 6), (6, 5), (5, 4)]
    stubs = [(3, 10.0), (6, 90.0), (4, 180.0), *((node, -90.0) for node in (1, 4, 2, 5)[:wait])]
    return a_map([(0, 0), *row, *again, (18, 9), (30, 3)], ways[: 8 if link else 7], stubs)


def test_three_nodes_that_are_there_twice_are_three():
    found = repaired(a_chain((2.0, 1.0)))
    assert [node.id for node in found.map.nodes] == [0, 1, 2, 3, 7, 8]
    known = sorted(sorted(pair) for pair in ends(found.map) if pair[1] >= 0)
    assert known == [[0, 1], [1, 2], [2, 3], [3, 7], [3, 8], [7, 8]]
    assert [pair for pair in ends(found.map) if pair[1] < 0] == [(1, -1), (2, -1)]


def test_a_row_of_equal_places_beside_another_is_one_of_its_own():
    """As before, but a passage of 4 m leads from one row to the other: they lie as far apart as it is long."""
    row = [(6, 0), (12, 0), (18, 0), (6, 3), (12, 3), (18, 3)]
    rows = a_map(row, [(0, 1), (1, 2), (3, 4), (4, 5), (2, 5)])
    assert repaired(rows).map == rows
    whole = a_map(row, [(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (2, 5), (1, 4)])
    assert repaired(whole).map == whole


SOUTHERN = a_chain((2.0, 1.0))


@pytest.mark.parametrize(
    "chain",
    [
        dataclasses.replace(
            SOUTHERN,
            nodes=tuple(  # a type that differs contradicts all
                dataclasses.replace(n, type="terminal") if n.id == 4 else n for n in SOUTHERN.nodes
            ),
        ),
        a_chain((2.0, 1.0), link=False),  # two pairs only
        a_chain((2.0, 1.0), wait=2),  # one of three has two openings, as any place in a passage
        a_chain((2.0, 4.0), last=(20, 4)),  # 4.5 m off
        a_chain((2.0, 1.0), last=(23, 1)),  # one is 9 m from the next, not 6
    ],
)
def test_nodes_that_are_not_three_alike_stay(chain):
    assert repaired(chain).map == chain


@pytest.mark.parametrize("gap_m", [2.5, 3.5])
def test_slopes_in_two_passages_side_by_side_are_two_rows(gap_m):
    """Three slopes in each, between two junctions: as long a way in both, 60 m round."""
    north, south = [(x, gap_m) for x in (5, 10, 15)], [(x, 0) for x in (5, 10, 15)]
    west, east = (-8, gap_m / 2), (28, gap_m / 2)
    row = [west, *south, *north, east, (-13, gap_m / 2), (35, gap_m / 2)]
    ways = [(8, 0), (0, 1, (-8, 0)), (1, 2), (2, 3), (3, 7, (28, 0)), (7, 6, (28, gap_m)), (6, 5), (5, 4)]
    rows = a_bent_map(row, *ways, (4, 0, (-8, gap_m)), (7, 9))
    slopes = [dataclasses.replace(n, type="obstacle", obstacle="slope") if 0 < n.id < 7 else n for n in rows.nodes]
    rows = dataclasses.replace(rows, nodes=tuple(slopes))
    assert repaired(rows).map == rows


# Ways that are longer than the passage, and two nodes each of which knows the next but one


def test_a_known_link_on_which_the_robot_went_up_and_down_explains_one():
    """From 1 to 2 it once took 12 m for 8; what leads from 0 to 2 ends by the opening of that link."""
    row = a_map([*ROW, (14, 9)], [(0, 1), (1, 2), (0, 2), (2, 3)])
    longer = dataclasses.replace(row.links[1], length_m=12.0)
    row = dataclasses.replace(row, links=(row.links[0], longer, *row.links[2:]))
    assert ends(repaired(row).map) == [(0, 1), (1, 2), (2, 3)]
    aside = dataclasses.replace(row.links[2], end_bearing_deg=-90.0)
    row = dataclasses.replace(row, links=(*row.links[:2], aside, row.links[3]))
    assert repaired(row).contradicted == 0


def test_two_links_that_lead_past_each_others_ends_are_three():
    """0 to 2 leads past 1, 1 to 3 past 2: what lies between 1 and 2 has no link."""
    row = a_map([(0, 0), (6, 0), (16, 0), (24, 0)], [(0, 1), (0, 2), (1, 3), (2, 3)])
    found = repaired(row)
    assert sorted(map(sorted, ends(found.map))) == [[0, 1], [1, 2], [2, 3]]
    assert (found.contradicted, found.left) == (1, 0)
    between = next(link for link in found.map.links if {link.start, link.end} == {1, 2})
    assert between.length_m == pytest.approx(10)
    assert between.attributes["moved"][:2] == pytest.approx([10, 0])


@pytest.mark.parametrize(("length_m", "mended"), [(15.0, True), (10.5, False), (19.0, False)])
def test_a_link_on_which_the_robot_turned_back_and_strayed_has_not_been_searched(length_m, mended):
    """It left 0 northwards, turned back, went by 0 unseen and came to 1; later it came from 2 in the north past 0."""
    line = a_map([(0, 0), (10, 0), (0, 8)], [(0, 1)])
    strayed = a_link(1, 0, 1, 90.0, 180.0, length_m, 10.0, 0.3, 0.0)
    past = a_link(2, 2, 1, -90.0, 178.0, 18.0, 10.0, -8.0, 0.0)
    found = repaired(dataclasses.replace(line, links=(*line.links, strayed, past)))
    assert (sorted(map(sorted, ends(found.map))) == [[0, 1], [0, 2]]) == mended
