"""Loops of a robot that does not know its pose: what it believes made anew of its key scans once their poses move."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from jexplore.arrays.loops import run_if
from jexplore.arrays.poses import between, compose
from jexplore.engine.program import Given
from jexplore.exploration.sensing import blank_grid
from jexplore.exploration.uncertain.poses import EIGHTH, Poses, beams_of
from jexplore.grid import Grid, is_known
from jexplore.planning import Belief
from jexplore.slam2d.beams import Reading, fold
from jexplore.slam2d.closing import Scanner
from jexplore.slam2d.mapping import Mapping, close, remake
from jexplore.slam2d.search import Window
from jexplore.slam2d.settings import SlamSettings

WINDOW = Window(10, 20)  # 2.1 m and 30 degrees on either side: a robot that has drifted farther is lost


def ranges_of(reading: Reading, cell_m: Array) -> Array:
    """Return the ranges of a reading, metres: `[B]` float32; inf: nothing stopped the beam, NaN: it tells nothing."""
    return jnp.where(reading.speaks, jnp.where(reading.hit, reading.distance, jnp.inf), jnp.nan) * cell_m


def look_for_loop(settings: SlamSettings, mapping: Mapping, scanner: Scanner, is_key: Array) -> tuple[Mapping, Array]:
    """Look for a loop that the last scan closes; the point map is made anew of all key scans if that moves poses.

    Returns:
      `(mapping, moved)`: whether it does, bool.
    """
    mapping, _ = close(settings, mapping, scanner, is_key, WINDOW)
    moved = jnp.isneginf(mapping.remade_at)

    def anew(mapping: Mapping) -> Mapping:
        return remake(settings, mapping, scanner, mapping.points.centre, len(mapping.pose_of))

    return run_if(moved, anew, mapping), moved


def made_anew(
    given: Given, belief: Belief, poses: Poses, before: Array, steps: Array, moved: Array
) -> tuple[Belief, Poses]:
    """Make the robot's map and its way anew of the key scans, if `moved`: `(belief, poses)`.

    The map is that of all key scans but the last, which is still to be counted; cells that none of them has seen keep
    their counts. No target is exhausted any more, and the way driven is where the key scans now have it.

    Args:
      before: `[K, 3]` float32, poses of the key scans before.
      steps: int32, steps made; of the last one the place is not yet noted.
    """

    def anew(both: Any) -> Any:
        belief, poses = both
        mapping, key, cell_m = poses.mapping, poses.key_of, belief.model.cell_m
        place = jnp.pad(poses.trail[:, 3:] * cell_m, ((0, 0), (0, 1)))
        place = compose(mapping.pose_of[key], between(before[key], place))[:, :2] / cell_m
        col, row = jnp.floor(place).astype(jnp.int32).T
        is_past = lax.iota(jnp.int32, len(row)) < steps
        own_col, own_row = jnp.floor(poses.estimate[:2]).astype(jnp.int32)
        driven = jnp.zeros_like(belief.driven).at[jnp.where(is_past, row, own_row), jnp.where(is_past, col, own_col)]
        grid = _map_of(given, belief, mapping)
        known = is_known(grid)
        belief = belief.replace(
            grid=jax.tree.map(lambda new, old: jnp.where(known, new, old), grid, belief.grid),
            driven=driven.set(True, mode="drop", wrap_negative_indices=False),
            exhausted=jnp.zeros_like(belief.exhausted),
        )
        return belief, poses.replace(trail=poses.trail.at[:, 3:].set(place), strayed=jnp.bool_(True))

    return run_if(moved, anew, (belief, poses))


def _map_of(given: Given, belief: Belief, mapping: Mapping) -> Grid:
    """Return the map of all key scans but the last one."""
    own, cell_m = given.numbers.unsure, belief.model.cell_m

    def put(k: Array, grid: Grid) -> Grid:
        (x, y, angle), distance = mapping.pose_of[k], mapping.ranges_of[k] / cell_m
        heading = jnp.round(angle / EIGHTH).astype(jnp.int32)
        pose = jnp.stack([x / cell_m, y / cell_m, angle - heading * EIGHTH])
        reading = Reading(distance, jnp.isfinite(distance), ~jnp.isnan(distance))
        direction = beams_of(own, heading % 8, pose)
        terms = direction, reading, own.reach, belief.extent, belief.model.native
        return fold(grid, pose[:2], *terms, ends_first=True)

    last = jnp.minimum(mapping.n_keys, len(mapping.pose_of)) - 1
    return lax.fori_loop(0, last, put, blank_grid(given))
