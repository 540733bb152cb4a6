"""The reflection map: pencil cases, the oracle's classes, laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref import plans
from scipy import ndimage

from jexplore import grid as G

SHAPES = ((1, 1), (1, 6), (5, 4), (67, 3))
counts = st.sampled_from(SHAPES).flatmap(
    lambda shape: st.tuples(*[hnp.arrays(np.int32, shape, elements=st.integers(0, 6))] * 2)
)
masks = st.sampled_from(SHAPES).flatmap(lambda shape: hnp.arrays(bool, shape))


def make(hits, misses):
    return G.Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))


def test_a_map_by_hand():
    grid = make([[0, 0, 1, 1, 1, 2]], [[0, 4, 3, 2, 1, 0]])
    np.testing.assert_allclose(G.probability(grid), [[0.5, 0, 0.25, 1 / 3, 0.5, 1]], rtol=1e-7)
    np.testing.assert_array_equal(G.is_known(grid), [[False, True, True, True, True, True]])
    np.testing.assert_array_equal(G.is_free(grid, 0.25), [[False, True, True, False, False, False]])
    np.testing.assert_array_equal(G.is_occupied(grid, 0.25), [[False, False, False, True, True, True]])
    np.testing.assert_array_equal(G.is_free(grid, 0.0), [[False, True, False, False, False, False]])
    assert G.probability(grid).dtype == jnp.float32
    assert G.probability(make([[1, 0]], [[0, 1]])).tolist() == [[1, 0]]  # one observation is enough


def test_entropy_by_hand():
    grid = make([[0, 0, 1, 1, 3, 5]], [[0, 4, 3, 1, 1, 0]])
    np.testing.assert_allclose(G.entropy(grid), [[1, 0, 0.8112781, 1, 0.8112781, 0]], atol=1e-6)


@given(counts)
@settings(max_examples=50, deadline=None)
def test_classes_agree_with_the_oracle(case):
    hits, misses = case
    grid = make(hits, misses)
    for p_free in (0.0, 0.25, 0.5):
        known, free, occupied = plans.classify(hits, misses, p_free)
        np.testing.assert_array_equal(G.is_known(grid), known)
        np.testing.assert_array_equal(G.is_free(grid, p_free), free)
        np.testing.assert_array_equal(G.is_occupied(grid, p_free), occupied)
        np.testing.assert_array_equal(free ^ occupied, known)  # exactly one of the two


def test_neighbours_by_hand():
    b = G.bordered(jnp.asarray([[1, 2], [3, 4]]), 9)
    np.testing.assert_array_equal(b, [[9, 9, 9, 9], [9, 1, 2, 9], [9, 3, 4, 9], [9, 9, 9, 9]])
    np.testing.assert_array_equal(G.beside(b, 0, 0), [[1, 2], [3, 4]])
    np.testing.assert_array_equal(G.beside(b, 1, 0), [[3, 4], [9, 9]])  # what lies one row up
    np.testing.assert_array_equal(G.beside(b, 0, -1), [[9, 1], [9, 3]])
    np.testing.assert_array_equal(G.beside(b, -1, 1), [[9, 9], [2, 9]])


@pytest.mark.jit
@given(masks)
@settings(max_examples=60, deadline=None)
def test_within_one_is_a_dilation_and_counts_count(mask):
    grown = jax.jit(G.any_within_one)(jnp.asarray(mask))
    np.testing.assert_array_equal(grown, ndimage.binary_dilation(mask, np.ones((3, 3))))
    assert G.count(jnp.asarray(mask)) == mask.sum()
    values = np.where(mask, np.arange(mask.size).reshape(mask.shape) - 2, 70)
    assert G.lowest(jnp.asarray(values)) == values.min()


@pytest.mark.parametrize(
    ("radius_m", "cell_m", "d2"),
    [(0.0, 0.1, 0), (0.3, 0.1, 9), (0.5, 0.1, 25), (0.29, 0.1, 8), (0.3, 0.07, 18), (0.05, 0.1, 0), (1.0, 1.0, 1)],
)
def test_a_radius_reaches_the_cells_on_its_circle(radius_m, cell_m, d2):
    assert G.radius_d2(radius_m, cell_m) == plans.radius2(radius_m, cell_m) == d2


def test_metres_and_cells():
    np.testing.assert_allclose(G.centre_of(2, 10, cell_m=0.1), (1.05, 0.25))
    np.testing.assert_allclose(G.centre_of(0, 4, cell_m=0.5, origin_m=(-1.0, 0.2)), (1.25, 0.45))
    rows, cols = np.indices((3, 4))
    x, y = G.centre_of(rows, cols, cell_m=0.1, origin_m=(-0.7, 3.0))
    np.testing.assert_allclose(x, -0.65 + 0.1 * cols)
    np.testing.assert_allclose(y, 3.05 + 0.1 * rows)
    assert [G.in_cells(0.3, 0.1), G.in_cells(8.0, 0.1), G.in_cells(0.25, 0.1)] == [3.0, 80.0, 2.5]
    assert [G.in_cells(1.05, 0.3), G.in_cells(1.5, 0.3), G.in_cells(1.0, 0.07)] == [3.5, 5, 14.285714286]
