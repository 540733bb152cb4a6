"""Episodes that the tests of engines run."""

import hashlib

import jax
import numpy as np

from jexplore.exploration.batch import Job
from jexplore.policies import parse_strategy
from jexplore.rules import Lidar, Rules
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World

from . import maps

RULES = Rules(max_plans=12)
LIDAR = Lidar(n_beams=37, range_m=2.0, sigma_m=0.03, dropout=0.02)


def some_jobs(strategies=("closest", "closest+recheck")):
    """Two worlds of one padded size, five starts each, a noisy scanner."""
    jobs = []
    for seed, shape in ((1, (40, 44)), (2, (50, 36))):
        occupied, rooms = maps.cluttered(seed, *shape)
        world = World(occupied=occupied, rooms=rooms, name=f"cluttered {seed}")
        starts = draw_starts(world, 5, 5, RULES.clearance_m)
        jobs += [Job(world, parse_strategy(name), starts, seed=7) for name in strategies]
    return jobs


def assert_equal(got, want):
    """Results, first maps and plans of outcomes, bit by bit."""
    for ours, theirs in zip(got, want, strict=True):
        jax.tree.map(np.testing.assert_array_equal, ours.result, theirs.result)
        for a, b in zip(ours.first._replace(plans=None), theirs.first._replace(plans=None), strict=True):
            np.testing.assert_array_equal(a, b)
        assert ours.first.plans == theirs.first.plans


def digest(report):
    """A number that differs if any bit of any result, last map or way does."""
    arrays = [a for o in report.outcomes for a in (*jax.tree.leaves(o.result), *o.first) if isinstance(a, np.ndarray)]
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()
