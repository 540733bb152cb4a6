"""Known cells, counted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jexplore.exploration import sensing
from jexplore.grid import Grid


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
