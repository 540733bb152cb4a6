"""Deciding in pieces: who is glanced at and who gets a slot, by hand; a search that ends where one in one go does."""

import functools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_planning import IN_MAP, S, drawn, large_belief, no_route

from jexplore.arrays import bits
from jexplore.engine import thoughts
from jexplore.exploration import pieces
from jexplore.planning import bound_of, nearest_in_window
from jexplore.planning.readout import last_motions, lay_route, lay_some
from jexplore.reach import FAR, motions_into, reach_packed, source, spread

# ---------------------------------------------------------------- who, by hand


def some_thoughts():
    """Four lanes, of which lane 2 has the second of three slots; lanes 1 and 3 were glanced at in vain."""
    return thoughts.Thoughts(jnp.array([0, 1, 1, 1]), jnp.array([4, 2, 4]), {"left": jnp.array([0, 0, 7])})


def test_sizes_by_hand():
    assert thoughts.sizes(64, 2) == ((8, 4), 8, 2)
    assert thoughts.sizes(65, 1) == ((9,), 9, 3)
    assert thoughts.sizes(64, 0) == ((), 8, 8)
    assert thoughts.sizes(1, 1) == ((1,), 1, 1)


def test_slots_are_taken_by_who_waits_and_has_none():
    waits = jnp.array([False, True, True, True])
    for m, want in ((3, ([0, 2, 3], [1, 3, 4])), (1, ([0], [1])), (2, ([0, 2], [1, 3]))):
        assert [a.tolist() for a in thoughts.taken(some_thoughts(), waits, m)] == list(want)
    assert thoughts.is_seeking(some_thoughts()).tolist() == [False, False, True, False]


def test_what_is_found_is_given_back():
    done = SimpleNamespace(is_done=lambda search: search["left"] == 0)
    slot, lane = thoughts.found(done, some_thoughts(), 2)
    assert (slot.tolist(), lane.tolist()) == ([1, 3], [2, 4])  # the first slot's search is nobody's
    after = thoughts.given_back(some_thoughts(), slot, lane)
    assert (after.lane.tolist(), after.stage.tolist()) == ([4, 4, 4], [0, 1, 0, 1])


def test_glances_move_on_or_settle():
    after = thoughts.glanced(some_thoughts(), jnp.array([0, 3, 4]), jnp.array([False, True, False]))
    assert after.stage.tolist() == [1, 1, 1, 0]


# ---------------------------------------------------------------- waves and ways of known length


def test_a_wave_goes_on_by_hand():
    """Eight free cells in a row; 4 rounds settle 4 steps, 8 all, after which nothing changes."""
    words, goals = bits.pack(jnp.ones((1, 9), bool)), jnp.zeros((32, 9), bool).at[0, 6].set(True)
    wave = jnp.int32(0), source((32, 9), 0, 0)
    once = spread(motions_into(words), wave, goals)
    assert (int(once[0]), once[1][0].tolist()) == (4 * S, [i * S for i in range(5)] + [FAR] * 4)
    for rounds in (4, 8):  # four more, or eight at once: the goal at 6 steps is settled
        ended = spread(motions_into(words), once if rounds == 4 else wave, goals, rounds=rounds)
        assert (int(ended[0]), ended[1][0].tolist()) == (FAR, [i * S for i in range(9)])
    assert int(spread(motions_into(words), wave, None, rounds=8)[0]) == 8 * S
    assert int(spread(motions_into(words), wave, None, rounds=12)[0]) == FAR


@jax.jit
def ways(passable, row, col, draw):
    """Costs by sweeps and by a wave that is 6 long, and the way to a reached cell, laid in three forms."""
    words = bits.pack(passable)
    cost = reach_packed(words, row, col)
    short = reach_packed(words, row, col, limit=6 * S, within=6, method="wave")
    reached = jnp.ravel(cost < FAR)
    end = jnp.argsort(~reached)[draw % jnp.sum(reached)]
    target, blank, cost = (end // 9, end % 9), jnp.full((7, 9), -1, jnp.int8), cost[:7]
    lay = functools.partial(lay_route, blank, cost, passable, (row, col), target, (0, 0))
    motions, at, route = last_motions(cost, passable), target, blank
    for _ in range(10):
        at, route = lay_some(route, motions, (row, col), at, (0, 0), n=4)
    return cost, short[:7], jnp.stack([lay(), lay(stride=2, within=40), lay(stride=4), route]), jnp.stack(at)


@pytest.mark.jit
@settings(max_examples=50)
@given(st.integers(0, 2**20))
def test_waves_and_ways_of_known_length_are_those_of_any(seed):
    draw = np.random.default_rng(seed)
    passable = draw.random((7, 9)) < 0.8
    row, col = (int(draw.integers(n)) for n in passable.shape)
    passable[row, col] = True
    cost, short, routes, at = map(np.asarray, ways(passable, row, col, int(draw.integers(10**6))))
    np.testing.assert_array_equal(short[cost <= 6 * S], cost[cost <= 6 * S])
    assert (short >= cost).all()
    assert (routes == routes[0]).all()
    assert at.tolist() == [row, col]


# ---------------------------------------------------------------- searches and glances

PARTS = pieces.pieces_of((32,))
BEGIN = jax.jit(lambda belief, route: PARTS.begin(None, None, SimpleNamespace(belief=belief, route=route)))
GO_ON, FIXED = jax.jit(PARTS.go_on), jax.jit(functools.partial(nearest_in_window, side=32, fixed=True))


def searched(belief):
    """What a search finds: `(row, col, route, pieces)`."""
    route, taken = no_route(belief), 0
    search = BEGIN(belief, route)
    while not PARTS.is_done(search):
        search, taken = GO_ON(search), taken + 1
        assert taken <= 2 * route.size // pieces.PIECE + 2
    again = GO_ON(search)
    for name in ("target", "route", "at"):  # what is done stays as it is
        np.testing.assert_array_equal(getattr(search, name), getattr(again, name))
    return *(int(i) for i in search.target), search.route, taken


@pytest.mark.jit
def test_a_search_by_hand():
    row, col, route, taken = searched(drawn("?....R..?"))
    assert (row, col, taken) == (0, 7, 1)
    assert route.tolist() == [[-1, -1, -1, -1, -1, 0, 0, -1, -1]]
    assert searched(drawn("#..R..#"))[:2] == (-1, -1)


@pytest.mark.jit
@pytest.mark.parametrize("clearance_d2", [9])
def test_pieces_end_where_one_go_does(clearance_d2):
    """The whole map's answer, searched for in pieces; and a glance's, where it has one."""
    settled = []
    for seed in range(16):
        belief = large_belief(seed, (70, 61), clearance_d2, [1, 3, 9, 12, 20, 40, 400])
        belief = belief.replace(model=belief.model.replace(reach="wave"))
        want, whole_route = IN_MAP(belief, no_route(belief))
        row, col, route, _ = searched(belief)
        assert (row, col) == (int(want.row), int(want.col))
        np.testing.assert_array_equal(route, whole_route)
        undecided, choice, route = FIXED(belief, no_route(belief))
        assert bool(undecided) == (int(want.cost) > bound_of(32, clearance_d2))
        settled.append(not undecided)
        if settled[-1]:
            assert [int(getattr(choice, n)) for n in ("row", "col", "cost")] == [row, col, int(want.cost)]
            np.testing.assert_array_equal(route, whole_route)
    assert 0 < sum(settled) < len(settled)
