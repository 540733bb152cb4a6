"""Single steps and sills in level ground, told from the profile that a robot drives over."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.driving import mapping
from jexplore.driving.records import LoneStep
from jexplore.driving.sensing import ground_profile

pytestmark = pytest.mark.jit
LENGTH_M, AHEAD_M, STEP_M, RECENT = 0.7, 0.7, 0.04, 64


@functools.partial(jax.jit, static_argnums=2)
def _known(x, z, n):
    def step(now, i):
        now = ground_profile.update_step(now, *(jax.lax.dynamic_slice(a, (i + 1,), (RECENT,)) for a in (x, z)))
        return now, now

    return jax.lax.scan(step, LoneStep(), jnp.arange(n))[1]


def driven(ground, sigma=0.0, seed=0, way_m=8.0):
    """The step as it is known along the way: the odometer, and `LoneStep` of arrays."""
    odometer = np.arange(0, way_m, STEP_M)
    x = (odometer + AHEAD_M).astype(np.float32)
    z = np.array([ground(v) for v in x]) + np.random.default_rng(seed).normal(scale=sigma, size=x.size)
    x = np.concatenate([np.full(RECENT, np.inf), x]).astype(np.float32)
    return odometer, _known(x, np.pad(z, (RECENT, 0)).astype(np.float32), len(odometer))


def test_the_steepest_rise_by_hand():
    """Beyond 45 degrees only, between neighbours that both are there, up only."""
    x, z = np.float32([0, 0.1, 0.2, 0.3, 0.4]), np.float32([0, 0.15, 0.1, 0.6, 0.1])
    for valid, rise in (([1, 1, 1, 1, 1], 0.4), ([1, 1, 1, 0, 1], 0.05), ([1, 0, 1, 0, 1], 0)):
        found = ground_profile.steepest_rise(jnp.asarray(x), jnp.asarray(z), jnp.array(valid, bool))
        assert float(found) == pytest.approx(rise, abs=1e-6)


def at_the_end(ground, **noise):
    return jax.tree.map(lambda a: a[-1], driven(ground, **noise)[1])


WATCHED = jax.jit(ground_profile.update_step)


def up(at, height):
    return lambda x: height * (x > at)


def sill(at, height, length=0.2):
    return lambda x: height * (at < x < at + length)


@pytest.mark.parametrize(
    ("ground", "at_m", "heights"), [(up, 4.01, (0.06, 0.12, 0.18, -0.06, -0.18)), (sill, 4.11, (0.06, 0.12, 0.18))]
)
def test_a_step_is_found_with_its_place_and_height_and_both_edges_of_a_sill_are_one(ground, at_m, heights):
    for height in heights:
        step = at_the_end(ground(4.01, height))
        assert float((step.from_m + step.to_m) / 2) == pytest.approx(at_m, abs=0.06)
        assert float(step.height_m) == pytest.approx(abs(height), abs=1e-3)


@pytest.mark.parametrize("face", [[0.05], [0.11], []])
def test_a_point_on_its_face_far_from_both_flanks_does_not_count(face):
    """Half way down, where the robot looks as it tips; the ground behind an edge is hidden."""
    now = LoneStep()
    x = np.array([3.6, 3.64, 3.68, 3.72, 3.76, *[3.84] * len(face), 4.0, 4.04, 4.08], np.float32)
    z = np.array([0.15] * 5 + face + [0] * 3, np.float32)
    for n in range(1, len(x) + 1):
        pad = RECENT - n
        now = WATCHED(now, np.pad(x[:n], (pad, 0), constant_values=np.inf), np.pad(z[:n], (pad, 0)))
    assert float(now.height_m) == pytest.approx(0.15, abs=1e-6)


def test_low_ones_slopes_and_noise_are_none():
    for ground in (up(4.01, 0.03), lambda x: 0.05 * x):
        assert not np.isfinite(at_the_end(ground).from_m)
    noises = [{"sigma": sigma, "seed": seed} for sigma in (0.005, 0.01, 0.02) for seed in range(20)]
    false = sum(bool(np.isfinite(at_the_end(lambda x: 0.0, **noise).from_m)) for noise in noises)
    assert false <= 1


def test_it_has_been_passed_once_the_robots_end_has():
    at, step = driven(up(4.01, 0.12))
    passed = np.asarray(ground_profile.has_passed(step, at, LENGTH_M))
    first = passed.argmax() * STEP_M
    assert passed[passed.argmax() :].all()
    assert 4.01 + LENGTH_M / 2 + 0.2 < first < 4.01 + LENGTH_M / 2 + 0.45


@pytest.mark.parametrize(
    ("degrees", "noise_deg", "tipped"), [(9.0, 0, True), (1.0, 0, False), (9.0, 1, True), (0.0, 1, False)]
)
@pytest.mark.parametrize("axis", ["pitch", "roll"])
def test_a_robot_that_did_not_tip_has_turned_away(degrees, noise_deg, tipped, axis):
    """Noise of a degree does not look like a step of 6 cm, of which 2.5 degrees would be seen."""
    step = LoneStep(jnp.float32(4.0), jnp.float32(4.1), jnp.float32(0.06))
    odometer = np.arange(256) * STEP_M
    angle = np.where(np.abs(odometer - 4) < 0.3, math.radians(degrees), 0.0)
    angle = np.where(odometer > 8, 1.0, angle)  # elsewhere it may lean as it likes
    rng = np.random.default_rng(5)
    for _ in range(20 if noise_deg else 1):
        angles = {name: rng.normal(scale=math.radians(noise_deg), size=256) for name in ("pitch", "roll")}
        angles[axis] = angles[axis] + angle
        way = mapping.no_way(256).replace(odometer_m=jnp.asarray(odometer), **jax.tree.map(jnp.asarray, angles))
        assert bool(ground_profile.has_tipped(step, way, LENGTH_M)) == tipped
