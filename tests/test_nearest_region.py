"""Nearest region: by hand on a small map, and region by region compared with plain numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs, plans
from ref.beliefs import belief_of

from jexplore.planning import field
from jexplore.policies.peers.nearest_region import goals, nearest_region
from jexplore.reach import FAR
from jexplore.rules import Lidar

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


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_goals_are_those_of_the_oracle(seed):
    belief = beliefs.after_scans(seed, (30, 34), range_cells=6)
    reached = jax.jit(field)(belief)
    cost, frontier = np.asarray(reached.cost), np.asarray(reached.frontier)
    label, want = plans.clusters(frontier), []
    for i in range(label.max() + 1):
        cells = np.argwhere(label == i)
        mean = cells.sum(axis=0) / len(cells)
        at = tuple(np.floor(mean + 0.5).astype(int))
        is_centroid = cost[at] < FAR and not frontier[at]
        if not is_centroid:
            at = tuple(cells[((cells - mean) ** 2).sum(axis=1).round(9).argmin()])
        want.append((*map(int, at), is_centroid, len(cells)))
    *found, overflow = jax.jit(goals)(belief, reached)
    assert [tuple(one) for one in zip(*(a[: len(want)].tolist() for a in found))] == want
    assert {one[2] for one in want} == {True, False}
    assert int(found[3].sum()) == frontier.sum()
    assert int(overflow) == 0
