"""Strategies of other papers: by hand on small maps, and step by step compared with plain numpy and Dijkstra."""

import heapq
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs, maps, plans, simulator
from ref import gain as oracle
from ref.beliefs import belief_of
from ref.episodes import clear_cells, compared

from jexplore.planning import field
from jexplore.policies import parse_strategy
from jexplore.policies.peers import random_tree
from jexplore.policies.peers.exploration_transform import STEPS, Params, descent, transform
from jexplore.policies.peers.nearest_region import goals, nearest_region
from jexplore.reach import FAR, MOTIONS
from jexplore.rules import Lidar, Rules

pytestmark = pytest.mark.jit


STAR = Lidar(n_beams=8, fov_deg=360, range_m=3.0)
# Cells of one metre. A region of three cells on the left, 3 m away; one of ten round the corner on the right, whose
# mean, (4, 8.5), is a known cell.
HOOK = """
    #####??????###
    #####......?##
    #####......?##
    ?...#......?##
    ?..........?##
    ?...R......?##
    ##############
"""
LEFT, CENTROID, MEMBER = (2, 1), (4, 9), (5, 8)


def test_least_size_decides_and_an_exhausted_centroid_gives_way():
    belief = belief_of(HOOK, cell_m=1.0)
    spent = belief.replace(exhausted=belief.exhausted.at[CENTROID].set(True))
    policy, route = nearest_region(), jnp.full(belief.driven.shape, -1, jnp.int8)
    beams, select = beliefs.table(STAR, belief), jax.jit(policy.select)
    for least_m, known, want in (
        (3.0, belief, LEFT),
        (3.1, belief, CENTROID),
        (10.0, belief, CENTROID),
        (10.1, belief, LEFT),  # no region is that large
        (10.0, spent, MEMBER),
    ):
        params = policy.params._replace(least_m=least_m)
        _, choice, _ = select(jax.random.key(0), params, (), known, beams, route)
        assert ((int(choice.row), int(choice.col)), bool(choice.is_view)) == (want, want == CENTROID)


def regions(frontier, cost, exhausted):
    """Goals: `(row, col, is_centroid, cells)` of each region, in the order of the lowest cells."""
    label, found = plans.clusters(frontier), []
    for i in range(label.max() + 1):
        cells = np.argwhere(label == i)
        mean = cells.sum(axis=0) / len(cells)
        at = tuple(np.floor(mean + 0.5).astype(int))
        is_centroid = cost[at] < FAR and not frontier[at] and not exhausted[at]
        if not is_centroid:
            at = tuple(cells[((cells - mean) ** 2).sum(axis=1).round(9).argmin()])
        found.append((*map(int, at), bool(is_centroid), len(cells)))
    return found


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_goals_are_those_of_the_oracle(seed):
    belief = beliefs.after_scans(seed, (30, 34), range_cells=6)
    reached = jax.jit(field)(belief)
    want = regions(*map(np.asarray, (reached.frontier, reached.cost, belief.exhausted)))
    *found, overflow = jax.jit(goals)(belief, reached)
    assert [tuple(one) for one in zip(*(a[: len(want)].tolist() for a in found))] == want
    assert {one[2] for one in want} == {True, False}
    assert int(found[3].sum()) == reached.frontier.sum()
    assert int(overflow) == 0


class Yamauchi(simulator.Robot):
    """The robot of the oracle, on its way to regions of at least 0.6 m."""

    is_view, views = False, 0

    def chosen(self, choose, targets, cost):
        found = regions(targets, cost, self.exhausted)
        large = [one for one in found if 0.2 * one[3] >= 0.6] or found
        *target, self.is_view, _ = min(large, key=lambda one: cost[one[:2]])
        Yamauchi.views += self.is_view
        return tuple(target)

    def live(self, target):
        """Return whether a look all round from a centroid would show an unknown cell."""
        if not self.is_view:
            return super().live(target)
        return oracle.look(self.result.hits, self.result.misses, *target, FEW.n_beams, FEW.fov_deg, 10)[1] > 0


FEW = Lidar(n_beams=31, range_m=2.0)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_whole_episodes_of_regions_are_the_oracles(seed, monkeypatch):
    occupied, rooms = maps.cluttered(seed, 34, 44)
    start, rules = (*clear_cells(occupied, 2)[seed], 90), Rules()
    monkeypatch.setattr(simulator, "Robot", Yamauchi)
    monkeypatch.setattr(Yamauchi, "views", 0)
    for strategy in ("nearest-region", "nearest-region+recheck"):
        *_, want = compared(occupied, start, strategy, FEW, rules, cell_m=0.2, rooms=rooms)
        assert want.steps > 100
    assert Yamauchi.views > 10


# A frontier 5 m to the right down the middle of a lane, another 4 m to the left in a bay one cell wide.
LANES = """
    #############
    #####......##
    ?...R.....?##
    #####......##
    #############
"""
BAY, LANE = (2, 1), (2, 9)


def test_safe_way_is_taken_before_a_short_one():
    """To the left 3 m and two cells of danger 1, to the right 5 m and one of (2 - sqrt 2)^2: the same at 1.21."""
    belief = beliefs.belief_of(LANES, cell_m=1.0)
    for text, want in {"weight=0": BAY, "weight=1.2,safe_m=2": BAY, "weight=1.22,safe_m=2": LANE}.items():
        assert beliefs.target_of(f"exploration-transform:{text}", belief, beliefs.LIDAR) == want


def dijkstra(traversable, frontier, danger):
    """The transform, cell by cell."""
    value = np.where(frontier & traversable, 0, FAR)
    queue = [(0, *at) for at in map(tuple, np.argwhere(value == 0))]
    while queue:
        cost, row, col = heapq.heappop(queue)
        for drow, dcol in MOTIONS:
            r, c = row + drow, col + dcol
            inside = 0 <= r < value.shape[0] and 0 <= c < value.shape[1]
            if inside and traversable[r, c] and traversable[row, c] and traversable[r, col]:
                new = cost + STEPS[bool(drow and dcol)] + danger[r, c]
                if cost <= value[row, col] and new < value[r, c]:
                    value[r, c] = new
                    heapq.heappush(queue, (new, r, c))
    return value


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_transform_and_its_descent(seed):
    belief = beliefs.but_for_spots(seed, (21, 40))
    reached = field(belief)
    params = Params(jnp.float32(90.0), jnp.float32(0.35))
    value = np.asarray(jax.jit(transform)(params, belief, reached))
    occupied = np.argwhere(np.asarray(belief.grid.hits) > 0)
    cells = np.moveaxis(np.indices(value.shape), 0, -1)[:, :, None]
    off_m = 0.1 * np.sqrt(((cells - occupied) ** 2).sum(axis=-1)).min(axis=-1)
    danger = np.rint(90.0 * np.maximum(0.35 - off_m, 0) ** 2 * STEPS[0]).astype(int)
    want = dijkstra(np.asarray(reached.traversable), np.asarray(reached.frontier), danger)
    np.testing.assert_allclose(value, want, rtol=1e-4)  # danger is rounded from float32

    row, col, motions = jax.jit(descent)(value, reached.traversable, belief.row, belief.col)
    assert reached.frontier[row, col]
    at = int(belief.row), int(belief.col)
    while at != (int(row), int(col)):
        drow, dcol = MOTIONS[motions[at]]
        after = value[at[0] + drow, at[1] + dcol] + STEPS[bool(drow and dcol)]
        assert abs(value[at] - after - danger[at]) <= 1
        at = (at[0] + drow, at[1] + dcol)


CROSS = Lidar(n_beams=4, fov_deg=360, range_m=2.0)  # in cells of one metre: two cells back, right, ahead, left
CORRIDOR = """
    ##############
    #?.R......???#
    ##############
"""


def test_the_first_edge_of_the_best_branch_is_driven_and_the_rest_kept():
    """The left end shows 1 cell after 1 m; on the right 1 and 2 are seen after 5 and 6 m.

    They are worth the same where x = x^5 + 2 x^6 for x = exp(-lam), at lam = 0.237.
    """
    belief = beliefs.belief_of(CORRIDOR, cell_m=1.0)
    beams = beliefs.table(CROSS, belief)
    cases = (("lam=0.23", 1, 4, [5, 6, 7, 8, 9]), ("lam=0.24", 1, 2, []), ("lam=0.24", 2, 4, [5, 6, 7, 8, 9]))
    for text, least, want, rest in cases:
        policy = parse_strategy(f"random-tree:{text},min_gain={least}").policy
        params, select = policy.params, jax.jit(policy.select)
        route = jnp.full(belief.driven.shape, -1, jnp.int8)
        carry, choice, _ = select(jax.random.key(1), params, random_tree.init(params, belief), belief, beams, route)
        assert (int(choice.row), int(choice.col), bool(choice.is_view)) == (1, want, True)
        assert carry[1, : len(rest)].tolist() == rest
        assert (carry[:, len(rest) :] == -1).all()
    carry, choice, _ = select(jax.random.key(1), params._replace(min_gain=3), carry, belief, beams, route)
    assert (int(choice.row), int(choice.col), bool(choice.is_view)) == (1, 2, False)
    assert (carry == -1).all()


def grown(params, belief, traversable, n_beams, range_cells, cell_m, points):
    """Nodes of a tree `(row, col, parent, length_m, gain)`, by the rules."""
    hits, misses = (np.asarray(a) for a in (belief.grid.hits, belief.grid.misses))
    nodes = [(int(belief.row), int(belief.col), 0, 0.0, 0.0)]
    for row, col in points:
        if len(nodes) > params.nodes and max(node[4] for node in nodes) > 0:
            break
        near = min(range(len(nodes)), key=lambda i: (row - nodes[i][0]) ** 2 + (col - nodes[i][1]) ** 2)
        at = np.array(nodes[near][:2])
        off = np.array([row, col]) - at
        step = np.round(off * min(1, params.edge_m / cell_m / max(math.hypot(*off), 1))).astype(int)
        n = abs(step).max()
        edge = [tuple(at + (2 * i * step + n) // (2 * n)) for i in range(n + 1)] if n else []
        corners = [((a[0], b[1]), (b[0], a[1])) for a, b in itertools.pairwise(edge)]
        cells = {*edge, *itertools.chain(*corners)}
        if n and row >= 0 and all(traversable[cell] for cell in cells):
            seen = oracle.look(hits, misses, *edge[-1], n_beams, 360, range_cells)[1]
            length = nodes[near][3] + math.hypot(*step) * cell_m
            gain = seen * math.exp(-params.lam * length) if seen >= params.min_gain else 0.0
            nodes.append((*map(int, edge[-1]), near, length, nodes[near][4] + gain))
    return nodes


@pytest.mark.parametrize("seed", [0, 1])
def test_a_tree_is_that_of_the_oracle(seed):
    belief = beliefs.after_scans(seed, (30, 34), range_cells=6)
    beams = beliefs.table(Lidar(n_beams=12, fov_deg=360, range_m=0.5), belief)
    reached = field(belief)
    draw = np.random.default_rng(seed)
    cells = np.argwhere(np.asarray(reached.cost) < FAR)
    points = np.concatenate([[[-1, -1]], cells[draw.integers(len(cells), size=60)]])
    params = random_tree.Params(nodes=20, lam=1.5, edge_m=0.5, min_gain=3)
    rows, cols = jnp.asarray(points.T, jnp.int32)
    tree = jax.jit(random_tree.grown)(params, belief, reached, beams, rows, cols)
    want = grown(params, belief, np.asarray(reached.traversable), 12, 5, 0.1, points)
    n = len(want)
    assert int(tree.n) == n > 10
    for found, expected in zip(tree[1:], zip(*want)):
        np.testing.assert_allclose(found[:n], expected, rtol=1e-5)
    first, rest = random_tree.best_branch(tree)
    branch = [max(range(n), key=lambda i: want[i][4])]
    while want[branch[0]][2]:
        branch.insert(0, want[branch[0]][2])
    assert [int(first), *rest[rest >= 0].tolist()] == branch
