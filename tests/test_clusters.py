"""Strategies that choose among frontier clusters: by hand on small maps, and their parts compared with brute force."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ref import beliefs, plans
from ref import gain as oracle
from ref.beliefs import CORRIDOR, CROSS, FAR_OFF, NEAR, NICHES, ONE_METRE, STAR

from jexplore.planning import field, known_of
from jexplore.policies import clusters
from jexplore.policies.distance_advantage import advantage
from jexplore.policies.mcdm import choquet, relative
from jexplore.policies.peers import mutual_information
from jexplore.policies.tour import inserted, two_opt
from jexplore.reach import FAR, STRAIGHT, reach
from jexplore.rules import Lidar

pytestmark = pytest.mark.jit

A, B, C = (1, 3), (1, 9), (1, 13)  # paths from the robot 4, 2, 6; A to B 6, B to C 4, A to C 10


# ---------------------------------------------------------------- by hand


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        # 1 - beta and 3 - 6 beta: the same at beta = 0.4. By default 5.
        ("utility", {"beta=0": FAR_OFF, "beta=0.39": FAR_OFF, "beta=0.41": NEAR, "": NEAR,
                     "min_gain=2": FAR_OFF, "beta=0,min_gain=4": NEAR}),
        # Both are alike in known cells. The near one is best in d and o, the far one in a and o.
        ("mcdm", {"": FAR_OFF, "do=0.69": FAR_OFF, "do=0.71": NEAR, "ao=0.5,do=0.51": NEAR}),
    ],
)  # fmt: skip
def test_much_to_see_far_off_or_little_near_by(name, numbers):
    belief = beliefs.belief_of(CORRIDOR, **ONE_METRE)
    for text, want in numbers.items():
        assert beliefs.target_of(f"{name}:{text}".rstrip(":"), belief, CROSS) == want
    if name == "utility":
        # Area in square metres: with cells of half a metre 1/4 - beta / 2 and 3/4 - 3 beta, the same at beta = 0.2.
        metres = belief.model.replace(cell_m=jnp.float32(0.5))
        belief, lidar = belief.replace(model=metres), Lidar(n_beams=4, fov_deg=360, range_m=2.0)
        for text, want in {"beta=0.19": FAR_OFF, "beta=0.21": NEAR}.items():
            assert beliefs.target_of(f"{name}:{text}", belief, lidar) == want


def test_revenue_counts_unknown_area_seen_or_not():
    """The better of two clusters, 1 m and 6 m away, by the formula in plain numpy."""
    belief = beliefs.belief_of(CORRIDOR, **ONE_METRE)
    known = np.asarray(belief.grid.hits + belief.grid.misses) > 0
    rows, cols = np.indices(known.shape)

    def worth(at, weight=3.0, radius_m=1.0, near_m=3.0, near_gain=2.0):
        off_m = np.hypot(at[0] - int(belief.row), at[1] - int(belief.col))
        near = np.hypot(rows - at[0], cols - at[1]) <= radius_m
        gain = max(np.pi * radius_m**2 - (known & near).sum(), 0)
        return weight * gain * (near_gain if off_m <= near_m else 1.0) - off_m

    chosen = set()
    for more in ({}, {"near_gain": 0.5}, {"near_gain": 0.5, "weight": 30.0}, {"radius_m": 2.0, "near_m": 0.5},
                 {"radius_m": 2.0, "near_m": 0.5, "weight": 20.0}):  # fmt: skip
        text = ",".join(f"{key}={value}" for key, value in more.items())
        want = max((NEAR, FAR_OFF), key=lambda at: worth(at, **more))
        assert beliefs.target_of(f"revenue:{text}".rstrip(":"), belief, CROSS) == want
        chosen.add(want)
    assert chosen == {NEAR, FAR_OFF}


def test_mutual_information_for_a_metre_of_path():
    """One unknown cell 1 m away tells half as much as a hit and a miss, three 6 m away 7/8: the same at 17/3 m."""
    belief = beliefs.belief_of(CORRIDOR, **ONE_METRE)
    for text, want in {"": NEAR, "plus_m=5.6": NEAR, "plus_m=5.7": FAR_OFF}.items():
        assert beliefs.target_of(f"mutual-information:{text}".rstrip(":"), belief, CROSS) == want


@pytest.mark.parametrize("seed", [0, 1])
def test_mutual_information_is_the_expected_divergence_of_what_a_beam_tells(seed):
    """Every end of every beam, its probability, and how far the cells that it tells of are then from before."""
    belief = beliefs.after_scans(seed, (14, 17), mixed=0.3)
    beams, delta = beliefs.table(Lidar(n_beams=12, fov_deg=360, range_m=0.5), belief).all_round, 2.5
    hits, seen = np.asarray(belief.grid.hits), np.asarray(belief.grid.hits + belief.grid.misses)
    prior = np.pad(np.where(seen > 0, hits / np.maximum(seen, 1), 0.5), 9, constant_values=0.5)

    def divergence(p, odds):
        after = p * odds / (p * odds + 1 - p)
        return sum(a * np.log(a / b) for a, b in ((after, p), (1 - after, 1 - p)) if a > 0)

    def expected(row, col):
        total = 0.0
        for beam, length in enumerate(np.asarray(beams.length[0])):
            at = [(row + 9 + beams.drow[0, i, beam], col + 9 + beams.dcol[0, i, beam]) for i in range(length)]
            chance, passed = 1.0, 0.0
            for p in (prior[r, c] for r, c in at):
                total += chance * p * (passed + divergence(p, delta))
                chance, passed = chance * (1 - p), passed + divergence(p, 1 / delta)
            total += chance * passed
        return total

    maps = mutual_information._maps(known_of(belief), beams, delta)
    found = [float(mutual_information.look_around(maps, row, col, beams)) for row, col in ((3, 4), (0, 0), (13, 9))]
    np.testing.assert_allclose(found, [expected(3, 4), expected(0, 0), expected(13, 9)], rtol=1e-4)


def test_consistent_tour_begins_straight_ahead():
    """Left first 1 + 7 m, right first 6 + 7 m; the robot faces right, so that left is pi turn_m farther off."""
    belief = beliefs.belief_of(CORRIDOR, **ONE_METRE)
    for text, want in {"turn_m=0": NEAR, "turn_m=1.5": NEAR, "turn_m=1.7": FAR_OFF, "": FAR_OFF}.items():
        assert beliefs.target_of(f"consistent-tour:{text}".rstrip(":"), belief, CROSS) == want
    assert beliefs.target_of("consistent-tour", belief.replace(heading=jnp.int32(4)), CROSS) == NEAR


def test_small_first_puts_off_what_draws_the_robot_in():
    """One step to the right 3 unknown cells, six to the left 1: -1 - s sqrt(3) and -6 - s, the same at s = 6.83."""
    belief = beliefs.belief_of("############## #?......R.???# ##############", **ONE_METRE)
    for text, want in {"": (1, 9), "side_weight=6.8": (1, 9), "side_weight=6.9": (1, 2)}.items():
        assert beliefs.target_of(f"small-first:{text}".rstrip(":"), belief, CROSS) == want


def test_every_pair_of_criteria_has_a_weight_of_its_own():
    """The near one is best in unknown cells (3 to 1) and path, the far one in known cells (6 to 5)."""
    belief = beliefs.belief_of("############# ##########.## #???.R.....?# #############", **ONE_METRE)
    near, far_off = (1, 4), (1, 10)
    for text, want in {"": near, "o=0.6,ao=0.6,do=0.6,ad=0.61": near, "o=0.6,ao=0.6,do=0.6,ad=0.59": far_off}.items():
        assert beliefs.target_of(f"mcdm:{text}".rstrip(":"), belief, CROSS) == want


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        # Mean distance from the others 8, 5, 7, less the path 4, 2, 6; where nothing shows enough: the nearest.
        ("distance-advantage", {"weight=0": B, "weight=0.6": B, "weight=0.7": A, "": A, "min_gain=2": B}),
        # The same, since all show as much; the square root of one cell, put off from all alike.
        ("small-first", {"weight=0": B, "weight=0.6": B, "weight=0.7": A, "": B, "min_gain=2": B, "side_weight=9": B}),
        # Ways through all: A B C 14, B A C 18, B C A 16, C B A 16. The nearest stop is not the first.
        ("tour", {"": A, "min_gain=2": A}),
    ],
)
def test_three_niches(name, numbers):
    for text, want in numbers.items():
        assert beliefs.target_of(f"{name}:{text}".rstrip(":"), beliefs.belief_of(NICHES, **ONE_METRE), STAR) == want


BETWEEN = jax.jit(clusters.costs_between)
ROUND = Lidar(n_beams=12, fov_deg=360, range_m=0.5)


@jax.jit
def everything(belief, beams):
    """Return `Targets`, the cells seen from them, their distances, and traversable cells."""
    known = field(belief)
    at = clusters.targets(belief, known)
    return at, clusters.looks(belief, at, beams), clusters.paths_apart(belief, at), known.traversable


def test_targets_by_hand():
    belief = beliefs.belief_of(NICHES, **ONE_METRE)
    at, (unknown, seen_known), apart_m, _ = everything(belief, beliefs.table(STAR, belief))
    n = int(at.used.sum())
    assert list(zip(at.row[:n].tolist(), at.col[:n].tolist())) == [A, B, C]
    assert at.path_m[:n].tolist() == [4, 2, 6]
    want = np.full((len(at.row), len(at.row)), np.inf)
    want[:3, :3] = [[0, 6, 10], [6, 0, 4], [10, 4, 0]]
    np.testing.assert_array_equal(apart_m, want)
    assert (unknown[:4].tolist(), seen_known[:4].tolist()) == ([1, 1, 1, 0], [3, 3, 3, 0])


def test_the_best_of_some_targets():
    at = clusters.Targets(*jnp.asarray([[0, 0, 0, -1]] * 2), jnp.asarray([1, 1, 1, 0], bool),
                          jnp.asarray([3.0, 2, 4, jnp.inf]), jnp.asarray([1, 1, 1, 0]), jnp.int32(0))  # fmt: skip
    worth = jnp.asarray([1.0, 2, 3, 4])
    for usable, want in (([1, 1, 1, 1], 2), ([1, 1, 0, 1], 1), ([1, 0, 0, 0], 0), ([0, 0, 0, 1], 1), ([0] * 4, 1)):
        assert clusters.best_of(at, worth, jnp.asarray(usable, bool)) == want
    assert clusters.best_of(at, worth, jnp.asarray([1, 1, 1, 0], bool)).dtype == jnp.int32
    assert clusters.best_of(at.replace(used=at.used & False), worth, worth > 0) == -1


@given(st.integers(0, 2**30), st.integers(0, 12))
@settings(max_examples=20, deadline=None)
def test_costs_between_cells_are_those_from_each(seed, n):
    draw = np.random.default_rng(seed)
    passable = draw.random((7, 9)) < 0.75
    row, col = (draw.integers(0, size, 12).astype(np.int32) for size in passable.shape)
    passable[row, col] = True
    want = np.full((12, 12), FAR)
    for i in range(n):
        want[i, :n] = reach(passable, row[i], col[i])[row[:n], col[:n]]
    got = np.array(BETWEEN(passable, row, col, np.int32(n)))
    np.testing.assert_array_equal(got[:n, :n], want[:n, :n])


# ---------------------------------------------------------------- how far targets lie apart


@pytest.mark.slow
@pytest.mark.parametrize("clearance_d2", [0, 9])
def test_distances_on_blocks_are_near_the_exact_ones(clearance_d2):
    """And the cells seen from the targets are those of a look-around at each."""
    shape, compared = (60, 70), 0
    side = clusters.block_side(clearance_d2)
    assert side == (1 if clearance_d2 == 0 else 4)
    for seed in range(3):
        belief = beliefs.but_for_spots(seed, shape, clearance_d2=clearance_d2)
        beams = beliefs.table(ROUND, belief)
        at, (unknown, seen_known), got, passable = jax.tree.map(np.asarray, everything(belief, beams))
        hits, misses = np.asarray(belief.grid.hits), np.asarray(belief.grid.misses)
        n = at.used.sum()
        assert not unknown[n:].any()
        assert not seen_known[n:].any()
        assert np.isinf(got[n:]).all()
        assert np.isinf(got[:, n:]).all()
        got = got[:n, :n]
        np.testing.assert_array_equal(got, got.T)
        assert not got.diagonal().any()
        for i in range(n):
            where = int(at.row[i]), int(at.col[i])
            assert (unknown[i], seen_known[i]) == oracle.look(hits, misses, *where, 12, 360, 5)[1:]
            cost, _ = plans.dijkstra(passable, where)
            exact = cost[at.row[:n], at.col[:n]] / plans.STRAIGHT * 0.1
            if clearance_d2 == 0:
                np.testing.assert_allclose(got[i], exact, rtol=1e-5)
            # Both ends may lie anywhere in their blocks, and ways through blocks cut corners and make steps.
            assert (np.abs(got[i] - exact) <= 3 * side * 0.1 + 0.1 * exact).all()
            compared += n
    assert compared > 20


@pytest.mark.parametrize("wall", [28, 31])
def test_no_way_leads_through_a_thin_wall_beside_the_robot(wall):
    cells = np.full((60, 70), ".")
    cells[[0, -1], :] = cells[:, [0, -1]] = cells[wall, :60] = "#"
    cells[15:18, 9:12] = cells[39:42, 9:12] = "?"
    cells[wall - 4, 10] = "R"
    belief = beliefs.belief_from(cells == "#", (cells == ".") | (cells == "R"), (wall - 4, 10), clearance_d2=9)
    belief = belief.replace(model=belief.model.replace(near_d2=jnp.int32(25)))
    at, _, apart_m, passable = everything(belief, beliefs.table(ROUND, belief))
    cost, _ = plans.dijkstra(np.asarray(passable), (int(at.row[0]), int(at.col[0])))
    assert apart_m[0, 1] > 0.9 * cost[at.row[1], at.col[1]] * 0.1 / STRAIGHT > 9


def test_no_path_no_distance():
    """Two rooms, one of them with the robot in it: a target in the other cannot be, so both are given."""
    text = "######### #?..#..?# #..R#...# #########"
    belief = beliefs.belief_of(text, **ONE_METRE)
    at = clusters.Targets(
        jnp.asarray([2, 2, -1]), jnp.asarray([2, 6, -1]), jnp.asarray([True, True, False]),
        jnp.asarray([1.0, jnp.inf, jnp.inf]), jnp.asarray([1, 1, 0]), jnp.int32(0),
    )  # fmt: skip
    inf = np.inf
    np.testing.assert_array_equal(
        jax.jit(clusters.paths_apart)(belief, at), [[0, inf, inf], [inf, 0, inf], [inf, inf, inf]]
    )


def test_advantage_by_hand():
    """Four targets: one that no path joins to the others, and one that does not count."""
    inf = jnp.inf
    apart_m = jnp.asarray([[0, 3, inf, 5], [3, 0, inf, 1], [inf, inf, 0, inf], [5, 1, inf, 0]], jnp.float32)
    path_m = jnp.asarray([2.0, 1.0, 4.0, 0.5])
    every = jnp.ones(4, bool)
    np.testing.assert_allclose(advantage(path_m, apart_m, every, 1.0), [4 - 2, 2 - 1, -4, 3 - 0.5])
    np.testing.assert_allclose(advantage(path_m, apart_m, every, 2.0), [8 - 2, 4 - 1, -4, 6 - 0.5])
    # The first counts three times as much as the others: the second's others are (3 x 3 + 1) / 4 away, the last's 4.
    got = advantage(path_m, apart_m, every, 1.0, jnp.asarray([3.0, 1, 1, 1]))
    np.testing.assert_allclose(got, [4 - 2, 2.5 - 1, -4, 4 - 0.5])
    got = advantage(path_m, apart_m, jnp.asarray([True, True, True, False]), 1.0)
    np.testing.assert_allclose(got[:3], [3 - 2, 3 - 1, -4])


# ---------------------------------------------------------------- tour


def length_of(lengths, route):
    return sum(float(lengths[a][b]) for a, b in itertools.pairwise(route))


def best_turns(lengths, route, n):
    """Oracle for `two_opt`: every turn tried, the best one taken, of equal ones the first."""
    while True:
        found = [(0.0, route)]
        for i, j in itertools.combinations(range(1, n + 1), 2):
            new = [*route[:i], *route[i : j + 1][::-1], *route[j + 1 :]]
            found.append((length_of(lengths, route) - length_of(lengths, new), new))
        saved, new = max(found, key=lambda turn: turn[0])
        if saved <= 1e-3:
            return route
        route = new


def test_every_turn_is_tried_however_many_stops_there_are():
    """More than are tried together, in a table with room for more. City blocks tie, and are whole numbers."""
    for n, seed in ((8, 0), (8, 1), (20, 0), (20, 1)):
        places = np.random.default_rng((n, seed)).integers(0, 12, (23, 2))
        lengths = np.abs(places[:, None] - places).sum(-1).astype(np.float32)
        first, better = (route[: n + 1].tolist() for route in both(jnp.asarray(lengths), jnp.int32(n)))
        assert better == best_turns(lengths, first, n)


both = jax.jit(lambda lengths, n: (first := inserted(lengths, n), two_opt(lengths, first, n)))


def nearest_insertion(lengths, n):
    """Oracle for `inserted`: the same rule in plain loops."""
    route = [0]
    while len(route) <= n:
        node = min(set(range(1, n + 1)) - set(route), key=lambda k: (min(lengths[a][k] for a in route), k))
        routes = [[*route[:i], node, *route[i:]] for i in range(1, len(route) + 1)]
        route = min(routes, key=lambda r: length_of(lengths, r))
    return route


@given(st.integers(0, 6), hnp.arrays(np.int64, (7, 2), elements=st.integers(0, 30)), st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_routes_beside_all_permutations(n, places, seed):
    """City blocks, so that lengths are whole numbers; now and then a way is barred."""
    lengths = np.abs(places[:, None] - places).sum(-1).astype(np.float32)
    barred = np.triu(np.random.default_rng(seed).random((7, 7)) < 0.1, 1)
    lengths[barred | barred.T] = 1e6
    first, better = (route[: n + 1].tolist() for route in both(jnp.asarray(lengths), jnp.int32(n)))
    assert first == nearest_insertion(lengths, n)
    assert better[0] == 0
    assert sorted(better) == list(range(n + 1))
    length = length_of(lengths, better)
    assert length <= length_of(lengths, first)
    assert better == best_turns(lengths, first, n)
    best = min(length_of(lengths, (0, *order)) for order in itertools.permutations(range(1, n + 1)))
    assert best <= length
    if n <= 2:
        assert length == best


# ---------------------------------------------------------------- mcdm


def test_relative_values_by_hand():
    value = jnp.asarray([3.0, 5.0, 4.0, 100.0])
    used = jnp.asarray([True, True, True, False])
    np.testing.assert_allclose(relative(value, used), [0, 1, 0.5, 0])
    np.testing.assert_allclose(relative(-value, used), [1, 0, 0.5, 0])
    np.testing.assert_allclose(relative(jnp.full(4, 2.0), used), [1, 1, 1, 0])
    np.testing.assert_allclose(relative(value, used & False), [0, 0, 0, 0])


MEASURE = jnp.asarray([0, 0.5, 0.3, 0.95, 0.2, 0.7, 0.4, 1])  # of {}, a, d, ad, o, ao, do, ado: the defaults


def test_the_choquet_integral_by_hand():
    """a = 0.2, d = 0.5, o = 1: 0.2 of all, 0.3 more of d and o, 0.5 more of o. And the same turned round."""
    columns = jnp.asarray([[0.2, 0.5, 1.0], [1.0, 0.5, 0.2], [0.0, 1.0, 1.0], [1.0, 1.0, 0.0]]).T
    want = [0.2 + 0.3 * 0.4 + 0.5 * 0.2, 0.2 + 0.3 * 0.95 + 0.5 * 0.5, 0.4, 0.95]
    np.testing.assert_allclose(choquet(columns, MEASURE), want, rtol=1e-6)
