"""Single steps and sills in level ground, told from the profile that a robot drives over."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.runs import a_state

from jexplore import btm
from jexplore.driving import behaviour, events, manoeuvre, mapping
from jexplore.driving.records import LoneStep
from jexplore.driving.sensing import lone_steps
from jexplore.driving.settings import ROBOTS

pytestmark = pytest.mark.jit
LENGTH_M, AHEAD_M, STEP_M, RECENT = 0.7, 0.7, 0.04, 64


def driven(ground, sigma=0.0, seed=0, way_m=8.0):
    """The step as it is known along the way: a list of `(odometer, LoneStep)`."""
    odometer = np.arange(0, way_m, STEP_M)
    x = (odometer + AHEAD_M).astype(np.float32)
    z = np.array([ground(v) for v in x]) + np.random.default_rng(seed).normal(scale=sigma, size=x.size)
    padded_x = np.concatenate([np.full(RECENT, np.inf), x]).astype(np.float32)
    padded_z = np.concatenate([np.zeros(RECENT), z]).astype(np.float32)
    now, found = lone_steps.no_step(), []
    for i, at in enumerate(odometer):
        part = slice(i + 1, i + 1 + RECENT)
        now = WATCHED(now, padded_x[part], padded_z[part])
        found.append((at, now))
    return found


WATCHED = jax.jit(lone_steps.update_step)


def up(at, height):
    return lambda x: height * (x > at)


def sill(at, height, length=0.2):
    return lambda x: height * (at < x < at + length)


@pytest.mark.parametrize("height", [0.06, 0.12, 0.18, -0.06, -0.18])
def test_a_step_is_found_with_its_place_and_height(height):
    step = driven(up(4.01, height))[-1][1]
    assert float((step.from_m + step.to_m) / 2) == pytest.approx(4.01, abs=0.06)
    assert float(step.height_m) == pytest.approx(abs(height), abs=1e-3)


@pytest.mark.parametrize("height", [0.06, 0.12, 0.18])
def test_both_edges_of_a_sill_are_one_step(height):
    step = driven(sill(4.01, height))[-1][1]
    assert float((step.from_m + step.to_m) / 2) == pytest.approx(4.11, abs=0.06)
    assert float(step.height_m) == pytest.approx(height, abs=1e-3)


def test_the_ground_hidden_behind_an_edge_does_not_matter():
    """A scanner that looks down at 45 degrees sees the ground again as far behind an edge as that is high."""
    now = lone_steps.no_step()
    x = np.array([3.6, 3.64, 3.68, 3.72, 3.76, 3.93, 3.97, 4.01], np.float32)
    z = np.where(x < 3.8, 0.15, 0.0).astype(np.float32)
    for n in range(1, len(x) + 1):
        pad = RECENT - n
        now = WATCHED(now, np.pad(x[:n], (pad, 0), constant_values=np.inf), np.pad(z[:n], (pad, 0)))
    assert float(now.height_m) == pytest.approx(0.15, abs=1e-6)
    assert 3.7 < float(now.from_m) <= float(now.to_m) < 3.93


@pytest.mark.parametrize("face", [0.05, 0.08, 0.11])
def test_a_point_on_its_face_far_from_both_flanks_does_not_count(face):
    """Half way down, where the robot looks as it tips."""
    now = lone_steps.no_step()
    x = np.array([3.6, 3.64, 3.68, 3.72, 3.76, 3.84, 4.0, 4.04, 4.08], np.float32)
    z = np.array([0.15] * 5 + [face] + [0] * 3, np.float32)
    for n in range(1, len(x) + 1):
        pad = RECENT - n
        now = WATCHED(now, np.pad(x[:n], (pad, 0), constant_values=np.inf), np.pad(z[:n], (pad, 0)))
    assert float(now.height_m) == pytest.approx(0.15, abs=1e-6)


def test_low_ones_slopes_and_noise_are_none():
    for ground in (up(4.01, 0.03), lambda x: 0.05 * x):
        assert not np.isfinite(driven(ground)[-1][1].from_m)
    false = sum(bool(np.isfinite(driven(lambda x: 0.0, sigma, seed)[-1][1].from_m))
                for sigma in (0.005, 0.01, 0.02) for seed in range(20))  # fmt: skip
    assert false <= 1


def test_it_has_been_passed_once_the_robots_end_has():
    passed = [bool(lone_steps.has_passed(step, jnp.float32(at), LENGTH_M)) for at, step in driven(up(4.01, 0.12))]
    first = passed.index(True) * STEP_M
    assert all(passed[passed.index(True) :])
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
        assert bool(lone_steps.has_tipped(step, way, LENGTH_M)) == tipped


@pytest.mark.parametrize(
    ("obstacle", "at_m", "is_seen"), [(btm.STAIRS, 7.5, False), (btm.STAIRS, 7.8, True), (btm.SLOPE, 7.5, True)]
)
def test_behind_a_step_what_the_robot_saw_as_it_tipped_is_no_second_one(obstacle, at_m, is_seen):
    """It has passed the first, at 6.4 m, and saw what lies up to 1.2 m behind that while it tipped."""
    writer = mapping.begin_map(RECENT, 4, 8, jnp.zeros(3), False)
    map_, node = btm.add_node(writer.map, btm.OBSTACLE, 6.4, 0.0, obstacle=obstacle, step_m=0.18)
    writer = writer.replace(map=map_, node=node, node_m=jnp.float32(6.4))
    state = a_state(
        odometer_m=jnp.float32(7.1),
        drive=behaviour.initial_drive(),
        manoeuvre=manoeuvre.initial_manoeuvre(jnp.zeros(3)),
    )
    x = np.full(RECENT, np.inf, np.float32)
    x[-20:] = at_m + 0.04 * np.arange(-17, 3)
    ground = jnp.asarray(x), jnp.where(x < at_m, -0.07, 0.0), jnp.zeros(RECENT)
    level, no = writer.level, jnp.bool_(False)
    found, *_ = events._lone_step(state, writer, ground, no, level, no, jnp.float32(0), jnp.int32(0), ROBOTS["kamui"])
    assert bool(jnp.isfinite(found.from_m)) == is_seen
