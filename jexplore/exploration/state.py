"""Records of an exploration episode: its static config, its state, its result."""

import enum
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import jax.numpy as jnp
from flax import struct
from jax import Array

from jexplore.exploration.uncertain.poses import Unsure, UnsureNumbers
from jexplore.grid import Grid
from jexplore.planning import Belief, MapModel

PERCENTILES = (50, 90, 95, 99)
"""Shares of the cells known in the end at which an episode records its path, per cent."""
MARKS = 100
"""An episode also records its path at each 1 / MARKS of the cells that can be known in its world."""

WHOLE = 10_000
"""Parts of which a share of the cells is counted."""
NEVER = 2**31 - 1
"""Known cells, ms, length of the path: none of these ends the episode."""


class Outcome(enum.IntEnum):
    """Outcome of an episode."""

    RUNNING = 0
    COMPLETE = 1  # no frontier left, and every cell that is clear and connected to the start is known
    BLOCKED = 2  # no frontier left, but such a cell is unknown
    STEP_LIMIT = 3
    PLAN_LIMIT = 4
    STUCK = 5  # the start is enclosed: no clear cell can be reached
    BAD_TARGET = 6  # the strategy chose, three times in a row, a target that no path leads to
    BAD_START = 7  # a traced start or world turned out to be wrong: `studies.environment.Environment.reset`
    LOST = 8  # scans have not matched for so long that the robot does not know where it is, see `uncertain.looking`
    INCONSISTENT = 9  # as BLOCKED, and walls of the robot's map enclose it: no clear cell can be reached from its own
    EXPLORED = 10  # the share of `rules.stop_at` is known
    PATH_LIMIT = 11
    TIME_LIMIT = 12


class Stream(enum.IntEnum):
    """Independent streams of random numbers within one episode."""

    SENSOR = 0
    POLICY = 1
    ODOMETRY = 4  # 2 and 3 are `studies.environment`'s
    ROBOT = 5  # of a team: each of the others draws from a key of its own
    CONTACT = 6  # of a team: which links fail


def steps_m(straight: Any, diagonal: Any, cell_m: Any) -> Array:
    """Return the length of some steps, metres: float32. A cost of `reach` would not hold the longest ways."""
    return (straight + jnp.float32(math.sqrt(2)) * diagonal) * cell_m


@struct.dataclass
class Truth:
    """A world as it is, padded, with what results are measured against; or M of one size, with a leading axis."""

    occupied: Array  # [H, W] bool; True in padding
    rooms: Array  # [H, W] int32; -1 outside rooms and in padding
    region: Array  # [H, W] int32, number of each 4-connected region of free cells within
    extent: Array  # [2] int32, height and width without padding
    within: Array | None = None  # [H, W] bool, where the robot may be and what it is to know; None: everywhere
    prior: Array | None = None  # [H, W] int8, what it knows before its first scan: -1 unknown, 0 free, 1 occupied
    replace: ClassVar[Callable[..., Self]]


class Setup(NamedTuple):
    """Static config of an episode. Hashable."""

    policy: Any  # `Policy` without its parameters; None: the site of no strategy yet
    first_scans: int  # scans all round at the start: 1, 2, 4 or 8
    noisy: bool  # whether the scanner's noise is simulated
    capacity: int  # T, steps that the trail has room for; at least max_steps
    window: int = 0  # half width of the square that a scan can change, cells; 0: the whole map
    native: str | None = None  # target of JAX's FFI that drives, see `native.drive`; None: JAX does
    metrics: tuple[Any, ...] = ()  # `metrics.Metric`s
    unsure: Unsure | None = None  # how the robot learns its pose; None: it is given
    ends: bool = False  # whether some episodes end once enough is known, or some robots return home

    @property
    def rides(self) -> bool:
        """Return whether the robot is a differential drive."""
        return self.unsure is not None and self.unsure.rides


@struct.dataclass
class Numbers:
    """The numbers of an episode that may be swept without compiling anew."""

    model: MapModel
    look_around: Array  # bool
    recheck: Array  # bool
    scan_every: Array  # int32, cost of the way after which a robot scans, see `reach`; of a differential drive ms
    arrival_d2: Array  # int32, cells^2, distance at which a target that is not live counts as reached
    max_steps: Array  # int32
    max_plans: Array  # int32
    sigma_cells: Array  # float32
    dropout: Array  # float32
    no_echo_is_free: Array  # bool, whether a beam that nothing stops shows its cells to be free
    stop_at: Array  # int32, share of `WHOLE` of the cells that can be known; 0: none
    return_home: Array  # bool
    max_path: Array  # int32, in units of `motion.LENGTHS`
    max_ms: Array  # int32
    clock: Array  # [C] int32, how long motions take, see `motion.clock_table`
    params: Any  # `Policy.params`
    unsure: UnsureNumbers | None = None  # of a robot whose pose is not given
    replace: ClassVar[Callable[..., Self]]


@struct.dataclass
class Result:
    """Measures of an episode: integers, so that equal results have equal bits. The host makes metres and radians."""

    straight: Array  # int32, straight steps
    diagonal: Array  # int32, diagonal steps
    turns: Array  # int32, 45-degree turns, those in place included
    scans: Array  # int32
    plans: Array  # int32, the last one, that found nothing, included
    exhausted: Array  # int32, targets that stayed live
    outcome: Array  # int32, `Outcome`
    n_known: Array  # int32, known cells among those that are to be known
    explored: Array  # int32, known cells among `explorable`
    explorable: Array  # int32, free cells 4-connected to the start in the true world
    room_entries: Array  # int32
    straight_at: Array  # [4] int32, straight steps when 50, 90, 95, 99 % of `n_known` were known
    diagonal_at: Array  # [4] int32, as `straight_at`
    straight_along: Array  # [MARKS] int32, straight steps when 1, 2, ... 100 % of what can be known was; -1: never
    diagonal_along: Array  # [MARKS] int32, as `straight_along`
    saturated: Array  # int32, cells out of reach at the end because their cost does not fit (see `reach.saturated`)
    refused: Array  # int32, steps refused because the cell ahead was not free
    overflow: Array  # int32, things that the strategy had no room for, all plans together
    time_ms: Array  # int32, from the end of the scans at the start until the robot stands, see `motion`
    starts: Array  # int32, thousandths of the kinetic energy at full speed, all runs together
    time_at: Array  # [4] int32, ms, as `straight_at`: when the last scan there had been made
    time_along: Array  # [MARKS] int32, ms, as `straight_along`
    metrics: tuple[Any, ...] = ()  # int32 or float32 each, values of `Setup.metrics`
    # [1 + 4 + MARKS] float32, metres driven in the end, at `straight_at` and at `straight_along`, where the pose is not
    # given; NaN: never
    way_m: Array | None = None
    # [2] float32, radians turned, and kinetic energy lost by braking, that at full speed is 1, of a differential drive
    ride: Array | None = None
    replace: ClassVar[Callable[..., Self]]


class StepCounts:
    """Steps of an episode, and the length of its path."""

    straight: Array
    diagonal: Array
    belief: Belief
    poses: Any

    @property
    def steps(self) -> Array:
        """Return the number of steps: int32."""
        return self.straight + self.diagonal

    @property
    def path_m(self) -> Array:
        """Return the driven way, metres: float32."""
        if self.poses is not None:
            return self.poses.way_m
        return steps_m(self.straight, self.diagonal, self.belief.model.cell_m)


@struct.dataclass
class State(StepCounts):
    """An episode under way. The robot's cell is where it is; where it believes to be is in its belief."""

    row: Array  # int32, the robot's cell
    col: Array  # int32
    heading: Array  # int32, units of 45 degrees
    belief: Belief
    goal: Array  # [ceil(H / 32), W] uint32, packed: cells that are known when the episode is complete
    route: Array  # [H, W] int8, see `planning.readout.lay_route`
    trail: Array  # [T + 1, 3] int32, see `trail.Trail`
    choices: Array  # [P, 2] int32, see `trail.Choices`
    carry: Any  # the policy's
    target: Array  # [2] int32, row and col; -1 for none
    is_view: Array  # bool, whether it is a view point
    looking: Array  # int32, scans in place still to be made
    looked: Array  # int32, scans in place made since the last step
    plan_active: Array  # bool, whether the plan is still being carried out
    bumped: Array  # int32, the motion that was refused just now, index into `reach.MOTIONS`; -1 for none
    came_from: Array  # [2] int32, row and col of the belief before the last motion
    since_scan: Array  # int32, cost of the way driven since the last scan, or ms, as `Numbers.scan_every`
    n_known: Array  # int32, known cells among those that are to be known
    enough: Array  # int32, their number at which the episode ends; `NEVER`
    homing: Array  # int32, the outcome of a robot that is done and on its way home; 0 for none
    room: Array  # int32, the last room stood in; -1 for none yet
    straight: Array  # int32, and so on as in `Result`
    diagonal: Array
    turns: Array
    scans: Array
    plans: Array
    exhausted: Array
    outcome: Array
    room_entries: Array
    saturated: Array
    refused: Array
    overflow: Array
    bad_targets: Array  # int32, targets in a row that no path leads to
    time_ms: Array  # int32, time since the scans at the start, as if the robot did not brake, see `motion`
    run: Array  # int32, steps since it stood, all in one direction
    starts: Array  # int32, as in `Result`
    poses: Any = None  # `Poses` of a robot whose pose is not given; None: it is given
    metrics: Any = ()  # how often those after every motion were taken, and a value for each, see `metrics.take_stock`
    replace: ClassVar[Callable[..., Self]]

    @property
    def seen(self) -> Grid:
        """Return the map whose known cells count: the robot's, or that of the true poses."""
        return self.belief.grid if self.poses is None or self.poses.seen is None else self.poses.seen

    @property
    def shape(self) -> tuple[int, ...]:
        """Return `(H, W)` of the maps."""
        return self.belief.driven.shape


def no_counts() -> Any:
    """Return the counts of a `State` at zero: dict."""
    names = "straight diagonal turns scans plans exhausted saturated refused overflow bad_targets"
    names += " n_known looking looked since_scan time_ms run starts homing"
    return dict.fromkeys(names.split(), jnp.int32(0))
