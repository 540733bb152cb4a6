"""Matching of known nodes by their exits with a drifting odometry: cases one can check with a pencil."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.runs import place

from jexplore import btm
from jexplore.driving import links, mapping

pytestmark = pytest.mark.jit
EAST, NORTH, WEST, SOUTH = (math.radians(a) for a in (0, 90, 180, 270))
MATCH, TURN_TO = jax.jit(links.match_node), jax.jit(links.turn_to)


def a_writer(*nodes, link=None):
    """A robot that has started at (-50, 0) with these divergences in its map: `((x, y), searched, un-searched)`.

    Searched links lead straight to node 0; it follows `link`, or one that nobody has followed.
    """
    start = jnp.array([-50.0, 0.0, 0.0])
    writer = mapping.begin_map(mapping.SLOPE_STEPS, 8, 16, start, False)
    map_ = writer.map
    for (x, y), searched, waiting in nodes:
        map_, node = btm.add_node(map_, btm.DIVERGENCE, x, y, radius_m=1.0)
        for bearing in searched:
            map_, own = btm.add_link(map_, node, bearing)
            way = {"moved_x_m": -50 - x, "moved_y_m": -y, "turned": 0.0}
            map_ = btm.end_link(map_, own, 0, 0.0, length_m=10.0, **way)
        for bearing in waiting:
            map_, _ = btm.add_link(map_, node, bearing)
    return writer.replace(map=map_, link=jnp.int32(0 if link is None else link))


def recognised(writer, centre, found, back, odometer_m=100.0, when=True):
    at = jnp.array(centre, float), jnp.float32(odometer_m)
    node, there = MATCH(writer, at, found, jnp.float32(back), jnp.float32(1.0), jnp.bool_(when))
    return int(node) if bool(there) else None


T = ((0.0, 0.0), (NORTH, SOUTH), (EAST,))  # node 1: the way east waits


@pytest.mark.parametrize(
    ("openings_deg", "turn_deg"),
    [
        ((80, 260, -10), 10),  # all ten degrees to the right of what the map says
        ((90, 270, 0), 0),
        ((83, 263, -1), 5),  # 7, 7 and 1
        ((83, 263), 7),  # a link has no opening
        ((83, 263, -7, 180), 7),  # an opening has no link
        ((83, 263, -25), 7),  # or lies too far off
    ],
)
def test_how_a_place_is_turned(openings_deg, turn_deg):
    turn = TURN_TO(a_writer(T).map, jnp.int32(1), place(*np.radians(openings_deg)))
    assert math.degrees(turn) == pytest.approx(turn_deg, abs=1e-3)


def test_how_a_node_lies_is_said_in_the_frame_of_the_last_one():
    """North by odometry is west there; the new one is turned by 20 degrees less."""
    writer = a_writer().replace(origin=jnp.array([1.0, 2.0, math.radians(90)]))
    found = mapping.moved_from_node(writer, jnp.array([1.0, 5.0]), math.radians(20))
    assert list(found) == ["moved_x_m", "moved_y_m", "turned"]
    np.testing.assert_allclose([*found.values()], [-3, 0, math.radians(70)], atol=1e-6)
    assert np.isnan(mapping.moved_from_node(writer, jnp.array([1.0, 5.0]), math.nan)["turned"])


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ((SOUTH, EAST), None),  # one is not seen
        ((NORTH, SOUTH, EAST, WEST), None),  # one is new
        ((NORTH, SOUTH, EAST), 1),
        ((EAST, NORTH + 0.6, SOUTH - 0.6), 1),  # 34 degrees off each
        ((EAST, NORTH + 0.8, SOUTH - 0.8), None),
    ],
)
def test_it_has_the_very_ways(found, expected):
    assert recognised(a_writer(T), (0.9, 0.0), place(*found), EAST) == expected
    assert recognised(a_writer(T), (0.9, 0.0), place(*found), EAST, when=False) is None


def test_the_way_by_which_the_robot_comes_must_wait_there():
    assert recognised(a_writer(T), (2.0, 0.0), place(NORTH, SOUTH, EAST), NORTH) is None
    done = ((0.0, 0.0), (NORTH, SOUTH, EAST), ())
    assert recognised(a_writer(done), (2.0, 0.0), place(NORTH, SOUTH, EAST), EAST) is None


def test_where_another_node_is_nearly_as_near_it_is_neither():
    far, near = ((4.0, 0.0), *T[1:]), ((2.5, 0.0), *T[1:])
    ways = place(NORTH, SOUTH, EAST)
    assert recognised(a_writer(T, far), (0.9, 0.0), ways, EAST) == 1  # 0.9 and 3.1 m
    assert recognised(a_writer(T, near), (0.9, 0.0), ways, EAST) is None  # 0.9 and 1.6 m
    other = ((1.5, 0.0), (NORTH, WEST), (SOUTH,))  # another place, but in the way
    assert recognised(a_writer(T, other), (0.9, 0.0), ways, EAST) is None


def test_where_a_known_link_leads_nothing_needs_to_wait():
    """The robot has left node 0 by the link between it and node 1, and has gone 20 m: 1 m, and 5 %."""
    writer = a_writer(((0.0, 0.0), (WEST, NORTH, EAST), ()), link=1)
    writer = writer.replace(node=jnp.int32(0), node_m=jnp.float32(80.0))
    ways = place(WEST, NORTH, EAST)
    assert recognised(writer, (1.9, 0.0), ways, WEST) == 1
    assert recognised(writer, (2.1, 0.0), ways, WEST) is None
    assert recognised(writer, (1.9, 0.0), place(SOUTH), SOUTH) is None


def test_where_a_known_link_leads_is_told_from_the_last_node():
    """The odometry has node 0 at (-48, 3) and 90 degrees of its frame to the left: the link east goes north there."""
    writer = a_writer(((0.0, 0.0), (WEST,), ()), link=1)
    writer = writer.replace(node=jnp.int32(0), node_m=jnp.float32(80.0), origin=jnp.array([-48, 3, math.radians(-90)]))
    followed, to, at = links.led_to(writer)
    assert (bool(followed), int(to)) == (True, 1)
    np.testing.assert_allclose(at, (-48, 53), atol=1e-4)
    back = writer.replace(node=jnp.int32(1), origin=jnp.zeros(3))
    np.testing.assert_allclose(links.led_to(back)[2], (-50, 0), atol=1e-4)
    assert not links.led_to(a_writer(T))[0]
