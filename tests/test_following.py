"""Robots that follow routes: what a guide takes a place for, where it says to go on, and drives in the building."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.runs import a_due_node, a_state

import jexplore as jx
from jexplore import btm as maps
from jexplore.config import InputError
from jexplore.driving import behaviour
from jexplore.driving.batch import building_of
from jexplore.driving.guiding import guide as guides
from jexplore.driving.guiding import leaving, steering
from jexplore.driving.guiding.guide import is_next
from jexplore.driving.links import reach_m
from jexplore.driving.mission import RunResult
from jexplore.driving.records import Latch, Openings, RunMode, Track
from jexplore.driving.sensing import surround
from jexplore.driving.settings import ROBOTS, Tuning
from jexplore.studies.traces import following
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node
from jexplore.worlds import load_world
from jexplore.worlds.world import World

EAST, NORTH, WEST, SOUTH = (math.radians(a) for a in (0, 90, 180, 270))
T = WEST, EAST, SOUTH  # the ways of the first place
CROSSING = NORTH, EAST, WEST, SOUTH  # of the second


LEGS = (10.0, 0.0), (0.0, -6.0)


def a_guide(out=(SOUTH, EAST), ways=(T, CROSSING), leg=LEGS, length_m=(10.0, 6.0), tail_m=5.0, **more):
    """From (0, 0) ten metres east, six south, then east."""
    end_leg = tail_m * math.cos(out[-1]), tail_m * math.sin(out[-1])
    more = {"end_leg": end_leg, "node_xy": (0.0, 0.0), "start_m": 1.0, "size": 4, **more}
    return jax.tree.map(jnp.asarray, guides.guide_of(out, ways, leg, length_m, tail_m=tail_m, **more))


def place(*bearings):
    """Openings of a place that bear so, the others unused."""
    n = len(bearings)
    bearing = np.zeros(8, np.float32)
    bearing[:n] = bearings
    flat = jnp.zeros(8)
    return Openings(jnp.asarray(bearing), jnp.zeros((8, 2)), flat, flat, jnp.arange(8) < n, jnp.int32(0))


def met(guide, odometer_m, centre, found, when=True, free_m=0.0):
    """The guide after a place, and the bearing of the way on, degrees in [0, 360)."""
    free = lambda place, bearing: jnp.float32(free_m)  # noqa: E731
    where = jnp.float32(odometer_m), jnp.array(centre, float)
    after, onward = guides.match_place(guide, *where, found, jnp.bool_(when), free)
    return after, math.degrees(float(onward.bearing)) % 360


def counts(guide):
    """`(places passed, missed, extra)`."""
    return int(guide.at), int(guide.missed), int(guide.extra)


def test_the_next_place_turns_the_way_the_map_says():
    after, bearing = met(a_guide(), 9.0, (10.2, 0.1), place(*T))
    assert bearing == pytest.approx(268.1, abs=0.1)  # the next one lies 6.1 m south and 0.2 m west
    assert counts(after) == (1, 0, 0)
    assert float(after.from_m) == 9.0
    assert np.asarray(after.from_xy).tolist() == pytest.approx([10.06, 0.03])  # three tenths of how far it was off
    assert np.degrees(np.asarray(after.seen)[0][:3]).tolist() == pytest.approx([180, 0, 270])
    assert np.isnan(np.asarray(after.seen)[1:]).all()
    after, bearing = met(after, 15.2, (10.3, -5.8), place(*CROSSING))
    assert bearing == pytest.approx(358, abs=0.1)
    assert counts(after) == (2, 0, 0)


@pytest.mark.parametrize(("off_m", "ways", "taken"), [(2.5, T, True), (2.5, (WEST, SOUTH), False), (4.0, T, False)])
def test_a_place_somewhat_off_must_have_the_very_ways(off_m, ways, taken):
    """2.5 m are within 0.2 * 10 + 1.5, and not within 0.1 * 10 + 1.0."""
    after, bearing = met(a_guide(), 9.0, (10.0 + off_m, 0.0), place(*ways))
    assert counts(after) == (int(taken), 0, int(not taken))
    assert bearing == pytest.approx(180 + math.degrees(math.atan(6 / off_m)) if taken else 180)


@pytest.mark.parametrize("ways", [(WEST, SOUTH), (WEST, EAST, SOUTH, NORTH)])
def test_a_way_less_or_more_is_no_other_place(ways):
    after, bearing = met(a_guide(), 9.0, (10.0, 0.5), place(*ways))
    assert counts(after) == (1, 0, 0)
    assert bearing == pytest.approx(270)


@pytest.mark.parametrize(("free_m", "taken"), [(1.9, False), (2.1, True)])
def test_a_place_whose_way_on_is_free_but_no_opening_is_the_one(free_m, taken):
    after, bearing = met(a_guide(), 9.0, (10.0, 0.5), place(WEST, EAST, NORTH), free_m=free_m)
    assert counts(after) == (int(taken), 0, int(not taken))
    if taken:
        assert bearing == pytest.approx(270)


def test_a_way_on_need_be_free_no_farther_than_what_it_leads_to():
    guide = a_guide(leg=((10.0, 0.0), (0.0, -1.0)), length_m=(10.0, 1.0))
    taken = [counts(met(guide, 9.0, (10.0, 0.5), place(WEST, EAST), free_m=m)[0])[0] for m in (0.9, 1.1)]
    assert taken == [0, 1]


def test_a_place_nearer_to_another_of_the_map_is_none_of_the_route():
    """Seen 0.9 m beyond; another one is there, 1.0 m beyond."""
    for others, taken in (((), True), ([[(0.0, 9.0), (1.0, 0.0)], []], False), ([[(5.0, 0.0)], []], True)):
        after, _ = met(a_guide(others=others), 9.0, (10.9, 0.0), place(*T))
        assert counts(after) == (int(taken), 0, int(not taken))


@pytest.mark.parametrize(("ways", "at"), [(T, 1), (CROSSING, 2)])
def test_of_two_places_as_near_that_one_is_met_which_has_its_ways(ways, at):
    """One at ten metres, the next at eleven, seen between."""
    guide = a_guide(out=(SOUTH, SOUTH), leg=((10.0, 0.0), (1.0, 0.0)), length_m=(10.0, 1.0))
    assert counts(met(guide, 9.5, (10.55 if at == 1 else 10.45, 0.0), place(*ways))[0])[0] == at


def a_door(length_m):
    """The map has the place 0.9 m east of where this robot sees it; a door north of both bears 150 degrees there."""
    return a_guide(
        out=(math.radians(150),), ways=((math.radians(150), EAST, SOUTH),), leg=((10.0, 0.0),), length_m=(10.0,)
    ).replace(tail_m=jnp.float32(length_m), end_leg=jnp.array([-0.8, 7.3]))


@pytest.mark.parametrize(("length_m", "bearing_deg"), [(7.7, 89), (9.0, 150)])
def test_a_straight_way_on_bears_to_where_it_leads(length_m, bearing_deg):
    """One that is much longer than its ends are apart bears as the map says: it may turn behind the door."""
    after, bearing = met(a_door(length_m), 9.0, (9.1, 0.3), place(NORTH, WEST, SOUTH, EAST))
    assert int(after.at) == 1
    assert bearing == pytest.approx(bearing_deg, abs=1)


def test_a_straight_way_on_that_is_no_opening_bears_as_the_map_says():
    _, bearing = met(a_door(7.7), 9.0, (9.1, 0.3), place(math.radians(140), SOUTH, EAST))
    assert bearing == pytest.approx(150)


@pytest.mark.parametrize(("off_m", "at"), [(0.3, 1), (0.5, 0)])
def test_a_place_where_the_map_has_it_is_met_whatever_is_seen_there(off_m, at):
    assert counts(met(a_guide(), 9.0, (10.0, off_m), place(WEST, EAST))[0])[0] == at


@pytest.mark.parametrize(("ways", "kept"), [(T, 3), ((WEST, EAST), 0)])
def test_what_is_seen_at_a_place_is_kept_where_it_is_like_that_place(ways, kept):
    """Not where it is that one only because the map has it there: its ways would be written back as new ones."""
    after, _ = met(a_guide(), 9.0, (10.0, 0.2), place(*ways))
    assert counts(after)[0] == 1
    assert int(np.isfinite(after.seen[0]).sum()) == kept


def test_at_a_place_that_the_map_does_not_have_the_robot_goes_towards_the_next():
    after, bearing = met(a_guide(), 3.0, (4.0, 6.0), place(NORTH, SOUTH, EAST))
    assert bearing == pytest.approx(315)
    assert counts(after) == (0, 0, 1)
    assert float(after.from_m) == -1.0


@pytest.mark.parametrize("size", [2, 4])  # with a guide that is full, and one that is not
@pytest.mark.parametrize(
    ("at", "centre", "toward"),
    [(2, (12.5, -6.2), 4.6), (2, (10.5, -5.0), 347.5), (1, (10.0, -5.0), 348.7), (1, (8.5, -3.0), 296.6)],
)
def test_past_the_last_place_it_goes_towards_the_end(size, at, centre, toward):
    """The end lies at (15, -6), also near the last place, at (10, -6)."""
    guide = a_guide(size=size).replace(at=jnp.int32(at), from_xy=jnp.array([10.0, (0.0, -6.0)[at - 1]]))
    after, bearing = met(guide, 20.0, centre, place(WEST, NORTH))
    assert counts(after) == (at, 0, 1)
    assert bearing == pytest.approx(toward, abs=0.1)


@pytest.mark.parametrize("size", [2, 4])
def test_past_the_last_place_only_the_way_back_is_a_wall(size):
    guide = a_guide(size=size).replace(at=jnp.int32(2), from_xy=jnp.array([10.0, -6.0]))
    for bearing, walled in ((WEST, True), (EAST, False)):
        assert bool(met(guide, 20.0, (12.5, -6.2), place(bearing))[0].walled) == walled


@pytest.mark.parametrize(("x", "walled"), [(13.4, True), (13.6, False)])
def test_only_the_way_back_near_the_end_is_the_ends_own(x, walled):
    """It lies at (15, -6)."""
    guide = a_guide().replace(at=jnp.int32(2), from_xy=jnp.array([10.0, -6.0]))
    after, _ = met(guide, 20.0, (x, -6.0), place(WEST))
    assert (bool(after.walled), bool(after.lost)) == (walled, walled)


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
    expected = np.asarray(guides._expected_positions(after, jnp.array([1])))[0]
    assert expected.tolist() == pytest.approx([10.0 + south[0], south[1]], abs=1e-4)


def test_a_heading_that_is_off_turns_legs_and_places_beside_the_route():
    """The odometry's heading is a quarter turn less than the map's: ten metres east are ten metres south there."""
    guide = a_guide().replace(turned=jnp.float32(math.pi / 2))
    np.testing.assert_allclose(guides.next_stop(guide)[0], (0.0, -10.0), atol=1e-4)
    ways = [way - math.pi / 2 for way in T]
    others = (((0.0, -1.2),), ())  # south of the first place: west by the odometry
    for beside, at in (((), 1), (others, 0)):
        guide = a_guide(others=beside).replace(turned=jnp.float32(math.pi / 2))
        assert int(met(guide, 9.0, (-0.9, -10.0), place(*ways))[0].at) == at
    after, bearing = met(a_guide().replace(turned=jnp.float32(math.pi / 2)), 9.0, (0.0, -10.0), place(*ways))
    assert bearing == pytest.approx(180, abs=1e-3)  # south on the map
    np.testing.assert_allclose(guides.next_stop(after)[0], (-6.0, -10.0), atol=1e-4)


def test_one_way_that_is_seen_elsewhere_does_not_turn_the_heading():
    after, _ = met(a_guide(), 9.0, (10.0, 0.0), place(WEST, EAST, SOUTH + math.radians(38)))
    assert math.degrees(float(after.turned)) == pytest.approx(0, abs=1e-4)
    after, _ = met(a_guide(), 9.0, (10.0, 0.0), place(*(way + math.radians(30) for way in T)))
    assert math.degrees(float(after.turned)) == pytest.approx(-5)


def test_nothing_happens_where_there_is_no_place():
    before = a_guide()
    after, _ = met(before, 9.0, (10.0, 0.0), place(*T), when=False)
    for one, other in zip(jax.tree.leaves(before), jax.tree.leaves(after)):
        np.testing.assert_array_equal(one, other)


FAR = np.full(surround.DIRECTIONS, 5.0)  # the way is free all round


def on_the_way(guide, odometer_m, position=(5.0, 0.0), blocked=False, ways_m=FAR):
    estimate = jnp.array([*position, 0.0])
    robot = ROBOTS["wheeled"]
    return steering.update_progress(
        guide, jnp.float32(odometer_m), estimate, jnp.asarray(ways_m), jnp.bool_(blocked), robot
    )


ONE = {"out": (SOUTH,), "ways": (T,), "leg": ((10.0, 0.0),), "length_m": (10.0,)}


@pytest.mark.parametrize("tail_m", [0.0, 5.0])
def test_a_route_ends_where_the_map_has_its_end(tail_m):
    """At the last place, or five metres south; the tolerance grows with the way."""
    guide, y = a_guide(**ONE, tail_m=tail_m), -tail_m
    if tail_m:
        guide, _ = met(guide, 9.0, (10.0, 0.0), place(*T))
        assert not bool(on_the_way(guide, 9.0, (10.0, 0.0)).arrived)
    else:
        guide = guide.replace(from_m=jnp.float32(-1.0))
    gone_m = 9.0 + tail_m
    assert [bool(on_the_way(guide, gone_m, (10.0 + x, y)).arrived) for x in (-0.5, -0.3)] == [False, True]
    assert [bool(on_the_way(guide, gone_m + 2, (10.0 + x, y)).arrived) for x in (-0.9, -0.7)] == [False, True]
    assert [bool(on_the_way(guide, gone_m + 9, (10.0 + x, y)).arrived) for x in (-0.9, -0.7)] == [False, True]


def test_a_way_as_long_as_the_maps_that_has_led_elsewhere_is_no_end():
    guide, _ = met(a_guide(**ONE, tail_m=5.0), 9.0, (10.0, 0.0), place(*T))
    assert not bool(on_the_way(guide, 14.0, (13.0, -2.0)).arrived)


def test_an_end_behind_a_wall_is_not_reached():
    ways_m = np.where(np.abs(surround.DIRECTION) < 0.1, -0.2, 5.0)
    found = [
        bool(on_the_way(a_guide(**ONE, tail_m=0.0), 12.0, (9.4, 0.0), ways_m=ways).arrived) for ways in (FAR, ways_m)
    ]
    assert found == [True, False]


def test_without_its_places_or_its_way_a_robot_is_lost():
    lost = [bool(on_the_way(a_guide(), m).lost) for m in (35.4, 35.6)]  # 1.5 * (10 + 6 + 5) + 5 m, begun at -1
    assert lost == [False, True]
    stopped = on_the_way(a_guide(), 2.0, blocked=True)
    assert bool(stopped.lost)
    assert bool(stopped.blocked)


def test_a_guide_of_a_route_has_its_divergences():
    world = load_world("course:obstacle=none")
    btm = world.course.topology
    route = jx.btm.route(btm, "wheeled", 0, 5)
    guide = following._guides(world, btm, [route], [(0.6, (0.0, 0.3))])
    assert guide.count.tolist() == [2]
    assert np.isfinite(guide.ways[0, :2]).sum(axis=1).tolist() == [3, 3]
    places = [node for node in route.nodes[1:] if btm.nodes[node].type == "divergence"][:2]
    ends = [(btm.nodes[node].x_m, btm.nodes[node].y_m) for node in places]
    np.testing.assert_allclose(
        guide.leg[0, :2].sum(axis=0), np.subtract(ends[1], (btm.nodes[0].x_m, btm.nodes[0].y_m)), atol=1e-4
    )
    assert guide.length_m[0, :2].sum() + guide.tail_m[0] == pytest.approx(route.length_m)
    assert guide.from_m[0] == pytest.approx(-0.6)
    node = np.subtract((btm.nodes[0].x_m, btm.nodes[0].y_m), world.origin_m)
    np.testing.assert_allclose(guide.from_xy[0], node + np.array([0.0, 0.3]), atol=1e-5)


@pytest.mark.jit
def test_routes_are_driven_and_what_is_otherwise_is_written_back():
    """The map knows nothing of the stairs that the building has, nor of one of its ways; one it has twice."""
    btm = load_world("course:obstacle=none").course.topology
    open_link = next(link for link in btm.links if link.end == NOWHERE)
    same = next(link for link in btm.links if (link.start, link.end) == (3, 4))
    narrow = dataclasses.replace(same, id=99, min_width_m=0.1)
    kept = (link for link in btm.links if link.id != open_link.id)
    short = dataclasses.replace(btm, links=(*kept, narrow))
    found = jx.btm.routes(short, ["wheeled"], [(1, 4), (4, 0), (3, 1)])[0]
    driven = jx.btm.follow("course:obstacle=stairs", short, found, "wheeled", workers=1)
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
    assert jx.btm.route(driven.map, "wheeled", 4, 0).refused == ((first.id, ("blocked for wheeled",)), too_narrow)
    climbs = jx.btm.route(driven.map, "kamui", 4, 0)
    assert first.id in climbs.links
    assert any(line.endswith("blocked for wheeled") for line in climbs.unknown)


@pytest.mark.parametrize("off_m", [10_000.0, -30.0, 2.0])  # outside the plan, on either side; in a wall
def test_a_map_of_another_place_is_refused(off_m):
    btm = load_world("course:obstacle=none").course.topology
    nodes = tuple(dataclasses.replace(node, y_m=node.y_m + off_m) for node in btm.nodes)
    moved = dataclasses.replace(btm, nodes=nodes)
    with pytest.raises(InputError, match="is the map of this building, in its frame"):
        jx.btm.follow("course:obstacle=none", moved, [jx.btm.route(moved, "wheeled", 0, 5)], "wheeled")


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
    route = jx.btm.route(btm, "kamui", 0, 4)
    assert route.links == (0, 1, 2, 3)

    def of(at, **more):
        guide = a_guide().replace(
            **{"at": at, "from_m": -0.5, "strays": False, "blocked": True, "walled": False, **more}
        )
        result = RunResult(**dict.fromkeys(RunResult.__dataclass_fields__)).replace(path_m=gone_m - 0.5, guide=guide)
        found = following._blocked_link(btm, route, result, ROBOTS["kamui"])
        return None if found is None else found.id

    assert of(0) == link
    assert of(1) == 3
    assert of(0, strays=True) is None
    assert of(0, blocked=False) is None
    assert of(0, blocked=False, walled=True) == link


def test_wrong_input_is_one_line():
    btm = load_world("course:obstacle=none").course.topology
    here, wide = jx.btm.route(btm, "wheeled", 0, 0), jx.btm.Robot("wheeled", 3, 3, 1, 5, 0.1, 1, 1, 0.5, 0, 45, 0.7)
    for routes, robot, message in [
        ([], "wheeled", "expected a route"),
        ([here], "wheeled", "must have a link"),
        ([jx.btm.route(btm, "wheeled", 0, 5)], "tank", "robot must be one of"),
        ([jx.btm.route(btm, "wheeled", 0, 5)], wide, "not fit on link"),
        ([jx.btm.route(btm, "wheeled", 0, 5)], "kamui", "kamui cannot follow a route of wheeled"),
    ]:
        with pytest.raises(InputError, match=message):
            jx.btm.follow("course:obstacle=none", btm, routes, robot)


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


# Where it steers


def steered(guide, at, *, ways_m=FAR, mode=RunMode.CENTRAL, latch=Latch.FREE, track=None, odometer_m=1.0, **more):
    """Return the result of steering at x, y, heading in degrees: the guide, the `Drive`, the `Track`."""
    x, y, heading = at
    space = behaviour.no_free_space().replace(inside=jnp.bool_(more.get("inside", False)))
    state = a_state(odometer_m=jnp.float32(odometer_m), mode=jnp.int32(mode), space=space)
    drive = behaviour.initial_drive().replace(latch=jnp.int32(latch), out=jnp.float32(more.get("out", 0.0)))
    drive = drive.replace(since=jnp.int32(more.get("since", 0)))
    nodes, looked = (jnp.array(more.get(name, [(99.0, 99.0)])) for name in ("nodes", "looked"))
    pose = jnp.array([x, y, math.radians(heading)])
    track = track or behaviour.empty_track()
    given = guide, drive, track, pose, jnp.asarray(ways_m), (nodes, looked)
    return steering._steered(state, *given, Tuning(), ROBOTS["wheeled"])


def bears(drive):
    """The direction in which a robot steers, degrees."""
    return math.degrees(float(drive.out)) % 360


STRAY = {"strays": jnp.bool_(True), "at": jnp.int32(1), "from_xy": jnp.array([10.0, 0.0])}  # the next lies 6 m south


def test_a_robot_astray_steers_for_the_next_place_by_the_free_way_nearest_to_it():
    guide = a_guide().replace(**STRAY)
    after, drive, _ = steered(guide, (8.0, -6.0, 90))  # two metres west of the visible place
    assert (int(drive.latch), bool(after.steers)) == (Latch.LEAVE, True)
    assert bears(drive) == pytest.approx(0, abs=1e-3)
    np.testing.assert_allclose(drive.target, (9.0, -6.0), atol=1e-5)
    shut = np.where(np.abs(surround.DIRECTION + math.pi / 2) < 0.4, 0.2, 5.0)  # to the right, where the place lies
    _, drive, _ = steered(guide, (8.0, -6.0, 90), ways_m=shut)
    assert bears(drive) == pytest.approx(25)  # the free one that is less of a turn


def test_it_goes_on_steering_as_before_where_two_ways_are_as_good():
    guide = a_guide().replace(**STRAY, steers=jnp.bool_(True))
    shut = np.where(np.abs(surround.DIRECTION) < 1.0, 0.2, 5.0)
    for out in (1.1, -1.1):
        _, drive, _ = steered(guide, (8.0, -6.0, 0), ways_m=shut, latch=Latch.LEAVE, out=out)
        assert math.copysign(1, math.sin(float(drive.out))) == math.copysign(1, out)


def test_in_a_passage_that_leads_to_the_next_place_it_does_not_steer():
    guide = a_guide().replace(**STRAY).replace(strays=jnp.bool_(False))
    steers = [
        bool(steered(guide, (10.0, y, 270), mode=mode)[0].steers)
        for mode in (RunMode.CENTRAL, RunMode.WALL_FOLLOWING)
        for y in (-1.0, -3.6)
    ]
    assert steers == [False, True, True, True]  # far in a passage; within sight; in a room


def test_it_steers_no_farther_than_the_way_is_worth():
    guide = a_guide().replace(**STRAY, from_m=jnp.float32(0.0))
    assert [bool(steered(guide, (8.0, -6.0, 0), odometer_m=m)[0].steers) for m in (11.9, 12.1)] == [True, False]


def believed(x, y):
    return Track(jnp.array([x, y]), jnp.float32(1), jnp.uint32(511), jnp.int32(9), jnp.float32(math.nan))


def test_a_place_that_it_sees_comes_first_but_not_one_where_it_has_been():
    guide = a_guide().replace(**STRAY)
    for nodes, steers in (((99.0, 99.0), False), ((8.0, -4.0), True)):
        after, *_ = steered(guide, (8.0, -6.0, 90), track=believed(8.0, -4.2), nodes=[nodes])
        assert bool(after.steers) == steers


def test_it_leaves_for_where_it_was_told_unless_it_sees_the_next_place_near():
    guide = a_guide().replace(**STRAY).replace(strays=jnp.bool_(False))
    steers = [bool(steered(guide, (10.0, y, 270), latch=Latch.LEAVE)[0].steers) for y in (-3.4, -3.6)]
    assert steers == [False, True]


@pytest.mark.parametrize(("inside", "latch"), [(False, Latch.APPROACH), (True, Latch.LEAVE)])
def test_near_a_place_that_it_has_not_seen_it_goes_there_and_looks_round(inside, latch):
    guide = a_guide().replace(**STRAY)
    after, drive, track = steered(guide, (10.0, -5.7, 270), inside=inside)
    assert int(drive.latch) == latch
    # In free space, where no place is seen, it has been there.
    assert int(after.at) == (2 if inside else 1)
    assert int(after.missed) - int(guide.missed) == inside
    if inside:
        np.testing.assert_allclose(drive.target, (11.0, -6.0), atol=1e-5)
        np.testing.assert_allclose(after.from_xy, (10.0, -6.0), atol=1e-5)
        assert (float(after.from_m), int(drive.since), bool(after.strays)) == (1.0, 0, False)
    else:
        np.testing.assert_allclose(track.centre, (10.0, -6.0), atol=1e-5)
        assert bool(drive.known)
        again, drive, _ = steered(guide, (10.0, -5.7, 270), looked=[(10.1, -6.1)])
        assert int(drive.latch) == Latch.FREE
        assert not bool(again.steers)


def test_who_may_steer_no_farther_is_free_again():
    guide = a_guide().replace(**STRAY, steers=jnp.bool_(True), from_m=jnp.float32(0.0))
    for m, latch, since in ((11.9, Latch.LEAVE, 7), (12.1, Latch.FREE, 0)):
        after, drive, _ = steered(guide, (8.0, -6.0, 0), latch=Latch.LEAVE, odometer_m=m, since=7)
        assert (int(drive.latch), int(drive.since), bool(after.steers)) == (latch, since, latch == Latch.LEAVE)
    _, drive, _ = steered(guide, (8.0, -6.0, 0), latch=Latch.APPROACH, odometer_m=12.1, since=7)  # it goes to a place
    assert (int(drive.latch), int(drive.since)) == (Latch.APPROACH, 7)


def test_an_end_in_sight_comes_before_a_place():
    guide = a_guide(**ONE, tail_m=5.0).replace(at=jnp.int32(1), from_xy=jnp.array([10.0, 0.0]))
    for ways_m, steers in ((FAR, True), (np.where(np.abs(surround.DIRECTION) < 0.3, 0.2, 5.0), False)):
        after, *_ = steered(guide, (10.0, -2.0, 270), track=believed(10.0, -3.0), ways_m=ways_m)
        assert bool(after.steers) == steers
    assert bears(steered(guide, (10.0, -2.0, 270), track=believed(10.0, -3.0))[1]) == pytest.approx(270)


# How it leaves a place


def left(guide, found, points, ways=(WEST, EAST), room=8, onto=(0, 0.0), turned=(0.0, (0.0, 0.0, 0.0))):
    """The link, its bearing in degrees, whether it is new, and the guide, at (10, 0.5)."""
    map_, node = maps.add_node(maps.empty(4, room), maps.DIVERGENCE, 10.0, 0.5)
    for bearing in ways:
        map_, _ = maps.add_link(map_, node, bearing)
    event = a_due_node(odometer_m=jnp.float32(9.0), centre=jnp.array([10.0, 0.5]))
    given = map_, a_state().writer.replace(guide=guide), event, node, found, jnp.bool_(True), points
    turned = jnp.float32(turned[0]), jnp.array(turned[1], jnp.float32)
    usual = jnp.int32(onto[0]), jnp.float32(onto[1])
    after, written, link, bearing, onward = leaving.leave_place(*given, usual, turned)
    return int(link), math.degrees(float(bearing)) % 360, int(written.n_links) > len(ways), after, onward


def walls(*points):
    return jnp.array(points, float), jnp.ones(len(points), bool)


def test_a_way_on_that_is_no_link_but_free_is_taken_from_where_it_is_free():
    """South of the place a post stands in the middle; 0.4 m to the west of that the way is free."""
    link, bearing, is_new, after, onward = left(a_guide(), place(WEST, EAST), walls((10.0, -1.0), (10.2, -1.0)))
    assert (link, is_new, int(after.at), bool(onward.is_free)) == (2, True, 1, True)
    assert bearing == pytest.approx(270)
    np.testing.assert_allclose(onward.middle, (9.6, 0.0), atol=1e-5)
    shut = walls(*((x, -1.0) for x in np.arange(9.0, 11.0, 0.2)))
    link, _, is_new, after, onward = left(a_guide(), place(WEST, EAST), shut)
    assert (is_new, int(after.at), bool(onward.is_free)) == (False, 0, False)
    assert not bool(after.steers)


def about(centre, angle):
    """The function that turns points about a centre."""
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return lambda xy: centre + turn @ (np.asarray(xy) - centre)


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_what_is_put_right_at_a_place_moves_the_route_with_the_odometry(share):
    """A known place lies 0.3 m east of where the odometry has it; its ways bear 0.2 rad more than there, and the
    heading is put right by a share of that.
    """
    turn, right = 0.2, (0.3, 0.0, 0.2 * share)
    free, centre = walls((10.0, -1.0), (10.2, -1.0)), np.array([10.0, 0.5])
    before = left(a_guide(), place(WEST, EAST), free)
    ways = WEST + turn, EAST + turn
    link, bearing, _, after, onward = left(a_guide(), place(*ways), free, ways=ways, turned=(turn, right))
    assert (link, int(after.at)) == (before[0], int(before[3].at))
    # The way on is as the map's node has it.
    assert bearing == pytest.approx(before[1] + math.degrees(turn), abs=1e-3)
    assert float(onward.bearing) == pytest.approx(float(before[4].bearing) + turn, abs=1e-6)
    np.testing.assert_allclose(onward.middle, about(centre, turn)(before[4].middle), atol=1e-5)
    # What lies ahead is as the odometry has it from now on.
    moved = about(centre, right[2])
    np.testing.assert_allclose(after.from_xy, moved(before[3].from_xy) + right[:2], atol=1e-5)
    assert float(after.turned) == pytest.approx(float(before[3].turned) - right[2], abs=1e-6)
    then, now = guides.next_stop(before[3])[0], guides.next_stop(after)[0]
    np.testing.assert_allclose(now, moved(then) + right[:2], atol=1e-4)
    np.testing.assert_allclose(after.seen, before[3].seen, atol=1e-6)  # bearings on the map stay


@pytest.mark.parametrize(("aside", "is_open"), [(-0.6, True), (0.6, True), (-0.75, False), (0.75, False)])
def test_a_way_on_without_a_link_is_open_where_the_node_has_an_opening(aside, is_open):
    """Towards an end that lies south of a place missing in the map; an opening lies `aside` of that way."""
    shut = walls(*((x, -1.0) for x in np.arange(9.0, 11.0, 0.2)))
    guide = a_guide().replace(**STRAY)
    ways = WEST + 0.2, EAST + 0.2
    toward = float(left(guide, place(WEST, EAST), shut)[4].bearing)
    found = place(*ways, toward + 0.2 + aside)
    link, bearing, is_new, _, onward = left(guide, found, shut, ways=ways, turned=(0.2, (0.3, 0.0, 0.04)))
    assert not bool(onward.is_free)
    assert is_new == is_open
    if is_open:
        assert (link, bearing) == (2, pytest.approx(math.degrees(toward + 0.2) % 360, abs=1e-3))


def test_where_the_map_has_no_room_or_the_place_no_link_it_goes_on_by_what_there_is():
    free = walls((10.0, -1.0), (10.2, -1.0))
    link, bearing, is_new, _, onward = left(a_guide(), place(WEST, -0.3), free, ways=(WEST, -0.3), room=2)
    assert (link, is_new, bool(onward.is_free)) == (1, False, False)
    assert bearing == pytest.approx(math.degrees(-0.3) % 360)
    shut = walls(*((x, -1.0) for x in np.arange(9.0, 11.0, 0.2)))
    link, bearing, is_new, _, _ = left(a_guide(), place(WEST), shut, ways=(), onto=(7, NORTH))
    assert (link, is_new) == (7, False)  # as it was told
    assert bearing == pytest.approx(90)


def test_a_robot_that_only_finds_the_way_back_steers_for_what_comes_next():
    """At its middle, ten metres east and half a metre north of the next place's; that lies behind the robot."""
    shut = walls(*((x, -1.0) for x in np.arange(9.0, 11.0, 0.2)))
    guide = a_guide(out=(NORTH, EAST), leg=((10.0, 0.5), (0.0, 1.0)), length_m=(10.0, 6.0))
    walled = walls(*((x, 1.0) for x in np.arange(9.0, 11.0, 0.2)), *map(tuple, np.asarray(shut[0])))
    for way, steers in ((WEST, False), (SOUTH, True)):
        _, _, _, after, _ = left(guide, place(way), walled, ways=(way,))
        assert (int(after.at), bool(after.steers), bool(after.lost)) == (1, steers, False)


def test_a_strip_is_free_as_far_as_the_nearest_point_in_it():
    points = walls((3.0, 0.2), (2.0, 0.4), (-1.0, 0.0))
    found = [float(reach_m(points, jnp.zeros(2), jnp.float32(0), width)) for width in (0.3, 0.5, 1.0)]
    assert found == [math.inf, 3.0, 2.0]


def test_a_place_that_looks_like_none_is_not_passed_where_the_route_has_one():
    for centre, is_it in ((10.5, True), (9.0, False)):
        assert bool(is_next(a_guide(), jnp.array([centre, 0.0]))) == is_it


def test_a_robot_starts_where_it_can_turn():
    """A post is before it where it would start, 1.5 m along; one metre along it is free."""
    occupied = np.ones((40, 80), bool)
    occupied[1:-1, 1:-1] = False
    nodes = Node(0, 1.0, 2.0, "divergence"), Node(1, 7.0, 2.0, "divergence")
    btm = BtmMap(nodes, (Link(0, 0, 1, "searched", 0.0, 180.0, 6.0, 1.0),))
    route = jx.btm.route(btm, "wheeled", 0, 1)
    begun = []
    for post in (False, True):
        occupied[20, 28] = post
        world = World(occupied=occupied.copy(), cell_m=0.1)
        begun.append(following.start_of(world, building_of(world), ROBOTS["wheeled"], btm, route)[1])
    assert begun == [1.5, 1.0]


def test_a_robot_starts_beside_a_link_that_the_map_has_in_a_wall():
    occupied = np.ones((40, 80), bool)
    occupied[10:30, 1:-1] = False
    nodes = Node(0, 1.0, 1.1, "divergence"), Node(1, 7.0, 1.1, "divergence")
    btm = BtmMap(nodes, (Link(0, 0, 1, "searched", 0.0, 180.0, 6.0, 1.0),))
    world = World(occupied=occupied, cell_m=0.1)
    pose, metres, beside = following.start_of(
        world, building_of(world), ROBOTS["wheeled"], btm, jx.btm.route(btm, "wheeled", 0, 1)
    )
    assert beside == pytest.approx((0.0, 0.3))
    np.testing.assert_allclose(pose, (1.0 + metres, 1.4, 0.0), atol=1e-5)
