"""Past what stands in the way: every rule by hand, and a robot that has to back out of a passage."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.btm import wrapped
from jexplore.driving import manoeuvre
from jexplore.driving.building.walls import cast, meets
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

_drive = jax.jit(lambda *args: manoeuvre.avoid_obstacles(*args, TUNING, KAMUI))
_remembered = jax.jit(manoeuvre.extend_trail)


def of(*xy):
    """A `Surround` of some points `(x, y)`."""
    out = np.full((2, SECTORS), INF, np.float32)
    out[:, : len(xy)] = np.reshape(xy, (-1, 2)).T
    return Surround(*out)


def driven(now, around=None, ways=FREE, pose=HERE, bearing=0.0, turning=0, touched=False):
    """`(after, v, omega)`."""
    ways, pose = (jnp.asarray(a, jnp.float32) for a in (ways, pose))
    around = surround.empty_surround() if around is None else around
    args = jnp.float32(bearing), jnp.int32(turning), jnp.bool_(touched)
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
    assert not after.avoiding
    for side in (1, -1):  # a target far aside is turned to in place; a turn in place is no matter of the target
        assert driven(along_x(1.0), bearing=side * 2.0)[1:] == (0, side * KAMUI.max_turn_rad_s)
        assert driven(along_x(1.0), bearing=-0.1, turning=side)[1:] == (0, side * KAMUI.max_turn_rad_s / 2)


def closed(low_deg, high_deg, way_m=P.motion.stop_m - 0.01, beyond_m=INF):
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
        (closed(-20, 30, way_m=P.motion.stop_m + 0.01), 3, 3),
    ],
)
def test_the_nearest_free_direction_is_taken(ways, bearing_deg, course_deg):
    course = math.radians(course_deg)
    after, v, omega = driven(along_x(1.0), ways=ways, bearing=math.radians(bearing_deg))
    assert (v, omega) == pytest.approx((TUNING.speed_m_s * math.cos(course), TUNING.turn_gain * course), rel=1e-5)
    assert bool(after.avoiding) == (course_deg != bearing_deg)
    assert float(after.side) == pytest.approx(course)


def test_the_side_that_was_taken_is_kept():
    """To the left round it, and the target comes to lie a little to the right of its middle."""
    ways = closed(-30, 30)
    after, _, omega = driven(along_x(1.0), ways=ways, bearing=0.05)
    assert omega == pytest.approx(TUNING.turn_gain * math.radians(35))
    _, _, omega = driven(after, ways=ways, bearing=-0.05)
    assert omega > 0
    assert float(driven(after, ways=ways, pose=(0, 0, 0.5))[0].side) == pytest.approx(math.radians(35) + 0.5)
    # In the odometry's frame: after a turn of a sixth that side is the other one.
    _, _, omega = driven(after, ways=ways, bearing=0.02, pose=(0, 0, math.radians(70)))
    assert omega < 0


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


@pytest.mark.parametrize("side", [1, -1])
def test_what_it_tries_leads_away_from_what_is_nearest(side):
    """With a wall to the left it turns left going back, and right going ahead."""
    now, found = along_x(1.0), []
    for _ in range(4):
        now, *way = driven(now, of((0, side * 0.2)), touched=True)
        found.append(way)
    lean = side * P.motion.lean_rad_s
    half = TUNING.speed_m_s / 2
    np.testing.assert_allclose(found, [(-half, 0), (-half, lean), (half, 0), (half, -lean)], atol=1e-6)


def beside_a_wall(side, gap_m, error_m=0.0, noise_m=0.0, unseen_m=math.inf, steps=150):
    """Let a robot turn away from a wall next to it: `(y, contacts)`, the distance made good in some steps.

    It sees the wall too far away by `error_m`, every point off by `noise_m`; behind its middle there is another wall,
    `unseen_m` away.
    """
    half = np.array([KAMUI.length_m, KAMUI.width_m]) / 2
    wall_m, corners = half[1] + gap_m, half * [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    along = np.arange(-4, 4, 0.03)
    aside = side * (wall_m + error_m) + noise_m * np.random.default_rng(0).standard_normal(len(along))
    now, pose, contacts, touched = along_x(2.0), np.zeros(3), 0, False
    for _ in range(steps):
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        x, y = along - pose[0], aside - pose[1]
        seen = np.stack([x * cos + y * sin, y * cos - x * sin], axis=1)
        bearing = (-side * math.pi / 2 - pose[2] + math.pi) % (2 * math.pi) - math.pi
        now, v, omega = driven(now, of(*seen), pose=pose, bearing=bearing, touched=touched)
        after = exact(pose, v, omega)
        cos, sin = math.cos(after[2]), math.sin(after[2])
        x, y = after[0] + corners @ [cos, -sin], after[1] + corners @ [sin, cos]
        touched = (side * y > wall_m).any() or (x < -unseen_m).any()
        contacts += touched
        pose = pose if touched else after
        now = _remembered(now, jnp.asarray(pose, jnp.float32))
        if -side * pose[1] > 0.5:
            break
    return -side * pose[1], contacts


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("error_m", "noise_m"), [(0.0, 0.0), (0.04, 0.0), (0.0, 0.01)])
def test_close_along_a_wall_it_gets_away(side, error_m, noise_m):
    """There is no room to turn, and the wall is not quite where it is seen: the robot leans away from it."""
    y, contacts = beside_a_wall(side, 0.004, error_m, noise_m)
    assert y > 0.5, (y, contacts)
    assert contacts < 20


def lines(*segments):
    return jnp.array(segments, jnp.float32)


ROOM_AND_PASSAGE = Walls(  # 3 m x 3 m, and from it a passage 1.2 m long and 0.7 m wide without a way out
    x=lines((-3.0, -1.5, 1.5), (0.0, -1.5, -0.35), (0.0, 0.35, 1.5), (1.2, -0.35, 0.35)),
    y=lines((-1.5, -3.0, 0.0), (1.5, -3.0, 0.0), (-0.35, 0.0, 1.2), (0.35, 0.0, 1.2)),
)


@functools.partial(jax.jit, static_argnums=4)
def _steps(now, around, pose, targets, backs_out):
    """Steps in `ROOM_AND_PASSAGE` without errors: poses `[n, 3]`, whether it goes back, whether it meets a wall."""

    def step(carry, _):
        now, around, pose, inside = carry
        around = surround.add_scan(around, cast(ROOM_AND_PASSAGE, pose, ANGLES_RAD, SCAN_RANGE_M))
        inside |= pose[0] > 0.5
        off = jnp.where(inside | (not backs_out), targets[1], targets[0]) - pose[:2]
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
    return jax.lax.scan(step, carry, length=130 if backs_out else 300)[1]


def test_it_backs_out_of_a_dead_end_and_turns_outside():
    pose = jnp.array((-0.8, 0.08, -0.1))
    now, targets = manoeuvre.initial_manoeuvre(pose), jnp.array([(1.0, 0.0), (-2.0, 0.0)])
    poses, backed, met = map(np.asarray, _steps(now, surround.empty_surround(), pose, targets, True))
    assert not met.any()
    x, y, heading = poses.T
    assert x.max() > 0.5
    assert sum(np.diff(backed.astype(int)) == 1) == 1
    assert x[backed].min() < -0.2  # outside, as far as its rear end
    assert np.abs(heading[x > 0]).max() < 0.35
    assert np.hypot(x[-1] + 2, y[-1]) < 0.6


@pytest.mark.slow
def test_it_gets_out_of_a_corner_whose_walls_are_beside_and_behind_it():
    """3 cm from both, it wants to the other side: there is no room to turn, nor to go back the way that it came."""
    pose = jnp.array([-0.38, 1.265, math.pi])
    now = gone(*[(x, 1.27, math.pi) for x in np.arange(0.4, -0.38, -0.05)], tuple(pose.tolist()))
    angles = np.radians(np.arange(SECTORS) - SECTORS // 2).astype(np.float32)
    ranges_m = cast(ROOM_AND_PASSAGE, pose, angles, SCAN_RANGE_M)
    around = Surround(ranges_m * jnp.cos(angles), ranges_m * jnp.sin(angles))
    poses, _, met = _steps(now, around, pose, jnp.array([(-0.9, -1.0)] * 2), False)
    assert not met.any()
    assert poses[-1, 1] < 0.3
