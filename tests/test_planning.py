"""Queries of strategies to a belief: pencil cases, the oracle, and windows that never change the answer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import plans
from ref.beliefs import belief_from, belief_of

from jexplore import planning
from jexplore.planning import choose, field, nearest_frontier, windows
from jexplore.reach import DIAGONAL, FAR, STRAIGHT

S, D = STRAIGHT, DIAGONAL


def believe(hits, misses, row, col, *, driven=None, exhausted=None, near_d2=0, **how):
    """The shared belief, of a robot that may have driven and been at some targets."""
    belief = belief_from(np.asarray(hits), np.asarray(misses), (row, col), **how)
    driven = belief.driven if driven is None else belief.driven | driven
    exhausted = belief.exhausted if exhausted is None else jnp.asarray(exhausted)
    return belief.replace(driven=driven, exhausted=exhausted, model=belief.model.replace(near_d2=jnp.int32(near_d2)))


def no_route(belief):
    return jnp.full(belief.driven.shape, -1, jnp.int8)


def oracle(belief):
    """`(traversable, cost, predecessors, candidates)`."""
    hits, misses = np.asarray(belief.grid.hits), np.asarray(belief.grid.misses)
    known, free, occupied = plans.classify(hits, misses)
    at = int(belief.row), int(belief.col)
    d2 = belief.model.clearance_d2
    passable = plans.traversable(free, occupied, np.asarray(belief.driven), *at, d2, int(belief.model.near_d2))
    cost, pred = plans.dijkstra(passable, at)
    clear = plans.clear(free, occupied, d2)
    return passable, cost, pred, plans.frontier(clear, cost, known, np.asarray(belief.exhausted))


ROOM = """
    ######
    #...?#
    #.R..#
    #....#
    ####?#
"""


def test_exhausted_cells_and_unreachable_ones_are_no_candidates():
    belief = belief_of("?.R#.?")
    belief = belief.replace(exhausted=jnp.zeros((1, 6), bool).at[0, 1].set(True))
    assert not field(belief).frontier.any()
    old = jnp.full((1, 6), 3, jnp.int8)
    choice, route = nearest_frontier(belief, old)
    assert (int(choice.row), int(choice.col), int(choice.cost)) == (-1, -1, FAR)
    np.testing.assert_array_equal(route, old)


def test_choosing_nothing_leaves_the_route():
    belief = belief_of(ROOM)
    choice, route = choose(belief, no_route(belief), field(belief), jnp.int32(-1), jnp.int32(-1))
    assert (int(choice.row), int(choice.col), int(choice.cost), int(choice.saturated)) == (-1, -1, FAR, 0)
    assert (np.asarray(route) == -1).all()


SHAPES = ((1, 9), 0), ((8, 7), 1), ((8, 7), 2)  # and squared clearances, each a program
FIELD, NEAREST = jax.jit(field), jax.jit(nearest_frontier)
IN_MAP = jax.jit(planning._nearest_in_map)


def random_belief(seed, shape, unknown, occupied, clearance_d2=0):
    draw = np.random.default_rng(seed)
    u = draw.random(shape)
    hits = ((u < occupied) * draw.integers(1, 4, shape)).astype(np.int32)
    misses = np.where(u > occupied + unknown, 2, 0) + np.where(u < occupied / 4, 9, 0)
    row, col = (int(draw.integers(n)) for n in shape)
    return believe(
        hits, misses, row, col, clearance_d2=clearance_d2, near_d2=int(draw.integers(4)),
        driven=draw.random(shape) < 0.05, exhausted=draw.random(shape) < 0.1,
    )  # fmt: skip


@pytest.mark.jit
@given(st.sampled_from(SHAPES), st.integers(0, 2**20), st.floats(0, 0.4), st.floats(0, 0.4))
@settings(max_examples=25, deadline=None)
def test_fields_and_nearest_frontiers_are_the_oracles(shape, seed, unknown, occupied):
    shape, clearance_d2 = shape
    belief = random_belief(seed, shape, unknown, occupied, clearance_d2)
    passable, cost, pred, candidates = oracle(belief)
    reached = FIELD(belief)
    np.testing.assert_array_equal(reached.traversable, passable)
    np.testing.assert_array_equal(reached.cost, cost)
    np.testing.assert_array_equal(reached.frontier, candidates)
    choice, route = NEAREST(belief, no_route(belief))
    best, width = plans.closest(candidates, cost), shape[1]
    assert (int(choice.row), int(choice.col)) == (divmod(best, width) if best >= 0 else (-1, -1))
    if best >= 0:
        start, target = (int(belief.row), int(belief.col)), divmod(best, width)
        assert plans.follow(np.asarray(route), start, target) == (plans.path(pred, start, target), int(choice.cost))


# ---------------------------------------------------------------- windows


def large_belief(seed, shape, clearance_d2, distances):
    """Unknown cells near the robot or far away, with walls and exhausted cells on the way."""
    draw = np.random.default_rng(seed)
    row, col = (int(draw.choice([1, n // 2, n - 2, draw.integers(n)])) for n in shape)
    rows, cols = np.indices(shape)
    away = np.maximum(abs(rows - row), abs(cols - col))
    unknown = (away > draw.choice(distances)) & (draw.random(shape) < draw.choice([0.004, 0.05, 1.0]))
    wall = (draw.random(shape) < draw.choice([0.0, 0.02, 0.2])) & (away > 2)
    exhausted = draw.random(shape) < 0.2
    return believe(
        wall & ~unknown, ~wall & ~unknown, row, col, clearance_d2=clearance_d2, near_d2=4, exhausted=exhausted
    )


def both(belief):
    """The answer with windows, after a check that it is the whole map's: choice and route."""
    got, route = NEAREST(belief, no_route(belief))
    want, whole_route = IN_MAP(belief, no_route(belief))
    for name in ("row", "col", "cost"):
        assert int(getattr(got, name)) == int(getattr(want, name)), name
    np.testing.assert_array_equal(route, whole_route)
    return got


SIDE = 192  # larger than every window


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("clearance_d2", [0, pytest.param(9, marks=pytest.mark.slow)])
def test_windows_never_change_the_answer(clearance_d2):
    distances = [1, 3, 9, 20, 24, 26, 27, 28, 29, 30, 31, 32, 40, 50, 57, 58, 59, 60, 61, 62, 63, 64, 80, 120, 400]
    costs = [int(both(large_belief(seed, (SIDE, SIDE - 9), clearance_d2, distances)).cost) for seed in range(40)]
    for low, high in ((0, 20), (32, 56), (66, 10_000)):  # of every kind there were some
        assert any(low * S <= cost <= high * S for cost in costs)
    assert FAR in costs


def test_larger_maps_have_larger_windows():
    sides = {longest: windows((64, longest), 9) for longest in (100, 160, 512, 1000, 1024, 1536, 2048, 4096)}
    small, large = [64, 128], [64, 256, 512]
    assert sides == {
        100: [],
        160: [64],
        512: small,
        1000: small,
        1024: [64, 256],
        1536: [64, 256],
        2048: large,
        4096: large,
    }


@pytest.mark.jit
def test_a_frontier_just_inside_and_just_outside_a_window():
    """A corridor that ends in the unknown, in the four directions."""
    for turns in range(4):
        for away in (0, 1, 29, 30, 31, 32, 61, 62, 63, 64, 100):
            misses, hits, robot = np.zeros((3, SIDE, SIDE), int)
            misses[31:34, 30 : 31 + away] = 1
            hits[30, :] = hits[34, :] = hits[30:35, 29] = robot[32, 30] = 1
            hits, misses, robot = (np.rot90(a, turns) for a in (hits, misses, robot))
            assert int(both(believe(hits, misses, *np.argwhere(robot)[0])).cost) == away * S


@pytest.mark.jit
def test_equal_costs_inside_and_outside_a_window_go_to_the_lowest_index():
    """Two corridors of one length, one of them bent and so nearer as the crow flies: a window may see its end alone."""
    for turns in range(4):
        for length in (*range(27, 33), *range(59, 65)):
            misses = np.zeros((SIDE, SIDE), int)
            misses[96 - length : 97, 96] = 1  # straight down
            misses[96, 96 - length + 5 : 97] = misses[96:102, 96 - length + 5] = 1  # to the left, and five cells up
            hits = 1 - misses
            hits[96 - length - 1, 96] = hits[102, 96 - length + 5] = 0  # unknown
            hits, misses = np.rot90(hits, turns), np.rot90(misses, turns)
            row, col = (96, 96) if turns == 0 else ((95, 96), (95, 95), (96, 95))[turns - 1]
            assert misses[row, col] == 1
            assert int(both(believe(hits, misses, row, col)).cost) == length * S
