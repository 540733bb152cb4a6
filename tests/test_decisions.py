"""The environment of decisions and its form in brax: equal to strategies in a comparison."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.refusals import refused

from jexplore.config import InputError
from jexplore.exploration.state import Outcome
from jexplore.learn import bank, brax_env
from jexplore.learn.brax_env import Slots
from jexplore.learn.decisions import Decisions
from jexplore.policies import Strategy, parse_strategy
from jexplore.policies.learned import features, model, networks
from jexplore.policies.learned.strategy import policy_of
from jexplore.rules import Lidar, Rules
from jexplore.worlds.world import World

WORLDS = ["rooms#1000:width_m=6,height_m=6", "maze#1000:width_m=6,height_m=6"]
NEAR = Lidar(n_beams=61, range_m=1.5)
STARTS = 3
STEPS = 120


def some_model():
    """A `linear` model that is not `closest`."""
    weights = np.zeros(len(features.FEATURES), np.float32)
    for name, value in {"path": -1, "others": 0.4, "side within 4 m": -0.5, "last": 0.2}.items():
        weights[features.FEATURES.index(name)] = value
    return model.Model("linear", {"weights": weights})


@pytest.fixture(scope="module")
def own():
    return bank.prepare_bank(WORLDS, lidar=NEAR)


@functools.cache
def decisions_of(own):
    return Decisions(own, starts=STARTS, seed=4)


@pytest.fixture
def env(own):
    return decisions_of(own)  # made by the first test that needs it, compiled


def drive_on(env, learned, state, told, metres=0.0):
    """The rest of an episode by a model: `(state, sum of rewards, decisions)`."""

    def choose(carry):
        state, told, total, n = carry
        found = networks.scores(learned.network, learned.weights, told.features, told.used)
        state, told, reward, _, _ = env.step(state, jnp.argmax(found).astype(jnp.int32))
        return state, told, total + reward, n + 1

    carry = state, told, jnp.float32(metres), jnp.int32(0)
    state, _, total, n = jax.lax.while_loop(lambda carry: ~carry[0].is_over, choose, carry)
    return state, total, n


@pytest.mark.slow
@pytest.mark.jit
def test_a_policy_drives_as_its_strategy_does(own, env):
    learned = some_model()
    which = [i for i in range(len(WORLDS)) for _ in range(STARTS)]
    driven_m = own.values([Strategy("learned", policy_of(learned), True)], which, 4)[0]
    starts = np.concatenate([found for _, _, found in own.episodes(which, 4)])
    want = {(world, *start[:2]): path for world, start, path in zip(which, starts.tolist(), driven_m)}
    play = jax.jit(lambda key: drive_on(env, learned, *env.reset(key)))
    met = set()
    for i in range(12):
        state, total, n = play(jax.random.key(i))
        place = int(state.env.world), *np.asarray(state.env.episode.belief.start)[:2].tolist()
        np.testing.assert_allclose(state.driven_m, want[place], rtol=1e-5)
        np.testing.assert_allclose(total, -want[place] / state.reference_m, rtol=1e-4)
        assert n > 1
        met.add(place)
    assert len(met) > 3


@pytest.mark.slow
@pytest.mark.jit
def test_only_used_slots_can_be_chosen(env):
    """Slots drawn at random among the used ones are valid, all others move nothing; rewards are of the way driven."""

    def choose(carry, key):
        state, told = carry
        fresh, at_start = env.reset(key)
        state, told = jax.tree.map(lambda a, b: jnp.where(state.is_over, a, b), (fresh, at_start), (state, told))
        unused = jnp.argmin(told.used).astype(jnp.int32)
        _, _, nothing, _, refused = env.step(state, unused)
        slot = Slots(env.n_choices).sample(jnp.where(told.used, 0.0, networks.MASKED), key)
        new, told, reward, done, info = env.step(state, slot)
        is_open = jnp.any(told.used) != done
        return (new, told), (info["valid"], refused["valid"], nothing, reward, is_open)

    begun = jax.jit(env.reset)(jax.random.key(100))
    keys = jax.random.split(jax.random.key(0), 300)
    _, (valid, refused, nothing, reward, is_open) = jax.jit(lambda c, k: jax.lax.scan(choose, c, k))(begun, keys)
    assert np.all(valid)
    assert not np.any(refused)
    assert np.all(nothing == 0)
    assert np.all(reward <= 0)
    assert np.all(is_open)


def starts_of(states):
    """World and cell of every start that each lane was given."""
    starts, worlds = np.asarray(states.pipeline_state.env.episode.belief.start), states.pipeline_state.env.world
    every = np.concatenate([np.asarray(worlds)[..., None], starts[..., :2]], axis=-1)
    return [set(map(tuple, every[:, lane].tolist())) for lane in range(every.shape[1])]


@pytest.mark.slow
@pytest.mark.jit
def test_lanes_begin_anew_elsewhere(env):
    """Until its first end a lane is the environment itself; then it has other starts and another key."""
    lanes, keys = brax_env.Lanes(env), jax.random.split(jax.random.PRNGKey(1), 3)

    @jax.jit
    def played(keys):
        def step(state, _):
            state = lanes.step(state, jnp.zeros(len(keys), jnp.int32))
            return state, state

        return jax.lax.scan(step, lanes.reset(keys), None, length=STEPS)[1]

    @jax.jit
    def alone(key):
        def step(state, _):
            state, _, reward, done, _ = env.step(state, jnp.int32(0))
            return state, (reward, done)

        return jax.lax.scan(step, env.reset(jax.random.wrap_key_data(key))[0], None, length=STEPS)[1]

    states = played(keys)
    done = np.asarray(states.done) > 0
    assert done.any(axis=0).all()
    assert 1 < max(map(len, starts_of(states))) <= 2 * STARTS
    for lane, end in enumerate(done.argmax(axis=0)):
        reward, over = alone(jax.random.split(keys[lane])[0])
        np.testing.assert_array_equal(states.reward[: end + 1, lane], reward[: end + 1])
        np.testing.assert_array_equal(done[: end + 1, lane], over[: end + 1])
    assert not np.any(states.metrics["invalid"])
    changed = np.any(np.diff(np.asarray(states.info["key"]).astype(np.int64), axis=0) != 0, axis=-1)
    np.testing.assert_array_equal(changed, done[1:])
    assert states.obs.shape == (STEPS, 3, lanes.observation_size)
    assert (lanes.action_size, lanes.backend) == (env.n_choices, "none")


def test_what_is_told_comes_back():
    told = (
        np.random.default_rng(0).normal(size=(2, features.SCORED_CLUSTERS, len(features.FEATURES))).astype(np.float32)
    )
    used = np.arange(features.SCORED_CLUSTERS) < np.asarray([[3], [0]])
    back = brax_env.unflat(brax_env.flat(brax_env.Told(jnp.asarray(told), jnp.asarray(used))))
    np.testing.assert_array_equal(back.features, told)
    np.testing.assert_array_equal(back.used, used)


def test_masked_choices_by_hand():
    logits = jnp.asarray([[0.0, np.log(3.0), networks.MASKED], [networks.MASKED, networks.MASKED, 5.0]])
    slots = Slots(3)
    drawn = np.stack([slots.sample(logits, jax.random.key(i)) for i in range(40)])
    assert set(drawn[:, 0].tolist()) == {0, 1}
    assert set(drawn[:, 1].tolist()) == {2}
    np.testing.assert_allclose(np.exp(slots.log_prob(logits, jnp.asarray([1, 2]))), [0.75, 1.0], rtol=1e-6)
    entropy = slots.entropy(logits, jax.random.key(0))
    np.testing.assert_allclose(entropy, [-0.75 * np.log(0.75) - 0.25 * np.log(0.25), 0.0], atol=1e-6)
    assert slots.mode(logits).tolist() == [1, 2]
    assert np.all(np.isfinite(jax.grad(lambda a: slots.entropy(a, jax.random.key(0)).sum())(logits)))


@pytest.mark.slow
@pytest.mark.jit
def test_no_start_is_left():
    with pytest.raises(InputError, match="from no start of these worlds does"):
        Decisions(bank.prepare_bank(WORLDS[:1], lidar=NEAR, rules=Rules(max_steps=2)), starts=1)
    walls = np.ones((15, 60), bool)
    walls[4:11, 4:56] = False
    corridor = World(occupied=walls, cell_m=0.1, name="corridor", start=(7, 6, 0))
    refused("is there anything to decide", Decisions, bank.prepare_bank(corridor, lidar=NEAR, start="world"), starts=1)


@pytest.mark.slow
@pytest.mark.jit
def test_an_episode_that_fails_costs_as_much_as_in_the_checks(own):
    """A limit of steps between the reference's need and that of a robot that goes to the farthest cluster."""
    long = bank.prepare_bank(WORLDS[:1], lidar=NEAR)
    steps = int(1.3 * long.values([parse_strategy(bank.REFERENCE)], [0] * STARTS, 4)[0].max() / 0.1)
    env = Decisions(bank.prepare_bank(WORLDS[:1], lidar=NEAR, rules=Rules(max_steps=steps)), starts=STARTS, seed=4)

    def choose(carry):
        state, told, total = carry
        farthest = jnp.argmax(jnp.where(told.used, told.features[:, 0], -1)).astype(jnp.int32)
        state, told, reward, *_ = env.step(state, farthest)
        return state, told, total + reward

    carry = *env.reset(jax.random.key(0)), jnp.float32(0)
    state, _, total = jax.jit(lambda carry: jax.lax.while_loop(lambda c: ~c[0].is_over, choose, carry))(carry)
    assert state.env.episode.outcome == Outcome.STEP_LIMIT
    np.testing.assert_allclose(total, -bank.FAILED, rtol=1e-5)


def test_the_shim_can_go_when_jax_has_it_again_or_brax_does_without():
    assert not hasattr(jax, brax_env.REMOVED)
    with brax_env.device_put_replicated():
        found = jax.device_put_replicated({"a": np.arange(3)}, jax.local_devices()[:1])
        assert found["a"].tolist() == [[0, 1, 2]]
    assert not hasattr(jax, brax_env.REMOVED)
    with brax_env.quietly():
        from brax.training.agents.ppo import train

    assert "device_put_replicated" in Path(train.__file__).read_text(), "brax does without it: the shim can go"
