"""Past what stands in the way: every rule by hand, and a robot that has to back out of a passage."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.driving import manoeuvre
from jexplore.driving.building.walls import Walls, cast, meets
from jexplore.driving.manoeuvre import GO_M, MIN_BACK_M, STOP_M, TRAIL_M, TRAIL_POSES
from jexplore.driving.records import Surround
from jexplore.driving.sensing import surround
from jexplore.driving.sensing.surround import DIRECTION, DIRECTIONS, SECTORS
from jexplore.driving.settings import ROBOTS, Tuning, for_world
from jexplore.driving.vehicle import ANGLES_RAD, DT_S, SCAN_RANGE_M

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


def gone(*poses):
    """Return the memory of a robot that has come along some poses."""
    now = manoeuvre.initial_manoeuvre(jnp.asarray(poses[0], jnp.float32))
    for pose in poses[1:]:
        now = _remembered(now, jnp.asarray(pose, jnp.float32))
    return now


def along_x(metres):
    """It has come along x to the origin."""
    return gone(*[(x, 0, 0) for x in np.arange(-metres, 0.001, 0.05)])


SIDES = [(0.0, 0.22), (0.0, -0.22)]  # as near as that the robot does not turn a step


# ---------------------------------------------------------------- memory


def test_at_rest_the_trail_is_where_the_robot_stands():
    now = manoeuvre.initial_manoeuvre(jnp.array([1.0, 2.0, 3.0]))
    assert now.trail[0].tolist() == [1, 2, 3]
    assert (int(now.length), bool(now.backing), bool(now.avoiding), float(now.backed_m)) == (1, False, False, 0)


@pytest.mark.parametrize(
    ("pose", "is_kept"),
    [
        ((0.99 * TRAIL_M, 0, 0.3), False),
        ((0, -1.01 * TRAIL_M, 0), True),
        ((0, 0, -2.0), False),
    ],
)
def test_a_pose_is_remembered_after_some_way_and_no_turn_in_place(pose, is_kept):
    after = gone(HERE, pose)
    assert int(after.length) == int(after.kept) == 1 + is_kept
    np.testing.assert_allclose(after.trail[1], np.multiply(pose, is_kept), rtol=1e-6)


def test_nothing_is_remembered_while_the_robot_goes_back():
    after = _remembered(gone(HERE).replace(backing=jnp.bool_(True)), jnp.array([1.0, 0.0, 0.0]))
    assert int(after.length) == 1
    assert not after.trail.any()


def test_the_trail_is_a_ring():
    now = along_x(0.05 * (TRAIL_POSES + 2))
    assert int(now.length) == TRAIL_POSES + 3
    np.testing.assert_allclose(now.trail[:4, 0], [-0.1, -0.05, 0, -0.05 * (TRAIL_POSES - 1)], atol=1e-4)


@pytest.mark.parametrize(("direction", "within", "is_open"), [(0, 0.0, True), (2, 0.17, False), (-2, 0.18, True)])
def test_a_way_near_straight_ahead_is_open(direction, within, is_open):
    """Directions are 5 degrees apart, 0.087."""
    ways = np.zeros(DIRECTIONS)
    ways[DIRECTIONS // 2 + direction] = 1.5
    assert bool(manoeuvre.has_free_way(jnp.asarray(ways), within, 1.5)) == is_open
    assert not manoeuvre.has_free_way(jnp.asarray(ways), within, 1.51)


# ---------------------------------------------------------------- free


@pytest.mark.parametrize("degrees", [0, 30, -30, 70, -70])
def test_a_free_way_is_driven_by_plain_proportional_control(degrees):
    bearing = math.radians(degrees)
    after, v, omega = driven(along_x(1.0), bearing=bearing)
    assert v == pytest.approx(TUNING.speed_m_s * math.cos(bearing))
    assert omega == pytest.approx(np.clip(TUNING.turn_gain * bearing, -KAMUI.max_turn_rad_s, KAMUI.max_turn_rad_s))
    assert not after.backing
    assert not after.avoiding


@pytest.mark.parametrize("degrees", [80, -80, 180])
def test_what_lies_aside_is_turned_to_in_place(degrees):
    _, v, omega = driven(along_x(1.0), bearing=math.radians(degrees))
    assert (v, omega) == (0, math.copysign(KAMUI.max_turn_rad_s, degrees))


@pytest.mark.parametrize("turning", [1, -1])
def test_a_turn_in_place_is_no_matter_of_the_target(turning):
    blocked = np.where(np.abs(DIRECTION) < 0.3, 0.0, INF)
    after, v, omega = driven(along_x(1.0), ways=blocked, bearing=-0.1, turning=turning)
    assert (v, omega) == (0, turning * KAMUI.max_turn_rad_s / 2)
    assert not after.avoiding


# ---------------------------------------------------------------- something in the way


def closed(low_deg, high_deg, way_m=STOP_M - 0.01, beyond_m=INF):
    """Ways that are short between two directions."""
    degrees = np.round(np.degrees(DIRECTION))
    return np.where((degrees >= low_deg) & (degrees <= high_deg), way_m, beyond_m)


@pytest.mark.parametrize(
    ("ways", "bearing_deg", "course_deg"),
    [
        (closed(-20, 30), 0, -25),
        (closed(-20, 30), 10, 35),
        (closed(-20, 30), 5, -25),  # both 30 degrees off: the first
        (closed(-20, 30), -25, -25),
        (closed(-20, 30, beyond_m=GO_M - 0.01), 3, 3),  # nowhere a way that is long enough
        (closed(-20, 30, way_m=STOP_M + 0.01), 3, 3),
        (closed(-10, -10, way_m=0.0), -9, -5),
        (closed(-10, -10, way_m=0.0), -7, -7),  # -5 is nearer
    ],
)
def test_the_nearest_free_direction_is_taken(ways, bearing_deg, course_deg):
    course = math.radians(course_deg)
    after, v, omega = driven(along_x(1.0), ways=ways, bearing=math.radians(bearing_deg))
    assert (v, omega) == pytest.approx((TUNING.speed_m_s * math.cos(course), TUNING.turn_gain * course), rel=1e-5)
    assert bool(after.avoiding) == (course_deg != bearing_deg)
    assert float(after.side) == pytest.approx(course)


def test_a_direction_must_be_longer_to_be_taken_than_to_be_kept():
    ways = closed(-20, 30)
    ways[DIRECTIONS // 2 - 5] = (STOP_M + GO_M) / 2  # at -25 degrees
    _, _, omega = driven(along_x(1.0), ways=ways)
    assert omega == pytest.approx(TUNING.turn_gain * math.radians(-30))


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


# ---------------------------------------------------------------- no room to turn


@pytest.mark.parametrize("bearing", [2.0, -2.0])
def test_without_room_to_turn_the_robot_goes_back_the_way_it_came(bearing):
    after, v, omega = driven(along_x(1.0), of(*SIDES), bearing=bearing)
    assert after.backing
    assert (v, omega) == pytest.approx((0, 0), abs=1e-5)  # the last pose is this one
    after, v, omega = driven(after, of(*SIDES), bearing=bearing)
    assert (v, omega) == pytest.approx((-TUNING.speed_m_s, 0), abs=1e-6)


@pytest.mark.parametrize("more", [{"bearing": 2.0, "around": of(*SIDES)}, {"touched": True}])
def test_with_nothing_on_the_trail_it_does_not_go_back(more):
    after, v, _ = driven(gone(HERE), **more)
    assert not after.backing
    assert v >= 0
    assert driven(along_x(0.05), **more)[0].backing


def test_with_room_on_one_side_only_that_is_turned_to():
    """A point before the left half of the front: met by a turn to the left."""
    corner = of((0.36, 0.22))
    assert driven(along_x(1.0), corner, bearing=2.0)[0].backing
    after, v, omega = driven(along_x(1.0), corner, bearing=-2.0)
    assert not after.backing
    assert (v, omega) == (0, -KAMUI.max_turn_rad_s)


def test_a_turn_is_begun_that_cannot_be_ended():
    """The point is met after 26 degrees to the left."""
    after, v, omega = driven(along_x(1.0), of((0.1, 0.3)), bearing=2.0)
    assert not after.backing
    assert (v, omega) == (0, KAMUI.max_turn_rad_s)


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
    assert MIN_BACK_M - 1e-6 <= -xs[-1] < MIN_BACK_M + TUNING.speed_m_s * DT_S + 1e-6
    assert v == pytest.approx(TUNING.speed_m_s)  # and on it goes


def test_what_gets_it_away_from_what_it_has_touched_is_gone_on_with():
    """For some steps, whatever it sees; the next touch makes it try the next way."""
    now, pose, tried = along_x(1.0), (0.0, 0.1, 0.3), []
    for _ in range(11):
        now, *first = driven(now, pose=pose, touched=True)
        tried.append(first)
        for _ in range(manoeuvre.RECOVERY_STEPS - 1):
            now, *way = driven(now.replace(backed_m=jnp.float32(0)), of((0.5, 0.5)), pose=pose)
            assert way == first
    assert len({tuple(way) for way in tried}) == 11
    assert {v > 0 for v, _ in tried} == {True, False}
    now, *way = driven(now, pose=pose)
    assert tuple(way) not in {tuple(way) for way in tried}  # back along its way


@pytest.mark.parametrize("side", [1, -1])
def test_what_it_tries_leads_away_from_what_is_nearest(side):
    """With a wall to the left it turns left going back, and right going ahead."""
    now, found = along_x(1.0), []
    for _ in range(4):
        now, *way = driven(now, of((0, side * 0.2)), touched=True)
        found.append(way)
    lean = side * manoeuvre.LEAN_RAD_S
    half = TUNING.speed_m_s / 2
    np.testing.assert_allclose(found, [(-half, 0), (-half, lean), (half, 0), (half, -lean)], atol=1e-6)


def test_where_nothing_is_free_it_goes_where_most_is():
    """A wall half a centimetre away, another one behind."""
    now = along_x(1.0).replace(backing=jnp.bool_(True))
    after, v, _ = driven(now, of((0, 0.2), (-0.355, 0.1), (-0.355, -0.1)), bearing=-2.0)
    assert after.backing
    assert v == pytest.approx(TUNING.speed_m_s / 2)


@pytest.mark.parametrize(("frees", "omega"), [(0, 0.057), (1, 0.0), (manoeuvre.TOUCH_AGAIN_STEPS, 0.0)])
def test_a_robot_that_leans_and_touches_goes_straight_back_for_a_while(frees, omega):
    now = along_x(1.0).replace(backing=jnp.bool_(True), frees=jnp.int32(frees + 1))
    now = now if frees else now.replace(frees=jnp.int32(0))
    _, v, turn = driven(now, of((0.1, 0.199)), bearing=-2.0)
    assert (v, turn) == pytest.approx((-TUNING.speed_m_s / 2, omega), abs=1e-3)


def test_where_it_leans_it_is_past_a_pose_of_the_trail_that_it_does_not_stand_on():
    now = along_x(1.0).replace(backing=jnp.bool_(True))
    after, v, _ = driven(now, of((0.1, 0.199)), pose=(0, 0, 0.5), bearing=-2.0)
    assert v == pytest.approx(-TUNING.speed_m_s / 2)
    assert int(after.length) == int(now.length) - 1


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
@pytest.mark.parametrize(("error_m", "noise_m"), [(0.0, 0.0), (0.02, 0.0), (0.04, 0.0), (0.0, 0.01)])
def test_close_along_a_wall_it_gets_away(side, error_m, noise_m):
    """There is no room to turn, and the wall is not quite where it is seen: the robot leans away from it."""
    y, contacts = beside_a_wall(side, 0.004, error_m, noise_m)
    assert y > 0.5, (y, contacts)
    assert contacts < 20


@pytest.mark.parametrize("unseen_m", [0.36, 0.6])
def test_it_does_not_go_round_in_circles_where_something_unseen_is_behind_it(unseen_m):
    """It does not undo an attempt ahead before it tries the next way."""
    y, contacts = beside_a_wall(1, 0.15, unseen_m=unseen_m)
    assert y > 0.5, (y, contacts)


def test_it_goes_back_no_farther_where_that_leads_nowhere():
    """Between walls where it cannot turn, with a third one behind it."""
    beside, behind = [(0, 0.3), (0, -0.3)], [(-0.36, y) for y in (-0.1, 0, 0.1)]
    now = along_x(1.0).replace(backing=jnp.bool_(True), backed_m=jnp.float32(MIN_BACK_M + 0.01))
    assert driven(now, of(*beside))[0].backing  # there is room behind it
    for turning in (0, 1):
        after, v = now, 0.0
        for _ in range(3):  # by then the trail's last pose, where it stands, is done with
            after, v, _ = driven(after, of(*beside, *behind), turning=turning)
        assert bool(after.backing) == (turning == 1)  # where it wants to turn it tries on
    after, v, _ = driven(now.replace(backing=jnp.bool_(False)), of(*beside, *behind))
    assert v == pytest.approx(TUNING.speed_m_s)


@pytest.mark.parametrize("left_m", [0.1, -0.1])
def test_going_back_it_comes_over_to_the_trail(left_m):
    """It stands next to its trail, heading alike, with a wall on either side too near to turn."""
    now = gone(*[(x, left_m, 0) for x in np.arange(-2, 0.001, 0.05)]).replace(backing=jnp.bool_(True))
    pose = np.zeros(3)
    for _ in range(40):
        now, v, omega = driven(now, of((0, 0.45 - pose[1]), (0, -0.45 - pose[1])), pose=pose)
        pose = exact(pose, v, omega)
    assert pose[0] < -0.7
    assert pose[1] == pytest.approx(left_m, abs=0.04)
    assert abs(pose[2]) < 0.15


@pytest.mark.parametrize("side", [1, -1])
def test_a_robot_that_goes_back_along_a_wall_leans_away_from_it(side):
    """At half a centimetre: its outline never meets the wall, and soon has room to turn."""
    now = along_x(4.0).replace(backing=jnp.bool_(True))
    pose, along = np.zeros(3), np.arange(-6, 0.36, 0.05)
    corners = [(x, y) for x in (-0.35, 0.35) for y in (-0.195, 0.195)]
    for _ in range(200):
        offset = np.stack([along, np.full(len(along), side * 0.2)], axis=1) - pose[:2]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        seen = np.stack([offset @ [cos, sin], offset @ [-sin, cos]], axis=1)
        now, v, omega = driven(now, of(*seen), pose=pose, turning=-side)
        if not now.backing:
            break
        pose = exact(pose, v, omega)
        aside = [side * (pose[1] + math.sin(pose[2]) * x + math.cos(pose[2]) * y) for x, y in corners]
        assert max(aside) < 0.2
    assert not now.backing
    assert -side * pose[1] > 0.2, pose


def lines(*segments):
    return jnp.array(segments, jnp.float32)


ROOM_AND_PASSAGE = Walls(  # 3 m x 3 m, and from it a passage 1.2 m long and 0.7 m wide without a way out
    x=lines((-3.0, -1.5, 1.5), (0.0, -1.5, -0.35), (0.0, 0.35, 1.5), (1.2, -0.35, 0.35)),
    y=lines((-1.5, -3.0, 0.0), (1.5, -3.0, 0.0), (-0.35, 0.0, 1.2), (0.35, 0.0, 1.2)),
)


@jax.jit
def _step(now, around, pose, target):
    """One step in `ROOM_AND_PASSAGE` without errors: `(now, around, pose)` after it."""
    around = surround.add_scan(around, cast(ROOM_AND_PASSAGE, pose, ANGLES_RAD, SCAN_RANGE_M))
    off = target - pose[:2]
    bearing = jnp.arctan2(off[1], off[0]) - pose[2]
    bearing = jnp.arctan2(jnp.sin(bearing), jnp.cos(bearing))
    ways = surround.free_lengths(around, KAMUI)
    now, v, omega = manoeuvre.avoid_obstacles(now, around, ways, pose, bearing, 0, jnp.bool_(False), TUNING, KAMUI)
    half = omega * DT_S / 2
    step = v * DT_S * jnp.stack([jnp.cos(half), jnp.sin(half)])
    cos, sin = jnp.cos(pose[2]), jnp.sin(pose[2])
    pose += jnp.stack([cos * step[0] - sin * step[1], sin * step[0] + cos * step[1], omega * DT_S])
    around = surround.move_surround(around, step[0], step[1], omega * DT_S)
    return manoeuvre.extend_trail(now, pose), around, pose


@pytest.mark.parametrize("start", [(-0.8, 0.0, 0.0), (-0.8, 0.08, -0.1)])
def test_it_backs_out_of_a_dead_end_and_turns_outside(start):
    pose = jnp.array(start)
    now, around, poses, backed = manoeuvre.initial_manoeuvre(pose), surround.empty_surround(), [start], []
    inside = False
    for _ in range(130):
        inside |= float(pose[0]) > 0.5
        target = (-2.0, 0.0) if inside else (1.0, 0.0)
        now, around, pose = _step(now, around, pose, jnp.array(target))
        assert not meets(ROOM_AND_PASSAGE, pose, KAMUI.length_m, KAMUI.width_m)
        backed.append(bool(now.backing))
        poses.append(pose.tolist())
    x, y, heading = np.array(poses).T
    assert x.max() > 0.5
    assert sum(np.diff(np.array(backed, int)) == 1) == 1
    assert x[1:][backed].min() < -0.2  # outside, as far as its rear end
    assert np.abs(heading[x > 0]).max() < 0.35
    assert np.hypot(x[-1] + 2, y[-1]) < 0.6


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.005, -0.005)])
def test_it_gets_out_of_a_corner_whose_walls_are_beside_and_behind_it(off):
    """3.5 cm from both, it wants to the other side: there is no room to turn, nor to go back the way that it came."""
    pose = jnp.array([-0.385 + off[0], 1.27 + off[1], math.pi])
    now = gone(*[(x, 1.27, math.pi) for x in np.arange(0.4, -0.38, -0.05)], tuple(pose.tolist()))
    angles = np.radians(np.arange(SECTORS) - SECTORS // 2).astype(np.float32)
    ranges_m = cast(ROOM_AND_PASSAGE, pose, angles, SCAN_RANGE_M)
    around = Surround(ranges_m * jnp.cos(angles), ranges_m * jnp.sin(angles))
    for _ in range(300):
        now, around, pose = _step(now, around, pose, jnp.array([-0.9, -1.0]))
        assert not meets(ROOM_AND_PASSAGE, pose, KAMUI.length_m, KAMUI.width_m)
    assert float(pose[1]) < 0.3
