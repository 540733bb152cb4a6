"""The robot as a body: where it stands in a building with height, what its sensors say, and how it moves.

A unicycle on two rigid tracks, with a scanner that looks ahead, one that looks down, an attitude sensor and encoders.
"""

import math
from collections.abc import Callable
from typing import ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array
from jax.tree_util import register_dataclass

from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.driving.terrain import Terrain, attitude, look_down, turned
from jexplore.driving.walls import Walls, cast, meets

register_dataclass(Robot, [f for f in Robot.__dataclass_fields__ if f != "name"], ["name"])
register_dataclass(Tuning, list(Tuning.__dataclass_fields__), [])
register_dataclass(Noise, list(Noise.__dataclass_fields__), [])

DT_S = 0.1
RANGE_M = 8.0
BEAMS = 181
ANGLES_RAD = np.radians(np.linspace(-90, 90, BEAMS)).astype(np.float32)
BEAM_SPACING_RAD = math.pi / (BEAMS - 1)
DOWN_BEAMS = 13
DOWN_RAD = np.radians(np.linspace(-18, 18, DOWN_BEAMS)).astype(np.float32)


@struct.dataclass
class Building:
    """Where a run takes place; cell (0, 0) begins at (0, 0)."""

    walls: Walls
    terrain: Terrain
    goal: Array  # [2] float32, metres; NaN: none
    marks: Array  # [K, 3] float32, x, y, radius, metres: places of which it is counted which ones a run has been at


@struct.dataclass
class Body:
    """The robot in truth."""

    pose: Array  # [3] float32, x, y, metres; heading, radians
    pitch: Array  # float32, radians
    roll: Array  # float32, radians
    height_m: Array  # float32
    rise_m: Array  # float32, highest step under the fronts of its tracks
    path_m: Array  # float32, way in the plane
    contacts: Array  # int32, steps refused because of a wall
    refused: Array  # int32, steps refused because of the ground
    replace: ClassVar[Callable[..., Self]]


@struct.dataclass
class Senses:
    """What the sensors say in one step."""

    ranges_m: Array  # [B] float32, inf: no return; NaN: no reading
    down_m: Array  # [D] float32, likewise
    pitch: Array  # float32, radians
    roll: Array  # float32, radians


@struct.dataclass
class Draws:
    """The random numbers of one step, standard normal but for the last."""

    ranges: Array  # [B] float32
    down: Array  # [D] float32
    attitude: Array  # [2] float32, pitch and roll
    encoders: Array  # [3] float32, length and turn of the step, and drift of the heading
    missing: Array  # [B] float32, uniform from 0 to 1


def draw(key: Array) -> Draws:
    """`Draws` of one step; the key is consumed."""
    key, missing_key = jax.random.split(key)
    ranges, down, attitude, encoders = jnp.split(
        jax.random.normal(key, (BEAMS + DOWN_BEAMS + 5,)), (BEAMS, BEAMS + DOWN_BEAMS, BEAMS + DOWN_BEAMS + 2)
    )
    missing = jax.random.uniform(missing_key, (BEAMS,))
    return Draws(ranges=ranges, down=down, attitude=attitude, encoders=encoders, missing=missing)


def down_directions(robot: Robot) -> Array:
    """Unit vectors of the downward scanner's beams in the robot's frame: `[D, 3]` float32."""
    tilt = jnp.radians(robot.scanner_angle_deg)
    ahead = jnp.cos(DOWN_RAD)
    return jnp.stack([jnp.sin(tilt) * ahead, jnp.sin(DOWN_RAD), -jnp.cos(tilt) * ahead], axis=1)


def at_rest(building: Building, robot: Robot, pose: Array) -> Body:
    """`Body` of a robot that has not moved yet."""
    pitch, roll, height, rise = attitude(building.terrain, pose, robot.length_m, robot.width_m)
    zero, none = jnp.float32(0), jnp.int32(0)
    return Body(pose, pitch, roll, height, rise, path_m=zero, contacts=none, refused=none)


def sense(draws: Draws, building: Building, robot: Robot, noise: Noise, body: Body) -> Senses:
    """What the sensors say.

    Args:
      draws: `Draws`.
      building, robot, noise, body: `Building`, `Robot`, `Noise`, `Body`.

    Returns:
      `Senses`.
    """
    numberless = draws.missing < noise.invalid
    ranges = cast(building.walls, body.pose, ANGLES_RAD, RANGE_M) + noise.range_m * draws.ranges
    direction = turned(down_directions(robot), body.pitch, body.roll, body.pose[2])
    mount = turned(
        jnp.stack([robot.scanner_x_m, 0.0, robot.scanner_height_m])[None], body.pitch, body.roll, body.pose[2]
    )[0]
    origin = body.pose[0] + mount[0], body.pose[1] + mount[1], body.height_m + mount[2]
    down = look_down(building.terrain, origin, direction) + noise.range_m * draws.down
    tilt = jnp.radians(noise.attitude_deg)
    return Senses(
        ranges_m=jnp.where(numberless, jnp.nan, jnp.maximum(ranges, 0.01)),
        down_m=down,
        pitch=body.pitch + tilt * draws.attitude[0],
        roll=body.roll + tilt * draws.attitude[1],
    )


def touches(building: Building, robot: Robot, pose: Array) -> Array:
    """Whether a robot at a pose touches a wall: bool."""
    return meets(building.walls, pose, robot.length_m, robot.width_m)


def move(
    draws: Draws,
    building: Building,
    robot: Robot,
    noise: Noise,
    body: Body,
    estimate: Array,
    senses: Senses,
    v: Array | float,
    omega: Array | float,
) -> tuple[Body, Array, Array]:
    """One step of the unicycle, and what the encoders make of it.

    A step into a wall is refused, and one onto a slope that is too steep, if not less steep than where the robot
    stands, or up or down a step that is too high, if not one that it stands on.

    Args:
      draws, building, robot, noise, body: as in `sense`.
      estimate: `[3]`, odometry.
      senses: `Senses`.
      v, omega: metres a second, below 0 backwards; radians a second.

    Returns:
      `(body, estimate, gone_m)`; `gone_m` is what the odometer adds, in the plane, backwards as well.
    """
    ahead, turn = v * DT_S, omega * DT_S
    heading = body.pose[2] + turn * (1 - noise.slip)
    middle = body.pose[2] + 0.5 * turn * (1 - noise.slip)
    flat = ahead * jnp.cos(body.pitch)
    pose = jnp.stack([body.pose[0] + flat * jnp.cos(middle), body.pose[1] + flat * jnp.sin(middle), heading])
    pitch, roll, height, rise = attitude(building.terrain, pose, robot.length_m, robot.width_m, v < 0)
    contact = touches(building, robot, pose)
    steep = jnp.radians(robot.max_slope_deg) + 1e-3
    climbs = (jnp.abs(pitch) <= steep) & (jnp.abs(roll) <= steep) | (jnp.abs(pitch) < jnp.abs(body.pitch))
    climbs = climbs & (rise <= jnp.maximum(robot.max_step_m, body.rise_m)) | (flat == 0)
    goes = ~contact & climbs
    moved = Body(
        pose=jnp.where(goes, pose, body.pose),
        pitch=jnp.where(goes, pitch, body.pitch),
        roll=jnp.where(goes, roll, body.roll),
        height_m=jnp.where(goes, height, body.height_m),
        rise_m=jnp.where(goes, rise, body.rise_m),
        path_m=body.path_m + jnp.where(goes, jnp.abs(flat), 0),
        contacts=body.contacts + contact,
        refused=body.refused + (~contact & ~climbs),
    )
    measured = ahead * (1 + noise.odometry * draws.encoders[0]) * jnp.cos(senses.pitch)
    turn = turn * (1 + noise.odometry * draws.encoders[1]) + jnp.radians(noise.heading_deg_sqrt_m) * draws.encoders[
        2
    ] * jnp.sqrt(jnp.abs(flat))
    middle = estimate[2] + 0.5 * turn
    odometry = estimate + jnp.stack([measured * jnp.cos(middle), measured * jnp.sin(middle), turn])
    return moved, jnp.where(goes, odometry, estimate), jnp.where(goes, jnp.abs(measured), 0)


def to_odometry(estimate: Array) -> Callable[[Array], Array]:
    """A function from points `[..., 2]` in the robot's frame to the odometry's."""
    cos, sin = jnp.cos(estimate[2]), jnp.sin(estimate[2])

    def placed(xy):
        x, y = xy[..., 0], xy[..., 1]
        return jnp.stack([estimate[0] + cos * x - sin * y, estimate[1] + sin * x + cos * y], axis=-1)

    return placed


def to_robot(estimate: Array) -> Callable[[Array], Array]:
    """A function from points `[..., 2]` in the odometry's frame to the robot's."""
    cos, sin = jnp.cos(estimate[2]), jnp.sin(estimate[2])

    def seen(xy):
        x, y = xy[..., 0] - estimate[0], xy[..., 1] - estimate[1]
        return jnp.stack([cos * x + sin * y, -sin * x + cos * y], axis=-1)

    return seen
