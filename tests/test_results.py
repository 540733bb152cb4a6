"""The device's integers as metres, radians and words."""

import math

import numpy as np
import pytest
from ref.results import result

from jexplore.exploration import results
from jexplore.grid import Grid, is_free, is_known
from jexplore.rules import Robot


def test_length_along_a_way_by_hand():
    # East, north-east, and then nothing but the start of another way.
    along = results.length_along_m(np.array([5, 5, 6]), np.array([1, 2, 3]), 2.0)
    np.testing.assert_allclose(along, [0, 2, 2 + 2 * math.sqrt(2)])
    assert results.length_along_m(np.array([5]), np.array([1]), 2.0).tolist() == [0.0]


def test_map_state_by_hand_and_as_on_the_device():
    hits, misses = np.array([[0, 0, 1, 1], [1, 2, 5, 0]]), np.array([[0, 4, 3, 2], [0, 6, 1, 1]])
    state = results.map_state(hits, misses, 0.25)
    assert state.tolist() == [[0, 1, 1, 2], [2, 1, 2, 1]]
    cells = np.arange(64, dtype=np.int32).reshape(8, 8)
    grid = Grid(cells % 7, cells // 5)
    for p_free in (0.0, 0.25, 1 / 3, 0.6):
        state = results.map_state(grid.hits, grid.misses, p_free)
        np.testing.assert_array_equal(state != 0, is_known(grid))
        np.testing.assert_array_equal(state == 1, is_free(grid, np.float32(p_free)))


def test_columns_by_hand():
    found = results.columns(
        result(
            2,
            straight=[10, 0],
            diagonal=[0, 4],
            turns=[8, 1],
            outcome=[1, 2],
            explored=[9, 5],
            explorable=[10, 10],
            straight_at=[[1, 2, 3, 4], [0, 0, 0, 0]],
            diagonal_at=[[0, 0, 0, 0], [1, 2, 3, 4]],
            room_entries=[3, 0],
            scans=[12, 5],
        ),
        np.array([[4, 5, 90], [6, 7, 315]]),
        seed=7,
        cell_m=0.1,
        has_rooms=True,
        robot=Robot(),
    )
    assert found["path_m"].tolist() == pytest.approx([1.0, 0.4 * math.sqrt(2)])
    assert found["turning_rad"].tolist() == pytest.approx([2 * math.pi, math.pi / 4])
    assert found["steps"].tolist() == [10, 4]
    assert found["scans"].tolist() == [12, 5]
    assert found["outcome"] == ["COMPLETE", "BLOCKED"]
    assert found["explored_fraction"].tolist() == [0.9, 0.5]
    assert found["path_m_at_50"].tolist() == pytest.approx([0.1, 0.1 * math.sqrt(2)])
    assert found["path_m_at_99"].tolist() == pytest.approx([0.4, 0.4 * math.sqrt(2)])
    assert found["room_entries"] == [3, 0]
    assert [found[f"start_{name}"].tolist() for name in ("row", "col", "heading_deg")] == [[4, 6], [5, 7], [90, 315]]
    assert found["episode"].tolist() == [0, 1]
    assert found["seed"].tolist() == [7, 7]


def test_without_rooms_there_are_no_room_entries():
    found = results.columns(result(), np.zeros((1, 3), int), seed=0, cell_m=1.0, has_rooms=False, robot=Robot())
    assert found["room_entries"] == [None]
