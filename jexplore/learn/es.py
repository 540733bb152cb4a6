"""Evolution strategies: weights moved towards those of random variations that drove less.

Salimans et al., "Evolution Strategies as a Scalable Alternative to Reinforcement Learning", 2017: antithetic pairs, and
all members of a generation from the same starts in the same worlds; steps by Adam (optax).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from jexplore.learn.bank import Bank
from jexplore.policies import Strategy
from jexplore.policies.learned.model import Model
from jexplore.policies.learned.strategy import policy_of


class Settings(NamedTuple):
    """Numbers of the search."""

    pairs: int = 8  # antithetic pairs of a generation
    episodes: int = 20  # worlds that each member explores
    sigma: float = 0.1  # standard deviation of a variation
    rate: float = 0.05  # of Adam


class State(NamedTuple):
    """A search under way."""

    theta: np.ndarray  # [D] float32, the weights as one vector
    moments: Any  # of the optimiser
    generation: Any  # int


def begin(weights: Any, settings: Settings) -> State:
    """A search that begins at some weights."""
    theta = np.asarray(ravel_pytree(weights)[0], np.float32)
    return State(theta, jax.tree.map(np.asarray, optax.adam(settings.rate).init(jnp.asarray(theta))), 0)


def weights_of(state: State, like: Any) -> Any:
    """The weights of a search as a pytree."""
    return jax.tree.map(np.asarray, ravel_pytree(like)[1](jnp.asarray(state.theta)))


def step(
    state: State, network: str, like: Any, bank: Bank, settings: Settings, seed: int, workers: int | None = None
) -> tuple[State, float]:
    """One generation.

    Args:
      state: `State`.
      network: one of `networks.NETWORKS`.
      like: pytree of weights of its shapes.
      bank: `Bank` to draw worlds from.
      settings: `Settings`.
      seed: of the whole search.
      workers: cores; by default all.

    Returns:
      `(state, ratio)`: ratio of paths to the reference's, the mean over all members.
    """
    draw = np.random.default_rng([seed, int(state.generation)])
    noise = draw.standard_normal((settings.pairs, len(state.theta))).astype(np.float32)
    which = draw.permutation(np.resize(draw.permutation(len(bank.worlds)), settings.episodes))
    members = [state.theta + sign * settings.sigma * one for one in noise for sign in (1, -1)]
    unravel: Callable[[Any], Any] = ravel_pytree(like)[1]
    strategies = [
        Strategy(f"member {i}", policy_of(Model(network, jax.tree.map(np.asarray, unravel(theta)))), True)
        for i, theta in enumerate(members)
    ]
    logs = bank.log_ratios(strategies, which.tolist(), int(draw.integers(2**31)), workers=workers)
    cost = logs.mean(axis=1)
    # Driving less is better: the gradient of the cost, from pairs, in units of what they differ by.
    apart = cost[0::2] - cost[1::2]
    gradient = (apart / (np.std(apart) + 1e-9)) @ noise / settings.pairs
    update, moments = optax.adam(settings.rate).update(jnp.asarray(gradient, jnp.float32), state.moments)
    theta = np.asarray(optax.apply_updates(state.theta, update), np.float32)
    return State(theta, jax.tree.map(np.asarray, moments), state.generation + 1), float(np.exp(logs.mean()))
