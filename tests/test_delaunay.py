"""Delaunay triangles: parity with scipy on random scans, points on one line or on one circle, laws."""

import math

import jax
import numpy as np
import pytest
from scipy import spatial

from jexplore.arrays.delaunay import circumcircles, delaunay

pytestmark = pytest.mark.jit

N = 48
one = jax.jit(delaunay)


def triangles(points, valid=None):
    """The valid triangles, as a sorted list of tuples; every one comes once and in ascending order.

    All sets are filled up to N points with such that are not there: one program for all.
    """
    points = np.asarray(points, np.float32)
    n = len(points)
    there = np.zeros(N, bool)
    there[:n] = True if valid is None else valid
    found = one(np.concatenate([points, np.full((N - n, 2), 0.5, np.float32)]), there)
    assert found.corner.shape == (2 * N, 3)
    assert found.valid.shape == (2 * N,)
    assert found.corner.dtype == np.int32
    assert found.valid.dtype == bool
    kept = [tuple(row) for row in np.asarray(found.corner)[np.asarray(found.valid)].tolist()]
    assert all(a < b < c < n for a, b, c in kept)
    assert len(set(kept)) == len(kept)
    return sorted(kept)


def circle(points, corner):
    """Centre and radius, float64."""
    a, b, c = np.asarray(points, np.float64)[list(corner)]
    centre = np.linalg.solve(2 * np.stack([b - a, c - a]), [(b - a) @ (b + a), (c - a) @ (c + a)])
    return centre, np.hypot(*(centre - a))


SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]


@pytest.mark.parametrize(
    "points",
    [
        [[4, 0], [0, 0], [3, 0], [1, 0], [2, 0]],
        [[8, -4], [0, 0], [6, -3], [2, -1], [4, -2]],
        np.zeros((0, 2)),
        [[0, 0], [1, 0]],
    ],
)
def test_points_on_one_line_and_fewer_than_three_make_no_triangle(points):
    assert triangles(points) == []


def test_of_four_points_on_one_circle_every_triangle_may_be_valid():
    found = triangles(SQUARE)
    assert {corner for triangle in found for corner in triangle} == {0, 1, 2, 3}
    assert len(found) >= 2
    for triangle in found:
        centre, radius = circle(SQUARE, triangle)
        np.testing.assert_allclose(centre, [0.5, 0.5])
        assert radius == pytest.approx(math.sqrt(0.5))


@pytest.mark.parametrize(("offset", "width"), [(0.0, 2), (0.5, 10), (0.25, 2)])
def test_no_edge_leaps_over_a_point_of_a_straight_wall(offset, width):
    """A passage: the points of both walls lie exactly on lines."""
    wall = np.arange(6.0)
    points = np.concatenate([np.stack([wall, 0 * wall], 1), np.stack([wall + offset, 0 * wall + width], 1)])
    for order in (np.arange(12), np.random.default_rng(0).permutation(12)):
        found = triangles(points[order])
        assert found
        for triangle in order[np.array(found)]:
            assert {corner < 6 for corner in triangle} == {True, False}
            for i in range(3):
                a, b = triangle[i - 1], triangle[i]
                if (a < 6) == (b < 6):
                    assert abs(a - b) == 1
        if offset == 0.25:  # no four of them lie on one circle
            assert len(found) == 10


def clouds(rng):
    return rng.uniform(-3, 3, (N, 2))


def passage(rng):
    """Points of a scan along two walls, with noise of ranges."""
    bearing = np.linspace(-1.4, 1.4, N) + rng.normal(scale=0.003, size=N)
    width = rng.uniform(1, 3)
    ranges = np.minimum(np.where(bearing > 0, width, -1.0) / np.sin(bearing), rng.uniform(4, 6))
    ranges += rng.normal(scale=rng.choice([0.003, 0.03]), size=N)
    return ranges[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], 1)


def clusters(rng):
    return rng.uniform(-3, 3, (6, 2))[rng.integers(0, 6, N)] + rng.normal(scale=0.1, size=(N, 2))


def thin(points, triangle):
    """Return whether a triangle has hardly any height: with rounded numbers it may exist or not."""
    a, b, c = points[list(triangle)]
    area2 = abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
    return area2 < 1e-4 * max(np.sum((p - q) ** 2) for p, q in ((a, b), (b, c), (c, a)))


def is_close_call(points, triangle):
    """Return whether a fourth point lies on its circle, within rounding."""
    centre, radius = circle(points, triangle)
    return np.sort(np.abs(np.hypot(*(points - centre).T) - radius))[3] < 1e-4 * radius


@pytest.mark.parametrize("kind", [clouds, passage, clusters])
def test_triangles_are_scipys(kind):
    rng = np.random.default_rng(1)
    unlike = total = 0
    for _ in range(30):
        points = kind(rng).astype(np.float32)
        valid = rng.random(N) < rng.choice([0.3, 0.8, 1.0])
        valid[:4] = True
        points[~valid] = rng.choice([0, 5], (N, 1))[~valid]  # what stands in unused slots does not matter
        at = np.flatnonzero(valid)
        exact = points.astype(np.float64)
        want = {tuple(sorted(at[row].tolist())) for row in spatial.Delaunay(exact[at]).simplices}
        got = set(triangles(points, valid))
        different = [t for t in got ^ want if not thin(exact, t)]
        unlike += len(different)
        total += len(want)
        assert all(is_close_call(exact[at], [int(np.searchsorted(at, k)) for k in t]) for t in different)
    assert unlike <= 0.002 * total


def test_circles_by_hand():
    points = np.array([[0, 0], [4, 0], [0, 3], [1, 1], [-1, 1], [2, 0]], np.float32)
    corner = np.array([[0, 1, 2], [1, 2, 0], [0, 3, 4], [3, 4, 0]], np.int32)
    centre, radius, side2 = circumcircles(points, corner)
    np.testing.assert_allclose(centre, [[2, 1.5], [2, 1.5], [0, 1], [0, 1]], atol=1e-6)
    np.testing.assert_allclose(radius, [2.5, 2.5, 1, 1], atol=1e-6)
    np.testing.assert_allclose(side2, [[25, 9, 16], [9, 16, 25], [4, 2, 2], [2, 2, 4]], atol=1e-6)


def test_a_flat_triangle_has_a_radius_of_inf():
    points = np.array([[0, 0], [4, 0], [1, 0], [2, 5], [2, 5]], np.float32)
    centre, radius, side2 = circumcircles(points, np.array([[0, 1, 2], [0, 3, 4], [0, 0, 0]], np.int32))
    np.testing.assert_array_equal(radius, [np.inf] * 3)
    assert np.isfinite(centre).all()
    np.testing.assert_array_equal(side2, [[9, 1, 16], [0, 29, 29], [0, 0, 0]])
