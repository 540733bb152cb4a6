"""The oracle of episodes: maps that one can check with a pencil, laws, bad input. Kernels hold the other oracles."""

import math

import numpy as np
import pytest
from ref import beams, maps, plans, simulator

S, D, FAR = plans.STRAIGHT, plans.DIAGONAL, plans.FAR


def simulate(occupied, row, col, heading=0, **changes):
    """An episode in cells of one metre: clearance and near radius one cell unless changed."""
    rules = {"recheck": False, "cell_m": 1.0, "clearance_m": 1.0, "near_m": 1.0, "range_m": 3.0}
    return simulator.simulate(occupied, row, col, heading, **(rules | changes))


def ringed(shape):
    """An empty room with its walls."""
    return np.pad(np.zeros((shape[0] - 2, shape[1] - 2), bool), 1, constant_values=True)


def test_a_room_seen_from_its_middle_is_done_at_once():
    result = simulate(ringed((7, 7)), 3, 3, range_m=20.0)
    assert maps.picture(result.hits, result.misses) == [
        "?#####?",
        *["#.....#"] * 5,
        "?#####?",
    ]  # x first hides the corners
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
    result = simulate(maps.walls(CORRIDOR), 2, 2, recheck=recheck)
    assert [(p.robot, p.target) for p in result.log] == plans
    assert all(p.cost == 3 * S for p in result.log[:-1])
    assert result.log[0].path == [(2, 3), (2, 4), (2, 5)]
    assert result.known_after_step == [26, 31, 36, 41, 46, 51, 56]
    assert result.visited == [(2, c) for c in range(2, 9)]
    assert (result.straight, result.diagonal, result.turns, result.scans) == (6, 0, 0, 8)
    assert (result.outcome, result.exhausted, result.plans) == ("COMPLETE", 0, len(plans))
    assert result.path_m == 6.0
    assert result.path_m_at == {50: 1.0, 90: 5.0, 95: 6.0, 99: 6.0}  # 28, 50.4, 53.2, 55.44 of 56 cells
    assert maps.picture(result.hits, result.misses) == ["?##########?", *["#..........#"] * 3, "?##########?"]


def test_corners_that_no_beam_reaches_exhaust_their_frontiers():
    # Without clearance both end cells stay next to a corner that nothing can show: two look-arounds, both in vain.
    result = simulate(maps.walls("####### #.....# #######"), 1, 2, range_m=2.0, clearance_m=0.0, near_m=0.0)
    assert result.visited == [(1, 2), (1, 1), (1, 2), (1, 3), (1, 4), (1, 5)]
    assert result.headings == [0, 180, 180, 270, 0, 90, 0, 0, 0, 0, 90, 180, 270]
    assert result.turns == 4 + 6 + 2 + 6  # to 180, round to 90, back to 0, round to 270
    assert result.turning_rad == 18 * math.pi / 4
    assert (result.exhausted, result.plans, result.scans, result.outcome) == (2, 4, 13, "COMPLETE")
    assert result.known_after_step == [13, 13, 13, 16, 17, 17]
    assert maps.picture(result.hits, result.misses) == ["?#####?", "#.....#", "?#####?"]


def test_start_heading_turns_and_field_of_view():
    walled = maps.walls(CORRIDOR)
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
    apart = maps.walls("""
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
    walled = maps.walls(CORRIDOR)
    short = simulate(walled, 2, 2, max_steps=4)
    assert (short.outcome, short.steps, short.plans, short.scans) == ("STEP_LIMIT", 4, 2, 6)
    once = simulate(walled, 2, 2, max_plans=1)
    assert (once.outcome, once.steps, once.plans) == ("PLAN_LIMIT", 3, 1)
    assert simulate(walled, 2, 2, max_plans=3, max_steps=6).outcome == "COMPLETE"  # bounds just wide enough
    assert simulate(walled, 2, 2, max_plans=2).outcome == "PLAN_LIMIT"


def test_a_step_into_a_wall_that_the_scanner_misses_is_refused():
    truth, believed = maps.walls("####### #...#.# #######"), maps.walls("####### #.....# #######")

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


def test_room_entries_count_changes_of_room_not_doorways():
    rooms = np.array([[0, 0, -1, 1, 1, -1, 1, 0]])
    visited = [(0, c) for c in (0, 1, 2, 1, 2, 3, 4, 5, 6, 7)]
    assert simulator.count_room_entries(visited, rooms) == 3  # 0, 1, 0: through -1 and back is no new entry
    assert simulator.count_room_entries([(0, 2)], rooms) == 0
    halves = np.repeat([[0] * 6 + [1] * 6], 5, axis=0)
    assert simulate(maps.walls(CORRIDOR), 2, 2, rooms=halves).room_entries == 2
