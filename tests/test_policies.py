"""Strategies: their names, and what each of them chooses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref import maps
from scipy import stats

from jexplore.config import InputError
from jexplore.grid import Grid
from jexplore.navigate import Belief, field, nearest_frontier
from jexplore.policies import MODIFIERS, STRATEGIES, parameters_of, parse_strategy
from jexplore.policies.uniform import kth_true
from jexplore.reach import FAR

TEXT = """
    ?....?
    ..##..
    .R#?..
    ..#...
    ?....?
"""


def belief_of(text, grow=(0, 0)):
    cells = np.pad(maps.drawn(text), [(0, n) for n in grow], constant_values=" ")
    (row, col), *_ = np.argwhere(cells == "R")
    return Belief(
        grid=Grid(jnp.asarray(cells == "#", jnp.int32), jnp.asarray((cells == ".") | (cells == "R"), jnp.int32)),
        driven=jnp.asarray(cells == "R"),
        exhausted=jnp.zeros(cells.shape, bool),
        row=jnp.int32(row),
        col=jnp.int32(col),
        heading=jnp.int32(0),
        extent=jnp.asarray(maps.drawn(text).shape, jnp.int32),
        p_free=jnp.float32(0.25),
        near_d2=jnp.int32(0),
        clearance_d2=0,
    )


def choice_of(name, key, belief):
    policy = parse_strategy(name).policy
    carry = policy.init(policy.params, belief)
    route = jnp.full(belief.driven.shape, -1, jnp.int8)
    return policy.select(key, policy.params, carry, belief, route)


# ---------------------------------------------------------------- names


def test_names_are_kept_verbatim():
    plain, rechecked = parse_strategy("closest"), parse_strategy("random+recheck")
    assert (plain.name, plain.recheck) == ("closest", False)
    assert (rechecked.name, rechecked.recheck) == ("random+recheck", True)
    assert plain.policy == STRATEGIES["closest"].make()
    assert rechecked.policy == STRATEGIES["random"].make()
    assert set(MODIFIERS) >= {"recheck"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("closet", "unknown strategy 'closet'; did you mean 'closest'"),
        ("", "unknown strategy ''"),
        ("closest+rechek", "did you mean 'recheck'"),
        ("closest+", "unknown modifier"),
        ("closest+recheck+recheck", "'recheck' is given twice"),
        ("closest:", "expected key=value after the colon"),
        ("closest:samples=5", "unknown parameter of 'closest'"),
        ("+recheck", "unknown strategy ''"),
    ],
)
def test_wrong_names_are_refused_in_one_line(text, message):
    with pytest.raises(InputError) as error:
        parse_strategy(text)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


# ---------------------------------------------------------------- every strategy


@pytest.mark.jit
@pytest.mark.parametrize("name", STRATEGIES)
def test_every_strategy_keeps_the_contract(name):
    """A candidate with its cost and a route; -1 and FAR where there is none; the same for the same key."""
    assert all(isinstance(v, int | float) for v in parameters_of(name).values())
    assert STRATEGIES[name].summary
    assert STRATEGIES[name].source
    select = jax.jit(lambda key, belief: choice_of(name, key, belief))
    belief = belief_of(TEXT)
    known = field(belief)
    for seed in range(5):
        _, choice, route = select(jax.random.key(seed), belief)
        assert known.candidates[choice.row, choice.col]
        assert choice.cost == known.cost[choice.row, choice.col]
        again = select(jax.random.key(seed), belief)
        jax.tree.map(np.testing.assert_array_equal, again[1:], (choice, route))
        if choice.cost > 0:
            assert route[belief.row, belief.col] >= 0
    _, choice, route = select(jax.random.key(0), belief.replace(exhausted=jnp.ones(belief.driven.shape, bool)))
    assert (int(choice.row), int(choice.col), int(choice.cost)) == (-1, -1, FAR)
    assert (np.asarray(route) == -1).all()


@pytest.mark.jit
def test_closest_is_the_nearest_frontier():
    belief = belief_of(TEXT)
    _, choice, route = choice_of("closest", jax.random.key(0), belief)
    want = nearest_frontier(belief, jnp.full(belief.driven.shape, -1, jnp.int8))
    jax.tree.map(np.testing.assert_array_equal, (choice, route), want)


# ---------------------------------------------------------------- random


def test_the_kth_true_cell_by_hand():
    mask = jnp.asarray([[False, True, False], [False, False, False], [True, False, True]])
    assert [[int(v) for v in kth_true(mask, k)] for k in range(3)] == [[0, 1], [2, 0], [2, 2]]


@pytest.mark.jit
@given(st.sampled_from(((1, 1), (1, 6), (5, 4))).flatmap(lambda s: hnp.arrays(bool, s, fill=st.nothing())))
@settings(max_examples=40, deadline=None)
def test_the_kth_true_cell_is_the_kth_of_all(mask):
    for k, cell in enumerate(np.argwhere(mask)):
        np.testing.assert_array_equal(jax.jit(kth_true)(jnp.asarray(mask), k), cell)


@pytest.mark.jit
def test_random_draws_are_uniform_and_do_not_depend_on_padding():
    belief, wide = belief_of(TEXT), belief_of(TEXT, grow=(3, 7))
    keys = jax.random.split(jax.random.key(11), 4000)
    draw = jax.jit(jax.vmap(lambda key, belief: choice_of("random", key, belief)[1], in_axes=(0, None)))
    choice, choice_wide = draw(keys, belief), draw(keys, wide)
    jax.tree.map(np.testing.assert_array_equal, choice, choice_wide)
    candidates = np.asarray(field(belief).candidates)
    counts = np.zeros(candidates.shape, int)
    np.add.at(counts, (np.asarray(choice.row), np.asarray(choice.col)), 1)
    assert not counts[~candidates].any()
    assert candidates.sum() > 8
    assert stats.chisquare(counts[candidates]).pvalue > 1e-3
