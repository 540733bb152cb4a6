"""Evolution strategies: weights moved towards those of random variations that drove less.

Salimans et al., "Evolution Strategies as a Scalable Alternative to Reinforcement Learning", 2017: antithetic pairs, and
all members of a generation from the same starts in the same worlds; steps by Adam (optax). The weights handed out are
running means over generations (Polyak and Juditsky 1992): steps are as noisy as episodes differ.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from jexplore.learn.bank import Bank
from jexplore.learn.settings import Es
from jexplore.policies import Strategy
from jexplore.policies.learned.model import Model
from jexplore.policies.learned.strategy import policy_of


class State(NamedTuple):
    """A search under way."""

    weights: Any  # the running mean, which is returned
    theta: np.ndarray  # [D] float32, the latest weights as one vector
    moments: Any  # of the optimiser
    generation: Any  # int


def begin(weights: Any, settings: Es) -> State:
    """Return the state of a search that begins at some weights."""
    theta = np.asarray(ravel_pytree(weights)[0], np.float32)
    return State(weights, theta, jax.tree.map(np.asarray, optax.adam(settings.rate).init(jnp.asarray(theta))), 0)


def make_round(
    state: State, network: str, bank: Bank, settings: Es, seed: int, workers: int | None = None
) -> tuple[State, float]:
    """Make one generation, in worlds drawn from the bank; the seed is that of the whole search.

    Returns:
      `(state, ratio)`: ratio of paths to the reference's, the mean over all members.
    """
    draw = np.random.default_rng([seed, int(state.generation)])
    noise = draw.standard_normal((settings.pairs, len(state.theta))).astype(np.float32)
    which = bank.some(draw, settings.episodes)
    members = [state.theta + sign * settings.sigma * one for one in noise for sign in (1, -1)]
    mean, unravel = ravel_pytree(state.weights)

    def tree(vector):
        return jax.tree.map(np.asarray, unravel(jnp.asarray(vector)))

    strategies = [
        Strategy(f"member {i}", policy_of(Model(network, tree(theta))), True) for i, theta in enumerate(members)
    ]
    logs = bank.log_ratios(strategies, which, int(draw.integers(2**31)), workers=workers)
    cost = logs.mean(axis=1)
    # Driving less is better: the gradient of the cost, from pairs, in units of what they differ by.
    apart = cost[0::2] - cost[1::2]
    gradient = (apart / (np.std(apart) + 1e-9)) @ noise / settings.pairs
    update, moments = optax.adam(settings.rate).update(jnp.asarray(gradient, jnp.float32), state.moments)
    theta = np.asarray(optax.apply_updates(state.theta, update), np.float32)
    share = max(settings.latest, 1 / (int(state.generation) + 2))  # at first the mean of all
    weights = tree(np.asarray((1 - share) * np.asarray(mean) + share * theta, np.float32))
    return State(weights, theta, jax.tree.map(np.asarray, moments), state.generation + 1), float(np.exp(logs.mean()))
