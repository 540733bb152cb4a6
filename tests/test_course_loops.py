"""Courses with ways round and with equal junctions: seed 0 by pencil, then laws that look at the cells alone."""

import itertools
import math

import networkx as nx
import numpy as np
import pytest
from scipy import ndimage
from test_course import STEP, is_free, sight, touched, types, width_at

from jexplore.config import InputError
from jexplore.extraction.extract import extract
from jexplore.tracemap.record import check_map
from jexplore.tracemap.rooted import topology_from
from jexplore.tracemap.similarity import code
from jexplore.worlds import load_world
from jexplore.worlds.generators.course import course
from jexplore.worlds.generators.network import draw_network
from jexplore.worlds.starts import check_start, clear_of_walls, label_components
from jexplore.worlds.world import with_ring

KINDS = ((1, 0), (2, 0), (3, 0), (0, 2), (0, 5), (1, 4), (3, 3))  # loops, equal junctions


@pytest.fixture(scope="module")
def courses():
    """(loops, repeat, seed) -> world."""
    return {(*kind, seed): course(seed, loops=kind[0], repeat=kind[1]) for kind in KINDS for seed in range(9)}


def as_graph(topology):
    graph = nx.MultiGraph()
    graph.add_nodes_from(node.id for node in topology.nodes)
    graph.add_edges_from((link.start, link.end, link.id, {"length_m": link.length_m}) for link in topology.links)
    return graph


def touched_near(world, node):
    """`touched`, among the cells within 3 m."""
    row, col = (max(int((at - 3.0) / world.cell_m), 0) for at in (node.y_m, node.x_m))
    n = int(6.0 / world.cell_m)
    part = world.replace(occupied=world.occupied[row : row + n, col : col + n])
    return touched(part, node.x_m - col * world.cell_m, node.y_m - row * world.cell_m)


def equal_junctions(world):
    """Side passages with a dead end, and the junctions from which they leave: pairs of nodes; of a repeated course."""
    nodes, topology = world.course.topology.nodes, world.course.topology
    ends = {node.id for node in nodes if len(topology.bearings_deg(node.id)) == 1}
    return [(nodes[link.start], link) for link in topology.links if link.end in ends]


# Seed 0, by pencil


def test_one_ring_has_its_walls():
    world = load_world("course:loops=1")
    expected = np.ones((200, 328), bool)
    expected[90:110, 10:218] = False  # the way in: 4 + 6 + 4.8 + 6 m
    expected[10:190, 218:238] = False  # the ring: 2 m wide, 6 m to either side of the junction
    expected[10:190, 298:318] = False
    expected[10:30, 218:318] = False
    expected[170:190, 218:318] = False
    np.testing.assert_array_equal(world.occupied, expected)


def test_one_ring_has_its_nodes_and_links():
    world = load_world("course:loops=1")
    found = [(node.x_m, node.y_m) for node in world.course.topology.nodes]
    off, eighth = 2 - 2**0.5, 2 / 8
    expected = [
        (5, 10), (11.05, 10), (13.45, 10), (15.85, 10), (22.8 - eighth, 10),
        (21.8 + 2 * off, 1 + 2 * off), (31.8 - 2 * off, 1 + 2 * off),
        (31.8 - 2 * off, 19 - 2 * off), (21.8 + 2 * off, 19 - 2 * off), (2, 10),
    ]  # fmt: skip
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert types(world) == "TOOODDDDDD"
    links = world.course.topology.links
    assert [(link.start, link.end) for link in links] == [*((i, i + 1) for i in range(8)), (8, 4), (0, 9)]
    assert [link.start_bearing_deg for link in links] == [0, 0, 0, 0, 270, 0, 90, 180, 270, 180]
    assert [link.end_bearing_deg for link in links] == [180, 180, 180, 180, 90, 180, 270, 0, 90, 0]
    sides = [8 - (2 * off - 1), 10 - 4 * off, 18 - 4 * off, 10 - 4 * off, 8 - (2 * off - 1)]
    np.testing.assert_allclose([link.length_m for link in links], [6.05, 2.4, 2.4, 6.7, *sides, 3], atol=1e-8)
    assert {(link.status, link.min_width_m, link.opening_m) for link in links} == {("searched", 2.0, 2.0)}
    assert world.course.goal_m is None
    assert world.course.start_pose == (5, 10, 0)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("course:loops=1,obstacle=none", "T(D(D(D(D(D(=1)))),=1),D)"),
        ("course:loops=2,obstacle=none", "T(D(D(D(D(D(D(D(=1),=2))),=2)),=1),D)"),
        ("course:repeat=2,obstacle=none", "T(D(D,D(D,D)),D)"),
        ("course:repeat=3,obstacle=sill", "T(O:stairs(D(D,D(D,D(D,D)))),D)"),
        ("course:loops=1,repeat=2,obstacle=none", "T(D(D(D(D,D(D,D(D(D(=1)))))),=1),D)"),
    ],
)
def test_codes_by_pencil(name, expected):
    assert code(load_world(name).course.topology) == expected


def test_equal_junctions_stand_8_m_apart():
    topology = load_world("course:repeat=3,obstacle=none").course.topology
    junctions = [node for node in topology.nodes if len(topology.bearings_deg(node.id)) == 3]
    np.testing.assert_allclose(np.diff([node.x_m for node in junctions]), 8)
    assert {node.y_m for node in junctions} == {junctions[0].y_m}
    stubs = [link for link in topology.links if link.start_bearing_deg == 270]
    np.testing.assert_allclose([link.length_m for link in stubs], 0.75 + 6 - 1)


# Laws


def test_every_course_is_sound(courses):
    for (loops, _, _), world in courses.items():
        occupied = world.occupied
        assert with_ring(world) is world
        assert label_components(~occupied).max() == 0
        assert label_components(clear_of_walls(occupied, 0.59, world.cell_m)).max() == 0, "1.2 m wide everywhere"
        walls, count = ndimage.label(occupied, np.ones((3, 3)))
        assert count == loops + 1, "a pillar a ring"
        inner = [int((walls == i).sum()) for i in range(1, count + 1) if i != walls[0, 0]]
        assert min(inner, default=500) > 400, "no pillar below 4 square metres"
        topology = check_map(world.course.topology)
        graph = as_graph(topology)
        assert nx.is_connected(graph)
        assert len(topology.links) - len(topology.nodes) + 1 == loops
        assert all(link.status == "searched" for link in topology.links)
        x, y, heading = world.course.start_pose
        place = int(y / world.cell_m), int(x / world.cell_m), int(heading)
        assert world.start == place
        assert check_start(world, place, 0.3) == place
        assert sight(world, x, y, heading + 180) == pytest.approx(4, abs=world.cell_m)
        assert types(world)[:4] == "TOOO"


def test_rings_are_20_m_round_at_least(courses):
    n = 0
    for world in courses.values():
        for link in world.course.topology.links:
            graph = as_graph(world.course.topology)
            graph.remove_edge(link.start, link.end, link.id)
            if nx.has_path(graph, link.start, link.end):
                assert link.length_m + nx.shortest_path_length(graph, link.start, link.end, "length_m") > 20
                n += 1
    assert n > 200


def test_a_divergence_is_the_largest_circle_between_three_walls(courses):
    degrees = set()
    for world in courses.values():
        topology = world.course.topology
        for node in topology.nodes:
            if node.type != "divergence":
                continue
            radius, contacts = touched_near(world, node)
            assert len(contacts) >= 3
            gaps = np.diff([*contacts, contacts[0] + 360])
            assert gaps.max() < 180.01, "it cannot grow by moving"
            assert 0.59 < radius < 1.8
            open_ways = [bearing for bearing in STEP if sight(world, node.x_m, node.y_m, bearing) > 3.0]
            assert topology.bearings_deg(node.id) == open_ways
            degrees.add(len(open_ways))
    assert degrees == {1, 2, 3, 4}


def test_a_link_is_a_passage_of_its_length_and_width(courses):
    for world in courses.values():
        nodes = world.course.topology.nodes
        for link in world.course.topology.links:
            a, b = nodes[link.start], nodes[link.end]
            dx, dy = STEP[link.start_bearing_deg]
            assert (link.start_bearing_deg + 180) % 360 == link.end_bearing_deg
            assert (b.x_m - a.x_m) * dx + (b.y_m - a.y_m) * dy == pytest.approx(link.length_m)
            assert abs((b.x_m - a.x_m) * dy) + abs((b.y_m - a.y_m) * dx) < link.opening_m, "one passage"
            middle = a.x_m + dx * link.length_m / 2, a.y_m + dy * link.length_m / 2
            assert width_at(world, *middle, link.start_bearing_deg) == pytest.approx(link.min_width_m)


def test_all_free_cells_are_passages_of_the_topology(courses):
    """Passages drawn again from the topology alone cover the free cells, but for the corners beyond the nodes."""
    for world in courses.values():
        free = ~world.occupied
        rows, cols = np.nonzero(free)
        x, y = (cols + 0.5) * world.cell_m, (rows + 0.5) * world.cell_m
        off = np.full(len(x), np.inf)
        nodes = world.course.topology.nodes
        for link in world.course.topology.links:
            a, b = (np.array([nodes[i].x_m, nodes[i].y_m]) for i in (link.start, link.end))
            share = np.clip(((x - a[0]) * (b - a)[0] + (y - a[1]) * (b - a)[1]) / max((b - a) @ (b - a), 1e-9), 0, 1)
            off = np.minimum(off, np.hypot(x - a[0] - share * (b - a)[0], y - a[1] - share * (b - a)[1]))
        assert off.max() < 2.4 * 2**0.5


def test_the_links_are_in_the_order_of_the_robots_rule(courses):
    for world in courses.values():
        topology, x = world.course.topology, as_graph(world.course.topology)
        here, back = 0, topology.links[0].start_bearing_deg
        for link in topology.links:
            done = {other.id for other in topology.links if other.id < link.id}
            if link.start != here:
                left = [i for i in x if any(key not in done for *_, key in x.edges(i, keys=True))]
                known = x.edge_subgraph([edge for edge in x.edges(keys=True) if edge[2] in done])
                far = nx.single_source_dijkstra_path_length(known, here, weight="length_m")
                assert here not in left
                assert far[link.start] == pytest.approx(min(far[i] for i in left if i in far))
                before = nx.dijkstra_path(known, here, link.start, "length_m")[-2]
                ways = [other for other in topology.links if {other.start, other.end} == {before, link.start}]
                back = ways[0].end_bearing_deg if ways[0].end == link.start else ways[0].start_bearing_deg
            turns = {}
            for other in topology.links:
                if other.id not in done:
                    for node, bearing in ((other.start, other.start_bearing_deg), (other.end, other.end_bearing_deg)):
                        if node == link.start:
                            turns[(bearing - back) % 360] = other.id
            assert turns[min(turns)] == link.id
            here, back = link.end, link.end_bearing_deg


def test_the_topology_is_as_begun_at_the_start(courses):
    for world in courses.values():
        assert topology_from(world.course.topology, world.course.start_pose) == world.course.topology


def test_equal_junctions_are_equal(courses):
    for (loops, repeat, _), world in courses.items():
        if not repeat:
            continue
        topology = world.course.topology
        nodes, along = topology.nodes, []
        for at, stub in equal_junctions(world):
            across = [(b - stub.start_bearing_deg) % 360 for b in topology.bearings_deg(at.id)]
            if sorted(across) == [0, 90, 270] and stub.length_m > 5.5:
                along.append((at, stub))
        lines = {}
        for at, stub in along:
            line = round(at.x_m if stub.start_bearing_deg % 180 == 0 else at.y_m, 6)
            lines.setdefault((line, stub.start_bearing_deg), []).append((at, stub))
        most = max(lines.values(), key=len)
        assert len(most) == repeat
        steps = np.diff(sorted((round(at.x_m, 6), round(at.y_m, 6)) for at, _ in most), axis=0)
        np.testing.assert_allclose(np.abs(steps).sum(1), np.abs(steps[0]).sum(), atol=1e-6)
        assert np.abs(steps[0]).sum() >= 6
        assert len({round(stub.length_m, 6) for _, stub in most}) == 1
        assert len({stub.min_width_m for _, stub in most}) == 1
        assert loops or len(nodes) == 2 * repeat + 6  # start, its end, three of the slope, the end of the row


@pytest.mark.parametrize("cell_m", [0.05, 0.2, 0.07])
def test_a_seed_is_one_building_at_every_cell(courses, cell_m):
    for kind in ((1, 0), (3, 0), (0, 5)):
        world, other = courses[*kind, 3], course(3, loops=kind[0], repeat=kind[1], cell_m=cell_m)
        assert code(other.course.topology) == code(world.course.topology)
        if cell_m != 0.07:
            assert other.free_m2 == pytest.approx(world.free_m2)
        for node in other.course.topology.nodes:
            if node.type == "divergence":
                assert len(touched_near(other, node)[1]) >= 3


def test_a_seed_is_one_world_and_seeds_differ(courses):
    for kind in KINDS:
        again = course(np.int64(3), loops=kind[0], repeat=kind[1])
        np.testing.assert_array_equal(again.occupied, courses[*kind, 3].occupied)
        np.testing.assert_array_equal(again.elevation, courses[*kind, 3].elevation)
        assert again.course == courses[*kind, 3].course
    assert len({code(courses[2, 0, seed].course.topology) for seed in range(9)}) >= 6
    assert len({courses[2, 0, seed].shape for seed in range(9)}) >= 8


def test_rings_share_sides_or_stand_apart():
    apart = 0
    for seed in range(1, 13):
        topology = course(seed, loops=2, obstacle="none").course.topology
        rings = nx.minimum_cycle_basis(nx.Graph(as_graph(topology)))
        apart += not set(rings[0]) & set(rings[1])
    assert 2 <= apart <= 10


def test_rings_have_dead_ends_where_they_may():
    with_some = 0
    for seed in range(9):
        worlds = [course(seed, loops=2, dead_ends=wanted).course.topology for wanted in (True, False)]
        ends = [sum(len(each.bearings_deg(node.id)) == 1 for node in each.nodes) for each in worlds]
        assert ends[1] == 1, "behind the start"
        with_some += ends[0] > 1
    assert with_some >= 6


def test_widths_are_asked_for():
    widths = {link.opening_m for seed in range(9) for link in course(seed, loops=3).course.topology.links}
    assert {round(width, 6) for width in widths} == {1.4, 1.6, 1.8, 2.0, 2.2, 2.4}
    assert {link.opening_m for link in course(0, loops=1, width_m=1.4).course.topology.links} == {1.4}


@pytest.mark.parametrize(("obstacle", "letters"), [("stairs", "TOOOOD"), ("cross-slope", "TOOD"), ("none", "TD")])
def test_the_obstacle_lies_on_the_way_in(obstacle, letters):
    for seed in range(4):
        world = course(seed, loops=2, obstacle=obstacle)
        assert types(world).startswith(letters)
        np.testing.assert_array_equal(world.occupied, course(seed, loops=2).occupied)
        obstacles = [node for node in world.course.topology.nodes if node.type == "obstacle"]
        for node in obstacles:
            assert is_free(world, node.x_m, node.y_m)
        assert (world.elevation is None) == (obstacle == "none")


def test_many_plans_keep_clear_of_themselves():
    """Elements that must fit are drawn without another try."""
    for seed, loops, repeat, width_m in itertools.product(range(40), (1, 2, 3), (0, 10), (1.2, 3.0)):
        plan = draw_network(np.random.default_rng(seed), width_m, 3, loops, repeat, True)
        fifths = np.array(plan.areas) / 0.2
        np.testing.assert_allclose(fifths, np.round(fifths), atol=1e-6)
        assert sum(stop.type == "divergence" for stop in plan.stops) >= 2 * loops + 3


@pytest.mark.jit
@pytest.mark.parametrize("name", ["course#1:loops=1", "course#4:loops=2", "course#1:repeat=3"])
def test_the_map_read_off_the_cells_has_the_divergences_of_the_topology(name):
    world = load_world(name)
    found = extract(~world.occupied, np.ones_like(world.occupied), world.cell_m, start_rc=world.start[:2])
    truth = world.course.topology
    places = [node for node in found.nodes if node.type == "divergence"]
    expected = [node for node in truth.nodes if node.type == "divergence"]
    assert len(places) == len(expected)
    for node in expected:
        other = min(places, key=lambda o, node=node: math.hypot(o.x_m - node.x_m, o.y_m - node.y_m))
        assert math.hypot(other.x_m - node.x_m, other.y_m - node.y_m) <= 2 * world.cell_m
        assert len(found.bearings_deg(other.id)) == len(truth.bearings_deg(node.id))
    assert len(found.links) - len(found.nodes) == len(truth.links) - len(truth.nodes)


# Bad input


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("course:loops=4", "course: loops must be an integer from 0 to 3, got 4"),
        ("course:loops=-1", "course: loops must be an integer from 0 to 3, got -1"),
        ("course:loops=1.5", "loops must be an integer, got 1.5"),
        ("course:loops=true", "loops must be an integer, got True"),
        ("course:repeat=1", "course: repeat must be from 2 to 10, or 0 for none, got 1"),
        ("course:repeat=11", "course: repeat must be an integer from 0 to 10, got 11"),
        ("course:loops=1,furniture=true", "course: furniture must be false where there are loops or repeat, got true"),
        ("course:repeat=2,furniture=true", "course: furniture must be false where there are loops or repeat, got true"),
        ("course:repeat=2,dead_ends=false", "course: dead_ends must be true with repeat"),
    ],
)
def test_a_wrong_parameter_is_refused(name, line):
    with pytest.raises(InputError, match=line) as error:
        load_world(name)
    assert "\n" not in str(error.value)
