"""Vectorised kernels on a CPU compared with NumPy."""

import numpy as np
import pytest

from jexplore.arrays import vectorised


def test_angles_are_those_of_numpy():
    rng = np.random.default_rng(0)
    y, x = (rng.normal(size=(2, 10_000)) * 10.0 ** rng.integers(-35, 6, 10_000)).astype(np.float32)
    np.testing.assert_allclose(vectorised.arctan2(y, x), np.arctan2(y, x), atol=4e-6)
    axes = np.float32([(0, 1), (1, 0), (0, -1), (-1, 0), (0, 0)])
    np.testing.assert_allclose(vectorised.arctan2(*axes.T), np.arctan2(*axes.T), atol=4e-6)


@pytest.mark.parametrize("values", [[3, 1, 1, 2], [np.inf] * 3, [2, np.inf, 2], [5]])
def test_the_first_of_the_least_is_found(values):
    assert int(vectorised.argmin(np.float32(values))) == np.argmin(values)
