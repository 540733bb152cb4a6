"""Behavioral Trace Maps read off grid maps: hand-made passages against formulas, laws, the course."""

import math

import numpy as np
import pytest

from jexplore.extraction.extract import extract
from jexplore.tracemap.record import NOWHERE
from jexplore.worlds import load_world

pytestmark = pytest.mark.jit

CELL_M = 0.1
W = 2.0  # width of the passages, metres
SIDE = 121
TOLERANCE_M = 2 * CELL_M


def board(*rects):
    """Free space as a union of rectangles (row, col, row, col), the last ones exclusive."""
    free = np.zeros((SIDE, SIDE), bool)
    for row, col, to_row, to_col in rects:
        free[row:to_row, col:to_col] = True
    return free


ALONG = (50, 5, 70, 115)
START = (60, 20)
STRAIGHT = board(ALONG)
CORNER = board((50, 5, 70, 115), (5, 95, 70, 115))
TEE = board(ALONG, (5, 50, 70, 70))
CROSSING = board(ALONG, (5, 50, 115, 70))
HALL = board((50, 5, 70, 30), (25, 30, 95, 90), (50, 90, 70, 115))
SHAPES = {"straight": STRAIGHT, "corner": CORNER, "tee": TEE, "crossing": CROSSING, "hall": HALL}


def mapped(free, known=None, start=START, **changes):
    known = np.ones_like(free) if known is None else known
    return extract(free & known, known, CELL_M, start_rc=start, **changes)


def node_at(found, x_m, y_m, tolerance_m=TOLERANCE_M):
    (node,) = [node for node in found.nodes if math.hypot(node.x_m - x_m, node.y_m - y_m) <= tolerance_m]
    return node


def types(found):
    return [node.type for node in found.nodes]


def bearings(found, node):
    return found.bearings_deg(node.id)


def near_deg(found, expected, tolerance=12):
    def apart(a, b):
        return abs((a - b + 180) % 360 - 180)

    return len(found) == len(expected) and all(min(apart(a, b) for a in found) <= tolerance for b in expected)


# ---------------------------------------------------------------- by formula


def test_a_straight_passage_has_a_dead_end_at_either_end():
    """Half the width from the wall. A length is that of the axis, a width that between the walls."""
    found = mapped(STRAIGHT)
    assert types(found) == ["terminal", "divergence"]  # the start stands in the disc of the other
    assert (found.nodes[0].x_m, found.nodes[0].y_m) == pytest.approx((2.05, 6.05))
    end = node_at(found, 11.5 - W / 2, 6.0)
    (link,) = found.links
    assert (link.start, link.end, link.status) == (0, end.id, "searched")
    assert link.length_m == pytest.approx(end.x_m - 2.05, abs=TOLERANCE_M)
    assert link.min_width_m == pytest.approx(W)
    assert near_deg([link.start_bearing_deg], [0])
    assert near_deg([link.end_bearing_deg], [180])
    found = mapped(STRAIGHT, start=(60, 60))
    assert types(found) == ["terminal", "divergence", "divergence"]
    node_at(found, 0.5 + W / 2, 6.0)
    assert near_deg(bearings(found, found.nodes[0]), [0, 180])


def test_a_t_lies_an_eighth_off_the_axis_on_the_side_of_its_stem():
    found = mapped(TEE)
    assert types(found) == ["terminal", *["divergence"] * 3]
    tee = node_at(found, 6.0, 6.0 - W / 8, CELL_M)
    assert near_deg(bearings(found, tee), [0, 180, 270])
    # the first way counter-clockwise from the entry, which lies behind, is the one to the right
    node_at(found, 6.0, 0.5 + W / 2)
    assert [(link.start, link.end) for link in found.links] == [(0, 1), (1, 2), (1, 3)]
    assert found.nodes[2].y_m < 2
    assert found.nodes[3].x_m > 10


def test_a_hall_on_the_way_gives_a_pair_of_nodes_at_its_doors():
    found = mapped(HALL)
    assert types(found) == ["terminal", "free_space", "free_space", "divergence"]
    one, two = node_at(found, 3.0, 6.0, 0.5), node_at(found, 9.0, 6.0, 0.5)
    assert [(link.start, link.end) for link in found.links] == [(0, one.id), (one.id, two.id), (two.id, 3)]
    assert found.links[1].length_m == pytest.approx(two.x_m - one.x_m, abs=0.5)
    node_at(found, 10.5, 6.0)
    # where even halls count as narrow, its two ends are junctions
    assert "free_space" not in types(mapped(HALL, open_m=4.0))


def test_the_doors_of_a_hall_are_linked_in_a_ring():
    free = HALL | board((5, 50, 30, 70), (90, 50, 115, 70))
    found = mapped(free)
    doors = [node.id for node in found.nodes if node.type == "free_space"]
    assert len(doors) == 4
    ring = [link for link in found.links if link.start in doors and link.end in doors]
    assert len(ring) == 4
    assert all(sum(door in (link.start, link.end) for link in ring) == 2 for door in doors)
    assert all(len(found.bearings_deg(door)) == 3 for door in doors)
    for link in ring:
        one, two = found.nodes[link.start], found.nodes[link.end]
        assert min(abs(one.x_m - two.x_m), abs(one.y_m - two.y_m)) > 2  # never straight across


# ---------------------------------------------------------------- unknown and closed parts


def test_a_smaller_room_behind_a_door_is_a_dead_end():
    free = board((50, 5, 70, 30), (38, 30, 82, 72), (55, 72, 64, 74), (44, 74, 76, 106))
    found = mapped(free, start=(60, 12))
    room = node_at(found, 9.0, 6.0, 0.3)
    assert room.type == "divergence"
    assert near_deg(bearings(found, room), [180])


@pytest.mark.parametrize(("first_row", "first_col"), [(50, 60), (60, 66)])
def test_a_room_with_doors_in_two_walls_is_a_corner_that_leads_on(first_row, first_col):
    doors = (first_row, 50, first_row + 9, 52), (70, first_col, 72, first_col + 9)
    found = mapped(board((50, 5, 70, 50), (38, 52, 70, 84), (72, 52, 105, 84), *doors), start=(60, 12))
    corner = node_at(found, 6.8, 5.4, 0.5)
    assert near_deg(bearings(found, corner), [90, 170], 25)
    assert any(node.y_m > 7.2 for node in found.nodes), "the room beyond"


def test_a_way_into_the_unknown_is_an_unsearched_link():
    known = np.ones_like(TEE)
    known[:40] = False
    found = mapped(TEE, known)
    assert types(found) == ["terminal", "divergence", "divergence"]
    tee = node_at(found, 6.0, 6.0 - W / 8)
    (link,) = [link for link in found.links if link.end == NOWHERE]
    assert (link.start, link.status, link.length_m, link.end_bearing_deg) == (tee.id, "un-searched", None, None)
    assert near_deg([link.start_bearing_deg], [270])
    assert link.opening_m == pytest.approx(W)


def test_a_passage_that_ends_in_the_unknown_is_no_free_space():
    known = np.ones_like(STRAIGHT)
    known[:, 60:] = False
    found = mapped(STRAIGHT, known)
    assert types(found) == ["terminal"]
    assert [(link.start, link.end) for link in found.links] == [(0, NOWHERE)]


def test_gaps_in_a_wall_seen_from_far_are_no_ways():
    known = np.ones_like(STRAIGHT)
    known[:50], known[70:] = False, False
    known[[49, 70]] = True
    known[[49, 70], 60:100] = np.arange(40) % 6 == 0
    found = mapped(STRAIGHT, known)
    assert types(found) == ["terminal", "divergence"]
    assert [link.end for link in found.links] == [1]


@pytest.mark.parametrize("cells", [3, 5])
def test_a_door_narrower_than_the_robot_is_closed(cells):
    free = board(ALONG, (5, 50, 40, 70), (40, 58, 50, 58 + cells))
    wide = mapped(free, width_m=0.3)
    assert len(wide.nodes) > 2
    assert min(link.min_width_m for link in wide.links) == pytest.approx(cells * CELL_M)
    found = mapped(free, width_m=0.39)
    assert (len(found.nodes) > 2) == (cells > 3)
    assert len(mapped(free, width_m=0.6).nodes) == 2


# ---------------------------------------------------------------- terminals and small maps


def test_only_what_can_be_reached_and_a_room_without_a_junction():
    below, above = board((5, 5, 25, 115)), board((80, 5, 100, 60))
    assert mapped(below | above, start=(90, 30)) == mapped(above, start=(90, 30))  # what the start can reach
    assert mapped(below | above, start=None) == mapped(below, start=None)  # without, the largest part
    for rect in ((50, 50, 70, 70), (60, 60, 61, 61), (20, 20, 100, 100)):
        found = mapped(board(rect), start=(60, 60))
        assert types(found) == ["terminal"]
        assert found.links == ()


def test_legs_of_a_table_are_looked_through():
    """And are not, if one says so: a passage round either side of each."""
    with_legs = TEE.copy()
    for row, col in ((58, 30), (62, 30), (58, 36), (62, 36), (60, 90)):
        with_legs[row : row + 2, col : col + 2] = False
    plain, found = mapped(TEE), mapped(with_legs)
    assert found == plain
    assert len(mapped(with_legs, clutter_m=0.0).links) > len(plain.links)


# ---------------------------------------------------------------- laws


def signature(found):
    ends = sorted(tuple(sorted((link.start, link.end))) for link in found.links)
    return [(node.type, len(found.bearings_deg(node.id))) for node in found.nodes], ends


@pytest.mark.parametrize("shape", SHAPES)
def test_roughness_of_one_cell_makes_no_nodes(shape):
    free = SHAPES[shape]
    rough = free.copy()
    wall = sum(np.roll(~free, shift, axis) for axis in (0, 1) for shift in (-1, 1)) > 0
    rough[free & wall & (np.random.default_rng(2).random(free.shape) < 0.2)] = False
    smooth, found = mapped(free), mapped(rough)
    assert signature(found) == signature(smooth)
    for one, two in zip(smooth.nodes, found.nodes):
        tolerance_m = 2 * TOLERANCE_M if one.type == "free_space" else TOLERANCE_M
        assert math.hypot(one.x_m - two.x_m, one.y_m - two.y_m) <= tolerance_m


def test_the_origin_moves_all_and_the_cell_scales_all():
    found, moved = mapped(TEE), mapped(TEE, origin_m=(-3.0, 7.0))
    for one, two in zip(found.nodes, moved.nodes):
        assert (two.x_m, two.y_m) == pytest.approx((one.x_m - 3, one.y_m + 7))
    assert found.links == moved.links
    known = np.ones_like(TEE)
    double = extract(TEE, known, 2 * CELL_M, start_rc=START, width_m=0.78, open_m=5.0)
    assert signature(double) == signature(found)
    assert [link.length_m for link in double.links] == pytest.approx([2 * (link.length_m or 0) for link in found.links])


# ---------------------------------------------------------------- worlds


@pytest.mark.parametrize("name", ["course", "course#2", "course#4:loops=2", "course#1:repeat=3"])
def test_the_divergences_of_a_course_are_those_of_its_topology(name):
    world = load_world(name)
    assert world.course is not None
    x_m, y_m = world.course.start_pose[:2]
    start = (int((y_m - world.origin_m[1]) / world.cell_m), int((x_m - world.origin_m[0]) / world.cell_m))
    known = np.ones_like(world.occupied)
    found = extract(~world.occupied, known, world.cell_m, start_rc=start, origin_m=world.origin_m)
    truth = world.course.topology
    expected = [node for node in truth.nodes if node.type == "divergence"]
    assert len(expected) >= 2
    for node in expected:
        other = node_at(found, node.x_m, node.y_m, 2 * world.cell_m)
        assert other.type == "divergence"
        assert near_deg(bearings(found, other), truth.bearings_deg(node.id), 15)
    if world.course.goal_m is None:  # else ways that the robot does not take end in the wall
        assert types(found).count("divergence") == len(expected)
        assert len(found.links) - len(found.nodes) == len(truth.links) - len(truth.nodes)
    pairs = [node for node in truth.nodes if node.type == "free_space"]
    assert len(pairs) == types(found).count("free_space")
    for node in pairs:
        assert node_at(found, node.x_m, node.y_m, 0.6).type == "free_space"


def test_every_link_of_an_office_has_two_ends_and_all_nodes_are_connected():
    world = load_world("office#1")
    start = tuple(np.argwhere(~world.occupied)[2000].tolist())
    found = extract(~world.occupied, np.ones_like(world.occupied), world.cell_m, start_rc=start)
    assert [node.id for node in found.nodes] == list(range(len(found.nodes)))
    assert [link.id for link in found.links] == list(range(len(found.links)))
    assert len(found.nodes) > 40
    assert all(link.end != NOWHERE for link in found.links)
    reached = {0}
    for link in found.links:  # in the order in which they are met
        assert link.start in reached
        reached.add(link.end)
        one, two = found.nodes[link.start], found.nodes[link.end]
        assert link.length_m >= 0.9 * math.hypot(one.x_m - two.x_m, one.y_m - two.y_m)
        assert link.min_width_m >= 0.39 - 1e-9
    assert reached == set(range(len(found.nodes)))
