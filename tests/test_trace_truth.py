"""Truth for a run: rooms drawn by hand, unreachable places, the course, and counts."""

import math

import numpy as np
import pytest

from jexplore.studies.traces.truth import REACHED_M, TraceTruth, false_divergences, maps_from, truth_of
from jexplore.tracemap.record import BtmMap, Node
from jexplore.tracemap.rooted import topology_from
from jexplore.worlds.generators.course import course
from jexplore.worlds.world import World

pytestmark = pytest.mark.jit

CELL_M = 0.1
WIDTH_M, OPEN_M = 0.39, 2.5
ORIGIN_M = -2.0, 1.0
CORNER = 5, 5  # of the first room: far from its middle
A, B, CLOSET = (0.4, 0.4, 3.6, 3.6), (3.8, 0.4, 6.2, 3.6), (6.4, 0.4, 7.6, 3.6)
DOOR = 3.6, 1.6, 3.8, 2.4


def drawn(*rooms, openings=(DOOR,), origin_m=(0.0, 0.0)):
    """A world of rectangles `(x0, y0, x1, y1)`, metres, the number of a room being its place."""
    occupied = np.ones((40, 80), bool)
    labels = np.full(occupied.shape, -1, np.int32)
    for number, rect in enumerate((*rooms, *openings)):
        x0, y0, x1, y1 = (round(v / CELL_M) for v in rect)
        occupied[y0:y1, x0:x1] = False
        if number < len(rooms):
            labels[y0:y1, x0:x1] = number
    return World(occupied=occupied, rooms=labels, cell_m=CELL_M, origin_m=origin_m)


def truth(world, start_rc=CORNER, width_m=WIDTH_M):
    return truth_of(world, start_rc, width_m, OPEN_M)


def near(marks, *places):
    """Return whether marks lie at places, in whatever order, within some two cells."""
    off = np.hypot(*(marks[:, None, :2] - np.array(places)[None]).transpose(2, 0, 1))
    return len(marks) == len(places) and set(off.argmin(axis=1)) == set(range(len(places))) and off.min(1).max() <= 0.25


def test_two_rooms_and_a_door():
    """A junction in the middle of either room, as far from the walls as these are apart by half."""
    found = truth(drawn(A, B))
    assert found.is_door.tolist() == [False, False, True]
    junctions, doors = found.marks[~found.is_door], found.marks[found.is_door]
    assert near(junctions, (2, 2), (5, 2))
    np.testing.assert_allclose(sorted(junctions[:, 2]), [1.2, 1.6], atol=0.1)
    assert near(doors, (3.7, 2))
    assert doors[0, 2] == REACHED_M
    assert [node.type for node in found.map.nodes] == ["divergence", "divergence"]


def test_marks_lie_in_the_worlds_frame():
    here, there = truth(drawn(A, B)), truth(drawn(A, B, origin_m=ORIGIN_M))
    np.testing.assert_allclose(there.marks, here.marks + np.array([*ORIGIN_M, 0]), atol=1e-9)
    at, moved = ((m.nodes[0].x_m, m.nodes[0].y_m) for m in (here.map, there.map))
    assert moved == pytest.approx((at[0] + ORIGIN_M[0], at[1] + ORIGIN_M[1]))


def test_without_true_rooms_there_are_no_doors():
    with_rooms = drawn(A, B)
    found = truth(with_rooms.replace(rooms=None))
    assert not found.is_door.any()
    np.testing.assert_array_equal(found.marks, truth(with_rooms).marks[:2])


def test_a_junction_counts_as_reached_within_half_a_metre_at_least():
    """The dead ends of a passage of 0.6 m are half of that from its walls."""
    found = truth(drawn((0.4, 1.0, 5.4, 1.6), openings=()), start_rc=(13, 29))
    assert near(found.marks, (0.7, 1.3), (5.1, 1.3))
    assert found.marks[:, 2].tolist() == [REACHED_M] * 2
    assert not found.is_door.any()


def test_a_closet_gives_marks_where_its_door_is_wide_enough():
    """A T before its door, an eighth of its width off the middle, and a dead end at either end."""
    doors = (6.2, 1.6, 6.4, 2.4), (6.2, 1.6, 6.4, 1.8)
    wide, narrow = (truth(drawn(A, B, CLOSET, openings=(DOOR, door))) for door in doors)
    assert near(wide.marks, (2, 2), (5, 2), (6.85, 2), (7, 1), (7, 3), (3.7, 2), (6.3, 2))
    assert near(narrow.marks, (2, 2), (5, 2), (3.7, 2))
    assert (wide.is_door.sum(), narrow.is_door.sum()) == (2, 1)


def test_a_robot_that_does_not_fit_through_the_door_stays_in_a_room_without_a_way_out():
    """Nothing divides or ends there: a lone room has no junction."""
    found = truth(drawn(A, B), width_m=0.9)
    assert found.marks.shape == (0, 3)
    assert found.map.nodes == ()


def test_the_start_may_be_nearer_to_a_wall_than_the_robot_fits():
    found, other = truth(drawn(A, B), start_rc=(4, 4)), truth(drawn(A, B))
    np.testing.assert_array_equal(found.marks, other.marks)


def test_a_junction_in_whose_circle_the_robot_starts_is_one_as_well():
    found = truth(drawn(A, B), start_rc=(20, 28))
    assert near(found.marks[~found.is_door], (2, 2), (5, 2))


def test_of_a_course_the_topology_is_taken():
    world = course(0)
    found = truth(world, start_of(world))
    assert found.map is world.course.topology
    places = [(n.x_m, n.y_m) for n in found.map.nodes if n.type in ("divergence", "free_space")]
    np.testing.assert_array_equal(found.marks[:, :2], places)
    assert len(places) < len(found.map.nodes)
    assert not found.is_door.any()
    assert (found.marks[:, 2] >= REACHED_M).all()


def maps(world, pose):
    return maps_from(world, truth(world, start_of(world)), pose)


def start_of(world):
    x_m, y_m, _ = world.course.start_pose
    return int(y_m / world.cell_m), int(x_m / world.cell_m)


def test_a_course_with_a_goal_is_true_from_its_start_alone():
    world = course(0)
    assert maps(world, world.course.start_pose) == (world.course.topology,)
    x_m, y_m, heading = world.course.start_pose
    assert maps(world, (x_m, y_m, heading + 360)) == (world.course.topology,)
    for pose in ((x_m + 0.1, y_m, heading), (x_m, y_m, heading + 180), (x_m, y_m, heading + 45)):
        assert maps(world, pose) == ()


def test_a_course_without_a_goal_is_true_as_begun_on_a_link():
    world = course(0, loops=1)  # its ring has the junction at (22.55, 10) and a side along y = 2
    topology = world.course.topology
    assert maps(world, world.course.start_pose) == (topology,)
    for pose in ((26.0, 2.3, 0.0), (26.0, 2.3, 135.0), (22.8, 13.0, 45.0), (8.0, 10.0, 180.0)):
        assert maps(world, pose) == (topology_from(topology, pose),)
    either = maps(world, (26.0, 2.3, 90.0))
    assert sorted(found.links[0].start_bearing_deg for found in either) == [0, 180]
    assert set(map(len, (either, maps(world, (22.8, 13.0, 180.0)), maps(world, (22.8, 13.0, 0.0))))) == {2}


@pytest.mark.parametrize(
    ("place", "count"), [((22.55, 10), 0), ((22.55, 11.2), 0), ((22.55, 11.3), 1), ((2.9, 10), 0), ((3.1, 10), 1)]
)
def test_a_start_in_the_circle_of_a_divergence_is_on_no_link(place, count):
    """That of the junction has a radius of 1.25 m, that of the dead end one of 1 m."""
    assert len(maps(course(0, loops=1), (*place, 45.0))) == count


def test_other_worlds_have_no_true_map():
    world = drawn(A, B)
    assert maps_from(world, truth(world), (2.0, 1.0, 0.0)) == ()


TRUTH = TraceTruth(
    map=BtmMap((), ()),
    marks=np.array([[1.0, 2.0, 0.5], [5.0, 2.0, 1.5], [8.0, 2.0, 0.5]]),
    is_door=np.array([False, False, True]),
)


def counted(*places, types="divergence", truth=TRUTH):
    """False divergences among nodes made at places; what the map says of where they lie is far off."""
    kinds = [types] * len(places) if isinstance(types, str) else types
    nodes = tuple(Node(id=i, x_m=90.0, y_m=90.0, type=kind) for i, kind in enumerate(kinds))
    return false_divergences(BtmMap(nodes, ()), np.array(places, float).reshape(-1, 2), truth)


@pytest.mark.parametrize(
    ("place", "is_false"),
    [((1, 2), 0), ((1, 2.5), 0), ((1, 2.51), 1), ((6.4, 2), 0), ((5, 0.4), 1), ((3, 2), 1), ((8, 2), 1)],
)
def test_a_divergence_far_from_every_junction_is_false(place, is_false):
    """The last one is at a door, which is no junction."""
    assert counted(place) == is_false


def test_every_false_divergence_counts_and_nothing_else():
    far = 20, 20
    assert counted() == 0
    assert counted(far, (1, 2), far, far, (5, 2)) == 3
    assert counted(far, far, far, far, types=["terminal", "divergence", "free_space", "obstacle"]) == 1


def test_where_there_is_no_junction_every_divergence_is_false():
    none = TRUTH._replace(marks=TRUTH.marks[2:], is_door=TRUTH.is_door[2:])
    assert counted((8, 2), (1, 2), truth=none) == 2


def test_nodes_are_looked_up_by_their_numbers():
    """The robot's second node stands first in the map."""
    nodes = tuple(Node(id=i, x_m=0.0, y_m=0.0, type=kind) for i, kind in ((1, "divergence"), (0, "terminal")))
    node_at = np.array([(20.0, 20.0), (1.0, 2.0), (math.nan, math.nan)])  # unused slots do not matter
    assert false_divergences(BtmMap(nodes, ()), node_at, TRUTH) == 0
    assert false_divergences(BtmMap(nodes, ()), node_at[[1, 0, 2]], TRUTH) == 1
