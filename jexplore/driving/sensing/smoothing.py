"""Smoothing of noisy sensors: averages over as many readings as the noise requires, and no more.

The noise is estimated from the readings themselves: the measured quantity changes gradually, noise jumps.
"""

import math

import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.driving.params.tree import P

_JUMP_OF_ONE = 0.6745 * math.sqrt(6)  # median of second differences of noise whose standard deviation is 1
MEAN_STEPS = 5  # steps over which widths and attitudes are averaged
MAX_BEAM_PAIRS = 6  # beams on either side of which it is the mean


def deviation(jumps: Array) -> Array:
    """Estimate the standard deviation of the noise of readings by `second_differences`: float32; 0 without any."""
    return jnp.nan_to_num(jnp.nanmedian(jumps)) / _JUMP_OF_ONE


def second_differences(values: Array, there: Array) -> Array:
    """Return twice the deviation of readings from the line through their neighbours: `[S - 2]`; NaN: one is missing."""
    both = there[2:] & there[1:-1] & there[:-2]
    return jnp.where(both, jnp.abs(values[2:] - 2 * values[1:-1] + values[:-2]), jnp.nan)


def _deviates_more(jumps, limit):
    """Return whether `deviation` is above a limit, without the sort of a median, which is costly and rarely needed."""
    return 2 * jnp.sum(jumps > _JUMP_OF_ONE * limit) > jnp.sum(~jnp.isnan(jumps))


def running_mean(values: Array, n: int) -> Array:
    """Compute the mean of every value and its neighbours, n in all (odd, static), with zeros beyond the ends: `[S]`."""
    return jnp.convolve(jnp.pad(values, n // 2), jnp.full(n, 1 / n), mode="valid")


def mean_of_known(values: Array, n: int) -> Array:
    """Compute the mean of every value and its neighbours, n in all (odd, static), without those that are inf: `[S]`."""
    known = jnp.isfinite(values).astype(jnp.float32)
    total, share = (running_mean(a, n) for a in (jnp.where(known > 0, values, 0), known))
    return total / jnp.maximum(share, 1 / n)


def mean_weights(angle: Array, age: Array) -> Array:
    """Compute the weight of each of the last readings in their mean: the last one alone where the noise is small.

    Args:
      angle: `[S]` float32, radians, of steps in a row.
      age: `[S]` int32, steps since then; below 0: not there yet.

    Returns:
      `[S]` float32, whose sum is 1.
    """
    steady, jumps = math.radians(1) * P.sensing.steady_deg, second_differences(angle, age >= 0)

    def several(_):
        n = jnp.clip(jnp.round((deviation(jumps) / steady) ** 2), 1, P.sensing.max_mean_steps)
        counts = (age >= 0) & (age < n)
        return counts / jnp.sum(counts)

    # From one and a half readings on it takes two.
    return run_if(_deviates_more(jumps, steady * math.sqrt(1.5)), several, (age == 0).astype(jnp.float32))


def smooth_ranges(ranges_m: Array) -> Array:
    """Average ranges over symmetric pairs of beams as long as these agree: walls stay straight.

    The reciprocal range of a straight wall is a sine of the bearing: over a few degrees it is a line.

    Args:
      ranges_m: `[B]` float32, beams at even angles; inf: no return; NaN: no reading.

    Returns:
      `[B]` float32; the ranges themselves where the noise is small.
    """
    near = jnp.where(jnp.isnan(ranges_m), jnp.nan, 1 / ranges_m)  # 0: no return
    returns = jnp.isfinite(ranges_m)
    jumps = second_differences(near, returns) * ranges_m[1:-1] ** 2

    def mean(_):
        sd = deviation(jumps)
        pairs = jnp.clip(jnp.round(((sd / P.sensing.steady_m) ** 2 - 1) / 2), 0, MAX_BEAM_PAIRS)
        limit = P.sensing.agree_deviations * sd / jnp.where(returns, ranges_m, 1) ** 2
        wide = jnp.pad(near, MAX_BEAM_PAIRS, constant_values=jnp.nan)

        def added(k, carry):
            total, count, goes_on = carry
            before, after = (lax.dynamic_slice(wide, (MAX_BEAM_PAIRS + j,), near.shape) for j in (-k, k))
            middle = (before + after) / 2
            missing = jnp.isnan(middle)
            goes_on &= (k <= pairs) & (missing | (jnp.abs(middle - near) < limit))
            counts = goes_on & ~missing
            return total + jnp.where(counts, 2 * middle, 0), count + 2 * counts, goes_on

        total, count, _ = lax.fori_loop(1, MAX_BEAM_PAIRS + 1, added, (near, jnp.ones_like(near), returns))
        return jnp.where(returns, count / total, ranges_m)

    return run_if(_deviates_more(jumps, P.sensing.steady_m * math.sqrt(2)), mean, ranges_m)
