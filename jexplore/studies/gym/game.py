"""Common code of the single and the vector environment: worlds, spaces, observations."""

import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces  # type: ignore[import-not-found]
from jax import Array, lax
from numpy.typing import ArrayLike

from jexplore.config import InputError, require_whole, unknown
from jexplore.exploration.environment import outcome_of
from jexplore.exploration.results import FREE, OCCUPIED, UNKNOWN, path_m
from jexplore.exploration.state import Outcome
from jexplore.grid import is_free, is_known
from jexplore.planning import metres
from jexplore.reach import FAR, STRAIGHT
from jexplore.rules import Rules
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


class Game:
    """Worlds that may be explored, and the spaces of gymnasium that they have."""

    def __init__(self, worlds: Any, *, rules: Rules, targets: str, max_decisions: int, **settings: Any) -> None:
        """Load the worlds. Arguments and errors as of `GymEnv`."""
        if targets not in TARGETS:
            raise InputError(f"targets must be {' or '.join(TARGETS)}, got {targets!r}")
        self.max_decisions = require_whole("max_decisions", max_decisions, 1, _INTS[1])
        self.env, self.rules, self.targets = Environment(worlds, rules=rules, **settings), rules, targets
        height, width = self.env.shape
        self.n_cells = height * width
        self.action_space = spaces.Discrete(self.n_cells)
        most_m = float(np.float32(FAR / STRAIGHT * self.env.cell_m))
        most = np.array([height - 1, width - 1, 7], np.int32)
        self.observation_space = spaces.Dict(
            {
                "map": spaces.Box(0, 2, (height, width), np.uint8),
                "frontier": spaces.MultiBinary((height, width)),
                "path_m": spaces.Box(-1.0, most_m, (height, width), np.float32),
                "robot": spaces.Box(np.zeros(3, np.int32), most, dtype=np.int32),
            }
        )

    def options(self, options: dict[str, Any] | None, n: int) -> tuple[np.ndarray | None, ...]:
        """Read the options of a reset of n lanes: `[n, 3]` starts, `[n]` worlds and episodes, int32; None if absent."""
        options = require_options(options)
        for name in options:
            if name not in _OPTIONS:
                raise unknown("option", str(name), _OPTIONS)
        start, world, episode = (options.get(name) for name in _OPTIONS)
        n_worlds = len(self.env.worlds)
        if world is not None:
            world = whole_numbers("option world", world, (n,), 0, n_worlds - 1)
        if episode is not None:
            episode = whole_numbers("option episode", episode, (n,), 0, _INTS[1])
        if start is not None:
            if world is None and n_worlds > 1:
                raise InputError("option start takes the option world as well: there are several worlds")
            world = np.zeros(n, np.int32) if world is None else world
            start = whole_numbers("option start", start, (n, 3), *_INTS)
            for own, (row, col, heading_deg) in zip(world.tolist(), start.tolist()):
                place = row, col, heading_deg
                check_start(self.env.worlds[own], place, self.rules.clearance_m, self.rules.near_m)
        return start, world, episode

    def ends(self, outcome: ArrayLike, decisions: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return whether episodes terminate or are truncated, never both: `(terminated, truncated)`, bool."""
        terminated = np.isin(outcome, TERMINAL)
        stopped = np.not_equal(outcome, Outcome.RUNNING) | np.greater_equal(decisions, self.max_decisions)
        return terminated, ~terminated & stopped

    def fetched(self, seen: Any, info: Any) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Fetch the result of `look` to the host, steps as metres: `(seen, info)`."""
        seen, info = jax.device_get((seen, info))
        driven_m = path_m(info.pop("straight"), info.pop("diagonal"), self.env.cell_m)
        return seen, {"path_m": driven_m} | info


def mask_of(state: EnvState, targets: str) -> Array:
    """Return the cells that an action may name: `[H, W]` bool; none once the episode is over."""
    view = shown(state)
    allowed = view.frontier if targets == "frontier" else view.cost < FAR
    return allowed & (state.episode.outcome == Outcome.RUNNING)


@functools.partial(jax.jit, static_argnames="targets")
def observe(state: EnvState, *, targets: str) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return observation and info of a state, before `Game.fetched`."""
    episode, view = state.episode, shown(state)
    belief, shape = view.belief, view.cost.shape
    rows, cols = (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))
    outside = (rows >= belief.extent[0]) | (cols >= belief.extent[1])
    free = jnp.where(is_free(belief.grid, belief.model.p_free), FREE, OCCUPIED)
    seen = {
        "map": jnp.where(outside, OCCUPIED, jnp.where(is_known(belief.grid), free, UNKNOWN)).astype(jnp.uint8),
        "frontier": view.frontier.astype(jnp.int8),
        "path_m": jnp.where(view.cost < FAR, metres(view.cost, belief.model.cell_m), -1.0),
        "robot": jnp.stack([belief.row, belief.col, belief.heading]).astype(jnp.int32),
    }
    info = {
        "action_mask": mask_of(state, targets).reshape(-1).astype(jnp.int8),
        "outcome": outcome_of(episode),
        "straight": episode.straight,
        "diagonal": episode.diagonal,
        "known_m2": episode.n_known * belief.model.cell_m**2,
    }
    if episode.poses is not None:  # steps are not of a cell's length
        info["path_m"] = episode.path_m
    return seen, info


def copied(arrays: dict[str, Any]) -> dict[str, np.ndarray]:
    """Copy arrays for whoever may write to them."""
    return {name: np.array(array) for name, array in arrays.items()}


def require_options(options: Any) -> dict[str, Any]:
    """Return the options of a reset as a dict; refuse all but mappings."""
    if options is not None and not isinstance(options, Mapping):
        raise InputError(f"options must be a mapping of {', '.join(_OPTIONS)}, got {options!r}")
    return dict(options or {})


def whole_numbers(name: str, value: Any, shape: tuple[int, ...], low: int, high: int) -> np.ndarray:
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


def drawn_seed(env: Any) -> int:
    """Draw a seed from the generator of an environment of gymnasium."""
    return int(env.np_random.integers(2**32))
