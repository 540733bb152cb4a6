"""Exact distances: pencil cases, brute force and scipy, laws, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref import plans
from scipy import ndimage

from jexplore.distance import FAR, nearest_offset, within

SHAPES = ((1, 1), (1, 7), (6, 1), (6, 9))
WITHIN = jax.jit(within, static_argnums=1)


@jax.jit
def nearest_site(sites):
    """Squared distance to the nearest site, and its flat index; -1 without any."""
    d2, drow, dcol = nearest_offset(sites)
    rows, cols = jnp.indices(sites.shape, jnp.int32)
    return d2, jnp.where(d2 < FAR, (rows + drow) * sites.shape[1] + cols + dcol, -1)


def masks(share=None):
    cells = st.booleans() if share is None else st.floats(0, 1).map(lambda u: u < share)
    return st.sampled_from(SHAPES).flatmap(lambda shape: hnp.arrays(bool, shape, elements=cells, fill=st.nothing()))


@pytest.mark.jit
@given(masks() | masks(0.1))
@settings(max_examples=150, deadline=None)
def test_nearest_site_is_brute_force_and_scipy(sites):
    d2, site = nearest_site(jnp.asarray(sites))
    expected_d2, expected_site = plans.nearest_site(sites)
    np.testing.assert_array_equal(d2, expected_d2)
    np.testing.assert_array_equal(site, expected_site)
    if sites.any():
        np.testing.assert_array_equal(d2, np.rint(ndimage.distance_transform_edt(~sites) ** 2))


@pytest.mark.parametrize("d2", [0, 1, 2, 4, 9, 200])
@pytest.mark.jit
@given(mask=masks(0.1) | masks())
@settings(max_examples=15, deadline=None)
def test_within_is_the_oracles_and_agrees_with_nearest_site(d2, mask):
    near = np.asarray(WITHIN(jnp.asarray(mask), d2))
    np.testing.assert_array_equal(near, ~plans.clear(np.ones(mask.shape, bool), mask, d2))
    np.testing.assert_array_equal(near, plans.nearest_site(mask)[0] <= d2)


@pytest.mark.jit
@pytest.mark.parametrize("d2", [0, 5, 9, 31**2, 1023, 1024, 40**2, 80**2])
def test_within_reaches_across_many_rows(d2):
    """Taller than a machine word, and radii longer than one, and longer than the map."""
    for seed in range(3):
        mask = np.random.default_rng(seed).random((70, 12)) < 0.003
        mask[33 * seed, 4] = True
        near = np.asarray(WITHIN(jnp.asarray(mask), d2))
        np.testing.assert_array_equal(near, ~plans.clear(np.ones(mask.shape, bool), mask, d2))


@pytest.mark.parametrize("wrong", [jnp.zeros((3, 3), jnp.int32), jnp.zeros(3, bool), jnp.zeros((1, 2, 3), bool)])
def test_what_is_no_mask_is_refused(wrong):
    with pytest.raises(AssertionError, match="expected"):
        nearest_site(wrong)
