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
from gymnasium.vector import AutoresetMode, SyncVectorEnv  # noqa: E402
from gymnasium.wrappers.vector import RecordEpisodeStatistics  # noqa: E402
from ref.refusals import refused  # noqa: E402

from jexplore.studies.gym import ID  # noqa: E402
from jexplore.studies.gym.envs import GymEnv, GymVectorEnv  # noqa: E402

LIDAR = Lidar(n_beams=37, range_m=1.0, sigma_m=0.03, dropout=0.02)
pytestmark = pytest.mark.jit


@pytest.fixture(scope="module")
def env(jit_on):
    with jit_on():
        return GymEnv(two_rooms(), lidar=LIDAR)


@pytest.fixture(scope="module")
def envs(jit_on):
    with jit_on():
        return GymVectorEnv([two_rooms(), two_rooms("low", rows=20)], 4, lidar=LIDAR)


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
def test_many_in_step_are_what_gymnasium_makes_of_single_ones(envs):
    """The observations, rewards, ends and infos of `SyncVectorEnv`, over several episodes a lane."""
    worlds = [two_rooms(), two_rooms("low", rows=20)]
    theirs = SyncVectorEnv([lambda: GymEnv(worlds, lidar=LIDAR)] * 4, autoreset_mode=AutoresetMode.NEXT_STEP)
    assert theirs.observation_space == envs.observation_space
    assert theirs.action_space == envs.action_space
    (seen, info), (other, other_info) = envs.reset(seed=7), theirs.reset(seed=7)
    same(seen, other)
    same(info, other_info)
    ends = np.zeros(4, int)
    for step in range(60):
        actions = nearest(seen)
        if step % 5 == 2:
            actions[step % 4] = 0  # a wall
        (seen, *rest), (other, *other_rest) = envs.step(actions), theirs.step(actions)
        same(seen, other)
        for one, another in zip(rest[:3], other_rest[:3]):
            np.testing.assert_allclose(one, another)
        same(rest[3], other_rest[3])
        ends += rest[1]
    assert ends.min() >= 2
    theirs.close()


@pytest.mark.slow
def test_made_by_name_and_wrapped():
    made = gymnasium.make_vec(ID, num_envs=2, worlds=two_rooms(), lidar=LIDAR)
    assert isinstance(made.unwrapped, GymVectorEnv)
    made = RecordEpisodeStatistics(made)
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


def test_an_observation_is_what_the_robot_believes(envs):
    seen, info = envs.reset(seed=5)
    for _ in range(3):
        seen, _, _, _, info = envs.step(nearest(seen))
    for i in range(4):
        belief = envs.states.episode.belief
        world = envs.environment.worlds[int(envs.states.world[i])]
        rows, cols = world.shape
        grid = belief.grid
        expected = np.full(envs.environment.shape, 2)
        expected[:rows, :cols] = map_state(np.asarray(grid.hits[i]), np.asarray(grid.misses[i]), 0.25)[:rows, :cols]
        np.testing.assert_array_equal(seen["map"][i], expected)
        cost = np.asarray(envs.states.reached.cost[i])
        np.testing.assert_allclose(
            seen["path_m"][i], np.where(cost < FAR, cost.astype(np.float64) / STRAIGHT * 0.1, -1), rtol=1e-6
        )
        assert seen["robot"][i].tolist() == [int(belief.row[i]), int(belief.col[i]), int(belief.heading[i])]
        assert seen["path_m"][i][tuple(seen["robot"][i][:2])] == 0
        np.testing.assert_array_equal(info["action_mask"][i], seen["frontier"][i].ravel())
        assert info["known_m2"][i] == pytest.approx(((expected > 0)[:rows, :cols]).sum() * 0.01)


CLOSET = {
    "worlds": with_ring(occupancy_to_world(np.zeros((3, 4), bool), name="closet")),
    "lidar": Lidar(n_beams=721, fov_deg=360, range_m=2),
    "rules": Rules(clearance_m=0.1),  # a corner of the closet is no place to look from
}


@pytest.mark.slow
def test_in_lanes_every_other_step_begins_anew_where_all_is_seen_from_the_start():
    many = GymVectorEnv(**CLOSET)
    many.reset(options={"start": [(2, 2, 90)]})
    assert [bool(many.step([0])[2][0]) for _ in range(4)] == [True, False, True, False]


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


# --- seeds and options


def test_seeds(env, envs):
    first, _ = env.reset(seed=11)
    second, _ = env.reset()
    same(env.reset(seed=11)[0], first)
    same(env.reset()[0], second)
    same(env.reset(seed=11, options={"episode": 1})[0], second)
    same(env.reset(options={"episode": 0})[0], first)
    assert not np.array_equal(first["robot"], second["robot"])
    lanes, _ = envs.reset(seed=11)
    again, _ = envs.reset(seed=[11, 12, 13, 14])
    same(lanes, again)
    assert len({tuple(robot) for robot in lanes["robot"].tolist()}) == 4
    unseeded = [GymEnv(two_rooms(), lidar=LIDAR).reset()[0]["robot"].tolist() for _ in range(3)]
    assert len(set(map(tuple, unseeded))) > 1


# --- wrong input


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"targets": "all"}, "targets must be frontier or reachable, got 'all'"),
        ({"max_decisions": 0}, "max_decisions must be an integer from 1"),
        ({"num_envs": 0}, "num_envs must be an integer from 1"),
    ],
)
def test_bad_settings_are_refused(settings, said):
    for make in (GymEnv, GymVectorEnv)["num_envs" in settings :]:
        refused(said, make, worlds=two_rooms(), lidar=LIDAR, **settings)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seed": -1}, "seed must be an integer from 0 to 4294967295, got -1"),
        ({"seed": 0.5}, "seed must be"),
        ({"options": {"strat": [(1, 1, 0)] * 4}}, "unknown option 'strat'; did you mean 'start'"),
        ({"options": {"start": [(0, 0, 0)] * 4}}, "several worlds|lies in a wall"),
        ({"options": {"start": [(0, 0, 0)] * 4, "world": [0] * 4}}, "lies in a wall"),
        ({"options": {"start": [(5, 5), 3] * 2, "world": [0] * 4}}, r"option start must be integers \[\d, 3\]"),
        ({"options": {"world": [2] * 4}}, r"option world must be integers \[\d\] from 0 to \d, got 2"),
        ({"options": {"episode": [-1] * 4}}, "option episode must be integers .* got -1"),
    ],
)
def test_bad_resets_are_refused_and_change_nothing(env, envs, given, said):
    alone = {name: {k: v[0] for k, v in value.items()} if name == "options" else value for name, value in given.items()}
    for one, own in ((env, alone), (envs, given)):
        one.reset(seed=5)
        refused(said, one.reset, **own)
        seen, _ = one.reset()
        one.reset(seed=5)
        same(one.reset()[0], seen)


def test_bad_seeds_for_lanes_are_refused(envs):
    refused("seed must be one, or one for each of 4 lanes, got 3", envs.reset, seed=[1, 2, 3])
    refused("seed must be an integer", envs.reset, seed=[1, 2, 3, "x"])


@pytest.mark.parametrize(
    ("action", "said"),
    [
        (64 * 64, "must be .* from 0 to 4095, got 4096"),
        (-1, "must be .* from 0 to 4095, got -1"),
        (0.5, r"must be .* got (0.5|\[4\] float64)"),
        ([1, 2, 3], r"must be .* got (\[4, 3\]|\[3\]) int64"),
    ],
)
def test_bad_actions_are_refused(env, envs, action, said):
    env.reset(seed=0)
    refused("action " + said, env.step, action)
    envs.reset(seed=0)
    refused("actions " + said, envs.step, [action] * 4)
    refused(r"actions must be integers \[4\]", envs.step, 3)


def test_a_step_before_a_reset_is_refused():
    refused("there is no episode yet; call reset first", GymEnv(two_rooms(), lidar=LIDAR).step, 0)
    refused("there are no episodes yet; call reset first", GymVectorEnv(two_rooms(), 2, lidar=LIDAR).step, [0, 0])


def test_without_the_package_it_says_what_to_install(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("jexplore.studies.gym")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ImportError, match=r"need gymnasium 1.1 or later: pip install 'jexplore\[gym\]'"):
        importlib.import_module("jexplore.studies.gym.envs")


@pytest.mark.slow
def test_closest_in_lanes_is_closest_to_the_bit(envs):
    table = jx.compare(two_rooms(), "closest", episodes=4, seed=2, lidar=LIDAR).episodes
    starts = table[["start_row", "start_col", "start_heading_deg"]].to_numpy(np.int32)
    seen, info = envs.reset(seed=[2] * 4, options={"start": starts, "world": [0] * 4, "episode": range(4)})
    ended = np.zeros(4, int)
    for step in range(1, 60):
        seen, _, terminated, truncated, info = envs.step(nearest(seen))
        for i in np.flatnonzero(terminated & (ended == 0)):
            ended[i] = step
            assert info["path_m"][i] == pytest.approx(table["path_m"].iloc[i], abs=1e-12)
            assert jx.Outcome(info["outcome"][i]).name == table["outcome"].iloc[i]
        assert not truncated.any()
    assert (ended + 1).tolist() == table["plans"].tolist()


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
