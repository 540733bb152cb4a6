"""The Voronoi graph of free space: pencil cases, brute force, scikit-image and networkx, laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import maps, plans, rooms
from skimage import morphology

from jexplore.arrays import bits
from jexplore.arrays.groups import EIGHT_NEIGHBOURS
from jexplore.distance import nearest_offset
from jexplore.skeleton import graph, medial_axis, thin, voronoi_graph

pytestmark = pytest.mark.jit

SHAPES = ((12, 12), (40, 7))  # one of them taller than a machine word


def masks(shapes=SHAPES):
    share = st.sampled_from((0.1, 0.5, 0.8))
    return st.tuples(st.sampled_from(shapes), share, st.integers(0, 2**30)).map(
        lambda case: np.random.default_rng(case[2]).random(case[0]) < case[1]
    )


@jax.jit
def axis(obstacle, gamma):
    return medial_axis(*nearest_offset(obstacle), gamma**2)


@jax.jit
def thinned(mask):
    return bits.unpack(thin(bits.pack(mask)), mask.shape[0])


GRAPH = jax.jit(graph, static_argnames="size")


def graph_of(obstacle, gamma2, *, size):
    return voronoi_graph(obstacle, gamma2, size=size)[0]


VORONOI = jax.jit(graph_of, static_argnames="size")


# ---------------------------------------------------------------- medial axis


@given(masks().map(lambda m: m & np.roll(m, 1)) | masks(), st.sampled_from((1.0, 1.5, 2.0, 3.0)))
@settings(max_examples=25, deadline=None)
def test_an_axis_lies_between_obstacles_that_are_apart(obstacle, gamma):
    marked = np.asarray(axis(jnp.asarray(obstacle), jnp.float32(gamma)))
    assert not marked[obstacle].any()
    site = plans.nearest_site(obstacle)[1]
    places = np.stack(np.divmod(site, obstacle.shape[1]), axis=-1)
    for row, col in np.argwhere(marked):
        around = [(row + drow, col + dcol) for drow, dcol in EIGHT_NEIGHBOURS[:4]]
        around = [cell for cell in around if all(0 <= i < n for i, n in zip(cell, marked.shape)) and not obstacle[cell]]
        assert any(np.hypot(*(places[cell] - places[row, col])) > gamma for cell in around)
    np.testing.assert_array_equal(marked, rooms.medial_axis(obstacle, gamma))


# ---------------------------------------------------------------- thinning


@given(masks())
@settings(max_examples=40, deadline=None)
def test_thinning_is_scikit_images(mask):
    lines = np.asarray(thinned(jnp.asarray(mask)))
    np.testing.assert_array_equal(lines[::-1], morphology.thin(mask[::-1]))
    np.testing.assert_array_equal(thinned(jnp.asarray(lines)), lines)


# ---------------------------------------------------------------- graph


@given(masks(), st.booleans())
@settings(max_examples=20, deadline=None)
def test_degrees_and_links_are_networkxs(mask, lines):
    skeleton = morphology.thin(mask) if lines else mask
    d2 = np.arange(mask.size, dtype=np.int32).reshape(mask.shape) ** 2 % 101
    found = GRAPH(jnp.asarray(skeleton), jnp.asarray(d2), size=300)
    cells = [tuple(cell) for cell in np.argwhere(skeleton).tolist()]
    expected = rooms.linked(set(cells))
    n = len(cells)
    assert found.cell.tolist() == [row * mask.shape[1] + col for row, col in cells] + [mask.size] * (300 - n)
    assert found.d2.tolist() == [d2[cell] for cell in cells] + [0] * (300 - n)
    assert found.degree.tolist() == [expected.degree(cell) for cell in cells] + [0] * (300 - n)
    assert int(found.overflow) == 0
    link = np.asarray(found.link)
    assert (link[n:] == 300).all()
    for slot, (row, col) in enumerate(cells):
        for i, (drow, dcol) in enumerate(EIGHT_NEIGHBOURS):
            there = row + drow, col + dcol
            assert link[slot, i] == (cells.index(there) if expected.has_edge((row, col), there) else 300)


def test_cells_that_do_not_fit_are_counted_and_not_linked():
    skeleton = jnp.asarray(maps.walls("####### ....... #......"))
    found = GRAPH(skeleton, jnp.ones((3, 7), jnp.int32), size=5)
    assert found.cell.tolist() == [0, 14, 15, 16, 17]
    assert found.degree.tolist() == [0, 1, 2, 2, 1]
    assert int(found.overflow) == 3


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (40, 7)])
def test_maps_without_an_axis(shape):
    """All free: no obstacle to be far from. All wall. One row of free cells between two walls."""
    ends = np.zeros(shape, bool)
    ends[0, [0, -1]] = True
    for obstacle in (np.zeros(shape, bool), np.ones(shape, bool), ends & (shape[0] == 1) & (shape[1] < 3)):
        found = VORONOI(jnp.asarray(obstacle), jnp.float32(4), size=16)
        assert (np.asarray(found.cell) == obstacle.size).all()
        assert (np.asarray(found.link) == 16).all()
        assert not found.degree.any()
        assert not found.d2.any()
        assert int(found.overflow) == 0
