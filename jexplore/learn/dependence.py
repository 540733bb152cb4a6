"""Partial dependence of a model: its score of a cluster as a function of each feature, the others as observed.

Friedman, "Greedy Function Approximation", Annals of Statistics 29(5), 2001.
"""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.config import require_whole
from jexplore.learn.decisions import Decisions, Told
from jexplore.policies.learned import features, networks
from jexplore.policies.learned.model import Model

if TYPE_CHECKING:
    import pandas as pd

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def decisions_met(env: Decisions, model: Model, n: int, key: Array) -> Told:
    """Collect the observations at n decisions of a model's episodes: `Told` of `[n, K, F]` and `[n, K]`, numpy.

    Args:
      env: `Decisions`.
      model: `Model`.
      n: decisions.
      key: consumed.

    Raises:
      InputError: n out of range.
    """
    require_whole("n", n, 1, 10**7)

    def choose(carry, key):
        state, told = carry
        slot = jnp.argmax(networks.scores(model.network, model.weights, told.features, told.used)).astype(jnp.int32)
        state, now, *_ = env.step(state, slot)
        return lax.cond(state.is_over, lambda: env.reset(key), lambda: (state, now)), told

    def play(keys):
        return lax.scan(choose, env.reset(keys[0]), keys[1:])[1]

    return jax.tree.map(np.asarray, jax.jit(play)(jax.random.split(key, n + 1)))


def dependence(model: Model, met: Told) -> "pd.DataFrame":
    """Compute the partial dependence of a cluster's score on each feature.

    Args:
      model: `Model`.
      met: from `decisions_met`.

    Returns:
      A DataFrame: `feature`; `quantile`, of its values at the clusters met; `value`; `score`, the mean over these
        clusters of the cluster's score with the feature set to that value in it alone, less the mean without it.
    """
    import pandas as pd

    def of_one(told, used, slot, which, value):
        return networks.scores(model.network, model.weights, told.at[slot, which].set(value), used)[slot]

    def mean(told, used, which, value):
        slots = jnp.arange(used.shape[-1])
        each = jax.vmap(lambda slot: of_one(told, used, slot, which, value))(slots)
        return jnp.sum(jnp.where(used, each, 0.0))

    @jax.jit
    def total(which, value):
        return jnp.sum(lax.map(lambda one: mean(one[0], one[1], which, value), (met.features, met.used)))

    plain = np.asarray(networks.scores(model.network, model.weights, *map(jnp.asarray, met)))[met.used]
    rows = []
    for i, name in enumerate(features.NAMES):
        for quantile, value in zip(QUANTILES, np.quantile(met.features[met.used][:, i], QUANTILES)):
            score = float(total(i, np.float32(value))) / len(plain) - float(plain.mean())
            rows.append((name, quantile, float(value), score))
    return pd.DataFrame(rows, columns=["feature", "quantile", "value", "score"])
