"""A single environment of gymnasium."""

from typing import Any

import gymnasium  # type: ignore[import-not-found]
import jax
import numpy as np

from jexplore.config import MAX_SEED, InputError, checked_names, require_whole
from jexplore.engine.draws import random_key
from jexplore.studies.checks import LIDAR, RULES, LidarLike, RulesLike
from jexplore.studies.environment import Environment, EnvState
from jexplore.studies.gym.game import MAX_DECISIONS, Game, copied, drawn_seed, observe, require_options, whole_numbers


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

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012

    def __init__(
        self,
        worlds: Any,
        *,
        cell_m: float = 0.1,
        lidar: LidarLike = LIDAR,
        rules: RulesLike = RULES,
        recheck: bool = False,
        targets: str = "frontier",
        max_decisions: int = MAX_DECISIONS,
        render_mode: str | None = None,
    ) -> None:
        """Load the worlds.

        Args:
          worlds, cell_m, lidar, rules, recheck: see `Environment`.
          targets: what an action may name: "frontier", the frontier cells that can be reached, or "reachable", every
            cell that a path leads to.
          max_decisions: decisions, those that moved nothing included, after which an episode is truncated.
          render_mode: None, or "rgb_array": `render` then returns a picture of the map.

        Raises:
          InputError: as `Environment`, or an argument that cannot be one.
        """
        settings = {"cell_m": cell_m, "lidar": lidar, "rules": rules, "recheck": recheck}
        self._game = Game(worlds, targets=targets, max_decisions=max_decisions, render_mode=render_mode, **settings)
        self.action_space, self.observation_space = self._game.action_space, self._game.observation_space
        self.render_mode = render_mode
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
        """Begin an episode: `(observation, info)`. The class describes the `options`.

        Raises:
          InputError: a seed or an option that cannot be one.
        """
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
        """Drive to a cell: `(observation, reward, terminated, truncated, info)`.

        Raises:
          InputError: no cell of the map, or no episode to make it in.
        """
        if self._state is None:
            raise InputError("there is no episode yet; call reset first")
        action = int(whole_numbers("action", action, (), 0, self._game.n_cells - 1))
        target = divmod(action, self.environment.shape[1]) if self._mask[action] else (-1, -1)
        self._state, _, reward, _, known = self.environment.step(self._key(), self._state, target)
        self._decisions += 1
        seen, info = self._told(bool(known["valid"]))
        terminated, truncated = self._game.ends(info["outcome"], self._decisions)
        return seen, float(reward) + 0.0, bool(terminated), bool(truncated), info

    def render(self) -> Any:
        """Draw the map as the robot knows it, `[h, w, 3]` uint8, in the mode "rgb_array"; else None."""
        if self.render_mode is None or self._state is None:
            return None
        return self._game.picture(self._seen, int(self._state.world))

    def _key(self):
        return jax.random.fold_in(self._base, self._number)

    def _told(self, valid):
        """Return observation and info of the state, numbers as Python has them."""
        self._seen, info = self._game.fetched(*observe(self._state, targets=self._game.targets))
        self._mask = info["action_mask"]
        plain = {name: value.item() for name, value in info.items() if not np.ndim(value)}
        return copied(self._seen), plain | {"action_mask": self._mask.copy(), "valid": valid}
