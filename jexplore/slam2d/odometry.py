"""Odometry: what encoders make of a motion, and how far that may be off. One model for all robots."""

import jax.numpy as jnp
from jax import Array
from jax.tree_util import register_dataclass

from jexplore.rules import Odometry

register_dataclass(Odometry)
FLOOR_M, FLOOR_RAD = 1e-3, 1e-3  # least standard deviation of a step: a covariance must be positive


def encoded(noise: Odometry, way: Array | float, turn: Array | float, flat: Array, draws: Array) -> tuple[Array, Array]:
    """Return what the encoders report of a motion: `(way, turn)`, metres and radians.

    Args:
      noise: `Odometry`. Slip is not among these errors: it makes the true turn smaller than the one made here.
      way: float32, metres, below 0 backwards.
      turn: float32, radians, as the tracks make it.
      flat: float32, `way` in the plane.
      draws: `[4]` float32, normal: for length, turn, heading, and the length that turning feigns.

    Source:
      Thrun, Burgard, Fox, Probabilistic robotics (2005), table 5.6. Changed: see `Odometry`.
    """
    length = noise.length_scale * (1 + noise.length * draws[0])
    walk = jnp.radians(noise.heading_deg_sqrt_m) * draws[2] * jnp.sqrt(jnp.abs(flat))
    turned = noise.turn_scale * turn * (1 + noise.turn * draws[1]) + walk
    turned += jnp.radians(noise.heading_bias_deg_m) * jnp.abs(flat)
    return way * length + noise.length_m_sqrt_rad * draws[3] * jnp.sqrt(jnp.abs(turn)), turned


def step_covariance(noise: Odometry, way: Array, turn: Array) -> Array:
    """Return the covariance of a step by the odometry, `[3, 3]` float32, m^2 and rad^2, alike in x and y.

    Systematic errors count as if they were drawn: the robot knows how large they are, and not their sign.
    """
    length2 = (noise.length**2 + (noise.length_scale - 1) ** 2) * way**2
    place = length2 + noise.length_m_sqrt_rad**2 * jnp.abs(turn) + FLOOR_M**2
    relative2 = noise.turn**2 + (noise.turn_scale - 1) ** 2 + noise.slip**2
    walk2 = jnp.radians(noise.heading_deg_sqrt_m) ** 2 * way + (jnp.radians(noise.heading_bias_deg_m) * way) ** 2
    return jnp.diag(jnp.stack([place, place, relative2 * turn**2 + walk2 + FLOOR_RAD**2]))
