"""The middle of a known place, found by a robot that has looked round, at a junction to check with a pencil."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from ref.runs import a_state

from jexplore import btm
from jexplore.driving import approach, behaviour, events, mapping
from jexplore.driving.building.walls import Walls, cast
from jexplore.driving.records import Ahead, Divergence, Latch, RunMode, Surround, Track
from jexplore.driving.sensing import surround
from jexplore.driving.sensing.surround import SECTORS
from jexplore.driving.settings import ROBOTS, Tuning, for_world
from jexplore.driving.vehicle import SCAN_RANGE_M, to_odometry

KAMUI, TUNING = ROBOTS["kamui"], for_world(Tuning(), is_course=True)
# A passage along x, two metres wide, and one that leads north from it. The largest circle touches the wall in the south
# and both corners: 0.8 ** 2 + (1 - y) ** 2 = (1 + y) ** 2.
T = Walls(
    x=jnp.array([[-0.8, 1, 8], [0.8, 1, 8]]),
    y=jnp.array([[-1, -8, 8], [1, -8, -0.8], [1, 0.8, 8]]),
)
Y_M, RADIUS_M = 0.16, 1.16


def looked_round(node, radius_m, robot_x_m=0.0, track_x_m=None, looked=math.pi, seen=511):
    """Return `Latched` of a robot that has looked round.

    It stands at `(robot_x_m, Y_M)`, has turned by `looked` radians, has seen a circle of `RADIUS_M` there, and its map
    has a divergence `node` with a circle of `radius_m`.
    """
    pose = jnp.array([robot_x_m, Y_M, 0.0])
    angles = np.radians(np.arange(SECTORS) - SECTORS // 2).astype(np.float32)
    ranges = cast(T, pose, angles, SCAN_RANGE_M)
    around = Surround(ranges * np.cos(angles), ranges * np.sin(angles))
    writer = mapping.begin_map(mapping.SLOPE_STEPS, 8, 16, jnp.array([-50.0, 0.0, 0.0]), False)
    map_, _ = btm.add_node(writer.map, btm.DIVERGENCE, *node, radius_m=radius_m)
    drive = behaviour.initial_drive().replace(latch=jnp.int32(Latch.LOOK), looked=jnp.float32(looked))
    state = a_state(
        drive=drive.replace(target=pose[:2]),
        writer=writer.replace(map=map_),
        estimate=pose,
        mode=jnp.int32(RunMode.BRANCH_SELECTION),
        odometer_m=jnp.float32(100),
    )
    at = pose[:2] if track_x_m is None else jnp.array([track_x_m, Y_M])
    track = Track(at, jnp.float32(RADIUS_M), jnp.uint32(seen), jnp.int32(20), jnp.float32(math.nan))
    ahead = Ahead(**dict.fromkeys(Ahead._fields))._replace(  # type: ignore[arg-type]
        track=track, space=behaviour.no_free_space(), leans=jnp.bool_(False)
    )
    ways_m = surround.free_lengths(around, KAMUI)
    return approach.select_branch(state, ahead, around, ways_m, to_odometry(pose), TUNING, KAMUI)


@pytest.mark.parametrize("node", [(0.0, Y_M), (0.2, Y_M), (0.7, -0.3), (-0.5, 0.9)])
def test_a_known_place_is_where_a_circle_as_large_is_seen(node):
    found = looked_round(node, RADIUS_M - 0.05)
    assert bool(found.arrives)
    assert found.track.centre.tolist() == pytest.approx([0, Y_M])


def test_the_robot_goes_to_where_it_sees_that_circle():
    found = looked_round((0.9, Y_M), RADIUS_M, robot_x_m=0.42)
    assert (bool(found.arrives), bool(found.drive.known), int(found.drive.latch)) == (False, True, Latch.APPROACH)
    assert found.drive.target.tolist() == pytest.approx([0, Y_M], abs=0.1)  # beams are a degree apart


@pytest.mark.parametrize(
    ("robot_x_m", "looked", "seen", "goes_on"),
    [
        (4.0, approach.LOOK_RAD - 0.01, 511, True),
        (4.0, approach.LOOK_RAD + 0.01, 511, True),
        (4.0, approach.LOOK_RAD + 0.01, 510, False),  # one scan has not shown it
        (4.0, approach.LOOK_RAD + approach.LOOK_ON_RAD + 0.01, 511, False),
        (0.0, approach.LOOK_RAD + 0.01, 511, False),  # there is a place
    ],
)
def test_where_it_sees_no_place_that_all_scans_have_shown_it_looks_a_little_longer(robot_x_m, looked, seen, goes_on):
    """In the passage no place exists: the one seen was noise, or noise hides it now."""
    found = looked_round((0.0, 50.0), RADIUS_M, robot_x_m, looked=looked, seen=seen)
    assert (int(found.drive.latch) == Latch.LOOK) == goes_on
    assert bool(found.gives_up) == (not goes_on and robot_x_m > 0)
    assert bool(found.arrives) == (not goes_on and robot_x_m == 0)
    assert int(found.track.age) == (0 if found.gives_up else 20)


@pytest.mark.parametrize(
    ("place", "radius_m", "middle"),
    [
        ((0.5, 0.1), 1.0, (0.8, 0.0)),  # of three circles as large the nearest to where the map has the place
        ((0.3, 0.1), 1.0, (0.0, 0.0)),
        ((0.5, 0.1), 2.0, (0.5, 0.6)),
        ((0.5, 0.1), 1.3, (0.5, 0.1)),  # none is as large
        ((0.0, 1.1), 1.0, (0.0, 1.1)),  # nor as near
    ],
)
def test_of_circles_as_large_the_nearest_to_where_the_map_has_the_place(place, radius_m, middle):
    centres = jnp.array([(0.0, 0.0), (0.8, 0.0), (-0.8, 0.0), (0.5, 0.6), (0.5, 0.1)])
    radii, valid = jnp.array([1.0, 1.05, 1.0, 1.95, 1.0]), jnp.arange(5) < 4  # the last is unused
    seen = Divergence(jnp.zeros((5, 3, 2)), centres, radii, valid, jnp.int32(0))
    found = approach._middle((jnp.array(place), jnp.float32(radius_m)), centres, seen)
    assert found.tolist() == pytest.approx(middle)


@pytest.mark.parametrize("radius_m", [RADIUS_M / 1.3, RADIUS_M * 1.3])
def test_where_no_circle_as_large_is_seen_it_goes_to_where_the_map_has_the_place(radius_m):
    found = looked_round((0.7, -0.3), radius_m)
    assert (bool(found.arrives), bool(found.drive.known), int(found.drive.latch)) == (False, True, Latch.APPROACH)
    assert found.drive.target.tolist() == pytest.approx([0.7, -0.3])


def test_a_place_beyond_the_circle_is_another_one():
    found = looked_round((1.2, Y_M), RADIUS_M)
    assert bool(found.arrives)
    assert found.track.centre.tolist() == pytest.approx([0, Y_M])


# ---------------------------------------------------------------- places seen on the way


def test_a_place_that_a_robot_sees_from_afar_as_it_looks_round_is_gone_to():
    found = looked_round((0.0, -5.0), RADIUS_M, robot_x_m=-1.5, track_x_m=0.0)
    assert not bool(found.arrives)
    assert int(found.drive.latch) == Latch.APPROACH
    assert found.drive.target.tolist() == pytest.approx([0, Y_M])


def leaving(track_xy, target, out_m, latch=Latch.LEAVE, passed=None, guide=None):
    """Return whether a robot that leaves a place, `out_m` beyond its circle, begins to approach a place it has seen.

    All lie along an axis that is turned by 40 degrees. `passed`: x and radius of a rejected candidate.
    """
    cos, sin = math.cos(0.7), math.sin(0.7)

    def turned(x, y):
        return jnp.array([cos * x - sin * y, sin * x + cos * y])

    writer = mapping.begin_map(mapping.SLOPE_STEPS, 8, 16, jnp.array([-50.0, 0.0, 0.0]), False)
    map_, node = btm.add_node(writer.map, btm.DIVERGENCE, 0.0, 0.0, radius_m=1.0)
    if passed is not None:
        writer = writer.replace(passed=jnp.array([*turned(passed[0], 0.0), passed[1], 5.0]))
    state = a_state(
        drive=behaviour.initial_drive().replace(latch=jnp.int32(latch), target=turned(*target)),
        writer=writer.replace(map=map_, node=node, node_m=jnp.float32(4), guide=guide),
        estimate=jnp.append(turned(1.0 + out_m, 0.0), 0.3),
    )
    track = Track(turned(*track_xy), jnp.float32(1.2), jnp.uint32(511), jnp.int32(20), jnp.float32(math.nan))
    return bool(approach._is_on_way(state, track, TUNING))


@pytest.mark.parametrize(
    ("place", "target", "out_m", "heeds"),
    [
        ((4.0, 0.3), (7.0, 0.0), 0.8, True),
        ((4.0, 0.3), (7.0, 0.0), 0.3, False),  # it has not left yet
        ((4.0, 0.7), (7.0, 0.0), 0.8, False),  # abeam of its way
        ((8.0, 0.0), (7.0, 0.0), 0.8, False),  # behind the opening
        ((1.5, 0.0), (7.0, 0.0), 0.8, False),  # it has gone past it
        ((2.0, 0.0), (2.7, 0.0), 0.8, False),  # it is there in a moment
    ],
)
def test_on_the_way_to_a_far_opening_a_robot_heeds_places_that_it_passes(place, target, out_m, heeds):
    assert leaving(place, target, out_m) == heeds
    assert not leaving(place, target, out_m, latch=Latch.APPROACH)


def test_it_has_left_a_place_that_was_none_as_well():
    assert not leaving((4.0, 0.3), (7.0, 0.0), 0.8, passed=(1.5, 1.0))
    assert leaving((4.0, 0.3), (7.0, 0.0), 2.2, passed=(1.5, 1.0))


def test_a_robot_that_follows_a_route_heeds_none_on_the_way():
    assert not leaving((4.0, 0.3), (7.0, 0.0), 0.8, guide=object())


# A corridor along y, and doors 0.9 m wide on both sides, not quite opposite, into wide rooms.
CORRIDOR = Walls(
    x=jnp.array([[0.0, -9, -0.45], [0.0, 0.45, 9], [2.35, -9, -0.05], [2.35, 0.85, 9], [-6.0, -4, 4], [7.0, -4, 4]]),
    y=jnp.array([[-4.0, -6, 0], [4.0, -6, 0], [-4.0, 2.35, 7], [4.0, 2.35, 7]]),
)


def crossing(monkeypatch, near_m):
    """Triangles in the corridor, between its doors, of a robot that comes out of one of them."""
    monkeypatch.setattr(events, "NEAR_POINTS_M", near_m)
    angles = np.radians(np.arange(SECTORS) - SECTORS // 2).astype(np.float32)
    ranges = cast(CORRIDOR, jnp.array([0.2, 0.0, 0.0]), angles, SCAN_RANGE_M)
    xy = jnp.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)
    found = events.triangles(xy, ranges < SCAN_RANGE_M, jnp.float32(8), for_world(Tuning(), is_course=False))
    place = found.centre + jnp.array([0.2, 0.0])
    return int(jnp.sum(found.valid & (jnp.hypot(*(place - jnp.array([1.2, 0.2])).T) < 0.5)))


@pytest.mark.jit
def test_a_robot_that_looks_far_sees_what_is_near_as_well(monkeypatch):
    """Of all that it sees within 8 m, 48 points lie farther apart than the doors are wide."""
    assert crossing(monkeypatch, near_m=8.0) == 0
    assert crossing(monkeypatch, near_m=4.0) > 0
