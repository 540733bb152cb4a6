"""Poses that fit what was measured between them: cases one can check with a pencil."""

import math

import numpy as np

from jexplore.tracemap.corrected import fitted

SIDE = [(4.0, 0.0, math.pi / 2)]  # of a square: ahead, then a quarter turn to the left


def test_a_square_that_closes_is_a_square():
    pose = fitted(np.array([[0, 0, 0], [4, 0, 1], [4, 4, 3], [0, 4, 4.0]]),
                  [(0, 1), (1, 2), (2, 3), (3, 0)], SIDE * 4, [(0.1, 0.1)] * 4)  # fmt: skip
    np.testing.assert_allclose(pose[:, :2], [[0, 0], [4, 0], [4, 4], [0, 4]], atol=1e-4)
    np.testing.assert_allclose(pose[:, 2], np.arange(4) * math.pi / 2, atol=1e-4)


def test_a_known_misfit_is_spread_evenly():
    """Along a line there and back: 4 m, 4 m and -7.7 m; of the 0.3 m too many every move takes a third."""
    pose = fitted(np.array([[0, 0, 0], [4, 0, 0], [8, 0, 0.0]]), [(0, 1), (1, 2), (2, 0)],
                  [(4, 0, 0), (4, 0, 0), (-7.7, 0, 0)], [(0.1, 0.01)] * 3)  # fmt: skip
    np.testing.assert_allclose(pose, [[0, 0, 0], [3.9, 0, 0], [7.8, 0, 0]], atol=1e-4)


def test_a_move_twice_as_sure_is_changed_a_quarter_as_much():
    first = np.array([[0, 0, 0], [4, 0, 0.0]])
    pose = fitted(first, [(0, 1), (0, 1)], [(4, 0, 0), (4.5, 0, 0)], [(0.1, 0.1), (0.2, 0.1)])
    np.testing.assert_allclose(pose[1], [4.1, 0, 0], atol=1e-4)


def test_what_nobody_measured_stays():
    """Places without a measurement, pose 0, poses apart from it, and turns of which nothing is known."""
    first = np.array([[1, 2, 0.5], [3, 2, 0.25], [9, 9, 1], [0, 0, 0]])
    pose = fitted(first, [(0, 1)], [(2, 0, 0)], [(0.1, math.inf)])
    np.testing.assert_allclose(pose[0], first[0], atol=1e-6)
    np.testing.assert_allclose(pose[1], [1 + 2 * math.cos(0.5), 2 + 2 * math.sin(0.5), 0.25], atol=1e-4)
    np.testing.assert_allclose(pose[2:], first[2:], atol=1e-6)
    assert fitted(first, [], [], []) is first
