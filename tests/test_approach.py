"""The middle of a known place, found by a robot that has looked round, at a junction to check with a pencil."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.runs import a_state

from jexplore import btm
from jexplore.driving import approach, behaviour
from jexplore.driving.building.walls import cast
from jexplore.driving.params.tree import P
from jexplore.driving.records import Ahead, Latch, RunMode, Surround, Track, Walls
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


@jax.jit
def selected(state, track, pose):
    angles = np.radians(np.arange(SECTORS) - SECTORS // 2).astype(np.float32)
    ranges = cast(T, pose, angles, SCAN_RANGE_M)
    around = Surround(ranges * np.cos(angles), ranges * np.sin(angles))
    ahead = Ahead(**dict.fromkeys(Ahead._fields))._replace(  # type: ignore[arg-type]
        track=track, space=behaviour.no_free_space(), leans=jnp.bool_(False)
    )
    ways_m = surround.free_lengths(around, KAMUI)
    return approach.select_branch(state, ahead, around, ways_m, to_odometry(pose), TUNING, KAMUI)


def looked_round(node, radius_m, robot_x_m=0.0, track_x_m=None, looked=math.pi, seen=511, age=20):
    """Return `Latched` of a robot that has looked round.

    It stands at `(robot_x_m, Y_M)`, has turned by `looked` radians, has seen a circle of `RADIUS_M` there, and its map
    has a divergence `node` with a circle of `radius_m`.
    """
    pose = jnp.array([robot_x_m, Y_M, 0.0])
    writer = a_state().writer
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
    track = Track(at, jnp.float32(RADIUS_M), jnp.uint32(seen), jnp.int32(age))
    return selected(state, track, pose)


@pytest.mark.jit
@pytest.mark.parametrize(
    ("node", "radius_m", "robot_x_m", "track_x_m", "arrives", "goes_to"),
    [
        # A known place is where a circle as large is seen.
        ((0.0, Y_M), RADIUS_M - 0.05, 0.0, None, True, (0, Y_M)),
        ((0.7, -0.3), RADIUS_M - 0.05, 0.0, None, True, (0, Y_M)),
        ((-0.5, 0.9), RADIUS_M - 0.05, 0.0, None, True, (0, Y_M)),
        ((1.2, Y_M), RADIUS_M, 0.0, None, True, (0, Y_M)),  # beyond the circle: another one
        ((0.9, Y_M), RADIUS_M, 0.42, None, False, (0, Y_M)),  # from aside the robot goes there
        # Where none as large is seen, it goes to where the map has the place.
        ((0.7, -0.3), RADIUS_M / 1.3, 0.0, None, False, (0.7, -0.3)),
        ((0.7, -0.3), RADIUS_M * 1.3, 0.0, None, False, (0.7, -0.3)),
        ((0.0, -5.0), RADIUS_M, -1.5, 0.0, False, (0, Y_M)),  # a place seen from afar
    ],
)
def test_where_a_robot_that_has_looked_round_goes(node, radius_m, robot_x_m, track_x_m, arrives, goes_to):
    found = looked_round(node, radius_m, robot_x_m, track_x_m)
    assert bool(found.arrives) == arrives
    if arrives:
        assert found.track.centre.tolist() == pytest.approx(goes_to)
    else:
        assert int(found.drive.latch) == Latch.APPROACH
        assert bool(found.drive.known) == (track_x_m is None)
        assert found.drive.target.tolist() == pytest.approx(goes_to, abs=0.1)  # beams are a degree apart


@pytest.mark.jit
def test_without_a_place_it_takes_the_one_that_it_sees():
    assert int(looked_round((0.0, 50.0), RADIUS_M, age=0).track.age) == 1


@pytest.mark.jit
@pytest.mark.parametrize(
    ("robot_x_m", "looked", "seen", "goes_on"),
    [
        (4.0, P.motion.look_rad - 0.01, 511, True),
        (4.0, P.motion.look_rad + 0.01, 511, True),
        (4.0, P.motion.look_rad + 0.01, 510, False),  # one scan has not shown it
        (4.0, P.motion.look_rad + P.motion.look_on_rad + 0.01, 511, False),
        (0.0, P.motion.look_rad + 0.01, 511, False),  # there is a place
    ],
)
def test_where_it_sees_no_place_that_all_scans_have_shown_it_looks_a_little_longer(robot_x_m, looked, seen, goes_on):
    """In the passage no place exists: the one seen was noise, or noise hides it now."""
    found = looked_round((0.0, 50.0), RADIUS_M, robot_x_m, looked=looked, seen=seen)
    assert (int(found.drive.latch) == Latch.LOOK) == goes_on
    assert bool(found.gives_up) == (not goes_on and robot_x_m > 0)
    assert bool(found.arrives) == (not goes_on and robot_x_m == 0)
    assert int(found.track.age) == (0 if found.gives_up else 20)
