"""Walls as straight segments: exact ranges of beams from any pose, without tracing cells.

The walls of an occupancy array all run along the axes. A building of passages has some dozens of segments: a scan means
one small dense computation, on a CPU as on a GPU. Ranges equal those of a traversal of every cell along every beam.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.driving.records import Walls

SEGMENT_SLACK_M = 1e-4  # segments are this much longer at both ends: no beam slips through where two meet
UNUSED_SLOT_M = 1e6


def _faces(occupied):
    """Return faces between free and occupied cells along columns: (column edge, first row, last row + 1), in cells."""
    face = np.diff(occupied.astype(np.int8), axis=1) != 0  # [H, W - 1], between col and col + 1
    lower = np.diff(np.pad(face, ((1, 0), (0, 0))).astype(np.int8), axis=0) == 1
    upper = np.diff(np.pad(face, ((0, 1), (0, 0))).astype(np.int8), axis=0) == -1
    col, first = np.nonzero(lower.T)
    _, last = np.nonzero(upper.T)
    return np.stack([col + 1, first, last + 1], axis=1)


def walls_of(occupied: np.ndarray, cell_m: float, *, multiple: int = 32) -> Walls:
    """Extract the walls of an occupancy array.

    Args:
      occupied: `[H, W]` bool, host; its outermost cells are occupied.
      cell_m: edge of a cell, metres.
      multiple: both lists are padded to a multiple of this, so that buildings of similar size share a program.

    Returns:
      `Walls` of numpy arrays; cell (0, 0) begins at (0, 0).
    """

    def padded(faces):
        n = max(1, -(-len(faces) // multiple)) * multiple
        out = np.full((n, 3), UNUSED_SLOT_M, np.float32)
        out[: len(faces)] = faces * cell_m
        return out

    # Ignored types: numpy on the host, where the record says what it is on the device.
    return Walls(x=padded(_faces(occupied)), y=padded(_faces(occupied.T)))  # type: ignore[arg-type]


def segments(walls: Walls) -> np.ndarray:
    """Return the segments as `[S, 4]` float32, x0, y0, x1, y1, metres; unused slots left out. Host."""
    x, y = (np.asarray(a) for a in (walls.x, walls.y))
    x, y = x[x[:, 0] < UNUSED_SLOT_M], y[y[:, 0] < UNUSED_SLOT_M]
    return np.concatenate([x[:, [0, 1, 0, 2]], y[:, [1, 0, 2, 0]]])


def cast_along(
    walls: Walls, x: Array | float, y: Array | float, dx: Array, dy: Array, max_range_m: Array | float
) -> Array:
    """Compute ranges of beams to the nearest wall.

    Args:
      x, y: origin of the beams, metres.
      dx, dy: `[B]` float32, their unit vectors.

    Returns:
      `[B]` float32, metres; inf where no wall lies within the range.
    """
    along_x = _range_bits(walls.x, x, y, dx, dy)
    along_y = _range_bits(walls.y, y, x, dy, dx)
    # Distances are not negative: their bits, as integers, are in the same order, and integers reduce fast on a CPU.
    range_m = lax.bitcast_convert_type(jnp.minimum(along_x, along_y), jnp.float32)
    return jnp.where(range_m < max_range_m, range_m, jnp.inf)


def _range_bits(lines, a, b, da, db):
    """Return the bits of the distance to the nearest of the segments at a constant first coordinate: `[B]` int32."""
    per = 1 / jnp.where(jnp.abs(da) < 1e-7, jnp.where(da < 0, -1e-7, 1e-7), da)
    distance = (lines[:, 0] - a) * per[:, None]
    meets = b + distance * db[:, None]
    hit = (distance >= 0) & (meets >= lines[:, 1] - SEGMENT_SLACK_M) & (meets <= lines[:, 2] + SEGMENT_SLACK_M)
    bits = lax.bitcast_convert_type(jnp.where(hit, distance, jnp.float32(UNUSED_SLOT_M)), jnp.int32)
    return jnp.min(bits, axis=1)


def meets(
    walls: Walls,
    pose: Array | tuple[Array | float, Array | float, Array | float],
    length_m: Array | float,
    width_m: Array | float,
) -> Array:
    """Return whether a rectangle meets a wall.

    Returns:
      bool: a segment has a point inside the rectangle; a point exactly on a side gives either answer.

    Source:
      Liang and Barsky, A new concept and method for line clipping (1984).
    """
    x, y, heading = pose
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    first = jnp.concatenate([walls.x[:, :2], walls.y[:, 1::-1]]) - jnp.stack([x, y])  # [S, 2]
    along = jnp.concatenate([walls.x[:, 2] - walls.x[:, 1], walls.y[:, 2] - walls.y[:, 1]])
    is_x = jnp.arange(first.shape[0]) < walls.x.shape[0]
    way = jnp.stack([jnp.where(is_x, 0, along), jnp.where(is_x, along, 0)], axis=1)
    enters, leaves = 0.0, 1.0  # share of the segment's way
    for axis, half in (((cos, sin), length_m / 2), ((-sin, cos), width_m / 2)):
        at, step = (a[:, 0] * axis[0] + a[:, 1] * axis[1] for a in (first, way))
        per = 1 / jnp.where(jnp.abs(step) < 1e-9, 1e-9, step)
        one, other = (-half - at) * per, (half - at) * per
        enters, leaves = jnp.maximum(enters, jnp.minimum(one, other)), jnp.minimum(leaves, jnp.maximum(one, other))
    return jnp.any(enters < leaves)
