"""Measures of an episode whose robot does not know its pose: columns that its results have besides the others."""

import jax.numpy as jnp
from jax import Array, lax

from jexplore.exploration.metrics import EpisodeView, Metric
from jexplore.grid import is_free


def ate_m(view: EpisodeView) -> Array:
    """Return the absolute trajectory error: the root mean square distance of estimated places from true ones.

    The places are those at the start and after every step, moved by loops that were closed later. The estimated way is
    first moved and turned as a whole so that it lies as near as it can. NaN where the way is not kept: an `Environment`
    without `paths`.
    """
    trail, cell_m = view.poses.trail, view.belief.model.cell_m
    counts = (lax.iota(jnp.int32, trail.shape[0]) <= view.steps)[:, None]
    n = view.steps + 1

    def centred(xy: Array) -> Array:
        return jnp.where(counts, xy - jnp.sum(jnp.where(counts, xy, 0), axis=0) / n, 0)

    true, own = centred(trail[:, 1:3]), centred(trail[:, 3:5])
    cos = jnp.sum(own * true)
    sin = jnp.sum(own[:, 0] * true[:, 1] - own[:, 1] * true[:, 0])
    size = jnp.maximum(jnp.hypot(cos, sin), 1e-9)
    cos, sin = cos / size, sin / size
    turned = jnp.stack([cos * own[:, 0] - sin * own[:, 1], sin * own[:, 0] + cos * own[:, 1]], axis=1)
    turned = jnp.where(size > 1e-8, turned, own)
    error_m = jnp.sqrt(jnp.sum((true - turned) ** 2) / n) * cell_m
    return jnp.where(view.steps < trail.shape[0], error_m, jnp.nan)


def end_error_m(view: EpisodeView) -> Array:
    """Return the distance of the estimated place from the true one in the end, metres."""
    off = view.poses.estimate - view.poses.true
    return jnp.hypot(off[0], off[1]) * view.belief.model.cell_m


def end_error_deg(view: EpisodeView) -> Array:
    """Return the difference of the estimated heading from the true one in the end, degrees, 0 to 180."""
    off = jnp.degrees(view.poses.estimate[2] - view.poses.true[2])
    return jnp.abs((off + 180) % 360 - 180)


def free_iou(view: EpisodeView) -> Array:
    """Return how the free cells of the robot's map agree with those of an exact one: intersection over union.

    The exact map is that of the same scans, counted at the true poses, where no beam grazes a cell in which another
    ends; the maps are compared as they lie.
    """
    p_free = view.belief.model.p_free
    free, true = is_free(view.belief.grid, p_free), is_free(view.poses.seen, p_free)
    return jnp.sum(free & true) / jnp.maximum(jnp.sum(free | true), 1)


def bumps(view: EpisodeView) -> Array:
    """Return how many steps a wall ended."""
    return view.poses.bumps


def unmatched(view: EpisodeView) -> Array:
    """Return how many scans had no match."""
    return view.poses.unmatched


def loops(view: EpisodeView) -> Array:
    """Return how many loops were found."""
    return jnp.int32(0) if view.poses.key_of is None else view.poses.mapping.n_loops


MEASURES = {one.__name__: Metric(one) for one in (ate_m, end_error_m, end_error_deg, free_iou, bumps, unmatched, loops)}
"""Name of a column -> what it holds."""
