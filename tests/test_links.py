"""Links of a map that is being written: cases one can check with a pencil."""

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
TURN_TO = jax.jit(links.turn_to)


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


def test_where_a_known_link_leads_is_told_from_either_end():
    writer = a_writer(T, link=1)
    for node, other in ((0, 1), (1, 0)):
        followed, to = links.leads_to(writer.replace(node=jnp.int32(node)))
        assert (bool(followed), int(to)) == (True, other)
    assert not links.leads_to(a_writer(T))[0]
