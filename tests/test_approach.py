"""A robot that has looked round, at a junction to check with a pencil."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.passages import cast
from ref.runs import a_state

from jexplore.driving import approach
from jexplore.driving.params.tree import P
from jexplore.driving.records import Ahead, Drive, Latch, RunMode, Surround, Track, Walls
from jexplore.driving.sensing import surround
from jexplore.driving.sensing.surround import SECTORS
from jexplore.driving.settings import ROBOTS, Tuning, for_world
from jexplore.driving.vehicle import SCAN_RANGE_M

KAMUI, TUNING = ROBOTS["kamui"], for_world(Tuning(), is_course=True)
# A passage along x, two metres wide, and one that leads north from it. The largest circle touches the wall in the south
# and both corners: 0.8 ** 2 + (1 - y) ** 2 = (1 + y) ** 2.
T = Walls(x=jnp.array([[-0.8, 1, 8], [0.8, 1, 8]]), y=jnp.array([[-1, -8, 8], [1, -8, -0.8], [1, 0.8, 8]]))
Y_M, RADIUS_M = 0.16, 1.16


@jax.jit
def selected(state, track, pose):
    angles = np.radians(np.arange(SECTORS) - SECTORS // 2).astype(np.float32)
    ranges = cast(T, pose, angles, SCAN_RANGE_M)
    around = Surround(ranges * np.cos(angles), ranges * np.sin(angles))
    ahead = Ahead(**dict.fromkeys(Ahead._fields))._replace(leans=jnp.bool_(False))  # type: ignore[arg-type]
    ways_m = surround.free_lengths(around, KAMUI)
    state = state.replace(track=track, around=around)
    return approach.select_branch(state, ahead, ways_m, TUNING, KAMUI)


def looked_round(robot_x_m=0.0, track_x_m=None, looked=math.pi, age=20):
    """Return the state, and whether it arrives, of a robot that has looked round.

    It stands at `(robot_x_m, Y_M)`, has turned by `looked` radians, and takes a circle of `RADIUS_M` to be there, or at
    `track_x_m`.
    """
    pose = jnp.array([robot_x_m, Y_M, 0.0])
    drive = Drive(latch=jnp.int32(Latch.LOOK), looked=jnp.float32(looked))
    mode, odometer_m = jnp.int32(RunMode.BRANCH_SELECTION), jnp.float32(100)
    state = a_state(drive=drive.replace(target=pose[:2]), estimate=pose, mode=mode, odometer_m=odometer_m)
    at = pose[:2] if track_x_m is None else jnp.array([track_x_m, Y_M])
    return selected(state, Track(at, jnp.float32(RADIUS_M), jnp.int32(511), jnp.int32(age)), pose)


@pytest.mark.jit
@pytest.mark.parametrize(
    ("robot_x_m", "track_x_m", "looked", "latch", "arrives"),
    [
        (0.0, None, P.motion.look_rad + 0.01, Latch.FREE, True),
        (0.42, 0.0, P.motion.look_rad + 0.01, Latch.FREE, True),
        (4.0, None, P.motion.look_rad - 0.01, Latch.LOOK, False),
        (4.0, None, P.motion.look_rad + 0.01, Latch.LEAVE, False),  # in the passage: what it has seen was noise
    ],
)
def test_a_robot_that_has_looked_round_is_at_a_place_if_it_sees_one_there(robot_x_m, track_x_m, looked, latch, arrives):
    found, there = looked_round(robot_x_m, track_x_m, looked)
    assert (int(found.drive.latch), bool(there)) == (latch, arrives)
    assert (float(found.writer.passed[3]) == 100) == (latch == Latch.LEAVE)  # then it gives the place up


@pytest.mark.jit
def test_without_a_place_it_takes_the_one_that_it_sees():
    found, _ = looked_round(age=0)
    assert (int(found.track.age), int(found.drive.latch)) == (1, Latch.APPROACH)
    assert found.drive.target.tolist() == pytest.approx([0, Y_M], abs=0.1)  # beams are a degree apart
