"""The oracles themselves: maps that one can check with a pencil, scipy where it has the same thing, laws, bad input."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref import beams, plans, simulator
from scipy import ndimage, sparse

S, D, FAR = plans.STRAIGHT, plans.DIAGONAL, plans.FAR


def drawn(text):
    """Characters of a map drawn with row 0 at the bottom."""
    return np.array([list(line) for line in text.split()][::-1])


def world(text):
    """Occupied cells of a drawn map."""
    return drawn(text) == "#"


def picture(result):
    """A belief as drawn: `?` unknown, `#` hit, `.` only missed."""
    cells = np.where(result.hits + result.misses == 0, "?", np.where(result.hits > 0, "#", "."))
    return "\n".join("".join(row) for row in cells[::-1])


def simulate(occupied, row, col, heading=0, **changes):
    """An episode in cells of one metre: clearance and near radius one cell unless changed."""
    rules = {"recheck": False, "cell_m": 1.0, "clearance_m": 1.0, "near_m": 1.0, "range_m": 3.0}
    return simulator.simulate(occupied, row, col, heading, **(rules | changes))


def ringed(shape):
    """An empty room with its walls."""
    return np.pad(np.zeros((shape[0] - 2, shape[1] - 2), bool), 1, constant_values=True)


# ---------------------------------------------------------------- beams


def test_direction_is_exact_on_the_lattice():
    axes = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1), 360: (1, 0), -90: (0, -1), 450: (0, 1)}
    for deg, expected in axes.items():
        assert beams.direction(deg) == expected
    h = math.sqrt(0.5)
    diagonals = {45: (h, h), 135: (-h, h), 225: (-h, -h), 315: (h, -h), -45: (h, -h)}
    for deg, expected in diagonals.items():
        assert beams.direction(deg) == expected
    assert [beams.direction(d)[1] for d in (30, 150, 210, 330)] == [0.5, 0.5, -0.5, -0.5]
    assert [beams.direction(d)[0] for d in (60, 120, 240, 300)] == [0.5, -0.5, -0.5, 0.5]
    assert all(math.copysign(1, v) == 1 for d in range(0, 360, 90) for v in beams.direction(d) if v == 0)


@pytest.mark.parametrize(
    ("n_beams", "fov_deg", "expected"),
    [
        (1, 180, [0]),
        (1, 0, [0]),
        (2, 90, [-45, 45]),
        (3, 180, [-90, 0, 90]),
        (4, 360, [-180, -90, 0, 90]),
        (3, 360, [-180, -60, 60]),
    ],
)
def test_lidar_angles(n_beams, fov_deg, expected):
    assert beams.lidar_angles(n_beams, fov_deg) == expected


@pytest.mark.parametrize("fov_deg", [240 / 7, 41.08, 100.1, 200 / 3, 123.4567])
def test_the_beam_in_the_middle_looks_straight_ahead(fov_deg):
    for n_beams in range(3, 362, 2):
        angles = beams.lidar_angles(n_beams, fov_deg)
        assert angles[n_beams // 2] == 0
        assert angles == [-angle for angle in angles[::-1]]
        assert angles[-1] == pytest.approx(fov_deg / 2, rel=1e-15)


@pytest.mark.parametrize(
    ("range_m", "cell_m", "expected"),
    [(1.05, 0.3, 3.5), (0.3, 0.1, 3), (1.5, 0.3, 5), (8, 0.1, 80), (1.0, 0.07, 14.285714286)],
)
def test_a_range_in_cells_is_not_lengthened_by_rounding(range_m, cell_m, expected):
    assert beams.in_cells(range_m, cell_m) == expected


@pytest.mark.parametrize(
    ("deg", "max_range", "expected"),
    [
        (0, 3, [(0, 1), (0, 2), (0, 3)]),  # entered at 0.5, 1.5, 2.5
        (0, 2.5, [(0, 1), (0, 2)]),  # entering at exactly the range does not count
        (270, 1, [(-1, 0)]),
        (45, 0.7, []),  # the corner lies at sqrt(0.5) = 0.707
        (45, 0.71, [(0, 1), (1, 1)]),
        (45, 3, [(0, 1), (1, 1), (1, 2), (2, 2)]),  # corners at 0.71 and 2.12; the next at 3.54
        (135, 1, [(0, -1), (1, -1)]),
        (225, 1, [(0, -1), (-1, -1)]),
        (315, 1, [(0, 1), (-1, 1)]),
        (30, 4, [(0, 1), (1, 1), (1, 2), (1, 3), (2, 3)]),  # x at 0.577 (2k + 1), y at 2k + 1
        (30, 3, [(0, 1), (1, 1), (1, 2), (1, 3)]),  # y = 1.5 is crossed at exactly 3
        (60, 3, [(1, 0), (1, 1), (2, 1), (3, 1)]),  # y at 0.577 (2k + 1); x = 1.5 at exactly 3
        (0, 0, []),
    ],
)
def test_beam_cells(deg, max_range, expected):
    assert beams.beam_cells(*beams.direction(deg), max_range) == expected


def test_beam_cells_from_beside_the_centre():
    assert beams.beam_entries(1.0, 0.0, 2.0, x0=0.25) == [(0.75, 0, 1), (1.75, 0, 2)]
    assert beams.beam_entries(-1.0, 0.0, 2.0, x0=0.25) == [(0.25, 0, -1), (1.25, 0, -2)]
    assert beams.beam_entries(0.0, -1.0, 1.0, y0=0.0) == [(0.0, -1, 0)]
    assert beams.beam_cells(*beams.direction(45), 1.1, x0=0.25, y0=0.5) == [(1, 0), (1, 1)]  # 0.71, 1.06


@given(st.floats(0, 360), st.floats(0.5, 20))
def test_a_beam_moves_by_one_edge_at_a_time_and_turns_by_half_a_turn(deg, max_range):
    cells = beams.beam_cells(*beams.direction(deg), max_range)
    for (r0, c0), (r1, c1) in zip([(0, 0), *cells], cells):
        assert abs(r1 - r0) + abs(c1 - c0) == 1
    c, s = beams.direction(deg)
    assert beams.beam_cells(-c, -s, max_range) == [(-r, -k) for r, k in cells]
    assert beams.beam_cells(c, -s, max_range) == [(-r, k) for r, k in cells]


@given(st.floats(0, 360), st.floats(0.1, 0.9), st.floats(0.1, 0.9))
def test_a_beam_visits_the_cells_that_points_along_it_lie_in(deg, x0, y0):
    c, s = beams.direction(deg)
    cells = {(0, 0), *beams.beam_cells(c, s, 6.0, x0, y0)}
    t = np.linspace(0, 6, 601)[:-1]
    x, y = x0 + t * c, y0 + t * s
    inside = np.minimum(abs(x - np.round(x)), abs(y - np.round(y))) > 1e-6  # not on an edge
    assert {(math.floor(b), math.floor(a)) for a, b in zip(x[inside], y[inside])} <= cells


def test_cast_hits_the_first_occupied_cell():
    occupied = world("""
        #####
        #..##
        #...#
        #####""")
    assert beams.cast(occupied, 1, 1, 0, 9.0) == ([(1, 2), (1, 3)], (1, 4), 2.5)
    assert beams.cast(occupied, 1, 1, 0, 2.5) == ([(1, 2), (1, 3)], None, 2.5)
    assert beams.cast(occupied, 1, 2, 45, 9.0) == ([(1, 3)], (2, 3), pytest.approx(math.sqrt(0.5)))  # x first
    assert beams.cast(np.zeros((1, 2), bool), 0, 0, 0, 9.0) == ([(0, 1)], None, 9.0)  # leaves the array
    assert beams.cast(np.zeros((2, 2), bool), 1, 1, 180, 9.0)[0] == [(1, 0)]  # and never comes in on the other side


def test_scan_counts_every_beam_and_the_robot_once():
    occupied = world("""
        ####
        #..#
        ####""")
    hits, misses = np.zeros((2, 3, 4), int)
    seen = beams.scan(occupied, 1, 1, 0, 3, 90.0, 9.0)
    # -45 and +45 degrees enter (1, 2) first, then the wall below or above it; 0 degrees ends at (1, 3)
    assert seen == [([(1, 2)], (0, 2)), ([(1, 2)], (1, 3)), ([(1, 2)], (2, 2))]
    beams.fold(hits, misses, 1, 1, seen)
    assert hits.tolist() == [[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 1, 0]]
    assert misses.tolist() == [[0, 0, 0, 0], [0, 1, 3, 0], [0, 0, 0, 0]]
    beams.fold(hits, misses, 1, 1, seen)
    assert misses[1].tolist() == [0, 2, 6, 0]


@settings(max_examples=20, deadline=None)
@given(
    hnp.arrays(bool, (7, 9), elements=st.sampled_from([False, False, False, True])), st.sampled_from(range(0, 360, 45))
)
def test_a_scan_turns_with_the_map_and_sees_more_with_more_range(occupied, heading):
    def counts(occupied, row, col, heading, max_range):
        hits, misses = np.zeros((2, 7, 9), int)
        beams.fold(hits, misses, row, col, beams.scan(occupied, row, col, heading, 181, 180.0, max_range))
        return hits, misses

    occupied[2, 5] = False
    hits, misses = counts(occupied, 2, 5, heading, 4.0)
    turned_hits, turned_misses = counts(occupied[::-1, ::-1], 4, 3, heading + 180, 4.0)
    np.testing.assert_array_equal(turned_hits[::-1, ::-1], hits)
    np.testing.assert_array_equal(turned_misses[::-1, ::-1], misses)
    assert not hits[~occupied].any()
    assert not misses[occupied].any()
    far_hits, far_misses = counts(occupied, 2, 5, heading, 5.0)
    assert (far_hits >= hits).all()
    assert (far_misses >= misses).all()


# ---------------------------------------------------------------- planning


def test_clear_and_traversable_by_hand():
    known_occupied = world("""
        #####
        .....
        .....
        .....
        ?????""")
    free = np.array([[0] * 5, [1] * 5, [1] * 5, [1] * 5, [0] * 5], bool)
    assert plans.clear(free, known_occupied, 1).astype(int).tolist() == [[0] * 5, [1] * 5, [1] * 5, [0] * 5, [0] * 5]
    assert plans.clear(free, known_occupied, 0).tolist() == free.tolist()
    assert not plans.clear(free, known_occupied, 9)[1:].any()
    driven = np.zeros((5, 5), bool)
    driven[4, 0] = True  # passable even though it turned out to be a wall
    got = plans.traversable(free, known_occupied, driven, 2, 3, clear_r2=4, near_r2=1)
    assert got.astype(int).tolist() == [
        [0, 0, 0, 0, 0],
        [1, 1, 1, 1, 1],
        [0, 0, 1, 1, 1],
        [0, 0, 0, 1, 0],
        [1, 0, 0, 0, 0],
    ]


def test_dijkstra_by_hand():
    passable = ~world("""
        ...#
        ....
        .#..""")
    cost, pred = plans.dijkstra(passable, (0, 0))
    assert cost.tolist() == [
        [0, FAR, 4 * S, 3 * S + D],  # no short cut past the wall at (0, 1)
        [S, 2 * S, 3 * S, 4 * S],
        [2 * S, S + D, 2 * S + D, FAR],
    ]
    assert pred.tolist() == [[-1, -1, 6, 6], [0, 4, 5, 6], [4, 4, 9, -1]]


@settings(max_examples=40, deadline=None)
@given(
    hnp.arrays(
        bool, hnp.array_shapes(min_dims=2, max_dims=2, max_side=8), elements=st.sampled_from([True, True, False])
    )
)
def test_dijkstra_agrees_with_scipy_and_paths_cost_what_the_map_says(passable):
    start = (passable.shape[0] // 2, passable.shape[1] // 2)
    passable[start] = True
    cost, pred = plans.dijkstra(passable, start)
    height, width = passable.shape
    graph = sparse.lil_matrix((passable.size, passable.size))
    for r, c in np.argwhere(passable):
        for dr, dc in plans.MOTIONS:
            box = passable[min(r, r + dr) : max(r, r + dr) + 1, min(c, c + dc) : max(c, c + dc) + 1]
            if 0 <= r + dr < height and 0 <= c + dc < width and box.all():
                graph[r * width + c, (r + dr) * width + c + dc] = D if dr and dc else S
    expected = sparse.csgraph.dijkstra(graph.tocsr(), indices=start[0] * width + start[1]).reshape(passable.shape)
    np.testing.assert_array_equal(np.where(cost == FAR, np.inf, cost), expected)
    for target in map(tuple, np.argwhere((cost < FAR) & (cost > 0))):
        cells = [start, *plans.path(pred, start, target)]
        length = sum(D if a[0] != b[0] and a[1] != b[1] else S for a, b in itertools.pairwise(cells))
        assert length == cost[target]


@settings(max_examples=40, deadline=None)
@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, max_side=8)), st.integers(0, 12))
def test_masks_agree_with_scipy(cells, r2):
    if cells.any():
        d2 = np.round(ndimage.distance_transform_edt(~cells) ** 2)
        np.testing.assert_array_equal(plans.nearest_site(cells)[0], d2)
        np.testing.assert_array_equal(plans.clear(np.ones(cells.shape, bool), cells, r2), d2 > r2)
    eight = np.ones((3, 3))
    label, count = ndimage.label(cells, eight)
    got = plans.clusters(cells)
    assert got.max(initial=-1) + 1 == count
    np.testing.assert_array_equal(got >= 0, cells)
    assert len(set(zip(got[cells].tolist(), label[cells].tolist()))) == count
    eight[1, 1] = 0
    expected = ndimage.binary_dilation(~cells, eight)
    np.testing.assert_array_equal(plans.beside_unknown(cells), expected)


def test_frontier_and_choice_by_hand():
    known = ~world("""
        #....
        .....
        ....#""")  # here # stands for unknown
    assert plans.beside_unknown(known).astype(int).tolist() == [[0, 0, 0, 1, 0], [1, 1, 0, 1, 1], [0, 1, 0, 0, 0]]
    everywhere, nowhere = np.ones((3, 5), bool), np.zeros((3, 5), bool)
    cost, _ = plans.dijkstra(everywhere, (1, 2))
    targets = plans.frontier(everywhere, cost, known, nowhere)
    assert targets.astype(int).tolist() == [[0, 0, 0, 1, 0], [1, 1, 0, 1, 1], [0, 1, 0, 0, 0]]
    assert plans.closest(targets, cost) == 6  # (1, 1) and (1, 3) both cost one step
    assert plans.closest(nowhere, cost) == -1
    exhausted = nowhere.copy()
    exhausted[1, 1] = True
    assert plans.closest(plans.frontier(everywhere, cost, known, exhausted), cost) == 8
    assert not plans.frontier(nowhere, cost, known, nowhere).any()
    assert not plans.frontier(everywhere, np.full((3, 5), FAR), known, nowhere).any()


# ---------------------------------------------------------------- episodes


def test_a_room_seen_from_its_middle_is_done_at_once():
    result = simulate(ringed((7, 7)), 3, 3, range_m=20.0)
    assert picture(result) == "\n".join(["?#####?"] + ["#.....#"] * 5 + ["?#####?"])  # x first hides the corners
    assert (result.outcome, result.plans, result.scans, result.turns) == ("COMPLETE", 1, 2, 0)
    assert (result.path_m, result.explored_fraction) == (0.0, 1.0)
    assert result.headings == [0, 180]
    assert result.visited == [(3, 3)]
    assert result.path_m_at == {50: 0.0, 90: 0.0, 95: 0.0, 99: 0.0}
    assert result.room_entries is None
    assert result.misses[3, 3] == 2
    assert result.log == [simulator.Plan((3, 3), None, 0, [])]


CORRIDOR = """
    ############
    #..........#
    #..........#
    #..........#
    ############"""


@pytest.mark.parametrize(
    ("recheck", "plans"),
    [
        (False, [((2, 2), (2, 5)), ((2, 5), (2, 8)), ((2, 8), None)]),
        (True, [((2, c), (2, c + 3)) for c in range(2, 8)] + [((2, 8), None)]),
    ],
)
def test_a_corridor_with_and_without_rechecking(recheck, plans):
    # From column c the robot knows rows 1 to 3 up to column c + 3 and the walls up to c + 2. So (2, c + 3) is the
    # nearest frontier, is exhausted after one step, and every step shows five cells. Column 8 sees the end wall.
    result = simulate(world(CORRIDOR), 2, 2, recheck=recheck)
    assert [(p.robot, p.target) for p in result.log] == plans
    assert all(p.cost == 3 * S for p in result.log[:-1])
    assert result.log[0].path == [(2, 3), (2, 4), (2, 5)]
    assert result.known_after_step == [26, 31, 36, 41, 46, 51, 56]
    assert result.visited == [(2, c) for c in range(2, 9)]
    assert (result.straight, result.diagonal, result.turns, result.scans) == (6, 0, 0, 8)
    assert (result.outcome, result.exhausted, result.plans) == ("COMPLETE", 0, len(plans))
    assert result.path_m == 6.0
    assert result.path_m_at == {50: 1.0, 90: 5.0, 95: 6.0, 99: 6.0}  # 28, 50.4, 53.2, 55.44 of 56 cells
    assert picture(result) == "\n".join(["?##########?"] + ["#..........#"] * 3 + ["?##########?"])


def test_corners_that_no_beam_reaches_exhaust_their_frontiers():
    # Without clearance both end cells stay next to a corner that nothing can show: two look-arounds, both in vain.
    result = simulate(world("####### #.....# #######"), 1, 2, range_m=2.0, clearance_m=0.0, near_m=0.0)
    assert result.visited == [(1, 2), (1, 1), (1, 2), (1, 3), (1, 4), (1, 5)]
    assert result.headings == [0, 180, 180, 270, 0, 90, 0, 0, 0, 0, 90, 180, 270]
    assert result.turns == 4 + 6 + 2 + 6  # to 180, round to 90, back to 0, round to 270
    assert result.turning_rad == 18 * math.pi / 4
    assert (result.exhausted, result.plans, result.scans, result.outcome) == (2, 4, 13, "COMPLETE")
    assert result.known_after_step == [13, 13, 13, 16, 17, 17]
    assert picture(result) == "?#####?\n#.....#\n?#####?"


def test_start_heading_turns_and_field_of_view():
    walled = world(CORRIDOR)
    up = simulate(walled, 2, 2, 90)
    assert up.headings[:3] == [90, 270, 0]
    assert up.turns == 2  # from 90, where the initial scans leave it, to 0
    quarters = simulate(walled, 2, 2, 45, fov_deg=90.0, n_beams=91)
    assert quarters.headings[:5] == [45, 135, 225, 315, 0]
    assert quarters.turns == 1
    assert simulate(walled, 2, 2, 0, fov_deg=360.0, n_beams=360).headings[:2] == [0, 0]
    assert [simulator.initial_scan_count(f) for f in (360, 270, 180, 120, 100, 90, 50, 45, 10)] == [
        1, 2, 2, 4, 4, 4, 8, 8, 8,
    ]  # fmt: skip
    with pytest.raises(ValueError, match="multiple of 45"):
        simulate(walled, 2, 2, 30)


@pytest.mark.parametrize("start", [(1, 1), (0, 0)])
def test_an_enclosed_start_is_stuck(start):
    result = simulate(ringed((3, 3)), *start, rooms=np.zeros((3, 3), int))
    assert (result.outcome, result.scans, result.plans, result.path_m) == ("STUCK", 0, 0, 0.0)
    assert not (result.hits + result.misses).any()
    assert (result.explored_fraction, result.path_m_at[99], result.room_entries) == (0.0, 0.0, 1)


def test_only_one_clear_cell_is_stuck_and_a_second_room_behind_a_wall_is_no_goal():
    assert simulate(ringed((5, 5)), 2, 2).outcome == "STUCK"
    apart = world("""
        #########
        #....#..#
        #....#..#
        #....#..#
        #########""")
    result = simulate(apart, 2, 2)
    assert result.outcome == "COMPLETE"
    assert result.explored_fraction == 1.0
    assert not (result.hits + result.misses)[:, 6:].any()


def test_bounds_end_the_episode():
    walled = world(CORRIDOR)
    short = simulate(walled, 2, 2, max_steps=4)
    assert (short.outcome, short.steps, short.plans, short.scans) == ("STEP_LIMIT", 4, 2, 6)
    once = simulate(walled, 2, 2, max_plans=1)
    assert (once.outcome, once.steps, once.plans) == ("PLAN_LIMIT", 3, 1)
    assert simulate(walled, 2, 2, max_plans=3, max_steps=6).outcome == "COMPLETE"  # bounds just wide enough
    assert simulate(walled, 2, 2, max_plans=2).outcome == "PLAN_LIMIT"


def test_diagonal_steps_drive_the_cells_beside_them():
    robot = simulator.Robot(ringed((5, 5)), (1, 1), 0, lambda *pose: [], 0.25, 0)
    robot.result.misses[2, 2] = 1
    assert robot.step((2, 2))
    assert robot.driven.astype(int).tolist() == [
        [0, 0, 0, 0, 0],
        [0, 1, 1, 0, 0],
        [0, 1, 1, 0, 0],
        [0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0],
    ]
    assert (robot.result.straight, robot.result.diagonal, robot.result.turns) == (0, 1, 1)
    assert robot.result.headings == [45]
    assert not robot.step((3, 3))  # unknown and not driven
    assert robot.cell == (2, 2)
    assert robot.step((2, 1))  # unknown, but driven
    assert (robot.result.straight, robot.result.turns) == (1, 1 + 0 + 3)  # to 45, stays, to 180
    simulator.measure(robot, (1, 1), 0.5, None)
    assert robot.result.path_m == pytest.approx(0.5 * (1 + math.sqrt(2)))


def test_a_step_into_a_wall_that_the_scanner_misses_is_refused():
    truth, believed = world("####### #...#.# #######"), world("####### #.....# #######")

    def blind(row, col, heading_deg):
        return beams.scan(believed, row, col, heading_deg, 181, 180.0, 20.0)

    result = simulate(truth, 1, 2, clearance_m=0.0, near_m=0.0, sense=blind, max_plans=5)
    # The end cells adjoin unseen corners. (1, 1) is exhausted first; then three plans lead to (1, 5), all in vain.
    assert [p.target for p in result.log] == [(1, 1), (1, 5), (1, 5), (1, 5), (1, 5)]
    assert result.visited == [(1, 2), (1, 1), (1, 2), (1, 3)]
    assert (result.outcome, result.refused, result.steps) == ("PLAN_LIMIT", 4, 3)
    assert result.headings[-4:] == [0, 0, 0, 0]
    assert result.scans == 2 + 1 + 3 + 2 + 4
    assert len(result.known_after_step) == 4


def test_a_robot_that_sees_nothing_is_blocked():
    result = simulate(ringed((7, 7)), 3, 3, sense=lambda *pose: [])
    assert [p.target for p in result.log] == [(3, 3), None]  # it stands on its only frontier
    assert (result.outcome, result.exhausted, result.scans, result.turns) == ("BLOCKED", 1, 2 + 3, 6)
    assert result.explored_fraction == 1 / 25
    assert simulate(ringed((7, 7)), 3, 3, sense=lambda *pose: [], look_around=False).scans == 2


def test_choose_sees_the_candidates_and_is_obeyed():
    seen = []

    def last(candidates, costs, plan_number):
        seen.append((candidates.tolist(), costs.tolist(), plan_number))
        return candidates[-1]

    result = simulate(world(CORRIDOR), 2, 2, choose=last)
    # (1, 5), (2, 5) and (3, 5) adjoin unknown cells, and no wall is known yet above or below column 5. The way to
    # the outer two leads through (2, 5): (1, 4) and (3, 4) are not clear, so there is no diagonal past them.
    assert seen[0] == ([17, 29, 41], [4 * S, 3 * S, 4 * S], 0)
    assert result.log[0].target == (3, 5)
    assert [n for *_, n in seen] == list(range(len(seen)))
    with pytest.raises(ValueError, match="one of the candidates"):
        simulate(world(CORRIDOR), 2, 2, choose=lambda *args: 0)


def test_room_entries_count_changes_of_room_not_doorways():
    rooms = np.array([[0, 0, -1, 1, 1, -1, 1, 0]])
    visited = [(0, c) for c in (0, 1, 2, 1, 2, 3, 4, 5, 6, 7)]
    assert simulator.count_room_entries(visited, rooms) == 3  # 0, 1, 0: through -1 and back is no new entry
    assert simulator.count_room_entries([(0, 2)], rooms) == 0
    halves = np.repeat([[0] * 6 + [1] * 6], 5, axis=0)
    assert simulate(world(CORRIDOR), 2, 2, rooms=halves).room_entries == 2


def test_goal_cells_start_in_a_narrow_place():
    occupied = world("""
        #########
        ####....#
        #.......#
        ####....#
        #########""")
    clear_cells = [[2, 4], [2, 5], [2, 6]]
    for start in ((2, 5), (2, 3), (2, 2)):  # from (2, 2) the free cell (2, 3) is near, and (2, 4) is clear
        assert np.argwhere(simulator.goal_cells(occupied, start, clear_r2=1, near_r2=1)).tolist() == clear_cells
    assert not simulator.goal_cells(occupied, (2, 1), clear_r2=1, near_r2=1).any()
    assert simulator.goal_cells(occupied, (2, 1), clear_r2=1, near_r2=4).any()
    walled = occupied.copy()
    walled[2, 3] = True  # near, but no way through
    assert np.argwhere(simulator.goal_cells(walled, (2, 2), clear_r2=0, near_r2=1)).tolist() == [[2, 1], [2, 2]]


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 1000), st.booleans())
def test_laws_of_an_episode_in_a_random_cave(seed, recheck):
    rng = np.random.default_rng(seed)
    occupied = ringed((20, 24)) | (rng.random((20, 24)) < 0.04)
    occupied[8:13, 8:13] = False
    result = simulate(occupied, 10, 10, recheck=recheck, range_m=6.0)
    assert result.outcome in ("COMPLETE", "BLOCKED")
    assert result.plans == len(result.log)
    assert result.scans == len(result.headings) == len(result.known_after_scan)
    assert result.steps == len(result.visited) - 1 == len(result.known_after_step) - 1
    assert not any(occupied[cell] for cell in result.visited)
    assert result.refused == 0
    assert np.diff(result.known_after_step).min(initial=0) >= 0
    assert not result.hits[~occupied].any()
    assert not result.misses[occupied].any()
    for a, b in itertools.pairwise(result.visited):
        motion = b[0] - a[0], b[1] - a[1]
        assert plans.may_step(~occupied, *a, motion)
    shares = [result.path_m_at[q] for q in simulator.SHARES]
    assert shares == sorted(shares)
    assert shares[-1] <= result.path_m
    assert all(result.path_m_at_any_scan[q] <= result.path_m_at[q] for q in simulator.SHARES)
    assert all(p.cost == sum(costs_of(p)) for p in result.log)


def costs_of(plan):
    """Cost of every step of a plan."""
    cells = [plan.robot, *plan.path]
    return [D if a[0] != b[0] and a[1] != b[1] else S for a, b in itertools.pairwise(cells)]
