"""Environments of gymnasium: its own checker, episodes as they are without it, and what ends, resets and is refused."""

import importlib
import sys

import numpy as np
import pytest
from ref.worlds import two_rooms

import jexplore as jx
from jexplore.exploration.results import map_state
from jexplore.reach import FAR, STRAIGHT
from jexplore.rules import Lidar, Rules
from jexplore.worlds.world import occupancy_to_world, with_ring

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed (the extra gym)")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.wrappers.vector import RecordEpisodeStatistics  # noqa: E402
from ref.refusals import refused  # noqa: E402

from jexplore.studies.gym import ID  # noqa: E402
from jexplore.studies.gym.envs import GymEnv  # noqa: E402

LIDAR = Lidar(n_beams=37, range_m=1.0, sigma_m=0.03, dropout=0.02)
SEED = 2
pytestmark = pytest.mark.jit


@pytest.fixture(scope="module")
def compared(jit_on):
    """`closest` in two rooms: episodes, and their starts."""
    with jit_on():
        table = jx.compare(two_rooms(), "closest", episodes=4, seed=SEED, lidar=LIDAR).episodes
        return table, table[["start_row", "start_col", "start_heading_deg"]].to_numpy(np.int32)


@pytest.fixture(scope="module")
def env(jit_on):
    with jit_on():
        return GymEnv(two_rooms(), lidar=LIDAR)


def nearest(seen):
    """Return the choice of `closest`, from an observation, or from many."""
    cost = np.where(seen["frontier"] > 0, seen["path_m"], np.inf)
    return np.argmin(cost.reshape(*cost.shape[:-2], -1), axis=-1)


def same(one, other):
    """Dicts of equal keys and arrays."""
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


# --- as gymnasium wants them


@pytest.mark.slow
def test_gymnasiums_checker_has_nothing_to_say():
    """It makes environments of its own by their name; any warning is an error here."""
    made = gymnasium.make(ID, worlds=two_rooms(), lidar=LIDAR)
    check_env(made.unwrapped)
    made.close()


@pytest.mark.slow
def test_made_by_name_and_wrapped():
    made = RecordEpisodeStatistics(gymnasium.make_vec(ID, num_envs=2, worlds=two_rooms(), lidar=LIDAR))
    seen, info = made.reset(seed=3)
    total = np.zeros(2)
    for _ in range(40):
        seen, reward, terminated, truncated, info = made.step(nearest(seen))
        total += reward
        if terminated[0]:
            break
    assert info["episode"]["r"][0] == pytest.approx(total[0])
    assert total[0] == pytest.approx(-info["path_m"][0])
    assert not truncated[0]


# --- as they are without it


@pytest.mark.slow
def test_closest_is_closest_to_the_bit(env, compared):
    table, starts = compared
    for i, row in enumerate(table.itertuples()):
        seen, _ = env.reset(seed=SEED, options={"start": starts[i], "world": 0, "episode": i})
        terminated, steps = False, 0
        while not terminated and steps < 60:
            seen, _, terminated, truncated, info = env.step(nearest(seen))
            assert not truncated
            steps += 1
        assert steps + 1 == row.plans
        assert info["path_m"] == pytest.approx(row.path_m, abs=1e-12)
        assert jx.Outcome(info["outcome"]).name == row.outcome


def test_an_observation_is_what_the_robot_believes(env):
    seen, info = env.reset(seed=5)
    for _ in range(3):
        seen, _, _, _, info = env.step(nearest(seen))
    belief, (rows, cols) = env.state.episode.belief, env.environment.worlds[0].shape
    expected = np.full(env.environment.shape, 2)
    expected[:rows, :cols] = map_state(np.asarray(belief.grid.hits), np.asarray(belief.grid.misses), 0.25)[:rows, :cols]
    np.testing.assert_array_equal(seen["map"], expected)
    cost = np.asarray(env.state.reached.cost)
    path_m = np.where(cost < FAR, cost.astype(np.float64) / STRAIGHT * 0.1, -1)
    np.testing.assert_allclose(seen["path_m"], path_m, rtol=1e-6)
    assert seen["robot"].tolist() == [int(belief.row), int(belief.col), int(belief.heading)]
    assert seen["path_m"][tuple(seen["robot"][:2])] == 0
    np.testing.assert_array_equal(info["action_mask"], seen["frontier"].ravel())
    assert info["known_m2"] == pytest.approx(((expected > 0)[:rows, :cols]).sum() * 0.01)


CLOSET = {
    "worlds": with_ring(occupancy_to_world(np.zeros((3, 4), bool), name="closet")),
    "lidar": Lidar(n_beams=721, fov_deg=360, range_m=2),
    "rules": Rules(clearance_m=0.1),  # a corner of the closet is no place to look from
}


@pytest.mark.slow
def test_by_pencil():
    """A closet that one look all round shows whole: over as it begins, which the first step says."""
    one = GymEnv(**CLOSET)
    seen, info = one.reset(options={"start": (2, 2, 90)})
    edge, room = [0, 2, 2, 2, 2, 0, 2], [2, 1, 1, 1, 1, 2, 2]  # the ring's corners are never seen
    assert seen["map"][:6, :7].tolist() == [edge, room, room, room, edge, [2] * 7]
    assert seen["robot"].tolist() == [2, 2, 2]
    np.testing.assert_allclose(
        seen["path_m"][:4, :4],
        [[-1] * 4, [-1, 0.1 * 2**0.5, 0.1, 0.1 * 2**0.5], [-1, 0.1, 0, 0.1], [-1, 0.1 * 2**0.5, 0.1, 0.1 * 2**0.5]],
        rtol=1e-4,
    )
    assert not seen["frontier"].any()
    assert not info["action_mask"].any()
    assert info["known_m2"] == pytest.approx(0.26)
    _, reward, terminated, truncated, info = one.step(0)
    assert (reward, terminated, truncated) == (0, True, False)
    assert info["outcome"] == jx.Outcome.COMPLETE


# --- ends


def test_what_is_got_can_be_written_to(env):
    seen, info = env.reset(seed=0)
    kept = {name: array.copy() for name, array in seen.items()}
    action = nearest(seen)
    for array in (*seen.values(), info["action_mask"]):
        array[:] = 0
    again, _, _, _, info = env.step(action)
    assert info["valid"]
    fresh, _ = env.reset(seed=0)
    same(fresh, kept)
    assert not np.array_equal(again["map"], fresh["map"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "outcome"),
    [
        ({"rules": Rules(max_plans=2)}, jx.Outcome.PLAN_LIMIT),
        ({"rules": Rules(max_steps=3)}, jx.Outcome.STEP_LIMIT),
        ({"max_decisions": 2}, jx.Outcome.RUNNING),
    ],
)
def test_limits_truncate(settings, outcome):
    one = GymEnv(two_rooms(), lidar=LIDAR, **settings)
    seen, _ = one.reset(seed=4)
    for _ in range(9):
        seen, _, terminated, truncated, info = one.step(nearest(seen))
        if truncated:
            break
    assert truncated
    assert not terminated
    assert info["outcome"] == outcome
    assert int(one.state.episode.plans) == 2 or outcome == jx.Outcome.STEP_LIMIT
    assert bool(info["action_mask"].any()) == (outcome == jx.Outcome.RUNNING)


def test_wrong_actions_move_nothing_and_count(env):
    seen, info = env.reset(seed=1)
    mask = info["action_mask"]
    for action in (0, int(np.flatnonzero(mask == 0)[-1]), int(seen["robot"][0] * 64 + seen["robot"][1])):
        after, reward, terminated, truncated, info = env.step(action)
        same(after, seen)
        assert (reward, terminated, truncated, info["valid"], info["path_m"]) == (0, False, False, False, 0)
    one = GymEnv(two_rooms(), lidar=LIDAR, max_decisions=3)
    one.reset(seed=1)
    assert [one.step(0)[3] for _ in range(3)] == [False, False, True]


@pytest.mark.slow
def test_any_cell_that_can_be_reached():
    one = GymEnv(two_rooms(), lidar=LIDAR, targets="reachable")
    seen, info = one.reset(seed=1)
    np.testing.assert_array_equal(info["action_mask"], (seen["path_m"] >= 0).ravel())
    far = int(np.argmax(np.where(seen["frontier"] > 0, -1, seen["path_m"])))
    after, reward, _, _, info = one.step(far)
    assert info["valid"]
    assert reward == pytest.approx(-seen["path_m"].ravel()[far])
    assert divmod(far, 64) == tuple(after["robot"][:2])


# --- seeds and options


def test_seeds(env):
    first, _ = env.reset(seed=11)
    second, _ = env.reset()
    same(env.reset(seed=11)[0], first)
    same(env.reset()[0], second)
    same(env.reset(seed=11, options={"episode": 1})[0], second)
    same(env.reset(options={"episode": 0})[0], first)
    assert not np.array_equal(first["robot"], second["robot"])
    unseeded = [GymEnv(two_rooms(), lidar=LIDAR).reset()[0]["robot"].tolist() for _ in range(3)]
    assert len(set(map(tuple, unseeded))) > 1


# --- wrong input


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"targets": "all"}, "targets must be frontier or reachable, got 'all'"),
        ({"max_decisions": 0}, "max_decisions must be an integer from 1"),
    ],
)
def test_bad_settings_are_refused(settings, said):
    refused(said, GymEnv, worlds=two_rooms(), lidar=LIDAR, **settings)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seed": -1}, "seed must be an integer from 0 to 4294967295, got -1"),
        ({"seed": 0.5}, "seed must be"),
        ({"options": {"strat": (1, 1, 0)}}, "unknown option 'strat'; did you mean 'start'"),
        ({"options": {"start": (0, 0, 0)}}, "lies in a wall"),
        ({"options": {"start": (5, 5)}}, r"option start must be integers \[3\]"),
        ({"options": {"world": 2}}, "option world must be an integer from 0 to 0, got 2"),
        ({"options": {"episode": -1}}, "option episode must be an integer .* got -1"),
        ({"options": [1]}, "options must be a mapping of start, world, episode"),
    ],
)
def test_bad_resets_are_refused_and_change_nothing(env, given, said):
    env.reset(seed=5)
    refused(said, env.reset, **given)
    seen, _ = env.reset()
    env.reset(seed=5)
    same(env.reset()[0], seen)


def test_a_start_takes_its_world_where_there_are_several():
    several = GymEnv([two_rooms(), two_rooms("low", rows=20)], lidar=LIDAR)
    refused("several worlds", several.reset, options={"start": (5, 5, 0)})


@pytest.mark.parametrize(
    ("action", "said"),
    [
        (64 * 64, "must be .* from 0 to 4095, got 4096"),
        (-1, "must be .* from 0 to 4095, got -1"),
        (0.5, "must be .* got 0.5"),
        ([1, 2, 3], r"must be .* got \[3\] int64"),
    ],
)
def test_bad_actions_are_refused(env, action, said):
    env.reset(seed=0)
    refused("action " + said, env.step, action)


def test_a_step_before_a_reset_is_refused():
    refused("there is no episode yet; call reset first", GymEnv(two_rooms(), lidar=LIDAR).step, 0)


def test_without_the_package_it_says_what_to_install(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("jexplore.studies.gym")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ImportError, match=r"needs gymnasium 1.1 or later: pip install 'jexplore\[gym\]'"):
        importlib.import_module("jexplore.studies.gym.envs")
