"""The environments of gymnasium: a single one, and many in step."""

import operator
from typing import Any

import gymnasium  # type: ignore[import-not-found]
import jax
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv  # type: ignore[import-not-found]
from gymnasium.vector.utils import batch_space  # type: ignore[import-not-found]

from jexplore.config import MAX_SEED, InputError, checked_names, require_whole
from jexplore.studies.checks import LIDAR, RULES, LidarLike, RulesLike
from jexplore.studies.environment import Environment, EnvState
from jexplore.studies.gym.game import MAX_DECISIONS, Game, whole_numbers


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

    environment: Environment
    """The wrapped `Environment`."""

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
        self._game = game = Game(worlds, 1, targets=targets, max_decisions=max_decisions, **settings)
        self.environment, self.action_space, self.observation_space = (
            game.env,
            game.action_space,
            game.observation_space,
        )

    @property
    def state(self) -> EnvState | None:
        """Return the `EnvState` of the episode under way; None before the first reset."""
        return jax.tree.map(lambda lanes: lanes[0], self._game.states)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode: `(observation, info)`. The class describes the `options`."""
        seeds = None if seed is None else [require_whole("seed", seed, 0, MAX_SEED)]
        given = self._game.options(options, of_one=True)
        super().reset(seed=seed)
        return _alone(*self._game.begin(seeds, given, self.np_random))

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive to a cell: `(observation, reward, terminated, truncated, info)`."""
        if self._game.states is None:
            raise InputError("there is no episode yet; call reset first")
        action = whole_numbers("action", action, (), 0, self._game.n_cells - 1)
        seen, *ends, info = self._game.turn(action[None], np.zeros(1, bool))
        seen, info = _alone(seen, info)
        reward, terminated, truncated = (end.item() for end in ends)
        return seen, reward, terminated, truncated, info


def _alone(seen, info):
    """Return observation and info of a single lane, numbers as Python has them."""
    plain = {name: value[0] if value.ndim > 1 else value[0].item() for name, value in info.items()}
    return {name: value[0] for name, value in seen.items()}, plain


@checked_names
class GymVectorEnv(VectorEnv):
    """Many environments in step, each with an episode of its own: `jx.GymVectorEnv(["rooms#1", "maze"], num_envs=64)`.

    As `GymEnv`, with a leading axis of `num_envs` everywhere. Lane i of `reset(seed=s)` is a `GymEnv` of the seed
    s + i; `seed` may be a list of seeds, one a lane, and the options have a leading axis as well. The step after the
    one that ends an episode begins the next one, whatever the action, with a reward of 0 (`AutoresetMode.NEXT_STEP`).

    All lanes are one compiled program: on a CPU they run one after the other, on an accelerator together.
    """

    environment: Environment
    """The wrapped `Environment`."""

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self, worlds: Any, num_envs: int = 1, *, cell_m: float = 0.1, lidar: LidarLike = LIDAR,
        rules: RulesLike = RULES, recheck: bool = False, targets: str = "frontier",
        max_decisions: int = MAX_DECISIONS,
    ) -> None:  # fmt: skip
        """Load the worlds. Arguments and errors as of `GymEnv`, and `num_envs`, the number of lanes."""
        settings = {"cell_m": cell_m, "lidar": lidar, "rules": rules, "recheck": recheck}
        self._game = Game(worlds, num_envs, targets=targets, max_decisions=max_decisions, **settings)
        self.environment, self.num_envs = self._game.env, self._game.lanes
        self.single_action_space = self._game.action_space
        self.single_observation_space = self._game.observation_space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._over = np.zeros(num_envs, bool)

    @property
    def states(self) -> EnvState | None:
        """Return the `EnvState`s of the episodes under way, with a leading axis; None before the first reset."""
        return self._game.states

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode in every lane: `(observations, infos)`. The class describes seeds and options."""
        seeds = None if seed is None else self._seeds(seed)
        given = self._game.options(options)
        if seeds is not None:
            super().reset(seed=seeds[0])
        self._over = np.zeros(self.num_envs, bool)
        seen, info = self._game.begin(seeds, given, self.np_random)
        return seen, self._with_masks(info)

    def step(self, actions: Any) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive to a cell in every lane: `(observations, rewards, terminations, truncations, infos)`."""
        if self._game.states is None:
            raise InputError("there are no episodes yet; call reset first")
        actions = whole_numbers("actions", actions, (self.num_envs,), 0, self._game.n_cells - 1)
        seen, rewards, terminated, truncated, info = self._game.turn(actions, self._over)
        self._over = terminated | truncated
        return seen, rewards, terminated, truncated, self._with_masks(info)

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

    def _with_masks(self, info):
        """Return infos, each with a mask of the lanes that have it, as in gymnasium."""
        return info | {f"_{name}": np.ones(self.num_envs, bool) for name in info}
