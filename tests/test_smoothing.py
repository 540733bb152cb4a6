"""Readings averaged as their noise asks for: what they tell of the noise, and what stays as it is."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.driving.sensing import smoothing
from jexplore.driving.vehicle import ANGLES_RAD, BEAMS

pytestmark = pytest.mark.jit
SCAN, SHARES = jax.jit(smoothing.smooth_ranges), jax.jit(smoothing.mean_weights)
AGE = jnp.arange(31, -1, -1)


def wall(ahead_m, right_m):
    """Ranges between a wall ahead and one on the right, and nothing on the left."""
    cos, sin = np.cos(ANGLES_RAD), np.sin(ANGLES_RAD)
    with np.errstate(divide="ignore"):
        ahead = np.where(cos > 1e-6, ahead_m / cos, np.inf)
        right = np.where(sin < -1e-6, right_m / -sin, np.inf)
    ranges = np.minimum(ahead, right)
    return np.where(ranges < 8, ranges, np.inf).astype(np.float32)


def test_quiet_readings_are_taken_as_they_are():
    rng = np.random.default_rng(0)
    ramp = np.radians(np.concatenate([np.zeros(10), np.linspace(0, 14, 17), np.full(5, 14)]))  # a body that tips
    shares = SHARES(jnp.asarray(ramp + np.radians(rng.normal(scale=0.1, size=32)), jnp.float32), AGE)
    np.testing.assert_array_equal(shares, np.eye(32)[31])


@pytest.mark.parametrize(("sd_deg", "few", "many"), [(0.6, 2, 5), (1.0, 7, 12), (3.0, 16, 16)])
def test_noisy_ones_are_averaged_over_as_many_as_it_takes(sd_deg, few, many):
    rng, taken = np.random.default_rng(1), []
    for _ in range(40):
        shares = np.asarray(SHARES(jnp.asarray(np.radians(rng.normal(scale=sd_deg, size=32)), jnp.float32), AGE))
        n = np.count_nonzero(shares)
        taken.append(n)
        np.testing.assert_allclose(shares, np.where(np.arange(32) >= 32 - n, 1 / n, 0), rtol=1e-6)
    assert few <= np.median(taken) <= many


def test_a_scan_of_little_noise_keeps_its_bits():
    rng = np.random.default_rng(3)
    for _ in range(20):
        ranges = jnp.asarray(wall(3, 1) + rng.normal(scale=0.01, size=BEAMS), jnp.float32)
        np.testing.assert_array_equal(SCAN(ranges), ranges)


@pytest.mark.parametrize(("sigma", "factor"), [(0.03, 1.7), (0.05, 2.2), (0.1, 2.2)])
def test_noise_falls_and_walls_stay_where_they_are(sigma, factor):
    rng = np.random.default_rng(4)
    true = wall(3, 1)
    hit = np.isfinite(true)
    inside = hit & (np.abs(np.degrees(ANGLES_RAD) + math.degrees(math.atan(1 / 3))) > 8)  # without the corner
    inside &= np.roll(hit, 7) & np.roll(hit, -7)
    found = np.stack([SCAN(jnp.asarray(true + rng.normal(scale=sigma, size=BEAMS), jnp.float32)) for _ in range(60)])
    off = found[:, inside] - true[inside]
    assert off.std() < sigma / factor
    assert np.abs(off.mean(axis=0)).max() < 0.5 * sigma


def test_what_is_missing_stays_missing_and_is_no_reading():
    rng = np.random.default_rng(5)
    ranges = (wall(3, 1) + rng.normal(scale=0.05, size=BEAMS)).astype(np.float32)
    ranges[rng.random(BEAMS) < 0.2] = np.nan
    found = np.asarray(SCAN(jnp.asarray(ranges)))
    np.testing.assert_array_equal(np.isnan(found), np.isnan(ranges))
    np.testing.assert_array_equal(np.isinf(found), np.isinf(ranges))
    there = np.isfinite(found)
    assert np.abs(found[there] - wall(3, 1)[there]).max() < 0.25
    for nothing in (np.full(BEAMS, np.nan), np.full(BEAMS, np.inf)):
        np.testing.assert_array_equal(SCAN(jnp.asarray(nothing, jnp.float32)), nothing)


def test_an_edge_stays_sharp():
    """A wall at 2 m before one at 4 m: no beam's range lies between."""
    rng = np.random.default_rng(6)
    true = np.where(np.arange(BEAMS) < 90, 2.0, 4.0)
    for _ in range(20):
        found = np.asarray(SCAN(jnp.asarray(true + rng.normal(scale=0.05, size=BEAMS), jnp.float32)))
        assert np.abs(found - true).max() < 0.25
