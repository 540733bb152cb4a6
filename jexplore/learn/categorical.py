"""A choice among slots as brax wants distributions: logits in, a slot out."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore.learn.shim import quietly

with quietly():
    from brax.training.distribution import IdentityPostprocessor, ParametricDistribution


@struct.dataclass
class Categorical:
    """One of K slots, by logits `[..., K]`; a logit as low as `networks.MASKED` is never drawn."""

    logits: Array

    def sample(self, seed: Array) -> Array:
        """Draw choices: `[...]` int32."""
        return jax.random.categorical(seed, self.logits).astype(jnp.int32)

    def mode(self) -> Array:
        """Return the most likely choice: `[...]` int32."""
        return jnp.argmax(self.logits, axis=-1).astype(jnp.int32)

    def log_prob(self, slot: Array) -> Array:
        """Return log probabilities: `[...]` float32."""
        return jnp.take_along_axis(jax.nn.log_softmax(self.logits), slot[..., None].astype(jnp.int32), axis=-1)[..., 0]

    def entropy(self) -> Array:
        """Return the entropy: `[...]` float32, nats."""
        logs = jax.nn.log_softmax(self.logits)
        return -jnp.sum(jnp.exp(logs) * logs, axis=-1)

    def kl_divergence(self, old: "Categorical") -> Array:
        """Return the divergence of the old one from this: `[...]` float32, nats."""
        ours, theirs = jax.nn.log_softmax(self.logits), jax.nn.log_softmax(old.logits)
        return jnp.sum(jnp.exp(theirs) * (theirs - ours), axis=-1)

    @property
    def loc(self) -> Array:
        """Return zeros: brax reports a mean of every distribution, and a choice has none."""
        return jnp.zeros(self.logits.shape[:-1])

    scale = loc


class Slots(ParametricDistribution):
    """`Categorical` by its logits."""

    def __init__(self, n: int) -> None:
        super().__init__(n, IdentityPostprocessor(), event_ndims=0, reparametrizable=False)

    def create_dist(self, parameters: Array) -> Any:
        """Return the `Categorical` of some logits."""
        return Categorical(parameters)
