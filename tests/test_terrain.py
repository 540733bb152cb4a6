"""Ground with height: pencil profiles, parity with scipy and brute force, laws of attitude and of looking down."""

import itertools
import math

import jax
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from jexplore.driving import vehicle
from jexplore.driving.building.terrain import (
    CONTACTS,
    FINER,
    MAX_DOWN_M,
    Terrain,
    attitude,
    height_at,
    look_at,
    terrain_of,
    turned,
)
from jexplore.driving.settings import ROBOTS

CELL_M = 0.05
GROUND_SHAPE = 80, 130
LENGTH_M, WIDTH_M = 0.7, 0.39
TEN = math.radians(10)


def along_x(heights, rows=30):
    """Ground whose height depends on x alone: `[rows, len(heights)]`."""
    return np.tile(np.asarray(heights, np.float32), (rows, 1))


def ground(elevation):
    """Terrain of cells of `CELL_M`, made as large as all others: one program for all."""
    elevation = np.atleast_2d(elevation)
    short = [(0, size - n) for size, n in zip(GROUND_SHAPE, elevation.shape)]
    return terrain_of(np.pad(elevation, short, mode="edge").astype(np.float32), CELL_M)


def stairs_of(tread_cells, riser_m, n_steps, level_cells=30):
    steps = np.repeat(np.arange(n_steps + 1), tread_cells) * riser_m
    return np.concatenate([np.zeros(level_cells), steps[tread_cells:], np.full(level_cells, n_steps * riser_m)])


def slope_of(angle_rad, n_cells=40, level_cells=30):
    """Heights at the centres of cells; the slope begins and ends at centres."""
    up = np.arange(n_cells + 1) * CELL_M * math.tan(angle_rad)
    return np.concatenate([np.zeros(level_cells), up, np.full(level_cells, up[-1])])


def exact(terrain, x, y):
    """Heights by scipy, float64."""
    height, spacing = np.asarray(terrain.height_m, np.float64), float(terrain.spacing_m)
    v, u = ((np.arange(n) + 0.5) * spacing for n in height.shape)
    x, y = np.clip(x, u[0], u[-1]), np.clip(y, v[0], v[-1])
    return RegularGridInterpolator((v, u), height)(np.stack([y, x], -1))


def test_level_ground_needs_no_grid():
    for elevation in (None, np.zeros((30, 40), np.float32)):
        terrain = terrain_of(elevation, 0.1)
        assert terrain.height_m.shape == (2, 2)
        assert terrain.height_m.dtype == np.float32
        np.testing.assert_array_equal(height_at(terrain, np.array([-3.0, 0, 1, 50]), np.array([0.0, 2, -1, 9])), 0)


def test_a_slope_of_few_cells_by_hand():
    heights = np.array([0, 0, 8, 16, 24, 24.0])
    terrain = terrain_of(along_x(heights, rows=1), 1.0)
    assert float(terrain.spacing_m) == 1 / FINER
    row = [0, 0, 0, 0, 0, 0, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 24, 24, 24, 24, 24, 24]
    np.testing.assert_array_equal(terrain.height_m, [row] * FINER)
    x = np.linspace(-1, 7, 400)
    centres = np.arange(6) + 0.5
    fine = (np.arange(24) + 0.5) / FINER
    np.testing.assert_allclose(terrain.height_m[0], np.interp(fine, centres, heights), atol=1e-6)
    np.testing.assert_allclose(height_at(terrain, x, np.full(400, 0.5)), np.interp(x, fine, row), atol=1e-5)


def test_steps_stay_at_the_edges_of_cells():
    terrain = terrain_of(along_x([0, 0, 4, 4, 12, 12], rows=2), 1.0)
    np.testing.assert_array_equal(terrain.height_m, np.repeat([[0, 0, 4, 4, 12, 12]], 4, axis=1).repeat(8, axis=0))
    x = np.array([1.5, 1.875, 1.9375, 2.0, 2.125, 2.5, 3.9, 4.0, 4.1])
    want = [0, 0, 1, 2, 4, 4, 4 + 0.1 * 8, 8, 12 - 0.1 * 8]
    np.testing.assert_allclose(height_at(terrain, x, np.full(9, 1.0)), want, atol=1e-5)


def test_an_uneven_rise_is_a_step_and_a_nearly_even_one_is_not():
    """Rises of neighbouring cells may differ by a quarter of the larger."""
    uneven = terrain_of(along_x([0, 0, 1, 3, 3, 3], rows=1), 1.0).height_m[0]
    np.testing.assert_array_equal(uneven, np.repeat([0, 0, 1, 3, 3, 3], 4))
    even = terrain_of(along_x([0, 0, 3, 7, 7, 7], rows=1), 1.0).height_m[0]
    want = [0] * 6 + [0.375, 1.125, 1.875, 2.625, 3.5, 4.5, 5.5, 6.5] + [7] * 10
    np.testing.assert_array_equal(even, want)
    peak = terrain_of(along_x([0, 1, 0, 0], rows=1), 1.0).height_m[0]  # up and down: no rise goes on
    np.testing.assert_array_equal(peak, np.repeat([0, 1, 0, 0], 4))


def of_heights(height_m, spacing_m):
    height_m = np.array(height_m, np.float32)
    return Terrain(height_m=height_m, spacing_m=np.float32(spacing_m), peak_m=height_m.max())


def test_heights_are_scipys():
    rng = np.random.default_rng(2)
    terrain = of_heights(rng.normal(size=(7, 11)), 0.25)
    x, y = rng.uniform(-0.5, 3.2, 500), rng.uniform(-0.5, 2.2, 500)  # beyond the edges too
    np.testing.assert_allclose(height_at(terrain, x, y), exact(terrain, x, y), atol=1e-5)


one_attitude = jax.jit(attitude)
one_look_at = jax.jit(look_at)


def stands(terrain, x, y, heading=0.0, length_m=LENGTH_M, width_m=WIDTH_M):
    pose = np.float32(x), np.float32(y), np.float32(heading)
    return [float(v) for v in one_attitude(terrain, pose, np.float32(length_m), np.float32(width_m))]


def supported(terrain, pose, length_m, width_m):
    """By brute force, a track: of lines through two contacts with none above, that which is lowest at the middle."""
    x, y, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    u = ((np.arange(CONTACTS) + 0.5) / CONTACTS - 0.5) * length_m
    found = []
    for v in (width_m / 2, -width_m / 2):
        z = exact(terrain, x + u * cos - v * sin, y + u * sin + v * cos)
        lines = []
        for i, j in itertools.combinations(range(CONTACTS), 2):
            slope = (z[j] - z[i]) / (u[j] - u[i])
            height = z[i] - slope * u[i]
            if (z <= height + slope * u + 1e-7).all():
                lines.append((height, slope))
        found.append(min(lines))
    (left, left_slope), (right, right_slope) = found
    return -math.atan((left_slope + right_slope) / 2), math.atan2(left - right, width_m), (left + right) / 2


@pytest.mark.jit
def test_level_ground():
    assert stands(terrain_of(None, 0.1), 3.0, 2.0, 1.0) == [0, 0, 0, 0]
    raised = ground(0.25)
    np.testing.assert_allclose(stands(raised, 1.0, 1.0, 1.0), [0, 0, 0.25, 0], atol=1e-6)


@pytest.mark.jit
@pytest.mark.parametrize("degrees", [2, 45])
def test_on_a_slope_the_pitch_is_its_angle_and_nose_up_is_negative(degrees):
    angle = math.radians(degrees)
    terrain = ground(slope_of(angle))
    x = (30.5 + 20) * CELL_M  # half way up
    height = 20 * CELL_M * math.tan(angle)
    rise = LENGTH_M / CONTACTS * math.tan(angle)
    up = stands(terrain, x, 0.75, 0.0)
    np.testing.assert_allclose(up, [-angle, 0, height, rise], atol=2e-5)
    down = stands(terrain, x, 0.75, math.pi)
    np.testing.assert_allclose(down, [angle, 0, height, rise], atol=2e-5)


@pytest.mark.jit
def test_attitude_is_that_of_brute_force():
    rng = np.random.default_rng(3)
    stairs = along_x(stairs_of(5, 0.15, 4), rows=80)
    bumps = rng.normal(scale=0.05, size=stairs.shape)
    plateaus = np.kron(rng.normal(scale=0.1, size=(16, stairs.shape[1] // 5 + 1)), np.ones((5, 5)))[
        :, : stairs.shape[1]
    ]
    for elevation in (stairs, bumps, plateaus, stairs + plateaus):
        terrain = ground(elevation)
        for _ in range(12):
            length, width = (np.float32(v) for v in (rng.uniform(0.3, 0.9), rng.uniform(0.2, 0.6)))
            x, y, heading = (np.float32(v) for v in (rng.uniform(1, 3), rng.uniform(1, 3), rng.uniform(-4, 4)))
            got = one_attitude(terrain, (x, y, heading), length, width)
            np.testing.assert_allclose(got[:3], supported(terrain, (x, y, heading), length, width), atol=3e-4)


@pytest.mark.jit
def test_beyond_the_range_and_upwards_there_is_no_ground():
    direction = np.array([[0, 0, -1], [0, 0, 1], [1, 0, 0]], np.float32)
    level = terrain_of(None, 0.1)
    np.testing.assert_array_equal(one_look_at(level, (1.0, 1.0, MAX_DOWN_M + 0.01), direction), [np.inf] * 3)
    seen = one_look_at(level, (1.0, 1.0, MAX_DOWN_M - 0.01), direction)
    assert float(seen[0]) == pytest.approx(MAX_DOWN_M - 0.01, abs=5e-4)
    assert np.isinf(seen[1:]).all()


def marched(terrain, origin, direction, step=4e-4):
    """By small steps, float64."""
    along = np.arange(1, int(MAX_DOWN_M / step) + 1) * step
    place = np.asarray(origin, np.float64) + along[:, None, None] * np.asarray(direction, np.float64)
    below = place[..., 2] <= exact(terrain, place[..., 0], place[..., 1])
    return np.where(below.any(0), along[below.argmax(0)], np.inf)


@pytest.mark.jit
def test_ranges_to_slopes_and_stairs_are_those_of_small_steps():
    robot = ROBOTS["kamui"]
    down = np.asarray(vehicle.down_directions(robot))
    grazed = beams = 0
    for heights in (slope_of(TEN), stairs_of(5, 0.1, 8), stairs_of(6, 0.2, 6), -slope_of(math.radians(30))):
        terrain = ground(heights)
        for x, heading in itertools.product((1.6, 3.1), (0.0, math.pi, 0.5)):
            pitch, roll, height, _ = stands(terrain, x, 1.5, heading)
            direction = turned(down, pitch, roll, heading)
            origin = tuple(np.float32(v) for v in (x, 1.5, height + 0.6))
            got, want = (
                np.minimum(np.asarray(ranges), 9)
                for ranges in (one_look_at(terrain, origin, direction), marched(terrain, origin, direction))
            )
            # A beam may pass an edge so closely that two of its samples lie on both sides: it sees the ground behind.
            assert (got >= want - 1e-3).all()
            grazed += int((np.abs(got - want) > 1e-3).sum())
            beams += got.size
    assert grazed <= 0.01 * beams
