"""The robot as a body: pose and attitude in a building with height, sensor readings, and motion.

A unicycle on two rigid tracks, with a scanner that looks ahead, one that looks down, an attitude sensor and encoders.
"""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.arrays.loops import pick, run_if
from jexplore.driving.building.terrain import attitude, look_at, turned
from jexplore.driving.building.walls import cast_along, meets
from jexplore.driving.params.tree import P
from jexplore.driving.records import Building, Draws, RobotBody, Senses
from jexplore.driving.settings import Noise, Robot
from jexplore.slam2d.odometry import encoded

DT_S = 0.1
SCAN_RANGE_M = 8.0
BEAMS = 181
ANGLES_RAD = np.radians(np.linspace(-90, 90, BEAMS)).astype(np.float32)
BEAM_SPACING_RAD = math.pi / (BEAMS - 1)
DOWN_BEAMS = 13
DOWN_RAD = np.radians(np.linspace(-18, 18, DOWN_BEAMS)).astype(np.float32)
BEACON_M = 1.0  # the goal's beacon is heard within this, where no wall lies between
GROUND_MARCH_M = 0.2  # beams of the scanner that looks ahead are followed over the ground in steps of this


def draw(keys: Array, noise: Noise) -> Draws:
    """Draw the random numbers of steps.

    Args:
      keys: `[n]`, one a step; they are consumed.
      noise: `Noise`; where no beam is ever without a number, that is not drawn.

    Returns:
      `Draws` with a leading axis of n.
    """
    ends = np.cumsum([BEAMS, DOWN_BEAMS, 2, 3])

    def one(key):
        key, missing_key = jax.random.split(key)
        return jax.random.normal(key, (ends[-1] + 2,)), missing_key

    drawn, missing_keys = jax.vmap(one)(keys)
    ranges, down, attitude, encoders, rest = jnp.split(drawn, ends, axis=1)
    beacon, feigned = rest[:, 0], rest[:, 1:]
    missing = lax.cond(
        noise.invalid > 0,
        jax.vmap(lambda key: jax.random.uniform(key, (BEAMS,))),
        lambda keys: jnp.ones((keys.shape[0], BEAMS)),
        missing_keys,
    )
    encoders = jnp.concatenate([encoders, feigned], axis=1)
    return Draws(ranges=ranges, down=down, attitude=attitude, encoders=encoders, missing=missing, beacon=beacon)


def draw_one(key: Array, noise: Noise) -> Draws:
    """Draw the random numbers of one step: `Draws` without a leading axis."""
    return jax.tree.map(lambda a: a[0], draw(key[None], noise))


def down_directions(robot: Robot) -> Array:
    """Return unit vectors of the downward scanner's beams in the robot's frame: `[D, 3]` float32."""
    tilt = jnp.radians(robot.scanner_angle_deg)
    ahead = jnp.cos(DOWN_RAD)
    return jnp.stack([jnp.sin(tilt) * ahead, jnp.sin(DOWN_RAD), -jnp.cos(tilt) * ahead], axis=1)


def initial_body(building: Building, robot: Robot, pose: Array) -> RobotBody:
    """Return the `RobotBody` of a robot that has not moved yet."""
    return RobotBody(pose, *attitude(building.terrain, pose, robot.length_m, robot.width_m))


def read_sensors(draws: Draws, building: Building, robot: Robot, noise: Noise, body: RobotBody) -> Senses:
    """Compute the sensor readings of one step."""
    origin, direction = _mounted(body, robot.scanner_x_m, robot.scanner_height_m, down_directions(robot))
    down = look_at(building.terrain, origin, direction) + noise.range_m * draws.down
    tilt = jnp.radians(noise.attitude_deg)
    return Senses(
        ranges_m=forward_scan(draws, building, robot, noise, body),
        down_m=down,
        pitch=body.pitch + tilt * draws.attitude[0],
        roll=body.roll + tilt * draws.attitude[1],
        beacon_m=_beacon(building, body) + noise.beacon_m * draws.beacon,
    )


def _mounted(body, x_m, height_m, direction):
    """Return the position of a scanner, `(x, y, z)`, and the directions of its beams, `[D, 3]`, in the building."""
    mount = turned(jnp.stack([jnp.float32(1) * x_m, 0.0, height_m])[None], body.pitch, body.roll, body.pose[2])[0]
    origin = body.pose[0] + mount[0], body.pose[1] + mount[1], body.height_m + mount[2]
    return origin, turned(direction, body.pitch, body.roll, body.pose[2])


def ahead_directions(robot: Robot) -> Array:
    """Return unit vectors of the beams of the scanner that looks ahead in the robot's frame: `[B, 3]` float32."""
    pitch = jnp.radians(robot.scan_pitch_deg)
    ahead = np.cos(ANGLES_RAD)
    return jnp.stack([jnp.cos(pitch) * ahead, np.sin(ANGLES_RAD), -jnp.sin(pitch) * ahead], axis=1)


def forward_scan(draws: Draws, building: Building, robot: Robot, noise: Noise, body: RobotBody) -> Array:
    """Compute the ranges of the forward scanner: `[B]` float32, metres, see `Senses`. Arguments as for `read_sensors`.

    Its beams lean with the robot: they meet walls, which have no upper end, and the ground.
    """
    origin, direction = _mounted(body, 0.0, robot.scan_height_m, ahead_directions(robot))
    flat = jnp.maximum(jnp.hypot(direction[:, 0], direction[:, 1]), 1e-6)
    dx, dy = direction[:, 0] / flat, direction[:, 1] / flat
    ranges = cast_along(building.walls, origin[0], origin[1], dx, dy, SCAN_RANGE_M) / flat
    terrain = building.terrain
    tilts = jnp.abs(jnp.stack([body.pitch, body.roll, jnp.radians(robot.scan_pitch_deg)]))
    meets_ground = jnp.any(tilts > 1e-3) | (terrain.peak_m > origin[2])
    ground = run_if(
        meets_ground,
        lambda _: look_at(terrain, origin, direction, SCAN_RANGE_M, GROUND_MARCH_M),
        jnp.full(BEAMS, jnp.inf),
    )
    ranges = jnp.minimum(ranges, ground)
    ranges = jnp.where(ranges < SCAN_RANGE_M, ranges, jnp.inf) + noise.range_m * draws.ranges
    return jnp.where(draws.missing < noise.invalid, jnp.nan, jnp.maximum(ranges, 0.01))


def _beacon(building, body):
    """Return the distance of the goal if its beacon is heard, else inf."""
    offset = building.goal - body.pose[:2]
    off_m = jnp.hypot(*offset)
    dx, dy = offset[:, None] / jnp.maximum(off_m, 1e-6)
    wall_m = cast_along(building.walls, body.pose[0], body.pose[1], dx, dy, BEACON_M)[0]
    return jnp.where((off_m < BEACON_M) & (off_m < wall_m), off_m, jnp.inf)


def level_scan(senses: Senses, robot: Robot) -> tuple[Senses, Array]:
    """Project the forward scan to the plane, by the measured attitude.

    A beam that ends no higher than `floor_m` above the robot's level has met ground and tells nothing of walls.
    Bearings are not corrected, nor is the scanner's position, which leans with the robot: at 10 degrees bearings are
    off by half a degree, and positions by 17 cm for each metre of the mount's height.

    Returns:
      `(senses, is_ground)`: ranges are NaN where a beam has met ground; `[B]` bool, those beams.
    """
    direction = turned(ahead_directions(robot), senses.pitch, senses.roll, 0.0)
    mount_m = robot.scan_height_m * jnp.cos(senses.pitch) * jnp.cos(senses.roll)
    reach_m = jnp.minimum(senses.ranges_m, SCAN_RANGE_M)
    ground = (mount_m + reach_m * direction[:, 2] < P.sensing.floor_m) & jnp.isfinite(senses.ranges_m)
    flat_m = senses.ranges_m * jnp.hypot(direction[:, 0], direction[:, 1])
    return senses.replace(ranges_m=jnp.where(ground, jnp.nan, flat_m)), ground


def touches(building: Building, robot: Robot, pose: Array) -> Array:
    """Return whether a robot at a pose touches a wall: bool."""
    return meets(building.walls, pose, robot.length_m, robot.width_m)


def move(
    draws: Draws,
    building: Building,
    robot: Robot,
    noise: Noise,
    body: RobotBody,
    estimate: Array,
    senses: Senses,
    v: Array | float,
    omega: Array | float,
) -> tuple[RobotBody, Array, Array]:
    """Move the unicycle by one step and update the odometry.

    A step is refused into a wall, onto a slope that is too steep, unless less steep than the present one, and up or
    down a step that is too high, unless the robot stands on it.

    Args:
      v, omega: metres a second, below 0 backwards; radians a second.

    Returns:
      `(body, estimate, gone_m)`; `gone_m` is added to the odometer: way in the plane, backwards as well.
    """
    ahead, turn = v * DT_S, omega * DT_S
    heading = body.pose[2] + turn * (1 - noise.slip)
    middle = body.pose[2] + 0.5 * turn * (1 - noise.slip)
    flat = ahead * jnp.cos(body.pitch)
    pose = jnp.stack([body.pose[0] + flat * jnp.cos(middle), body.pose[1] + flat * jnp.sin(middle), heading])
    stands = pitch, roll, _, rise = attitude(building.terrain, pose, robot.length_m, robot.width_m, v < 0)
    contact = touches(building, robot, pose)
    steep = jnp.radians(robot.max_slope_deg) + 1e-3
    climbs = (jnp.abs(pitch) <= steep) & (jnp.abs(roll) <= steep) | (jnp.abs(pitch) < jnp.abs(body.pitch))
    climbs = climbs & (rise <= jnp.maximum(robot.max_step_m + 1e-3, body.rise_m)) | (flat == 0)
    goes = ~contact & climbs
    counts = {"contacts": body.contacts + contact, "refused": body.refused + (~contact & ~climbs)}
    there = RobotBody(pose, *stands, path_m=body.path_m + jnp.abs(flat))
    moved = pick(goes, there, body).replace(**counts)
    measured, turn = encoded(noise, ahead, turn, flat, draws.encoders)
    measured *= jnp.cos(senses.pitch)
    middle = estimate[2] + 0.5 * turn
    odometry = estimate + jnp.stack([measured * jnp.cos(middle), measured * jnp.sin(middle), turn])
    return moved, jnp.where(goes, odometry, estimate), jnp.where(goes, jnp.abs(measured), 0)


def towards(angle: Array | float) -> Array:
    """Return the unit vector of a direction, radians: `[2]` float32."""
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def to_odometry(estimate: Array) -> Callable[[Array], Array]:
    """Return a function from points `[..., 2]` in the robot's frame to the odometry's."""
    cos, sin = jnp.cos(estimate[2]), jnp.sin(estimate[2])

    def placed(xy):
        x, y = xy[..., 0], xy[..., 1]
        return jnp.stack([estimate[0] + cos * x - sin * y, estimate[1] + sin * x + cos * y], axis=-1)

    return placed


def rotate_by(turn: Array | float) -> Callable[[Array], Array]:
    """Return a function that rotates points `[..., 2]` about the origin, radians."""
    return to_odometry(jnp.stack([0.0, 0.0, turn]))


def to_robot(estimate: Array) -> Callable[[Array], Array]:
    """Return a function from points `[..., 2]` in the odometry's frame to the robot's."""
    cos, sin = jnp.cos(estimate[2]), jnp.sin(estimate[2])

    def seen(xy):
        x, y = xy[..., 0] - estimate[0], xy[..., 1] - estimate[1]
        return jnp.stack([cos * x + sin * y, -sin * x + cos * y], axis=-1)

    return seen
