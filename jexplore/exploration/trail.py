"""The record that an episode keeps of itself, written while it runs and decoded here only: where the robot was after
every step, and what it chose in every plan.
"""

import enum
import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jexplore.arrays.padding import within
from jexplore.exploration.state import Result, State
from jexplore.exploration.uncertain.poses import note_pose
from jexplore.grid import is_free, is_occupied
from jexplore.planning import Choice
from jexplore.reach import MOTIONS, NO_MOTION

LOOKS = 8  # scans made in place at a spot, less than that
CHOICES = 4  # room for one recorded plan per this many steps


class Trail(enum.IntEnum):
    """Columns of a trail: one row for the start and one for every step, after the last scan made there."""

    SPOT = 0  # LOOKS * flat index (row * W + col) of the robot's cell + scans made in place there before going on
    KNOWN = 1  # known cells
    TIME = 2  # ms


class Choices(enum.IntEnum):
    """Columns of the record of plans: one row for every plan."""

    TARGET = 0  # 2 * flat index of the target + whether it is a view point; -1 for none; -2 for one that was refused
    WHEN = 1  # 16 * steps made before + motion that was refused just before + 1 (0 for none)


def blank(capacity: int) -> tuple[Array, Array]:
    """Return an empty trail and record of plans with room for a number of steps: `[T + 1, 3]`, `[P, 2]` int32."""
    steps, plans = (capacity + 1, len(Trail)), (-(-capacity // CHOICES), len(Choices))
    return jnp.zeros(steps, jnp.int32), jnp.zeros(plans, jnp.int32)


def note_step(state: State, when: Array | bool = True) -> State:
    """Add the present step to the trail of a `State`, unless there is nothing to add."""
    cell = state.row * state.shape[1] + state.col
    entry = jnp.stack([LOOKS * cell + state.looked, state.n_known, state.time_ms])
    step = jnp.where(when, state.steps, state.trail.shape[0])
    poses = None if state.poses is None else note_pose(state.poses, state.steps, when)
    return state.replace(trail=state.trail.at[step].set(entry, mode="drop"), poses=poses)


def choice_of(state: State, choice: Choice, bad: Array) -> Array:
    """Return the entry of a choice in the record of plans, `bad` if it was refused: `[2]` int32."""
    cell = 2 * (choice.row * state.shape[1] + choice.col) + choice.is_view
    return jnp.stack([jnp.where(choice.row < 0, -1, jnp.where(bad, -2, cell)), 16 * state.steps + state.bumped + 1])


class Plan(NamedTuple):
    """A recorded choice."""

    step: int  # steps made before
    target: tuple[int, int] | None  # row, col; None: there was none, or it was refused
    is_view: bool
    is_bad: bool  # whether it was refused, because no path leads there
    motions: list[int]  # into the cells of the way that was driven, and the one that was refused


class Final(NamedTuple):
    """An episode's last map and its way there, on the host, in the world's cells: without ring and padding."""

    hits: np.ndarray  # [H, W] int32
    misses: np.ndarray  # [H, W] int32
    rows: np.ndarray  # [n + 1] int32, the robot's cell at the start and after each of n steps
    cols: np.ndarray  # [n + 1] int32
    looked: np.ndarray  # [n + 1] int32, scans made in place there
    n_known: np.ndarray  # [n + 1] int32, known cells then
    plans: list[Plan] | None  # every choice; None where there was no room for all of them, or the pose was not given
    poses: np.ndarray | None = None  # [n + 1, 5] float32, `uncertain.poses.TRAIL`, in the world's cells; None: given
    # of a team: of every robot [n + 1, 5] int32 at the start and after each step: row, col, clock (`motion.LENGTHS`),
    # row and col of the target, -1 for none; and [H, W] int32, the clock when each cell was first known, or the largest
    ways: list[np.ndarray] | None = None
    seen_at: np.ndarray | None = None

    @property
    def own_cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the cells in which the robot took itself to be, at the start and after each step: `(rows, cols)`.

        Those of a team are the ways of all robots, with NaN between two.
        """
        if self.ways is not None:
            gap = np.full((1, 2), np.nan)
            rows, cols = np.concatenate([part for way in self.ways for part in (gap, way[:, :2])])[1:].T
            return rows, cols
        if self.poses is None:
            return self.rows, self.cols
        cols, rows = np.floor(self.poses[:, 3:]).astype(np.int32).T
        return rows, cols


def detail_of(state: State) -> tuple[Array, ...]:
    """Return the detailed record of an episode: map, trail, choices, the last refused motion, and maybe poses."""
    poses = () if state.poses is None else (state.poses.trail,)
    return state.belief.grid.hits, state.belief.grid.misses, state.trail, state.choices, state.bumped, *poses


def _steps_and_map(state: State) -> tuple[Array, ...]:
    grid, p_free = state.belief.grid, state.belief.model.p_free
    return state.trail, (is_free(grid, p_free) + 2 * is_occupied(grid, p_free)).astype(jnp.uint8)


RECORDS: dict[str, Callable[[State], tuple[Array, ...]]] = {
    "paths": lambda state: (state.trail,),
    "maps": _steps_and_map,
}
"""Possible records of every episode: its way; its way and its last map."""


class Record(NamedTuple):
    """Record of every episode, on the host."""

    path: np.ndarray  # [n + 1, 3] int32, row, col and known cells, at the start and after each of n steps
    state: np.ndarray | None  # [H, W] uint8, the last map: 0 unknown, 1 free, 2 occupied; the world's cells


def record_of(result: Result, found: tuple[np.ndarray, ...], shape: tuple[int, ...], width: int, ring: int) -> Record:
    """Return the `Record` of an episode with a `Result` of scalars, from what one of `RECORDS` gave.

    `shape`: of the world with its ring; `width`: of the padded maps; `ring`: of the site.
    """
    trail, *state = found
    trail = trail[: int(result.straight + result.diagonal) + 1]
    rows, cols = np.divmod(trail[:, Trail.SPOT] // LOOKS, width)
    path = np.stack([rows - ring, cols - ring, trail[:, Trail.KNOWN]], axis=1)
    inner = shape[0] - 2 * ring, shape[1] - 2 * ring
    return Record(path, within(state[0], inner, ring).copy() if state else None)


def decode(found: tuple[np.ndarray, ...], result: Result, shape: tuple[int, int], ring: int = 0) -> Final:
    """Make `Final` of what `detail_of` gave for an episode, its `Result`, the world's shape and the site's ring."""
    hits, misses, trail, choices, bumped, *poses = found
    steps, n_plans = int(result.straight + result.diagonal), int(result.plans)
    trail = trail[: steps + 1]
    rows, cols = np.divmod(trail[:, Trail.SPOT] // LOOKS, hits.shape[1])
    plans = None
    if n_plans <= len(choices) and not poses:
        motions = [MOTIONS.index(step) for step in zip(np.diff(rows).tolist(), np.diff(cols).tolist())]
        end = -1, 16 * steps + int(bumped) + 1
        plans = list(_plans([*choices[:n_plans].tolist(), end], motions, hits.shape[1], ring))
    return Final(
        hits=within(hits, shape, ring),
        misses=within(misses, shape, ring),
        rows=rows - ring,
        cols=cols - ring,
        looked=trail[:, Trail.SPOT] % LOOKS,
        n_known=trail[:, Trail.KNOWN],
        plans=plans,
        poses=poses[0][: steps + 1] - np.array([0, ring, ring, ring, ring], np.float32) if poses else None,
    )


def _plans(choices: list[Any], motions: list[int], padded: int, ring: int) -> Iterator[Plan]:
    for (code, when), (_, after) in itertools.pairwise(choices):
        first, last, refused = when // 16, after // 16, after % 16 - 1
        way = motions[first:last] + ([] if refused == NO_MOTION else [refused])
        row, col = divmod(code // 2, padded)
        target = None if code < 0 else (row - ring, col - ring)
        yield Plan(first, target, code >= 0 and code % 2 == 1, code == -2, way)
