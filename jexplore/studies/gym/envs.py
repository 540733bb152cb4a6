"""The environment of gymnasium."""

import functools
from collections.abc import Mapping
from typing import Any

import gymnasium  # type: ignore[import-not-found]
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces  # type: ignore[import-not-found]
from jax import Array, lax

from jexplore.config import MAX_SEED, InputError, checked_names, require_whole, unknown
from jexplore.engine.draws import random_key
from jexplore.exploration.environment import outcome_of
from jexplore.exploration.results import FREE, OCCUPIED, UNKNOWN, path_m
from jexplore.exploration.state import Outcome
from jexplore.grid import is_free, is_known
from jexplore.planning import metres
from jexplore.reach import FAR, STRAIGHT
from jexplore.studies.checks import LIDAR, RULES, LidarLike, RulesLike
from jexplore.studies.environment import Environment, EnvState, shown
from jexplore.worlds.starts import check_start

TARGETS = ("frontier", "reachable")
MAX_DECISIONS = 20_000
TERMINAL = (
    Outcome.COMPLETE, Outcome.EXPLORED, Outcome.BLOCKED, Outcome.STUCK, Outcome.BAD_TARGET, Outcome.BAD_START
)  # fmt: skip
"""Outcomes that terminate an episode; limits of the rules truncate it."""
_OPTIONS = ("start", "world", "episode")
_INTS = -(2**31), 2**31 - 1


@checked_names
class GymEnv(gymnasium.Env):
    """Exploration for gymnasium: `jx.GymEnv("rooms#1")`. The folder's docstring describes observations and infos.

    The reward is minus the metres driven. An episode terminates without a reachable frontier, COMPLETE or BLOCKED, or
    if its start is enclosed, STUCK; the limits of the rules and `max_decisions` truncate it. An action outside
    `info["action_mask"]` moves nothing.

    `reset(seed=s)` begins episode 0 of the seed s, each further reset the next one; `jx.compare(..., seed=s)` has the
    same noise in its episode of that number. `reset(options=...)` takes `start`, row, col, heading_deg; `world`, index
    of a world; `episode`, another number than the next. Other values are drawn.
    """

    environment: Environment
    state: EnvState | None
    """Of the episode under way; None before the first reset."""

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
        if targets not in TARGETS:
            raise InputError(f"targets must be {' or '.join(TARGETS)}, got {targets!r}")
        self._targets = targets
        self._max_decisions = require_whole("max_decisions", max_decisions, 1, _INTS[1])
        self.environment = Environment(worlds, cell_m=cell_m, lidar=lidar, rules=rules, recheck=recheck)
        height, width = self.environment.shape
        self.action_space = spaces.Discrete(height * width)
        most_m = float(np.float32(FAR / STRAIGHT * self.environment.cell_m))
        most = np.array([height - 1, width - 1, 7], np.int32)
        self.observation_space = spaces.Dict(
            {
                "map": spaces.Box(0, 2, (height, width), np.uint8),
                "frontier": spaces.MultiBinary((height, width)),
                "path_m": spaces.Box(-1.0, most_m, (height, width), np.float32),
                "robot": spaces.Box(np.zeros(3, np.int32), most, dtype=np.int32),
            }
        )
        self._base: Any = None  # the seed's key
        self._number, self._decisions = -1, 0
        self.state = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode: `(observation, info)`. The class describes the `options`."""
        if seed is not None:
            seed = require_whole("seed", seed, 0, MAX_SEED)
        start, world, episode = self._read_options(options)
        super().reset(seed=seed)
        if seed is not None or self._base is None:
            self._base, self._number = random_key(int(self.np_random.integers(2**32)) if seed is None else seed), -1
        self._number = self._number + 1 if episode is None else int(episode)
        self._decisions = 0
        self.state, _ = self.environment.reset(self._key(), start, world)
        return self._told(True)

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive to a cell: `(observation, reward, terminated, truncated, info)`."""
        if self.state is None:
            raise InputError("there is no episode yet; call reset first")
        action = int(_whole_numbers("action", action, (), 0, int(self.action_space.n) - 1))
        target = divmod(action, self.environment.shape[1]) if self._mask[action] else (-1, -1)
        self.state, _, reward, _, known = self.environment.step(self._key(), self.state, target)
        self._decisions += 1
        seen, info = self._told(bool(known["valid"]))
        terminated = info["outcome"] in TERMINAL
        truncated = info["outcome"] != Outcome.RUNNING or self._decisions >= self._max_decisions
        return seen, float(reward) + 0.0, terminated, truncated and not terminated, info

    def _read_options(self, options):
        """Read the options of a reset: start, world, episode; int32, None if absent."""
        if options is not None and not isinstance(options, Mapping):
            raise InputError(f"options must be a mapping of {', '.join(_OPTIONS)}, got {options!r}")
        options = dict(options or {})
        for name in options:
            if name not in _OPTIONS:
                raise unknown("option", str(name), _OPTIONS)
        start, world, episode = (options.get(name) for name in _OPTIONS)
        worlds = self.environment.worlds
        if world is not None:
            world = _whole_numbers("option world", world, (), 0, len(worlds) - 1)
        if episode is not None:
            episode = _whole_numbers("option episode", episode, (), 0, _INTS[1])
        if start is not None:
            if world is None and len(worlds) > 1:
                raise InputError("option start takes the option world as well: there are several worlds")
            world = np.int32(0) if world is None else world
            start = _whole_numbers("option start", start, (3,), *_INTS)
            rules = self.environment.rules
            check_start(worlds[int(world)], tuple(start.tolist()), rules.clearance_m, rules.near_m)
        return start, world, episode

    def _key(self):
        return jax.random.fold_in(self._base, self._number)

    def _told(self, valid):
        """Return observation and info of the state, numbers as Python has them; arrays may be written to."""
        seen, info = jax.device_get(_observe(self.state, targets=self._targets))
        driven_m = path_m(info.pop("straight"), info.pop("diagonal"), self.environment.cell_m)
        self._mask = info.pop("action_mask")
        plain = {name: value.item() for name, value in ({"path_m": driven_m} | info).items()}
        seen = {name: np.array(array) for name, array in seen.items()}
        return seen, plain | {"action_mask": self._mask.copy(), "valid": valid}


@functools.partial(jax.jit, static_argnames="targets")
def _observe(state: EnvState, *, targets: str) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return observation and info of a state. An episode that is over allows no action."""
    episode, view = state.episode, shown(state)
    belief, shape = view.belief, view.cost.shape
    rows, cols = (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))
    outside = (rows >= belief.extent[0]) | (cols >= belief.extent[1])
    free = jnp.where(is_free(belief.grid, belief.model.p_free), FREE, OCCUPIED)
    allowed = view.frontier if targets == "frontier" else view.cost < FAR
    seen = {
        "map": jnp.where(outside, OCCUPIED, jnp.where(is_known(belief.grid), free, UNKNOWN)).astype(jnp.uint8),
        "frontier": view.frontier.astype(jnp.int8),
        "path_m": jnp.where(view.cost < FAR, metres(view.cost, belief.model.cell_m), -1.0),
        "robot": jnp.stack([belief.row, belief.col, belief.heading]).astype(jnp.int32),
    }
    info = {
        "action_mask": (allowed & (episode.outcome == Outcome.RUNNING)).reshape(-1).astype(jnp.int8),
        "outcome": outcome_of(episode),
        "straight": episode.straight,
        "diagonal": episode.diagonal,
        "known_m2": episode.n_known * belief.model.cell_m**2,
    }
    if episode.poses is not None:  # steps are not of a cell's length
        info["path_m"] = episode.path_m
    return seen, info


def _whole_numbers(name: str, value: Any, shape: tuple[int, ...], low: int, high: int) -> np.ndarray:
    """Convert whole numbers of a shape, within bounds, both inclusive, to int32; refuse all others."""
    expected = f"{name} must be {f'integers {list(shape)}' if shape else 'an integer'} from {low} to {high}"
    try:
        array = np.asarray(value)
    except ValueError:
        raise InputError(f"{expected}, got {value!r}") from None
    if array.dtype.kind not in "iu" or array.shape != shape:
        raise InputError(f"{expected}, got {value if array.ndim == 0 else f'{list(array.shape)} {array.dtype}'}")
    if array.min() < low or array.max() > high:
        raise InputError(f"{expected}, got {array.min() if array.min() < low else array.max()}")
    return array.astype(np.int32)
