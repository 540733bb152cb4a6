"""Proximal policy optimisation (Schulman et al. 2017), as brax has it, over `Decisions`.

brax is imported here and in `brax_env` only.
"""

import functools
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.config import InputError
from jexplore.engine.devices import pinned_draws, random_key
from jexplore.engine.runner import find_resources
from jexplore.learn.bank import Bank
from jexplore.learn.decisions import Decisions
from jexplore.learn.settings import Ppo
from jexplore.policies import Strategy
from jexplore.policies.learned import features, networks
from jexplore.policies.learned.model import Model
from jexplore.policies.learned.strategy import policy_of

CHECKED = 20  # episodes by which a round is judged


class State(NamedTuple):
    """A search under way."""

    weights: Any  # of the policy
    value: Any  # of the network that predicts the remaining way
    generation: Any  # int


class Value(nn.Module):
    """Network for the remaining way: a perceptron for each cluster, their mean and maximum, another perceptron."""

    width: int = 64

    @nn.compact
    def __call__(self, told: Array, used: Array) -> Array:
        """Compute values `[...]` float32, of `[..., K, F]` features and `[..., K]` bool."""
        x, on = nn.relu(nn.Dense(self.width)(told)), used[..., None]
        mean = jnp.sum(jnp.where(on, x, 0.0), axis=-2) / jnp.maximum(jnp.sum(on, axis=-2), 1)
        most = jnp.max(jnp.where(on, x, 0.0), axis=-2)
        both = jnp.concatenate([mean, most, jnp.sum(on, axis=-2) / features.SCORED_CLUSTERS], axis=-1)
        return nn.Dense(1)(nn.relu(nn.Dense(self.width)(both)))[..., 0]


def require_trainable(bank: Bank, settings: Ppo) -> None:
    """Refuse settings that brax or `Decisions` would refuse.

    Raises:
      InputError: a measure that is not the path; worlds of different cells; lanes that cannot be shared out to the
        devices.
    """
    if bank.measure != "path_m":
        raise InputError(f"ppo trains for path_m, its reward, got {bank.measure!r}; es trains for any measure")
    sizes = sorted({world.cell_m for world in bank.worlds})
    if len(sizes) > 1:
        raise InputError(f"worlds to train in by ppo must have cells of one size, got {sizes[0]:g} and {sizes[1]:g} m")
    find_resources()  # starts JAX
    devices = len(jax.local_devices())
    if settings.lanes % devices:
        raise InputError(f"lanes must be a multiple of {devices}, the number of devices, got {settings.lanes}")


def begin(weights: Any, settings: Ppo) -> State:
    """Return the state of a search that begins at some weights."""
    del settings
    blank = jnp.zeros((features.SCORED_CLUSTERS, len(features.FEATURES))), jnp.zeros(features.SCORED_CLUSTERS, bool)
    value = Value().init(random_key(0), *blank)
    weights, value = jax.tree.map(np.asarray, (weights, value))
    return State(weights, value, 0)


@pinned_draws()
def make_round(
    state: State, network: str, bank: Bank, settings: Ppo, seed: int, workers: int | None = None
) -> tuple[State, float]:
    """Make one round of brax's `ppo.train`, from the weights of the last, with new moments of the optimiser.

    Arguments and result as of `es.make_round`; the ratio is that of the weights after the round, from new starts.
    """
    from jexplore.learn.brax_env import Lanes, device_put_replicated, quietly, wrap_lanes

    with quietly():
        from brax.training.acme import running_statistics, specs
        from brax.training.agents.ppo import train as ppo

    env = Lanes(_decisions(bank, settings.starts, seed, workers))
    size = specs.Array((env.observation_size,), jnp.dtype("float32"))
    draw = np.random.default_rng([seed, int(state.generation)])
    batch = -(-settings.decisions // (settings.unroll * settings.minibatches * settings.lanes)) * settings.lanes
    with device_put_replicated(), quietly():
        _, (_, weights, value), _ = ppo.train(
            environment=env,
            num_timesteps=settings.decisions,
            wrap_env_fn=wrap_lanes,
            num_envs=settings.lanes,
            episode_length=2**31 - 1,
            learning_rate=settings.rate,
            entropy_cost=settings.entropy,
            discounting=1.0,
            unroll_length=settings.unroll,
            batch_size=batch,
            num_minibatches=settings.minibatches,
            num_updates_per_batch=settings.updates,
            clipping_epsilon=settings.clip,
            gae_lambda=settings.gae,
            max_grad_norm=1.0,
            network_factory=functools.partial(_networks, network, settings.sharpness),
            seed=int(draw.integers(2**31)),
            restore_params=(running_statistics.init_state(size), state.weights, state.value),
            run_evals=False,
            num_eval_envs=1,  # brax resets them all the same
        )
    weights, value = jax.tree.map(np.asarray, (weights, value))
    strategy = Strategy("learned", policy_of(Model(network, weights)), True)
    logs = bank.log_ratios([strategy], bank.some(draw, CHECKED), int(draw.integers(2**31)), workers=workers)
    return State(weights, value, state.generation + 1), float(np.exp(logs.mean()))


@functools.lru_cache(maxsize=1)
def _decisions(bank, starts, seed, workers):
    return Decisions(bank, starts=starts, seed=seed, workers=workers)


def _networks(network, sharpness, observation_size, action_size, preprocess_observations_fn=None):
    """Build the networks: brax's network factory."""
    del preprocess_observations_fn
    from jexplore.learn.brax_env import Slots, quietly, unflat

    with quietly():
        from brax.training.agents.ppo.networks import PPONetworks
        from brax.training.networks import FeedForwardNetwork

    def logits(_, weights, observation):
        told = unflat(observation)
        found = sharpness * networks.scores(network, weights, told.features, told.used)
        return jnp.where(told.used, found, networks.MASKED)

    def value(_, weights, observation):
        return Value().apply(weights, *unflat(observation))

    def begun(key):
        return networks.initial_weights(network, key, len(features.FEATURES))

    def begun_value(key):
        return Value().init(key, *unflat(jnp.zeros(observation_size)))

    # Ignored types: flax dataclasses, whose fields a type checker does not see.
    policy = FeedForwardNetwork(init=begun, apply=logits)  # type: ignore[call-arg]
    critic = FeedForwardNetwork(init=begun_value, apply=value)  # type: ignore[call-arg]
    return PPONetworks(policy, critic, Slots(action_size))  # type: ignore[call-arg]
