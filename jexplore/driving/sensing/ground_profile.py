"""Ground ahead by the downward scanner: features of its height profile, and single steps in level ground."""

import math

import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array, lax

from jexplore.driving.params.tree import P
from jexplore.driving.records import LoneStep, Trajectory
from jexplore.driving.sensing import smoothing

PROFILE_CELLS, PROFILE_CELL_M = 1024, 0.02  # of a profile: what lies beyond is left out
FLANK_M = 0.10  # m; a step is the difference of mean heights this far before and behind a place, less one cell
RISE_M = FLANK_M + PROFILE_CELL_M  # between the middles of both flanks
TREADS_M = np.linspace(0.20, 0.44, 13)  # periods of steps that are tried
FLANK_POINTS = 3  # points on either side of a step, whose height is that between their medians: one may lie on its face

_ANGLE = 2 * math.pi * PROFILE_CELL_M * np.arange(PROFILE_CELLS) / TREADS_M[:, None]
_TREAD_WAVES = np.concatenate([np.cos(_ANGLE), np.sin(_ANGLE)]).astype(np.float32)


def ground_point(
    ranges_m: Array,
    direction: Array,
    pitch_rad: Array | float,
    roll_rad: Array | float,
    mount: tuple[Array | float, Array | float],
    half_width_m: Array | float,
) -> tuple[Array, Array, Array]:
    """Compute the point where downward beams meet the ground: the mean over the robot's width.

    Args:
      ranges_m: `[D]` float32; inf or NaN: none.
      direction: `[D, 3]` float32, unit vectors in the robot's frame.
      pitch_rad, roll_rad: measured attitude; pitch positive nose down.
      mount: `(x_m, z_m)`, place of the scanner on the robot.
      half_width_m: beams that meet the ground farther to the side are left out.

    Returns:
      `(x_m, z_m, found)`: horizontal distance before the robot's middle, and height above the ground there.

    Source:
      Mano et al., section III.A.2, with the attitude.
    """
    valid = jnp.isfinite(ranges_m)
    r = jnp.where(valid, ranges_m, 0)
    x, y, z = mount[0] + r * direction[:, 0], r * direction[:, 1], mount[1] + r * direction[:, 2]
    y, z = jnp.cos(roll_rad) * y - jnp.sin(roll_rad) * z, jnp.sin(roll_rad) * y + jnp.cos(roll_rad) * z
    x, z = jnp.cos(pitch_rad) * x + jnp.sin(pitch_rad) * z, -jnp.sin(pitch_rad) * x + jnp.cos(pitch_rad) * z
    valid &= jnp.abs(y) <= half_width_m
    n = jnp.sum(valid)
    per = 1 / jnp.maximum(n, 1)
    return jnp.sum(jnp.where(valid, x, 0)) * per, jnp.sum(jnp.where(valid, z, 0)) * per, n > 0


class Profile(struct.PyTreeNode):
    """Features of the height profile of an obstacle."""

    variance_m2: Array  # float32, residual variance about the least-squares line, n - 2 in the denominator
    tread_wave_m2: Array  # float32, amplitude of the sine with the best tread period
    noise_m: Array  # float32, standard deviation of a point, told by how its neighbours differ
    slope: Array  # float32, of that line, signed
    step_m: Array  # float32, height of a step, the median of all
    riser_m: Array  # float32, height of a step of stairs: what the slope rises over a tread
    highest_m: Array  # float32, of the highest one, beyond what the slope rises; 0 where none stands out of the noise
    count: Array  # int32, points


def profile(x_m: Array, z_m: Array, valid: Array) -> Profile:
    """Fit a line to heights along the way.

    Args:
      x_m, z_m, valid: `[P]`, points of the profile.

    Returns:
      `Profile`; zeros where there are fewer than three points.

    Source:
      Mano et al., section III.A.2. Changed: a slope is what fits a line, stairs what goes up and down about it with
      every tread (the text has both the same way round, and takes all of the residual variance: noise is in it), and
      the height of a step comes from the profile.
    """
    n = jnp.sum(valid)
    per = 1 / jnp.maximum(n, 1)
    x = jnp.where(valid, x_m - jnp.sum(jnp.where(valid, x_m, 0)) * per, 0)
    z = jnp.where(valid, z_m - jnp.sum(jnp.where(valid, z_m, 0)) * per, 0)
    slope = jnp.sum(x * z) / jnp.maximum(jnp.sum(x * x), 1e-9)
    residual = jnp.where(valid, z - slope * x, 0)
    enough = n >= 3
    first = jnp.min(jnp.where(valid, x, jnp.inf))
    cells = jnp.where(valid, ((x - first) / PROFILE_CELL_M).astype(jnp.int32), PROFILE_CELLS)
    rises = _rises(*(jnp.zeros(PROFILE_CELLS, jnp.float32).at[cells].add(a, mode="drop") for a in (1.0, z)))
    wave, tread = _tread_wave(cells, residual, n)
    highest = jnp.max(rises) - jnp.abs(slope) * RISE_M
    noise = smoothing.deviation(smoothing.second_differences(z, valid))
    variance = jnp.where(enough, jnp.sum(residual**2) / jnp.maximum(n - 2, 1), 0)
    return Profile(
        variance_m2=variance,
        tread_wave_m2=jnp.where(enough, wave, 0),
        noise_m=noise,
        slope=jnp.where(enough, slope, 0),
        step_m=jnp.where(enough, _median(rises, _steps(rises)), 0),
        riser_m=jnp.where(enough, jnp.abs(slope) * tread, 0),
        highest_m=jnp.where(
            enough & (highest > P.ground.min_step_m) & (highest > P.ground.noise_deviations * noise), highest, 0
        ),
        count=n.astype(jnp.int32),
    )


def _tread_wave(cells, residual_m, n):
    """Return the largest power, in square metres, of a residual's waves as long as a tread, and the length of that one,
    metres, between those that are tried."""
    total = jnp.zeros(PROFILE_CELLS, jnp.float32).at[cells].add(residual_m, mode="drop")
    mean = _TREAD_WAVES @ total / jnp.maximum(n, 1)  # [2 * periods]
    power = 2 * jnp.sum(mean.reshape(2, -1) ** 2, axis=0)
    at = jnp.clip(jnp.argmax(power), 1, len(TREADS_M) - 2)
    before, here, after = (power[at + k] for k in (-1, 0, 1))
    off = (before - after) / jnp.minimum(2 * (before - 2 * here + after), -1e-12)  # vertex of the parabola through them
    return power.max(), TREADS_M[0] + (at + jnp.clip(off, -1, 1)) * (TREADS_M[1] - TREADS_M[0])


def steepest_rise(x_m: Array, z_m: Array, valid: Array) -> Array:
    """Return the largest rise between neighbouring points of a profile beyond a slope of 45 degrees: float32, metres.

    Steps are that steep, slopes are not. Arguments as for `profile`, in the order of time.
    """
    both = valid[1:] & valid[:-1]
    x, z = jnp.where(valid, x_m, 0), jnp.where(valid, z_m, 0)
    return jnp.max(jnp.where(both, jnp.diff(z) - jnp.abs(jnp.diff(x)), 0))


def _rises(count, total):
    """Return the difference of mean heights of both flanks of every cell: `[CELLS]`, metres. Arguments: points in each
    cell, and the sum of their heights."""
    # Points come in the order of time, about in that of x: flanks are sums over sorted cells of the way.
    n, wide = PROFILE_CELLS, round(FLANK_M / PROFILE_CELL_M)
    run_n, run_z = (jnp.pad(jnp.cumsum(a), (1, 0)) for a in (count, total))

    def window(run, low, high):  # sums of cells [i + low, i + high)
        padded = jnp.concatenate([jnp.zeros(wide + 2), run, jnp.full(wide + 2, run[-1])])
        i = wide + 2
        return padded[i + high : i + high + n] - padded[i + low : i + low + n]

    before_n, before_z = window(run_n, -wide, -1), window(run_z, -wide, -1)
    after_n, after_z = window(run_n, 1, wide), window(run_z, 1, wide)
    both = (before_n > 0) & (after_n > 0)
    rise = jnp.abs(after_z / jnp.maximum(after_n, 1) - before_z / jnp.maximum(before_n, 1))
    return jnp.where(both, rise, 0)


def _steps(rise):
    """Return the cells that are steps: `[CELLS]` bool. A step is a place steeper than its neighbours; where the robot's
    body tips, heights are off for a moment."""
    wide = round(FLANK_M / PROFILE_CELL_M)
    top = lax.reduce_window(rise, -jnp.inf, lax.max, (2 * wide + 1,), (1,), "SAME")
    return (rise == top) & (rise > top.max() / 2)


def _median(values, valid):
    """Return the lower median; 0 without a valid value."""
    number = jnp.sum(valid)
    return jnp.where(number > 0, jnp.sort(jnp.where(valid, values, jnp.inf))[jnp.maximum(number - 1, 0) // 2], 0)


def update_step(step: LoneStep, x_m: Array, z_m: Array) -> LoneStep:
    """Update the single riser with the last point of the profile, of a robot on level ground before it.

    Args:
      x_m, z_m: `[P]` float32, the last points of the profile, in the order of time; x is inf for missing points.
    """
    there = jnp.isfinite(x_m)
    # Behind a descending edge the ground is hidden: flanks are numbers of points, at any distance.
    after = jnp.argsort(there)[-FLANK_POINTS:]
    begins = jnp.min(jnp.where(there[after], x_m[after], -jnp.inf))
    earlier = there & (x_m < begins - P.ground.face_m)
    before = jnp.argsort(earlier)[-FLANK_POINTS:]
    rise = jnp.abs(jnp.sort(z_m[after])[FLANK_POINTS // 2] - jnp.sort(z_m[before])[FLANK_POINTS // 2])
    place = (begins + x_m[before[-1]]) / 2
    noise = smoothing.deviation(smoothing.second_differences(z_m, there))
    is_one = earlier[before[0]] & (rise > jnp.maximum(P.ground.step_m, P.ground.noise_deviations * noise))
    joins = jnp.isfinite(step.from_m) & (place - step.to_m < P.ground.together_m)
    return LoneStep(
        from_m=jnp.where(is_one & ~joins, place, step.from_m),
        to_m=jnp.where(is_one, place, step.to_m),
        height_m=jnp.where(is_one, jnp.where(joins, jnp.maximum(rise, step.height_m), rise), step.height_m),
    )


def has_passed(step: LoneStep, odometer_m: Array, length_m: Array | float) -> Array:
    """Return whether a robot of a length, metres, has passed the riser: bool."""
    return odometer_m - step.to_m > length_m / 2 + P.ground.passed_m


def has_tipped(step: LoneStep, way: Trajectory, length_m: Array | float) -> Array:
    """Return whether the robot has tipped as on a riser of this height: bool.

    Otherwise it has turned away before it.
    """
    near = (way.odometer_m > step.from_m - length_m) & (way.odometer_m < step.to_m + length_m)
    # Of both angles, whose noise goes either way: that of the inclination never goes below 0.
    leant = jnp.hypot(*(smoothing.running_mean(a, smoothing.MEAN_STEPS) for a in (way.pitch, way.roll)))
    return jnp.max(jnp.where(near, leant, 0)) > P.ground.tip_share * jnp.arctan(step.height_m / length_m)
