"""Settings of a trace run: the robot, its sensors' noise, and the thresholds that are options.

Plain Python: importing this loads neither jax nor numpy. Every number is a leaf of the compiled run: each sweep is a
single batch. The docstrings are the command line's help texts. All other numbers are `params.groups.Params`.
"""

import dataclasses
import math
from typing import ClassVar

from jexplore.config import NUMBER_BOUNDS, InputError, checked_names, require_kind, require_number, require_whole
from jexplore.rules import Odometry, Settings, limit


@checked_names
@dataclasses.dataclass(frozen=True)
class Robot(Settings):
    """Dimensions and limits of a robot."""

    HOLDS_ARRAYS: ClassVar[bool] = True

    name: str
    length_m: float = limit(low_open=True, high=10)
    width_m: float = limit(low_open=True, high=10)
    height_m: float = limit(low_open=True, high=10)
    max_slope_deg: float = limit(high=60)
    """Steepest ground that it climbs, degrees."""
    max_step_m: float = limit(high=1)
    """Highest step that it climbs, metres."""
    max_speed_m_s: float = limit(low_open=True, high=10)
    max_turn_rad_s: float = limit(low_open=True, high=10)
    scanner_height_m: float = limit(low_open=True, high=10)
    """Height of the downward scanner above the ground, metres."""
    scanner_x_m: float = limit(low=-5, high=5)
    """Distance of the downward scanner before the robot's middle, metres."""
    scanner_angle_deg: float = limit(low=10, high=75)
    """Mount of the downward scanner: angle from the vertical, degrees."""
    scan_height_m: float = limit(low=0.2, high=10)
    """Height of the scanner that looks ahead above the ground, metres."""
    scan_pitch_deg: float = limit(0.0, low=-20, high=20)
    """Mount of the scanner that looks ahead: downward pitch, degrees."""


ROBOTS = {
    "kamui": Robot("kamui", 0.70, 0.39, 0.74, 45.0, 0.20, 7 / 3.6, 1.5, 0.50, 0.20, 45.0, 0.70),
    "wheeled": Robot("wheeled", 0.45, 0.39, 0.50, 5.0, 0.03, 1.0, 2.0, 0.50, 0.20, 45.0, 0.45),
}
"""Name -> robot. `kamui` is the crawler of Mano et al., Table III; its step height and sensor mounts are ours."""


@checked_names
@dataclasses.dataclass(frozen=True)
class Noise(Odometry):
    """Errors of the sensors; those of the encoders are `jx.Odometry`."""

    range_m: float = limit(0.0, high=1)
    """The ranges of both scanners have this standard deviation, in metres."""
    invalid: float = limit(0.0, high=1)
    """A beam gives no number (NaN) with this probability."""
    attitude_deg: float = limit(0.1, high=10)
    """The attitude sensor has this standard deviation, in degrees."""
    beacon_m: float = limit(0.05, high=1)
    """The distance of the goal's beacon has this standard deviation, in metres."""


WHOLE = {"votes": 9, "helps": 100}
"""Thresholds that are whole numbers -> their largest value."""


@checked_names
@dataclasses.dataclass(frozen=True)
class Tuning(Settings):
    """Thresholds of perception and behaviour. Letters in brackets are those of Mano et al."""

    HOLDS_ARRAYS: ClassVar[bool] = True

    width_m: float = limit(0.39, low_open=True, high=1000)
    """A gap narrower than this reference width [W], in metres, is no opening, and no side of a triangle. The default is
    that of the narrowest robot, so that every robot makes the same map."""
    far_m: float = limit(0.0, high=1000)
    """Points farther away than this [D2], in metres, are left out of the triangles; less where the beams are too far
    apart on the walls. 0: 4 on courses, 8 in other worlds."""
    ahead_m: float = limit(1.0, low_open=True, high=1000)
    """The target point and the middle of the region that is watched lie this far ahead [L], in metres."""
    region_m: float = limit(2.4, low_open=True, high=1000)
    """The region that is watched for walls (the gray one) is this long, in metres: more than the widest side
    passage."""
    open_m: float = limit(0.0, high=1000)
    """A side without a wall within this [C1], in metres, is free space. 0: 2.5 on courses, whose hall is free space, 5
    in other worlds, whose rooms are places where ways part."""
    dead_end_m: float = limit(0.39, low_open=True, high=1000)
    """The way ahead is closed if both walls together are no farther than this [C2], in metres."""
    arrive_m: float = limit(0.3, low_open=True, high=1000)
    """A target is reached within this [C3], in metres."""
    leave_m: float = limit(0.5, high=1000)
    """A branch is taken this far beyond the radius of its triangle's circle [C4 less that radius], in metres."""
    circle: float = limit(1.5, low=1, low_open=True, high=3)
    """The search circle for links has this radius, in radii of the triangle's circle [k]."""
    obtuse_tol_deg: float = limit(10.0, high=90, high_open=True)
    """A triangle is kept if no angle is more than this above 90 degrees; the paper's letter is 0."""
    votes: int = limit(5, require_whole, low=1, high=WHOLE["votes"])
    """This many of the last nine scans, 1 to 9, must show a triangle before it is believed; 1 means no voting."""
    same_m: float = limit(0.4, low_open=True, high=1000)
    """Two circle centres nearer than this, in metres, are one."""
    tread_wave_m2: float = limit(2e-5, high=1000)
    """An obstacle is stairs if its height profile goes up and down about its slope with every tread by a variance above
    this [Vmax], in square metres."""
    inclination_deg: float = limit(5.0, low=1, high=45)
    """A change of the ground's inclination by more than this, in degrees, is an obstacle."""
    speed_m_s: float = limit(0.4, low_open=True, high=1000)
    """The robot approaches a target at this speed [Vc], in metres a second."""
    helps: int = limit(3, require_whole, low=1, high=WHOLE["helps"])
    """The run ends as STUCK after this many times of operator help since the last node."""
    turn_gain: float = limit(1.5, low_open=True, high=1000)
    """The robot turns at this rate for each radian of bearing of the target point [kw], in 1/s."""

    @property
    def region(self) -> tuple[float, float]:
        """Return where the watched region begins and ends, metres ahead."""
        return self.ahead_m / 2, self.ahead_m / 2 + self.region_m


MOST_NODES = int(NUMBER_BOUNDS["nodes"][1])
"""Of a map, at most; of links twice as many."""
BY_WORLD = {"open_m": (2.5, 5.0), "far_m": (4.0, 8.0)}
"""Thresholds whose 0 stands for another number -> that on courses, and in other worlds."""
LEVEL_SIGHT_M = 4.0
"""The scanner that looks ahead must see level ground no nearer than this, metres."""


def for_world(tuning: Tuning, *, is_course: bool) -> Tuning:
    """Replace thresholds of 0 by the numbers that they stand for.

    Args:
      tuning: `Tuning` of numbers; anything else is returned as it is.
      is_course: whether the world is a course, with the paper's hall; else a building with rooms.
    """
    if not isinstance(tuning, Tuning):
        return tuning
    own = {name: found[0 if is_course else 1] for name, found in BY_WORLD.items() if getattr(tuning, name) == 0}
    return dataclasses.replace(tuning, **own)


def require_tuning(tuning: Tuning) -> None:
    """Refuse thresholds that contradict each other.

    Raises:
      InputError: no `Tuning`, or naming the threshold and its value.
    """
    require_kind("tuning", tuning, Tuning)
    for name in BY_WORLD:
        require_number(f"tuning.{name}", getattr(tuning, name), low_open=True)
    for low, high in (("width_m", "open_m"), ("arrive_m", "open_m")):
        if getattr(tuning, low) >= getattr(tuning, high):
            got = f"{getattr(tuning, low):g} and {getattr(tuning, high):g}"
            raise InputError(f"tuning.{low} must be less than tuning.{high}, got {got}")


def require_robot(robot: Robot) -> None:
    """Refuse a robot whose scanner looks into the floor.

    Raises:
      InputError: naming the number.
    """
    down = math.tan(math.radians(robot.scan_pitch_deg))
    if down > 0 and (floor_m := robot.scan_height_m / down) < LEVEL_SIGHT_M:
        raise InputError(
            f"robot.scan_pitch_deg must let the scanner see {LEVEL_SIGHT_M:g} m: {robot.scan_height_m:g} m above the "
            f"ground, {robot.scan_pitch_deg:g} degrees down, it looks into the floor after {floor_m:.1f} m"
        )


def robot_of(name: str) -> Robot:
    """Make a robot by name, with other measures if given: `kamui`, `kamui:width_m=0.6`.

    Raises:
      InputError: no such robot or measure, or a value out of range.
    """
    base, _, rest = name.partition(":")
    if base not in ROBOTS:
        raise InputError(f"robot must be one of {', '.join(ROBOTS)}, got {base!r}")
    changed = {}
    numbers = [field.name for field in dataclasses.fields(ROBOTS[base]) if field.name != "name"]
    for part in rest.split(",") if rest else ():
        key, _, value = part.partition("=")
        if key not in numbers:
            raise InputError(f"robot {name!r}: there is no {key!r}; there are {', '.join(numbers)}")
        try:
            changed[key] = float(value)
        except ValueError:
            raise InputError(f"robot {name!r}: {key} must be a number, got {value!r}") from None
    robot = dataclasses.replace(ROBOTS[base], name=name, **changed)
    require_robot(robot)
    return robot
