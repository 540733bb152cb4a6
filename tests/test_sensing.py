"""Known cells, counted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jexplore.exploration import sensing
from jexplore.grid import Grid


def test_known_cells_by_hand():
    hits, misses = np.zeros((2, 5, 6), np.int32)
    hits[1, 1] = misses[1, 1] = misses[2, 3] = hits[4, 5] = 1  # one twice
    grid, row = Grid(jnp.asarray(hits), jnp.asarray(misses)), jnp.arange(5)[:, None] + jnp.zeros(6, int)
    for within, n in ((None, 3), (row < 9, 3), (row > 1, 2), (row > 9, 0)):
        assert int(sensing.known_cells(grid, within)) == n


@pytest.mark.jit
@given(seed=st.integers(0, 2**30), shape=st.sampled_from(((1, 1), (5, 9), (40, 70))))
@settings(max_examples=20, deadline=None)
def test_known_cells_are_numpys(seed, shape):
    rng = np.random.default_rng(seed)
    hits, misses = rng.integers(0, 3, (2, *shape)) * (rng.random((2, *shape)) < 0.3)
    within = rng.random(shape) < 0.7
    grid = Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))
    assert int(jax.jit(sensing.known_cells)(grid)) == np.count_nonzero(hits + misses)
    assert int(jax.jit(sensing.known_cells)(grid, within)) == np.count_nonzero((hits + misses) * within)
