"""Obstacle avoidance: driving past, turning where there is room, or backing out.

Between a target point and the wheels. A direction is taken in which the robot's width fits, the nearest to the target
(target approach, wall following while the way is blocked, target approach; Mano et al., Fig. 7). Before it turns in
place the robot sweeps its outline over what it has seen; where that would touch, it goes back the way that it came, or
along a wall away from that.
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
DRIVE_AWAY_RAD_S = 0.0, 0.1, 0.2, 0.5, 1.0  # turning so fast


def initial_manoeuvre(pose: Array) -> Manoeuvre:
    """Return an empty memory at a pose `[3]`."""
    return Manoeuvre(
        trail=jnp.zeros((TRAIL_POSES, 3)).at[0].set(pose),
        length=jnp.int32(1),
        kept=jnp.int32(1),
        backing=jnp.bool_(False),
        backed_m=jnp.float32(0),
        away_m=jnp.float32(0),
        tried=jnp.int32(0),
        frees=jnp.int32(0),
        avoiding=jnp.bool_(False),
        side=jnp.float32(0),
    )


def has_free_way(ways_m: Array, within_rad: float, long_m: float) -> Array:
    """Return whether some direction near straight ahead is free over a length: bool."""
    return jnp.any((ways_m >= long_m) & (jnp.abs(DIRECTION) <= within_rad))


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
    course, avoiding = _course_round(now, ways_m, pose, bearing, turning)

    # What would be driven, were there room.
    v = jnp.where(turning != 0, 0, speed * jnp.maximum(jnp.cos(course), 0))
    omega = jnp.where(turning != 0, turning * robot.max_turn_rad_s / 2, tuning.turn_gain * course)
    omega = jnp.clip(omega, -robot.max_turn_rad_s, robot.max_turn_rad_s)
    v = jnp.where(_meets(around, robot, v * P.motion.ahead_s, omega * P.motion.ahead_s), 0, v)
    in_place = (turning != 0) | (v < 0.25 * speed)
    v = jnp.where(in_place, 0, v)
    wanted = jnp.where(turning != 0, jnp.pi, jnp.abs(course))

    starts, enough = _backs(now, around, robot, in_place, wanted, omega, touched)
    goes = (now.backing | starts) & (now.kept > 1)
    still = jnp.float32(0), jnp.float32(0), now.length, jnp.bool_(False), jnp.float32(0)
    now = _tries(now, touched)
    side = jnp.sign(jnp.where(turning != 0, turning, course))
    back_v, back_omega, length, wedged, away_m = run_if(
        goes, lambda _: _back_or_away(now, around, robot, pose, speed, side), still
    )
    # Nor does it go back farther where that leads nowhere and the way that it wants is free.
    enough |= wedged & ~in_place & (now.backed_m >= P.motion.min_back_m)
    backing = goes & ~(now.backing & enough)
    after = now.replace(
        backing=backing,
        away_m=jnp.where(backing, away_m, 0),
        backed_m=jnp.where(backing, now.backed_m + jnp.maximum(jnp.abs(back_v) * DT_S, P.motion.min_back_step_m), 0),
        length=jnp.where(backing, length, now.length),
        kept=jnp.where(backing, now.kept - (now.length - length), now.kept),
        avoiding=avoiding,
        side=course + pose[2],
    )
    return after, jnp.where(backing, back_v, v), jnp.where(backing, back_omega, omega)


def _tries(now, touched):
    """Advance the recovery: the next attempt, if it still tried one."""
    return now.replace(
        tried=jnp.where(touched, jnp.where(now.frees > 0, (now.tried + 1) % len(_recoveries()), 0), now.tried),
        frees=jnp.where(touched, P.motion.recovery_steps + P.motion.touch_again_steps, jnp.maximum(now.frees - 1, 0)),
    )


def _course_round(now, ways_m, pose, bearing, turning):
    """Return the direction in which to drive, and whether it differs from that of the target."""
    off = jnp.abs(wrapped(DIRECTION - bearing))
    here = ways_m[jnp.argmin(off)]
    free = ways_m >= P.motion.go_m
    stick = jnp.where(now.avoiding, P.motion.keep_direction_weight, 0) * jnp.abs(
        wrapped(DIRECTION + pose[2] - now.side)
    )
    best = jnp.argmin(jnp.where(free, off + stick, jnp.inf))
    avoiding = (here < P.motion.stop_m) & jnp.any(free) & (turning == 0)
    return jnp.where(avoiding, jnp.asarray(DIRECTION)[best], bearing), avoiding


def _room_m(around, robot, ahead_m, turn):
    """Compute the distance of the nearest point from the robot's outline after a motion, metres; below 0: inside."""
    xy, known = surround.known_points(surround.move_surround(around, ahead_m, jnp.float32(0), turn))
    outside = jnp.maximum(jnp.abs(xy[:, 0]) - robot.length_m / 2, jnp.abs(xy[:, 1]) - robot.width_m / 2)
    return jnp.min(jnp.where(known, outside, jnp.inf))


def _meets(around, robot, ahead_m, turn):
    """Return whether the robot's outline meets a point after a short motion."""
    return _room_m(around, robot, ahead_m, turn) < P.motion.outline_slack_m


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
    return starts, (now.backed_m >= P.motion.min_back_m) & can | (now.backed_m > P.motion.max_back_m)


def _nearest_side(around, robot):
    """Find the nearest obstacle to either side of the robot. Returns `(side, off_m, leans)`: 1 left, -1 right; distance
    from the robot's front half; bool, it leaves no room to turn in place while there is room on the other side and
    behind."""
    xy, known = surround.known_points(around)
    x, y = xy.T
    half_m, half_width_m = robot.length_m / 2, robot.width_m / 2
    # A wall that it touches is seen some way inside its outline.
    beside_m = half_width_m - jnp.where(jnp.abs(x) < half_m, P.sensing.outline_margin_m, P.motion.outline_slack_m)

    def nearest(there, off_m):
        return jnp.min(jnp.where(known & there, off_m, jnp.inf))

    left, right = (
        nearest((jnp.abs(x) < half_m + P.motion.min_back_m) & (side * y > beside_m), side * y) - half_width_m
        for side in (1, -1)
    )
    behind = nearest((x < 0) & (jnp.abs(y) < half_width_m - 2 * P.motion.outline_slack_m), -x) - half_m
    margin_m = 2 * P.sensing.outline_margin_m
    needed_m = jnp.hypot(half_m + margin_m, half_width_m + margin_m) - half_width_m
    leans = (jnp.minimum(left, right) < needed_m) & (left + right > 2 * needed_m) & (behind > P.motion.min_back_m)
    side = jnp.where(left < right, 1, -1)
    off_m = nearest((x > 0) & (x < half_m + P.motion.min_back_m) & (side * y > beside_m), side * y) - half_width_m
    return side, off_m, leans


def _recoveries():
    """Return recovery attempts: speeds, in halves of its speed, and turn rates away from the nearest point."""
    rates = (0, P.motion.lean_rad_s), (0.5, -0.5), (1, -1)
    return (*((v, turn) for turns in rates for v in (-1, 1) for turn in turns), (0, 1), (0, -1))


def _gets_free(speed, side):
    """Return the recovery attempts as `[K, 2]`, metres and radians a second."""
    # Going ahead, it leaves an obstacle on the left by turning right; going back, by turning left.
    return jnp.stack(
        [jnp.stack([v * speed / 2, jnp.float32(turn) * side * (-1 if v > 0 else 1)]) for v, turn in _recoveries()]
    )


def _back(now, around, robot, pose, speed):
    """Return speed and turn rate to the previous pose: `(v, omega, length, wedged)`; poses left; whether it can go
    neither there, nor straight back, nor along a wall. Else it goes by the motion that leads farthest, leaning away
    from a wall."""
    goal = now.trail[(now.length - 1) % TRAIL_POSES]
    offset = goal[:2] - pose[:2]
    behind = -(offset[0] * jnp.cos(pose[2]) + offset[1] * jnp.sin(pose[2]))
    turn = wrapped(goal[2] - pose[2])
    left = offset[1] * jnp.cos(pose[2]) - offset[0] * jnp.sin(pose[2])
    aside = jnp.abs(turn) > P.motion.off_trail_rad
    v = jnp.where(aside, -speed / 2, -jnp.clip(behind / DT_S, 0, speed))
    # Going back, it comes to the left by heading to the right.
    steered = turn - jnp.where(
        v < 0, jnp.clip(P.motion.steer_rad_m * left, -P.motion.max_steer_rad, P.motion.max_steer_rad), 0
    )
    omega = jnp.where(aside, 0, jnp.clip(steered / DT_S, -1.0, 1.0))
    near = (behind < P.motion.trail_m / 2) & (aside | (jnp.abs(turn) < P.motion.trail_rad + P.motion.max_steer_rad))
    # Along a wall, by half of what its front has room for. Where that touches, it goes straight back for a while.
    side, off_m, leans = _nearest_side(around, robot)
    lean = jnp.where(
        now.frees == 0, jnp.clip(off_m / robot.length_m / DT_S, P.motion.lean_rad_s / 8, P.motion.lean_rad_s), 0.0
    )
    ways = jnp.stack([jnp.stack([-speed / 2, side * lean]), jnp.stack([v, omega])])
    ways = jnp.concatenate([ways, _gets_free(speed, side)])
    room_m = jax.vmap(lambda way: _room_m(around, robot, way[0] * P.motion.ahead_s, way[1] * P.motion.ahead_s))(ways)
    leans &= (now.frees <= P.motion.touch_again_steps) & (room_m[0] > jnp.minimum(off_m, 0) - P.motion.outline_slack_m)
    # As planned, or straight back; where neither is free, the motion that leads farthest; after contact with something
    # unseen, one attempt after the other.
    free = room_m[1:3] >= P.motion.outline_slack_m
    best = jnp.where(jnp.any(free), 1 + jnp.argmax(free), jnp.argmax(room_m))
    best = jnp.where(now.frees > P.motion.touch_again_steps, 2 + now.tried, jnp.where(leans, 0, best))
    found, passes = ways[best], best != 1
    near |= passes & (jnp.hypot(offset[0], offset[1]) < P.motion.min_back_m)
    return found[0], found[1], jnp.where(near, now.length - 1, now.length), ~jnp.any(free) & ~leans


def _back_or_away(now, around, robot, pose, speed, side):
    """Return `_back`, and the distance still to drive ahead: without room behind the robot drives away."""
    back_v, back_omega, length, wedged = _back(now, around, robot, pose, speed)
    away_v, away_omega, is_free = _drive_away(around, robot, speed, side)
    away = is_free & (now.frees <= P.motion.touch_again_steps) & (wedged | (now.away_m > 0))
    left_m = jnp.maximum(jnp.where(now.away_m > 0, now.away_m, P.motion.drive_away_m) - away_v * DT_S, 0)
    v, omega = jnp.where(away, away_v, back_v), jnp.where(away, away_omega, back_omega)
    return v, omega, jnp.where(away, now.length, length), wedged, jnp.where(away, left_m, 0.0)


def _drive_away(around, robot, speed, side):
    """Return speed and turn rate ahead, with as much to one side as is free: `(v, omega, is_free)`."""
    omega = jnp.concatenate([side * jnp.asarray(DRIVE_AWAY_RAD_S), -side * jnp.asarray(DRIVE_AWAY_RAD_S[1:])])
    room_m = jax.vmap(lambda omega: _room_m(around, robot, speed / 2 * P.motion.ahead_s, omega * P.motion.ahead_s))(
        omega
    )
    free = room_m >= P.motion.outline_slack_m
    best = jnp.argmax(jnp.where(free, side * omega, -jnp.inf))
    return speed / 2, omega[best], jnp.any(free)
