"""Exploration step by step: the rules of an episode, whoever chooses; under jit, vmap and scan."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import maps
from ref.refusals import refused
from ref.worlds import two_rooms

import jexplore as jx
from jexplore.exploration.motion import LENGTHS
from jexplore.exploration.state import Outcome
from jexplore.rules import Lidar, Rules
from jexplore.studies import environment
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World

LIDAR = Lidar(n_beams=37, range_m=1.0, sigma_m=0.03, dropout=0.02)
SEED = 2
pytestmark = pytest.mark.jit


@jax.jit
def nearest(view):
    cost = jnp.where(view.frontier, view.cost, jnp.iinfo(jnp.int32).max)
    return jnp.stack(jnp.unravel_index(jnp.argmin(cost), cost.shape))


def keys(n):
    """The episodes' own keys."""
    return jax.vmap(lambda i: jax.random.fold_in(jax.random.key(SEED), i))(jnp.arange(n))


def starts_of(comparison):
    return jnp.asarray(comparison.episodes[["start_row", "start_col", "start_heading_deg"]].to_numpy(np.int32))


@pytest.mark.slow
def test_a_team_that_goes_to_the_nearest_frontier_is_closest():
    """Two robots that differ and do not meet: ways and known area of `compare`; one that gets no target waits."""
    world, starts = two_rooms(), [(5, 5, 0), (9, 12, 90)]
    given = {"lidar": LIDAR, "rules": Rules(clearance_m=0.0), "members": ["pace=1", "pace=2,range=0.7"]}
    found = jx.compare(world, "closest", episodes=1, seed=SEED, robots=2, team_starts=starts, **given).episodes.iloc[0]
    env = jx.Environment(world, robots=2, **given)
    state, view = env.reset(keys(1)[0], jnp.array(starts))
    done, path_m = False, 0.0
    while not done:
        state, view, reward, done, info = env.step(keys(1)[0], state, jax.vmap(nearest)(view))
        path_m -= float(reward)
    assert path_m == pytest.approx(found["path_sum_m"], rel=1e-5)
    assert float(info["path_m"]) == pytest.approx(found["path_sum_m"], rel=1e-5)
    assert int(state.episode.robots.plans.sum()) == found["plans"]
    state, _ = env.reset(keys(1)[0], jnp.array(starts))
    after, _, _, done, info = env.step(keys(1)[0], state, jnp.array([[-1, -1], [0, 0]]))
    assert not done
    assert not info["valid"].any()
    assert after.episode.waits.tolist() == [1, 1]
    assert after.episode.clock.tolist() == [LENGTHS[0], 2 * LENGTHS[0]]
    state, _ = env.reset(keys(1)[0], jnp.array(starts[:1] * 2))
    _, _, _, done, info = env.step(keys(1)[0], state, jnp.zeros((2, 2), jnp.int32))
    assert done
    assert int(info["outcome"]) == Outcome.BAD_START
    refused("of one robot", jx.Environment, world, robots=2, paths=True)
    for n, text in ((1, "2 or more robots, got 2 for 1"), (3, "got 2 for 3")):
        refused(text, jx.Environment, world, robots=n, **given)


def test_the_nearest_frontier_at_every_step_is_closest_to_the_bit():
    """Under `vmap` over episodes and `scan` over decisions, the scanner's noise included."""
    found = jx.compare(two_rooms(), "closest+recheck", episodes=5, seed=SEED, lidar=LIDAR, keep="maps")
    env, table = jx.Environment(two_rooms(), lidar=LIDAR, recheck=True, paths=True), found.episodes
    over = int(table["plans"].max()) + 3  # steps beyond the end change nothing

    def decide(carry, _):
        state, view = carry
        state, view, *rest = jax.vmap(env.step)(keys(5), state, jax.vmap(nearest)(view))
        return (state, view), rest

    (state, view), (reward, done, info) = jax.lax.scan(
        decide, jax.vmap(env.reset)(keys(5), starts_of(found)), length=over
    )
    (paths,), (last,) = found.paths.values(), found.maps.values()
    for i in range(5):
        own = jax.tree.map(lambda a, i=i: a[i], state)
        np.testing.assert_array_equal(env.path(own), paths[i][:, :2])
        known = (own.episode.belief.grid.hits + own.episode.belief.grid.misses) > 0
        np.testing.assert_array_equal(known[: last.shape[1], : last.shape[2]], last[i] > 0)
    episode = state.episode
    for name in ("plans", "scans", "exhausted", "refused", "saturated"):
        assert getattr(episode, name).tolist() == table[name].tolist()
    np.testing.assert_allclose(episode.turns * np.pi / 4, table["turning_rad"], rtol=1e-6)
    assert [jx.Outcome(int(code)).name for code in info["outcome"][-1]] == table["outcome"].tolist()
    np.testing.assert_allclose(-reward.sum(axis=0), table["path_m"], rtol=1e-5)
    np.testing.assert_allclose(info["path_m"][-1], table["path_m"], rtol=1e-5)
    # A decision is a plan, but for the last plan, which finds nothing: done comes with the step before.
    assert (np.argmax(done, axis=0) + 2).tolist() == table["plans"].tolist()
    assert (done == (np.cumsum(done, axis=0) > 0)).all()
    assert (reward[-1] == 0).all()
    assert not info["valid"][-1].any()
    assert not view.frontier.any()
    np.testing.assert_allclose(info["known_m2"][-1], [path[-1, 2] * 0.01 for path in paths], rtol=1e-5)


@pytest.fixture(scope="module")
def env(jit_on):
    with jit_on():
        return jx.Environment(two_rooms(), lidar=Lidar(n_beams=37, range_m=1.0), paths=True)


def same(one, other):
    jax.tree.map(np.testing.assert_array_equal, one, other)


def test_what_cannot_be_reached_moves_nothing(env):
    key = jax.random.key(3)
    state, view = env.reset(key)
    assert int(view.cost[0, 0]) == 2**30
    for action in ([0, 0], [-1, 5], [5, -1], [64, 5], [5, 10**6], [2**32 + 5, 5], np.array([2**40, -(2**40)])):
        new, seen, reward, done, info = env.step(key, state, action)
        same(new, state)
        same(seen, view)
        assert (float(reward), bool(done), bool(info["valid"])) == (0.0, False, False)


def test_any_cell_of_finite_cost_can_be_gone_to(env):
    key = jax.random.key(4)
    state, view = env.reset(key)
    free = np.argwhere((np.asarray(view.cost) < 2**30) & ~np.asarray(view.frontier))
    far = free[np.argmax(np.asarray(view.cost)[tuple(free.T)])]
    for recheck in (False, True):  # a target other than a frontier cell is not given up for that
        one = jx.Environment(two_rooms(), lidar=Lidar(n_beams=37, range_m=1.0), recheck=recheck, paths=True)
        new, _, reward, _, info = one.step(key, one.reset(key, view.belief.start * jnp.int32([1, 1, 45]))[0], far)
        assert bool(info["valid"])
        assert [int(new.episode.row), int(new.episode.col)] == far.tolist()
        assert float(-reward) == pytest.approx(float(view.path_m[tuple(far)]), rel=1e-5)
    state, _, reward, done, info = env.step(key, state, jnp.stack([state.episode.row, state.episode.col]))
    assert (float(reward), bool(done), bool(info["valid"])) == (0.0, False, True)  # where it stands already


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:cluttered. a robot of 0.3 m clearance reaches")
def test_a_bank_of_worlds():
    occupied, rooms = maps.cluttered(3, 40, 70)
    worlds = [two_rooms(), World(occupied=occupied, rooms=rooms, name="cluttered")]
    env = jx.Environment(worlds, lidar=LIDAR)
    assert env.shape == (64, 96)
    state, view = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 64))
    assert set(state.world.tolist()) == {0, 1}
    extent = np.asarray(view.belief.extent)
    assert {tuple(e) for e in extent.tolist()} == {world.shape for world in worlds}
    for i in range(8):
        row, col, _ = np.asarray(view.belief.start)[i]
        assert not worlds[int(state.world[i])].occupied[row, col]
    chosen, _ = jax.jit(env.reset)(jax.random.key(0), world=jnp.int32(1))
    assert int(chosen.world) == 1
    # In whatever bank it is, an episode in a world is that of the world alone.
    key, start = jax.random.fold_in(jax.random.key(SEED), 0), draw_starts(worlds[1], SEED, 1, Rules().clearance_m)[0]
    found = jx.compare(worlds[1], "closest", episodes=1, seed=SEED, lidar=LIDAR).episodes.iloc[0]
    state, view = env.reset(key, start, 1)
    for _ in range(int(found["plans"]) - 1):
        state, view, *_, done, info = env.step(key, state, nearest(view))
    assert bool(done)
    assert float(info["path_m"]) == pytest.approx(found["path_m"], rel=1e-5)


def test_ends(env):
    occupied = np.ones((24, 24), bool)
    occupied[5:8, 5:8], occupied[12:22, 12:22] = False, False
    lidar = Lidar(n_beams=37, range_m=1.0)
    closed = jx.Environment(World(occupied=occupied, name="closed"), lidar=lidar, paths=True)
    key = jax.random.key(0)
    for start, outcome in (
        *(([6, 6, 0], "STUCK"), ([17, 17, 90], "COMPLETE"), ([17, 17, -270], "COMPLETE"), ([-3, 500, 0], "BAD_START")),
        *(([17, 23, 0], "BAD_START"), ([17, 40, 0], "BAD_START"), ([17, 17, 30], "BAD_START")),
        *(([17, 17, 0, 1], "BAD_START"), ([17, 17, 0, -1], "BAD_START"), ([17, 17, 0, 0], "COMPLETE")),
    ):
        start, world = jnp.int32(start[:3]), jnp.int32(start[3] if len(start) > 3 else 0)
        state, view = jax.jit(closed.reset)(key, start, world)  # traced: not refused
        new, _, reward, done, info = closed.step(key, state, nearest(view))
        assert (bool(done), float(reward), jx.Outcome(int(info["outcome"])).name) == (True, 0.0, outcome)
        same(new, state)
    short = jx.Environment(two_rooms(), lidar=Lidar(n_beams=37, range_m=1.0), rules=Rules(max_plans=2), paths=True)
    state, view = short.reset(key)
    for n in range(2):
        state, view, _, done, info = short.step(key, state, nearest(view))
        assert bool(done) == (n == 1)
    assert int(info["outcome"]) == jx.Outcome.PLAN_LIMIT


def test_what_is_refused(env):
    key, world = jax.random.key(0), two_rooms()
    state, _ = env.reset(key)
    many, _ = jax.vmap(env.reset)(jax.random.split(key, 3))
    for call, says in (
        (lambda: env.step(key, state, [1.0, 2.0]), "action must be int32 [2], row, col, got [2] float32"),
        (lambda: env.step(key, state, [1, 2, 3]), "action must be int32 [2], row, col, got [3] int32"),
        (lambda: env.step(key, state, "up"), "action must be int32 [2], row, col, got 'up'"),
        (lambda: env.step(key, many, [1, 2]), "step takes one state, got 3 or more; use jax.vmap(env.step)"),
        (lambda: env.step(key, state.episode, [1, 2]), "state must be what reset or step returned, got State"),
        (lambda: env.step(0, state, [1, 2]), "key must be one jax.random.key(...), got int"),
        (lambda: env.reset(jax.random.split(key)), "key must be one jax.random.key(...), got [2] key<fry>"),
        (lambda: env.reset(key, [1, 2]), "start must be int32 [3], row, col, heading_deg, got [2] int32"),
        (lambda: env.reset(key, [0, 0, 0]), "lies in a wall"),
        (lambda: env.reset(key, [5, 5, 10]), "multiple of 45"),
        (lambda: env.reset(key, world=1), "world must be from 0 to 0, got 1"),
        (lambda: env.reset(key, world=0.5), "world must be int32 [], got [] float32"),
        (lambda: jx.Environment([]), "worlds must name at least one"),
        (lambda: jx.Environment([world, world.replace(name="b", cell_m=0.2)]), "cells of one size, got 0.1 and 0.2 m"),
        (lambda: jx.Environment(world, recheck=1), "recheck must be True or False"),
        (lambda: jx.Environment(world, rules=Rules(clearance_m=2)), "no cell has more than 2 m"),
        (lambda: jx.Environment(world).path(jx.Environment(world).reset(key)[0]), "keeps no paths: jx.Environment("),
        (lambda: jx.Environment(world).step(key, state, [5, 5]), "state must be one of this environment"),
        (lambda: env.path(many), "path takes one state, got 3 or more"),
        (lambda: jx.Environment(world, lidar=5), "lidar must be a jx.Lidar, such as jx.Lidar(n_beams=181), got 5"),
        (lambda: jx.Environment(world, rules={"p": 3}), "'p'"),
    ):
        refused(re.escape(says), call)


def test_64_bits_are_refused(env):
    key = jax.random.key(0)
    state, view = env.reset(key)
    calls = (lambda: jx.Environment(two_rooms()), lambda: env.reset(key), lambda: env.step(key, state, nearest(view)))
    with jax.enable_x64(True):
        for call in calls:
            refused("jexplore computes in 32 bits", call)


def test_environments_of_one_shape_share_their_programs(env):
    env.step(jax.random.key(0), env.reset(jax.random.key(0))[0], [5, 5])
    before = environment._step._cache_size(), environment._reset._cache_size()
    other = jx.Environment(two_rooms(door=5), lidar=Lidar(n_beams=37, range_m=1.0), recheck=True, paths=True)
    other.step(jax.random.key(0), other.reset(jax.random.key(0))[0], [5, 5])
    assert (environment._step._cache_size(), environment._reset._cache_size()) == before
    assert repr(env) == "<Environment of two rooms; 64 x 64 cells of 0.1 m>"
