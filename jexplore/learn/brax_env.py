"""`Decisions` for brax: an environment of lanes, a distribution over slots, a shim. Importing this takes seconds."""

import contextlib
import io
import warnings
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jexplore.arrays.loops import run_if
from jexplore.learn.decisions import Decisions, Told
from jexplore.policies.learned import features


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Silence brax and its imports, which warn of physics engines that are not installed."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield


with quietly():
    from brax.envs.base import Env, State, Wrapper
    from brax.envs.wrappers.training import EpisodeWrapper
    from brax.training.distribution import IdentityPostprocessor, ParametricDistribution

REMOVED = "device_put_replicated"  # of JAX


def _replicated(tree, devices):
    """Copy a pytree to each device, with a leading axis of the devices on every leaf."""
    each = NamedSharding(Mesh(np.asarray(devices), ("device",)), PartitionSpec("device"))
    return jax.tree.map(lambda leaf: jax.device_put(jnp.stack([jnp.asarray(leaf)] * len(devices)), each), tree)


@contextlib.contextmanager
def device_put_replicated() -> Iterator[None]:
    """Provide `jax.device_put_replicated` for the block.

    JAX 0.10 took it out, and brax 0.14.2 calls it (github.com/google/brax/issues/671).
    """
    setattr(jax, REMOVED, getattr(jax, REMOVED, _replicated))
    try:
        yield
    finally:
        if getattr(jax, REMOVED) is _replicated:
            delattr(jax, REMOVED)


SLOT_WIDTH = len(features.FEATURES) + 1  # numbers of a slot in an observation


def flat(told: Told) -> Array:
    """Flatten an observation: `[..., K * (F + 1)]` float32, of every slot its features and whether it is used."""
    both = jnp.concatenate([told.features, told.used[..., None].astype(jnp.float32)], axis=-1)
    return both.reshape(*both.shape[:-2], -1)


def unflat(observation: Array) -> Told:
    """Convert a flat observation to `Told`."""
    both = observation.reshape(*observation.shape[:-1], -1, SLOT_WIDTH)
    return Told(both[..., :-1], both[..., -1] > 0)


class Lanes(Env):
    """`Decisions` in lanes, an environment of brax. A lane whose episode is over begins anew, from a start drawn then.

    Actions are slots, `[n]` int32. Keys are legacy ones, as brax has them.
    """

    def __init__(self, decisions: Decisions) -> None:
        self.decisions = decisions

    def reset(self, rng: Array) -> State:
        """Begin an episode in every lane, see `Decisions.reset`; one key each: `[n, 2]` uint32."""
        use, following = jnp.moveaxis(jax.vmap(jax.random.split)(rng), 1, 0)
        begun, told = jax.vmap(self._begun)(use)
        zero = jnp.zeros(len(rng), jnp.float32)
        whole: Any = begun  # brax says that this is a state of its physics, and takes any pytree
        metrics = {"invalid": zero, "overflow": zero}
        return State(whole, flat(told), zero, begun.is_over.astype(jnp.float32), metrics, {"key": following})

    def step(self, state: Any, action: Array) -> State:
        """Make a step of every lane, see `Decisions.step`.

        At the end of an episode `done` and `reward` are those of its last step, the observation the first of the next
        one. Metrics: `invalid`, 1 where the action was an unused slot; `overflow`.
        """

        def step(now, key, slot):
            now, told, reward, done, info = self.decisions.step(now, slot)

            def anew(_):
                following, use = jax.random.split(key)
                return following, *self._begun(use)

            return *run_if(done, anew, (key, now, told)), reward, done, info

        slots = action.astype(jnp.int32)
        key, now, told, reward, done, info = jax.vmap(step)(state.pipeline_state, state.info["key"], slots)
        metrics = {"invalid": 1.0 - info["valid"], "overflow": info["overflow"].astype(jnp.float32)}
        new = {"pipeline_state": now, "obs": flat(told), "reward": reward, "done": done.astype(jnp.float32)}
        return state.replace(**new, metrics=metrics, info={**state.info, "key": key})

    def _begun(self, key):
        return self.decisions.reset(jax.random.wrap_key_data(key))

    @property
    def observation_size(self) -> int:
        """Return K * (F + 1)."""
        return self.decisions.n_choices * SLOT_WIDTH

    @property
    def action_size(self) -> int:
        """Return K."""
        return self.decisions.n_choices

    @property
    def backend(self) -> str:
        """Return no physics engine: brax asks for its name."""
        return "none"


def wrap_lanes(env: Env, episode_length: int = 1000, action_repeat: int = 1, randomization_fn: Any = None) -> Wrapper:
    """Count steps: `wrap_env_fn` of `brax.training`, whose own wrapper goes back to the first start for ever."""
    del randomization_fn
    return EpisodeWrapper(env, episode_length, action_repeat)


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
