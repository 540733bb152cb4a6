"""The random tree: by hand in a corridor, and node by node compared with plain numpy."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs
from ref import gain as oracle

from jexplore.planning import field
from jexplore.policies import parse_strategy
from jexplore.policies.peers import random_tree
from jexplore.reach import FAR
from jexplore.rules import Lidar

pytestmark = pytest.mark.jit

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
