"""Known cells, counted square by square."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jexplore.exploration import sensing
from jexplore.grid import Grid


def test_known_cells_of_a_square_by_hand():
    hits, misses = np.zeros((2, 5, 6), np.int32)
    hits[1, 1] = misses[1, 1] = misses[2, 3] = hits[4, 5] = 1  # one twice, the last one outside
    grid, corner = Grid(jnp.asarray(hits), jnp.asarray(misses)), jnp.asarray([1, 1])
    for within in (None, jnp.ones((5, 6), bool)):
        assert int(sensing.known_in(grid, corner, (3, 4), within)) == 2
        assert int(sensing.known_in(grid, corner * 0, (5, 6), within)) == 3
    assert int(sensing.known_in(grid, corner, (3, 4), jnp.zeros((5, 6), bool))) == 0


@pytest.mark.jit
@given(seed=st.integers(0, 2**30), shape=st.sampled_from(((1, 1), (5, 9), (40, 70))))
@settings(max_examples=50, deadline=None)
def test_known_cells_are_numpys(seed, shape):
    rng = np.random.default_rng(seed)
    hits, misses = rng.integers(0, 3, (2, *shape)) * (rng.random((2, *shape)) < 0.3)
    size = tuple((n + 1) // 2 for n in shape)
    corner = [int(rng.integers(0, n - m + 1)) for n, m in zip(shape, size)]
    square = (hits + misses)[corner[0] : corner[0] + size[0], corner[1] : corner[1] + size[1]]
    grid = Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))
    known = jax.jit(sensing.known_in, static_argnames=("size",))(grid, jnp.asarray(corner), size)
    assert int(known) == np.count_nonzero(square)
