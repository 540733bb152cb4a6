"""Robots that follow routes: what a guide takes a place for, where it says to go on, and drives in the building."""

import dataclasses
import math
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jexplore as jx
from jexplore.config import InputError
from jexplore.driving import guide as guides
from jexplore.driving.sensing.openings import Openings
from jexplore.driving.settings import ROBOTS
from jexplore.studies.traces import following
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node
from jexplore.worlds import load_world

EAST, NORTH, WEST, SOUTH = (math.radians(a) for a in (0, 90, 180, 270))
T = WEST, EAST, SOUTH  # the ways of the first place
CROSSING = NORTH, EAST, WEST, SOUTH  # of the second


def a_guide(out=(SOUTH, EAST), ways=(T, CROSSING), leg=((10.0, 0.0), (0.0, -6.0)), length_m=(10.0, 6.0), tail_m=5.0):
    """From (0, 0) ten metres east, six south, then east."""
    made = guides.guide_of(out, ways, leg, length_m, tail_m=tail_m, node_xy=(0.0, 0.0), start_m=1.0, size=4)
    return jax.tree.map(jnp.asarray, made)


def place(*bearings):
    """Openings of a place that bear so, the others unused."""
    n = len(bearings)
    bearing = np.zeros(8, np.float32)
    bearing[:n] = bearings
    flat = jnp.zeros(8)
    return Openings(jnp.asarray(bearing), jnp.zeros((8, 2)), flat, flat, jnp.arange(8) < n, jnp.int32(0))


def met(guide, odometer_m, centre, found, when=True):
    """The guide after a place, and the bearing of the way on, degrees in [0, 360)."""
    after, bearing = guides.at_place(guide, jnp.float32(odometer_m), jnp.array(centre, float), found, jnp.bool_(when))
    return after, math.degrees(float(bearing)) % 360


def counts(guide):
    """`(places passed, missed, extra)`."""
    return int(guide.at), int(guide.missed), int(guide.extra)


def test_the_next_place_turns_the_way_the_map_says():
    after, bearing = met(a_guide(), 9.0, (10.2, 0.1), place(*T))
    assert bearing == pytest.approx(270)
    assert counts(after) == (1, 0, 0)
    assert float(after.from_m) == 9.0
    assert np.asarray(after.from_xy).tolist() == pytest.approx([10.2, 0.1])
    assert np.degrees(np.asarray(after.seen)[0][:3]).tolist() == pytest.approx([180, 0, 270])
    assert np.isnan(np.asarray(after.seen)[1:]).all()
    after, bearing = met(after, 15.2, (10.3, -5.8), place(*CROSSING))
    assert bearing == pytest.approx(0)
    assert counts(after) == (2, 0, 0)


@pytest.mark.parametrize(("off_m", "ways", "taken"), [(2.5, T, True), (2.5, (WEST, SOUTH), False), (4.0, T, False)])
def test_a_place_somewhat_off_must_have_the_very_ways(off_m, ways, taken):
    """2.5 m are within 0.2 * 10 + 1.5, and not within 0.1 * 10 + 1.0."""
    after, bearing = met(a_guide(), 9.0, (10.0 + off_m, 0.0), place(*ways))
    assert counts(after) == (int(taken), 0, int(not taken))
    assert bearing == pytest.approx(270 if taken else 180)


@pytest.mark.parametrize("ways", [(WEST, SOUTH), (WEST, EAST, SOUTH, NORTH)])
def test_a_way_less_or_more_is_no_other_place(ways):
    after, bearing = met(a_guide(), 9.0, (10.0, 0.5), place(*ways))
    assert counts(after) == (1, 0, 0)
    assert bearing == pytest.approx(270)


def test_a_place_without_the_way_on_is_another():
    after, _ = met(a_guide(), 9.0, (10.0, 0.5), place(WEST, EAST, NORTH))
    assert counts(after) == (0, 0, 1)


def test_at_a_place_that_the_map_does_not_have_the_robot_goes_towards_the_next():
    after, bearing = met(a_guide(), 3.0, (4.0, 6.0), place(NORTH, SOUTH, EAST))
    assert bearing == pytest.approx(315)
    assert counts(after) == (0, 0, 1)
    assert float(after.from_m) == -1.0


def test_a_place_that_is_missed_is_told_by_the_next():
    after, bearing = met(a_guide(), 15.0, (10.0, -6.0), place(*CROSSING))
    assert bearing == pytest.approx(0)
    assert counts(after) == (2, 1, 0)


def test_the_heading_is_put_right_at_a_place():
    """The odometry has turned 10 degrees to the left: so do all bearings, and the next leg."""
    off = math.radians(10)
    after, bearing = met(a_guide(), 9.0, (10.0, 0.0), place(*(way + off for way in T)))
    assert math.degrees(float(after.turned)) == pytest.approx(-5)
    assert bearing == pytest.approx(275)
    south = 6.0 * math.cos(NORTH * 3 + off / 2), 6.0 * math.sin(NORTH * 3 + off / 2)
    expected = np.asarray(guides._expected(after, jnp.array([1])))[0]
    assert expected.tolist() == pytest.approx([10.0 + south[0], south[1]], abs=1e-4)


def test_nothing_happens_where_there_is_no_place():
    before = a_guide()
    after, _ = met(before, 9.0, (10.0, 0.0), place(*T), when=False)
    for one, other in zip(jax.tree.leaves(before), jax.tree.leaves(after)):
        np.testing.assert_array_equal(one, other)


def on_the_way(guide, odometer_m, position=(5.0, 0.0), blocked=False):
    return guides.on_the_way(guide, jnp.float32(odometer_m), jnp.array(position), jnp.bool_(blocked))


ONE = {"out": (SOUTH,), "ways": (T,), "leg": ((10.0, 0.0),), "length_m": (10.0,)}


def test_a_route_ends_at_its_last_place_or_where_the_way_is_long_enough():
    at_place, _ = met(a_guide(**ONE, tail_m=0.0), 9.0, (10.0, 0.0), place(*T))
    assert bool(at_place.arrived)
    near = [bool(on_the_way(a_guide(**ONE, tail_m=0.0), 8.5, (x, 0.0)).arrived) for x in (9.2, 9.4)]
    assert near == [False, True]
    on_link, _ = met(a_guide(**ONE, tail_m=5.0), 9.0, (10.0, 0.0), place(*T))
    assert not bool(on_link.arrived)
    ends = [bool(on_the_way(on_link, m).arrived) for m in (13.6, 13.8)]
    assert ends == [False, True]


def test_without_its_places_or_its_way_a_robot_is_lost():
    lost = [bool(on_the_way(a_guide(), m).lost) for m in (35.4, 35.6)]  # 1.5 * (10 + 6 + 5) + 5 m, begun at -1
    assert lost == [False, True]
    stopped = on_the_way(a_guide(), 2.0, blocked=True)
    assert bool(stopped.lost)
    assert bool(stopped.blocked)


def test_a_guide_of_a_route_has_its_divergences():
    world = load_world("course:obstacle=none")
    btm = world.course.topology
    route = jx.route(btm, "wheeled", 0, 5)
    guide = following._guides(world, btm, [route], [0.6])
    assert guide.count.tolist() == [2]
    assert np.isfinite(guide.ways[0, :2]).sum(axis=1).tolist() == [3, 3]
    places = [node for node in route.nodes[1:] if btm.nodes[node].type == "divergence"][:2]
    ends = [(btm.nodes[node].x_m, btm.nodes[node].y_m) for node in places]
    np.testing.assert_allclose(
        guide.leg[0, :2].sum(axis=0), np.subtract(ends[1], (btm.nodes[0].x_m, btm.nodes[0].y_m)), atol=1e-4
    )
    assert guide.length_m[0, :2].sum() + guide.tail_m[0] == pytest.approx(route.length_m)
    assert guide.from_m[0] == pytest.approx(-0.6)


@pytest.mark.jit
def test_routes_are_driven_and_what_is_otherwise_is_written_back():
    """The map knows nothing of the stairs that the building has, nor of one of its ways; one it has twice."""
    btm = load_world("course:obstacle=none").course.topology
    open_link = next(link for link in btm.links if link.end == NOWHERE)
    same = next(link for link in btm.links if (link.start, link.end) == (3, 4))
    narrow = dataclasses.replace(same, id=99, min_width_m=0.1)
    kept = (link for link in btm.links if link.id != open_link.id)
    short = dataclasses.replace(btm, links=(*kept, narrow))
    found = jx.routes(short, ["wheeled"], [(1, 4), (4, 0), (3, 1)])[0]
    driven = jx.follow("course:obstacle=stairs", short, found, "wheeled", workers=1)
    assert driven.table["outcome"].tolist() == ["ARRIVED", "BLOCKED", "ARRIVED"]
    assert (driven.table["off_m"].iloc[[0, 2]] < 1.0).all()
    assert driven.table["refused"].max() <= 1
    assert driven.table["refused_links"].tolist() == [1, 1, 0]
    links = {link.id: link for link in driven.map.links}
    first = next(link for link in btm.links if 0 in (link.start, link.end))
    who = {"name": "wheeled", "width_m": 0.39, "max_step_m": 0.03, "max_slope_deg": 5.0}
    assert links[first.id].attributes == {"blocked": True, "blocked_for": who, "found_by": "wheeled"}
    (new,) = [link for link in driven.map.links if link.attributes.get("found_by") and link.end == NOWHERE]
    assert new.start == open_link.start
    assert abs((new.start_bearing_deg - open_link.start_bearing_deg + 180) % 360 - 180) < 20
    assert len(driven.changes) == 2
    too_narrow = (99, ("width 0.1 m < 0.39 m",))
    assert jx.route(driven.map, "wheeled", 4, 0).refused == ((first.id, ("blocked for wheeled",)), too_narrow)
    climbs = jx.route(driven.map, "kamui", 4, 0)
    assert first.id in climbs.links
    assert any(line.endswith("blocked for wheeled") for line in climbs.unknown)


@pytest.mark.parametrize("off_m", [10_000.0, -30.0, 2.0])  # outside the plan, on either side; in a wall
def test_a_map_of_another_place_is_refused(off_m):
    btm = load_world("course:obstacle=none").course.topology
    nodes = tuple(dataclasses.replace(node, y_m=node.y_m + off_m) for node in btm.nodes)
    moved = dataclasses.replace(btm, nodes=nodes)
    with pytest.raises(InputError, match="is the map of this building, in its frame"):
        jx.follow("course:obstacle=none", moved, [jx.route(moved, "wheeled", 0, 5)], "wheeled")


def test_where_only_the_way_back_is_open_a_wall_is_before_it():
    """On the way ten metres east: a place with one opening that leads back, with another, and one off the way."""
    for bearing, walled in ((WEST, True), (NORTH, False)):
        after, _ = met(a_guide(), 5.0, (6.0, 0.0), place(bearing))
        assert (bool(after.walled), bool(after.lost)) == (walled, walled)
    strayed, _ = met(a_guide(), 3.0, (3.0, 4.0), place(NORTH, SOUTH, EAST))
    after, _ = met(strayed, 5.0, (6.0, 0.0), place(WEST))
    assert not bool(after.walled)
    last, _ = met(a_guide(**ONE, tail_m=0.0), 9.0, (10.0, 0.0), place(WEST))
    assert not bool(last.walled)


@pytest.mark.parametrize(
    ("gone_m", "link"), [(1.0, 0), (3.2, 0), (3.6, 1), (7.0, 1), (9.0, 2), (30.0, 2)]
)  # the front is half a metre and more ahead
def test_of_several_links_between_two_places_that_one_is_blocked_which_lies_before_the_robot(gone_m, link):
    nodes = [Node(0, 0.0, 0.0, "divergence"), *(Node(i, 4.0 * i, 0.0, "obstacle") for i in (1, 2))]
    nodes += [Node(3, 12.0, 0.0, "divergence"), Node(4, 16.0, 0.0, "terminal")]
    links = [Link(i, i, i + 1, "searched", 0.0, 180.0, 4.0, 1.0) for i in range(4)]
    btm = BtmMap(tuple(nodes), tuple(links))
    route = jx.route(btm, "kamui", 0, 4)
    assert route.links == (0, 1, 2, 3)

    def of(at, **more):
        guide = {"at": at, "from_m": -0.5, "strays": False, "blocked": True, "walled": False, **more}
        result = types.SimpleNamespace(path_m=gone_m - 0.5, guide=types.SimpleNamespace(**guide))
        found = following._blocked_link(btm, route, result, ROBOTS["kamui"])
        return None if found is None else found.id

    assert of(0) == link
    assert of(1) == 3
    assert of(0, strays=True) is None
    assert of(0, blocked=False) is None
    assert of(0, blocked=False, walled=True) == link


def test_wrong_input_is_one_line():
    btm = load_world("course:obstacle=none").course.topology
    here, wide = jx.route(btm, "wheeled", 0, 0), jx.Robot("wheeled", 3, 3, 1, 5, 0.1, 1, 1, 0.5, 0, 45, 0.7)
    for routes, robot, message in [
        ([], "wheeled", "expected a route"),
        ([here], "wheeled", "must have a link"),
        ([jx.route(btm, "wheeled", 0, 5)], "tank", "robot must be one of"),
        ([jx.route(btm, "wheeled", 0, 5)], wide, "not fit on link"),
        ([jx.route(btm, "wheeled", 0, 5)], "kamui", "kamui cannot follow a route of wheeled"),
    ]:
        with pytest.raises(InputError, match=message):
            jx.follow("course:obstacle=none", btm, routes, robot)


@pytest.mark.parametrize("walled", [True, False])
def test_a_link_that_is_blocked_loses_what_maps_said_about_that(walled):
    told = {"blocked": [["a", True], ["b", False]], "blocked_for": [["a", {}]], "victim": [["a", 1], ["b", 2]]}
    link = Link(
        0, 0, 1, "searched", 0.0, 180.0, 4.0, 1.0, attributes={"conflicts": told, "blocked_for": 3, "note": "x"}
    )
    found = following._blocked(link, ROBOTS["kamui"], walled=walled).attributes
    assert found["conflicts"] == {"victim": told["victim"]}
    assert (found["blocked"], found["found_by"], found["note"]) == (True, "kamui", "x")
    assert ("blocked_for" in found) == (not walled)
