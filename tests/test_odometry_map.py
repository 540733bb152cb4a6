"""Grid maps drawn by odometry: what they show of a room, and how broken they are."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts.drift.odometry_map import occupied_centres, odometry_map

from jexplore.driving.batch import Driven
from jexplore.driving.settings import Noise
from jexplore.studies.traces.job import prepare_trace
from jexplore.studies.traces.recording import scans_of
from jexplore.worlds.readers.scans import ScanLog
from jexplore.worlds.world import World

SIDE = 5.0  # of a square room, metres
ANGLES = np.radians(np.arange(-90.0, 91.0, 2.0))
N = 24


def room(origin_m=(0.0, 0.0)):
    """A square room inside a ring of one cell."""
    occupied = np.ones((52, 52), bool)
    occupied[1:-1, 1:-1] = False
    return World(occupied=occupied, cell_m=0.1, name="room", origin_m=origin_m)


def to_walls(poses, angles):
    """Distances to the walls of the room from `[n, 3]` poses, by plain geometry: `[n, B]`."""
    angle = poses[:, 2:] + angles
    found = np.full(angle.shape, np.inf)
    for at, direction in ((poses[:, :1], np.cos(angle)), (poses[:, 1:2], np.sin(angle))):
        wall = np.where(direction > 0, 0.1 + SIDE, 0.1)
        found = np.fmin(found, np.divide(wall - at, direction, out=np.full(angle.shape, np.inf), where=direction != 0))
    return found


def log_of(odometry=None, seed=0):
    """Scans all over the room; what the robot takes itself to be is a function of the true poses."""
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(1.0, 4.0, (N, 2)), np.linspace(0, 2 * math.pi, N)])
    ranges = to_walls(poses, ANGLES)
    return ScanLog(poses, poses if odometry is None else odometry(poses), ranges, ANGLES, np.arange(N) * 1.0, 8.0)


def turned(poses, deg, x_m, y_m):
    a = math.radians(deg)
    x, y, heading = poses.T
    return np.column_stack(
        [math.cos(a) * x - math.sin(a) * y + x_m, math.sin(a) * x + math.cos(a) * y + y_m, heading + a]
    )


def near_walls(points):
    """Share of points within 0.1 m of the room's walls: between two squares, but for the corners of the outer one."""
    inside, outside = (np.abs(points - 0.1 - SIDE / 2).max(axis=1) - SIDE / 2 + margin for margin in (0.1, -0.1))
    return np.mean((inside >= 0) & (outside <= 0))


def test_a_room_as_it_is():
    found = odometry_map(log_of(), room())
    assert found.on_wall == 1.0
    assert found.doubled == 0.0
    assert math.hypot(found.move.x_m, found.move.y_m) < 0.1
    centres = occupied_centres(found.map)
    off = np.min([abs(centres - 0.05), abs(centres - SIDE - 0.15)], axis=0).min(axis=1)
    assert off.max() <= 0.1 + 1e-9  # in the wall, or in the cell before it


def test_half_of_the_scans_half_a_metre_off():
    """Walls across the shift are drawn twice, those along it are not: half of the wall."""
    found = odometry_map(log_of(lambda poses: poses + np.outer(np.arange(N) % 2, [0.5, 0.0, 0.0])), room())
    assert found.doubled == pytest.approx(0.5, abs=0.03)
    assert found.on_wall < 0.85
    shifts = [(x_m, y_m) for x_m in np.linspace(-0.6, 0.2, 17) for y_m in np.linspace(-0.1, 0.1, 5)]
    assert found.on_wall > max(near_walls(occupied_centres(found.map) + shift) for shift in shifts) - 0.02


@pytest.mark.parametrize(("shift", "doubled"), [((0.5, 0.0), 1.0), ((0.0, 0.5), 0.0)])
def test_only_what_is_off_across_a_wall_doubles_it(shift, doubled):
    """The robot looks at one wall, straight ahead on +x."""
    poses = np.column_stack([np.full(N, 3.5), np.linspace(2.2, 2.8, N), np.zeros(N)])
    angles = np.radians(np.arange(-20.0, 21.0))
    odometry = poses + np.outer(np.arange(N) % 2, [*shift, 0.0])
    log = ScanLog(poses, odometry, to_walls(poses, angles), angles, np.arange(N) * 1.0, 8.0)
    assert odometry_map(log, room()).doubled == doubled


@settings(max_examples=15)
@given(st.floats(-40, 40), st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 99))
def test_a_map_that_is_turned_and_shifted_as_a_whole_is_right(deg, x_m, y_m, seed):
    found = odometry_map(log_of(lambda poses: turned(poses, deg, x_m, y_m), seed), room())
    assert found.on_wall > 0.97
    place = turned(np.array([[2.5, 2.5, 0.0]]), deg, x_m, y_m)[0]
    assert math.dist(found.move.place(*place[:2]), (2.5, 2.5)) < 0.1


@pytest.mark.jit
def test_scans_of_a_run():
    """As plain geometry has them, in the world's frame; the noise is that of the setting."""
    world = room((10.0, -5.0))
    plan = prepare_trace(world, start=(12.0, -3.0, 0.0), noise=Noise(attitude_deg=0.0))
    poses = np.column_stack([np.linspace(1.5, 3.5, 11), np.full(11, 2.2), np.linspace(0, 3, 11)]).astype(np.float32)
    way = Driven(poses, poses + np.float32([0.1, 0.0, 0.0]), np.zeros(11, np.int32), np.zeros(11, np.float32))
    log = scans_of(plan, way, every=2)
    np.testing.assert_allclose(log.ranges, to_walls(poses[::2].astype(float), log.angles_rad), atol=1e-4)
    np.testing.assert_allclose(log.poses, poses[::2] + np.array([10.0, -5.0, 0.0]), atol=1e-5)
    np.testing.assert_allclose(log.odometry - log.poses, np.broadcast_to([0.1, 0.0, 0.0], (6, 3)), atol=1e-5)
    np.testing.assert_allclose(log.times, np.arange(0, 11, 2) * 0.1)

    noisy = dataclasses.replace(plan, swept={"noise.range_m": np.array([0.0, 0.05])}, settings=2)
    np.testing.assert_array_equal(scans_of(noisy, way, every=2).ranges, log.ranges)
    off = scans_of(noisy, way, setting=1, every=2).ranges - log.ranges
    assert 0.04 < off.std() < 0.06
    assert not np.array_equal(off, scans_of(noisy, way, setting=1, run=1, every=2).ranges - log.ranges)

    blind = dataclasses.replace(plan, swept={"noise.invalid": np.array([1.0])})
    assert not scans_of(blind, way).ranges.any()
