"""The environments of gymnasium: a single one, and many in step."""

import functools
import operator
from typing import Any

import gymnasium  # type: ignore[import-not-found]
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv  # type: ignore[import-not-found]
from gymnasium.vector.utils import batch_space  # type: ignore[import-not-found]

from jexplore.arrays.loops import alone_on_cpu, run_if
from jexplore.config import MAX_SEED, InputError, checked_names, require_whole
from jexplore.engine.devices import random_key
from jexplore.studies.checks import LIDAR, RULES, LidarLike, RulesLike
from jexplore.studies.environment import Environment, EnvState
from jexplore.studies.gym.game import (
    MAX_DECISIONS,
    Game,
    copied,
    drawn_seed,
    mask_of,
    observe,
    require_options,
    whole_numbers,
)


@checked_names
class GymEnv(gymnasium.Env):
    """Single environment: `jx.GymEnv("rooms#1")`. The folder's docstring describes observations, actions and infos.

    The reward is minus the metres driven. An episode terminates without a reachable frontier, COMPLETE or BLOCKED, or
    if its start is enclosed, STUCK; the limits of the rules and `max_decisions` truncate it. An action outside
    `info["action_mask"]` moves nothing.

    `reset(seed=s)` begins episode 0 of the seed s, each further reset the next one; `jx.compare(..., seed=s)` has the
    same noise in its episode of that number. `reset(options=...)` takes `start`, row, col, heading_deg; `world`, index
    of a world; `episode`, another number than the next. Other values are drawn.
    """

    def __init__(
        self, worlds: Any, *, cell_m: float = 0.1, lidar: LidarLike = LIDAR, rules: RulesLike = RULES,
        recheck: bool = False, targets: str = "frontier", max_decisions: int = MAX_DECISIONS,
    ) -> None:  # fmt: skip
        """Load the worlds.

        Args:
          worlds, cell_m, lidar, rules, recheck: see `Environment`.
          targets: what an action may name: "frontier", the frontier cells that can be reached, or "reachable", every
            cell that a path leads to.
          max_decisions: decisions, those that moved nothing included, after which an episode is truncated.
        """
        settings = {"cell_m": cell_m, "lidar": lidar, "rules": rules, "recheck": recheck}
        self._game = Game(worlds, targets=targets, max_decisions=max_decisions, **settings)
        self.action_space, self.observation_space = self._game.action_space, self._game.observation_space
        self._base: Any = None  # the seed's key
        self._number, self._decisions = -1, 0
        self._state: EnvState | None = None

    @property
    def environment(self) -> Environment:
        """Return the wrapped `Environment`."""
        return self._game.env

    @property
    def state(self) -> EnvState | None:
        """Return the `EnvState` of the episode under way; None before the first reset."""
        return self._state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode: `(observation, info)`. The class describes the `options`."""
        if seed is not None:
            seed = require_whole("seed", seed, 0, MAX_SEED)
        given = self._game.options({name: [value] for name, value in require_options(options).items()}, 1)
        start, world, episode = (None if a is None else a[0] for a in given)
        super().reset(seed=seed)
        if seed is not None or self._base is None:
            self._base, self._number = random_key(drawn_seed(self) if seed is None else seed), -1
        self._number = self._number + 1 if episode is None else int(episode)
        self._decisions = 0
        self._state, _ = self.environment.reset(self._key(), start, world)
        return self._told(True)

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive to a cell: `(observation, reward, terminated, truncated, info)`."""
        if self._state is None:
            raise InputError("there is no episode yet; call reset first")
        action = int(whole_numbers("action", action, (), 0, self._game.n_cells - 1))
        target = divmod(action, self.environment.shape[1]) if self._mask[action] else (-1, -1)
        self._state, _, reward, _, known = self.environment.step(self._key(), self._state, target)
        self._decisions += 1
        seen, info = self._told(bool(known["valid"]))
        terminated, truncated = self._game.ends(info["outcome"], self._decisions)
        return seen, float(reward) + 0.0, bool(terminated), bool(truncated), info

    def _key(self):
        return jax.random.fold_in(self._base, self._number)

    def _told(self, valid):
        """Return observation and info of the state, numbers as Python has them."""
        seen, info = self._game.fetched(*observe(self._state, targets=self._game.targets))
        self._mask = info["action_mask"]
        plain = {name: value.item() for name, value in info.items() if not np.ndim(value)}
        return copied(seen), plain | {"action_mask": self._mask.copy(), "valid": valid}


@checked_names
class GymVectorEnv(VectorEnv):
    """Many environments in step, each with an episode of its own: `jx.GymVectorEnv(["rooms#1", "maze"], num_envs=64)`.

    As `GymEnv`, with a leading axis of `num_envs` everywhere. Lane i of `reset(seed=s)` is a `GymEnv` of the seed
    s + i; `seed` may be a list of seeds, one a lane, and the options have a leading axis as well. The step after the
    one that ends an episode begins the next one, whatever the action, with a reward of 0 (`AutoresetMode.NEXT_STEP`).

    All lanes are one compiled program: on a CPU they run one after the other, on an accelerator together.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self, worlds: Any, num_envs: int = 1, *, cell_m: float = 0.1, lidar: LidarLike = LIDAR,
        rules: RulesLike = RULES, recheck: bool = False, targets: str = "frontier",
        max_decisions: int = MAX_DECISIONS,
    ) -> None:  # fmt: skip
        """Load the worlds. Arguments and errors as of `GymEnv`, and `num_envs`, the number of lanes."""
        self.num_envs = require_whole("num_envs", num_envs, 1, 2**20)
        settings = {"cell_m": cell_m, "lidar": lidar, "rules": rules, "recheck": recheck}
        self._game = Game(worlds, targets=targets, max_decisions=max_decisions, **settings)
        self.single_action_space = self._game.action_space
        self.single_observation_space = self._game.observation_space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._bases: Any = None  # the keys of the lanes' seeds
        self._numbers, self._decisions = np.full(num_envs, -1, np.int32), np.zeros(num_envs, np.int32)
        self._over = np.zeros(num_envs, bool)
        self._states: EnvState | None = None
        self._begin = jax.jit(functools.partial(_begun, self._game))
        self._turn = jax.jit(functools.partial(_turned, self._game))

    @property
    def environment(self) -> Environment:
        """Return the wrapped `Environment`."""
        return self._game.env

    @property
    def states(self) -> EnvState | None:
        """Return the `EnvState`s of the episodes under way, with a leading axis; None before the first reset."""
        return self._states

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode in every lane: `(observations, infos)`. The class describes seeds and options."""
        seeds = None if seed is None else self._seeds(seed)
        start, world, episode = self._game.options(options, self.num_envs)
        if seeds is not None:
            super().reset(seed=seeds[0])
        elif self._bases is None:
            seeds = [drawn_seed(self) for _ in range(self.num_envs)]
        if seeds is not None:
            self._bases = jnp.stack([random_key(one) for one in seeds])
            self._numbers = np.full(self.num_envs, -1, np.int32)
        self._numbers = self._numbers + np.int32(1) if episode is None else episode
        self._states, seen, info = self._begin(self.environment.arrays, self._bases, self._numbers, start, world)
        self._decisions, self._over = np.zeros_like(self._decisions), np.zeros_like(self._over)
        return self._told(seen, info | {"valid": jnp.ones(self.num_envs, bool)})

    def step(self, actions: Any) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive to a cell in every lane: `(observations, rewards, terminations, truncations, infos)`."""
        if self._states is None:
            raise InputError("there are no episodes yet; call reset first")
        actions, over = whole_numbers("actions", actions, (self.num_envs,), 0, self._game.n_cells - 1), self._over
        self._numbers = self._numbers + over.astype(np.int32)
        self._states, rewards, seen, info = self._turn(
            self.environment.arrays, self._bases, self._numbers, self._states, actions, over
        )
        seen, info = self._told(seen, info)
        self._decisions = np.where(over, 0, self._decisions + 1)
        # An episode that is over as it begins says so with its first step.
        terminated, truncated = (end & ~over for end in self._game.ends(info["outcome"], self._decisions))
        self._over = terminated | truncated
        return seen, np.array(rewards, np.float64) + 0.0, terminated, truncated, info

    def _seeds(self, seed):
        """Return one seed for each lane."""
        try:
            first = operator.index(seed)
            seeds = [first + i for i in range(self.num_envs)]
        except TypeError:
            seeds = list(seed) if isinstance(seed, (list, tuple, np.ndarray)) else [seed]
        if len(seeds) != self.num_envs:
            raise InputError(f"seed must be one, or one for each of {self.num_envs} lanes, got {len(seeds)}")
        return [require_whole("seed", one, 0, MAX_SEED) for one in seeds]

    def _told(self, seen, info):
        """Return observations and infos; each info has a mask of the lanes that have it, as in gymnasium."""
        seen, info = self._game.fetched(seen, info)
        masks = {f"_{name}": np.ones(self.num_envs, bool) for name in info}
        return copied(seen), copied(info) | masks


def _begun(game, arrays, bases, numbers, starts, worlds):
    """Return the first state of every lane, and its observation."""
    env = game.env.with_arrays(arrays)

    def begin(base, number, start, world):
        state, _ = env.reset(jax.random.fold_in(base, number), start, world)
        return state, *observe(state, targets=game.targets)

    return jax.vmap(begin)(bases, numbers, starts, worlds)


def _turned(game, arrays, bases, numbers, states, actions, over):
    """Return the next state of every lane, after a decision or of the next episode, and its observation."""
    env = game.env.with_arrays(arrays)

    def turn(base, number, state, action, over):
        key = jax.random.fold_in(base, number)
        row, col = action // env.shape[1], action % env.shape[1]
        allowed = mask_of(state, game.targets)[row, col] & ~over
        state, _, reward, _, known = env.step(key, state, jnp.where(allowed, jnp.stack([row, col]), -1))
        state = run_if(over, lambda _: env.reset(key)[0], state)
        seen, info = observe(state, targets=game.targets)
        return state, reward, seen, info | {"valid": known["valid"] | over}

    return jax.vmap(alone_on_cpu(turn))(bases, numbers, states, actions, over)
