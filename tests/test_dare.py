"""DARE's rules on maps that one can check with a pencil, its planners, its table, refusals."""

import math

import numpy as np
import pandas as pd
import pytest
from parts.dare import own, planners, rules, table
from PIL import Image
from ref.refusals import refused

HALL = np.zeros((13, 93), bool)
HALL[1:12, 1:92] = True  # 36.4 m long: the far end is seen from the third node on


def picture(path, size=rules.PIXELS, n_start=30):
    """A picture of a square room with `n_start` start cells at its upper left, from row 10, column 10."""
    grey = np.full((size, size), 127, np.uint8)
    grey[20:80, 20:80] = 195
    cells = grey[: size // 2 * 2, : size // 2 * 2].reshape(size // 2, 2, size // 2, 2)
    cells[10, :, 10 : 10 + n_start] = rules.START
    Image.fromarray(grey).save(path)


def test_a_cell_is_the_darkest_of_four_pixels_and_the_start_the_eleventh_of_its_grey(tmp_path):
    picture(tmp_path / "1.png", n_start=20)
    free, start = rules.read_map(tmp_path / "1.png")
    want = np.zeros((250, 250), bool)
    want[10:40, 10:40] = True
    assert np.array_equal(free, want)
    assert start == (10, 20)


def test_a_line_goes_across_edges_and_leaves_out_its_end():
    path = rules.lines()[rules.RANGE + 1, rules.RANGE + 3]  # 1 row down, 3 columns right
    assert path[:4].tolist() == [[0, 0], [0, 1], [1, 1], [1, 2]]
    assert not path[4:].any()


def test_a_wall_hides_what_is_behind_it_and_is_seen_itself():
    free = np.ones((1, 5), bool)
    free[0, 3] = False
    ends = np.array([[0, 1], [0, 2], [0, 3], [0, 4]])
    assert rules.in_sight(free, np.array([0, 0]), ends).tolist() == [True, True, True, False]


def test_a_scan_shows_the_cells_round_a_beam_up_to_its_first_hit():
    explorer = rules.explorer(np.array([[0, 0, 0, 0, 0, 0], [0, 1, 1, 0, 1, 0], [0, 0, 0, 0, 0, 0]], bool), (1, 1))
    seen = explorer.belief[rules.PAD : -rules.PAD, rules.PAD : -rules.PAD]
    assert seen[1].tolist() == [rules.OCCUPIED, rules.FREE, rules.FREE, rules.OCCUPIED, rules.FREE, rules.UNKNOWN]


def test_ariadnes_scanner_enters_the_cells_of_beams_alone_and_walls_in_depth():
    explorer = rules.explorer(np.array([[1, 1, 0, 0, 1]], bool), (0, 0), rules.SCANNERS["ariadne"])
    seen = explorer.belief[rules.PAD - 1 : rules.PAD + 1, rules.PAD : -rules.PAD]
    assert seen[1].tolist() == [rules.FREE, rules.FREE, rules.OCCUPIED, rules.OCCUPIED, rules.UNKNOWN]
    bare = rules.explorer(np.array([[1, 1, 0, 0, 1]], bool), (0, 0), rules.SCANNERS["bare"])
    assert bare.belief[rules.PAD, rules.PAD + 3] == rules.UNKNOWN


def test_a_frontier_cell_has_two_to_seven_unknown_neighbours():
    belief = np.full((4, 4), rules.FREE, np.int8)
    belief[0, 0] = rules.UNKNOWN
    assert rules.frontier_cells(belief).tolist() == []  # each of its neighbours has one
    belief[0, 1] = rules.UNKNOWN
    assert rules.frontier_cells(belief).tolist() == [[1, 0], [1, 1]]  # cells (0, 2) and (1, 2) have one


def test_nodes_lie_four_metres_apart_and_are_linked_in_sight():
    explorer = rules.explorer(HALL, (6, 5))
    assert explorer.places == [(0, i) for i in range(6)]  # 50 cells are seen from column 5 on
    assert explorer.links[0] == {1, 2}
    far, before = rules.distances(explorer.links, explorer.cells, [0])
    np.testing.assert_allclose(far[0], [0, 4, 8, 12, 16, 20])
    assert rules.first_step(before[0], 0, 3) in (1, 2)


@pytest.mark.parametrize("name", planners.PLANNERS)
def test_every_planner_explores_a_hall(name):
    explorer, plan, rng = rules.explorer(HALL, (6, 5)), planners.PLANNERS[name](), np.random.default_rng(0)
    while explorer.utility.any():
        node = plan(explorer, rng)
        assert node in explorer.links[explorer.at]
        explorer.move(node)
    assert (explorer.belief[explorer.truth] == rules.FREE).all()
    assert explorer.path_m <= 36.0


def test_the_table_sets_ours_beside_the_papers():
    rows = [{"map": i, "planner": "nearest", "path_m": path, "complete": True} for i, path in enumerate((600.0, 700.0))]
    found = table.DareResult(pd.DataFrame(rows).assign(explored_fraction=1.0))
    row = found.table.iloc[0]
    assert (row["paper_mean"], row["mean"], row["ratio"], row["complete"]) == (652, 650, 650 / 652, 2)
    assert row["high"] - row["mean"] == pytest.approx(12.7062 * math.sqrt(5000 / 2), rel=1e-4)  # t of 1 degree
    text = found.to_markdown()
    assert "| nearest    |  652.00 ± 76.00 |" in text
    assert "| dare       |  563.00 ± 71.00 |   0 |" in text


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"size": 400}, "must have 500 x 500 pixels, not 400 x 400"),
        ({"n_start": 10}, "must show its start by more than 10 cells of grey 208, not 10"),
    ],
)
def test_maps_that_are_none_are_refused(tmp_path, given, says):
    picture(tmp_path / "1.png", **given)
    refused(says, rules.read_map, tmp_path / "1.png")


def test_every_planner_makes_a_row_of_a_map(tmp_path):
    picture(tmp_path / "1.png")
    found = table.reproduce_dare(tmp_path, episodes=1, workers=1).episodes
    assert list(found["planner"]) == list(planners.PLANNERS)
    assert found["complete"].all()


@pytest.mark.slow
@pytest.mark.jit
def test_own_rules_explore_the_same_map_from_the_same_start_above_the_bound(tmp_path, monkeypatch):
    picture(tmp_path / "1.png")
    monkeypatch.setattr(own, "STRATEGIES", ("closest+recheck", "closest"))
    (world,) = own.worlds_of(tmp_path, 1)
    free, (row, col) = rules.read_map(tmp_path / "1.png")
    assert world.start == (249 - row, col, 0)
    assert np.array_equal(~world.occupied[::-1], free)
    found, bounds = own.explore_dare(tmp_path, episodes=1, workers=1)
    assert "| closest+recheck |   1 of 1 |" in own.own_text(found, bounds)
    assert (found.episodes["path_m"] >= bounds.table["low_any_m"].item()).all()
