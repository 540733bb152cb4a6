"""Lists of a mask's True cells and their 8-connected groups: pencil cases, numpy, scipy, laws."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from jexplore.arrays import bits, groups

pytestmark = pytest.mark.jit


SHAPES = ((1, 1), (3, 40), (70, 5))  # wider and taller than a machine word
masks = st.tuples(st.sampled_from(SHAPES), st.sampled_from((0.0, 0.1, 0.4, 1.0)), st.integers(0, 2**30)).map(
    lambda case: np.random.default_rng(case[2]).random(case[0]) < case[1]
)
GROUPED = jax.jit(groups.grouped, static_argnames=("size", "part"))
EIGHT = np.ones((3, 3))


@given(masks, st.sampled_from((7, 64, 80)))
@settings(max_examples=25, deadline=None)
def test_groups_are_scipys(mask, part):
    found = GROUPED(jnp.asarray(mask), size=80, part=part)
    flat = np.flatnonzero(mask)[:80]
    n = len(flat)
    assert found.cell[:n].tolist() == flat.tolist()
    assert (np.asarray(found.cell[n:]) == mask.size).all()
    kept = np.zeros(mask.size, bool)
    kept[flat] = True
    label = ndimage.label(kept.reshape(mask.shape), EIGHT)[0].reshape(-1)[flat]
    first = [int(np.flatnonzero(label == own)[0]) for own in label]
    assert found.lowest.tolist() == first + list(range(n, len(found.cell)))
    assert (int(found.count), int(found.overflow)) == (n, mask.sum() - n)


def test_a_long_winding_group_is_one_and_rows_of_a_batch_are_independent():
    mask = np.ones((21, 20), bool)
    mask[1::2] = False
    mask[np.arange(1, 21, 2), np.where(np.arange(10) % 2, 0, 19)] = True
    some = jnp.asarray(np.stack([mask, mask & False, mask.copy()]))
    some = some.at[2, 11].set(False)
    grouped = functools.partial(groups.grouped, size=300, part=32)
    batch = jax.jit(jax.vmap(grouped))(some)
    for i, want in enumerate((1, 0, 2)):
        alone = grouped(some[i])
        jax.tree.map(lambda many, single, i=i: np.testing.assert_array_equal(many[i], single), batch, alone)
        used = np.arange(len(alone.cell)) < int(alone.count)
        assert len(set(np.asarray(alone.lowest)[used].tolist())) == want


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
