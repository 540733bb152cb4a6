"""The robot's sensors and encoders: the scanner over ground that rises and falls, the beacon, errors that add up."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.driving import vehicle
from jexplore.driving.building.terrain import terrain_of
from jexplore.driving.building.walls import walls_of
from jexplore.driving.params.tree import P
from jexplore.driving.records import Building, Senses
from jexplore.driving.settings import ROBOTS, Noise
from jexplore.driving.vehicle import ANGLES_RAD, BEAMS

pytestmark = pytest.mark.jit

CELL_M = 0.1
SLOPE_DEG = 10.0
FOOT_M, TOP_M = 4.0, 8.0  # a ramp rises between them
STILL = Noise(attitude_deg=0, length=0, turn=0, heading_deg_sqrt_m=0, slip=0, beacon_m=0)
NONE = jax.tree.map(jnp.zeros_like, vehicle.draw_one(jax.random.key(0), Noise()))
LOW = dataclasses.replace(ROBOTS["kamui"], name="", scan_height_m=0.35)
SENSE = jax.jit(vehicle.read_sensors)
LEVELLED = jax.jit(vehicle.level_scan)
MOVE = jax.jit(vehicle.move)


def height(x):
    return np.tan(np.radians(SLOPE_DEG)) * (np.clip(x, FOOT_M, TOP_M) - FOOT_M)


def hall(*, ramp=True, length_m=16.0, width_m=8.0, walls=(), goal=(math.nan, math.nan)):
    """A hall whose ground rises along x between `FOOT_M` and `TOP_M`."""
    rows, cols = round(width_m / CELL_M), round(length_m / CELL_M)
    occupied = np.zeros((rows, cols), bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    for wall in walls:
        occupied[wall] = True
    level = np.tile(height((np.arange(cols) + 0.5) * CELL_M), (rows, 1))
    return Building(
        walls=walls_of(occupied, CELL_M),
        terrain=terrain_of(level.astype(np.float32) if ramp else None, CELL_M),
        goal=np.array(goal, np.float32),
        marks=np.zeros((0, 3), np.float32),
    )


def seen(building, pose, robot=LOW, noise=STILL, draws=NONE):
    body = vehicle.initial_body(building, robot, jnp.asarray(pose, jnp.float32))
    senses = SENSE(draws, building, robot, noise, body)
    level, is_ground = LEVELLED(senses, robot)
    return body, senses, np.asarray(level.ranges_m), np.asarray(is_ground)


def test_a_ramp_ahead_looks_like_a_wall_where_it_is_as_high_as_the_scanner():
    _, senses, level_m, is_ground = seen(hall(), (1.0, 4.0, 0.0))
    at_m = FOOT_M + LOW.scan_height_m / math.tan(math.radians(SLOPE_DEG)) - 1.0
    for degrees in (-20, 0, 20):  # a line across the hall
        beam = 90 + degrees
        assert senses.ranges_m[beam] == pytest.approx(at_m / math.cos(math.radians(degrees)), abs=0.02)
    np.testing.assert_allclose(level_m, senses.ranges_m, rtol=1e-6)
    assert not is_ground.any()


def test_on_the_ramp_it_looks_along_it_and_distances_are_those_of_the_plan():
    building = hall(length_m=8.0)
    body, senses, level_m, is_ground = seen(building, (6.0, 4.0, 0.0))
    assert math.degrees(body.pitch) == pytest.approx(-SLOPE_DEG, abs=0.05)
    mount_m = LOW.scan_height_m * math.sin(body.pitch)
    assert senses.ranges_m[90] == pytest.approx((1.9 - mount_m) / math.cos(body.pitch), abs=0.01)
    assert level_m[90] == pytest.approx(1.9 - mount_m, abs=0.01)
    assert not is_ground.any()


def test_downhill_the_floor_is_seen_and_taken_for_ground():
    body, senses, level_m, is_ground = seen(hall(), (5.0, 4.0, math.pi))
    assert math.degrees(body.pitch) == pytest.approx(SLOPE_DEG, abs=0.05)
    mount = 5.0 + LOW.scan_height_m * math.sin(-body.pitch), height(5.0) + LOW.scan_height_m * math.cos(body.pitch)
    assert senses.ranges_m[90] == pytest.approx(mount[1] / math.sin(math.radians(SLOPE_DEG)), abs=0.03)
    assert is_ground[90]
    assert np.isnan(level_m[90])
    # To its sides it sees the walls.
    for beam in (0, BEAMS - 1):
        assert not is_ground[beam]
        assert level_m[beam] == pytest.approx(3.9, abs=0.02)


def test_a_tilted_mount_looks_into_the_floor():
    down = dataclasses.replace(LOW, scan_pitch_deg=5.0)
    _, senses, level_m, is_ground = seen(hall(ramp=False), (1.0, 4.0, 0.0), down)
    assert senses.ranges_m[90] == pytest.approx(0.35 / math.sin(math.radians(5)), abs=0.02)
    assert is_ground[90]
    assert np.isnan(level_m[90])


@pytest.mark.parametrize(("pitch_deg", "roll_deg"), [(-30.0, 20.0), (15.0, -12.0)])
def test_what_is_level_lies_where_the_point_does(pitch_deg, roll_deg):
    """Every beam as a vector, turned by hand."""
    pitch, roll = math.radians(pitch_deg), math.radians(roll_deg)
    senses = Senses(jnp.full(BEAMS, 2.0), jnp.zeros(13), jnp.float32(pitch), jnp.float32(roll), jnp.float32(9))
    level, is_ground = LEVELLED(senses, LOW)
    beams = np.stack([np.cos(ANGLES_RAD), np.sin(ANGLES_RAD), np.zeros(BEAMS)])
    about_x = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    about_y = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
    points = 2.0 * about_y @ about_x @ beams
    z = points[2] + LOW.scan_height_m * math.cos(pitch) * math.cos(roll)
    sure = np.abs(z - P.sensing.floor_m) > 1e-4
    np.testing.assert_array_equal(np.asarray(is_ground)[sure], (z < P.sensing.floor_m)[sure])
    kept = ~np.asarray(is_ground)
    np.testing.assert_allclose(np.asarray(level.ranges_m)[kept], np.hypot(*points[:2])[kept], rtol=1e-5)


@pytest.mark.parametrize(
    ("place", "off_m"),
    [((5.5, 4.0), 0.5), ((5.0, 4.95), 0.95), ((6.05, 4.0), math.inf), ((4.45, 4.0), math.inf)],
    ids=["near", "to the side", "too far", "behind a wall"],
)
def test_the_beacon_is_heard_within_a_metre_and_not_through_walls(place, off_m):
    building = hall(ramp=False, walls=[np.s_[30:50, 46:48]], goal=place)
    _, senses, _, _ = seen(building, (5.0, 4.0, 0.3))
    assert float(senses.beacon_m) == pytest.approx(off_m, abs=1e-5)


def test_the_beacon_has_noise_and_no_goal_has_none():
    draws = dataclasses.replace(NONE, beacon=jnp.float32(2.0))
    noise = dataclasses.replace(STILL, beacon_m=0.1)
    _, senses, _, _ = seen(hall(ramp=False, goal=(5.5, 4.0)), (5.0, 4.0, 0.0), noise=noise, draws=draws)
    assert float(senses.beacon_m) == pytest.approx(0.7)
    _, senses, _, _ = seen(hall(ramp=False), (5.0, 4.0, 0.0), noise=noise, draws=draws)
    assert float(senses.beacon_m) == math.inf


def odometry(noise, v, omega, steps=50):
    building = hall(ramp=False)
    body, estimate, gone_m = vehicle.initial_body(building, LOW, jnp.array([2.0, 4.0, 0.0])), jnp.zeros(3), 0.0
    senses = vehicle.read_sensors(NONE, building, LOW, STILL, body)
    for _ in range(steps):
        body, estimate, step_m = MOVE(NONE, building, LOW, noise, body, estimate, senses, v, omega)
        gone_m += float(step_m)
    return body, np.asarray(estimate), gone_m


def test_scales_of_length_and_of_turns():
    body, estimate, gone_m = odometry(dataclasses.replace(STILL, length_scale=0.9), 0.4, 0.0)
    assert float(body.path_m) == pytest.approx(2.0, rel=1e-5)
    assert gone_m == pytest.approx(1.8, rel=1e-5)
    np.testing.assert_allclose(estimate, [1.8, 0, 0], atol=1e-5)
    body, estimate, _ = odometry(dataclasses.replace(STILL, turn_scale=1.05), 0.0, 0.3)
    assert float(body.pose[2]) == pytest.approx(1.5, rel=1e-5)
    np.testing.assert_allclose(estimate, [0, 0, 1.575], atol=1e-5)


def test_a_bias_turns_the_heading_by_the_metre_and_not_in_place():
    noise = dataclasses.replace(STILL, heading_bias_deg_m=3.0)
    for v, want in ((0.4, 6.0), (-0.2, 3.0), (0.0, 0.0)):
        _, estimate, _ = odometry(noise, v, 0.0)
        assert math.degrees(estimate[2]) == pytest.approx(want, abs=1e-3)


def test_whether_beams_are_missed_is_drawn_only_where_they_may_be():
    keys = jax.random.split(jax.random.key(2), 3)
    never, some = (vehicle.draw(keys, dataclasses.replace(STILL, invalid=share)) for share in (0.0, 0.3))
    assert np.all(np.asarray(never.missing) >= 1)
    assert 0.4 < np.mean(some.missing) < 0.6
    assert len(np.unique(np.asarray(some.missing))) > 500
    for name in ("ranges", "down", "attitude", "encoders", "beacon"):
        np.testing.assert_array_equal(getattr(never, name), getattr(some, name))
        assert len(np.unique(getattr(some, name))) == np.size(getattr(some, name))
