"""Other frontiers and other ends of an episode, by hand on small maps, and by all engines on random ones."""

import math

import numpy as np
import pytest
from ref import fuzz, maps
from ref.refusals import refused

import jexplore as jx
from jexplore.config import InputWarning
from jexplore.rules import Lidar, Robot, Rules
from jexplore.studies.explore import replay_of

pytestmark = pytest.mark.jit
POINT = Rules(clearance_m=0.0, near_m=0.0, frontier_connectivity=4)
CROSS = Lidar(n_beams=4, fov_deg=360, range_m=2.0)  # in cells of one metre: two cells ahead, back, left and right
ROUND = Lidar(n_beams=360, fov_deg=360, range_m=20.0)
CORRIDOR = "#######\n#S....#\n#######"
ROOM = "#####\n#...#\n#.S.#\n#...#\n#####"


def play(text, rules, lidar=CROSS, strategy="closest", **how):
    """Return the measures of one episode from the cell `S`, heading east, in cells of one metre."""
    world = jx.World(maps.walls(text.replace("S", ".")), cell_m=1.0, name="pencil")
    start = (*maps.one(text, "S"), 0)
    return jx.explore(world, strategy, start=start, lidar=lidar, rules=rules, **how)


def test_an_inner_corner_is_a_frontier_of_a_point_robot_unless_only_edges_count():
    """The robot sees all but the four cells where two walls meet; with 8 it drives into all corners for nothing."""
    found = {n: play(ROOM, POINT.replace(frontier_connectivity=n), ROUND).measures for n in (8, 4)}
    assert [found[n]["exhausted"] for n in (8, 4)] == [4, 0]
    assert [found[n]["outcome"] for n in (8, 4)] == ["COMPLETE", "COMPLETE"]
    assert found[4]["path_m"] == 0
    assert found[8]["path_m"] == pytest.approx(math.sqrt(2) + 3 * 2)  # to the first corner, and along three walls


@pytest.mark.parametrize(("least", "path_m", "outcome"), [(1, 4, "COMPLETE"), (3, 4, "COMPLETE"), (4, 0, "BLOCKED")])
def test_groups_of_few_cells_are_no_frontier(least, path_m, outcome):
    """A corridor three cells wide, seen three cells far, with all round in view: its end is a group of three."""
    text = "########\n#......#\n#S.....#\n#......#\n########"
    lidar = ROUND.replace(range_m=3.0)
    found = play(text, POINT.replace(min_frontier_cells=least), lidar).measures
    assert found["outcome"] == outcome
    assert (found["path_m"] > 0) == (path_m > 0)


# In the corridor 17 cells can be known: 5 free ones, 5 walls above and below, 2 at the ends. From the start 6 are seen,
# after a step 9, then 12, 14 or 15, ...
@pytest.mark.parametrize(
    ("change", "path_m", "outcome"),
    [
        ({}, 4, "COMPLETE"),
        ({"stop_at": 0.3}, 0, "EXPLORED"),
        ({"stop_at": 0.5}, 1, "EXPLORED"),  # 9 of 17 are more than half
        ({"stop_at": 0.5, "return_home": True}, 2, "EXPLORED"),
        ({"stop_at": 0.3, "return_home": True}, 0, "EXPLORED"),  # it is at home
        ({"return_home": True}, 8, "COMPLETE"),
        ({"max_path_m": 2.5}, 2, "PATH_LIMIT"),
        ({"max_path_m": 3.0}, 3, "PATH_LIMIT"),
        ({"max_path_m": 0.9}, 0, "PATH_LIMIT"),
        ({"max_path_m": 6.0, "return_home": True}, 6, "PATH_LIMIT"),  # on its way home
        ({"max_time_s": 2.8}, 1, "TIME_LIMIT"),  # a metre takes 2.833 s from standing, two 4.833
        ({"max_time_s": 2.9}, 2, "TIME_LIMIT"),
        ({"max_plans": 2, "return_home": True}, 2, "PLAN_LIMIT"),
    ],
)
def test_ends_in_a_corridor(change, path_m, outcome):
    found = play(CORRIDOR, POINT.replace(**change))
    assert (found.measures["outcome"], found.measures["path_m"]) == (outcome, path_m)
    if outcome in ("COMPLETE", "EXPLORED") and change.get("return_home"):
        assert (found.final.rows[-1], found.final.cols[-1]) == (1, 1)


def test_time_is_that_of_the_robot():
    slow = Robot(speed_m_s=0.1)
    found = jx.compare(
        jx.World(maps.walls(CORRIDOR.replace("S", ".")), cell_m=1.0, name="pencil"), "closest", episodes=1,
        start=(1, 1, 0), lidar=CROSS, rules=POINT.replace(max_time_s=11), robot=slow,
    )  # fmt: skip
    assert found.episodes[["path_m", "outcome"]].values.tolist() == [[2, "TIME_LIMIT"]]


def test_stopping_early_is_the_beginning_of_the_whole_episode():
    """The path to a share is that of the curve of the whole episode at this share."""
    world = jx.load_world("rooms#3:width_m=8,height_m=6")
    whole = jx.compare(world, "closest+recheck", episodes=4, seed=1)
    ((_, curves),) = whole.progress.items()
    for share in (30, 80, 99):
        found = jx.compare(world, "closest+recheck", episodes=4, seed=1, rules={"stop_at": share / 100})
        met, ends = np.isfinite(curves[:, share - 1]), (found.episodes["outcome"] == "EXPLORED").to_numpy()
        np.testing.assert_array_equal(ends, met)
        wanted = np.where(met, curves[:, share - 1], whole.episodes["path_m"])
        np.testing.assert_allclose(found.episodes["path_m"], wanted, rtol=1e-6)
        assert met.any()


def test_a_replay_shows_the_way_home():
    found = play(CORRIDOR, POINT.replace(return_home=True))
    plans = found.final.plans
    assert [plan.target for plan in plans[-2:]] == [None, (1, 1)]
    assert plans[-1].is_view
    assert replay_of(found).steps.tolist() == list(range(9))


@pytest.mark.slow
@pytest.mark.parametrize("number", range(16))
def test_all_engines_and_the_oracle_agree(number):
    assert fuzz.compare(fuzz.draw_case(2, number, fuzz.ENDS)).differences == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stop_at": 0}, "rules.stop_at must be a number at least 0.0001 and at most 1, got 0"),
        ({"stop_at": 99}, "rules.stop_at must be a number at least 0.0001 and at most 1, got 99"),
        ({"max_path_m": -1}, "rules.max_path_m must be a number at least 0 and at most 1e\\+06, got -1"),
        ({"max_time_s": 1e8}, "rules.max_time_s must be a number at least 0 and at most 1.07374e\\+06, got 1"),
        ({"min_frontier_cells": 0}, "rules.min_frontier_cells must be an integer from 1 to 1000, got 0"),
        ({"frontier_connectivity": 6}, r"unknown frontier_connectivity '6' \(there are: 8, 4\)"),
        ({"frontier_connectivity": 4.0}, "unknown frontier_connectivity '4.0'"),
        ({"return_home": "yes"}, "rules.return_home must be True or False, got 'yes'"),
    ],
)
def test_wrong_rules_are_refused(change, message):
    refused(f"^{message}", Rules, **change)


def test_an_environment_does_not_drive_home():
    refused(r"^rules.return_home must be False", jx.Environment, "maze:width_m=6", rules={"return_home": True})


def test_a_share_that_can_hardly_be_met_is_told():
    """A passage in which the robot does not fit, longer than its scanner sees."""
    occupied = np.zeros((12, 200), bool)
    occupied[:, 60:] = True
    occupied[6] = False
    world = jx.World(occupied, cell_m=0.1, name="gap")
    with pytest.warns(InputWarning, match=r"^'gap': rules.stop_at 0.95 can hardly be met: 0\.\d+ of the cells lie"):
        jx.compare(world, "closest", episodes=1, start=(6, 20, 0), lidar={"range_m": 3.0}, rules={"stop_at": 0.95})
