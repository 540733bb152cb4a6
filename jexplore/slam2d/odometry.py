"""Odometry: what encoders make of a motion, and how far that may be off. One model for all robots."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.tree_util import register_dataclass

from jexplore.rules import Odometry
from jexplore.slam2d.matching import inverted

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


class Systematic(NamedTuple):
    """Systematic errors of the odometry, as far as matched scans have told them: a robot knows how large they may be,
    and not their sign. In standard deviations: of the length and the turn it reports, and of its bias of the heading.
    """

    error: Array  # [3] float32, estimate of what is to be added to the reported motion
    covariance: Array  # [3, 3] float32
    with_pose: Array  # [3, 3] float32, covariances of the pose (rows; m, m, rad) with these errors


def unknown_errors() -> Systematic:
    """Return the `Systematic` of a robot that has matched nothing."""
    return Systematic(jnp.zeros(3), jnp.eye(3), jnp.zeros((3, 3)))


def corrected(noise: Odometry, errors: Systematic, way: Array, turn: Array, flat: Array) -> tuple[Array, Array]:
    """Return a reported motion without its systematic errors: `(way, turn)`, metres and radians; see `encoded`."""
    length, turned, bias = errors.error * _sds(noise)
    return way * (1 + length), turn * (1 + turned) + bias * flat


def spread(
    noise: Odometry, errors: Systematic, covariance: Array, moved: Array, way: Array, turn: Array
) -> tuple[Systematic, Array]:
    """Return errors and covariance `[3, 3]` (m^2, m rad, rad^2) of an estimated pose after a motion.

    Args:
      covariance: `[3, 3]` float32, before it.
      moved: `[2]` float32, the motion in the map's frame, metres.
      way: float32, its length, metres.
      turn: float32, radians.
    """
    jacobian = jnp.eye(3).at[:2, 2].set(jnp.stack([-moved[1], moved[0]]))
    length, turned, bias = _sds(noise)
    by_error = jnp.zeros((3, 3)).at[:2, 0].set(length * moved).at[2, 1].set(turned * turn).at[2, 2].set(bias * way)
    before = jacobian @ errors.with_pose
    after = before + by_error @ errors.covariance
    covariance = jacobian @ covariance @ jacobian.T + before @ by_error.T + by_error @ after.T
    return errors._replace(with_pose=after), covariance + step_covariance(noise, way, turn)


def learned(errors: Systematic, prior: Array, off: Array, posterior: Array) -> Systematic:
    """Return the errors after a match: their regression on the pose (Kalman filter with an augmented state).

    Args:
      prior: `[3, 3]` float32, covariance of the predicted pose, positive.
      off: `[3]` float32, the matched pose less the predicted one: m, m, rad.
      posterior: `[3, 3]` float32, covariance of the matched pose.

    Source:
      Martinelli, Tomatis, Siegwart, Simultaneous localization and odometry self calibration for mobile robot (2007).
    """
    known = inverted(prior)
    gain = errors.with_pose.T @ known
    return Systematic(
        errors.error + gain @ off,
        errors.covariance - gain @ (prior - posterior) @ gain.T,
        posterior @ known @ errors.with_pose,
    )


def step_covariance(noise: Odometry, way: Array, turn: Array) -> Array:
    """Return the covariance of a step by the drawn errors, `[3, 3]` float32, m^2 and rad^2, alike in x and y."""
    place = (noise.length * way) ** 2 + noise.length_m_sqrt_rad**2 * jnp.abs(turn) + FLOOR_M**2
    walk2 = jnp.radians(noise.heading_deg_sqrt_m) ** 2 * way
    return jnp.diag(jnp.stack([place, place, (noise.turn * turn) ** 2 + walk2 + FLOOR_RAD**2]))


def _sds(noise):
    """Return the standard deviations of systematic errors: relative, of lengths and turns; of the heading, rad/m."""
    return jnp.stack(
        [
            jnp.abs(jnp.asarray(noise.length_scale - 1)),
            jnp.hypot(noise.turn_scale - 1, noise.slip),
            jnp.abs(jnp.radians(noise.heading_bias_deg_m)),
        ]
    )
