"""Run modes, what lies ahead, free space and the target point: every rule by hand."""

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest

from jexplore.driving import behaviour
from jexplore.driving.records import Divergence, Drive, Latch, RunMode, ScanWalls, Track
from jexplore.driving.sensing.surround import DIRECTIONS
from jexplore.driving.settings import ROBOTS, Tuning, for_world

TUNING, KAMUI = for_world(Tuning(), is_course=True), ROBOTS["kamui"]
INF = math.inf


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
    track = Track() if track is None else track
    for scan in scans:
        track = behaviour.update_track(track, found(*scan), placed, same_m, may_begin)
    return track


def bits(track):
    return f"{int(track.seen):b}"


SEEN, UNSEEN = [(3.0, 0.0, 1.0)], []


def test_centres_are_kept_in_the_odometrys_frame():
    track = followed([[(3.0, 0.5, 1.0)]], placed=ahead_of(10))
    assert track.centre.tolist() == [9.5, 3]
    track = followed([[(3.0, 0.5, 1.0)]], track, placed=ahead_of(10))
    assert (bits(track), track.centre.tolist()) == ("11", [9.5, 3])
    # In the robot's own frame that would be it.
    track = followed([[(9.5, 3.0, 1.0)]], track, placed=ahead_of(10), may_begin=False)
    assert bits(track) == "110"


def test_the_last_nine_scans_vote():
    track = followed([UNSEEN, UNSEEN])
    assert (int(track.age), int(track.seen)) == (0, 0)
    track = followed([SEEN, UNSEEN, SEEN, SEEN])
    assert (int(track.age), bits(track), int(behaviour.votes(track))) == (4, "1011", 3)
    assert [bool(behaviour.is_believed(track, n)) for n in (3, 4)] == [True, False]
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


def test_the_largest_of_the_near_triangles_goes_on_and_the_nearest_begins():
    track = followed([SEEN, [(3.0, 0.1, 0.5), (3.2, 0.0, 1.2), (3.1, 0.0, 0.9), (4.0, 0.0, 2.0)]])
    np.testing.assert_allclose([*track.centre, track.radius], [3.1, 0, 1.1], rtol=1e-6)
    for x, same_m, goes_on in ((3.39, 0.4, True), (3.41, 0.4, False), (3.41, 0.5, True)):
        assert bits(followed([SEEN] * 3 + [[(x, 0.0, 1.0)]], same_m=same_m)) == ("1111" if goes_on else "1110")
    three = [(4.0, 0.0, 2.0), (2.0, -1.0, 0.5), (3.0, 0.0, 1.0)]
    for placed, centre in ((here, [2, -1]), (ahead_of(10), [11, 2])):  # from the robot, wherever it stands
        assert followed([three], placed=placed).centre.tolist() == centre


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


def test_free_space_is_entered_where_there_is_room_and_left_between_walls():
    walls, left, right = (1.0, 1.0), (INF, 1.0), (2.45, 2.6)
    inside, border_m, events = jnp.bool_(False), jnp.float32(INF), ""
    for sides, looks, roomy in (
        (walls, True, True),
        (left, True, False),
        (left, False, True),  # nobody looks
        (left, True, True),
        (right, True, False),
        (walls, False, True),
        (walls, True, True),
    ):
        before, walls_ahead = inside, walls_of(hall_sides=sides, roomy=roomy)
        inside, border_m, missed = behaviour.watch_free_space(
            inside, border_m, jnp.float32(10), walls_ahead, jnp.bool_(looks), TUNING
        )
        events += "." if inside == before else "E" if inside else "L"
        # 0.5 m ahead it begins; it has ended before the robot was there.
        assert float(border_m) == pytest.approx(INF if "E" not in events else 12.9 if "L" in events else 10.5)
        assert bool(missed) == (events[-1] == "L")
    assert events == "...E..L"
    again = behaviour.watch_free_space(inside, border_m, jnp.float32(11), walls_of(hall_sides=left), True, TUNING)
    assert (bool(again[0]), float(again[1]), bool(again[2])) == (True, INF, False)  # a short stretch of walls


@pytest.mark.parametrize(
    ("left_m", "right_m", "open_m", "is_free"),
    [
        (2.5, 2.5, 2.5, False),
        (2.6, 2.3, 2.5, False),  # the paper, which looks at one side only, would call it free
        (2.6, 2.45, 2.5, True),
        (3.9, 1.0, 2.5, False),
        (4.1, 1.0, 2.5, True),
        (INF, INF, 2.5, True),
        (1.5, 1.0, 1.2, True),
    ],
)
def test_free_space_has_room_for_a_circle_between_its_walls(left_m, right_m, open_m, is_free):
    """One wall is farther than C1, and both together are farther than twice that."""
    assert bool(behaviour.is_free_space(left_m, right_m, open_m)) == is_free
    assert bool(behaviour.is_free_space(right_m, left_m, open_m)) == is_free


def driving(*, latch=Latch.FREE, target=(0.0, 0.0), turning=0, left_m=1.0, right_m=1.0):
    return Drive(
        latch=jnp.int32(latch),
        target=jnp.asarray(target, jnp.float32),
        turning=jnp.int32(turning),
        left_m=jnp.float32(left_m),
        right_m=jnp.float32(right_m),
    )


NO_WAY = jnp.zeros(DIRECTIONS)


def walls_of(*, hall_sides=(1.0, 1.0), roomy=True, left_m=1.0, right_m=1.0, closed=False, front_m=5.0):
    return ScanWalls(
        region_sides=tuple(jnp.float32(v) for v in hall_sides),
        roomy=jnp.bool_(roomy),
        closed=jnp.bool_(closed),
        fronts_m=tuple(jnp.float32(v) for v in np.broadcast_to(front_m, 2)),
        left_m=jnp.float32(left_m),
        right_m=jnp.float32(right_m),
        beside=jnp.zeros(2),
    )


def mode_of(drive=None, *, inside=False, ways_m=NO_WAY, **walls):
    drive = driving() if drive is None else drive
    mode, drive = behaviour.choose_mode(drive, jnp.bool_(inside), walls_of(**walls), ways_m, TUNING, KAMUI)
    return RunMode(int(mode)), drive


FLAGS = list(itertools.product((False, True), repeat=6))


def test_modes_in_the_order_of_their_priority():
    for near, latched, closed, inside, left, right in FLAGS:
        mode, _ = mode_of(
            driving(latch=Latch.APPROACH if inside else Latch.LEAVE) if latched else None,
            inside=inside,
            hall_sides=(INF if left else 2.4, 2.7 if right else 2.4),
            closed=closed,
            front_m=0.34 if near else 0.36,  # the guard: half the robot's length
        )
        want = (
            RunMode.CONTACT_GUARD if near
            else RunMode.BRANCH_SELECTION if latched
            else RunMode.DEAD_END if closed
            else RunMode.WALL_FOLLOWING if inside or left or right
            else RunMode.CENTRAL
        )  # fmt: skip
        assert mode == want, (near, latched, closed, inside, left, right)
    assert mode_of(hall_sides=(INF, 1.0), roomy=False)[0] == RunMode.CENTRAL  # a place without room is no free space
    assert mode_of(inside=True, roomy=False)[0] == RunMode.WALL_FOLLOWING
    assert mode_of(driving(latch=Latch.LOOK), front_m=0.2)[0] == RunMode.BRANCH_SELECTION  # it turns in place


def test_the_guard_turns_from_what_is_near_one_half_of_the_front():
    for fronts, left_m, side in (((0.2, 0.5), 2.0, -1), ((0.5, 0.2), 0.5, 1), ((0.3, INF), 2.0, -1)):
        assert int(mode_of(driving(left_m=left_m), front_m=fronts)[1].turning) == side
    for left_m, side in ((2.0, 1), (0.5, -1)):  # a wall across both: to the larger side
        assert int(mode_of(driving(left_m=left_m), front_m=(0.3, 0.3))[1].turning) == side


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


AHEAD = (0.0, 0.0)


def target(mode, left_m, right_m, drive=None, *, edge=AHEAD, robot=(1.0, 2.0)):
    drive = driving(left_m=0.8, right_m=1.1) if drive is None else drive
    sides, edge = ([jnp.float32(v) for v in pair] for pair in ((left_m, right_m), edge))
    found = behaviour.target_point(
        jnp.int32(mode), drive, *sides, tuple(edge), lambda xy: xy - jnp.asarray(robot), TUNING
    )
    return found.tolist()


@pytest.mark.parametrize(
    ("along_deg", "off_m", "want"),
    [
        (30, 0.0, (math.cos(math.pi / 6), 0.5)),
        (-30, 0.0, (math.cos(math.pi / 6), -0.5)),
        (30, 0.4, (math.cos(math.pi / 6) + 0.2, 0.5 - 0.4 * math.cos(math.pi / 6))),
        (0, 1.7, (1, -1)),  # no farther aside than ahead
        (0, -1.7, (1, 1)),
    ],
)
def test_the_target_lies_on_the_edge_of_a_passage_that_bends(along_deg, off_m, want):
    edge = math.radians(along_deg), off_m
    assert target(RunMode.CENTRAL, 1.0, 1.0, edge=edge) == pytest.approx(want, abs=1e-6)


@pytest.mark.parametrize(
    ("mode", "left_m", "right_m", "aside"),
    [
        (RunMode.WALL_FOLLOWING, INF, 1.5, -0.4),  # the wall on the right was 1.1 m away
        (RunMode.WALL_FOLLOWING, 1.5, 1.0, 0.1),
        (RunMode.WALL_FOLLOWING, 1.5, INF, 0.7),  # that on the left 0.8 m
        (RunMode.WALL_FOLLOWING, 1.2, 1.2, 0.4),  # equally near: the left one
        (RunMode.WALL_FOLLOWING, INF, INF, 0),
        (RunMode.WALL_FOLLOWING, 2.6, 3.0, 1),  # both open: the left wall was nearer; no farther aside than ahead
        (RunMode.WALL_FOLLOWING, INF, 2.6, 0),  # it is out of sight
        (RunMode.CENTRAL, 2.6, 1.0, 0.1),  # a passage with an open side is driven along the other
        (RunMode.CENTRAL, 1.0, 2.6, 0.2),
        (RunMode.CENTRAL, 2.4, 1.0, 0.7),  # else the middle of the known
        (RunMode.CENTRAL, INF, INF, 0.7),
    ],
)
def test_the_nearer_wall_is_followed_at_the_distance_it_had(mode, left_m, right_m, aside):
    assert target(mode, left_m, right_m, edge=(0.0, -0.7)) == pytest.approx([1, aside])


def test_the_target_of_branch_selection_is_that_of_the_latch():
    drive = driving(latch=Latch.LEAVE, target=(4.0, 7.0))
    for edge in (AHEAD, (0.3, 0.2)):
        assert target(RunMode.BRANCH_SELECTION, 1.0, 0.2, drive, edge=edge) == pytest.approx([3.0, 5.0])
    assert target(RunMode.CONTACT_GUARD, 1.0, 1.0, drive) == [1, 0]
