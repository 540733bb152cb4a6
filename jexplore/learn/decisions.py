"""Exploration as a decision problem: an action is a frontier cluster nearby, a step the way to the next decision.

Between decisions the robot drives on its own.
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.arrays.loops import alone_on_cpu, run_if
from jexplore.config import InputError, require_whole
from jexplore.engine.devices import random_key
from jexplore.exploration.environment import outcome_of
from jexplore.exploration.state import Outcome
from jexplore.learn.bank import FAILED, REFERENCE, Bank
from jexplore.policies import parse_strategy
from jexplore.policies.clusters import Targets, targets
from jexplore.policies.learned import features
from jexplore.policies.learned.strategy import is_forced
from jexplore.studies.environment import Environment, EnvState


class Told(NamedTuple):
    """Observation at a decision."""

    features: Array  # [K, F] float32, see `features.FEATURES`
    used: Array  # [K] bool, which slots hold a cluster: what may be chosen. The nearest is slot 0


@struct.dataclass
class DecisionState:
    """An episode at a decision, or over."""

    env: EnvState
    key: Array  # of the episode
    at: Targets
    last: Array  # [2] int32, row and col of the last target; -1 for none
    reference_m: Array  # float32, how long the reference's path is from this start
    driven_m: Array  # float32
    overflow: Array  # int32, clusters that had no room, all plans together
    replace: ClassVar[Callable[..., Self]]

    @property
    def is_over(self) -> Array:
        """Return whether the episode is over: bool."""
        return self.env.episode.outcome != Outcome.RUNNING


class Decisions:
    """Worlds and starts of a bank to be explored by choosing among clusters: `reset`, then `step` until done.

    Both are pure, for one robot; `jax.jit`, `jax.vmap` and `jax.lax.scan` go over them. A policy that scores clusters
    drives here as the strategy `learned+recheck` does in a comparison.
    """

    n_choices = features.SCORED_CLUSTERS
    """K, slots."""

    def __init__(self, bank: Bank, *, starts: int = 16, seed: int = 0, workers: int | None = None) -> None:
        """Draw a number of starts in each world and drive the reference from each.

        A start from which the reference does not see everything, or has nothing to see, or from which nothing has to be
        decided, is left out.

        Raises:
          InputError: no start is left, or numbers out of range.
        """
        require_whole("starts", starts, 1, 10**6)
        self.env = Environment(bank.worlds, lidar=bank.lidar, rules=bank.rules, recheck=True)
        which = np.repeat(np.arange(len(bank.worlds)), starts)
        where = np.concatenate([own for _, _, own in bank.episodes(which.tolist(), seed)])
        length_m = bank.values([parse_strategy(REFERENCE)], which.tolist(), seed, workers=workers)[0]
        good = np.isfinite(length_m) & (length_m > 0)
        if not good.any():
            raise InputError(f"from no start of these worlds does {REFERENCE} see everything")
        starts_of = which.astype(np.int32), where.astype(np.int32), length_m.astype(np.float32)
        self._starts = tuple(jnp.asarray(a[good]) for a in starts_of)
        numbers = jnp.arange(good.sum())
        is_over = jax.jit(lambda: lax.map(lambda i: self._begun_at(random_key(0), i).is_over, numbers))()
        decides = ~np.asarray(is_over)
        if not decides.any():
            raise InputError("from no start of these worlds is there anything to decide")
        self._starts = tuple(a[decides] for a in self._starts)

    def reset(self, key: Array) -> tuple[DecisionState, Told]:
        """Begin an episode from a start of the bank, drawn with its world, at its first decision; consumes the key."""
        return alone_on_cpu(self._begun)(key)

    def step(self, state: DecisionState, action: Array) -> tuple[DecisionState, Told, Array, Array, dict[str, Array]]:
        """Drive to a cluster, with re-checking, and on to the next decision.

        The action is a slot, int32. An unused one moves nothing, and `info["valid"]` is False.

        Returns:
          state: `DecisionState`; as it was once the episode is over.
          told: `Told`.
          reward: float32, minus the metres driven since the last decision (at the first since the start), divided by
            the whole path of `closest+recheck` from the same start. An episode that does not end COMPLETE has cost at
            least `bank.FAILED` of these paths in the end.
          done: bool.
          info: dict of `valid`, bool; `outcome`, int32, an `Outcome`; `path_m`, float32, metres driven since the start;
            `overflow`, int32, clusters that did not fit, all plans together.
        """
        return alone_on_cpu(self._chosen)(state, action)

    def _begun(self, key):
        draw, key = jax.random.split(key)
        state = self._begun_at(key, jax.random.randint(draw, (), 0, len(self._starts[0])))
        return state, _told(self.env, state)

    def _begun_at(self, key, i):
        world, start, reference_m = (a[i] for a in self._starts)
        env, _ = self.env.reset(jax.random.clone(key), start, world)
        at, nothing = _targets(env), jnp.full((2,), -1, jnp.int32)
        state = DecisionState(env, key, at, nothing, reference_m, jnp.float32(0), at.overflow)
        return self._drive_on(state, jnp.int32(0), jnp.bool_(False))

    def _chosen(self, state, action):
        valid = state.at.used[jnp.clip(action, 0, self.n_choices - 1)] & (action >= 0) & (action < self.n_choices)
        valid &= ~state.is_over
        new = run_if(valid, lambda state: self._drive_on(state, action, jnp.bool_(True)), state)
        path_m, outcome = new.env.episode.path_m, outcome_of(new.env.episode)
        failed = new.is_over & (outcome != Outcome.COMPLETE) & (outcome != Outcome.EXPLORED)
        cost_m = jnp.where(failed, jnp.maximum(path_m, FAILED * state.reference_m), path_m) - state.driven_m
        reward = -cost_m / state.reference_m
        new = new.replace(driven_m=jnp.where(valid, path_m, state.driven_m))
        info = {"valid": valid, "outcome": outcome, "path_m": path_m, "overflow": new.overflow}
        return new, _told(self.env, new), jnp.where(valid, reward, 0.0), new.is_over, info

    def _drive_on(self, state, action, first):
        """Drive to a slot's target, if requested, and then on to the next decision."""

        def drive(carry):
            state, slot, _ = carry
            target = jnp.stack([state.at.row[slot], state.at.col[slot]])
            env = self.env.step(jax.random.clone(state.key), state.env, target)[0]
            at = _targets(env)
            return state.replace(env=env, at=at, last=target, overflow=state.overflow + at.overflow), 0, False

        def goes_on(carry):
            state, _, first = carry
            return first | (is_forced(state.at) & state.at.used[0] & ~state.is_over)

        return lax.while_loop(goes_on, drive, (state, action, first))[0]


def _targets(env):
    return features.shortlist(targets(env.episode.belief, env.reached))


def _told(env, state):
    beams = env.arrays[0].beams
    blank = jnp.zeros((features.SCORED_CLUSTERS, len(features.FEATURES)), jnp.float32)
    used = state.at.used & ~state.is_over

    def tell(_):
        return features.features(state.env.episode.belief, state.at, state.last, beams)

    return Told(run_if(~state.is_over, tell, blank), used)
