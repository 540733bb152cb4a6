"""Common code of the single and the vector environment: spaces, lanes of episodes in step, observations."""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces  # type: ignore[import-not-found]
from jax import Array, lax

from jexplore.arrays.loops import alone_on_cpu, run_if
from jexplore.config import InputError, require_whole, unknown
from jexplore.engine.devices import random_key
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
OPTIONS = ("start", "world", "episode")
_INTS = -(2**31), 2**31 - 1


class Game:
    """Episodes in step, one a lane, and the spaces of gymnasium that they have."""

    states: EnvState | None
    """Of the episodes under way, with a leading axis of lanes; None before the first reset."""

    def __init__(
        self, worlds: Any, lanes: int, *, rules: Rules, targets: str, max_decisions: int, **settings: Any
    ) -> None:
        """Load the worlds. Arguments and errors as of `GymEnv`."""
        if targets not in TARGETS:
            raise InputError(f"targets must be {' or '.join(TARGETS)}, got {targets!r}")
        self.lanes = require_whole("num_envs", lanes, 1, 2**20)
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
        self.states, self._bases = None, None  # the keys of the lanes' seeds
        self._numbers, self._decisions = np.full(lanes, -1, np.int32), np.zeros(lanes, np.int32)
        self._begun, self._turned = (jax.jit(functools.partial(made, self)) for made in (_begun, _turned))

    def begin(
        self, seeds: Sequence[int] | None, options: tuple[np.ndarray | None, ...], rng: np.random.Generator
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Begin an episode in every lane: `(seen, info)`; seeds are drawn where there never were any."""
        start, world, episode = options
        if seeds is None and self._bases is None:
            seeds = [int(rng.integers(2**32)) for _ in range(self.lanes)]
        if seeds is not None:
            self._bases = jnp.stack([random_key(one) for one in seeds])
            self._numbers = np.full(self.lanes, -1, np.int32)
        self._numbers = self._numbers + np.int32(1) if episode is None else episode
        self._decisions = np.zeros_like(self._decisions)
        self.states, seen, info = self._begun(self.env.arrays, self._bases, self._numbers, start, world)
        return self._fetched(seen, info | {"valid": jnp.ones(self.lanes, bool)})

    def turn(self, actions: np.ndarray, over: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, Any]:
        """Drive to a cell in every lane, or begin its next episode: all that `step` of a vector environment returns.

        `over` are the lanes, `[N]` bool, in which the next episode begins.
        """
        self._numbers = self._numbers + over.astype(np.int32)
        self.states, rewards, seen, info = self._turned(
            self.env.arrays, self._bases, self._numbers, self.states, actions, over
        )
        seen, info = self._fetched(seen, info)
        self._decisions = np.where(over, 0, self._decisions + 1)
        terminated = np.isin(info["outcome"], TERMINAL)
        stopped = (info["outcome"] != Outcome.RUNNING) | (self._decisions >= self.max_decisions)
        # An episode that is over as it begins says so with its first step.
        return seen, np.array(rewards, np.float64) + 0.0, terminated & ~over, stopped & ~terminated & ~over, info

    def options(self, options: Any, *, of_one: bool = False) -> tuple[np.ndarray | None, ...]:
        """Read the options of a reset: `[N, 3]` starts, `[N]` worlds and episodes, int32; None if absent.

        Those `of_one` have no axis of lanes.
        """
        if options is not None and not isinstance(options, Mapping):
            raise InputError(f"options must be a mapping of {', '.join(OPTIONS)}, got {options!r}")
        given = {name: [value] if of_one else value for name, value in (options or {}).items()}
        for name in given:
            if name not in OPTIONS:
                raise unknown("option", str(name), OPTIONS)
        (start, world, episode), n = (given.get(name) for name in OPTIONS), self.lanes
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

    def _fetched(self, seen, info):
        """Fetch arrays to the host, which whoever gets them may write to, and steps as metres: `(seen, info)`."""
        seen, info = jax.tree.map(np.array, jax.device_get((seen, info)))
        driven_m = path_m(info.pop("straight"), info.pop("diagonal"), self.env.cell_m)
        return seen, {"path_m": driven_m} | info


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


def mask_of(state: EnvState, targets: str) -> Array:
    """Return the cells that an action may name: `[H, W]` bool; none once the episode is over."""
    view = shown(state)
    allowed = view.frontier if targets == "frontier" else view.cost < FAR
    return allowed & (state.episode.outcome == Outcome.RUNNING)


@functools.partial(jax.jit, static_argnames="targets")
def observe(state: EnvState, *, targets: str) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return observation and info of a state, steps not yet as metres."""
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
