"""Single steps and sills: the ground before and behind is level, so that only its profile tells of them."""

import jax.numpy as jnp
from jax import Array

from jexplore.driving.records import LoneStep, Trajectory
from jexplore.driving.sensing import smoothing
from jexplore.driving.sensing.ground_profile import FACE_M, NOISE_DEVIATIONS, STEP_M

FLANK_POINTS = 3  # points on either side of a step, whose height is that between their medians: one may lie on its face
TOGETHER_M = 1.2  # steps no farther apart are one, as high as those seen before the robot is on the first
PASSED_M = 0.30  # m; distance of the robot's end beyond the riser: before, its own tipping shows in the profile
ATTITUDE_MEAN_STEPS, ATTITUDE_MEAN_M = (
    5,
    0.1,
)  # steps, m; attitude is averaged over these, at most this far before and behind
TIP_SHARE = 0.5  # share of the angle at which a robot stands with one end on the riser that counts as tipping


def no_step() -> LoneStep:
    """Return a state without a step."""
    return LoneStep(jnp.float32(jnp.inf), jnp.float32(jnp.inf), jnp.float32(0))


def update_step(step: LoneStep, x_m: Array, z_m: Array) -> LoneStep:
    """Update the single riser with the last point of the profile, of a robot on level ground before it.

    Args:
      x_m, z_m: `[P]` float32, the last points of the profile, in the order of time; x is inf for missing points.
    """
    there = jnp.isfinite(x_m)
    # Behind a descending edge the ground is hidden: flanks are numbers of points, at any distance.
    after = jnp.argsort(there)[-FLANK_POINTS:]
    begins = jnp.min(jnp.where(there[after], x_m[after], -jnp.inf))
    earlier = there & (x_m < begins - FACE_M)
    before = jnp.argsort(earlier)[-FLANK_POINTS:]
    rise = jnp.abs(jnp.sort(z_m[after])[FLANK_POINTS // 2] - jnp.sort(z_m[before])[FLANK_POINTS // 2])
    place = (begins + x_m[before[-1]]) / 2
    noise = smoothing.deviation(smoothing.second_differences(z_m, there))
    is_one = earlier[before[0]] & (rise > jnp.maximum(STEP_M, NOISE_DEVIATIONS * noise))
    joins = jnp.isfinite(step.from_m) & (place - step.to_m < TOGETHER_M)
    return LoneStep(
        from_m=jnp.where(is_one & ~joins, place, step.from_m),
        to_m=jnp.where(is_one, place, step.to_m),
        height_m=jnp.where(is_one, jnp.where(joins, jnp.maximum(rise, step.height_m), rise), step.height_m),
    )


def has_passed(step: LoneStep, odometer_m: Array, length_m: Array | float) -> Array:
    """Return whether a robot of a length, metres, has passed the riser: bool."""
    return odometer_m - step.to_m > length_m / 2 + PASSED_M


def has_tipped(step: LoneStep, way: Trajectory, length_m: Array | float) -> Array:
    """Return whether the robot has tipped as on a riser of this height: bool.

    Otherwise it has turned away before it.
    """
    near = (way.odometer_m > step.from_m - length_m) & (way.odometer_m < step.to_m + length_m)
    # Of both angles, whose noise goes either way: that of the inclination never goes below 0.
    leant = jnp.hypot(
        *(
            smoothing.mean_near(a, way.odometer_m, way.odometer_m, ATTITUDE_MEAN_STEPS, ATTITUDE_MEAN_M)
            for a in (way.pitch, way.roll)
        )
    )
    return jnp.max(jnp.where(near, leant, 0)) > TIP_SHARE * jnp.arctan(step.height_m / length_m)
