"""Records of a team, and values that follow from them."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore.arrays.loops import take_one
from jexplore.engine.program import Given
from jexplore.exploration.motion import MOST_MS
from jexplore.exploration.state import Outcome, Setup, State, Stream
from jexplore.exploration.team.coordination import Coordination
from jexplore.exploration.team.team import Contact
from jexplore.grid import Grid

ENDED = 2**31 - 1  # clock of a robot that has ended, and of a cell that nobody has seen


class TeamSetup(NamedTuple):
    """Static config of a team. Hashable."""

    robot: Setup  # of each; its own trail has no room, `TeamState.way` is there instead
    n: int
    coordination: Coordination | None  # None: each robot asks its strategy
    capacity: int  # T, steps that the way of each has room for
    meets: bool = False  # whether robots have a rendezvous
    native: str | None = None  # as in `Setup`; the robot has none


class TeamTask(NamedTuple):
    """Task of a team's run."""

    starts: Any  # [N, 3] int32, row, col and heading of each
    contact: Contact
    paces: Any  # [N] int32, see `Member`


@struct.dataclass
class TeamState:
    """A team under way."""

    robots: State  # with a leading axis N
    clock: Array  # [N] int32, in units of `motion.LENGTHS`
    waits: Array  # [N] int32
    in_a_row: Array  # [N] int32, waits since the last step
    hemmed: Array  # [N] bool, whether its next plan takes robots for walls
    fled: Array  # [N, 2] int32, the target from which each has fled last; -1 for none
    shunned: Array  # [N, H, W] bool, targets that each has given up because others were always in the way
    since: Array  # [N, N] int32, clock since which each two have a link; -1 for none
    acts: Array  # int32, times that a robot has acted, where links may fail
    heard: Array  # [N, N] bool, whom each heard when it last acted
    met: Array  # [N] int32, clock when each last heard all that explore, or had waited for them for long enough
    came: Array  # [N] int32, clock since which each waits for others at the rendezvous; -1 for none
    own: Array  # [N, H, W] bool, cells that each had seen itself when it last exchanged maps
    shared: Array  # [N, H, W] int32, its counts of each cell then
    seen_at: Array  # [H, W] int32, clock when any of them first knew each cell; `ENDED`: not yet
    n_known: Array  # int32, those among them that are to be known
    log: Array  # [H * W + 1, 4] int32: n_known, straight steps and waits, diagonal steps, ms; when it last grew
    n_log: Array  # int32, entries
    last: Array  # int32, robot of the last entry
    links: Array  # int32, sum over steps of the others that the robot heard
    way: Array  # [N, T + 1, 3] int32, at the start and after each step: index of the cell, clock, index of the target
    replace: ClassVar[Callable[..., Self]]


def counts(grid: Grid) -> Array:
    """Return how often a cell was hit or passed: int32."""
    return grid.hits + grid.misses


def given_of_robot(given: Given, i: Array | int) -> Given:
    """Return the run context of one robot: the first draws as a robot alone, the others from keys of their own.

    Its beams are those of all, ended where its range is.
    """
    others = jax.random.fold_in(jax.random.fold_in(given.key, Stream.ROBOT), i)
    beams, numbers = given.shared, given.numbers
    if beams.length.ndim == 3:  # a leading axis N
        around = beams.all_round and beams.all_round.replace(length=beams.all_round.length[i], reach=beams.reach[i])
        beams = beams.replace(length=beams.length[i], reach=beams.reach[i], all_round=around)
    numbers = numbers.replace(max_ms=-(-numbers.max_ms // given.task.paces[i]))
    key = jnp.where(i == 0, given.key, others)
    return given.replace(key=key, task=take_one(given.task.starts, i), shared=beams, numbers=numbers)


def own_cells(robots: State, own: Array, shared: Array) -> Array:
    """Return the cells that each robot has seen itself, `[N, H, W]` bool: only its scans change counts in between."""
    return own | (counts(robots.belief.grid) != shared)


def is_exploring(team: TeamState) -> Array:
    """Return which robots have not ended: `[N]` bool."""
    return team.robots.outcome == Outcome.RUNNING


def next_robot(team: TeamState) -> Array:
    """Return whose turn it is: int32."""
    return jnp.argmin(jnp.where(is_exploring(team), team.clock, ENDED)).astype(jnp.int32)


def is_done(team: TeamState) -> Array:
    """Return whether all robots have ended: bool."""
    return ~jnp.any(is_exploring(team))


def must_decide(team: TeamState) -> Array:
    """Return whether the robot whose turn it is has no plan: bool."""
    return ~team.robots.plan_active[next_robot(team)]


def paced_ms(time_ms: Array, pace: Array) -> Array:
    """Return the time of a robot of a pace, of that of one of pace 1: int32, ms."""
    return jnp.minimum(time_ms, MOST_MS // pace) * pace
