"""Rooms: pencil cases, the oracle of Figure 7, laws, bad input."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import maps, rooms
from skimage import morphology

from jexplore.segment import MAX_HOPS, Form, borders, criteria, critical_points, merged, segment
from jexplore.skeleton import graph

pytestmark = pytest.mark.jit

SHAPES = ((11, 23), (24, 24))  # of all maps that are compiled for
FORM = Form(nodes=256, splits=64)
BORDERS, MERGED = jax.jit(borders, static_argnums=1), jax.jit(merged)


def hops(variant):
    """`max_hops` of a variant as the oracle takes it."""
    return None if variant == "thrun" else MAX_HOPS[variant]


def parts(text):
    """The cells of each letter of a drawn map as a label map, rock around it: `[11, 23]`; -1 in walls."""
    cells = maps.drawn(text)
    label = np.where(cells == "#", -1, cells.astype("U1").view(np.int32).reshape(cells.shape))
    height, width = (n - m for n, m in zip(SHAPES[0], label.shape))
    return np.pad(label, ((0, height), (0, width)), constant_values=-1)


def cells_of(flat, width):
    return [divmod(int(i), width) for i in flat]


# ---------------------------------------------------------------- by hand


RING = """
    #######################
    #######ddddddddd#######
    ######ddddddddddd######
    #####aadddddddddcc#####
    ####aaaa#######cccc####
    ####aaaa#######cccc####
    ####aaaa#######cccc####
    #####aabbbbbbbbccc#####
    ######bbbbbbbbbbc######
    ######bbbbbbbbbbb######
    #######################
"""


# ---------------------------------------------------------------- critical points


@functools.partial(jax.jit, static_argnames="size")
def critical_cells(skeleton, d2, criteria, size=150):
    """Slots beyond the last are never critical: a mask of cells says it all."""
    found = graph(skeleton, d2, size=size)
    at = jnp.where(critical_points(found, criteria), found.cell, skeleton.size)
    return jnp.zeros(skeleton.size + 1, bool).at[at].set(True)[:-1].reshape(skeleton.shape)


chains = st.tuples(
    st.integers(0, 2**30), st.sampled_from((0.3, 0.6)), st.sampled_from((4, 10, 150)), st.sampled_from((0.0, 0.4, 1.0))
)


@given(chains, st.sampled_from((0, 1, 2, 3, 5, None)))
@settings(max_examples=30, deadline=None)
def test_critical_points_are_the_oracles(case, max_hops):
    """Lines from nowhere with clearances out of the blue: chains with many minima, rings among them."""
    seed, share, spread, prominence = case
    draw = np.random.default_rng(seed)
    skeleton = morphology.thin(draw.random((12, 12)) < share)
    d2 = draw.integers(1, spread, skeleton.shape)
    given = criteria(prominence=prominence).replace(max_hops=jnp.int32(2**30 if max_hops is None else max_hops))
    found = critical_cells(jnp.asarray(skeleton), jnp.asarray(d2, jnp.int32), given)
    lines = rooms.linked({tuple(c) for c in np.argwhere(skeleton).tolist()})
    expected = rooms.critical_points(lines, d2, max_hops=max_hops, prominence=prominence)
    assert cells_of(np.flatnonzero(found), 12) == expected


# ---------------------------------------------------------------- borders and merging


def test_segments_that_grew_from_one_cell_are_one_from_the_start():
    """0 and 2 share a cell: 1 and 3, the other sides, must meet neither."""
    shared = np.zeros((4, 4), np.int32)
    shared[0, 3] = shared[1, 3] = shared[0, 1] = 1
    assert MERGED(jnp.asarray(shared), jnp.asarray([0, 1, 0, 3])).tolist() == [0, 1, 0, 1]


@given(st.integers(0, 2**30), st.sampled_from((3, 6, 12)))
@settings(max_examples=20, deadline=None)
def test_borders_and_merging_are_the_oracles(seed, blocks):
    draw = np.random.default_rng(seed)
    label = np.kron(draw.integers(-1, 12, (blocks, blocks)), np.ones((12 // blocks, 12 // blocks), int))
    expected = rooms.borders(label)
    shared = np.asarray(BORDERS(jnp.asarray(label, jnp.int32), 12))
    assert {tuple(pair): shared[tuple(pair)] for pair in np.argwhere(shared).tolist()} == expected
    # labels that are strewn about touch more often than those of a plane can: only as many as fit
    kept = sorted(expected)[:48]
    shared = np.zeros((12, 12), np.int32)
    for pair in kept:
        shared[pair] = expected[pair]
    group = np.asarray(MERGED(jnp.asarray(shared), jnp.arange(12)))
    for members in rooms.merge({pair: expected[pair] for pair in kept}, range(12)):
        assert {group[i] for i in members} == {min(members)}
    assert (group[0::2] != group[1::2]).all()


# ---------------------------------------------------------------- the oracle

floors = st.tuples(st.sampled_from(("carved", "walled")), st.sampled_from(SHAPES), st.integers(0, 2**30)).map(
    lambda case: getattr(rooms, case[0])(np.random.default_rng(case[2]), *case[1])
)
choices = st.fixed_dictionaries(
    {
        "variant": st.sampled_from(tuple(MAX_HOPS)),
        "prominence": st.sampled_from((0.0, 0.0, 0.4, 1.0)),
        "gamma": st.sampled_from((1.0, 2.0, 3.0)),
    }
)


@given(free=floors, chosen=choices)
@settings(max_examples=25, deadline=None)
def test_segments_are_the_oracles(free, chosen):
    found = segment(jnp.asarray(free), criteria(**chosen), form=FORM)
    used = np.asarray(found.graph.cell) < free.size
    skeleton = cells_of(np.asarray(found.graph.cell)[used], free.shape[1])
    d2 = np.zeros(free.shape, int)
    d2[tuple(np.array(skeleton, int).reshape(-1, 2).T)] = np.asarray(found.graph.d2)[used]
    critical, seeds, label = rooms.segments(
        free, set(skeleton), d2, max_hops=hops(chosen["variant"]), prominence=chosen["prominence"]
    )
    n = len(critical)
    assert int(found.overflow) == 0
    assert int(found.count) == n
    assert cells_of(found.graph.cell[found.critical], free.shape[1]) == critical
    assert cells_of(found.seed[: 2 * n], free.shape[1]) == seeds
    assert (np.asarray(found.seed)[2 * n :] == free.size).all()
    assert found.split_d2.tolist() == [d2[c] for c in critical] + [0] * (64 - n)
    np.testing.assert_array_equal(found.label, label)


# ---------------------------------------------------------------- laws


TINY = Form(nodes=14, splits=2)


@pytest.mark.slow
def test_splits_that_do_not_fit_are_counted():
    free, thrun = jnp.asarray(parts(RING) >= 0), criteria("thrun", prominence=0.5)
    few, whole = segment(free, thrun, form=FORM._replace(splits=3)), segment(free, thrun, form=FORM)
    assert (int(few.count), int(few.overflow)) == (4, 1)
    np.testing.assert_array_equal(few.seed, whole.seed[:6])
    assert ((few.label >= 0) == free).all()


@pytest.mark.parametrize(
    ("shape", "free", "form"), [((1, 1), False, TINY), ((1, 1), True, TINY), (SHAPES[0], False, FORM)]
)
def test_a_single_cell_and_maps_without_free_space(shape, free, form):
    found = segment(jnp.full(shape, free), criteria("thrun", prominence=0.0), form=form)
    assert (np.asarray(found.label) == -1).all()
    assert (int(found.count), int(found.overflow)) == (0, 0)


# ---------------------------------------------------------------- bad input


def test_what_is_no_mask_or_not_known_is_refused():
    for wrong in (jnp.zeros((3, 3), jnp.int32), jnp.zeros(3, bool)):
        with pytest.raises(AssertionError):
            segment(wrong, criteria(), form=TINY)
    with pytest.raises(KeyError):
        criteria("nobody")
