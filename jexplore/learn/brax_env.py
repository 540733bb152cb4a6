"""`Decisions` as an environment of brax, with its own way of beginning anew.

brax's `AutoResetWrapper` goes back to the first state of every lane, so to the same world and the same start for ever;
`RenewWrapper` draws another.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import run_if
from jexplore.learn.decisions import Decisions, Told
from jexplore.learn.shim import quietly
from jexplore.policies.learned import features

with quietly():
    from brax.envs.base import Env, State, Wrapper
    from brax.envs.wrappers.training import EpisodeWrapper, VmapWrapper

WIDTH = len(features.NAMES) + 1  # numbers of a slot in an observation


def flat(told: Told) -> Array:
    """Flatten an observation: `[..., K * (F + 1)]` float32, of every slot its features and whether it is used."""
    both = jnp.concatenate([told.features, told.used[..., None].astype(jnp.float32)], axis=-1)
    return both.reshape(*both.shape[:-2], -1)


def unflat(observation: Array) -> Told:
    """Convert a flat observation to `Told`."""
    both = observation.reshape(*observation.shape[:-1], -1, WIDTH)
    return Told(both[..., :-1], both[..., -1] > 0)


class BraxDecisions(Env):
    """An environment of brax over `Decisions`. An action is a slot, int32."""

    def __init__(self, decisions: Decisions) -> None:
        self.decisions = decisions

    def reset(self, rng: Array) -> State:
        """See `Decisions.reset`; `rng` may be a legacy key, as brax has them."""
        state, told = self.decisions.reset(_typed(rng))
        zero = jnp.zeros((), jnp.float32)
        metrics = {"ratio": zero, "invalid": zero, "overflow": zero}
        whole: Any = state  # brax says that this is a state of its physics, and takes any pytree
        return State(whole, flat(told), zero, state.is_over.astype(jnp.float32), metrics, {})

    def step(self, state: Any, action: Array) -> State:
        """See `Decisions.step`.

        Metrics: `ratio`, the whole path relative to the reference's, 0 before the end; `invalid`, 1 where the action
        was an unused slot; `overflow`, clusters that did not fit, 0 before the end.
        """
        now, told, reward, done, info = self.decisions.step(state.pipeline_state, action.astype(jnp.int32))
        metrics = {
            "ratio": jnp.where(done, info["path_m"] / now.reference_m, 0.0),
            "invalid": 1.0 - info["valid"].astype(jnp.float32),
            "overflow": jnp.where(done, info["overflow"], 0).astype(jnp.float32),
        }
        done = done.astype(jnp.float32)
        return state.replace(pipeline_state=now, obs=flat(told), reward=reward, done=done, metrics=metrics)

    @property
    def observation_size(self) -> int:
        """Return K * (F + 1)."""
        return self.decisions.n_choices * WIDTH

    @property
    def action_size(self) -> int:
        """Return K."""
        return self.decisions.n_choices

    @property
    def backend(self) -> str:
        """Return no physics engine: brax asks for its name."""
        return "none"


class RenewWrapper(Wrapper):
    """Begins lanes anew whose episode is over, each from a start drawn then.

    It goes around `EpisodeWrapper(VmapWrapper(...))`.
    """

    def reset(self, rng: Array) -> State:
        """Reset the lanes; one legacy key each, as brax has them: `[n, 2]` uint32."""
        both = jax.vmap(lambda key: jax.random.split(key))(rng)
        state = self.env.reset(both[:, 0])
        state.info["key"] = both[:, 1]
        return state

    def step(self, state: Any, action: Array) -> State:
        """Make a step of every lane.

        At the end of an episode, `done` and `reward` are those of its last step, the observation the first of the next
        one.
        """
        keys, over = state.info["key"], state.done
        state.info["steps"] = jnp.where(over > 0, 0.0, state.info["steps"])
        state = self.env.step(state.replace(done=jnp.zeros_like(over)), action)

        def renewed(done, key, now, obs):
            def anew(_):
                following, use = jax.random.split(key)
                new = self.env.unwrapped.reset(use)
                return following, new.pipeline_state, new.obs

            return run_if(done > 0, anew, (key, now, obs))

        key, now, obs = jax.vmap(renewed)(state.done, keys, state.pipeline_state, state.obs)
        state.info["key"] = key
        return state.replace(pipeline_state=now, obs=obs)


def wrapped(env: Env, episode_length: int = 1000, action_repeat: int = 1, randomization_fn: Any = None) -> Wrapper:
    """Wrap an environment: `wrap_env_fn` of `brax.training`."""
    del randomization_fn
    return RenewWrapper(EpisodeWrapper(VmapWrapper(env), episode_length, action_repeat))


def _typed(rng):
    return rng if jnp.issubdtype(rng.dtype, jax.dtypes.prng_key) else jax.random.wrap_key_data(rng)
