"""Regression on the observed costs of choices: rounds of lessons with the present weights, and fits to all lessons.

Rounds as in Ross, Gordon, Bagnell, "A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning" (DAgger), AISTATS 2011; costs of every action from rollouts as in Ross, Bagnell, "Reinforcement and Imitation
Learning via Interactive No-Regret Learning", 2014. Rollouts know the true map; the learned strategy does not.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array, lax

from jexplore.learn.bank import REFERENCE, Bank, log_ratio
from jexplore.learn.lessons import Asking, Lessons, give_lessons, no_lessons, together
from jexplore.learn.settings import Advantage
from jexplore.policies import parse_strategy
from jexplore.policies.learned import networks
from jexplore.policies.learned.model import Model

MAX_LESSONS = 5_000  # lessons, the latest: 2 kB each, in every check that is kept


class State(NamedTuple):
    """A search under way."""

    weights: Any
    lessons: Lessons
    generation: Any  # int


def begin(weights: Any, settings: Advantage) -> State:
    """Return the state of a search that begins at some weights."""
    del settings
    return State(weights, no_lessons(), 0)


def make_round(
    state: State, network: str, bank: Bank, settings: Advantage, seed: int, workers: int | None = None
) -> tuple[State, float]:
    """Make one round. Arguments and result as of `es.make_round`; the ratio is that of the paths with lessons."""
    draw = np.random.default_rng([seed, int(state.generation)])
    which = bank.some(draw, settings.episodes)
    starts = int(draw.integers(2**31))
    asking = Asking(settings.share, settings.tried, settings.margin_m, settings.stray)
    new, path_m = give_lessons(bank, Model(network, state.weights), which, starts, asking, workers=workers)
    every = together([state.lessons, new])
    every = Lessons(*(column[-MAX_LESSONS:] for column in every))
    weights = state.weights
    if len(every.weight):
        size = 2 ** (len(every.weight) - 1).bit_length()  # few sizes, so that few programs are compiled
        padded = Lessons(*(np.resize(column, (size, *column.shape[1:])) for column in every))
        at = jnp.asarray(draw.integers(len(every.weight), size=(settings.steps, settings.batch)))
        rates = jnp.float32(settings.rate), jnp.float32(settings.delta)
        weights = jax.tree.map(np.asarray, _fitted(network, weights, padded, at, *rates))
    logs = log_ratio(path_m, bank.lengths([parse_strategy(REFERENCE)], which, starts, workers=workers)[0])
    return State(weights, every, state.generation + 1), float(np.exp(logs.mean()))


def loss(network: str, weights: Any, some: Lessons, delta: Array | float) -> Array:
    """Compute Huber's loss of scores against minus the costs, both centred over the candidates tried: float32.

    Args:
      network: one of `networks.NETWORKS`.
      weights: of that network.
      some: `Lessons`, B of them.
      delta: errors beyond it count linearly, FEATURE_UNIT_M.
    """
    on = ~jnp.isnan(some.costs)
    n = jnp.maximum(jnp.sum(on, axis=1), 1)
    both = networks.scores(network, weights, some.features, some.used) + jnp.where(on, some.costs, 0.0)
    apart = both - (jnp.sum(jnp.where(on, both, 0.0), axis=1) / n)[:, None]
    each = jnp.sum(jnp.where(on, optax.huber_loss(jnp.where(on, apart, 0.0), delta=delta), 0.0), axis=1) / n
    return jnp.sum(some.weight * each) / jnp.sum(some.weight)


@functools.partial(jax.jit, static_argnums=0)
def _fitted(network, weights, lessons, at, rate, delta):
    """Return weights after some steps of Adam, on `at`: `[steps, batch]` int32."""
    optimiser = optax.adam(rate)

    def one(carry, at):
        weights, moments = carry
        some = jax.tree.map(lambda column: column[at], lessons)
        gradient = jax.grad(lambda weights: loss(network, weights, some, delta))(weights)
        update, moments = optimiser.update(gradient, moments)
        return (optax.apply_updates(weights, update), moments), None

    return lax.scan(one, (weights, optimiser.init(weights)), at)[0][0]
