"""Poses that fit what was measured between them: cases one can check with a pencil, and scipy's least squares."""

import math

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from jexplore.arrays.pose_graph import settle

pytestmark = pytest.mark.jit
SIDE = [(4.0, 0.0, math.pi / 2)]  # of a square: ahead, then a quarter turn to the left
POSES, MOVES = 9, 12
SETTLE = jax.jit(settle)


def padded(pose, ends, moved, spread):
    """Poses and moves that are none fill up: one program for all sizes."""
    none = MOVES - len(ends)
    rows = (
        np.vstack([pose, np.ones((POSES - len(pose), 3))]),
        [*ends, *[(-1, -1)] * none],
        [*moved, *[(1, 1, 1)] * none],
        [*spread, *[(1, 1)] * none],
    )
    return [np.asarray(a, kind) for a, kind in zip(rows, (np.float32, np.int32, np.float32, np.float32))]


def settled(pose, ends, moved, spread):
    found = SETTLE(*padded(pose, ends, moved, spread))
    return np.asarray(found.pose)[: len(pose)], np.asarray(found.misfit)[: len(ends)]


def misfit(pose, ends, moved, spread):
    """The misfit in other words: every move as seen from its first pose, with complex numbers."""
    z, heading = pose[:, 0] + 1j * pose[:, 1], pose[:, 2]
    rows = []
    for (i, j), (x, y, turn), (place, angle) in zip(ends, moved, spread):
        if i >= 0 and j >= 0:
            off = (z[j] - z[i]) * np.exp(-1j * heading[i]) - (x + 1j * y)
            aside = np.angle(np.exp(1j * (heading[j] - heading[i] - turn)))
            rows += [off.real / place, off.imag / place, aside / angle]
    return np.array(rows)


# Pencil


def test_a_square_that_closes_is_a_square():
    pose, off = settled([[0, 0, 0], [4, 0, 1], [4, 4, 3], [0, 4, 4]],
                        [(0, 1), (1, 2), (2, 3), (3, 0)], SIDE * 4, [(0.1, 0.1)] * 4)  # fmt: skip
    np.testing.assert_allclose(pose[:, :2], [[0, 0], [4, 0], [4, 4], [0, 4]], atol=1e-4)
    np.testing.assert_allclose(pose[:, 2], np.arange(4) * math.pi / 2, atol=1e-4)
    assert np.abs(off).max() < 1e-3


def test_a_known_misfit_is_spread_evenly():
    """Along a line there and back: 4 m, 4 m and -7.7 m; of the 0.3 m too many every move takes a third."""
    pose, off = settled([[0, 0, 0], [4, 0, 0], [8, 0, 0]], [(0, 1), (1, 2), (2, 0)],
                        [(4, 0, 0), (4, 0, 0), (-7.7, 0, 0)], [(0.1, 0.01)] * 3)  # fmt: skip
    np.testing.assert_allclose(pose, [[0, 0, 0], [3.9, 0, 0], [7.8, 0, 0]], atol=1e-4)
    np.testing.assert_allclose(off[:, 0], [1, 1, 1], atol=1e-2)


def test_a_move_twice_as_sure_is_changed_a_quarter_as_much():
    pose, _ = settled([[0, 0, 0], [4, 0, 0]], [(0, 1), (0, 1)], [(4, 0, 0), (4.5, 0, 0)], [(0.1, 0.1), (0.2, 0.1)])
    np.testing.assert_allclose(pose[1], [4.1, 0, 0], atol=1e-4)


def test_what_nobody_measured_stays():
    """Places without a measurement, pose 0, poses apart from it, and turns of which nothing is known."""
    first = [[1, 2, 0.5], [3, 2, 0.25], [9, 9, 1], [0, 0, 0]]
    pose, off = settled(first, [(0, 1), (-1, 2), (2, -1)], [(2, 0, math.nan), (9, 9, 9), (9, 9, 9)],
                        [(0.1, math.inf), (1, 1), (1, 1)])  # fmt: skip
    np.testing.assert_allclose(pose[0], first[0], atol=1e-6)
    np.testing.assert_allclose(pose[1], [1 + 2 * math.cos(0.5), 2 + 2 * math.sin(0.5), 0.25], atol=1e-4)
    np.testing.assert_allclose(pose[2:], first[2:], atol=1e-6)
    assert (off[1:] == 0).all()
    assert (off[0, 2] == 0).all()


# Against scipy


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(2, 9), st.integers(0, 4))
def test_it_is_what_least_squares_finds(seed, n, closures):
    rng = np.random.default_rng(seed)
    true = np.column_stack([rng.uniform(-10, 10, (n, 2)), rng.uniform(-3, 3, n)])
    ends = [(i, i + 1) for i in range(n - 1)] + [tuple(rng.choice(n, 2, replace=False)) for _ in range(closures)]
    moved = []
    for i, j in ends:
        z = complex(*(true[j] - true[i])[:2]) * np.exp(-1j * true[i, 2])
        moved.append(np.array([z.real, z.imag, true[j, 2] - true[i, 2]]) + rng.normal(size=3) * [0.2, 0.2, 0.03])
    spread = rng.uniform(0.5, 2, (len(ends), 2)) * [0.2, 0.03]
    first = true + rng.normal(size=(n, 3)) * [0.3, 0.3, 0.05]
    found = least_squares(
        lambda free: misfit(np.vstack([first[:1], free.reshape(-1, 3)]), ends, moved, spread), first[1:].reshape(-1)
    )
    pose, off = settled(first, ends, moved, spread)
    assert misfit(pose, ends, moved, spread) @ misfit(pose, ends, moved, spread) <= 2 * found.cost + 1e-2
    np.testing.assert_allclose(np.sum(off**2), 2 * found.cost, rtol=1e-3, atol=1e-2)
    np.testing.assert_allclose(pose[1:, :2], found.x.reshape(-1, 3)[:, :2], atol=2e-2)


# Laws


def test_many_at_once_are_as_many_one_by_one():
    rng = np.random.default_rng(0)
    pose, moved = (rng.normal(size=(3, 4, 3)) for _ in range(2))
    rows = [padded(p, [(0, 1), (1, 2), (2, 3), (3, 0)], m, [(0.5, 0.5)] * 4) for p, m in zip(pose, moved)]
    many = jax.jit(jax.vmap(settle))(*map(np.stack, zip(*rows)))
    for i, row in enumerate(rows):
        np.testing.assert_allclose(many.pose[i], SETTLE(*row).pose, atol=1e-3)
