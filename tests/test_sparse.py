"""Lists of a mask's True cells: pencil cases and numpy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jexplore.arrays import bits, groups

pytestmark = pytest.mark.jit

SHAPES = ((1, 1), (3, 40), (70, 5))  # wider and taller than a machine word
masks = st.tuples(st.sampled_from(SHAPES), st.sampled_from((0.0, 0.02, 0.5, 1.0)), st.integers(0, 2**30)).map(
    lambda case: np.random.default_rng(case[2]).random(case[0]) < case[1]
)
LISTED = jax.jit(groups.list_cells, static_argnames="size")


def test_values_at_listed_places():
    array = jnp.asarray([[3, 1, 4], [1, 5, 9]])
    assert groups.at(array, jnp.asarray([5, 0, 6, 7]), -1).tolist() == [9, 3, -1, -1]
    np.testing.assert_array_equal(groups.at(array, jnp.asarray([[4], [6]]), 0), [[5], [0]])
    assert groups.at(jnp.asarray([8, 9]), jnp.asarray([1, 2]), 7).tolist() == [9, 7]


@given(masks)
@settings(max_examples=30, deadline=None)
def test_a_list_is_numpys(mask):
    size = 80
    cells = LISTED(jnp.asarray(mask), size=size)
    assert cells.cell.dtype == cells.near.dtype == jnp.int32
    flat = np.flatnonzero(mask)
    kept = flat[:size]
    assert cells.cell.tolist() == kept.tolist() + [mask.size] * (size - len(kept))
    assert int(cells.overflow) == len(flat) - len(kept)
    slot = np.full(np.add(mask.shape, 2), size)
    slot[1:-1, 1:-1].flat[kept] = np.arange(len(kept))
    near = np.full((size, 8), size)
    for i, (drow, dcol) in enumerate(groups.EIGHT_NEIGHBOURS):
        near[: len(kept), i] = slot[kept // mask.shape[1] + 1 + drow, kept % mask.shape[1] + 1 + dcol]
    np.testing.assert_array_equal(cells.near, near)


PACK, NTH = jax.jit(bits.pack), jax.jit(bits.nth_cells)
FIRST = jax.jit(bits.first_cells, static_argnames="size")


@given(masks, st.integers(0, 2**30))
@settings(max_examples=30, deadline=None)
def test_cells_by_their_number_are_numpys(mask, seed):
    words = PACK(jnp.asarray(mask))
    none = 32 * words.size
    flat = np.append(np.flatnonzero(mask), none)
    n = np.random.default_rng(seed).integers(0, max(1, mask.sum() + 3), 50, dtype=np.int32)
    np.testing.assert_array_equal(NTH(words, n), flat[np.minimum(n, len(flat) - 1)])
    np.testing.assert_array_equal(FIRST(words, size=30), np.append(flat, [none] * 30)[:30])


def test_rows_of_a_batch_are_independent():
    mask = jnp.asarray(np.random.default_rng(6).random((3, 3, 40)) < [[[0.0]], [[0.3]], [[0.05]]])
    batch = jax.jit(jax.vmap(functools.partial(groups.list_cells, size=12)))(mask)
    for i in range(3):
        alone = LISTED(mask[i], size=12)
        jax.tree.map(lambda many, one, i=i: np.testing.assert_array_equal(many[i], one), batch, alone)
