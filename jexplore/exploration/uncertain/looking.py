"""Scans of a robot that does not know its pose: made at the true one, counted where the robot takes itself to be."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jexplore.arrays.loops import pick, run_if
from jexplore.arrays.poses import wrapped
from jexplore.engine.program import Given
from jexplore.exploration.sensing import known_cells, square_round, stacked
from jexplore.exploration.state import Outcome, Setup, State, Stream
from jexplore.exploration.uncertain.closing import look_for_loop, made_anew, ranges_of
from jexplore.exploration.uncertain.poses import EIGHTH, Poses, UnsureNumbers, beams_of, cell_of, rounded
from jexplore.grid import Grid
from jexplore.native import kernels
from jexplore.planning import Belief
from jexplore.slam2d import beams, matching
from jexplore.slam2d.beams import Reading
from jexplore.slam2d.closing import Scanner
from jexplore.slam2d.mapping import enter
from jexplore.slam2d.odometry import learned
from jexplore.slam2d.scans import read_scan
from jexplore.slam2d.tracking import locate

LOST_M, LOST_RAD = 1.0, 0.2617993877991494  # m, rad (15 degrees); a search finds no scan much farther from its guess


def look(setup: Setup, given: Given, state: State, when: Array) -> State:
    """Make one scan at the true pose, correct the estimate if scans are matched, and count the scan there, if `when`.

    A robot of whose place or heading the estimate has come to be less certain than `LOST_M` or `LOST_RAD`, as standard
    deviations, because scans do not match, is `LOST`: the episode ends.
    """
    is_matched = state.poses.mapping is not None
    parts = state.belief, state.poses, state.n_known, state.heading

    def scanned(parts: Any) -> Any:
        belief, poses, n_known, heading = parts
        own = given.numbers.unsure
        direction = beams_of(own, heading, poses.true)
        clean = _cast(given, poses.true[:2], direction)
        clean, reading = _disturbed(setup, given, state, clean)
        if poses.seen is None:
            grid, n_known = _seen(setup, own, belief, belief.grid, poses, direction, reading, n_known)
            return belief.replace(grid=grid), poses, n_known, heading
        seen, n_known = _seen(setup, own, belief, poses.seen, poses, direction, clean, n_known)
        poses = poses.replace(seen=seen)
        if is_matched:
            before = poses.mapping.pose_of
            poses, moved = _matched(given, poses, heading, reading, belief.model.cell_m)
            if poses.key_of is not None:
                belief, poses = made_anew(given, belief, poses, before, state.steps, moved)
            heading, poses = rounded(heading, poses)
            row, col = cell_of(poses.estimate, belief.row, belief.col, belief.extent)
            poses = poses.replace(strayed=poses.strayed | (row != belief.row) | (col != belief.col))
            belief = belief.replace(row=row, col=col, heading=heading)
        direction = beams_of(own, heading, poses.estimate)
        grid = beams.fold(
            belief.grid, poses.estimate[:2], direction, reading, own.reach, belief.extent, belief.model.native,
            ends_first=True,
        )  # fmt: skip
        return belief.replace(grid=grid), poses, n_known, heading

    belief, poses, n_known, heading = run_if(when, scanned, parts)
    sd2 = jnp.diagonal(poses.covariance)
    is_lost = ~((jnp.max(sd2[:2]) <= LOST_M**2) & (sd2[2] <= LOST_RAD**2))
    is_lost &= (state.outcome == Outcome.RUNNING) & is_matched & when
    return state.replace(
        belief=belief,
        poses=poses,
        heading=heading,
        n_known=n_known,
        scans=state.scans + when,
        outcome=jnp.where(is_lost, Outcome.LOST, state.outcome),
        plan_active=state.plan_active & ~is_lost,
    )


def _cast(given: Given, xy: Array, direction: Array) -> Reading:
    """Return where beams from a place of the true world end."""
    occupied, base = stacked(given, jnp.asarray(given.scenes.occupied))
    return beams.cast(occupied, xy, direction, given.numbers.unsure.reach, base, given.numbers.model.native)


def _seen(
    setup: Setup, own: UnsureNumbers, belief: Belief, grid: Grid, poses: Poses,
    direction: Array, clean: Reading, n_known: Array,
) -> tuple[Grid, Array]:  # fmt: skip
    """Count a scan at the true pose into a map: `(map, n_known)`."""
    xy, terms = poses.true[:2], (direction, clean, own.reach, belief.extent)
    native = kernels.target_of(belief.model.native)
    if native is not None:
        seen, fresh = kernels.fold(native, grid, xy, *terms, belief.within)
        return seen, n_known + fresh
    square = square_round(setup, xy[1].astype(jnp.int32), xy[0].astype(jnp.int32), belief.driven.shape)
    before = n_known if square is None else known_cells(grid, belief.within, square)
    # As in `sensing.sense`: the number is made first, so that the map can be changed in place.
    seen = beams.fold(grid, xy + jnp.minimum(before, 0), *terms)
    return seen, n_known - before + known_cells(seen, belief.within, square)


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


def _matched(given: Given, poses: Poses, heading: Array, reading: Reading, cell_m: Array) -> tuple[Poses, Array]:
    """Correct the estimate by matching a scan with the point map, and maybe by a loop: `(poses, moved)`.

    `moved`: bool, whether a loop has moved key scans.
    """
    own, mapping, moved = given.numbers.unsure, poses.mapping, jnp.bool_(False)
    scanner = Scanner(own.angles_rad, own.reach * cell_m)
    ranges_m = ranges_of(reading, cell_m)
    scan = read_scan(own.matching, ranges_m, *scanner)
    x, y, more = poses.estimate
    start = jnp.stack([x * cell_m, y * cell_m, wrapped(heading * EIGHTH + more)])
    found = locate(own.matching, mapping.points, scan, start, poses.covariance)
    failed, is_first = found.outcome >= matching.Outcome.FAR, mapping.n_keys == 0
    off = found.pose - start
    off = off.at[2].set(wrapped(off[2]))
    errors = pick(failed, poses.errors, learned(poses.errors, poses.covariance, off, found.covariance))
    mapping, is_key = enter(own.matching, mapping, ranges_m, scan, found)
    if poses.key_of is not None:
        mapping, moved = look_for_loop(own.matching, mapping, scanner, is_key)
    estimate = jnp.append(mapping.pose[:2] / cell_m, wrapped(mapping.pose[2] - heading * EIGHTH))
    poses = poses.replace(
        estimate=jnp.where(failed & ~moved, poses.estimate, estimate),
        covariance=found.covariance,
        errors=errors,
        mapping=mapping,
        unmatched=poses.unmatched + (failed & ~is_first),
    )
    return poses, moved
