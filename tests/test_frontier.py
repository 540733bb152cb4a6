"""Clear and frontier cells, and their clusters: the oracle, scipy, pencil cases, laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref import maps, plans
from scipy import ndimage

from jexplore.arrays import bits
from jexplore.frontier import clear_cells, frontier_clusters, plan_masks
from jexplore.grid import Grid

SHAPES = ((1, 1), (1, 7), (7, 8))
EIGHT = np.ones((3, 3), int)
counts = st.sampled_from(SHAPES).flatmap(
    lambda shape: st.tuples(*[hnp.arrays(np.int32, shape, elements=st.integers(0, 3), fill=st.just(0))] * 2)
)
masks = st.sampled_from(SHAPES).flatmap(lambda shape: hnp.arrays(bool, shape, fill=st.nothing()))


CLEAR = jax.jit(clear_cells, static_argnames="clearance_d2")


@pytest.mark.jit
@given(counts, st.sampled_from((0, 1, 4)))
@settings(max_examples=60, deadline=None)
def test_clear_cells_are_the_oracles(case, clearance_d2):
    hits, misses = case
    _, free, occupied = plans.classify(hits, misses)
    clear = CLEAR(Grid(jnp.asarray(hits), jnp.asarray(misses)), p_free=0.25, clearance_d2=clearance_d2)
    np.testing.assert_array_equal(clear, plans.clear(free, occupied, clearance_d2))


# ---------------------------------------------------------------- clusters


def framed(text):
    """Cells drawn, in the corner of a map of one shape: each shape compiles a hundred operations."""
    cells = maps.walls(text)
    return jnp.asarray(np.pad(cells, [(0, full - n) for full, n in zip((4, 7), cells.shape)]))


def test_frontier_cells_that_are_not_looked_at_are_counted():
    clusters = frontier_clusters(framed("#.#.###"), max_clusters=4, max_cells=3)
    assert clusters.label[0].tolist() == [0, -1, 1, -1, 2, -1, -1]
    assert (int(clusters.count), int(clusters.left_out)) == (3, 2)


CLUSTERS = jax.jit(frontier_clusters, static_argnames="max_clusters")


@pytest.mark.jit
@given(masks)
@settings(max_examples=100, deadline=None)
def test_clusters_are_scipys_and_the_oracles(mask):
    n = ndimage.label(mask, EIGHT)[1]
    for slots in (3, 40):
        clusters = CLUSTERS(jnp.asarray(mask), max_clusters=slots)
        want = plans.clusters(mask)
        np.testing.assert_array_equal(clusters.label, np.where(want < slots, want, -1))
        assert int(clusters.count) == n
        assert int(clusters.overflow) == max(n - slots, 0)
        for i in range(slots):
            cells = np.argwhere(want == i)
            assert int(clusters.size[i]) == len(cells)
            at = int(clusters.row[i]), int(clusters.col[i])
            if not len(cells):
                assert at == (-1, -1)
                continue
            off = ((cells * len(cells) - cells.sum(0)) ** 2).sum(1)  # exact, in units of 1 / size^2
            chosen = off[(cells == at).all(1)]
            assert len(chosen) == 1
            assert chosen[0] == off.min()


@pytest.mark.jit
@given(masks, st.integers(0, 2**30))
@settings(max_examples=60, deadline=None)
def test_the_cheapest_member_is_the_oracles(mask, seed):
    cost = np.random.default_rng(seed).integers(0, 6, mask.shape).astype(np.int32)
    clusters = CLUSTERS(jnp.asarray(mask), jnp.asarray(cost), max_clusters=3)
    want = plans.clusters(mask)
    for i in range(3):
        expected = plans.closest(want == i, cost)
        at = int(clusters.row[i]), int(clusters.col[i])
        assert at == (divmod(expected, mask.shape[1]) if expected >= 0 else (-1, -1))


@pytest.mark.parametrize("clearance_d2", [0, 1, 9])
def test_masks_of_a_plan_are_the_oracles(clearance_d2):
    """Packed, with exhausted targets left out, on maps of mixed cells, some rows and columns of them padding."""
    for seed, shape in ((0, (9, 40)), (1, (33, 7))):
        draw = np.random.default_rng(seed)
        hits, misses = draw.integers(0, 3, shape), draw.integers(0, 6, shape) * (draw.random(shape) < 0.8)
        driven, exhausted = (draw.random(shape) < share for share in (0.05, 0.2))
        inside = np.indices(shape)[0] < shape[0] - 2
        row, col = shape[0] // 2, shape[1] // 2
        numbers = {"p_free": 0.25, "near_d2": 5, "clearance_d2": clearance_d2}
        grid = Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))
        found = plan_masks(grid, *map(jnp.asarray, (driven, exhausted, inside)), row, col, **numbers)
        known, free, occupied = plans.classify(hits, misses)
        clear = plans.clear(free, occupied, clearance_d2)
        passable = plans.traversable(free, occupied, driven, row, col, clearance_d2, 5)
        unknown = np.pad(~known & inside, 1)
        beside = np.any([unknown[r : r + shape[0], c : c + shape[1]] for r in range(3) for c in range(3)], axis=0)
        np.testing.assert_array_equal(bits.unpack(found.traversable, shape[0]), passable)
        np.testing.assert_array_equal(bits.unpack(found.frontier, shape[0]), clear & beside & ~exhausted)
