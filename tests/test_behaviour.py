"""Run modes, what lies ahead, free space and the target point: every rule by hand."""

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.driving import behaviour
from jexplore.driving.behaviour import Latch, RunMode
from jexplore.driving.perception import Divergence
from jexplore.driving.settings import ROBOTS, Tuning

TUNING, KAMUI = Tuning(), ROBOTS["kamui"]
INF = math.inf


# ---------------------------------------------------------------- what lies ahead


def found(*triangles, size=4):
    """Triangles `(x, y, radius)` in the robot's frame; the last slots are unused and hold what must not be read."""
    rows = [*triangles, *[(3.0, 0.1, 9.0)] * (size - len(triangles))]
    x, y, radius = jnp.asarray(rows, jnp.float32).T
    return Divergence(
        corners=jnp.zeros((size, 3, 2)),
        centre=jnp.stack([x, y], axis=1),
        radius=radius,
        valid=jnp.arange(size) < len(triangles),
        overflow=jnp.int32(0),
    )


def ahead_of(x):
    """The odometry of a robot at (x, 0) that looks along +y."""

    def placed(xy):
        return jnp.stack([x - xy[..., 1], xy[..., 0]], axis=-1)

    return placed


def here(xy):
    return xy


def followed(scans, track=None, *, same_m=0.4, may_begin=True, placed=here):
    track = behaviour.no_track() if track is None else track
    for scan in scans:
        track = behaviour.follow(track, found(*scan), placed, same_m, may_begin)
    return track


def bits(track):
    return f"{int(track.seen):b}"


SEEN, UNSEEN = [(3.0, 0.0, 1.0)], []


def test_nothing_is_followed_until_a_triangle_shows():
    track = followed([UNSEEN, UNSEEN])
    assert (int(track.age), int(track.seen), int(behaviour.votes(track))) == (0, 0, 0)
    assert not behaviour.is_believed(track, 0)
    track = followed([UNSEEN, SEEN])
    assert (int(track.age), bits(track), int(behaviour.votes(track))) == (1, "1", 1)
    assert track.centre.tolist() == [3, 0]
    assert float(track.radius) == 1


def test_centres_are_kept_in_the_odometrys_frame():
    track = followed([[(3.0, 0.5, 1.0)]], placed=ahead_of(10))
    assert track.centre.tolist() == [9.5, 3]
    track = followed([[(3.0, 0.5, 1.0)]], track, placed=ahead_of(10))
    assert (bits(track), track.centre.tolist()) == ("11", [9.5, 3])
    # In the robot's own frame that would be it.
    track = followed([[(9.5, 3.0, 1.0)]], track, placed=ahead_of(10), may_begin=False)
    assert bits(track) == "110"


def test_scans_vote():
    track = followed([SEEN, UNSEEN, SEEN, SEEN])
    assert (int(track.age), bits(track), int(behaviour.votes(track))) == (4, "1011", 3)
    assert behaviour.is_believed(track, 3)
    assert not behaviour.is_believed(track, 4)


def test_only_the_last_nine_scans_vote():
    track = followed([SEEN] * 12)
    assert (int(track.age), bits(track), int(behaviour.votes(track))) == (12, "1" * 9, 9)
    track = followed([UNSEEN] * 8, track)
    assert (int(track.age), bits(track)) == (20, "100000000")
    track = followed([UNSEEN], track)
    assert (int(track.age), int(track.seen)) == (0, 0)
    assert not behaviour.is_believed(track, 0)


def test_the_place_is_the_mean_of_what_was_seen():
    track = followed([[(3.0, 0.0, 1.0)], [(3.2, 0.0, 1.3)], UNSEEN])
    np.testing.assert_allclose([*track.centre, track.radius], [3.1, 0, 1.15], rtol=1e-6)
    track = followed([[(3.1, 0.2, 1.15)]], track)  # the fourth scan weighs a quarter
    np.testing.assert_allclose([*track.centre, track.radius], [3.1, 0.05, 1.15], rtol=1e-6)
    old = followed([SEEN] * 20)
    new = followed([[(3.09, 0.0, 1.9)]], old)  # never less than a ninth
    np.testing.assert_allclose([*new.centre, new.radius], [3.01, 0, 1.1], rtol=1e-6)


@pytest.mark.parametrize(("x", "same_m", "goes_on"), [(3.39, 0.4, True), (3.41, 0.4, False), (3.41, 0.5, True)])
def test_a_triangle_goes_on_within_same_m(x, same_m, goes_on):
    track = followed([SEEN] * 3 + [[(x, 0.0, 1.0)]], same_m=same_m)
    assert bits(track) == ("1111" if goes_on else "1110")
    assert (float(track.centre[0]) > 3) == goes_on


def test_the_largest_of_the_near_triangles_goes_on():
    track = followed([SEEN, [(3.0, 0.1, 0.5), (3.2, 0.0, 1.2), (3.1, 0.0, 0.9), (4.0, 0.0, 2.0)]])
    np.testing.assert_allclose([*track.centre, track.radius], [3.1, 0, 1.1], rtol=1e-6)


def test_the_nearest_triangle_begins():
    track = followed([[(4.0, 0.0, 2.0), (2.0, -1.0, 0.5), (3.0, 0.0, 1.0)]])
    assert (track.centre.tolist(), float(track.radius)) == ([2, -1], 0.5)
    # From the robot, wherever it stands.
    track = followed([[(4.0, 0.0, 2.0), (2.0, -1.0, 0.5), (3.0, 0.0, 1.0)]], placed=ahead_of(10))
    assert track.centre.tolist() == [11, 2]


def test_a_doubtful_one_gives_way_to_another():
    far = [(5.0, 0.0, 0.7)]
    track = followed([SEEN, SEEN, far])
    assert (int(track.age), bits(track), track.centre.tolist()) == (1, "1", [5, 0])
    assert float(track.radius) == pytest.approx(0.7)
    track = followed([SEEN, SEEN, SEEN, far])
    assert (int(track.age), bits(track), track.centre.tolist()) == (4, "1110", [3, 0])
    # Votes count, not age.
    track = followed([SEEN] * 3 + [UNSEEN] * 7 + [far])
    assert (int(track.age), track.centre.tolist()) == (1, [5, 0])


def test_one_that_may_not_begin_does_not():
    assert int(followed([SEEN], may_begin=False).age) == 0
    track = followed([SEEN, SEEN])
    track = followed([[(5.0, 0.0, 1.0)]], track, may_begin=False)
    assert (int(track.age), bits(track), track.centre.tolist()) == (3, "110", [3, 0])
    track = followed([SEEN], track, may_begin=False)
    assert (int(track.age), bits(track)) == (4, "1101")


# ---------------------------------------------------------------- free space


def watched(looks, *, open_m=2.5):
    """`(events, halls)` of looks `(left_m, right_m)`, the odometer in steps of 0.1 m; None: nobody looks."""
    hall, events, halls = behaviour.no_free_space(), "", []
    for i, look in enumerate(looks):
        sides = (1.0, 1.0) if look is None else look
        hall, enters, leaves = behaviour.watch_free_space(
            hall, *sides, jnp.float32(i / 10), open_m, jnp.bool_(look is not None)
        )
        events += "E" if enters else "L" if leaves else "."
        assert not (enters and leaves)
        halls.append(hall)
    return events, halls


WALLS, LEFT, RIGHT = (1.0, 1.0), (INF, 1.0), (1.0, 2.6)


def test_a_free_space_is_believed_at_the_third_look():
    events, halls = watched([WALLS, LEFT, RIGHT, LEFT, LEFT, WALLS, WALLS, WALLS, WALLS])
    assert events == "...E...L."
    assert [bool(hall.inside) for hall in halls] == [False] * 3 + [True] * 4 + [False] * 2
    assert [int(hall.streak) for hall in halls] == [0, 1, 2, 0, 0, 1, 2, 0, 0]
    assert float(halls[3].since_m) == pytest.approx(0.1)  # where it was first seen
    assert float(halls[7].since_m) == pytest.approx(0.5)


def test_looks_that_disagree_begin_anew():
    events, halls = watched([LEFT, LEFT, WALLS, LEFT, LEFT, LEFT])
    assert events == ".....E"
    assert float(halls[-1].since_m) == pytest.approx(0.3)


def test_free_space_ends_where_the_walls_are_nearer_than_where_it_began():
    # Entered above 2.5 m, left at 2.2 m.
    for width, inside, event in ((2.5, False, "..."), (2.51, False, "..E"), (2.21, True, "..."), (2.19, True, "..L")):
        before = [(3.0, 3.0)] * 3 if inside else []
        assert watched([*before, *[(width, 1.0)] * 3])[0][-3:] == event
        assert watched([*before, *[(1.0, width)] * 3])[0][-3:] == event
    assert watched([(1.3, 1.0)] * 3, open_m=1.2)[0] == "..E"


def test_nothing_changes_while_nobody_looks():
    events, halls = watched([LEFT, LEFT, LEFT, None, None, None, None])
    assert events == "..E...."
    assert halls[-1].inside
    assert watched([LEFT, LEFT, None, LEFT, LEFT, LEFT])[0] == ".....E"


# ---------------------------------------------------------------- run modes


def driving(*, latch=Latch.FREE, target=(0.0, 0.0), turning=0, left_m=1.0, right_m=1.0):
    return behaviour.Drive(
        latch=jnp.int32(latch),
        target=jnp.asarray(target, jnp.float32),
        turning=jnp.int32(turning),
        left_m=jnp.float32(left_m),
        right_m=jnp.float32(right_m),
    )


def in_hall(inside):
    return behaviour.no_free_space().replace(inside=jnp.bool_(inside))


def _fronts(front_m):
    return tuple(jnp.float32(v) for v in np.broadcast_to(front_m, 2))


def mode_of(drive=None, *, inside=False, hall_sides=(1.0, 1.0), left_m=1.0, right_m=1.0, closed=False, front_m=5.0):
    mode, drive = behaviour.choose_mode(
        driving() if drive is None else drive, in_hall(inside), hall_sides, jnp.float32(left_m), jnp.float32(right_m),
        jnp.bool_(closed), _fronts(front_m), TUNING, KAMUI,
    )  # fmt: skip
    return RunMode(int(mode)), drive


FLAGS = list(itertools.product((False, True), repeat=6))


def test_modes_in_the_order_of_their_priority():
    for near, latched, closed, inside, left, right in FLAGS:
        mode, _ = mode_of(
            driving(latch=Latch.APPROACH if inside else Latch.LEAVE) if latched else None,
            inside=inside,
            hall_sides=(INF if left else 2.4, 2.6 if right else 2.4),
            closed=closed,
            front_m=0.44 if near else 0.46,  # the guard: half the robot's length and 0.1 m
        )
        want = (
            RunMode.CONTACT_GUARD if near
            else RunMode.BRANCH_SELECTION if latched
            else RunMode.DEAD_END if closed
            else RunMode.WALL_FOLLOWING if inside or left or right
            else RunMode.CENTRAL
        )  # fmt: skip
        assert mode == want, (near, latched, closed, inside, left, right)


def test_the_guard_turns_from_what_is_near_one_half_of_the_front():
    for fronts, left_m, side in (((0.2, 0.5), 2.0, -1), ((0.5, 0.2), 0.5, 1), ((0.3, INF), 2.0, -1)):
        assert int(mode_of(driving(left_m=left_m), front_m=fronts)[1].turning) == side
    for left_m, side in ((2.0, 1), (0.5, -1)):  # a wall across both: to the larger side
        assert int(mode_of(driving(left_m=left_m), front_m=(0.3, 0.34))[1].turning) == side


@pytest.mark.parametrize(("left_m", "right_m", "side"), [(1.2, 0.8, 1), (0.8, 1.2, -1), (1.0, 1.0, 1)])
def test_a_dead_end_turns_to_the_larger_side_and_keeps_to_it(left_m, right_m, side):
    mode, drive = mode_of(driving(left_m=left_m, right_m=right_m), closed=True, left_m=0.1, right_m=0.2)
    assert (mode, int(drive.turning)) == (RunMode.DEAD_END, side)
    swapped = drive.replace(left_m=drive.right_m, right_m=drive.left_m)
    for more in ({"closed": True}, {"front_m": 0.2}):  # the guard turns on the same way
        mode, after = mode_of(swapped, **more)
        assert int(after.turning) == side
        assert mode in (RunMode.DEAD_END, RunMode.CONTACT_GUARD)
    _, after = mode_of(swapped)
    assert int(after.turning) == 0
    _, after = mode_of(swapped.replace(latch=jnp.int32(Latch.LEAVE)), closed=True)
    assert int(after.turning) == 0  # branch selection does not turn in place


def test_walls_are_remembered_only_in_a_passage():
    _, drive = mode_of(left_m=0.7, right_m=0.9)
    assert (float(drive.left_m), float(drive.right_m)) == pytest.approx((0.7, 0.9))
    _, drive = mode_of(left_m=INF, right_m=0.9)
    assert (float(drive.left_m), float(drive.right_m)) == pytest.approx((1, 0.9))
    _, drive = mode_of(left_m=0.7, right_m=2.5)
    assert (float(drive.left_m), float(drive.right_m)) == pytest.approx((0.7, 1))
    latched = driving(latch=Latch.APPROACH)
    for more in ({"inside": True}, {"hall_sides": (INF, 1.0)}, {"closed": True}, {"drive": latched}):
        _, drive = mode_of(left_m=0.7, right_m=0.9, **more)
        assert (float(drive.left_m), float(drive.right_m)) == (1, 1)


def test_at_rest_nothing_is_held():
    drive = behaviour.at_rest()
    assert (int(drive.latch), int(drive.turning)) == (Latch.FREE, 0)
    assert (drive.target.tolist(), float(drive.left_m), float(drive.right_m)) == ([0, 0], 1, 1)


# ---------------------------------------------------------------- target point


def target(mode, left_m, right_m, drive=None):
    drive = driving(left_m=0.8, right_m=1.1) if drive is None else drive
    sides = jnp.float32(left_m), jnp.float32(right_m)
    return behaviour.target_of(jnp.int32(mode), drive, *sides, lambda xy: xy - jnp.asarray([1.0, 2.0]), TUNING).tolist()


@pytest.mark.parametrize(("left_m", "right_m", "aside"), [(1.0, 1.0, 0), (1.4, 1.0, 0.2), (0.5, 1.5, -0.5)])
def test_the_middle_of_a_passage(left_m, right_m, aside):
    assert target(RunMode.CENTRAL, left_m, right_m) == pytest.approx([TUNING.ahead_m, aside])


@pytest.mark.parametrize(
    ("left_m", "right_m", "aside"),
    [
        (INF, 1.5, -0.4),  # the wall on the right was 1.1 m away
        (INF, 0.8, 0.3),
        (1.5, 1.0, 0.1),
        (1.5, INF, 0.7),  # that on the left 0.8 m
        (0.5, 0.6, -0.3),
        (1.2, 1.2, 0.4),  # equally near: the left one
        (INF, INF, 0),
        (2.6, 3.0, 1),  # both open: the left wall was the nearer, and no farther aside than ahead
        (3.0, 2.6, 1),
        (3.0, INF, 1),
        (INF, 2.6, 0),  # it is out of sight
    ],
)
def test_the_nearer_wall_is_followed_at_the_distance_it_had(left_m, right_m, aside):
    assert target(RunMode.WALL_FOLLOWING, left_m, right_m) == pytest.approx([1, aside])


@pytest.mark.parametrize(
    ("left_m", "right_m", "aside"), [(2.4, 1.0, 0.7), (2.6, 1.0, 0.1), (1.0, 2.6, 0.2), (INF, INF, 0), (2.6, 2.6, 1)]
)
def test_a_passage_with_an_open_side_is_driven_along_the_other(left_m, right_m, aside):
    assert target(RunMode.CENTRAL, left_m, right_m) == pytest.approx([1, aside])


def test_the_target_of_a_latch_in_the_robots_frame():
    drive = driving(latch=Latch.LEAVE, target=(4.0, 7.0))
    assert target(RunMode.BRANCH_SELECTION, 1.0, 0.2, drive) == [3, 5]
    assert target(RunMode.CONTACT_GUARD, 1.0, 1.0, drive) == [1, 0]


# ---------------------------------------------------------------- speeds


def steered(xy, mode=RunMode.CENTRAL, turning=0, tuning=TUNING):
    v, omega = behaviour.steer(jnp.int32(mode), driving(turning=turning), jnp.asarray(xy, jnp.float32), tuning, KAMUI)
    return float(v), float(omega)  # fmt: skip


def test_speed_and_turn_rate_by_hand():
    assert steered((1, 0)) == pytest.approx((0.4, 0))
    angle = math.radians(30)
    for side in (1, -1):
        at = 2 * math.cos(angle), 2 * side * math.sin(angle)
        assert steered(at) == pytest.approx((0.4 * math.cos(angle), 1.5 * side * angle))
        assert steered(at, RunMode.BRANCH_SELECTION) == steered(at, RunMode.WALL_FOLLOWING) == steered(at)
    slow = Tuning(speed_m_s=0.1, turn_gain=0.5)
    assert steered((3, 3), tuning=slow) == pytest.approx((0.1 * math.sqrt(0.5), 0.5 * math.pi / 4))


def test_no_faster_than_the_robot_can():
    fast = Tuning(speed_m_s=50.0, turn_gain=100.0)
    assert steered((1, 0), tuning=fast)[0] == pytest.approx(KAMUI.max_speed_m_s)
    assert steered((1, 0.5), tuning=fast)[1] == KAMUI.max_turn_rad_s
    assert steered((1, -0.5), tuning=fast)[1] == -KAMUI.max_turn_rad_s


def test_it_turns_in_place_towards_what_lies_behind():
    for y in (0.5, -0.5):
        assert steered((-1, y)) == (0, math.copysign(KAMUI.max_turn_rad_s, y))
    assert steered((0, 1))[0] == pytest.approx(0, abs=1e-6)
    assert steered((0, 0)) == pytest.approx((0.4, 0))  # on the target


@pytest.mark.parametrize("mode", [RunMode.DEAD_END, RunMode.CONTACT_GUARD])
def test_a_dead_end_turns_in_place_at_half_the_rate(mode):
    for turning in (1, -1, 0):
        assert steered((1, 0.3), mode, turning) == (0, turning * KAMUI.max_turn_rad_s / 2)
