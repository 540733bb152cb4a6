"""Features of every frontier cluster for a learned strategy: numbers of about 1, lengths over `FEATURE_UNIT_M`."""

import math

import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import repeat
from jexplore.grid import count, is_known
from jexplore.planning import Belief
from jexplore.policies.clusters import Targets, looks, paths_apart
from jexplore.policies.distance_advantage import mean_apart
from jexplore.raycast import Beams

SCORED_CLUSTERS = 32  # clusters that are told apart, the nearest ones
FEATURE_UNIT_M = 10.0
RADII_M = (2.0, 4.0, 8.0)
POCKET_M2 = 15.0  # area of which a pocket has no more
AROUND_M = 4.0  # radius in which unknown cells at other clusters count
STAY_M = 3.0  # how far the last target's neighbourhood reaches
FEATURES = (
    "path",  # of the robot
    "size",  # frontier cells side by side
    *(
        "side within 2 m",
        "side within 4 m",
        "side within 8 m",
    ),  # of a square as large as the unknown area seen
    "pocket",  # 1 where nothing unknown is behind it, 0 where there is much
    "others",  # mean distance from the other clusters
    "others by area",  # the same, each counted by the unknown area that a look would show there
    "nearest other",  # distance from the nearest other
    "turn",  # from the robot's heading to where it lies: 0 ahead, 1 behind
    "home",  # distance from the start
    "last",  # 1 where the last target was, 0 far from there
    "detour",  # how much longer a tour of all clusters is that begins with it than one that begins best
    "side near",  # side of the unknown area seen from it and, the less the farther, from the others near it
    "progress",  # share that known cells have of these and the unknown ones seen from clusters, the same for all
)
"""The features, in order; lengths over `FEATURE_UNIT_M`. Models name those that they were trained with."""


def shortlist(at: Targets) -> Targets:
    """Return the `SCORED_CLUSTERS` nearest targets, in the order of their paths; the others are counted."""
    order = jnp.argsort(at.path_m, stable=True)[:SCORED_CLUSTERS]
    left_out = jnp.maximum(jnp.sum(at.used, dtype=jnp.int32) - SCORED_CLUSTERS, 0)
    row, col, used, path_m, size = (a[order] for a in (at.row, at.col, at.used, at.path_m, at.size))
    return Targets(row, col, used, path_m, size, at.overflow + left_out)


def detours(at: Targets, apart_m: Array) -> Array:
    """Compute the cost of beginning with each target: open tours of all, always on to the nearest unvisited one.

    `[M]` float32, metres beyond the shortest of these; 0 in an unused slot. Unreachable targets are left out.
    """
    n = len(at.used)
    slots = jnp.arange(n)
    length_m = jnp.where(at.used[None] & at.used[:, None], apart_m, jnp.inf)

    def visit(state):
        i, now, left, total = state
        there = jnp.where(left, length_m[now], jnp.inf)  # [M, M], of each tour
        nearest, step_m = jnp.argmin(there, axis=1), jnp.min(there, axis=1)
        on = jnp.isfinite(step_m)
        total = total + jnp.where(on, step_m, 0.0)
        left = left & ~(on[:, None] & (slots[None] == nearest[:, None]))
        return i + 1, jnp.where(on, nearest, now), left, total

    left = at.used[None] & (slots[None] != slots[:, None])
    stops = jnp.sum(at.used, dtype=jnp.int32)
    state = jnp.int32(1), slots, left, jnp.where(at.used, at.path_m, jnp.inf)
    total = repeat(lambda state: state[0] < stops, visit, state)[3]
    return jnp.where(at.used, total - jnp.min(total), 0.0)


def features(belief: Belief, at: Targets, last: Array, beams: Beams) -> Array:
    """Compute features of targets, `[M, F]` float32, 0 in an unused slot. `last`: `[2]`, the last target; -1: none."""
    cell_m = belief.model.cell_m
    unknown = looks(belief, at, beams, RADII_M)[:-1].astype(jnp.float32) * cell_m**2
    known_m2 = count(is_known(belief.grid)) * cell_m**2
    apart_m = paths_apart(belief, at)
    nearest = jnp.min(jnp.where(jnp.eye(len(at.used), dtype=bool), jnp.inf, apart_m), axis=1)
    drow, dcol = at.row - belief.row, at.col - belief.col
    bearing = jnp.arctan2(drow.astype(jnp.float32), dcol.astype(jnp.float32))
    turn = jnp.abs((bearing / math.pi - belief.heading / 4 + 1) % 2 - 1)

    def away_m(row, col):
        return cell_m * jnp.hypot((at.row - row).astype(jnp.float32), (at.col - col).astype(jnp.float32))

    columns = [
        at.path_m / FEATURE_UNIT_M,
        at.size * cell_m / FEATURE_UNIT_M,
        *(jnp.sqrt(unknown) / FEATURE_UNIT_M),
        jnp.exp(-unknown[-1] / POCKET_M2),
        mean_apart(apart_m, at.used) / FEATURE_UNIT_M,
        mean_apart(apart_m, at.used, unknown[-1]) / FEATURE_UNIT_M,
        jnp.where(jnp.isfinite(nearest), nearest, 0.0) / FEATURE_UNIT_M,
        turn,
        away_m(belief.start[0], belief.start[1]) / FEATURE_UNIT_M,
        jnp.where(last[0] >= 0, jnp.exp(-away_m(last[0], last[1]) / STAY_M), 0.0),
        detours(at, apart_m) / FEATURE_UNIT_M,
        jnp.sqrt(jnp.exp(-apart_m / AROUND_M) @ unknown[-1]) / FEATURE_UNIT_M,
        jnp.full(at.row.shape, known_m2 / (known_m2 + jnp.sum(unknown[-1]))),
    ]
    return jnp.where(at.used[:, None], jnp.stack(columns, axis=1), 0.0)
