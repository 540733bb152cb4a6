"""Networks that score frontier clusters by their features. In whatever order clusters come, each has the same score."""

from collections.abc import Callable
from typing import Any

import flax.linen as nn
import jax.numpy as jnp
from jax import Array

from jexplore.config import unknown

MASKED = -1e9  # score of a slot without a cluster; finite, so that gradients are


class Linear(nn.Module):
    """A weighted sum of the features; without a constant, which would not tell clusters apart."""

    @nn.compact
    def __call__(self, features: Array, used: Array) -> Array:
        """Compute scores, see `scores`."""
        weights = self.param("weights", nn.initializers.zeros, (features.shape[-1],))
        del used
        return features @ weights


class Attention(nn.Module):
    """A perceptron for each cluster, one layer of attention over all of them, and another perceptron."""

    width: int = 32
    heads: int = 4

    @nn.compact
    def __call__(self, features: Array, used: Array) -> Array:
        """Compute scores, see `scores`."""
        x = nn.relu(nn.Dense(self.width)(features))
        mask = jnp.broadcast_to(used[..., None, None, :], (*used.shape[:-1], 1, used.shape[-1], used.shape[-1]))
        seen = nn.MultiHeadDotProductAttention(self.heads)(nn.LayerNorm()(x), mask=mask)
        x = x + jnp.where(jnp.any(used, axis=-1)[..., None, None], seen, 0.0)
        x = x + nn.Dense(self.width)(nn.relu(nn.Dense(2 * self.width)(nn.LayerNorm()(x))))
        # In addition to a weighted sum, so that training can begin at that.
        plain = self.param("plain", nn.initializers.zeros, (features.shape[-1],))
        return nn.Dense(1, kernel_init=nn.initializers.normal(0.01))(nn.LayerNorm()(x))[..., 0] + features @ plain


NETWORKS: dict[str, Callable[[], Any]] = {"linear": Linear, "attention": Attention}
"""Name -> constructor."""


def network_named(name: str) -> Any:
    """Return a network by its name."""
    if name not in NETWORKS:
        raise unknown("network", name, NETWORKS)
    return NETWORKS[name]()


PLAIN = {"linear": "weights", "attention": "plain"}
"""Name -> which of its parameters is the weighted sum of the features."""


def initial_weights(name: str, key: Array, n_features: int) -> Any:
    """Return weights before training, which choose as `closest`: float32 arrays. The key is consumed."""
    blank = jnp.zeros((1, n_features)), jnp.ones((1,), bool)
    weights = network_named(name).init(key, *blank)["params"]
    return weights | {PLAIN[name]: weights[PLAIN[name]].at[0].set(-1.0)}


def scores(name: str, weights: Any, features: Array, used: Array) -> Array:
    """Compute scores `[..., M]` of clusters by their features `[..., M, F]`; `MASKED` in an unused slot."""
    found = network_named(name).apply({"params": weights}, features, used)
    return jnp.where(used, found, MASKED)
