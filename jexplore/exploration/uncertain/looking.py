"""Scans of a robot that does not know its pose: made at the true one, counted where the robot takes itself to be."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import run_if
from jexplore.arrays.poses import rotated, wrapped
from jexplore.engine.program import Given
from jexplore.exploration.sensing import known_cells, square_round, stacked
from jexplore.exploration.state import Outcome, Setup, State, Stream
from jexplore.exploration.uncertain.poses import EIGHTH, Poses, UnsureNumbers, cell_of, rounded
from jexplore.slam2d import matching
from jexplore.slam2d.beams import Reading, cast, fold
from jexplore.slam2d.points import add
from jexplore.slam2d.scans import read_scan
from jexplore.slam2d.tracking import locate

LOST_M, LOST_RAD = 1.0, 0.2617993877991494  # m, rad (15 degrees); a search finds no scan much farther from its guess


def look(setup: Setup, given: Given, state: State, when: Array) -> State:
    """Make one scan at the true pose, correct the estimate if scans are matched, and count the scan there, if `when`.

    A robot of whose place or heading the estimate has come to be less certain than `LOST_M` or `LOST_RAD`, as standard
    deviations, because scans do not match, is `LOST`: the episode ends.
    """
    parts = state.belief.grid, state.poses, state.n_known, state.heading, state.belief.row, state.belief.col

    def scanned(parts: Any) -> Any:
        grid, poses, n_known, heading, row, col = parts
        own, belief = given.numbers.unsure, state.belief
        occupied, base = stacked(given, jnp.asarray(given.scenes.occupied))
        reach = own.reach
        direction = _directions(own, heading, poses.true)
        clean = cast(occupied, poses.true[:2], direction, reach, base)
        clean, reading = _disturbed(setup, given, state, clean)
        square = square_round(setup, poses.true[1].astype(jnp.int32), poses.true[0].astype(jnp.int32), grid.hits.shape)
        before = jnp.int32(0) if square is None else known_cells(poses.seen, belief.within, square)
        seen = fold(poses.seen, poses.true[:2] + jnp.minimum(before, 0), direction, clean, reach, belief.extent)
        after = known_cells(seen, belief.within, square)
        n_known = after if square is None else n_known - before + after
        poses = poses.replace(seen=seen)
        if poses.points is not None:
            poses = _matched(given, poses, heading, reading, belief.model.cell_m)
            heading, poses = rounded(heading, poses)
            here = cell_of(poses.estimate, row, col, belief.extent)
            poses = poses.replace(strayed=poses.strayed | (here[0] != row) | (here[1] != col))
            row, col = here
        direction = _directions(own, heading, poses.estimate)
        grid = fold(grid, poses.estimate[:2], direction, reading, reach, belief.extent)
        return grid, poses, n_known, heading, row, col

    grid, poses, n_known, heading, row, col = run_if(when, scanned, parts)
    sd2 = jnp.diagonal(poses.covariance)
    is_lost = (jnp.max(sd2[:2]) > LOST_M**2) | (sd2[2] > LOST_RAD**2)
    is_lost &= (state.outcome == Outcome.RUNNING) & (poses.points is not None) & when
    return state.replace(
        belief=state.belief.replace(grid=grid, row=row, col=col, heading=heading),
        poses=poses,
        heading=heading,
        n_known=n_known,
        scans=state.scans + when,
        outcome=jnp.where(is_lost, Outcome.LOST, state.outcome),
        plan_active=state.plan_active & ~is_lost,
    )


def _directions(own: UnsureNumbers, heading: Array, pose: Array) -> Array:
    """Return unit vectors of the beams: `[B, 2]`."""
    return rotated(jnp.asarray(own.directions)[heading], jnp.broadcast_to(pose[2], own.angles_rad.shape))


def _disturbed(setup: Setup, given: Given, state: State, clean: Reading) -> tuple[Reading, Reading]:
    """Return what the scanner would read without noise of its ranges, and what it reads; some beams tell nothing."""
    numbers, own, n = given.numbers, given.numbers.unsure, clean.distance.shape[0]
    distance, hit, speaks = clean.distance, clean.hit, clean.speaks
    if setup.noisy:
        key = jax.random.fold_in(jax.random.fold_in(given.key, Stream.SENSOR), state.scans)
        key_range, key_drop = jax.random.split(key)
        noisy = jnp.maximum(distance + numbers.sigma_cells * jax.random.normal(key_range, (n,)), 0)
        distance = jnp.where(hit, noisy, distance)
        hit &= distance < own.reach
        speaks &= jax.random.uniform(key_drop, (n,)) >= numbers.dropout

    def told(distance: Array, hit: Array) -> Reading:
        silent = jnp.where(hit, distance < own.min_reach, ~numbers.no_echo_is_free)
        return Reading(distance, hit, speaks & ~silent)

    return told(clean.distance, clean.hit), told(distance, hit)


def _matched(given: Given, poses: Poses, heading: Array, reading: Reading, cell_m: Array) -> Poses:
    """Correct the estimate by matching a scan with the point map; it enters the map after some way or turn."""
    own = given.numbers.unsure
    settings, points, since = own.matching, poses.points, poses.since_key
    ranges_m = jnp.where(reading.hit & reading.speaks, reading.distance, jnp.inf) * cell_m
    scan = read_scan(settings, ranges_m, own.angles_rad, own.reach * cell_m)
    x, y, more = poses.estimate
    start = jnp.stack([x * cell_m, y * cell_m, wrapped(heading * EIGHTH + more)])
    found = locate(settings, points, scan, start, poses.covariance)
    failed = found.outcome >= matching.Outcome.FAR
    is_key = (since[0] >= settings.key_m) | (since[1] >= jnp.radians(settings.key_deg))
    is_key |= ~failed & (found.fitness < settings.min_share)
    points = run_if(is_key, lambda points: add(settings, points, scan, found.pose), points)
    off = wrapped(found.pose[2] - heading * EIGHTH)
    estimate = jnp.append(found.pose[:2] / cell_m, off)
    is_first = jnp.isinf(since[0])
    return poses.replace(
        estimate=jnp.where(failed | is_first, poses.estimate, estimate),
        covariance=jnp.where(is_first, poses.covariance, found.covariance),
        points=points,
        since_key=jnp.where(is_key, 0.0, since),
        unmatched=poses.unmatched + (failed & ~is_first),
    )
