"""Robots that follow routes: which place they take for the map's, drives in the building, refusals."""

import dataclasses
import math

import numpy as np
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.config import InputError
from jexplore.driving.batch import building_of
from jexplore.driving.local.follow import Stop, recognised
from jexplore.driving.local.sight import SeenPlace, SeenWay
from jexplore.driving.settings import ROBOTS
from jexplore.studies.traces import following
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node
from jexplore.worlds import load_world
from jexplore.worlds.world import World

pytestmark = pytest.mark.jit
EAST, NORTH, WEST, SOUTH = (math.radians(a) for a in (0, 90, 180, 270))
T = WEST, EAST, SOUTH


def place(x, y, *bearings):
    ways = [SeenWay(bearing, -1, np.array([(x, y)])) for bearing in bearings]
    return SeenPlace(np.array([x, y]), "divergence", 0.7, True, ways)


@pytest.mark.parametrize(
    ("seen", "taken"),
    [
        ([place(11, 0, *T)], 0),
        ([place(9.8, 0, *T), place(10.2, 0, *T)], 1),  # the nearer one
        ([place(10.9, 0, WEST, EAST)], 0),  # a way less is no other place,
        ([place(10.9, 0, WEST, EAST), place(11.6, 0, *T)], 1),  # but counts as 0.7 m
        ([place(11, 0, WEST + 0.6, EAST + 0.6, SOUTH + 0.6)], 0),
        ([place(12.6, 0, *T)], None),
        ([place(10.9, 0, NORTH)], None),
        ([place(11.1, 1.2, *T)], None),  # nearer to another place of the map
        ([], None),
    ],
)
def test_the_place_near_the_map_s_with_its_exits_is_taken_for_it(seen, taken):
    """The map has it at (10, 0) and another at (10, 2); by the place before, both are a metre farther east."""
    stop, places = Stop(np.array([10.0, 0.0]), True, T, EAST), np.array([(10.0, 0.0), (10.0, 2.0)])
    found = recognised(seen, stop, places, np.array([1.0, 0.0]))
    assert found is (None if taken is None else seen[taken])


@pytest.mark.slow
def test_routes_are_driven_and_what_is_otherwise_is_written_back():
    """The map knows nothing of the stairs and of the wall in the building, nor of one of its ways; one it has twice."""
    btm = load_world("course:obstacle=none").course.topology
    open_link = next(link for link in btm.links if link.end == NOWHERE)
    same = next(link for link in btm.links if (link.start, link.end) == (3, 4))
    narrow = dataclasses.replace(same, id=99, min_width_m=0.1)
    kept = (link for link in btm.links if link.id != open_link.id)
    short = dataclasses.replace(btm, links=(*kept, narrow))
    building = load_world("course:obstacle=stairs")
    row, col = ((np.array([9.0, 13.0]) - building.origin_m[::-1]) / building.cell_m).astype(int)
    occupied = building.occupied.copy()
    occupied[row - 30 : row + 30, col : col + 3] = True
    building = dataclasses.replace(building, occupied=occupied)
    found = jx.btm.routes(short, ["wheeled"], [(1, 4), (4, 0), (3, 5)])[0]
    driven = jx.btm.follow(building, short, found, "wheeled", workers=1)
    assert driven.table["outcome"].tolist() == ["ARRIVED", "BLOCKED", "BLOCKED"]
    assert driven.table["off_m"].iloc[0] < 0.5
    assert driven.table["refused"].tolist() == [0, 1, 0]
    assert driven.table["refused_links"].tolist() == [1, 1, 1]
    links = {link.id: link for link in driven.map.links}
    first = next(link for link in btm.links if 0 in (link.start, link.end))
    who = {"name": "wheeled", "width_m": 0.39, "max_step_m": 0.03, "max_slope_deg": 5.0}
    assert links[first.id].attributes == {"blocked": True, "blocked_for": who, "found_by": "wheeled"}
    (new,) = [link for link in driven.map.links if link.attributes.get("found_by") and link.end == NOWHERE]
    assert new.start == open_link.start
    assert abs((new.start_bearing_deg - open_link.start_bearing_deg + 180) % 360 - 180) < 20
    shut = next(link for link in btm.links if 5 in (link.start, link.end))
    assert links[shut.id].attributes == {"blocked": True, "found_by": "wheeled"}
    assert len(driven.changes) == 3
    refused = dict(jx.btm.route(driven.map, "wheeled", 4, 0).refused)
    assert refused.keys() == {first.id, shut.id, 99}
    assert refused[first.id] == ("blocked for wheeled",)
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
        refused(message, jx.btm.follow, "course:obstacle=none", btm, routes, robot)


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
