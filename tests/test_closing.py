"""Loops of robots that do not know their pose: what they believe follows their key scans, and maps are mended."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_uncertain import NOISE, begun

from jexplore.exploration.uncertain import closing, looking, moving
from jexplore.grid import empty_grid
from jexplore.rules import Lidar, Odometry
from jexplore.slam2d.beams import Reading, fold

pytestmark = pytest.mark.jit
LIDAR = Lidar(n_beams=91, range_m=3.0)


@functools.cache
def driven(pose):
    """A robot that has driven sixteen steps in a room, three ahead, three to the left and so on."""
    setup, given, state = begun(pose, Odometry(**NOISE), LIDAR)
    look, go = jax.jit(looking.look, static_argnums=0), jax.jit(moving.turn_and_go)
    for k in range(16):
        state, _ = go(given, state, jnp.int32(k // 3 * 2), jnp.bool_(True), jnp.bool_(True))
        state = look(setup, given, state, jnp.bool_(True))
    return given, state


@pytest.mark.slow
def test_without_a_loop_a_robot_is_as_one_that_only_matches():
    (_, one), (_, other) = driven("icp"), driven("icp+closing")
    mapping = other.poses.mapping
    assert mapping.n_loops == 0
    assert mapping.tried_at > 0  # one was looked for
    for name in ("true", "estimate", "covariance", "seen"):
        jax.tree.map(np.testing.assert_array_equal, getattr(other.poses, name), getattr(one.poses, name))
    jax.tree.map(np.testing.assert_array_equal, other.belief, one.belief)
    jax.tree.map(np.testing.assert_array_equal, mapping.points, one.poses.mapping.points)


@pytest.mark.slow
def test_what_a_robot_believes_moves_with_its_key_scans():
    """All key scans move by two cells to the right and one up: so does the map of them, and the way."""
    given, state = driven("icp+closing")
    before, cell_m, n = state.poses.mapping.pose_of, 0.1, int(state.poses.mapping.n_keys)
    trail = state.poses.trail.at[:3, 3:].set(jnp.float32([[12.5, 12.5], [13.4, 12.6], [14.5, 12.4]]))
    blank = empty_grid(state.belief.driven.shape)
    unseen = blank.replace(misses=blank.misses.at[-2, -2].set(7))
    belief = state.belief.replace(exhausted=~state.belief.exhausted, grid=unseen)
    poses = state.poses.replace(trail=trail)

    @jax.jit
    def anew(by, moved):
        mapping = poses.mapping.replace(pose_of=before + jnp.float32([*by, 0]) * cell_m)
        return closing.made_anew(given, belief, poses.replace(mapping=mapping), before, jnp.int32(3), moved)

    one, other = anew((0.0, 0.0), True), anew((2.0, 1.0), True)
    for name in ("hits", "misses"):
        found, shifted = (np.asarray(getattr(b.grid, name)) for b, _ in (one, other))
        inner = np.s_[1:29, 2:42], np.s_[2:30, 4:44]  # the world has 30 x 44 cells
        agree = found[inner[0]] == shifted[inner[1]]
        assert agree.mean() > 0.98  # a beam on an edge may be rounded to the other cell
        assert found.sum() > 1000
    np.testing.assert_allclose(other[1].trail[:3, 3:], trail[:3, 3:] + jnp.float32([2, 1]), atol=1e-3)
    assert other[0].driven[13, 14:17].all()
    assert other[0].driven.sum() == 4  # and the robot's own cell
    assert other[0].grid.misses[-2, -2] == 7  # no key scan has seen it
    assert not other[0].exhausted.any()
    assert other[1].strayed
    own, grid, add = given.numbers.unsure, blank, jax.jit(fold)
    for pose, ranges in zip(before[: n - 1], poses.mapping.ranges_of):
        direction = jnp.stack([jnp.cos(pose[2] + own.angles_rad), jnp.sin(pose[2] + own.angles_rad)], axis=1)
        reading = Reading(ranges / cell_m, jnp.isfinite(ranges), ~jnp.isnan(ranges))
        grid = add(grid, pose[:2] / cell_m, direction, reading, own.reach, belief.extent)
    off = np.asarray(grid.hits - one[0].grid.hits)
    assert np.abs(off).sum() < 0.05 * np.asarray(grid.hits).sum()
    same = anew((2.0, 1.0), False)
    jax.tree.map(np.testing.assert_array_equal, same[0], belief)
    np.testing.assert_array_equal(same[1].trail, trail)
