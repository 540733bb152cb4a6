"""A scan as points with normals in the robot's frame."""

import jax.numpy as jnp
from flax import struct
from jax import Array, lax
from jax.tree_util import register_dataclass

from jexplore.arrays.loops import one_kernel
from jexplore.slam2d.settings import SlamSettings

register_dataclass(SlamSettings)
LINE_BEAMS = 5  # beams on either side through whose points a line is laid


@struct.dataclass
class Scan:
    """Ends of the beams of a scan."""

    xy: Array  # [B, 2] float32, metres, in the scanner's frame; 0 of a beam without an end
    normal: Array  # [B, 2] float32, of the line on which the end lies, towards the scanner; 0, 0: on none
    valid: Array  # [B] bool, there is an end


def read_scan(settings: SlamSettings, ranges_m: Array, angles_rad: Array, max_range_m: Array | float) -> Scan:
    """Return the ends of a scan's beams, each with the normal of the line through it and its neighbours.

    Args:
      settings: `line_reach_m`, `line_flatness`.
      ranges_m: `[B]` float32; inf, NaN, 0 and less, and `max_range_m` and more have no end.
      angles_rad: `[B]` float32, directions of the beams, in order.

    Returns:
      `Scan`.
    """
    return one_kernel(_read, settings, ranges_m, angles_rad, max_range_m)


def _read(settings, ranges_m, angles_rad, max_range_m):
    valid = (ranges_m > 0) & (ranges_m < max_range_m)  # False for NaN
    r = jnp.where(valid, ranges_m, 0).astype(jnp.float32)
    x, y = r * jnp.cos(angles_rad), r * jnp.sin(angles_rad)
    _, (nx, ny), lined = fit_lines(settings, x, y, valid)
    sign = jnp.where(lined, jnp.where(nx * x + ny * y > 0, -1.0, 1.0), 0.0)
    return Scan(jnp.stack([x, y], -1), jnp.stack([sign * nx, sign * ny], -1), valid)


def fit_lines(
    settings: SlamSettings, x: Array, y: Array, valid: Array
) -> tuple[tuple[Array, Array], tuple[Array, Array], Array]:
    """Fit a line through every end of a scan's beams `[B]` and its neighbours.

    Returns:
      `(mean, normal, lined)`: x and y of a point on the line and of its normal; `[B]` bool, whether there is a line.
    """
    wide = [jnp.pad(a, LINE_BEAMS) for a in (x, y)]
    known, n = jnp.pad(valid, LINE_BEAMS), x.shape[0]
    moments = [jnp.zeros(n)] * 6
    for k in range(2 * LINE_BEAMS + 1):
        there, other_x, other_y = (lax.slice_in_dim(a, k, k + n) for a in (known, *wide))
        dx, dy = other_x - x, other_y - y
        weight = (there & valid & (dx * dx + dy * dy < settings.line_reach_m**2)).astype(jnp.float32)
        terms = weight, weight * dx, weight * dy, weight * dx * dx, weight * dx * dy, weight * dy * dy
        moments = [total + term for total, term in zip(moments, terms)]
    count, sx, sy, sxx, sxy, syy = moments
    per = 1 / jnp.maximum(count, 1)
    mx, my = sx * per, sy * per
    cxx, cxy, cyy = sxx * per - mx * mx, sxy * per - mx * my, syy * per - my * my
    half, root = (cxx + cyy) / 2, jnp.hypot((cxx - cyy) / 2, cxy)
    along = 0.5 * jnp.arctan2(2 * cxy, cxx - cyy)
    lined = valid & (count >= LINE_BEAMS) & (half - root < settings.line_flatness * (half + root))
    return (x + mx, y + my), (-jnp.sin(along), jnp.cos(along)), lined
