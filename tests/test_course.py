"""Courses, with ways round and equal junctions: by pencil, then laws that compare the topology with cells alone."""

import math

import networkx as nx
import numpy as np
import pytest
from ref.refusals import refused
from scipy import ndimage

from jexplore.rooms.scores import label_components
from jexplore.tracemap.record import NOWHERE, check_map
from jexplore.tracemap.rooted import topology_from
from jexplore.tracemap.similarity import code
from jexplore.worlds import load_world
from jexplore.worlds.generators.course import course
from jexplore.worlds.starts import check_start, clear_of_walls
from jexplore.worlds.world import with_ring

SEEDS = range(31)
KINDS = ((1, 0), (2, 0), (3, 0), (0, 2), (0, 5), (1, 4), (3, 3))  # loops, equal junctions
STEP = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}
LETTERS = {"terminal": "T", "obstacle": "O", "divergence": "D", "free_space": "F"}


@pytest.fixture(scope="module")
def courses():
    """Seed -> the paper's course and others like it."""
    return {seed: course(seed) for seed in SEEDS}


@pytest.fixture(scope="module")
def networks():
    """(loops, repeat, seed) -> course with ways round or equal junctions."""
    return {(*kind, seed): course(seed, loops=kind[0], repeat=kind[1]) for kind in KINDS for seed in range(9)}


@pytest.fixture(scope="module")
def worlds(courses, networks):
    return [*courses.values(), *networks.values()]


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


def touched(world, node):
    """Radius of the largest empty circle about a node and directions of its contacts, degrees, one a wall."""
    row, col = (max(int((at - 3.0) / world.cell_m), 0) for at in (node.y_m, node.x_m))
    n, half = int(6.0 / world.cell_m), world.cell_m / 2
    rows, cols = np.nonzero(world.occupied[row : row + n, col : col + n])
    gap_x = (cols + col + 0.5) * world.cell_m - node.x_m
    gap_y = (rows + row + 0.5) * world.cell_m - node.y_m
    near_x, near_y = (np.sign(gap) * np.maximum(np.abs(gap) - half, 0) for gap in (gap_x, gap_y))
    distance = np.hypot(near_x, near_y)
    touching = distance <= distance.min() + 1e-8
    return distance.min(), np.unique(np.round(np.degrees(np.arctan2(near_y, near_x))[touching], 3) % 360)


# Seed 0, by pencil


def as_graph(topology):
    graph = nx.MultiGraph()
    graph.add_nodes_from(node.id for node in topology.nodes)
    graph.add_edges_from((link.start, link.end, link.id, {"length_m": link.length_m}) for link in topology.links)
    return graph


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


UP = np.repeat(np.arange(1, 9), 3) * 0.15


@pytest.mark.parametrize(
    ("obstacle", "riser_m", "profile", "places"),
    [
        ("stairs", 0.15, [(66, 0), *((1, z) for z in [*UP, *UP[::-1]])], [6.6, 8.7, 9.3, 11.4]),
        ("platform", 0.12, [(66, 0), (48, 0.12)], [6.6, 11.4]),
        ("sill", 0.06, [(89, 0), (2, 0.06)], [9.0]),  # in the middle
    ],
)
def test_steps_have_treads_and_risers(obstacle, riser_m, profile, places):
    world = course(0, obstacle=obstacle, riser_m=riser_m)
    expected = np.concatenate([np.full(n, z) for n, z in profile])
    np.testing.assert_allclose(world.elevation[270], np.pad(expected, (0, 244 - len(expected))), atol=1e-6)
    nodes = [node for node in world.course.topology.nodes if node.type == "obstacle"]
    assert [(n.obstacle, n.step_m, n.inclination_deg) for n in nodes] == [("stairs", riser_m, None)] * len(places)
    np.testing.assert_allclose([node.x_m for node in nodes], places)


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


# Laws


def test_every_course_is_sound(courses, networks):
    for (loops, _, _), world in [*(((0, 0, 0), world) for world in courses.values()), *networks.items()]:
        occupied, plain = world.occupied, world.course.goal_m is not None
        assert with_ring(world) is world
        assert label_components(~occupied).max() == 0
        assert label_components(clear_of_walls(occupied, 0.59, world.cell_m)).max() == 0, "1.2 m wide everywhere"
        start_x, start_y, heading = world.course.start_pose
        place = int(start_y / world.cell_m), int(start_x / world.cell_m), int(heading)
        assert world.start == place
        assert check_start(world, place, 0.3) == place
        behind = sight(world, start_x, start_y, heading + 180)
        assert behind == pytest.approx(1.5 if plain else 4, abs=world.cell_m)
        assert types(world)[0] == "T"
        assert types(world).count("OOO") == 1
        topology = check_map(world.course.topology)
        if plain:
            assert types(world)[-1] == "T"
            assert is_free(world, *world.course.goal_m)
            last = topology.links[-1 - sum(link.end == NOWHERE for link in topology.links)]
            assert sight(world, *world.course.goal_m, (last.end_bearing_deg + 180) % 360) >= 6.0  # nothing ends it
            continue
        walls, count = ndimage.label(occupied, np.ones((3, 3)))
        assert count == loops + 1, "a pillar a ring"
        inner = [int((walls == i).sum()) for i in range(1, count + 1) if i != walls[0, 0]]
        assert min(inner, default=500) > 400, "no pillar below 4 square metres"
        assert nx.is_connected(as_graph(topology))
        assert len(topology.links) - len(topology.nodes) + 1 == loops
        assert all(link.status == "searched" for link in topology.links)
        assert topology_from(topology, world.course.start_pose) == topology


def test_a_divergence_is_the_largest_circle_between_three_walls_and_its_links_are_its_openings(worlds):
    degrees, count = set(), 0
    for world in worlds:
        topology = world.course.topology
        for node in topology.nodes:
            bearings = topology.bearings_deg(node.id)
            if node.type != "divergence":
                assert len(bearings) == 2 or (node.type, len(bearings)) == ("terminal", 1)
                continue
            radius, contacts = touched(world, node)
            assert len(contacts) == 4 if len(bearings) == 4 else len(contacts) >= 3
            gaps = np.diff([*contacts, contacts[0] + 360])
            assert gaps.min() > 30
            assert gaps.max() < 180.01, "it cannot grow by moving"
            assert 0.59 < radius < 1.8
            assert bearings == [b for b in STEP if sight(world, node.x_m, node.y_m, b) > 3.0]
            degrees.add(len(bearings))
            count += 1
    assert degrees == {1, 2, 3, 4}
    assert count > 400


def beyond(node, bearing_deg, distance):
    dx, dy = STEP[bearing_deg % 360]
    return node.x_m + dx * distance, node.y_m + dy * distance


@pytest.mark.parametrize("furniture", [False, True])
def test_links_are_as_long_and_as_narrow_as_the_cells_say(worlds, furniture):
    narrowed = 0
    for world in [course(seed, furniture=True) for seed in SEEDS] if furniture else worlds:
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
                      for d in np.arange(1.6, link.length_m - 1.6, 0.1 if furniture else 0.4)]  # fmt: skip
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


@pytest.mark.parametrize("cell_m", [0.05, 0.2, 0.15])
def test_a_seed_is_one_building_at_every_cell(courses, networks, cell_m):
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
                assert len(touched(other, node)[1]) >= 3
    network = course(3, loops=3, cell_m=cell_m)
    assert code(network.course.topology) == code(networks[3, 0, 3].course.topology)


def test_widths_and_angles_vary_within_their_bounds(courses):
    links = [link for seed in SEEDS if seed for link in courses[seed].course.topology.links]
    widths = {round(link.opening_m, 6) for link in links}
    assert widths == {1.4, 1.6, 1.8, 2.0, 2.2, 2.4}
    assert {link.opening_m for link in course(0, width_m=1.7).course.topology.links} == {1.7}
    for seed in range(1, 8):  # nor dead ends where none are wanted
        topology = course(seed, dead_ends=False).course.topology
        assert all(len(topology.bearings_deg(node.id)) > 1 for node in topology.nodes if node.type == "divergence")
    angles = {node.inclination_deg for world in courses.values() for node in world.course.topology.nodes} - {None}
    assert min(angles) >= 6
    assert max(angles) <= 15
    assert len(angles) > 5


# And their laws


@pytest.mark.parametrize(("obstacle", "letters"), [("stairs", "TOOOOD"), ("cross-slope", "TOOD"), ("none", "TD")])
def test_the_obstacle_lies_on_the_way_in(obstacle, letters):
    for seed in range(4):
        world = course(seed, loops=2, obstacle=obstacle)
        assert "".join(filter(str.isupper, code(world.course.topology))).startswith(letters)
        np.testing.assert_array_equal(world.occupied, course(seed, loops=2).occupied)
        obstacles = [node for node in world.course.topology.nodes if node.type == "obstacle"]
        for node in obstacles:
            assert is_free(world, node.x_m, node.y_m)
        assert (world.elevation is None) == (obstacle == "none")


# Bad input


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("course:obstacle=river", "obstacle must be one of slope, stairs, platform, sill, cross-slope, none"),
        ("course:obstacle=1", "obstacle must be a word, got 1"),
        ("course:width_m=1.0", "width_m must be a number at least 1.2 and at most 3, got 1.0"),
        ("course:furniture=1", "furniture must be true or false, got 1"),
        ("course:height_m=20", "there is no parameter 'height_m'"),
        ("course:loops=4", "course: loops must be an integer from 0 to 3, got 4"),
        ("course:repeat=1", "course: repeat must be from 2 to 10, or 0 for none, got 1"),
        ("course:repeat=11", "course: repeat must be an integer from 0 to 10, got 11"),
        ("course:loops=1,furniture=true", "course: furniture must be false where there are loops or repeat, got true"),
        ("course:repeat=2,dead_ends=false", "course: dead_ends must be true with repeat"),
    ],
)
def test_a_wrong_parameter_is_refused(name, line):
    refused(line, load_world, name)


@pytest.mark.parametrize("cell_m", [0.25, 0.0])
def test_wrong_cells_are_refused(cell_m):
    refused("cell_m", load_world, "course", cell_m)
