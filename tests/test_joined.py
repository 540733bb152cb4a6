"""Strategies that share a program: each is what it is alone."""

import jax
import numpy as np
import pytest
from ref.jobs import LIDAR, RULES, some_jobs

from jexplore.exploration.batch import run_jobs
from jexplore.policies import parse_strategy, strategy
from jexplore.policies.catalogue.joined import join_strategies

NAMES = ("closest+recheck", "random", "decision-theoretic+recheck:samples=20", "decision-theoretic:samples=40,lam=1")


def nearest(view):
    return -view.cost


def test_strategies_with_the_same_functions_are_one():
    given = [parse_strategy(name) for name in ("random", "closest", "closest+recheck", "gain-rate")]
    first, second, third, fourth = join_strategies(given)
    assert [one.name for one in (first, second, third, fourth)] == [one.name for one in given]
    assert [one.recheck for one in (first, second, third, fourth)] == [False, False, True, False]
    assert second.policy == third.policy
    assert len({one.policy._replace(params=()) for one in (first, second, fourth)}) == 1
    assert {one.policy.params.which for one in (first, second, fourth)} == {0, 1, 2}
    # In any order, and made anew, it is the same program.
    again = join_strategies([parse_strategy(one.name) for one in given[::-1]])
    assert again[0].policy == fourth.policy
    assert again[3].policy == first.policy


def test_parameters_stay_ones_own():
    given = [parse_strategy(name) for name in NAMES]
    for one, whole in zip(given, join_strategies(given)):
        params = whole.policy.params
        assert params.each[params.which] == one.policy.params


def test_a_lone_one_and_a_users_stay_as_they_are():
    lone = [parse_strategy("closest"), parse_strategy("closest+recheck")]
    assert join_strategies(lone) == lone
    own = strategy(nearest, segment=True)
    mixed = join_strategies([parse_strategy("closest"), own, parse_strategy("random")])
    assert mixed[1] is own
    assert mixed[0].policy.params.which != mixed[2].policy.params.which


@pytest.mark.slow
@pytest.mark.jit
def test_together_and_alone_they_do_the_same():
    jobs = [job._replace(starts=job.starts[:2]) for job in some_jobs(NAMES)[: len(NAMES)]]
    together, lanes = (
        run_jobs(jobs, LIDAR, RULES, engine="jax", in_lanes=in_lanes).outcomes for in_lanes in (False, True)
    )
    for job, found, other in zip(jobs, together, lanes):
        (alone,) = run_jobs([job], LIDAR, RULES, engine="jax").outcomes
        for one in (alone, other):
            jax.tree.map(np.testing.assert_array_equal, found.result, one.result)
            assert found.first.plans == one.first.plans
    assert len({np.stack([found.result.plans, found.result.turns]).tobytes() for found in together}) == len(NAMES)
