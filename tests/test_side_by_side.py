"""Functions that a CPU makes many elements of at a time, beside those of NumPy."""

import numpy as np
import pytest

from jexplore.arrays.side_by_side import bearing, first_least


def test_bearings_are_those_of_arctan2():
    rng = np.random.default_rng(0)
    y, x = rng.normal(size=(2, 10_000)).astype(np.float32) * np.float32(10) ** rng.integers(-6, 6, (2, 10_000))
    np.testing.assert_allclose(bearing(np.float32(y), np.float32(x)), np.arctan2(y, x), atol=4e-6)
    axes = np.float32([(0, 1), (1, 0), (0, -1), (-1, 0), (0, 0)])
    np.testing.assert_allclose(bearing(*axes.T), np.arctan2(*axes.T), atol=4e-6)


@pytest.mark.parametrize("values", [[3, 1, 1, 2], [np.inf] * 3, [2, np.inf, 2], [5]])
def test_the_first_of_the_least_is_found(values):
    assert int(first_least(np.float32(values))) == np.argmin(values)
