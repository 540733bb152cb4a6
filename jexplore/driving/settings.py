"""Settings of a Behavioral Trace Map run: the robot, its sensors' noise, and every threshold of its perception.

Plain Python: importing this loads neither jax nor numpy. Every number is a leaf of the compiled run: a sweep over it is
one batch. The docstrings are the command line's help texts.
"""

import dataclasses

from jexplore.config import InputError, require_number, require_whole


@dataclasses.dataclass(frozen=True)
class Robot:
    """What a robot is and what it can do."""

    name: str
    length_m: float
    width_m: float
    height_m: float
    max_slope_deg: float
    """Steepest ground that it climbs, degrees."""
    max_step_m: float
    """Highest step that it climbs, metres."""
    max_speed_m_s: float
    max_turn_rad_s: float
    scanner_height_m: float
    """Height of the downward scanner above the ground, metres."""
    scanner_x_m: float
    """How far the downward scanner is before the robot's middle, metres."""
    scanner_angle_deg: float
    """Mount of the downward scanner: angle from the vertical, degrees."""


ROBOTS = {
    "kamui": Robot("kamui", 0.70, 0.39, 0.74, 45.0, 0.20, 7 / 3.6, 1.5, 0.50, 0.20, 45.0),
    "wheeled": Robot("wheeled", 0.45, 0.39, 0.50, 5.0, 0.03, 1.0, 2.0, 0.50, 0.20, 45.0),
}
"""Name -> robot. `kamui` is the crawler of Mano et al., Table III; its step height and sensor mounts are ours."""


@dataclasses.dataclass(frozen=True)
class Noise:
    """Errors of the sensors."""

    range_m: float = 0.0
    """Standard deviation of both scanners' ranges, metres."""
    invalid: float = 0.0
    """Probability that a beam gives no number (NaN)."""
    attitude_deg: float = 0.1
    """Standard deviation of the attitude sensor, degrees."""
    odometry: float = 0.01
    """Standard deviation of an encoder step, relative to the step."""
    heading_deg_sqrt_m: float = 0.5
    """Standard deviation of the odometry's heading after one metre, degrees; it grows with the root of the path."""
    slip: float = 0.02
    """Share of every turn that the tracks lose to slip, which the encoders do not notice."""


@dataclasses.dataclass(frozen=True)
class Tuning:
    """Thresholds of perception and behaviour. Letters in brackets are those of Mano et al."""

    width_m: float = 0.39
    """Reference width [W]: what is narrower is no opening, and no side of a triangle. That of the narrowest robot, so
    that every robot makes the same map."""
    near_m: float = 0.3
    """Scan points nearer ahead than this are left out of the triangles [D1], metres."""
    far_m: float = 4.0
    """Scan points farther ahead than this are left out of the triangles [D2], metres; less where the beams are too far
    apart on the walls."""
    ahead_m: float = 1.0
    """Look-ahead: distance of the target point and of the middle of the region that is watched [L], metres."""
    region_m: float = 2.4
    """Length of the region that is watched for walls (the gray one), metres: more than the widest side passage."""
    open_m: float = 2.5
    """A side without a wall within this is free space [C1], metres."""
    dead_end_m: float = 0.39
    """The way ahead is closed if both walls together are no farther than this [C2], metres."""
    arrive_m: float = 0.3
    """A target is reached within this [C3], metres."""
    leave_m: float = 0.5
    """A branch is taken this far beyond the radius of its triangle's circle [C4 less that radius], metres."""
    circle: float = 1.5
    """Radius of the search circle for links, in radii of the triangle's circle [k]."""
    obtuse_tol_deg: float = 10.0
    """A triangle is kept if no angle is more than this above 90 degrees; the paper's letter is 0."""
    votes: int = 5
    """Scans of the last nine that must show a triangle before it is believed, 1 to 9; 1: no voting."""
    same_m: float = 0.4
    """Two circle centres nearer than this are one, metres."""
    variance_max_m2: float = 3e-4
    """Residual variance of a height profile above which an obstacle is stairs [Vmax], square metres."""
    inclination_deg: float = 5.0
    """A change of the ground's inclination by more than this is an obstacle, degrees."""
    speed_m_s: float = 0.4
    """Speed of approach [Vc], metres a second."""
    turn_gain: float = 1.5
    """Turn rate a radian of bearing of the target point [kw], 1 / s."""


def require_tuning(tuning: Tuning) -> None:
    """Refuse thresholds that are out of range or contradict each other.

    Args:
      tuning: `Tuning` of numbers.

    Raises:
      InputError: naming the threshold and its value.
    """
    for field in dataclasses.fields(tuning):
        value = getattr(tuning, field.name)
        if field.name == "votes":
            require_whole("tuning.votes", value, low=1, high=9)
        else:
            above = field.name not in ("near_m", "obtuse_tol_deg", "leave_m", "variance_max_m2")
            require_number(f"tuning.{field.name}", value, low_open=above, high=1000)
    for low, high in (("near_m", "far_m"), ("width_m", "open_m"), ("arrive_m", "open_m")):
        if getattr(tuning, low) >= getattr(tuning, high):
            got = f"{getattr(tuning, low):g} and {getattr(tuning, high):g}"
            raise InputError(f"tuning.{low} must be less than tuning.{high}, got {got}")
    require_number("tuning.circle", tuning.circle, low=1, low_open=True, high=3)
    require_number("tuning.obtuse_tol_deg", tuning.obtuse_tol_deg, high=90, high_open=True)
    require_number("tuning.inclination_deg", tuning.inclination_deg, low=1, high=45)


def require_noise(noise: Noise) -> None:
    """Refuse noise that is out of range.

    Raises:
      InputError: naming the number.
    """
    for name, high in (("range_m", 1), ("invalid", 1), ("attitude_deg", 10), ("odometry", 0.5), ("slip", 0.5)):
        require_number(f"noise.{name}", getattr(noise, name), high=high)
    require_number("noise.heading_deg_sqrt_m", noise.heading_deg_sqrt_m, high=45)


def require_robot(robot: Robot) -> None:
    """Refuse a robot that cannot be.

    Raises:
      InputError: naming the number.
    """
    for name in ("length_m", "width_m", "height_m", "max_speed_m_s", "max_turn_rad_s", "scanner_height_m"):
        require_number(f"robot.{name}", getattr(robot, name), low_open=True, high=10)
    require_number("robot.max_slope_deg", robot.max_slope_deg, high=60)
    require_number("robot.max_step_m", robot.max_step_m, high=1)
    require_number("robot.scanner_x_m", robot.scanner_x_m, low=-5, high=5)
    require_number("robot.scanner_angle_deg", robot.scanner_angle_deg, low=10, high=75)
