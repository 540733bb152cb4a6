"""Odometry: what encoders make of a motion, and how far that may be off. One model for all robots."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.tree_util import register_dataclass

from jexplore.arrays.loops import pick
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


class SystematicErrors(NamedTuple):
    """Estimate of the systematic errors of the odometry: of lengths, of turns, and the bias of the heading.

    A robot knows how large they are, not their sign. They are in units of that size, positive where the encoders report
    too much: logarithms of what lengths and turns are multiplied by, and radians per metre.
    """

    error: Array  # [3] float32
    covariance: Array  # [3, 3] float32
    with_pose: Array  # [3, 3] float32, covariance of the pose (rows: m, m, rad) with these errors


def unknown_errors() -> SystematicErrors:
    """Return the `SystematicErrors` of a robot that has matched no scan."""
    return SystematicErrors(jnp.zeros(3), jnp.eye(3), jnp.zeros((3, 3)))


def corrected(noise: Odometry, errors: SystematicErrors, way: Array, turn: Array, flat: Array) -> tuple[Array, Array]:
    """Return a reported motion without its systematic errors: `(way, turn)`, metres and radians; see `encoded`."""
    length, turned, bias = errors.error * _sizes(noise)
    return way * jnp.exp(-length), (turn - bias * jnp.abs(flat)) * jnp.exp(-turned)


def spread(
    noise: Odometry, errors: SystematicErrors, covariance: Array, moved: Array, turn: Array
) -> tuple[SystematicErrors, Array]:
    """Return errors and covariance `[3, 3]` (m^2, m rad, rad^2) of an estimated pose after a turn and a way.

    Errors of the heading move the place to first order; the second order is added as independent of everything.

    Args:
      covariance: `[3, 3]` float32, before the turn.
      moved: `[2]` float32, the way in the map's frame, metres.
      turn: float32, radians.
    """
    way = jnp.hypot(moved[0], moved[1])
    by_heading = jnp.eye(3).at[:2, 2].set(jnp.stack([-moved[1], moved[0]]))
    length, turned, bias = _sizes(noise)
    by_error = jnp.zeros((3, 3)).at[:2, 0].set(-length * moved).at[2, 1].set(-turned * turn).at[2, 2].set(-bias * way)
    after_turn = errors.with_pose + by_error @ errors.covariance
    covariance += errors.with_pose @ by_error.T + by_error @ after_turn.T + step_covariance(noise, way, turn)
    second = 0.75 * (way * covariance[2, 2]) ** 2  # the mean of (way heading^2 / 2)^2
    covariance = by_heading @ covariance @ by_heading.T + second * jnp.diag(jnp.float32([1, 1, 0]))
    return errors._replace(with_pose=by_heading @ after_turn), covariance


def learned(errors: SystematicErrors, prior: Array, off: Array, posterior: Array) -> SystematicErrors:
    """Return the errors after a match, regressed on the pose: a Kalman filter of pose and errors.

    A match cannot make errors less certain. Where rounding says so, they stay, and are independent of the pose.

    Args:
      prior: `[3, 3]` float32, covariance of the predicted pose.
      off: `[3]` float32, the matched pose less the predicted one: m, m, rad.
      posterior: `[3, 3]` float32, covariance of the matched pose.

    Source:
      Martinelli, Tomatis, Siegwart, Simultaneous localization and odometry self calibration for mobile robot (2007).
    """
    known = inverted(prior)
    gain = errors.with_pose.T @ known
    covariance = errors.covariance - gain @ (prior - posterior) @ gain.T
    new = SystematicErrors(errors.error + gain @ off, covariance, posterior @ known @ errors.with_pose)
    left, before = jnp.diagonal(covariance), jnp.diagonal(errors.covariance)
    is_sound = jnp.all((left >= 0) & (left <= before)) & jnp.all(jnp.isfinite(new.with_pose))
    return pick(is_sound, new, errors._replace(with_pose=jnp.zeros((3, 3))))


def step_covariance(noise: Odometry, way: Array, turn: Array) -> Array:
    """Return the covariance of a step by the drawn errors, `[3, 3]` float32, m^2 and rad^2, alike in x and y."""
    place = (noise.length * way) ** 2 + noise.length_m_sqrt_rad**2 * jnp.abs(turn) + FLOOR_M**2
    walk2 = jnp.radians(noise.heading_deg_sqrt_m) ** 2 * way
    return jnp.diag(jnp.stack([place, place, (noise.turn * turn) ** 2 + walk2 + FLOOR_RAD**2]))


def _sizes(noise):
    """Return the sizes of systematic errors `[3]`: logarithms of scales of lengths and turns; rad/m."""
    turn = jnp.hypot(jnp.log(noise.turn_scale), jnp.log1p(-noise.slip))
    return jnp.stack([jnp.abs(jnp.log(noise.length_scale)), turn, jnp.radians(jnp.abs(noise.heading_bias_deg_m))])
