"""Ground with height: attitude of a robot on it, and ranges of a downward scanner."""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.driving.records import Terrain

FINER = 4  # heights are kept this much finer than cells: a step is a ramp of a quarter of a cell
CONTACTS = 14  # points of a track, lengthwise, that may touch the ground
MARCH_M = 0.1  # between two samples of a beam
RANGE_HALVINGS = 7  # of the stretch in which such a beam meets the ground
MAX_DOWN_M = 2.4  # range of a beam that looks down, metres


def terrain_of(elevation: np.ndarray | None, cell_m: float) -> Terrain:
    """Make heights of cells finer: slopes stay even, steps stay steep.

    Args:
      elevation: `[H, W]` float32, height at cell centres, metres; None: level. Host.
      cell_m: edge of a cell, metres.

    Returns:
      `Terrain` of numpy arrays.
    """
    # Ignored types: numpy on the host, where the record says what it is on the device.
    if elevation is None or not np.any(elevation):
        level = np.zeros((2, 2), np.float32)
        return Terrain(height_m=level, spacing_m=np.float32(cell_m), peak_m=level.max())  # type: ignore[arg-type]
    fine = _finer(_finer(np.asarray(elevation, np.float64)).T).T
    fine = fine.astype(np.float32)
    return Terrain(height_m=fine, spacing_m=np.float32(cell_m / FINER), peak_m=fine.max())  # type: ignore[arg-type]


def is_level(terrain: Terrain) -> bool:
    """Return whether the ground is level everywhere; known before compiling, so that level ground costs nothing."""
    return terrain.height_m.shape[-2:] == (2, 2)


def _finer(height):
    """Interpolate along columns; a difference that neither neighbour continues is a step, which stays at the edge."""
    rows, cols = height.shape
    rise = np.diff(height, axis=1, prepend=height[:, :1], append=height[:, -1:])  # [rows, cols + 1]: before and after
    before, after = rise[:, :-1], rise[:, 1:]

    def continued(one, other):
        return (np.abs(one - other) <= 0.25 * np.maximum(np.abs(one), np.abs(other))) & (one != 0)

    goes_on = continued(before, after)
    wide = np.pad(goes_on, ((0, 0), (1, 1)))
    even = wide[:, :-1] | wide[:, 1:]  # the rise before cell c goes on before or behind it
    at = (np.arange(FINER) + 0.5) / FINER - 0.5  # of the fine points, in cells from the centre
    out = np.empty((rows, cols, FINER))
    for k, offset in enumerate(at):
        slope = np.where(even[:, :-1], before, 0) if offset < 0 else np.where(even[:, 1:], after, 0)
        out[..., k] = height + offset * slope
    return out.reshape(rows, cols * FINER)


def height_at(terrain: Terrain, x_m: Array | float, y_m: Array | float) -> Array:
    """Return the height of the ground at points, metres: `[...]` float32; beyond the edge that of the edge."""
    rows, cols = terrain.height_m.shape
    u = jnp.clip(x_m / terrain.spacing_m - 0.5, 0, cols - 1)
    v = jnp.clip(y_m / terrain.spacing_m - 0.5, 0, rows - 1)
    col, row = jnp.minimum(u.astype(jnp.int32), cols - 2), jnp.minimum(v.astype(jnp.int32), rows - 2)
    u, v = u - col, v - row
    flat, at = jnp.asarray(terrain.height_m).reshape(-1), row * cols + col
    corners = at[..., None] + np.array([0, 1, cols, cols + 1], np.int32)
    z = flat.at[corners].get(mode="clip", wrap_negative_indices=False)
    low = z[..., 0] + u * (z[..., 1] - z[..., 0])
    high = z[..., 2] + u * (z[..., 3] - z[..., 2])
    return low + v * (high - low)


def attitude(
    terrain: Terrain,
    pose: Array | tuple[Array | float, Array | float, Array | float],
    length_m: Array | float,
    width_m: Array | float,
    backwards: Array | bool = False,
) -> tuple[Array, Array, Array, Array]:
    """Compute the attitude of a robot on two rigid tracks.

    Each track rests on the two points of the ground, one before and one behind its middle, that carry it highest.

    Args:
      backwards: bool, driving backwards.

    Returns:
      `(pitch_rad, roll_rad, height_m, rise_m)`: pitch is positive nose down and roll positive with the left side up
        (REP 103); height of the middle; the largest difference of height between neighbouring points of the tracks'
        leading halves.
    """
    if is_level(terrain):
        return (jnp.float32(0),) * 4
    x, y, heading = pose
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    u = ((jnp.arange(CONTACTS) + 0.5) / CONTACTS - 0.5) * length_m
    v = jnp.array([0.5, -0.5]) * width_m
    ground = height_at(terrain, x + u * cos - v[:, None] * sin, y + u * sin + v[:, None] * cos)  # [2, CONTACTS]
    half = CONTACTS // 2
    back_u, back_z, fore_u, fore_z = u[:half, None], ground[:, :half, None], u[half:], ground[:, None, half:]
    slope = (fore_z - back_z) / (fore_u - back_u)  # [2, half, half]
    carries = (back_z - slope * back_u).reshape(2, -1)
    best = jnp.argmax(carries, axis=1)[:, None]
    height = jnp.take_along_axis(carries, best, axis=1)[:, 0]
    slope = jnp.take_along_axis(slope.reshape(2, -1), best, axis=1)[:, 0]
    leading = jnp.where(backwards, ground[:, :half], ground[:, half:])
    rise = jnp.max(jnp.abs(jnp.diff(leading, axis=1)))
    return -jnp.arctan(slope.mean()), jnp.arctan2(height[0] - height[1], width_m), height.mean(), rise


def look_at(
    terrain: Terrain,
    origin: tuple[Array | float, Array | float, Array | float],
    direction: Array,
    most_m: float = MAX_DOWN_M,
    march_m: float = MARCH_M,
) -> Array:
    """Compute ranges of beams to the ground.

    Args:
      origin: `(x_m, y_m, z_m)`, float scalars.
      direction: `[D, 3]` float32, unit vectors.
      most_m: range, metres. Static.
      march_m: ground above a beam over a shorter length than this may be missed. Static.

    Returns:
      `[D]` float32, metres; inf beyond the range.
    """
    if is_level(terrain):
        range_m = origin[2] / jnp.maximum(-direction[:, 2], 1e-6)
        return jnp.where((direction[:, 2] < 0) & (range_m < most_m), range_m, jnp.inf)

    def above(distance):  # [..., D]
        x, y, z = (origin[i] + distance * direction[:, i] for i in range(3))
        return z - height_at(terrain, x, y)

    n = round(most_m / march_m)
    step = most_m / n
    distance = jnp.arange(1, n + 1, dtype=jnp.float32)[:, None] * step
    below = above(distance) <= 0  # [n, D]
    # The first of them: a minimum, where an argmax is slow on a CPU.
    first = jnp.min(jnp.where(below, jnp.arange(n)[:, None], n), axis=0)

    def halved(_, ends):
        low, high = ends
        middle = (low + high) / 2
        under = above(middle) <= 0
        return jnp.where(under, low, middle), jnp.where(under, middle, high)

    # As a loop: unrolled, XLA computes every halving anew in those that follow.
    low, high = lax.fori_loop(0, RANGE_HALVINGS, halved, (first * step, (first + 1) * step))
    return jnp.where(first < n, (low + high) / 2, jnp.inf)


def turned(direction: Array, pitch_rad: Array | float, roll_rad: Array | float, heading_rad: Array | float) -> Array:
    """Turn directions in the robot's frame (x forward, y left, z up) to the world's: `[D, 3]` to `[D, 3]`."""
    cos_p, sin_p = jnp.cos(pitch_rad), jnp.sin(pitch_rad)
    cos_r, sin_r = jnp.cos(roll_rad), jnp.sin(roll_rad)
    cos_h, sin_h = jnp.cos(heading_rad), jnp.sin(heading_rad)
    x, y, z = direction[:, 0], direction[:, 1], direction[:, 2]
    y, z = cos_r * y - sin_r * z, sin_r * y + cos_r * z
    x, z = cos_p * x + sin_p * z, -sin_p * x + cos_p * z
    return jnp.stack([cos_h * x - sin_h * y, sin_h * x + cos_h * y, z], axis=1)
