"""Past what stands in the way: every rule by hand, and a robot that has to back out of a passage."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.passages import cast

from jexplore.btm import wrapped
from jexplore.driving import manoeuvre
from jexplore.driving.building.walls import meets
from jexplore.driving.manoeuvre import TRAIL_POSES
from jexplore.driving.params.tree import P
from jexplore.driving.records import Surround, Walls
from jexplore.driving.sensing import surround
from jexplore.driving.sensing.surround import DIRECTION, DIRECTIONS, SECTORS
from jexplore.driving.settings import ROBOTS, Tuning, for_world
from jexplore.driving.vehicle import ANGLES_RAD, DT_S, SCAN_RANGE_M, to_odometry

pytestmark = pytest.mark.jit

TUNING, KAMUI = for_world(Tuning(), is_course=True), ROBOTS["kamui"]
INF = math.inf
FREE = np.full(DIRECTIONS, INF)
HERE = (0.0, 0.0, 0.0)

_drive = jax.jit(lambda *args: manoeuvre.avoid_obstacles(*args, KAMUI))
_remembered = jax.jit(manoeuvre.extend_trail)


def of(*xy):
    """A `Surround` of some points `(x, y)`."""
    out = np.full((2, SECTORS), INF, np.float32)
    out[:, : len(xy)] = np.reshape(xy, (-1, 2)).T
    return Surround(*out)


def driven(now, around=None, ways=FREE, pose=HERE, bearing=0.0, turning=0, touched=False, tuning=TUNING):
    """`(after, v, omega)`."""
    ways, pose = (jnp.asarray(a, jnp.float32) for a in (ways, pose))
    around = Surround() if around is None else around
    args = jnp.float32(bearing), jnp.int32(turning), jnp.bool_(touched), tuning
    after, v, omega = _drive(now, around, ways, pose, *args)
    return after, float(v), float(omega)


@jax.jit
def _come(poses):
    add = lambda now, pose: (manoeuvre.extend_trail(now, pose), 0)  # noqa: E731
    return jax.lax.scan(add, manoeuvre.initial_manoeuvre(poses[0]), poses[1:])[0]


def gone(*poses):
    """Return the memory of a robot that has come along some poses."""
    return _come(jnp.asarray(poses, jnp.float32))


def along_x(metres):
    """It has come along x to the origin."""
    poses = jnp.stack([jnp.arange(-metres, 0.001, 0.05), *jnp.zeros((2, round(metres / 0.05) + 1))], axis=1)
    return _come(poses)


SIDES = [(0.0, 0.22), (0.0, -0.22)]  # as near as that the robot does not turn a step


def test_the_trail_is_a_ring():
    now = manoeuvre.initial_manoeuvre(jnp.array([1.0, 2.0, 3.0]))
    assert (now.trail[0].tolist(), int(now.length)) == ([1, 2, 3], 1)
    now = along_x(0.05 * (TRAIL_POSES + 2))
    assert int(now.length) == TRAIL_POSES + 3
    np.testing.assert_allclose(now.trail[:4, 0], [-0.1, -0.05, 0, -0.05 * (TRAIL_POSES - 1)], atol=1e-4)


@pytest.mark.parametrize("degrees", [0, 30, -70])
def test_a_free_way_is_driven_by_plain_proportional_control(degrees):
    bearing = math.radians(degrees)
    after, v, omega = driven(along_x(1.0), bearing=bearing)
    assert v == pytest.approx(TUNING.speed_m_s * math.cos(bearing))
    assert omega == pytest.approx(np.clip(TUNING.turn_gain * bearing, -KAMUI.max_turn_rad_s, KAMUI.max_turn_rad_s))
    assert not after.backing
    fast = dataclasses.replace(TUNING, speed_m_s=50.0)  # no faster than the robot can
    assert driven(along_x(1.0), tuning=fast)[1] == pytest.approx(KAMUI.max_speed_m_s)
    for side in (1, -1):  # a target far aside is turned to in place; a turn in place is no matter of the target
        assert driven(along_x(1.0), bearing=side * 2.0)[1:] == (0, side * KAMUI.max_turn_rad_s)
        assert driven(along_x(1.0), bearing=-0.1, turning=side)[1:] == (0, side * KAMUI.max_turn_rad_s / 2)


def closed(low_deg, high_deg, way_m=P.motion.go_m - 0.01, beyond_m=INF):
    """Ways that are short between two directions."""
    degrees = np.round(np.degrees(DIRECTION))
    return np.where((degrees >= low_deg) & (degrees <= high_deg), way_m, beyond_m)


@pytest.mark.parametrize(
    ("ways", "bearing_deg", "course_deg"),
    [
        (closed(-20, 30), 0, -25),
        (closed(-20, 30), 10, 35),
        (closed(-20, 30), 5, -25),  # both 30 degrees off: the first
        (closed(-20, 30, beyond_m=P.motion.go_m - 0.01), 3, 3),  # nowhere a way that is long enough
        (closed(-20, 30, way_m=P.motion.go_m + 0.01), 3, 3),
    ],
)
def test_the_nearest_free_direction_is_taken(ways, bearing_deg, course_deg):
    course = math.radians(course_deg)
    _, v, omega = driven(along_x(1.0), ways=ways, bearing=math.radians(bearing_deg))
    assert (v, omega) == pytest.approx((TUNING.speed_m_s * math.cos(course), TUNING.turn_gain * course), rel=1e-5)


@pytest.mark.parametrize(("x_m", "v"), [(0.35 + 0.4 * 0.2 - 0.01, 0.0), (0.35 + 0.4 * 0.2 + 0.02, 0.4)])
def test_a_step_that_would_touch_is_not_made(x_m, v):
    """A step is looked at 0.2 s ahead: 8 cm before a front at 0.35 m."""
    assert driven(along_x(1.0), of((x_m, 0.1)))[1] == pytest.approx(v)


@pytest.mark.parametrize("bearing", [2.0, -2.0])
def test_without_room_to_turn_the_robot_goes_back_the_way_it_came(bearing):
    after, v, omega = driven(along_x(1.0), of(*SIDES), bearing=bearing)
    assert after.backing
    assert (v, omega) == pytest.approx((0, 0), abs=1e-5)  # the last pose is this one
    after, v, omega = driven(after, of(*SIDES), bearing=bearing)
    assert (v, omega) == pytest.approx((-TUNING.speed_m_s, 0), abs=1e-6)
    for more in (
        {"bearing": bearing, "around": of(*SIDES)},
        {"touched": True},
    ):  # with nothing on the trail it does not
        assert not driven(gone(HERE, HERE), **more)[0].backing
        assert driven(along_x(0.05), **more)[0].backing


def test_with_room_on_one_side_only_that_is_turned_to():
    """A point before the left half of the front: met by a turn to the left."""
    corner = of((0.36, 0.22))
    assert driven(along_x(1.0), corner, bearing=2.0)[0].backing
    after, v, omega = driven(along_x(1.0), corner, bearing=-2.0)
    assert not after.backing
    assert (v, omega) == (0, -KAMUI.max_turn_rad_s)


def exact(pose, v, omega):
    """A step without errors."""
    middle = pose[2] + omega * DT_S / 2
    return pose + DT_S * np.array([v * math.cos(middle), v * math.sin(middle), omega])


def test_what_was_touched_is_left_by_the_least_way_back():
    now, pose, xs = along_x(1.0), np.zeros(3), [0.0]
    for i in range(12):
        now, v, omega = driven(now, pose=pose, touched=i == 0)
        if not now.backing:
            break
        pose = exact(pose, v, omega)
        now = _remembered(now, jnp.asarray(pose, jnp.float32))
        xs.append(pose[0])
    assert i < 11
    assert (np.diff(xs) <= 0).all()
    assert P.motion.min_back_m - 1e-6 <= -xs[-1] < P.motion.min_back_m + TUNING.speed_m_s * DT_S + 1e-6
    assert v == pytest.approx(TUNING.speed_m_s)  # and on it goes


def lines(*segments):
    return jnp.array(segments, jnp.float32)


ROOM_AND_PASSAGE = Walls(  # 3 m x 3 m, and from it a passage 1.2 m long and 0.7 m wide without a way out
    x=lines((-3.0, -1.5, 1.5), (0.0, -1.5, -0.35), (0.0, 0.35, 1.5), (1.2, -0.35, 0.35)),
    y=lines((-1.5, -3.0, 0.0), (1.5, -3.0, 0.0), (-0.35, 0.0, 1.2), (0.35, 0.0, 1.2)),
)


@jax.jit
def _steps(now, around, pose, targets):
    """Steps in `ROOM_AND_PASSAGE` without errors: poses `[n, 3]`, whether it goes back, whether it meets a wall."""

    def step(carry, _):
        now, around, pose, inside = carry
        around = surround.add_scan(around, cast(ROOM_AND_PASSAGE, pose, ANGLES_RAD, SCAN_RANGE_M))
        inside |= pose[0] > 0.4
        off = jnp.where(inside, targets[1], targets[0]) - pose[:2]
        bearing = wrapped(jnp.arctan2(off[1], off[0]) - pose[2])
        ways = surround.free_lengths(around, KAMUI)
        now, v, omega = manoeuvre.avoid_obstacles(now, around, ways, pose, bearing, 0, jnp.bool_(False), TUNING, KAMUI)
        half = omega * DT_S / 2
        step = v * DT_S * jnp.stack([jnp.cos(half), jnp.sin(half)])
        pose = jnp.append(to_odometry(pose)(step), pose[2] + omega * DT_S)
        around = surround.move_surround(around, step[0], step[1], omega * DT_S)
        met = meets(ROOM_AND_PASSAGE, pose, KAMUI.length_m, KAMUI.width_m)
        return (manoeuvre.extend_trail(now, pose), around, pose, inside), (pose, now.backing, met)

    carry = now, around, pose, jnp.bool_(False)
    return jax.lax.scan(step, carry, length=130)[1]


def test_it_backs_out_of_a_dead_end_and_turns_outside():
    pose = jnp.array((-0.8, 0.08, -0.1))
    now, targets = manoeuvre.initial_manoeuvre(pose), jnp.array([(1.0, 0.0), (-2.0, 0.0)])
    poses, backed, met = map(np.asarray, _steps(now, Surround(), pose, targets))
    assert not met.any()
    x, y, heading = poses.T
    assert x.max() > 0.4
    assert sum(np.diff(backed.astype(int)) == 1) == 1
    assert x[backed].min() < -0.2  # outside, as far as its rear end
    assert np.abs(heading[x > 0]).max() < 0.35
    assert np.hypot(x[-1] + 2, y[-1]) < 0.6
