"""The oracle of episodes on maps that one can check with a pencil; kernels hold the other oracles."""

import numpy as np
import pytest
from ref import maps, plans, simulator

S, D, FAR = plans.STRAIGHT, plans.DIAGONAL, plans.FAR


def simulate(occupied, row, col, heading=0, **changes):
    """An episode in cells of one metre: clearance and near radius one cell unless changed."""
    rules = {"recheck": False, "cell_m": 1.0, "clearance_m": 1.0, "near_m": 1.0, "range_m": 3.0}
    return simulator.simulate(occupied, row, col, heading, **(rules | changes))


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
    assert [known for _, known in result.known_after_scan] == [18, 26, 31, 36, 41, 46, 51, 56]
    assert result.visited == [(2, c) for c in range(2, 9)]
    assert (result.straight, result.diagonal, result.turns, result.scans) == (6, 0, 0, 8)
    assert (result.outcome, result.exhausted, result.plans) == ("COMPLETE", 0, len(plans))
    assert result.path_m_at == {50: 1.0, 90: 5.0, 95: 6.0, 99: 6.0}  # 28, 50.4, 53.2, 55.44 of 56 cells
    assert maps.picture(result.hits, result.misses) == ["?##########?", *["#..........#"] * 3, "?##########?"]


def test_room_entries_count_changes_of_room_not_doorways():
    rooms = np.array([[0, 0, -1, 1, 1, -1, 1, 0]])
    visited = [(0, c) for c in (0, 1, 2, 1, 2, 3, 4, 5, 6, 7)]
    assert simulator.count_room_entries(visited, rooms) == 3  # 0, 1, 0: through -1 and back is no new entry
    assert simulator.count_room_entries([(0, 2)], rooms) == 0
    halves = np.repeat([[0] * 6 + [1] * 6], 5, axis=0)
    assert simulate(maps.walls(CORRIDOR), 2, 2, rooms=halves).room_entries == 2


def test_bounds_end_the_episode():
    walled = maps.walls(CORRIDOR)
    short = simulate(walled, 2, 2, max_steps=4)
    assert (short.outcome, short.steps, short.plans, short.scans) == ("STEP_LIMIT", 4, 2, 6)
    once = simulate(walled, 2, 2, max_plans=1)
    assert (once.outcome, once.steps, once.plans) == ("PLAN_LIMIT", 3, 1)
    assert simulate(walled, 2, 2, max_plans=3, max_steps=6).outcome == "COMPLETE"  # bounds just wide enough
    assert simulate(walled, 2, 2, max_plans=2).outcome == "PLAN_LIMIT"
