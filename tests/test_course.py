"""The course: seed 0 by pencil, then laws that look at the cells alone and compare them with the topology."""

import math

import jax
import numpy as np
import pytest

from jexplore.config import InputError
from jexplore.tracemap.record import NOWHERE
from jexplore.worlds import load_world
from jexplore.worlds.generators.course import course
from jexplore.worlds.generators.course_map import render_course
from jexplore.worlds.generators.route import LEFT, RIGHT, STRAIGHT, CourseRoute, largest_circle
from jexplore.worlds.starts import check_start, clear_of_walls, label_components
from jexplore.worlds.world import pad, with_ring

SEEDS = range(31)
STEP = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}
LETTERS = {"terminal": "T", "obstacle": "O", "divergence": "D", "free_space": "F"}


@pytest.fixture(scope="module")
def courses():
    return {seed: course(seed) for seed in SEEDS}


def types(world):
    return "".join(LETTERS[node.type] for node in world.course.topology.nodes)


def is_free(world, x, y):
    """Return whether the cell of a point is free, from the convention of `Course`."""
    row = math.floor((y - world.origin_m[1]) / world.cell_m + 1e-6)
    col = math.floor((x - world.origin_m[0]) / world.cell_m + 1e-6)
    return not world.occupied[row, col]


def sight(world, x, y, bearing_deg, high_m=60.0):
    """Distance to the first occupied cell in an axis direction, metres, to half a cell."""
    dx, dy = STEP[bearing_deg % 360]
    for distance in np.arange(0, high_m, world.cell_m / 2):
        if not is_free(world, x + dx * distance, y + dy * distance):
            return float(distance)
    return high_m


def width_at(world, x, y, bearing_deg):
    """Free width across a bearing, metres, in whole cells."""
    (dx, dy), cell = STEP[bearing_deg % 360], world.cell_m
    n = 1
    for side in (-1, 1):
        k = 1
        while is_free(world, x - dy * side * k * cell, y + dx * side * k * cell):
            k += 1
        n += k - 1
    return n * cell


def touched(world, x, y):
    """Radius of the largest empty circle about a point and directions of its contacts, degrees, one a wall."""
    rows, cols = np.nonzero(world.occupied)
    half = world.cell_m / 2
    gap_x, gap_y = ((index + 0.5) * world.cell_m - at for index, at in ((cols, x), (rows, y)))
    near_x = np.sign(gap_x) * np.maximum(np.abs(gap_x) - half, 0)
    near_y = np.sign(gap_y) * np.maximum(np.abs(gap_y) - half, 0)
    distance = np.hypot(near_x, near_y)
    touching = distance <= distance.min() + 1e-8
    return distance.min(), np.unique(np.round(np.degrees(np.arctan2(near_y, near_x))[touching], 3) % 360)


# Seed 0, by pencil


def test_the_course_of_the_paper_has_its_nodes_where_a_pencil_puts_them(courses):
    world = courses[0]
    assert types(world) == "TOOODFFDT"
    found = [(node.x_m, node.y_m) for node in world.course.topology.nodes]
    eighth = 2.0 / 8
    expected = [
        (2.5, 27), (6.65, 27), (9.05, 27), (11.45, 27), (17.4 - eighth, 27),
        (17.4, 21), (17.4, 15), (17.4 - eighth, 9), (11.4, 9),
    ]  # fmt: skip
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert world.course.start_pose == (2.5, 27.0, 0.0)
    assert world.course.goal_m == (11.4, 9.0)
    assert [node.inclination_deg for node in world.course.topology.nodes[1:4]] == [10.0] * 3
    assert {node.obstacle for node in world.course.topology.nodes} == {None, "slope"}


def test_the_course_of_the_paper_has_its_links(courses):
    links = courses[0].course.topology.links
    assert [(link.start, link.end) for link in links] == [(k, k + 1) for k in range(8)] + [(4, NOWHERE), (7, NOWHERE)]
    assert [link.status for link in links] == ["searched"] * 8 + ["un-searched"] * 2
    assert [link.start_bearing_deg for link in links] == [0, 0, 0, 0, 270, 270, 270, 180, 90, 270]
    assert [link.end_bearing_deg for link in links] == [180, 180, 180, 180, 90, 90, 90, 0, None, None]
    assert [link.length_m for link in links] == [4.15, 2.4, 2.4, 5.7, 6, 6, 6, 5.75, None, None]
    assert [link.min_width_m for link in links] == [2.0] * 8 + [None] * 2
    assert [link.opening_m for link in links] == [2.0] * 10


def test_the_course_of_the_paper_has_its_walls(courses):
    world = courses[0]
    assert world.shape == (360, 244)
    expected = np.ones(world.shape, bool)
    expected[260:280, 10:164] = False  # from the start to the first junction
    expected[10:350, 164:184] = False  # the long passage from north to south
    expected[150:210, 184:234] = False  # the hall, to the left of the robot
    expected[80:100, 44:164] = False  # the way to the goal and on
    np.testing.assert_array_equal(world.occupied, expected)


def test_the_slope_of_the_paper_has_10_degrees(courses):
    world = courses[0]
    rise = math.tan(math.radians(10)) * world.cell_m
    profile = world.elevation[270].astype(float)
    steps = np.zeros(world.shape[1] - 1)
    steps[66:90], steps[90:114] = rise, -rise  # creases in the middles of cells 66, 90 and 114
    np.testing.assert_allclose(np.diff(profile), steps, atol=1e-6)
    assert profile.max() == pytest.approx(2.4 * math.tan(math.radians(10)))
    np.testing.assert_array_equal(world.elevation[256:284], np.broadcast_to(world.elevation[270], (28, 244)))
    assert not world.elevation[:250].any()
    assert world.elevation.dtype == np.float32


def test_stairs_have_treads_and_risers():
    world = course(0, obstacle="stairs", riser_m=0.15)
    up = np.repeat(np.arange(1, 9), 3) * 0.15
    expected = np.concatenate([np.zeros(66), up, up[::-1], np.zeros(244 - 114)])
    np.testing.assert_allclose(world.elevation[270], expected, atol=1e-6)
    stairs = world.course.topology.nodes[1:5]  # the foot, both ends of the landing, the foot
    assert [(node.obstacle, node.step_m, node.inclination_deg) for node in stairs] == [("stairs", 0.15, None)] * 4
    np.testing.assert_allclose([node.x_m for node in stairs], [6.6, 8.7, 9.3, 11.4])


def test_a_platform_is_one_step_up_and_one_down():
    world = course(0, obstacle="platform", riser_m=0.12)
    expected = np.concatenate([np.zeros(66), np.full(48, 0.12), np.zeros(244 - 114)])
    np.testing.assert_allclose(world.elevation[270], expected, atol=1e-6)
    nodes = world.course.topology.nodes[1:3]
    assert [(node.obstacle, node.step_m) for node in nodes] == [("stairs", 0.12)] * 2
    np.testing.assert_allclose([node.x_m for node in nodes], [6.6, 11.4])


def test_a_sill_lies_in_the_middle():
    world = course(0, obstacle="sill", riser_m=0.06)
    expected = np.concatenate([np.zeros(89), np.full(2, 0.06), np.zeros(244 - 91)])
    np.testing.assert_allclose(world.elevation[270], expected, atol=1e-6)
    (node,) = [node for node in world.course.topology.nodes if node.type == "obstacle"]
    assert (node.obstacle, node.step_m, node.inclination_deg) == ("stairs", 0.06, None)
    assert node.x_m == pytest.approx(9.0)


@pytest.mark.parametrize("cell_m", [0.05, 0.2])
def test_a_sill_is_a_cell_long_on_either_side_at_least(cell_m):
    for seed in (0, 1, 2):
        world = course(seed, obstacle="sill", riser_m=0.06, cell_m=cell_m)
        (node,) = [node for node in world.course.topology.nodes if node.type == "obstacle"]
        row, col = int(node.y_m / cell_m), int(node.x_m / cell_m)
        assert world.elevation[row, col] == pytest.approx(0.06)
        assert world.elevation.max() == pytest.approx(0.06)


def test_a_cross_slope_twists_to_its_angle_and_back():
    world = course(0, obstacle="cross-slope")
    middle = world.elevation[260:280, 90]  # the passage is 2 m wide, rows 260 to 279
    np.testing.assert_allclose(np.diff(middle) / 0.1, math.tan(math.radians(10)), atol=1e-5)
    assert middle.mean() == pytest.approx(0, abs=1e-6)  # it rises to one side by as much as it falls to the other
    twist = world.elevation[279, 64:80]
    assert (np.diff(twist)[3:11] > 0).all()
    np.testing.assert_allclose(twist[:2], 0)
    nodes = [node for node in world.course.topology.nodes if node.type == "obstacle"]
    assert [(node.obstacle, node.inclination_deg) for node in nodes] == [("slope", 10.0)] * 2
    np.testing.assert_allclose([node.x_m for node in nodes], [7.1, 10.9])


def test_without_the_slope_the_layout_is_the_same(courses):
    world = load_world("course:obstacle=none")
    assert types(world) == "TDFFDT"
    assert world.elevation is None
    np.testing.assert_array_equal(world.occupied, courses[0].occupied)
    assert world.course.topology.links[0].length_m == pytest.approx(14.65)
    for seed in (1, 2, 3):
        level = course(seed, obstacle="none")
        np.testing.assert_array_equal(level.occupied, courses[seed].occupied)
        assert types(level) == types(courses[seed]).replace("O", "")


def test_circles_by_pencil():
    square, wide = (0.0, 0.0, 2.0, 2.0), (0.0, 0.0, 2.0, 1.4)
    assert largest_circle(square, {1, 2, 3}) == pytest.approx((0.75, 1.0, 1.25))  # T, far wall in the east
    assert largest_circle(square, {0, 2, 3}) == pytest.approx((1.0, 0.75, 1.25))  # T, far wall in the north
    x, y, radius = largest_circle(square, {2, 3})  # corner, outer walls in the east and the north
    assert (2 - x, 2 - y, radius) == pytest.approx([2 * (2 - 2**0.5)] * 3)
    assert largest_circle(square, {3}) == pytest.approx((1.0, 1.0, 1.0))
    assert largest_circle(wide, {0}) == pytest.approx((0.7, 0.7, 0.7))
    assert largest_circle(wide, {0, 1, 2, 3}) == pytest.approx((1.0, 0.7, math.hypot(1.0, 0.7)))
    x, y, radius = largest_circle(wide, {0, 1, 2})  # far wall in the south, corners (0, 1.4) and (2, 1.4)
    assert (x, y) == pytest.approx((1.0, radius))
    assert math.hypot(1.0, 1.4 - y) == pytest.approx(radius)


def test_a_dead_end_to_the_right_comes_first_and_leads_back():
    route = CourseRoute(0, 2.0, 1.5)
    route.passage(4.5)
    route.junction((STRAIGHT, RIGHT, LEFT), 2.0, 6.0, dead_m=5.0)
    route.goal(5.0, 6.0)
    topology = render_course(route, 0.1, "slope", 0.1).course.topology
    assert [node.type for node in topology.nodes] == ["terminal", "divergence", "divergence", "terminal"]
    assert [(link.start, link.end, link.start_bearing_deg) for link in topology.links] == [
        (0, 1, 0.0), (1, 2, 270.0), (1, 3, 0.0), (1, NOWHERE, 90.0),
    ]  # fmt: skip
    np.testing.assert_allclose([link.length_m for link in topology.links[:3]], [4.5 + 1, 5.0, 5.0 + 1])


# Laws


def test_every_course_is_sound(courses):
    for world in courses.values():
        occupied = world.occupied
        assert world.rooms is None
        assert with_ring(world) is world
        assert label_components(~occupied).max() == 0
        assert label_components(clear_of_walls(occupied, 0.59, world.cell_m)).max() == 0, "1.2 m wide everywhere"
        assert types(world)[0] == types(world)[-1] == "T"
        assert types(world).count("OOO") == 1
        start_x, start_y, heading = world.course.start_pose
        place = int(start_y / world.cell_m), int(start_x / world.cell_m), int(heading)
        assert world.start == place
        assert check_start(world, place, 0.3) == place
        assert is_free(world, *world.course.goal_m)
        assert sight(world, start_x, start_y, heading + 180) == pytest.approx(1.5, abs=world.cell_m)


def test_nothing_ends_a_passage_near_the_goal(courses):
    for world in courses.values():
        ahead = (world.course.topology.links[-1 - unsearched(world)].end_bearing_deg + 180) % 360
        assert sight(world, *world.course.goal_m, ahead) >= 6.0


def unsearched(world):
    return sum(link.end == NOWHERE for link in world.course.topology.links)


def test_a_divergence_is_the_largest_circle_between_three_walls(courses):
    count = 0
    for world in courses.values():
        topology = world.course.topology
        for node in topology.nodes:
            if node.type != "divergence":
                continue
            radius, contacts = touched(world, node.x_m, node.y_m)
            assert len(contacts) >= 3, "cells of one wall touch in one point, and so do corners"
            gaps = np.diff([*contacts, contacts[0] + 360])
            assert gaps.min() > 30
            assert gaps.max() < 180.01, "it cannot grow by moving"
            assert 0.59 < radius < 1.8
            assert len(contacts) == 4 if len(topology.bearings_deg(node.id)) == 4 else len(contacts) == 3
            count += 1
    assert count > 100


def test_the_links_of_a_divergence_are_its_openings(courses):
    seen = set()
    for world in courses.values():
        topology = world.course.topology
        for node in topology.nodes:
            if node.type == "divergence":
                open_ways = [b for b in STEP if sight(world, node.x_m, node.y_m, b) > 3.0]
                assert topology.bearings_deg(node.id) == open_ways
                seen.add(len(open_ways))
            else:
                bearings = topology.bearings_deg(node.id)
                assert len(bearings) == (1 if node.type == "terminal" else 2)
    assert seen == {1, 2, 3, 4}


def test_ways_not_taken_go_on_for_6_m(courses):
    n = 0
    for world in courses.values():
        for link in world.course.topology.links:
            node = world.course.topology.nodes[link.start]
            if link.end == NOWHERE:
                mouth = next(  # the way narrows to the opening
                    d
                    for d in np.arange(0.05, 4, 0.1)
                    if width_at(world, *beyond(node, link.start_bearing_deg, d), link.start_bearing_deg)
                    == pytest.approx(link.opening_m)
                )
                assert sight(world, node.x_m, node.y_m, link.start_bearing_deg) >= 6.0 + mouth - 0.11
                n += 1
    assert n > 30


def beyond(node, bearing_deg, distance):
    dx, dy = STEP[bearing_deg % 360]
    return node.x_m + dx * distance, node.y_m + dy * distance


@pytest.mark.parametrize("furniture", [False, True])
def test_links_are_as_long_and_as_narrow_as_the_cells_say(courses, furniture):
    narrowed = 0
    for seed in SEEDS:
        world = course(seed, furniture=True) if furniture else courses[seed]
        nodes = world.course.topology.nodes
        for link in world.course.topology.links:
            if link.end == NOWHERE:
                continue
            a, b = nodes[link.start], nodes[link.end]
            assert (link.start_bearing_deg + 180) % 360 == link.end_bearing_deg
            dx, dy = STEP[link.start_bearing_deg]
            assert (b.x_m - a.x_m) * dx + (b.y_m - a.y_m) * dy == pytest.approx(link.length_m)
            assert abs((b.x_m - a.x_m) * dy) + abs((b.y_m - a.y_m) * dx) < link.opening_m, "one passage"
            if link.length_m < 3.5 or a.type == b.type == "free_space":
                continue
            middle = [width_at(world, *beyond(a, link.start_bearing_deg, d), link.start_bearing_deg)
                      for d in np.arange(1.6, link.length_m - 1.6, 0.1)]  # fmt: skip
            assert min(middle) == pytest.approx(link.min_width_m)
            assert min(middle) > 1.199
            narrowed += link.min_width_m < link.opening_m - 1e-6
    assert narrowed > 10 if furniture else narrowed == 0


def test_the_robots_rule_leads_to_the_goal(courses):
    dead_ends = 0
    for world in courses.values():
        topology = world.course.topology
        here, came, done = 0, None, set()
        order = [0]
        while True:
            ways = {}  # turn counter-clockwise from the way in -> link
            for link in topology.links:
                for node, bearing in ((link.start, link.start_bearing_deg), (link.end, link.end_bearing_deg)):
                    if node == here:
                        ways[(bearing - (came or 0)) % 360] = (link, bearing)
            todo = [ways[turn] for turn in sorted(ways) if ways[turn][0].id not in done]
            if not todo:
                if here == len(topology.nodes) - 1:
                    break
                (back,) = ways.values()
                assert topology.nodes[here].type == "divergence"
                here, came, dead_ends = back[0].start, back[0].start_bearing_deg, dead_ends + 1
                continue
            link, _ = todo[0]
            assert link.status == "searched", "the rule takes a way that the course does not"
            assert link.id == len(done), "in the order of the links"
            done.add(link.id)
            here, came = link.end, link.end_bearing_deg
            order.append(here)
        assert order == list(range(len(topology.nodes))), "nodes are numbered as they are met"
    assert dead_ends > 5


@pytest.mark.parametrize("cell_m", [0.05, 0.2, 0.07, 0.15])
def test_a_seed_is_one_building_at_every_cell(courses, cell_m):
    for seed in range(6):
        world, other = courses[seed], course(seed, cell_m=cell_m)
        assert types(other) == types(world)
        for a, b in zip(world.course.topology.nodes, other.course.topology.nodes):
            off = abs(a.x_m - b.x_m), abs(a.y_m - b.y_m)
            assert max(off) <= max(0.1, cell_m) + 1e-9
        if cell_m in (0.05, 0.2):
            assert other.free_m2 == pytest.approx(world.free_m2)
        ratio = math.tan(math.radians(other.course.topology.nodes[types(other).index("O")].inclination_deg)) * cell_m
        steps = np.abs(np.concatenate([np.diff(other.elevation, axis=axis)[~other.occupied.take(range(1, n), axis)]
                                       for axis, n in enumerate(other.shape)]))  # fmt: skip
        sloping = steps[steps > 1e-6]
        np.testing.assert_allclose(sloping, ratio, rtol=1e-3)
        for node in other.course.topology.nodes:
            if node.type == "divergence":
                _, contacts = touched(other, node.x_m, node.y_m)
                assert len(contacts) >= 3


def test_elevation_interpolates_to_straight_lines_between_the_nodes(courses):
    for world in courses.values():
        start, top, end = (node for node in world.course.topology.nodes if node.type == "obstacle")
        for node, height in ((start, 0.0), (top, 2.4 * math.tan(math.radians(top.inclination_deg))), (end, 0.0)):
            along = (node.x_m if abs(end.x_m - start.x_m) > 1 else node.y_m) / world.cell_m
            assert along % 1 == pytest.approx(0.5), "a crease lies in the middle of a cell"
            row, col = int(node.y_m / world.cell_m), int(node.x_m / world.cell_m)
            assert world.elevation[row, col] == pytest.approx(height, abs=1e-6)


def test_a_seed_is_one_world_and_seeds_differ(courses):
    again = course(np.int64(3))
    np.testing.assert_array_equal(again.occupied, courses[3].occupied)
    np.testing.assert_array_equal(again.elevation, courses[3].elevation)
    assert again.course == courses[3].course
    assert hash(again.course) == hash(courses[3].course)
    assert len({types(world) for world in courses.values()}) > 15


def test_widths_and_angles_vary_within_their_bounds(courses):
    links = [link for seed in SEEDS if seed for link in courses[seed].course.topology.links]
    widths = {round(link.opening_m, 6) for link in links}
    assert widths == {1.4, 1.6, 1.8, 2.0, 2.2, 2.4}
    assert {link.opening_m for link in course(0, width_m=1.7).course.topology.links} == {1.7}
    angles = {node.inclination_deg for world in courses.values() for node in world.course.topology.nodes} - {None}
    assert min(angles) >= 6
    assert max(angles) <= 15
    assert len(angles) > 5


def test_no_dead_ends_where_none_are_wanted():
    for seed in range(1, 15):
        topology = course(seed, dead_ends=False).course.topology
        assert all(len(topology.bearings_deg(node.id)) > 1 for node in topology.nodes if node.type == "divergence")


def test_elevation_and_course_go_along_with_a_world(courses):
    world = courses[0]
    larger = pad(world, (400, 300))
    assert larger.course is world.course
    np.testing.assert_array_equal(larger.elevation[:360, :244], world.elevation)
    opened = world.occupied.copy()
    opened[0, 0] = False
    ringed = with_ring(world.replace(occupied=opened))
    assert is_free(ringed, *ringed.course.goal_m)
    np.testing.assert_array_equal(ringed.elevation[1:-1, 1:-1], world.elevation)
    leaves, structure = jax.tree_util.tree_flatten(world)
    assert len(leaves) == 2
    assert hash(structure) == hash(jax.tree_util.tree_structure(course(0)))
    assert structure == jax.tree_util.tree_structure(course(0))


# Bad input


@pytest.mark.parametrize(
    ("name", "line"),
    [
        (
            "course:obstacle=river",
            "obstacle must be one of slope, stairs, platform, sill, cross-slope, none, got 'river'",
        ),
        ("course:obstacle=1", "obstacle must be a word, got 1"),
        ("course:width_m=1.0", "width_m must be a number at least 1.2 and at most 3, got 1.0"),
        ("course:riser_m=0", "riser_m must be a number at least 0.01"),
        ("course:furniture=1", "furniture must be true or false, got 1"),
        ("course:height_m=20", "there is no parameter 'height_m'"),
    ],
)
def test_a_wrong_parameter_is_refused(name, line):
    with pytest.raises(InputError, match=line) as error:
        load_world(name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "wrong",
    [{"cell_m": 0.25}, {"cell_m": 0.0}, {"cell_m": 0.001}, {"seed": -1}, {"seed": 1.5}, {"dead_ends": "no"},
     {"width_m": math.nan}],
)  # fmt: skip
def test_wrong_values_are_refused(wrong):
    with pytest.raises(InputError, match=r"course|seed"):
        course(**({"seed": 0} | wrong))
