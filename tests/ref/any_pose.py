"""Beams from any pose, by the traversal that makes the table of the lattice: what the table is compared with."""

import functools
import math

import jax
import jax.numpy as jnp
from jax import lax

from jexplore.grid import in_cells
from jexplore.raycast import Beams, advance_beams, beam_geometry, by_beam, n_steps, scan


@functools.partial(jax.jit, static_argnames=("max_range_m", "cell_m", "width"))
def beams_from(pose, angles_rad, *, max_range_m, cell_m, width):
    """The cells that beams from any pose enter.

    Args:
      pose: `(x_m, y_m, heading_rad)`, float scalars; x and y in the map's own frame (cell (0, 0) begins at 0, 0).
      angles_rad: `[B]` float32, angles relative to the heading.
      max_range_m: range, metres. Static.
      cell_m: edge of a cell, metres. Static.
      width: W of the maps that the beams will cross, cells. Static.

    Returns:
      `Beams`, K = 1, relative to the cell that holds the pose.

    Source:
      Amanatides and Woo 1987.
    """
    reach = in_cells(max_range_m, cell_m)
    x, y, heading = (jnp.asarray(v, jnp.float32) for v in pose)
    angle = heading + jnp.asarray(angles_rad, jnp.float32)
    dx, dy = jnp.cos(angle), jnp.sin(angle)
    # float32 angles at multiples of 45 degrees miss the exact direction by some 1e-7: snap those.
    for value in (0.0, 0.5, math.sqrt(0.5), 1.0):
        for sign in (-1, 1):
            dx = jnp.where(jnp.abs(dx - sign * value) < 1e-6, jnp.float32(sign * value), dx)
            dy = jnp.where(jnp.abs(dy - sign * value) < 1e-6, jnp.float32(sign * value), dy)
    x, y = x / cell_m, y / cell_m
    geometry = beam_geometry(jnp, dx, dy, x - jnp.floor(x), y - jnp.floor(y), jnp.float32(1e30))

    def step(state, _):
        return advance_beams(jnp, state, geometry)

    zero = jnp.zeros(angle.shape, jnp.int32)
    _, (drow, dcol, entry) = lax.scan(step, (zero, zero), length=n_steps(reach))
    within = entry < reach
    drow, dcol = jnp.where(within, drow, 0)[None], jnp.where(within, dcol, 0)[None]
    offset = drow * width + dcol
    return Beams(
        offset=offset,
        by_beam=by_beam(offset),
        drow=drow,
        dcol=dcol,
        entry=jnp.where(within, entry, jnp.inf)[None],
        length=within.sum(axis=0, dtype=jnp.int32)[None],
        blind=jnp.zeros((1, within.shape[1]), jnp.int32),
        reach=jnp.float32(reach),
    )


def cast(occupied, pose, angles_rad, *, max_range_m, cell_m):
    """Ranges of beams from any pose in a true map.

    Args:
      occupied: `[H, W]` bool. What lies outside the map counts as occupied.
      pose: `(x_m, y_m, heading_rad)`, float scalars, inside the map; cell (0, 0) begins at (0, 0).
      angles_rad: `[B]` float32, angles relative to the heading.
      max_range_m: range, metres. Static.
      cell_m: edge of a cell, metres. Static.

    Returns:
      `range_m`: `[B]` float32, metres to where the beam enters the cell that stops it; `max_range_m` if none does.
      `hit`: `[B]` bool, whether one does.

    Raises:
      ValueError: while tracing, if `occupied` is not a bool matrix.

    Source:
      Amanatides and Woo 1987.
    """
    if occupied.ndim != 2 or occupied.dtype != bool:
        raise ValueError(f"expected occupied: [H, W] bool, got {occupied.shape} {occupied.dtype}")
    walled = jnp.pad(jnp.asarray(occupied), 1, constant_values=True)
    x, y, heading = pose
    beams = beams_from(
        (x + cell_m, y + cell_m, heading), angles_rad, max_range_m=max_range_m, cell_m=cell_m, width=walled.shape[1]
    )
    row = jnp.floor(jnp.float32(y) / cell_m).astype(jnp.int32) + 1
    col = jnp.floor(jnp.float32(x) / cell_m).astype(jnp.int32) + 1
    seen = scan(walled, row, col, jnp.int32(0), beams)
    at = jnp.minimum(seen.end, beams.entry.shape[1] - 1)
    range_m = jnp.take_along_axis(beams.entry[0], at[None], axis=0)[0] * cell_m
    return jnp.where(seen.hit, range_m, jnp.float32(max_range_m)), seen.hit
