"""Strategies: their names, and what each of them chooses."""

import math
from pathlib import Path

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref.beliefs import belief_of, choice_of
from ref.refusals import refused
from scipy import stats

from jexplore.planning import field
from jexplore.policies import MODIFIERS, STRATEGIES, parse_strategy
from jexplore.policies.catalogue.entries import parameters
from jexplore.policies.uniform import kth_true
from jexplore.reach import FAR

TEXT = """
    ?....?
    ..##..
    .R#?..
    ..#...
    ?....?
"""


# ---------------------------------------------------------------- names


def test_names_are_kept_verbatim():
    plain, rechecked = parse_strategy("closest"), parse_strategy("random+recheck")
    assert (plain.name, plain.recheck) == ("closest", False)
    assert (rechecked.name, rechecked.recheck) == ("random+recheck", True)
    assert plain.policy == STRATEGIES["closest"].make()
    assert rechecked.policy == STRATEGIES["random"].make()
    assert set(MODIFIERS) >= {"recheck"}


def test_modifiers_take_a_kind_and_numbers():
    holz, wurm, auto = (parse_strategy(f"closest+segment{kind}").policy for kind in ("", "=wurm", "=auto"))
    assert [one.params.cut.max_hops for one in (holz, wurm, auto)] == [2, 1, 2]
    assert holz == parse_strategy("closest+segment=holz").policy
    assert (holz.params.door_m, auto.params.door_m) == (math.inf, 1.6)
    both = parse_strategy("decision-theoretic+segment=wurm+recheck:samples=100,prominence_m=1,lam=2")
    assert both.recheck
    assert both.policy.params.cut.prominence_m == 1
    basins, rooms = (parse_strategy(f"closest+segment={kind}:ratio=0.5").policy.params for kind in ("voronoi", "rooms"))
    assert basins.cut == rooms.cut == (0.5, 2.0, 1.0)
    assert (basins.door_m, rooms.door_m) == (math.inf, 1.6)
    assert both.policy.params.inner == parse_strategy("decision-theoretic:lam=2,samples=100").policy.params
    assert both.policy.params.inner.samples == 100
    assert parse_strategy("decision-theoretic").policy.params.samples == 500


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("closet", "unknown strategy 'closet'; did you mean 'closest'"),
        ("", "unknown strategy ''"),
        ("closest+rechek", "did you mean 'recheck'"),
        ("closest+recheck+recheck", "'recheck' is given twice"),
        ("closest:", "expected key=value after the colon"),
        ("closest:samples=5", "unknown parameter of 'closest'"),
        ("closest+recheck=1", "modifier 'recheck' takes no value, got 'recheck=1'"),
        (
            "closest+segment=foo",
            "unknown kind of 'segment': 'foo'; did you mean 'rooms'? "
            "(there are: thrun, wurm, holz, auto, voronoi, rooms)",
        ),
        ("decision-theoretic:samples=0", "samples must be an integer from 1 to 1024, got 0"),
        ("decision-theoretic:samples=1.5", "samples must be an integer from 1 to 1024, got 1.5"),
        ("decision-theoretic:lam=-1", "lam must be a number at least 0"),
        ("decision-theoretic:lam=much", "expected a number for lam"),
        ("decision-theoretic:lam=1,lam=2", "expected lam=NUMBER once"),
        ("decision-theoretic:min_gain=0", "min_gain must be an integer from 1"),
        ("gain-rate:plus_m=-1", "plus_m must be a number at least 0"),
        ("utility:beta=-0.1", "beta must be a number at least 0"),
        ("distance-advantage:weight=1000", "weight must be a number at least 0 and at most 100"),
        ("mutual-information:delta=1", "delta must be greater than 1, got 1"),
        ("tour:min_gain=0.5", "min_gain must be an integer from 0"),
        ("mcdm:a=1.5", "a must be a number at least 0 and at most 1"),
        ("mcdm:ad=0.1", "ad must be at least a, got 0.1 and 0.5"),
        ("closest:prominence_m=1", "unknown parameter of 'closest': 'prominence_m'"),
        ("closest+segment:prominence_m=-1", "prominence_m must be a number at least 0"),
        ("closest+segment:room_m2=3", "unknown parameter"),
        ("closest+segment=voronoi:gamma=3", "unknown parameter"),
    ],
)
def test_wrong_names_are_refused_in_one_line(text, message):
    assert message in refused(None, parse_strategy, text)


# ---------------------------------------------------------------- every strategy


QUICK = "closest", "random", "decision-theoretic", "learned", "closest+segment"
OTHERS = [name for name in STRATEGIES if name not in QUICK]  # chosen by hand in test_clusters and test_views as well
OTHERS += ["random+segment=auto", "decision-theoretic+segment", "closest+segment=rooms"]


@pytest.mark.jit
@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)])
def test_every_strategy_keeps_the_contract(name):
    """A candidate or a view point with its cost and a route; -1 and FAR without one; traced once."""
    entry = name.partition("+")[0]
    assert all(isinstance(v, int | float | Path) for v in parameters(STRATEGIES[entry].make).values())
    assert STRATEGIES[entry].summary
    assert STRATEGIES[entry].source
    chex.clear_trace_counter()
    select = jax.jit(chex.assert_max_traces(lambda key, belief: choice_of(name, key, belief), n=1))
    belief = belief_of(TEXT)
    reached = field(belief)
    for seed in range(5):
        _, choice, route = select(jax.random.key(seed), belief)
        assert reached.frontier[choice.row, choice.col] | choice.is_view
        assert reached.cost[choice.row, choice.col] < FAR
        assert choice.cost == reached.cost[choice.row, choice.col]
        again = select(jax.random.key(seed), belief)
        jax.tree.map(np.testing.assert_array_equal, again[1:], (choice, route))
        if choice.cost > 0:
            assert route[belief.row, belief.col] >= 0
    _, choice, route = select(jax.random.key(0), belief.replace(exhausted=jnp.ones(belief.driven.shape, bool)))
    assert (int(choice.row), int(choice.col), int(choice.cost)) == (-1, -1, FAR)
    assert (np.asarray(route) == -1).all()


# ---------------------------------------------------------------- random

KTH = jax.jit(kth_true)


@pytest.mark.jit
@given(st.sampled_from(((1, 1), (1, 6), (5, 4))).flatmap(lambda s: hnp.arrays(bool, s, fill=st.nothing())))
@settings(max_examples=20, deadline=None)
def test_the_kth_true_cell_is_the_kth_of_all(mask):
    for k, cell in enumerate(np.argwhere(mask)):
        np.testing.assert_array_equal(KTH(jnp.asarray(mask), k), cell)


@pytest.mark.jit
def test_random_draws_are_uniform_and_do_not_depend_on_padding():
    belief, wide = belief_of(TEXT), belief_of(TEXT, grow=(3, 7))
    keys = jax.random.split(jax.random.key(11), 4000)
    draw = jax.jit(jax.vmap(lambda key, belief: choice_of("random", key, belief)[1], in_axes=(0, None)))
    choice, choice_wide = draw(keys, belief), draw(keys, wide)
    jax.tree.map(np.testing.assert_array_equal, choice, choice_wide)
    candidates = np.asarray(field(belief).frontier)
    counts = np.zeros(candidates.shape, int)
    np.add.at(counts, (np.asarray(choice.row), np.asarray(choice.col)), 1)
    assert not counts[~candidates].any()
    assert candidates.sum() > 8
    assert stats.chisquare(counts[candidates]).pvalue > 1e-3
