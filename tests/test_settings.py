"""Thresholds, noise and robots out of range are refused in one line that names the number."""

import dataclasses
import math
import subprocess
import sys

import pytest
from ref.refusals import refused

from jexplore.driving.settings import ROBOTS, Noise, Tuning, for_world, require_robot, require_tuning

KAMUI = ROBOTS["kamui"]


def of_tuning(**values):
    require_tuning(dataclasses.replace(for_world(Tuning(), is_course=True), **values))


def of_noise(**values):
    dataclasses.replace(Noise(), **values)


def of_robot(**values):
    require_robot(dataclasses.replace(KAMUI, **values))


CHECKS = {"tuning": of_tuning, "noise": of_noise, "robot": of_robot}

# Name -> (outside, least, largest, outside); `ABOVE` where the bound itself is outside.
ABOVE = 1e-9
LEAST, MOST = 1e-6, 1000 * (1 + ABOVE)
BOUNDS = {
    "tuning.far_m": (0, ABOVE, 1000, MOST),
    "tuning.width_m": (0, LEAST, 2.4, 2.5),
    "tuning.ahead_m": (0, LEAST, 1000, MOST),
    "tuning.region_m": (0, LEAST, 1000, MOST),
    "tuning.open_m": (0.39, 0.4, 1000, MOST),
    "tuning.dead_end_m": (0, LEAST, 1000, MOST),
    "tuning.arrive_m": (0, LEAST, 2.4, 2.5),
    "tuning.leave_m": (-ABOVE, 0, 1000, MOST),
    "tuning.circle": (1, 1.001, 3, 3.001),
    "tuning.obtuse_tol_deg": (-ABOVE, 0, 89.9, 90),
    "tuning.votes": (0, 1, 9, 10),
    "tuning.helps": (0, 1, 100, 101),
    "tuning.same_m": (0, LEAST, 1000, MOST),
    "tuning.tread_wave_m2": (-ABOVE, 0, 1000, MOST),
    "tuning.inclination_deg": (0.99, 1, 45, 45.1),
    "tuning.speed_m_s": (0, LEAST, 1000, MOST),
    "tuning.turn_gain": (0, LEAST, 1000, MOST),
    "noise.range_m": (-ABOVE, 0, 1, 1.01),
    "noise.invalid": (-ABOVE, 0, 1, 1.01),
    "noise.attitude_deg": (-ABOVE, 0, 10, 10.01),
    "noise.length": (-ABOVE, 0, 0.5, 0.501),
    "noise.turn": (-ABOVE, 0, 0.5, 0.501),
    "noise.length_m_sqrt_rad": (-ABOVE, 0, 0.5, 0.501),
    "noise.heading_deg_sqrt_m": (-ABOVE, 0, 45, 45.1),
    "noise.slip": (-ABOVE, 0, 0.5, 0.501),
    "noise.beacon_m": (-ABOVE, 0, 1, 1.01),
    "noise.length_scale": (0, LEAST, 2, 2.01),
    "noise.turn_scale": (0, LEAST, 2, 2.01),
    "noise.heading_bias_deg_m": (-45.1, -45, 45, 45.1),
    "robot.length_m": (0, LEAST, 10, 10.01),
    "robot.width_m": (0, LEAST, 10, 10.01),
    "robot.height_m": (0, LEAST, 10, 10.01),
    "robot.max_slope_deg": (-ABOVE, 0, 60, 60.1),
    "robot.max_step_m": (-ABOVE, 0, 1, 1.01),
    "robot.max_speed_m_s": (0, LEAST, 10, 10.01),
    "robot.max_turn_rad_s": (0, LEAST, 10, 10.01),
    "robot.scanner_height_m": (0, LEAST, 10, 10.01),
    "robot.scanner_x_m": (-5.01, -5, 5, 5.01),
    "robot.scanner_angle_deg": (9.9, 10, 75, 75.1),
    "robot.scan_height_m": (0.19, 0.2, 10, 10.01),
    "robot.scan_pitch_deg": (-20.1, -20, 9.9, 20.1),
}


def test_every_number_has_bounds():
    fields = [
        f"{part}.{field.name}"
        for part, kind in (("tuning", Tuning), ("noise", Noise), ("robot", type(KAMUI)))
        for field in dataclasses.fields(kind)
    ]
    assert set(fields) == {*BOUNDS, "robot.name"}


@pytest.mark.parametrize("name", BOUNDS)
def test_bounds(name):
    part, field = name.split(".")
    below, least, largest, above = BOUNDS[name]
    for value in (least, largest):
        CHECKS[part](**{field: value})
    for value in (below, above, math.nan, math.inf, -math.inf, "1", None, True):
        assert name in refused(None, CHECKS[part], **{field: value})


def test_what_0_stands_for_depends_on_the_world():
    course, building = (for_world(Tuning(), is_course=is_course) for is_course in (True, False))
    assert (course.open_m, course.far_m) == (2.5, 4.0)
    assert (building.open_m, building.far_m) == (5.0, 8.0)
    assert dataclasses.replace(course, open_m=0.0, far_m=0.0) == Tuning()
    own = Tuning(open_m=3.0, votes=3)
    for is_course in (True, False):
        found = for_world(own, is_course=is_course)
        assert (found.open_m, found.votes) == (3.0, 3)


def test_messages_by_hand():
    for refuse, message in (
        (lambda: of_tuning(votes=2.5), "tuning.votes must be an integer from 1 to 9, got 2.5"),
        (lambda: of_noise(slip=0.6), "noise.slip must be a number at least 0 and at most 0.5, got 0.6"),
        (lambda: of_tuning(arrive_m=3.5, open_m=3), "tuning.arrive_m must be less than tuning.open_m, got 3.5 and 3"),
        (lambda: of_tuning(width_m=3, open_m=3), "tuning.width_m must be less than tuning.open_m, got 3 and 3"),
        (
            lambda: of_robot(scan_pitch_deg=10, scan_height_m=0.35),
            "robot.scan_pitch_deg must let the scanner see 4 m: 0.35 m above the ground, 10 degrees down, it looks "
            "into the floor after 2.0 m",
        ),
    ):
        assert refused(None, refuse) == message


def test_what_comes_with_the_package_passes():
    for is_course in (True, False):
        require_tuning(for_world(Tuning(), is_course=is_course))
    Noise()
    for name, robot in ROBOTS.items():
        require_robot(robot)
        assert robot.name == name


@pytest.mark.slow
def test_settings_load_no_jax():
    code = "import sys, jexplore.driving.settings; assert not {'jax', 'numpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
