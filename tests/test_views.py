"""Strategies that go to view points: what they sample, and which of the samples they take."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs
from ref.beliefs import CORRIDOR, CROSS, FAR_OFF, NEAR, ONE_METRE

from jexplore.gain import look, prospect
from jexplore.planning import field, known_of
from jexplore.policies import parse_strategy, views
from jexplore.reach import FAR
from jexplore.rules import Lidar

pytestmark = pytest.mark.jit


# ---------------------------------------------------------------- by hand


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        # 1 exp(-lam) and 3 exp(-6 lam): the same at lam = ln 3 / 5 = 0.2197. A view that shows too little is not
        # considered; where nothing shows enough, the nearest frontier is.
        ("decision-theoretic", {"lam=0": FAR_OFF, "lam=0.21": FAR_OFF, "lam=0.23": NEAR, "lam=5": NEAR,
                                "lam=5,min_gain=2": FAR_OFF, "lam=0,min_gain=4": NEAR}),
        # 1 / (plus + 1) and 3 / (plus + 6): the same at plus = 1.5.
        ("gain-rate", {"plus_m=0": NEAR, "plus_m=1.4": NEAR, "plus_m=1.6": FAR_OFF,
                       "plus_m=0,min_gain=3": FAR_OFF, "plus_m=100,min_gain=4": NEAR}),
    ],
)  # fmt: skip
def test_much_to_see_far_off_or_little_near_by(name, numbers):
    """Without a spread every view point is a frontier cell, and with 200 samples each of the two is drawn."""
    belief = beliefs.belief_of(CORRIDOR, **ONE_METRE)
    for text, want in numbers.items():
        text += "" if "min_gain" in text else ",min_gain=1"
        assert beliefs.target_of(f"{name}:{text},samples=200,spread_m=0", belief, CROSS) == want


def test_a_choice_says_whether_it_is_a_view_point():
    belief = beliefs.belief_of(CORRIDOR, **ONE_METRE)
    for min_gain, is_view in ((3, True), (4, False)):
        policy = parse_strategy(f"decision-theoretic:lam=0,spread_m=0,min_gain={min_gain}").policy
        beams = beliefs.table(CROSS, belief)
        args = policy.select, jax.random.key(0), policy.params
        choice = beliefs.selected(*args, belief, beams)
        assert bool(choice.is_view) == is_view
        done = beliefs.selected(*args, belief.replace(exhausted=~belief.exhausted), beams)
        assert (int(done.row), int(done.col), int(done.cost), bool(done.is_view)) == (-1, -1, FAR, False)


def test_a_view_point_is_live_while_it_shows_enough():
    belief = beliefs.belief_of(CORRIDOR, **ONE_METRE)
    beams = beliefs.table(CROSS, belief)
    for (row, col), seen in ((NEAR, 1), (FAR_OFF, 3), ((1, 7), 2), ((1, 6), 1)):
        for min_gain in (1, 2, 3, 4):
            policy = parse_strategy(f"gain-rate:min_gain={min_gain}").policy
            live = policy.live(policy.params, belief, beams, jnp.int32(row), jnp.int32(col))
            assert bool(live) == (seen >= min_gain)


# ---------------------------------------------------------------- samples

SHAPE = (30, 34)
LIDAR = Lidar(n_beams=8, fov_deg=360, range_m=0.7)


@jax.jit
def drawn(key, belief, params):
    reached = field(belief)
    return *views.drawn(key, belief, reached, params), reached


def numbers(samples=500, spread_m=0.4, weight=0.2, min_gain=5):
    return views.views(("lam", weight), samples, spread_m, min_gain)


@pytest.mark.parametrize("seed", range(3))
def test_samples_can_be_reached_and_lie_near_frontiers(seed):
    belief = beliefs.after_scans(seed, SHAPE)
    exhausted = np.random.default_rng(seed).random(SHAPE) < 0.3
    belief = belief.replace(exhausted=jnp.asarray(exhausted))
    row, col, reached = jax.tree.map(np.asarray, drawn(jax.random.key(seed), belief, numbers()))
    assert (reached.cost[row, col] < FAR).all()
    assert not exhausted[row, col].any()
    frontier = np.argwhere(reached.frontier)
    d2 = ((np.stack([row, col], axis=1)[:, None] - frontier) ** 2).sum(-1).min(1)
    assert d2.max() <= (4 + 0.5 * 2**0.5) ** 2  # rounded to the centre of a cell
    assert d2.max() > 3**2
    # Every frontier cell is drawn from, and so are others.
    row, col, _ = jax.tree.map(np.asarray, drawn(jax.random.key(seed), belief, numbers(spread_m=0)))
    assert set(zip(row.tolist(), col.tolist())) <= set(map(tuple, frontier.tolist()))
    assert len(set(zip(row, col))) > 0.9 * len(frontier)


def test_draws_depend_neither_on_padding_nor_on_how_many_there_are():
    narrow, wide = (beliefs.after_scans(1, SHAPE, grow=grow) for grow in ((0, 0), (5, 11)))
    for key in map(jax.random.key, range(3)):
        few, many, padded = (drawn(key, b, numbers(n)) for b, n in ((narrow, 100), (narrow, 500), (wide, 500)))
        for a, b, c in zip(few[:2], many[:2], padded[:2]):
            np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(a, c)


def test_without_a_frontier_there_are_no_samples():
    belief = beliefs.after_scans(1, SHAPE)
    row, _, _ = drawn(jax.random.key(0), belief.replace(exhausted=~belief.exhausted), numbers())
    assert (np.asarray(row) == SHAPE[0]).all()


# ---------------------------------------------------------------- the best of them


@functools.partial(jax.jit, static_argnames=("utility",))
def all_views(utility, key, params, belief, beams):
    """Cell, utility and unknown cells in sight of every sample, none left out, and what `best_view` finds."""
    reached = field(belief)
    row, col = views.drawn(key, belief, reached, params)
    ahead = prospect(known_of(belief), beams.all_round)
    told = jax.lax.map(lambda at: look(ahead, *at, beams.all_round), (row, col))
    worth = utility(params, told.gain, views.metres(reached.cost[row, col], belief.model.cell_m))
    best, overflow = views.best_view(utility, key, params, belief, reached, beams)
    return row * reached.cost.shape[1] + col, worth, told.unknown, best, overflow


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("decision-theoretic", "scans"),
        ("gain-rate", "mixed"),
        pytest.param("decision-theoretic", "mixed", marks=pytest.mark.slow),
        pytest.param("decision-theoretic", "spots", marks=pytest.mark.slow),
        pytest.param("gain-rate", "scans", marks=pytest.mark.slow),
        pytest.param("gain-rate", "spots", marks=pytest.mark.slow),
    ],
)
def test_the_best_view_is_the_best_of_all(name, known):
    """That those which promise less are not looked at changes nothing, and neither do samples beyond the number asked
    for. Equal ones go to the lowest index: without mixed cells gains are whole numbers, and many are equal.
    """
    found, (utility,) = set(), parse_strategy(name).policy.select.args
    for seed in range(3):
        if known == "spots":  # nothing else in reach: a place shows most of what it promises
            belief = beliefs.but_for_spots(seed, SHAPE)
        else:
            belief = beliefs.after_scans(seed, SHAPE, mixed=0.2 * (known == "mixed"))
        beams = beliefs.table(LIDAR, belief)
        for weight, samples, min_gain in ((0, 500, 1), (0.2, 500, 5), (1.0, 7, 1), (3.0, 200, 4), (1.0, 500, 2**20)):
            params = numbers(samples, weight=weight, min_gain=min_gain)
            cell, worth, unknown, best, overflow = map(
                np.asarray, all_views(utility, jax.random.key(seed), params, belief, beams)
            )
            usable = (np.arange(len(cell)) < samples) & (unknown >= min_gain)
            assert overflow == 0
            if not usable.any():
                assert best == -1
                found.add("none")
                continue
            most = worth[usable].max()
            equal = set(cell[usable & (worth >= most * (1 - 1e-6))].tolist())
            assert int(best) in equal
            if weight == 0 and known != "mixed" and name == "decision-theoretic":
                assert best == min(cell[usable & (worth == most)])
                found.add("equal" if len(equal) > 1 else "one")
    assert "none" in found
    assert name == "gain-rate" or known == "mixed" or "equal" in found
