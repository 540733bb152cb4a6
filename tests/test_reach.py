"""The reachability map: pencil cases, Dijkstra, laws, saturation, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref import maps, plans, rooms
from ref.definitions import predecessors
from scipy import ndimage

from jexplore.arrays import bits
from jexplore.planning.readout import lay_route
from jexplore.reach import (
    DIAGONAL,
    FAR,
    HEADING,
    MOTIONS,
    STRAIGHT,
    flood,
    nearest_source,
    reach,
    saturated,
    spread,
)

pytestmark = pytest.mark.jit

S, D = STRAIGHT, DIAGONAL
SHAPES = ((1, 1), (1, 8), (7, 1), (7, 9))
nearest = jax.jit(nearest_source, static_argnames="n")
LAY, SATURATED = jax.jit(lay_route), jax.jit(saturated)


@st.composite
def places(draw, shapes=SHAPES):
    """Traversable cells, mostly, and a start among them."""
    height, width = draw(st.sampled_from(shapes))
    passable = draw(hnp.arrays(bool, (height, width), elements=st.integers(0, 3).map(bool), fill=st.nothing()))
    row, col = draw(st.integers(0, height - 1)), draw(st.integers(0, width - 1))
    passable[row, col] = True
    return passable, row, col


def flat_predecessors(came):
    """Index of the cell before each cell, as the oracle has it; -1 for none."""
    came = np.asarray(came)
    rows, cols = np.indices(came.shape)
    step = np.array(MOTIONS)[came]
    return np.where(came < 0, -1, (rows - step[..., 0]) * came.shape[1] + cols - step[..., 1])


def test_constants_are_the_oracles():
    assert (STRAIGHT, DIAGONAL, FAR, MOTIONS) == (plans.STRAIGHT, plans.DIAGONAL, plans.FAR, plans.MOTIONS)
    for (drow, dcol), heading in zip(MOTIONS, HEADING):
        assert np.degrees(np.arctan2(drow, dcol)) % 360 == 45 * heading


def test_the_nearest_source_of_a_long_map():
    """Rows that lie further from the first one than any path may be long."""
    free = np.zeros((3968, 32), bool)
    free[3900:, 1:31] = True
    free[3904::4, 1:30] = free[3906::4, 2:31] = False
    sources = np.full(free.shape, -1, np.int32)
    sources[3901, 1], sources[3967, 1] = 7, 9
    found = np.asarray(nearest(jnp.asarray(free), jnp.asarray(sources), 4096))
    assert set(np.unique(found)) == {-1, 7, 9}
    assert (found[3901, 1], found[3967, 1]) == (7, 9)
    np.testing.assert_array_equal(found >= 0, free)


def test_a_start_in_a_wall_can_be_left():
    passable = ~maps.walls("... .#. ...")
    cost = reach(jnp.asarray(passable), 1, 1)
    assert cost.tolist() == [[D, S, D], [S, 0, S], [D, S, D]]


@given(places())
@settings(max_examples=200, deadline=None)
def test_costs_and_predecessors_are_dijkstras(place):
    passable, row, col = place
    cost = reach(jnp.asarray(passable), row, col)
    want_cost, want_pred = plans.dijkstra(passable, (row, col))
    np.testing.assert_array_equal(cost, want_cost)
    np.testing.assert_array_equal(flat_predecessors(predecessors(cost, jnp.asarray(passable))), want_pred)
    assert SATURATED(cost, jnp.asarray(passable)) == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_labyrinth_of_one_long_way_is_dijkstras(seed):
    """Many turns: the sweeps must run until nothing changes, and no further."""
    passable = np.ones((41, 40), bool)
    passable[1::2] = False
    ends = np.random.default_rng(seed).integers(0, 40, 20)
    passable[np.arange(1, 41, 2), ends] = True
    for row, col in ((0, 0), (40, 39), (20, 5)):
        cost = reach(jnp.asarray(passable), row, col)
        np.testing.assert_array_equal(cost, plans.dijkstra(passable, (row, col))[0])


@given(places())
@settings(max_examples=60, deadline=None)
def test_every_route_leads_from_the_start_to_its_target_at_the_exact_cost(place):
    passable, row, col = place
    cost = reach(jnp.asarray(passable), row, col)
    pred = plans.dijkstra(passable, (row, col))[1]
    blank = jnp.full(passable.shape, -1, jnp.int8)
    for target in np.argwhere(np.asarray(cost) < FAR)[::5]:
        args = blank, cost, jnp.asarray(passable), (row, col), tuple(target), (0, 0)
        route = np.asarray(LAY(*args))
        cells, total = plans.follow(route, (row, col), tuple(target))
        assert total == cost[tuple(target)]
        assert cells == plans.path(pred, (row, col), target)
        assert (route >= 0).sum() == len(cells)  # nothing else was written


def test_costs_saturate_below_far_and_are_counted():
    """A row of 16,390 cells: 16,383 steps fit, the next would cost FAR."""
    row = jnp.ones((1, 16390), bool)
    cost = reach(row, 0, 0)
    np.testing.assert_array_equal(cost[0, :16384], S * np.arange(16384))
    assert (np.asarray(cost[0, 16384:]) == FAR).all()
    assert SATURATED(cost, row) == 1
    cost = reach(row.at[0, 16384].set(False), 0, 0)  # a wall would not have been reached anyway
    assert (int(cost[0, 16383]), int(SATURATED(cost, row.at[0, 16384].set(False)))) == (FAR - S, 0)
    row = jnp.ones((1, 40000), bool)
    assert SATURATED(reach(row, 0, 20000), row) == 2


# ---------------------------------------------------------------- limits, goals, floods


@jax.jit
def _limited(passable, goals, row, col, limit):
    words = bits.pack(passable)
    goals = jnp.pad(goals, ((0, 32 * words.shape[0] - passable.shape[0]), (0, 0)))
    return spread(words, at=(row, col), goals=goals, limit=limit)[: passable.shape[0]]


def limited(passable, goals, row, col, limit):
    """Costs that need only be final up to a limit, and up to the cheapest goals."""
    return np.asarray(_limited(jnp.asarray(passable), jnp.asarray(goals), row, col, limit))


@jax.jit
def flooded(passable, row, col):
    return bits.unpack(flood(bits.pack(passable), row, col), passable.shape[0])


@given(place=places(), seed=st.integers(0, 2**30), steps=st.integers(-1, 12))
@settings(max_examples=100, deadline=None)
def test_costs_are_final_up_to_the_limit_and_the_cheapest_goals(place, seed, steps):
    passable, row, col = place
    goals = np.random.default_rng(seed).random(passable.shape) < 0.05
    cost = limited(passable, goals, row, col, steps * S)
    exact = np.asarray(reach(jnp.asarray(passable), row, col))
    final = exact <= min(steps * S, exact[goals].min(initial=FAR))
    assert (cost >= exact).all()
    np.testing.assert_array_equal(cost[final], exact[final])
    if steps >= 0:
        came = predecessors(jnp.asarray(cost), jnp.asarray(passable))
        pred = plans.dijkstra(passable, (row, col))[1]
        np.testing.assert_array_equal(flat_predecessors(came)[final], pred[final])


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("wide", [1, 3])
def test_a_goal_behind_a_wall_is_found_however_far_the_way_round_is(turns, wide):
    """A long U: the goal is near in a straight line, and the way there leads far to one side and back."""
    passable, goals, start = (np.zeros((96, 96), bool) for _ in range(3))
    passable[15:86, 10 : 10 + wide] = passable[15:86, 22 : 22 + wide] = True
    passable[15 : 15 + wide, 10 : 22 + wide] = True
    start[85, 10] = goals[85, 22] = True
    passable, goals, start = (np.rot90(a, turns) for a in (passable, goals, start))
    row, col = np.argwhere(start)[0]
    cost = limited(passable, goals, row, col, FAR)
    exact = plans.dijkstra(passable, (row, col))[0]
    assert cost[goals] == exact[goals] > 80 * S


@given(place=places(), stands=st.booleans())
@settings(max_examples=100, deadline=None)
def test_a_flood_reaches_what_has_a_cost(place, stands):
    passable, row, col = place
    passable[row, col] = stands  # a start outside the cells
    want = np.asarray(reach(jnp.asarray(passable), row, col)) < FAR
    np.testing.assert_array_equal(flooded(jnp.asarray(passable), row, col), want)


@given(
    seed=st.integers(0, 2**30),
    share=st.sampled_from((0.55, 0.6, 0.65, 0.8)),
    shape=st.sampled_from(((40, 70), (70, 33))),
)
@settings(max_examples=100, deadline=None)
def test_a_flood_over_several_words_is_scipys_group(seed, share, shape):
    rng = np.random.default_rng(seed)
    passable, (row, col) = rng.random(shape) < share, rng.integers(0, shape)
    passable[row, col] = True
    groups, _ = ndimage.label(passable)
    np.testing.assert_array_equal(flooded(jnp.asarray(passable), row, col), groups == groups[row, col])


# ---------------------------------------------------------------- nearest source


@given(place=places(((1, 8), (7, 9))), seed=st.integers(0, 2**30))
@settings(max_examples=80, deadline=None)
def test_the_nearest_source_is_dijkstras_from_every_source(place, seed):
    passable, _, _ = place
    draw = np.random.default_rng(seed)
    cells = np.argwhere(passable)
    cells = cells[draw.permutation(len(cells))[: draw.integers(0, 7)]]
    sources = np.full(passable.shape, -1, np.int32)
    numbers = draw.integers(0, 3, len(cells))  # the same number in several cells
    sources[tuple(cells.T)] = numbers
    expected = np.full(passable.shape, -1)
    if len(cells):
        length = rooms.distances(passable, cells)
        least = np.array([length[numbers == i].min(0, initial=np.inf) for i in range(3)])
        expected = np.where(least.min(0) < np.inf, least.argmin(0), -1)
    np.testing.assert_array_equal(nearest(passable, sources, 3), expected)


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize("wrong", [jnp.zeros((3, 3), jnp.int32), jnp.zeros(3, bool)])
def test_what_is_no_mask_is_refused(wrong):
    with pytest.raises(AssertionError, match="expected"):
        reach(wrong, 0, 0)


def test_cells_that_cost_too_much_by_hand():
    """Cells one motion beyond those with a cost: straight ones, diagonal ones only past two that are traversable."""
    f, far = FAR - 1, FAR
    alone = jnp.asarray([[far, far, far], [far, f, far], [far, far, far]], jnp.int32)
    everywhere = jnp.ones((3, 3), bool)
    assert saturated(alone, everywhere) == 8
    assert saturated(alone, everywhere.at[0, 1].set(False)) == 5  # nor the two adjacent corners
    assert saturated(alone, ~everywhere) == 0
    assert saturated(jnp.full((3, 3), far), everywhere) == 0
    assert saturated(jnp.asarray([[f, far, far]], jnp.int32), jnp.ones((1, 3), bool)) == 1
    assert saturated(jnp.zeros((3, 3), jnp.int32), everywhere) == 0
