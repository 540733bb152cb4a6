"""Obstacle avoidance: driving past, turning where there is room, or backing out.

Between a target point and the wheels. A direction is taken in which the robot's width fits, the nearest to the target
(target approach, wall following while the way is blocked, target approach; Mano et al., Fig. 7). Before it turns in
place the robot sweeps its outline over what it has seen; where that would touch, it goes back the way that it came.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import run_if
from jexplore.btm import wrapped
from jexplore.driving.params.tree import P
from jexplore.driving.records import Manoeuvre, Surround
from jexplore.driving.sensing import surround
from jexplore.driving.sensing.surround import DIRECTION
from jexplore.driving.settings import Robot, Tuning
from jexplore.driving.vehicle import DT_S

TRAIL_POSES = 256  # poses of the way here that are kept
# Shares of the speed, and turn rates, rad/s, of a robot that cannot go back as it came; the first is straight back.
OTHER_MOTIONS = (
    (-0.5, 0.0),
    *((v, turn) for v in (-0.5, 0.5) for turn in (-1.0, -0.5, 0.5, 1.0)),
    (0.5, 0.0),
    (0, 1),
    (0, -1),
)


def initial_manoeuvre(pose: Array) -> Manoeuvre:
    """Return an empty memory at a pose `[3]`."""
    return Manoeuvre(trail=jnp.zeros((TRAIL_POSES, 3)).at[0].set(pose))


def extend_trail(now: Manoeuvre, pose: Array) -> Manoeuvre:
    """Add the pose to the trail, if the robot has moved on since the last one; not while it goes back."""
    last = now.trail[(now.length - 1) % TRAIL_POSES]
    adds = (jnp.hypot(pose[0] - last[0], pose[1] - last[1]) >= P.motion.trail_m) & ~now.backing
    at = jnp.where(adds, now.length % TRAIL_POSES, TRAIL_POSES)
    kept = jnp.minimum(now.kept + adds, TRAIL_POSES)
    return now.replace(trail=now.trail.at[at].set(pose, mode="drop"), length=now.length + adds, kept=kept)


def avoid_obstacles(
    now: Manoeuvre,
    around: Surround,
    ways_m: Array,
    pose: Array,
    bearing: Array,
    turning: Array,
    touched: Array,
    tuning: Tuning,
    robot: Robot,
) -> tuple[Manoeuvre, Array, Array]:
    """Compute speed and turn rate towards a target, round obstacles; `pose` is odometry without corrections.

    Args:
      bearing: of the target point, radians.
      turning: int32, where the robot is to turn in place whatever the target: halves of its highest rate, to the left
        above 0; else 0.
      touched: bool, the last step was refused because of a wall.

    Returns:
      `(after, v, omega)`: `Manoeuvre`; metres a second, radians a second.
    """
    speed = jnp.minimum(tuning.speed_m_s, robot.max_speed_m_s)
    course = _course_round(ways_m, bearing, turning)

    # What would be driven, were there room.
    v = jnp.where(turning != 0, 0, speed * jnp.maximum(jnp.cos(course), 0))
    omega = jnp.where(turning != 0, turning * robot.max_turn_rad_s / 2, tuning.turn_gain * course)
    omega = jnp.clip(omega, -robot.max_turn_rad_s, robot.max_turn_rad_s)
    room_m = _room_m(around, robot, v * P.motion.ahead_s, omega * P.motion.ahead_s)
    v = jnp.where(room_m < P.motion.outline_slack_m, 0, v)
    in_place = (turning != 0) | (v < 0.25 * speed)
    v = jnp.where(in_place, 0, v)
    wanted = jnp.where(turning != 0, jnp.pi, jnp.abs(course))

    starts, enough = _backs(now, around, robot, in_place, wanted, omega, touched)
    goes = (now.backing | starts) & (now.kept > 1)
    still = jnp.float32(0), jnp.float32(0), now.length, jnp.bool_(False)
    back_v, back_omega, length, wedged = run_if(goes, lambda _: _back(now, around, robot, pose, speed), still)
    # Nor does it go back farther where that leads nowhere and the way that it wants is free.
    enough |= wedged & ~in_place & (now.backed_m >= P.motion.min_back_m)
    backing = goes & ~(now.backing & enough)
    after = now.replace(
        backing=backing,
        backed_m=jnp.where(backing, now.backed_m + jnp.abs(back_v) * DT_S, 0),
        length=jnp.where(backing, length, now.length),
        kept=jnp.where(backing, now.kept - (now.length - length), now.kept),
    )
    return after, jnp.where(backing, back_v, v), jnp.where(backing, back_omega, omega)


def _course_round(ways_m, bearing, turning):
    """Return the direction in which to drive: that of the target, or the nearest one that is free."""
    off = jnp.abs(wrapped(DIRECTION - bearing))
    free = ways_m >= P.motion.go_m
    avoids = ~free[jnp.argmin(off)] & jnp.any(free) & (turning == 0)
    return jnp.where(avoids, jnp.asarray(DIRECTION)[jnp.argmin(jnp.where(free, off, jnp.inf))], bearing)


def _room_m(around, robot, ahead_m, turn):
    """Compute the distance of the nearest point from the robot's outline after a motion, metres; below 0: inside."""
    xy, known = surround.known_points(surround.move_surround(around, ahead_m, jnp.float32(0), turn))
    outside = jnp.maximum(jnp.abs(xy[:, 0]) - robot.length_m / 2, jnp.abs(xy[:, 1]) - robot.width_m / 2)
    return jnp.min(jnp.where(known, outside, jnp.inf))


def _backs(now, around, robot, in_place, wanted, omega, touched):
    """Decide about backing up: `(starts, enough)`. It starts when the robot cannot turn as wanted or has touched
    something; `enough`: it has backed far enough."""
    margin_m = jnp.where(now.backing, 2 * P.sensing.outline_margin_m, P.sensing.outline_margin_m)
    needed = jnp.where(now.backing, jnp.pi, jnp.minimum(wanted, P.motion.glance_rad))

    def swept(_):
        left, right = surround.free_turn(around, robot, margin_m)
        return jnp.where(omega >= 0, left, right) >= needed

    can = run_if(in_place | now.backing, swept, jnp.bool_(True))
    starts = (in_place & ~can) | touched
    return starts, (now.backed_m >= P.motion.min_back_m) & can


def _back(now, around, robot, pose, speed):
    """Return speed and turn rate to the previous pose: `(v, omega, length, wedged)`; poses left; whether it can go
    neither there nor straight back. Then it goes by the motion that leads farthest."""
    goal = now.trail[(now.length - 1) % TRAIL_POSES]
    offset = goal[:2] - pose[:2]
    behind = -(offset[0] * jnp.cos(pose[2]) + offset[1] * jnp.sin(pose[2]))
    turn = wrapped(goal[2] - pose[2])
    v, omega = -jnp.clip(behind / DT_S, 0, speed), jnp.clip(turn / DT_S, -1.0, 1.0)
    near = (behind < P.motion.trail_m / 2) & (jnp.abs(turn) < P.motion.trail_rad)
    others = jnp.asarray(OTHER_MOTIONS) * jnp.stack([speed, jnp.float32(1)])
    motions = jnp.concatenate([jnp.stack([v, omega])[None], others])
    room_m = jax.vmap(lambda way: _room_m(around, robot, way[0] * P.motion.ahead_s, way[1] * P.motion.ahead_s))(motions)
    # As planned, or straight back; where neither is free, the motion that leads farthest.
    free = room_m[:2] >= P.motion.outline_slack_m
    best = jnp.where(jnp.any(free), jnp.argmax(free), jnp.argmax(room_m))
    near |= (best != 0) & (jnp.hypot(offset[0], offset[1]) < P.motion.min_back_m)
    return *motions[best], jnp.where(near, now.length - 1, now.length), ~jnp.any(free)
