"""Deciding in pieces: who is glanced at and who gets a slot, by hand; a search that ends where one in one go does."""

import functools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax
from ref import plans
from test_planning import IN_MAP, S, drawn, follow, large_belief, no_route, oracle

from jexplore.arrays import bits
from jexplore.engine import thoughts
from jexplore.exploration import pieces
from jexplore.planning import bound_of, windows
from jexplore.planning.glances import MOST, UNITS, UNREACHED, costs_of, glance, placed
from jexplore.planning.readout import laid, last_motions, lay_route, way_by_doubling, way_by_steps
from jexplore.planning.waves import ALIGN, SHUT, margins, outwards, room, shut_ways, width_of
from jexplore.reach import DIAGONAL, FAR, STEPS, STRAIGHT, motions_into, reach_packed, source, spread

# ---------------------------------------------------------------- who, by hand


def some_thoughts():
    """Four lanes, of which lane 2 has the second of three slots; lanes 1 and 3 were glanced at in vain."""
    seen = (jnp.array([7, 8, 9, 10]),)
    return thoughts.Thoughts(jnp.array([0, 1, 1, 1]), jnp.array([4, 2, 4]), {"left": jnp.array([0, 0, 7])}, seen)


def test_sizes_by_hand():
    assert thoughts.sizes(64, 2) == ((16, 4), 3, 2)
    assert thoughts.sizes(65, 1) == ((17,), 6, 3)
    assert thoughts.sizes(64, 3) == ((16, 4, 4), 3, 2)
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
    which, seen = jnp.array([0, 3, 4]), jnp.array([1, 2, 3])
    after = thoughts.glanced(some_thoughts(), 0, which, jnp.array([False, True, False]), seen)
    assert after.stage.tolist() == [1, 1, 1, 0]
    assert after.seen[0].tolist() == [1, 8, 9, 2]
    assert thoughts.seen_before(after, 1, jnp.array([3, 1])).tolist() == [2, 8]
    assert thoughts.seen_before(after, 0, which) == ()


# ---------------------------------------------------------------- waves and ways of known length

# Radii of waves, one after the other: of a whole number of groups of rounds, with a smaller one last, going on.
LENGTHS = (4,), (6,), (3, 7)


def test_a_wave_goes_on_by_hand():
    """Eight free cells in a row; 4 rounds settle what costs less than 5 steps, 8 all; then nothing changes."""
    words, goals = bits.pack(jnp.ones((1, 9), bool)), jnp.zeros((32, 9), bool).at[0, 6].set(True)
    wave = jnp.int32(0), source((32, 9), 0, 0)
    once = spread(motions_into(words), wave, goals)
    assert (int(once[0]), once[1][0].tolist()) == (5 * S - 1, [i * S for i in range(5)] + [FAR] * 4)
    for rounds in (4, 8):  # four more, or eight at once: the goal at 6 steps is settled
        ended = spread(motions_into(words), once if rounds == 4 else wave, goals, rounds=rounds)
        assert (int(ended[0]), ended[1][0].tolist()) == (FAR, [i * S for i in range(9)])
    assert int(spread(motions_into(words), wave, None, rounds=8)[0]) == 9 * S - 1
    assert int(spread(motions_into(words), wave, None, rounds=12)[0]) == FAR


def wave(words, row, col, radii, steps, far):
    """Costs after a wave outwards from a cell to one radius after the other: `[7, 9]`; `far` where it has not come."""
    cost, ways = jnp.full((1, width_of(0)), far).at[0, 0].set(0), shut_ways(motions_into(words))
    for before, radius in zip((0, *radii), radii):
        (above, left), size = margins(radius), room(radius)
        shut = jnp.pad(ways, ((above, above), (left, size[1] - left)), constant_values=SHUT)
        cost = outwards(cost, lax.dynamic_slice(shut, (row, col), size), steps, (before, radius), int(far))
    n = radii[-1]
    whole = jnp.full((7 + 2 * n, 9 + 2 * n + ALIGN), far)
    return lax.dynamic_update_slice(whole, cost, (row, col))[n : n + 7, n : n + 9]


@jax.jit
def ways(passable, row, col, draw):
    """Costs by sweeps, by waves of `LENGTHS`, by those in `UNITS`; the way to a reached cell, in four forms."""
    words = bits.pack(passable)
    cost = reach_packed(words, row, col)
    short = jnp.stack([wave(words, row, col, radii, STEPS, np.int32(FAR)) for radii in LENGTHS])
    units = jnp.stack([wave(words, row, col, radii, UNITS, np.int16(UNREACHED)) for radii in LENGTHS])
    reached = jnp.ravel(cost < FAR)
    end = jnp.argsort(~reached)[draw % jnp.sum(reached)]
    target, blank, cost = (end // 9, end % 9), jnp.full((7, 9), -1, jnp.int8), cost[:7]
    lay = functools.partial(lay_route, blank, cost, passable, (row, col), target, (0, 0))
    motions, at, route = last_motions(cost, passable), target, blank
    for _ in range(10):
        at, way = way_by_steps(motions, at, (0, 0), 7, n=4)
        route = laid(route, way)
    way = way_by_doubling(motions, target, (0, 0), 7, n=37)
    first = way.first(row, col) == jnp.maximum(route[row, col], 0)
    routes = jnp.stack([lay(), lay(stride=4), route, laid(blank, way)])
    return cost, short, costs_of(units), routes, jnp.stack(at), first


@pytest.mark.jit
@settings(max_examples=50)
@given(st.integers(0, 2**20))
def test_waves_and_ways_of_known_length_are_those_of_any(seed):
    draw = np.random.default_rng(seed)
    passable = draw.random((7, 9)) < 0.8
    row, col = (int(draw.integers(n)) for n in passable.shape)
    passable[row, col] = True
    cost, short, by_units, routes, at, first = map(np.asarray, ways(passable, row, col, int(draw.integers(10**6))))
    np.testing.assert_array_equal(by_units, short)
    assert first
    for costs, (*_, last) in zip(short, LENGTHS):
        np.testing.assert_array_equal(costs[cost <= last * S], cost[cost <= last * S])
    assert (short >= cost).all()
    assert (routes == routes[0]).all()
    assert at.tolist() == [row, col]


def test_units_of_a_window_order_ways_as_costs_do():
    """All ways of as many motions as a window's wave has rounds, each beside each."""
    straight, diagonal = (a.reshape(-1) for a in np.indices((MOST + 1, MOST + 1)))
    few = straight + diagonal <= MOST
    straight, diagonal = straight[few].astype(np.int64), diagonal[few].astype(np.int64)
    units, cost = UNITS[0] * straight + UNITS[1] * diagonal, STRAIGHT * straight + DIAGONAL * diagonal
    assert units.max() + UNITS[1] < UNREACHED
    order = np.argsort(cost, kind="stable")
    np.testing.assert_array_equal(np.sign(np.diff(units[order])), np.sign(np.diff(cost[order])))
    np.testing.assert_array_equal(costs_of(units.astype(np.int16)), cost)
    assert int(costs_of(np.int16(UNREACHED))) == FAR


# ---------------------------------------------------------------- searches and glances

PARTS = pieces.pieces_of(())
BEGIN = jax.jit(lambda belief: PARTS.begin(None, None, SimpleNamespace(belief=belief), ()))
GO_ON = jax.jit(PARTS.go_on)


@jax.jit
def glances(belief):
    """Two glances, the second of which goes on from the first; the second one alone; and a search after it."""
    small = glance(belief, 20)
    large = glance(belief, 32, small.cost, 20)
    search = pieces.pieces_of((20, 32)).begin(None, None, SimpleNamespace(belief=belief), large.cost)
    return small, large, glance(belief, 32), search


def searched(belief, search=None):
    """What a search finds: `(row, col, route, pieces)`."""
    route, taken = no_route(belief), 0
    search = BEGIN(belief) if search is None else search
    while not PARTS.is_done(search):
        search, notes = GO_ON(search)
        route, taken = laid(route, notes.way), taken + 1
        assert taken <= 2 * route.size // pieces.PIECE + 2
    again, notes = GO_ON(search)
    for name in ("target", "motion", "at"):  # what is done stays as it is
        np.testing.assert_array_equal(getattr(search, name), getattr(again, name))
    assert (notes.way.rows >= search.cost.shape[0]).all()
    assert int(search.motion) == max(int(route[belief.row, belief.col]), 0)
    return *(int(i) for i in search.target), route, taken


@pytest.mark.jit
def test_a_search_by_hand():
    row, col, route, taken = searched(drawn("?....R..?"))
    assert (row, col, taken) == (0, 7, 1)
    assert route.tolist() == [[-1, -1, -1, -1, -1, 0, 0, -1, -1]]
    assert searched(drawn("#..R..#"))[:2] == (-1, -1)


@pytest.mark.jit
@pytest.mark.parametrize("clearance_d2", [9])
def test_pieces_end_where_one_go_does(clearance_d2):
    """The whole map's answer, searched for in pieces, from the start or after glances; theirs, where they have one."""
    settled = []
    for seed in range(16):
        belief = large_belief(seed, (70, 61), clearance_d2, [1, 3, 9, 12, 20, 40, 400])
        belief = belief.replace(model=belief.model.replace(reach="wave"))
        want, whole_route = IN_MAP(belief, no_route(belief))
        row, col, route, _ = searched(belief)
        assert (row, col) == (int(want.row), int(want.col))
        np.testing.assert_array_equal(route, whole_route)
        *found, search = glances(belief)
        again_row, again_col, route, _ = searched(belief, search)
        assert (again_row, again_col) == (row, col)
        np.testing.assert_array_equal(route, whole_route)
        for seen, side in zip(found, (20, 32, 32)):
            bound = bound_of(side, clearance_d2)
            assert bool(seen.settled) == (int(want.cost) <= bound)
            if seen.settled:
                assert [int(getattr(seen.choice, n)) for n in ("row", "col", "cost")] == [row, col, int(want.cost)]
                np.testing.assert_array_equal(laid(no_route(belief), seen.way), whole_route)
                assert int(seen.way.first(belief.row, belief.col)) == max(int(whole_route[belief.row, belief.col]), 0)
            else:
                assert (seen.way.rows >= 70).all()
        settled.append(bool(found[1].settled))
        assert (costs_of(found[1].cost) == costs_of(found[2].cost))[costs_of(found[2].cost) <= bound].all()
    assert 0 < sum(settled) < len(settled)


@functools.partial(jax.jit, static_argnums=1)
@functools.partial(jax.vmap, in_axes=(0, None))
def glances_in(beliefs, sides):
    """Glances into windows, each of which goes on from the one before, and the costs that it tells of in the map."""
    found, before = [], (None, 0)
    for side in sides:
        seen = glance(beliefs, side, *before)
        found.append((seen, costs_of(placed(seen.cost, side, beliefs, beliefs.driven.shape))))
        before = seen.cost, side
    return found


@pytest.mark.jit
@pytest.mark.parametrize(("shape", "clearance_d2"), [((129, 40), 0), ((70, 200), 9)])
def test_glances_into_the_windows_that_there_are_see_what_the_oracle_does(shape, clearance_d2):
    """Windows of 64 and 128 cells, which are larger than one side of the map or both."""
    sides, beliefs, settled = tuple(windows(shape, clearance_d2, glances=True)), [], []
    assert sides == (64, 128)
    for seed in range(12):
        belief = large_belief(seed, shape, clearance_d2, [1, 9, 24, 26, 28, 40, 56, 60, 400])
        beliefs.append(belief.replace(model=belief.model.replace(reach="wave")))
    found = jax.device_get(glances_in(jax.tree.map(lambda *a: jnp.stack(a), *beliefs), sides))
    for i, belief in enumerate(beliefs):
        _, cost, pred, candidates = oracle(belief)
        best, start = plans.closest(candidates, cost), (int(belief.row), int(belief.col))
        target = divmod(best, shape[1])
        for side, (seen, costs) in zip(sides, jax.tree.map(lambda a, i=i: a[i], found)):
            bound = bound_of(side, clearance_d2)
            np.testing.assert_array_equal(costs[cost <= bound], cost[cost <= bound])
            assert seen.settled == (best >= 0 and cost[target] <= bound)
            if seen.settled:
                assert (seen.choice.row, seen.choice.col, seen.choice.cost) == (*target, cost[target])
                route = np.asarray(laid(no_route(belief), seen.way))
                assert follow(route, start, target) == (plans.path(pred, start, target), cost[target])
            settled.append((side, bool(seen.settled)))
    assert len(set(settled)) == 4
