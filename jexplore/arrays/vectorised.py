"""`arctan2` and `argmin` for a CPU, where XLA has them go element by element: made of operations that it vectorises."""

import math

import jax.numpy as jnp
from jax import Array, lax

# Odd minimax polynomial of arctan on [0, 1], lowest power first: no more than 2e-6 off.
_ARCTAN = 0.99997726, -0.33262347, 0.19354346, -0.11643287, 0.05265332, -0.01172120


def arctan2(y: Array, x: Array) -> Array:
    """Compute the angle of a finite point, to 4e-6 radians: float32, 0 at the origin; signs of zeros do not count."""
    ax, ay = jnp.abs(x), jnp.abs(y)
    largest = jnp.maximum(ax, ay)
    share = jnp.minimum(ax, ay) / jnp.where(largest > 0, largest, 1)
    square, angle = share * share, jnp.zeros_like(share)
    for factor in reversed(_ARCTAN):
        angle = angle * square + factor
    angle = angle * share
    angle = jnp.where(ay > ax, math.pi / 2 - angle, angle)
    angle = jnp.where(x < 0, math.pi - angle, angle)
    return jnp.where(y < 0, -angle, angle)


def argmin(values: Array) -> Array:
    """Return the place of the first least value of `[n]` float32 without NaN: int32; with NaN it returns the last."""
    n = values.shape[0]
    return jnp.min(jnp.where(values == jnp.min(values), lax.iota(jnp.int32, n), n - 1))
