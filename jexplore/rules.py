"""The settings of an episode: scanner, odometry, times of a robot, rules. Loads neither jax nor numpy.

The command line builds its options from these classes; their docstrings are its help texts, and "off" among a field's
metadata is that of the option which switches it off, "short" leaves the record's name off the option.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, Literal, Self, get_args, get_origin

from jexplore.config import (
    InputError,
    as_record,
    checked_names,
    is_array,
    require_number,
    require_whole,
    unknown,
)


def limit(default: Any = dataclasses.MISSING, check: Callable[..., Any] = require_number, **bounds: Any) -> Any:
    """Make a field of `Settings` whose values, but for a default of None, a function of `config` checks.

    Without a default the field must be given.
    """
    return dataclasses.field(default=default, metadata={"check": functools.partial(check, **bounds)})


class Settings:
    """Common base of records of settings. Values that are no numbers within their bounds are refused."""

    HOLDS_ARRAYS: ClassVar[bool] = False
    """True if a kernel may put arrays in the place of numbers that were checked."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            name, value = f"{type(self).__name__.lower()}.{field.name}", getattr(self, field.name)
            if self.HOLDS_ARRAYS and is_array(value):
                continue
            if field.type is bool and not isinstance(value, bool):
                raise InputError(f"{name} must be True or False, got {value!r}")
            if get_origin(field.type) is Literal and (isinstance(value, float) or value not in get_args(field.type)):
                raise unknown(field.name, str(value), [*map(str, get_args(field.type))])
            if "check" in field.metadata and not (value is field.default is None):
                field.metadata["check"](name, value)

    def replace(self, **changes: Any) -> Self:
        """Return the same settings with some fields changed, checked as when they are made."""
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]


@checked_names
@dataclasses.dataclass(frozen=True)
class Lidar(Settings):
    """A planar laser scanner, at the robot's centre and looking forward unless told otherwise.

    The defaults are a SICK LMS 200 as Stage models it.
    """

    n_beams: int = limit(181, require_whole, low=1, high=4096)
    """A scan has this many beams, evenly spaced over the field of view, both edges included."""
    fov_deg: float = limit(180.0, high=360)
    """The field of view is this wide, in degrees. At 360 the beams are spaced so that first and last do not coincide.
    Below 90 a look all round is eight scans."""
    range_m: float = limit(8.0, low_open=True, high=1000)
    """A beam sees what it enters at a distance below this, in metres."""
    sigma_m: float = limit(0.0, high=1000)
    """The noise of the ranges has this standard deviation, in metres."""
    dropout: float = limit(0.0, high=1, high_open=True)
    """A beam returns nothing at all, and leaves the map as it is, with this probability."""
    no_echo: Literal["free", "unknown"] = "free"
    """A beam that nothing stops within the range says that its cells are free, or says nothing: they stay unknown, as
    drivers have it that report no echo as an invalid reading."""
    min_range_m: float = limit(0.0)
    """A beam that is stopped nearer than this to the scanner says nothing, in metres (REP 117: an invalid reading)."""
    forward_m: float = limit(0.0, low=-10, high=10)
    """The scanner is mounted this far ahead of the robot's centre, in metres."""
    left_m: float = limit(0.0, low=-10, high=10)
    """The scanner is mounted this far to the left of the robot's centre, in metres."""
    yaw_deg: float = limit(0.0, low=-360, high=360)
    """The scanner looks this far to the left of the robot's heading, in degrees."""

    @property
    def mount_m(self) -> float:
        """Return distance of the scanner from the robot's centre, metres."""
        return math.hypot(self.forward_m, self.left_m)

    def without_noise(self) -> Self:
        """Return the scanner that has the same beams and perfect readings."""
        return dataclasses.replace(self, sigma_m=0.0, dropout=0.0, no_echo="free")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n_beams > 1:
            require_number("lidar.fov_deg", self.fov_deg, low_open=True, high=360)
        require_number("lidar.min_range_m", self.min_range_m, high=self.range_m, high_open=True)


MOST_TIME_S = 2**30 // 1000  # s; clocks stand still there, see `exploration.motion`
POSES = ("true", "odometry", "icp", "icp+closing")
"""Ways in which a robot learns its pose: it is given; by odometry alone; by matching its scans as well, and by closing
loops."""


@checked_names
@dataclasses.dataclass(frozen=True)
class Odometry(Settings):
    """Errors of the odometry, for robots whose pose is not given: on a grid, and on tracks as part of `jx.btm.Noise`.

    The squares of the first four are alpha 3, 1, 2 and 4 of Thrun, Burgard and Fox 2005, 5.4; the errors of alpha 2 and
    4 grow with the root of way and turn, so that they do not depend on the length of steps. The last four are
    systematic: with `pose="icp"` the robot estimates them.
    """

    HOLDS_ARRAYS: ClassVar[bool] = True

    length: float = limit(0.01, high=0.5)
    """The length of a step has this standard deviation, relative to it."""
    turn: float = limit(0.01, high=0.5)
    """A turn has this standard deviation, relative to it."""
    heading_deg_sqrt_m: float = limit(0.5, high=45)
    """The heading has this standard deviation after one metre of way, in degrees; it grows with the root of the way."""
    length_m_sqrt_rad: float = limit(0.0, high=0.5)
    """The length of a step has this standard deviation after a turn of one radian, in metres; it grows with the root of
    the turn."""
    length_scale: float = limit(1.0, low_open=True, high=2)
    """The encoders report every length scaled by this."""
    turn_scale: float = limit(1.0, low_open=True, high=2)
    """The encoders report every turn scaled by this."""
    heading_bias_deg_m: float = limit(0.0, low=-45, high=45)
    """The odometry's heading turns by this on every metre of way, in degrees, counter-clockwise."""
    slip: float = limit(0.02, high=0.5)
    """The robot loses this share of every turn to slip, which the encoders do not notice."""


@checked_names
@dataclasses.dataclass(frozen=True)
class Robot(Settings):
    """Times and energies of the robot's motions; no path on the lattice depends on them.

    The defaults are a Pioneer 3-DX with a SICK LMS 200: accelerations and turns as its firmware has them (300 mm/s²,
    100 degrees/s²), half a metre a second as in rooms, energy by Mei et al. 2005.
    """

    speed_m_s: float = limit(0.5, low=0.001, high=1000)
    """The robot drives this fast, in metres a second."""
    turn_rad_s: float = limit(1.75, low=0.001, high=1000)
    """It turns in place this fast, in radians a second."""
    acceleration_m_s2: float = limit(0.3, low=0.001, high=1000)
    """It speeds up and brakes this much, in metres a second squared."""
    turn_acceleration_rad_s2: float = limit(1.75, low=0.001, high=1000)
    """It speeds up and slows down a turn this much, in radians a second squared."""
    scan_s: float = limit(0.013, high=3600)
    """A scan takes this long where the robot stands for it, in seconds; on its way it scans while it drives."""
    plan_s: float = limit(0.0, high=3600)
    """A plan takes this long, in seconds, and the robot stands meanwhile; at 0 it plans while it drives."""
    standby_w: float = limit(36.0, high=1e6)
    """Whatever it does it draws this power, in watts: controller 5, computer 11, scanner 20."""
    drive_j_m: float = limit(7.4, high=1e6)
    """Rolling takes this energy, in joules a metre."""
    turn_j_rad: float = limit(1.2, high=1e6)
    """Turning in place takes this energy, in joules a radian: that of wheels that roll 0.16 m from the centre."""
    mass_kg: float = limit(14.0, high=1e6)
    """It weighs this much, in kilograms; braking loses the kinetic energy."""
    scan_period_s: float = limit(0.2, high=3600)
    """With --motion diff-drive it scans whenever this much time has passed on its way, in seconds."""
    lookahead_m: float = limit(0.3, low=0.01, high=10)
    """With --motion diff-drive it steers to the point of its route that lies this far ahead, in metres."""
    tolerance_m: float = limit(0.1, low=0.01, high=10)
    """With --motion diff-drive it brakes and turns in place where it is farther than this from its route, in metres."""


@checked_names
@dataclasses.dataclass(frozen=True)
class Rules(Settings):
    """The rules of an exploration episode, besides the scanner and the strategy."""

    clearance_m: float = limit(0.30, high=10)
    """A cell is clear if it is free and no occupied cell lies within this distance, centre to centre, in metres."""
    near_m: float = limit(0.50, high=10)
    """Free cells within this distance of the robot, in metres, are traversable even where they are not clear."""
    p_free: float = limit(0.25, high=1, high_open=True)
    """A known cell is free if its reflection probability is at most this, in float32; else it is occupied."""
    look_around: bool = dataclasses.field(
        default=True, metadata={"off": "A robot that arrives at a live target does not turn to look all round."}
    )
    """A robot that arrives at a live target turns in place, with scans at +90, +180 and +270 degrees; at every 45 where
    the field of view is below 90 degrees."""
    known_outline: bool = False
    """Strategies know where the world ends: beams of an expected gain stop at its outermost cells. By default what lies
    beyond counts as unknown."""
    scan_every_m: float = limit(0.0, high=1000)
    """A robot on its way makes a scan whenever it has driven this far since the last one, in metres; 0 is after every
    step. It also scans at its target, where it looks round, and where a step is refused."""
    arrival_m: float = limit(0.0, high=1000)
    """A target within this distance, in metres, that is no longer live counts as reached, also without +recheck."""
    frontier_connectivity: Literal[8, 4] = 8
    """A frontier cell has an unknown cell among this many neighbours: across edges and corners, or across edges alone.
    A robot without a clearance needs 4: it sees no cell that lies behind the inner corner of two walls."""
    min_frontier_cells: int = limit(1, require_whole, low=1, high=1000)
    """Groups of fewer frontier cells, that touch along edges or corners, are no frontier."""
    stop_at: float | None = limit(None, low=0.0001, high=1)
    """An episode ends as EXPLORED once this share of the cells that can be known is known, as in the curves; steps of
    0.0001."""
    return_home: bool = False
    """A robot that is done drives back to its start before the episode ends; its outcome is the same."""
    max_path_m: float | None = limit(None, high=1e6)
    """An episode ends as PATH_LIMIT before the step that would make its path longer than this, in metres."""
    max_time_s: float | None = limit(None, high=MOST_TIME_S)
    """An episode ends as TIME_LIMIT before the motion that would begin this late, in seconds, by the robot's clock."""
    max_steps: int | None = limit(None, require_whole, low=1, high=2**24)
    """An episode ends as STEP_LIMIT after this many steps; by default the larger of 20000 and the number of cells."""
    max_plans: int | None = limit(None, require_whole, low=1, high=2**24)
    """An episode ends as PLAN_LIMIT after this many plans; by default the larger of 20000 and the number of cells."""
    motion: Literal["lattice", "diff-drive"] = dataclasses.field(default="lattice", metadata={"short": True})
    """The robot goes from cell to cell in eight directions, or pursues its route as a differential drive
    with the robot's speeds and accelerations, and scans by the clock."""
    pose: Literal["true", "odometry", "icp", "icp+closing"] = dataclasses.field(
        default="true", metadata={"short": True}
    )
    """The robot is given its pose (true), takes it from its odometry, or corrects that by matching its scans (icp) and
    by closing loops."""
    odometry: Odometry = dataclasses.field(default_factory=Odometry, metadata={"short": True})

    def __post_init__(self) -> None:
        object.__setattr__(self, "odometry", as_record("odometry", self.odometry, Odometry))
        object.__setattr__(self, "pose", "true" if self.pose is True else self.pose)  # as YAML has it
        super().__post_init__()
        if self.motion != "lattice" and self.pose != "true":
            raise InputError(
                f"motion diff-drive is for a robot whose pose is given: pose must be true, got {self.pose}"
            )
        if self.motion != "lattice" and self.scan_every_m:
            raise InputError("rules.scan_every_m is for the lattice: motion diff-drive scans by robot.scan_period_s")

    @property
    def on_lattice(self) -> bool:
        """Return whether the robot is always in the middle of a cell, and knows which one."""
        return self.pose == "true" and self.motion == "lattice"

    def require_lattice(self, what: str) -> None:
        """Refuse other robots than those `on_lattice`, for what cannot do without."""
        if not self.on_lattice:
            name = "motion" if self.pose == "true" else "pose"
            wanted, got = {"motion": ("lattice", self.motion), "pose": ("true", self.pose)}[name]
            raise InputError(
                f"{what} of robots whose pose is given, on the lattice: {name} must be {wanted}, got {got}"
            )
