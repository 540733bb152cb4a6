"""Robots that follow routes: what a guide takes a place for, where it says to go on, and drives in the building."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.runs import a_due_node, a_state, place

import jexplore as jx
from jexplore import btm as maps
from jexplore.config import InputError
from jexplore.driving import behaviour
from jexplore.driving.batch import MAX_STEPS, building_of, step_slots
from jexplore.driving.guiding import guide as guides
from jexplore.driving.guiding import leaving, steering
from jexplore.driving.links import reach_m
from jexplore.driving.mission import RunResult
from jexplore.driving.records import Latch
from jexplore.driving.sensing import surround
from jexplore.driving.settings import ROBOTS, Tuning
from jexplore.studies.traces import following
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node
from jexplore.worlds import load_world
from jexplore.worlds.world import World

pytestmark = pytest.mark.jit
EAST, NORTH, WEST, SOUTH = (math.radians(a) for a in (0, 90, 180, 270))
T = WEST, EAST, SOUTH  # the ways of the first place
CROSSING = NORTH, EAST, WEST, SOUTH  # of the second


LEGS = (10.0, 0.0), (0.0, -6.0)


def a_guide(out=(SOUTH, EAST), ways=(T, CROSSING), leg=LEGS, length_m=(10.0, 6.0), tail_m=5.0, **more):
    """From (0, 0) ten metres east, six south, then east."""
    end_leg = tail_m * math.cos(out[-1]), tail_m * math.sin(out[-1])
    more = {"end_leg": end_leg, "node_xy": (0.0, 0.0), "start_m": 1.0, "size": 4, **more}
    return jax.tree.map(jnp.asarray, guides.guide_of(out, ways, leg, length_m, tail_m=tail_m, **more))


@jax.jit
def matched(guide, odometer_m, centre, found, when, free_m):
    return guides.match_place(guide, odometer_m, centre, found, when, lambda place, bearing: free_m)


def met(guide, odometer_m, centre, found, when=True, free_m=0.0):
    """The guide after a place, and the bearing of the way on, degrees in [0, 360)."""
    numbers = jnp.float32(odometer_m), jnp.array(centre, float), found, jnp.bool_(when), jnp.float32(free_m)
    after, onward = matched(guide, *numbers)
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


@pytest.mark.parametrize(
    ("off", "ways", "free_m", "taken"),
    [
        ((0.0, 0.5), (WEST, SOUTH), 0.0, True),  # a way less or more is no other place
        ((0.0, 0.5), (WEST, EAST, SOUTH, NORTH), 0.0, True),
        ((0.0, 0.3), (WEST, EAST), 0.0, True),  # where the map has the place it is met whatever is seen there
        ((0.0, 0.5), (WEST, EAST), 0.0, False),
        ((2.5, 0.0), T, 0.0, True),  # within 0.2 * 10 + 1.5
        ((2.5, 0.0), (WEST, SOUTH), 0.0, False),  # and not within 0.1 * 10 + 1.0
        ((4.0, 0.0), T, 0.0, False),
        ((0.0, 0.5), (WEST, EAST, NORTH), 1.9, False),
        ((0.0, 0.5), (WEST, EAST, NORTH), 2.1, True),  # its way on is no opening, but free
    ],
)
def test_a_place_somewhat_off_must_have_the_very_ways(off, ways, free_m, taken):
    after, bearing = met(a_guide(), 9.0, np.add((10.0, 0.0), off), place(*ways), free_m=free_m)
    assert counts(after) == (int(taken), 0, int(not taken))
    if taken:
        assert bearing == pytest.approx(180 + math.degrees(math.atan2(6, off[0])))


def test_a_place_nearer_to_another_of_the_map_is_none_of_the_route():
    """Seen 0.9 m beyond; another one is there, 1.0 m beyond."""
    for others, taken in (((), True), ([[(0.0, 9.0), (1.0, 0.0)], []], False), ([[(5.0, 0.0)], []], True)):
        after, _ = met(a_guide(others=others), 9.0, (10.9, 0.0), place(*T))
        assert counts(after) == (int(taken), 0, int(not taken))


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


FAR = np.full(surround.DIRECTIONS, 5.0)  # the way is free all round
UNNAMED = dataclasses.replace(ROBOTS["wheeled"], name="")


progress = jax.jit(steering.update_progress)


def on_the_way(guide, odometer_m, position=(5.0, 0.0), blocked=False, ways_m=FAR):
    numbers = jnp.float32(odometer_m), jnp.array([*position, 0.0]), jnp.asarray(ways_m, jnp.float32)
    return progress(guide, *numbers, jnp.bool_(blocked), UNNAMED)


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


@pytest.mark.slow
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
    past = a_guide().replace(at=jnp.int32(2), from_xy=jnp.array([10.0, -6.0]))  # before the end, at (15, -6)
    for x, way, walled in ((13.4, WEST, True), (13.4, EAST, False), (13.6, WEST, False)):  # there it is the end's own
        assert bool(met(past, 20.0, (x, -6.0), place(way))[0].walled) == walled


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
        ([], "wheeled", "one jx.btm.Route or more"),
        ([here], "wheeled", "with a link or more"),
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


steer = jax.jit(lambda *given: steering._steered(*given, Tuning(), ROBOTS["wheeled"]))


def steered(guide, at, ways_m=FAR):
    """Return the result of steering at x, y, heading in degrees: the guide, the `Drive`, the `Track`."""
    nowhere = jnp.array([(99.0, 99.0)])
    pose = jnp.array([*at[:2], math.radians(at[2])])
    given = behaviour.initial_drive(), behaviour.empty_track(), pose, jnp.asarray(ways_m, jnp.float32)
    return steer(a_state(), guide, *given, (nowhere, nowhere))


STRAY = {"strays": jnp.bool_(True), "at": jnp.int32(1), "from_xy": jnp.array([10.0, 0.0])}  # the next lies 6 m south


def test_a_robot_astray_steers_for_the_next_place_by_the_free_way_nearest_to_it():
    guide = a_guide().replace(**STRAY)
    after, drive, _ = steered(guide, (8.0, -6.0, 90))  # two metres west of the visible place
    assert (int(drive.latch), bool(after.steers)) == (Latch.LEAVE, True)
    assert math.cos(drive.out) == pytest.approx(1)
    np.testing.assert_allclose(drive.target, (9.0, -6.0), atol=1e-5)
    shut = np.where(np.abs(surround.DIRECTION + math.pi / 2) < 0.4, 0.2, 5.0)  # to the right, where the place lies
    _, drive, _ = steered(guide, (8.0, -6.0, 90), ways_m=shut)
    assert math.degrees(drive.out) == pytest.approx(25)  # the free one that is less of a turn


# How it leaves a place


leave = jax.jit(leaving.leave_place)


def left(guide, found, points, ways=(WEST, EAST), turned=(0.0, (0.0, 0.0, 0.0))):
    """The link, its bearing in degrees, whether it is new, and the guide, at (10, 0.5)."""
    map_, node = maps.add_node(maps.empty(4, 8), maps.DIVERGENCE, 10.0, 0.5)
    for bearing in ways:
        map_, _ = maps.add_link(map_, node, bearing)
    event = a_due_node(odometer_m=jnp.float32(9.0), centre=jnp.array([10.0, 0.5]))
    given = map_, a_state().writer.replace(guide=guide), event, node, found, jnp.bool_(True), points
    turned = jnp.float32(turned[0]), jnp.array(turned[1], jnp.float32)
    after, written, link, bearing, onward = leave(*given, (jnp.int32(0), jnp.float32(0)), turned)
    return int(link), math.degrees(float(bearing)) % 360, int(written.n_links) > len(ways), after, onward


def walls(*points):
    """Points, with unused slots: one program for all."""
    return jnp.zeros((16, 2)).at[: len(points)].set(jnp.array(points, float)), jnp.arange(16) < len(points)


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


def test_a_strip_is_free_as_far_as_the_nearest_point_in_it():
    points = walls((3.0, 0.2), (2.0, 0.4), (-1.0, 0.0))
    found = [float(reach_m(points, jnp.zeros(2), jnp.float32(0), width)) for width in (0.3, 0.5, 1.0)]
    assert found == [math.inf, 3.0, 2.0]


@pytest.mark.parametrize(("steps", "slots"), [(1, 1), (MAX_STEPS, 1), (MAX_STEPS + 1, 2), (2 * MAX_STEPS + 1, 4)])
def test_buffers_of_steps_double(steps, slots):
    assert step_slots(steps) == slots * MAX_STEPS


def test_a_goal_is_taken_into_the_frame_of_the_building():
    world = World(occupied=np.ones((4, 4), bool), cell_m=0.1, origin_m=(-3.0, 2.0))
    np.testing.assert_allclose(building_of(world, goal_m=(1.0, 4.0)).goal, (4.0, 2.0))


def start(occupied, y_m):
    nodes = Node(0, 1.0, y_m, "divergence"), Node(1, 7.0, y_m, "divergence")
    btm = BtmMap(nodes, (Link(0, 0, 1, "searched", 0.0, 180.0, 6.0, 1.0),))
    world, robot = World(occupied=occupied, cell_m=0.1), ROBOTS["wheeled"]
    return following.start_of(world, building_of(world), robot, btm, jx.btm.route(btm, "wheeled", 0, 1))


def test_a_robot_starts_where_it_can_turn():
    """A post is before it where it would start, 1.5 m along; one metre along it is free. A link may lie in a wall."""
    occupied = np.ones((40, 80), bool)
    occupied[1:-1, 1:-1] = False
    assert start(occupied, 2.0)[1] == 1.5
    occupied[20, 28] = True
    assert start(occupied, 2.0)[1] == 1.0
    occupied[:10] = occupied[30:] = True
    pose, metres, aside = start(occupied, 1.1)
    assert aside == pytest.approx((0.0, 0.3))
    np.testing.assert_allclose(pose, (1.0 + metres, 1.4, 0.0), atol=1e-5)
