"""The robot with a local map: paths of its outline, places in view, the trace map as it grows, whole runs."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.driving.local.area import SeenArea
from jexplore.driving.local.lattice import Lattice, outlines
from jexplore.driving.local.nodes import TRIES, Exit, Node, TraceMap, direction_out
from jexplore.driving.local.pilot import Pilot
from jexplore.driving.local.run import LocalRun
from jexplore.driving.local.sight import SeenPlace, SeenWay, look
from jexplore.driving.local.window import CELL_M, SIDE, Window
from jexplore.driving.settings import ROBOTS
from jexplore.report.operator_view import page
from jexplore.studies.traces.job import prepare_trace
from jexplore.studies.traces.recording import record_run
from jexplore.worlds.world import World

CRAWLER = ROBOTS["kamui"]


def window_with(*free, unknown=(), walls=True):
    """A window whose cells are occupied but for rectangles `(row, col, rows, cols)`, of which some are unknown."""
    occupied, known = np.full((SIDE, SIDE), walls), np.ones((SIDE, SIDE), bool)
    for row, col, rows, cols in free:
        occupied[row : row + rows, col : col + cols] = False
    for row, col, rows, cols in unknown:
        known[row : row + rows, col : col + cols] = False
    known[[0, -1]] = known[:, [0, -1]] = False
    return Window(np.array([-64, -64]), occupied & known, known)


# Paths of the outline


def test_outline_covers_its_area_at_every_heading():
    for mask in outlines(0.7, 0.39):
        assert abs(mask.sum() * CELL_M**2 - (0.7 + 0.1) * (0.39 + 0.1)) < 0.12
        assert (mask == mask[::-1, ::-1]).all()  # it looks the same ahead and behind


def test_cost_is_the_way_straight_on_and_more_to_the_back():
    window = window_with((20, 20, 88, 88))
    found = Lattice(window, np.array([0.05, 0.05, 0.0]), CRAWLER)
    begin = found.cost[64, 64]
    assert found.cost[64, 84] - begin == pytest.approx(2.0, abs=0.01)
    assert found.cost[64, 54] - begin == pytest.approx(min(2.5 * 1.0, 4 * 0.25 + 1.0), abs=0.01)
    assert found.cost[84, 84] - begin == pytest.approx(0.25 + 20 * math.sqrt(2) * 0.1, abs=0.01)


def reaches(window, row, col, **how):
    """Return whether a path leads to a cell from a place 2 m before the middle."""
    return bool(np.isfinite(Lattice(window, np.array([-1.95, 0.05, 0.0]), CRAWLER, **how).cost[row, col]))


@pytest.mark.parametrize(("cells", "passes"), [(4, False), (6, True)])
def test_robot_passes_where_its_width_fits(cells, passes):
    window = window_with((50, 30, 28, 30), (64 - cells // 2, 60, cells, 20), (50, 80, 28, 30))
    assert reaches(window, 64, 95) == passes


def test_robot_does_not_turn_where_its_length_does_not_fit():
    """A corner of 0.6 m: each leg is wide enough, the bend is not for a robot of 0.7 m."""
    window = window_with((61, 40, 6, 30), (30, 64, 37, 6))
    assert [reaches(window, *cell) for cell in ((64, 60), (35, 66))] == [True, False]
    assert reaches(window_with((59, 40, 10, 30), (30, 60, 39, 10)), 35, 65)


def test_unknown_cells_are_not_passed_but_may_be_hoped_for():
    free = (50, 30, 28, 70)
    assert reaches(window_with(free), 64, 90)
    assert not reaches(window_with(free, unknown=[(50, 70, 28, 1)]), 64, 90)
    window = window_with((50, 30, 28, 30), (61, 60, 6, 20), (50, 80, 28, 30), unknown=[(61, 65, 6, 5)])
    assert [reaches(window, 64, 95, through_unknown=hopes) for hopes in (0, 1)] == [False, True]


def test_path_leads_from_the_robot_to_the_cell_by_single_motions():
    window = window_with((20, 20, 88, 88), (64, 64, 1, 1))
    found = Lattice(window, np.array([0.05, 0.05, 0.3]), CRAWLER)
    path = found.path_to(np.array([90, 40]))
    assert np.abs(path[0].cell - 64).max() <= 3
    assert path[-1].cell.tolist() == [90, 40]
    for one, other in itertools.pairwise(path):
        turn, step = (other.heading - one.heading) % 8, np.abs(other.cell - one.cell).max()
        assert (turn in (1, 7) and step == 0) or (turn == 0 and step == 1)


def test_walled_in_robot_reaches_nothing():
    found = Lattice(window_with(), np.array([0.05, 0.05, 0.0]), CRAWLER)
    assert np.isinf(found.cost).all()
    assert found.nearest(np.zeros(2), 1.0) is None
    assert found.nearest(np.array([500.0, 0.0]), 1.0) is None  # far outside


# Places in view


def tee(**more):
    """A corridor of 2 m along x with one of 2 m up from its middle."""
    return window_with((54, 4, 20, 120), (74, 54, 50, 20), **more)


def test_junction_is_one_sure_place_with_three_ways():
    seen = look(tee(), np.array([0.0, 0.0, 0.0]), np.array([99.0, 99.0]), 0.39, 5.0)
    (place,) = [place for place in seen if len(place.ways) == 3]
    assert (place.is_sure, place.type) == (True, "divergence")
    assert math.dist(place.xy, (0.0, 0.25)) < 0.3
    bearings = sorted(round(math.degrees(way.bearing) / 90) % 4 for way in place.ways)
    assert bearings == [0, 1, 2]


def test_way_into_the_unknown_has_no_end_and_stops_there():
    seen = look(tee(unknown=[(0, 100, 128, 28)]), np.array([0.0, 0.0, 0.0]), np.array([99.0, 99.0]), 0.39, 5.0)
    (place,) = [place for place in seen if len(place.ways) == 3]
    (way,) = [way for way in place.ways if math.cos(way.bearing) > 0.9]
    assert way.to == -1
    assert 3.0 < way.path[-1, 0] < 3.7


def test_place_next_to_the_unknown_is_not_sure():
    def sure(unknown):
        seen = look(tee(unknown=[unknown]), np.zeros(3), np.array([99.0, 99.0]), 0.39, 5.0)
        return [place.is_sure for place in seen if math.dist(place.xy, (0.0, 0.0)) < 1]

    assert sure((74, 54, 50, 20)) == [False]
    assert sure((94, 54, 30, 20)) == [True]


def test_corner_of_a_hall_of_which_two_walls_are_in_view_is_no_place():
    """The line between the two walls leads into the unknown: no junction shows that it is a corner's."""
    window = window_with((10, 10, 117, 117))
    assert look(window, np.array([-1.0, -1.0, 0.0]), np.array([99.0, 99.0]), 0.39, 5.0) == []


def test_start_in_the_window_is_a_terminal():
    seen = look(tee(), np.array([0.0, 0.0, 0.0]), np.array([-3.0, 0.0]), 0.39, 5.0)
    assert [place.type for place in seen].count("terminal") == 1


def test_robot_off_the_graph_sees_no_place():
    assert look(window_with(), np.zeros(3), np.zeros(2), 0.39, 5.0) == []


# The map as it grows


def place_at(x, y, ways=(), *, kind="divergence", sure=True):
    made = [SeenWay(bearing, to, np.array([[x, y], end])) for bearing, to, end in ways]
    return SeenPlace(np.array([x, y]), kind, 1.0, sure, made)


def new_map():
    return TraceMap(np.zeros(2), np.zeros(2))


AT = np.zeros(3)


def test_place_seen_again_is_the_same_node_and_one_of_another_type_is_not():
    trace = new_map()
    trace.note([place_at(3, 0)], AT, AT)
    assert trace.note([place_at(3.4, 0)], AT, AT) == {0: 1}
    assert trace.note([place_at(3.4, 0, kind="free_space")], AT, AT) == {0: 2}
    assert trace.note([place_at(3.4, 5)], AT, AT) == {0: 3}


def test_unsure_place_makes_no_node():
    trace = new_map()
    assert trace.note([place_at(3, 0, sure=False)], AT, AT) == {}
    assert len(trace.nodes) == 1


def test_exit_is_searched_once_its_end_is_a_node():
    trace = new_map()
    trace.note([place_at(3, 0, [(0.0, -1, (5, 0))])], AT, AT)
    assert [e.to for e in trace.nodes[1].exits] == [-1]
    trace.note([place_at(3, 0, [(0.1, 1, (8, 0))]), place_at(8, 0, [(math.pi, 0, (3, 0))])], AT, AT)
    assert [e.to for e in trace.nodes[1].exits] == [2]
    assert [e.to for e in trace.nodes[2].exits] == [1]


def test_exit_that_is_not_there_goes_when_the_place_is_sure_and_near():
    trace = new_map()
    ways = [(0.0, -1, (5, 0)), (math.pi / 2, -1, (3, 2))]
    trace.note([place_at(3, 0, ways)], AT, AT)
    trace.note([place_at(3, 0, ways[:1], sure=False)], AT, AT)
    assert len(trace.nodes[1].exits) == 2
    trace.note([place_at(3, 0, ways[:1])], np.array([50.0, 0, 0]), AT)
    assert len(trace.nodes[1].exits) == 2
    trace.note([place_at(3, 0, ways[:1])], AT, AT)
    assert len(trace.nodes[1].exits) == 1


def test_tries_begin_anew_where_more_of_a_way_is_known():
    trace = new_map()
    for end, made, kept in ((5.0, 2, 0), (5.1, 2, 2), (4.5, 3, 2), (6.0, 3, 0)):
        trace.note([place_at(3, 0, [(0.0, -1, (end, 0))])], AT, AT)
        assert trace.nodes[1].exits[0].tries == kept
        trace.nodes[1].exits[0].tries = made
    trace.note([place_at(3, 0)], AT, AT)  # it is not seen: that it was given up is kept
    assert [e.tries for e in trace.nodes[1].exits] == [3]


def test_dropped_node_leaves_exits_into_the_unknown():
    trace = linked((0, 1, 1), (1, 2, 1), (0, 2, 5), n=3)
    trace.drop(1)
    assert [[e.to for e in node.exits] for node in trace.nodes] == [[-1, 1], []]


def ends(trace, begin, goals):
    """Return the nodes of a route; None: no way leads there."""
    found = trace.route(begin, goals)
    return found if found is None else [to for _, to in found]


def linked(*edges, n):
    """A map of n nodes with links `(one, other, length)`, passable from the first to the second."""
    trace = new_map()
    trace.nodes += [Node(np.array([float(i), 0.0]), "divergence", 0.5, np.zeros(2)) for i in range(1, n)]
    for one, other, length in edges:
        trace.nodes[one].exits.append(Exit(0.0, np.array([[0.0, 0.0], [length, 0.0]]), other))
    return trace


def test_route_is_the_shortest_to_the_nearest_goal():
    trace = linked((0, 1, 1), (1, 2, 1), (0, 2, 5), (2, 3, 1), (0, 3, 9), n=4)
    assert ends(trace, 0, {3}) == [1, 2, 3]
    assert ends(trace, 0, {2, 3}) == [1, 2]
    assert trace.route(3, {0}) is None
    assert trace.route(0, {0}) is None


def test_link_that_failed_counts_as_longer_and_is_left_out_in_the_end():
    trace = linked((0, 1, 1), (1, 2, 1), (0, 2, 5), n=3)
    trace.nodes[1].exits[0].fails = 1
    assert ends(trace, 0, {2}) == [2]
    trace.nodes[0].exits[1].fails = TRIES
    assert ends(trace, 0, {2}) == [1, 2]
    trace.nodes[1].exits[0].fails = TRIES
    assert trace.route(0, {2}) is None


def test_failures_are_forgotten_once():
    trace = linked((0, 1, 1), n=2)
    trace.nodes[0].exits[0].fails = TRIES
    assert trace.route(0, {1}) is None
    assert trace.forget_failures()
    assert ends(trace, 0, {1}) == [1]
    assert not trace.forget_failures()


def test_driven_way_links_nodes_that_no_route_joins():
    trace = linked(n=3)
    way = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    trace.link_driven(0, 1, way)
    trace.link_driven(0, 1, way)
    assert [len(node.exits) for node in trace.nodes] == [1, 1, 0]
    assert trace.nodes[1].exits[0].bearing == pytest.approx(-math.pi / 2)
    assert direction_out(way) == pytest.approx(0.0)


def test_map_as_arrays_has_each_link_once_and_counts_what_does_not_fit():
    trace = linked((0, 1, 2), (1, 0, 2), (1, 2, 3), n=3)
    trace.nodes[1].exits[1].path = np.array([[1.0, 0.5], [1.0, 1.0], [1.5, 1.0]])
    trace.nodes[2].exits.append(Exit(1.0, np.zeros((1, 2))))
    found = jx.btm.to_map(trace.to_btm(8, 8))
    assert [(link.start, link.end, link.status) for link in found.links] == [
        (0, 1, "searched"),
        (1, 2, "searched"),
        (2, -1, "un-searched"),
    ]
    assert found.links[1].length_m == pytest.approx(1 + math.sqrt(2))  # from node to node
    small = trace.to_btm(2, 1)
    assert (int(small.n_nodes), int(small.n_links), int(small.overflow)) == (2, 1, 1 + 2)


def test_way_through_another_node_and_one_told_twice_are_no_links():
    trace = linked((0, 1, 1), (1, 2, 1), n=3)
    around = [np.array([[0.0, 0.0], [1.0, aside], [2.0, 0.0]]) for aside in (0.2, 3.0, 3.3)]
    trace.nodes[0].exits += [Exit(0.0, path, 2) for path in around]
    trace.nodes[1].exits[0].path = np.array([[1.0, 0.0], [1.5, 0.0], [2.0, 0.0]])
    assert [(i, e.to, e.path[len(e.path) // 2].tolist()) for i, e, _ in trace.links() if e.to == 2] == [
        (0, 2, [1.0, 3.0]),
        (1, 2, [1.5, 0.0]),
    ]


def test_exit_of_a_node_out_of_view_is_one_link_with_the_exit_that_passes_its_end():
    trace = new_map()
    trace.note([place_at(3, 0, [(0.0, -1, (8, 0))])], AT, AT)
    trace.note([place_at(13, 0, [(math.pi, -1, (8, 0))])], AT, AT)  # they only touch: a place may lie there
    assert [e.to for node in trace.nodes for e in node.exits] == [-1, -1]
    passing = SeenWay(math.pi, -1, np.array([[13.0, 0.0], [8.0, 0.0], [7.0, 0.0]]))
    trace.note([SeenPlace(np.array([13.0, 0.0]), "divergence", 1.0, True, [passing])], AT, AT)
    assert ends(trace, 1, {2}) == [2]
    assert ends(trace, 2, {1}) == [1]
    assert trace.nodes[1].exits[0].path[[0, -1]].tolist() == [[3, 0], [13, 0]]


# Frontiers


def test_frontier_is_as_wide_as_the_robot():
    known, area = window_with((50, 30, 28, 30), (61, 60, 6, 20), (30, 60, 3, 20)), SeenArea()
    area.add(known, 0.39)
    assert area.frontiers(known) == []
    open_ = window_with((50, 30, 28, 70), unknown=[(50, 90, 28, 10), (60, 40, 3, 3)])
    area = SeenArea()
    area.add(open_, 0.39)
    (one,) = area.frontiers(open_)  # the unseen patch is smaller than the robot
    assert (np.unique(np.argwhere(one)[:, 1]).tolist(), one.sum()) == ([89], 28 - 2)


def test_frontiers_out_of_the_local_map_are_remembered_until_given_up():
    here = window_with((50, 30, 28, 70), unknown=[(50, 90, 28, 10)])
    away, area = here._replace(corner=here.corner - [0, 300], occupied=here.known, known=here.known), SeenArea()
    area.add(here, 0.39)
    area.add(away, 0.39)
    left = area.elsewhere(away)
    assert left[:, 0] == pytest.approx(np.full(26, (89 - 64 + 0.5) * 0.1))
    area.give_up(away, left[:20])
    assert len(area.elsewhere(away)) == 6
    area.add(here, 0.39)
    assert sum(int(some.sum()) for some in area.frontiers(here)) <= 6


def test_walls_out_of_the_local_map_are_remembered():
    here, area = window_with((50, 30, 28, 70)), SeenArea()
    area.add(here, 0.39)
    away = here._replace(corner=np.add(here.corner, (0, 40)), occupied=here.known & False, known=here.known & False)
    area.add(away, 0.39)
    wide = area.around(away)
    row, col = np.add(here.corner, (40, 10)) - wide.corner
    assert (wide.occupied[row, col], wide.known[row, col]) == (True, True)
    row, col = np.add(here.corner, (60, 40)) - wide.corner
    assert (wide.occupied[row, col], wide.known[row, col]) == (False, True)


# Decisions


class Standing:
    """A pilot that stands in a window and counts how far it is told to go back."""

    def __init__(self, window, way=()):
        self.now = self
        self.truth = self.pose = np.array([0.05, 0.05, 0.0])
        self.way = [(np.array([x, y, 0.0]), None, None) for x, y in way]
        self.odometer_m, self.target, self.backs = 0.0, None, []
        self.window = lambda: window

    def follow(self, path, window, most_m):
        return False

    def turn_to(self, heading):
        return True

    def retrace(self, most_m):
        self.backs.append(round(most_m, 3))


def standing(window, way=()):
    """A run whose robot stands in the middle of a window, with a node there and one at (4, 0)."""
    run = object.__new__(LocalRun)
    run.pilot, run.robot, run._stops, run._target = Standing(window, way), CRAWLER, 0, None
    run.map = TraceMap(np.array([0.05, 0.05]), np.array([0.05, 0.05]))
    run.map.nodes.append(Node(np.array([4.05, 0.05]), "divergence", 0.5, np.array([4.05, 0.05])))
    run._lattice, run._hoped = Lattice(window, run.pilot.pose, run.robot), None
    return run


@pytest.mark.parametrize(("unknown", "is_shut"), [((), True), ([(61, 75, 6, 5)], False)])
def test_place_behind_walls_is_doubted_and_one_behind_the_unknown_is_not(unknown, is_shut):
    run = standing(
        window_with((50, 50, 28, 25), (50, 80, 28, 35), (61, 75, 6, 5) if unknown else (0, 0, 0, 0), unknown=unknown)
    )
    assert run._doubt_shut({1}) == is_shut
    assert run.map.nodes[1].tries == is_shut


def test_robot_is_shut_in_where_it_cannot_drive_most_of_its_way_again():
    room, whole = window_with((58, 58, 12, 12)), window_with((30, 30, 70, 70))
    way = [(x / 10, 0.0) for x in range(-30, 1)]
    assert [standing(window, way)._is_shut_in() for window in (room, whole)] == [True, False]
    assert not standing(whole)._is_shut_in()  # it has not driven yet


def test_robot_that_is_stopped_goes_back_farther_each_time_before_it_counts_a_try():
    run = standing(window_with((30, 30, 70, 80)))
    run.map.nodes[0].is_visited = True
    for _ in range(5):
        assert run._go_near()
    assert run.pilot.backs == [0.7, 1.4, 2.8, 5.6, 11.2]
    assert run.map.nodes[1].tries == TRIES


# Runs


def cross(cells=120):
    """Two corridors of 1.6 m, 11 m long, that cross."""
    occupied = np.ones((cells, cells), bool)
    occupied[52:68, 5:-5] = occupied[5:-5, 52:68] = False
    return World(occupied=occupied, cell_m=0.1, name="cross")


@pytest.mark.jit
@pytest.mark.slow
def test_robot_maps_a_crossing_the_same_way_twice():
    found = jx.btm.trace(cross(), start=(1.5, 6.0, 0.0), runs=2, noise={"range_m": 0.01}, perception="map")
    assert found.table["outcome"].tolist() == ["EXHAUSTED", "EXHAUSTED"]
    assert found.table["contacts"].max() <= 1  # with the wall behind the start, of which it sees the middle of a cell
    for i in range(2):
        crossing = [n for n in found.maps[i].nodes if math.dist((n.x_m, n.y_m), (6.0, 6.0)) < 0.5]
        assert [n.type for n in crossing] == ["divergence"]
        assert len(found.maps[i].bearings_deg(crossing[0].id)) == 4
    again = jx.btm.trace(cross(), start=(1.5, 6.0, 0.0), runs=1, noise={"range_m": 0.01}, workers=1)
    assert again.table["steps"][0] == found.table["steps"][0]
    assert np.array_equal(again.driven.truth, found.driven.truth)


@pytest.mark.jit
@pytest.mark.slow
def test_robot_goes_back_the_way_it_came_past_contacts():
    plan = prepare_trace(cross(), start=(1.5, 6.0, 0.0), perception="map")
    pilot, draw = Pilot(*plan.local_tasks(*plan.all_runs())), np.random.default_rng(0)
    begin = pilot.now.truth
    for _ in range(20):
        pilot.drive_to(pilot.pose[:2] + draw.uniform(-1, 1, 2), back=bool(draw.integers(2)))
        pilot.turn_to(draw.uniform(-3, 3))
    touched = pilot.now.contacts
    assert touched > 0
    assert math.dist(begin, pilot.now.truth) > 0.1
    pilot.retrace(1000.0)
    assert pilot.now.contacts == touched
    assert pilot.now.truth == pytest.approx(begin, abs=1e-3)


@pytest.mark.jit
@pytest.mark.slow
def test_robot_without_readings_is_blind_and_one_without_time_ends():
    blind = jx.btm.trace(cross(), start=(1.5, 6.0, 0.0), noise={"invalid": 1.0}, perception="map")
    assert blind.table["outcome"].tolist() == ["BLIND"]
    late = jx.btm.trace(cross(), start=(1.5, 6.0, 0.0), max_steps=100, perception="map")
    assert late.table[["outcome", "steps"]].iloc[0].tolist() == ["STEP_LIMIT", 100]


def test_link_that_failed_from_either_end_is_blocked():
    for failed in (0, 1):
        trace = linked((0, 1, 2), (1, 0, 2), n=2)
        trace.nodes[failed].exits[0].fails = TRIES
        assert trace.to_btm(4, 4).blocked.tolist() == [True, False, False, False]


@pytest.mark.jit
@pytest.mark.slow
def test_recorded_run_is_the_run_and_its_page_shows_it():
    plan = prepare_trace(cross(), start=(1.5, 6.0, 0.0), noise={"range_m": 0.01})
    seen, found = record_run(plan), jx.btm.trace(cross(), start=(1.5, 6.0, 0.0), noise={"range_m": 0.01})
    n = len(seen.pose)
    assert n == found.table["steps"][0]
    np.testing.assert_allclose(seen.pose, found.driven.truth + np.array([*plan.world.origin_m, 0]), atol=1e-5)
    assert sorted((link.start, link.end) for link in seen.map.links) == sorted(
        (link.start, link.end) for link in found.first.links
    )
    assert (np.diff(seen.n_links) >= 0).all()
    assert (seen.n_links[-1], seen.n_nodes[-1]) == (len(seen.map.links), len(seen.map.nodes))
    searched = [link.status == "searched" for link in seen.map.links]
    assert [frame < n for frame in seen.link_searched_frame] == searched
    assert "<html" in page(seen)


@pytest.mark.jit
@pytest.mark.slow
def test_team_merges_what_its_robots_have_at_contact():
    found = jx.btm.trace_team(cross(), robots=2, noise={"range_m": 0.01}, perception="map")
    alone = jx.btm.trace(cross(), start=(1.5, 6.0, 0.0), noise={"range_m": 0.01})
    assert found.plan.perception == alone.plan.perception == "map"
    for log in found.logs:
        held = log.held(2)
        assert int(held.map.n_nodes) == np.isfinite(held.node_at[:, 0]).sum() <= int(log.result.map.n_nodes)
    assert len(found.maps) == 2


@pytest.mark.jit
@pytest.mark.slow
def test_run_with_a_full_map_says_so():
    found = jx.btm.trace(cross(), start=(1.5, 6.0, 0.0), nodes=3, perception="map")
    assert found.table["outcome"].tolist() == ["MAP_FULL"]
    assert len(found.first.nodes) == 3
    assert all(link.end < 3 for link in found.first.links)


def test_what_does_not_count_with_a_local_map_is_told():
    for message, call, world, how in (
        ("perception must be one of auto, triangles, map, got 'eyes'", prepare_trace, cross(), {"perception": "eyes"}),
        ("perception map: the ground must be level", jx.btm.trace, "course", {"perception": "map"}),
        ("sweep: votes goes with perception triangles; with map width_m", prepare_trace, cross(),
         {"sweep": ["votes=1,2"], "perception": "map"}),
        (r"tuning\.votes goes with perception triangles", prepare_trace, cross(),
         {"tuning": {"votes": 4}, "perception": "map"}),
        ("engine and lanes go with perception triangles", jx.btm.trace, cross(),
         {"start": (1.5, 6.0, 0.0), "engine": "jax"}),
    ):  # fmt: skip
        refused(message, call, world, **how)


def test_perception_depends_on_the_world():
    level = prepare_trace(cross(), start=(1.5, 6.0, 0.0))
    ramp = np.tile(np.linspace(0, 1, 120, dtype=np.float32), (120, 1))
    uneven = prepare_trace(dataclasses.replace(cross(), elevation=ramp), start=(1.5, 6.0, 0.0))
    assert [plan.perception for plan in (level, uneven, prepare_trace("course"))] == ["map", "triangles", "triangles"]
