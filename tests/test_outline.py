"""Solid rock round a world changes no episode: no strategy knows where the building ends."""

import dataclasses

import jax
import numpy as np
import pytest
from ref import maps

from jexplore.exploration.batch import Job, run_jobs
from jexplore.policies import STRATEGIES, parse_strategy
from jexplore.policies.catalogue.joined import join_strategies
from jexplore.rules import Lidar, Rules
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World

pytestmark = pytest.mark.jit

OCCUPIED, ROOMS = maps.cluttered(3, 33, 41)
LIDAR = Lidar(n_beams=37, range_m=1.5)
MODIFIED = ("closest+recheck+segment", "small-first+recheck+segment=rooms", "decision-theoretic+segment=voronoi")
OURS = [name for name, entry in STRATEGIES.items() if not entry.is_own]
PLAIN = tuple(f"{name}{recheck}" for name in OURS for recheck in ("", "+recheck"))


def explored(rock, names, lidar, rules, engine, n=2):
    """Results of n episodes of each strategy with this much rock round the building, cells, and their records."""
    world = World(np.pad(OCCUPIED, rock, constant_values=True), np.pad(ROOMS, rock, constant_values=-1))
    starts = draw_starts(World(OCCUPIED), 5, n, rules.clearance_m) + np.array([rock, rock, 0])
    strategies = join_strategies([parse_strategy(name) for name in names])
    jobs = [Job(world, strategy, starts, seed=4) for strategy in strategies]
    return run_jobs(jobs, lidar, rules, engine=engine, workers=1, keep="paths").outcomes


def check(names, lidar, rules, engine, thicknesses, n=2):
    found = explored(0, names, lidar, rules, engine, n)
    for rock in thicknesses:
        for name, want, got in zip(names, found, explored(rock, names, lidar, rules, engine, n)):
            for one, other in zip(jax.tree.leaves(got.result), jax.tree.leaves(want.result), strict=True):
                np.testing.assert_array_equal(one, other, f"{name} in {rock} cells of rock")
            for episode, record in want.records.items():
                np.testing.assert_array_equal(got.records[episode].path - [rock, rock, 0], record.path)
            for plan, other in zip(got.first.plans, want.first.plans, strict=True):
                assert plan.target == (other.target and tuple(at + rock for at in other.target))
    assert min(int(outcomes.result.plans.min()) for outcomes in found) >= 3


def test_rock_round_a_world_changes_no_episode():
    """Of 1 cell the blocks lie otherwise in the map, of 20 the padded map is larger."""
    names = ("small-first+recheck",)
    check(names, LIDAR, Rules(clearance_m=0.2), "auto", (1, 20))


@pytest.mark.slow
def test_rock_changes_no_episode_of_any_strategy():
    """All thicknesses have the padded size of the bare world, and share its program. Rooms are always of JAX."""
    own = {"n_beams": 8, "fov_deg": 360.0, "no_echo": "unknown", "forward_m": 0.12, "min_range_m": 0.15}
    lidar = dataclasses.replace(LIDAR, **own)
    check((*PLAIN, *MODIFIED), lidar, Rules(clearance_m=0.0), "auto", (1, 2, 3), n=1)


def test_a_known_outline_is_of_use():
    """The same rock then shortens what a strategy expects to see: its episodes are others."""
    names, rules = ("small-first+recheck",), Rules(clearance_m=0.2, known_outline=True)
    known, unknown = (explored(0, names, LIDAR, r, "auto")[0] for r in (rules, rules.replace(known_outline=False)))
    assert [r.path.tolist() for r in known.records.values()] != [r.path.tolist() for r in unknown.records.values()]
