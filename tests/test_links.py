"""Which known node a place is by its ways, where the odometry is off: cases one can check with a pencil."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jexplore import btm
from jexplore.driving import links, mapping
from jexplore.driving.sensing.openings import Openings

EAST, NORTH, WEST, SOUTH = (math.radians(a) for a in (0, 90, 180, 270))


def place(*bearings):
    """Openings that bear so, the others unused."""
    n, flat = len(bearings), jnp.zeros(8)
    bearing = jnp.zeros(8).at[:n].set(jnp.array(bearings, float))
    return Openings(bearing, jnp.zeros((8, 2)), flat, flat, jnp.arange(8) < n, jnp.int32(0))


def a_writer(*nodes, sure_m=0.0, link=None):
    """A robot that has started at (-50, 0) with these divergences in its map: `((x, y), searched, un-searched)`.

    Searched links lead to node 0; it follows `link`, or one that nobody has followed.
    """
    start = jnp.array([-50.0, 0.0, 0.0])
    writer = mapping.begin(mapping.LEAN_STEPS, 8, 16, start, False)
    map_ = writer.map
    for (x, y), searched, waiting in nodes:
        map_, node = btm.add_node(map_, btm.DIVERGENCE, x, y, radius_m=1.0)
        for bearing in searched:
            map_, own = btm.add_link(map_, node, bearing)
            map_ = btm.end_link(map_, own, 0, 0.0, length_m=10.0)
        for bearing in waiting:
            map_, _ = btm.add_link(map_, node, bearing)
    return writer.replace(map=map_, sure_m=jnp.float32(sure_m), link=jnp.int32(0 if link is None else link))


def recognised(writer, centre, found, back, odometer_m=100.0, when=True):
    at = jnp.array(centre, float), jnp.float32(odometer_m)
    node, there = links.recognised(writer, at, found, jnp.float32(back), jnp.float32(1.0), jnp.bool_(when))
    return int(node) if bool(there) else None


T = ((0.0, 0.0), (NORTH, SOUTH), (EAST,))  # node 1: the way east waits


@pytest.mark.parametrize(
    ("openings_deg", "turn_deg", "spread_deg"),
    [
        ((80, 260, -10), 10, 0),  # all ten degrees to the right of what the map says
        ((90, 270, 0), 0, 0),
        ((83, 263, -1), 5, 4),  # 7, 7 and 1
        ((83, 263), 7, math.inf),  # a link has no opening
        ((83, 263, -7, 180), 7, math.inf),  # an opening has no link
        ((83, 263, -25), 7, math.inf),  # or lies too far off
    ],
)
def test_how_a_place_is_turned_and_how_well_its_ways_agree(openings_deg, turn_deg, spread_deg):
    turn, spread = links.turn_to(a_writer(T).map, jnp.int32(1), place(*np.radians(openings_deg)))
    assert math.degrees(turn) == pytest.approx(turn_deg, abs=1e-3)
    assert math.degrees(spread) == pytest.approx(spread_deg, abs=1e-3)


def test_how_a_node_lies_is_said_in_the_frame_of_the_last_one():
    """What the odometry calls north is west there; the new one is turned by 20 degrees less."""
    writer = a_writer().replace(origin=jnp.array([1.0, 2.0, math.radians(90)]))
    found = mapping.moved(writer, jnp.array([1.0, 5.0]), math.radians(20))
    np.testing.assert_allclose(found, [-3, 0, math.radians(70)], atol=1e-6)
    assert np.isnan(mapping.moved(writer, jnp.array([1.0, 5.0]), math.nan)[2])


def test_a_place_with_the_ways_of_a_node_that_waits_there_is_that_node():
    assert recognised(a_writer(T), (2.0, 0.0), place(NORTH, SOUTH, EAST), EAST) == 1
    assert recognised(a_writer(T), (2.0, 0.0), place(NORTH, SOUTH, EAST), EAST, when=False) is None


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ((SOUTH, EAST), None),  # one is not seen
        ((NORTH, SOUTH, EAST, WEST), None),  # one is new
        ((EAST, NORTH + 0.6, SOUTH - 0.6), 1),  # 34 degrees off each
        ((EAST, NORTH + 0.8, SOUTH - 0.8), None),
    ],
)
def test_it_has_the_very_ways(found, expected):
    assert recognised(a_writer(T), (2.0, 0.0), place(*found), EAST) == expected


def test_the_way_by_which_the_robot_comes_must_wait_there():
    assert recognised(a_writer(T), (2.0, 0.0), place(NORTH, SOUTH, EAST), NORTH) is None
    done = ((0.0, 0.0), (NORTH, SOUTH, EAST), ())
    assert recognised(a_writer(done), (2.0, 0.0), place(NORTH, SOUTH, EAST), EAST) is None


@pytest.mark.parametrize(
    ("off_m", "sure_m", "there"), [(1.9, 60.0, True), (2.1, 60.0, False), (3.4, -400, True), (3.6, -400, False)]
)
def test_how_far_it_may_seem_off_grows_with_the_way(off_m, sure_m, there):
    """1 m, and 2.5 % of the way since the odometry was put right, 2.5 m at most."""
    found = recognised(a_writer(T, sure_m=sure_m), (off_m, 0.0), place(NORTH, SOUTH, EAST), EAST)
    assert (found == 1) == there


def test_where_another_node_is_nearly_as_near_it_is_neither():
    far, near = ((4.0, 0.0), *T[1:]), ((3.0, 0.0), *T[1:])
    ways = place(NORTH, SOUTH, EAST)
    assert recognised(a_writer(T, far), (1.2, 0.0), ways, EAST) == 1  # 1.2 and 2.8 m
    assert recognised(a_writer(T, near), (1.4, 0.0), ways, EAST) is None  # 1.4 and 1.6 m
    other = ((1.5, 0.0), (NORTH, WEST), (SOUTH,))  # another place, but in the way
    assert recognised(a_writer(T, other), (2.0, 0.0), ways, EAST) is None


def test_where_a_known_link_leads_nothing_needs_to_wait():
    """The robot has left node 0 by the link between it and node 1, and has gone 20 m: 1 m, and 5 %."""
    writer = a_writer(((0.0, 0.0), (WEST, NORTH, EAST), ()), sure_m=100.0, link=1)
    writer = writer.replace(node=jnp.int32(0), node_m=jnp.float32(80.0))
    ways = place(WEST, NORTH, EAST)
    assert recognised(writer, (1.9, 0.0), ways, WEST) == 1
    assert recognised(writer, (2.1, 0.0), ways, WEST) is None
    assert recognised(writer, (1.9, 0.0), place(SOUTH), SOUTH) is None


def test_the_ends_of_a_node_are_those_of_its_links():
    map_ = a_writer(T, ((9.0, 0.0), (WEST,), (SOUTH,))).map
    own, bearing = links.ends_at(map_, jnp.int32(1))
    assert np.degrees(np.sort(np.asarray(bearing)[np.asarray(own)])).round().tolist() == [-90, 0, 90]
    link, out, off = links.toward(map_, jnp.int32(1), jnp.float32(math.radians(70)))
    assert map_.start_bearing[link] == pytest.approx(NORTH)
    assert [float(out), float(off)] == pytest.approx([NORTH, math.radians(20)])
