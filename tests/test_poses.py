"""Starts as a user writes them: in cells, in metres, with a heading that a grid does not have."""

import math
import warnings

import numpy as np
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.config import InputWarning
from jexplore.studies.checks import ready_starts
from jexplore.worlds.poses import Pose, cell_of, read_start

ROOM = jx.occupancy_to_world(
    np.pad(np.zeros((8, 12), bool), 1, constant_values=True), cell_m=0.1, name="room", origin_m=(-3.0, 2.0)
)
"""10 x 14 cells; x is -3 to -1.6 m, y 2 to 3 m."""
RULES = jx.Rules(clearance_m=0.1)


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ("random", "random"),
        ("world", "world"),
        ("12,30,90", (12, 30, 90)),
        ("12, 30, -45", (12, 30, -45)),
        (np.array([1, 2, 90]), (1, 2, 90)),
        ("2.0m,1.5m,90", Pose(2.0, 1.5, 90.0)),
        ("-2 m, .5 m, 90 deg", Pose(-2.0, 0.5, 90.0)),
        ("2m,1e-1m,-45°", Pose(2.0, 0.1, -45.0)),
    ],
)
def test_a_start_says_itself_whether_it_is_in_cells_or_metres(given, found):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_start(given) == found


def test_a_yaw_in_radians_is_marked():
    pose = read_start("2m,1m,1.5708rad")
    assert isinstance(pose, Pose)
    assert pose.yaw_deg == pytest.approx(90, abs=1e-3)


@pytest.mark.parametrize(
    ("start", "start_m", "line"),
    [
        ("2.0,1.5,90", None, "metres such as 2.0m,1.5m,90"),
        ("2m,1.5m", None, "metres such as 2.0m,1.5m,90"),
        ("2m,1.5,90", None, "metres such as 2.0m,1.5m,90"),
        ("nearest", None, "start must be random, world, cells"),
        ((2.0, 1.5, 90), None, "metres go into start_m"),
        (7, None, "start must be random, world, or row, col"),
        ("random", (1, 2), "start_m must be x_m, y_m, yaw_deg"),
        ("random", (1, math.nan, 0), "y of the start must be a number"),
        ("random", ("1", 2, 0), "x of the start must be a number"),
        ("world", (1, 2, 0), "give one"),
    ],
)
def test_what_is_no_start_is_refused_with_what_is_one(start, start_m, line):
    refused(line, read_start, start, start_m)


@pytest.mark.parametrize(
    ("x_m", "y_m", "cell"),
    [
        (-3.0, 2.0, (0, 0)),
        (-2.95, 2.35, (3, 0)),
        (-2.7, 2.3, (3, 3)),  # (-2.7 + 3.0) / 0.1 is 2.9999999999999982
        (-1.61, 2.99, (9, 13)),
    ],
)
def test_a_point_lies_in_the_cell_that_has_it_in_the_frame_of_the_map(x_m, y_m, cell):
    assert cell_of(ROOM, Pose(x_m, y_m, 0.0)) == (*cell, 0)


@pytest.mark.parametrize("x_m", [-3.01, -1.59])
def test_a_point_outside_is_told_in_metres(x_m):
    refused(r"lies outside; x is -3 to -1.6 m, y 2 to 3 m", cell_of, ROOM, Pose(x_m, 2.5, 0.0))


@pytest.mark.parametrize(("yaw_deg", "heading"), [(90.2, 90), (-90, 270), (359.9, 0), (44.6, 45), (-180, 180)])
def test_a_heading_is_rounded_without_a_word_within_its_digits(yaw_deg, heading):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cell_of(ROOM, Pose(-2.5, 2.5, yaw_deg))[2] == heading


@pytest.mark.parametrize(("yaw_deg", "heading"), [(80, 90), (1.5708, 0), (30, 45), (359, 0)])
def test_a_heading_that_changes_is_told(yaw_deg, heading):
    with pytest.warns(InputWarning, match=f"becomes {heading}, for headings are multiples of 45 degrees"):
        assert cell_of(ROOM, Pose(-2.5, 2.5, yaw_deg))[2] == heading


def test_every_episode_starts_at_the_point():
    starts = ready_starts(ROOM, read_start("random", (-2.45, 2.45, 90)), 3, seed=0, rules=RULES)
    assert starts.tolist() == [[4, 5, 90]] * 3
    refused(r"^-2.95m,2.45m,0 is start", ready_starts, ROOM, "-2.95m,2.45m,0", 3, seed=0, rules=RULES)
