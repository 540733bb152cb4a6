"""Planning's kernels in native code against those in JAX: equal bits, under vmap, and nothing to differentiate."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beliefs

from jexplore.gain import look, prospect
from jexplore.grid import Grid, is_known
from jexplore.native import build, drive, kernels
from jexplore.planning import choose, field, known_of, nearest_frontier
from jexplore.policies import clusters, views
from jexplore.rules import Lidar
from jexplore.slam2d import beams, points
from jexplore.slam2d.scans import read_scan
from jexplore.slam2d.search import Window, search
from jexplore.slam2d.settings import SlamSettings

LIDAR = Lidar(n_beams=31, fov_deg=270, range_m=1.6)
SHAPE = 37, 45

pytestmark = [pytest.mark.jit, pytest.mark.skipif(not build.find_compiler(), reason="no C++ compiler")]


@pytest.fixture(scope="module", autouse=True)
def target():
    found = drive.load_driving()
    assert found.loaded is not None, found.why_not
    return found.name


def some_belief(seed, shape, clearance_d2, *, mixed=0.0, is_held=False):
    """Return a belief in which the robot has driven, been at some targets, and may be held within a region."""
    draw = np.random.default_rng(seed)
    belief = beliefs.after_scans(
        seed, shape, n_scans=int(draw.integers(1, 12)), mixed=mixed, grow=(3, 5), clearance_d2=clearance_d2
    )
    row, col = np.indices(belief.driven.shape)
    far = (row - int(belief.row)) ** 2 + (col - int(belief.col)) ** 2
    free = np.asarray(belief.grid.misses) > 0
    driven = free & (far < draw.integers(0, 80)) | np.asarray(belief.driven)
    within = None if not is_held else jnp.asarray(row + col < 0.8 * sum(shape))
    model = dataclasses.replace(belief.model, near_d2=jnp.int32(draw.integers(0, 30)))
    return belief.replace(
        driven=jnp.asarray(driven), exhausted=jnp.asarray(draw.random(free.shape) < 0.1), within=within, model=model
    )


def with_native(belief, target):
    return belief.replace(model=dataclasses.replace(belief.model, native=target))


def plan(belief, beams, key):
    """Return what strategies ask for, of a belief and its beams."""
    reached = field(belief)
    at = clusters.targets(belief, reached)
    route = jnp.full(reached.cost.shape, -1, jnp.int8)
    row, col = views.drawn(key, belief, reached, PARAMS)
    told = [
        reached, at, clusters.looks(belief, at, beams), clusters.looks(belief, at, beams, (0.3, 0.8)),
        jnp.minimum(clusters.looks(belief, at, beams, enough=3)[0], 3), clusters.paths_apart(belief, at),
        nearest_frontier(belief, route),
        clusters.go_to(belief, route, reached, at, jnp.sum(at.used, dtype=jnp.int32) - 1),
        views.live(PARAMS, belief, beams, belief.row, belief.col),
    ]  # fmt: skip
    ahead = prospect(known_of(belief), beams.all_round)
    told.append(look(ahead, belief.row, belief.col, beams.all_round, native=belief.model.native))
    told.append(views.best_view(views.gain_for_path, key, PARAMS, belief, reached, beams))
    return told, (row, col)


PARAMS = views.views(("weight", 0.1), 20, 0.5, 2)
PLAN = jax.jit(plan)


def assert_equal(one, other):
    for ours, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "clearance_d2", "is_held"), [((64, 96), 9, False), ((37, 45), 2, True)])
def test_plans_have_the_same_bits(target, shape, clearance_d2, is_held):
    found = 0
    for seed in range(16):
        belief = some_belief(seed, shape, clearance_d2, mixed=0.05 * (seed % 2), is_held=is_held)
        beams, key = beliefs.table(LIDAR, belief), jax.random.key(seed)
        want, got = (PLAN(own, beams, key) for own in (belief, with_native(belief, target)))
        assert_equal(got, want)
        found += int(want[0][1].used.sum())
    assert found > 20


def test_lanes_of_a_vmap_have_the_same_bits(target):
    alone = [some_belief(seed, SHAPE, 1) for seed in (1, 2, 4)]
    lanes = jax.tree.map(lambda *a: jnp.stack(a), *(with_native(belief, target) for belief in alone))
    found = jax.jit(jax.vmap(field))(lanes)
    for i, belief in enumerate(alone):
        assert_equal(jax.tree.map(lambda a, i=i: a[i], found), jax.jit(field)(belief))


def test_lengths_of_paths_have_no_gradient(target):
    belief = with_native(some_belief(1, SHAPE, 1), target)

    def nearest_m(cell_m, p_free):
        reached = field(belief.replace(model=dataclasses.replace(belief.model, p_free=p_free)))
        return jnp.min(jnp.where(reached.frontier, reached.cost * cell_m, math.inf))

    gradient = jax.jit(jax.grad(nearest_m, (0, 1)))(jnp.float32(0.1), jnp.float32(0.25))
    assert gradient[0] > 0
    assert gradient[1] == 0


def test_more_frontier_cells_than_are_looked_at_are_counted(target):
    """A chequered map has one frontier cell in four; one in 16 is looked at."""
    draw = np.random.default_rng(0)
    hits, misses = np.zeros((2, 40, 50), int)
    misses[::2] = 1
    misses[:, 25] = 1
    belief = beliefs.belief_from(hits, misses, (20, 25))
    belief = belief.replace(exhausted=jnp.asarray(draw.random(hits.shape) < 0.3))
    run = jax.jit(lambda belief: clusters.targets(belief, field(belief)))
    want, got = run(belief), run(with_native(belief, target))
    assert want.overflow > 100
    assert_equal(got, want)


def test_a_target_that_no_path_leads_to_ends(target):
    belief = some_belief(1, SHAPE, 1)
    route = jnp.full(belief.driven.shape, -1, jnp.int8)
    run = jax.jit(lambda belief: choose(belief, route, field(belief), jnp.int32(0), jnp.int32(0))[0])
    assert_equal(run(with_native(belief, target)), run(belief))


def test_a_robot_beside_its_map_is_refused(target):
    belief = with_native(some_belief(1, SHAPE, 1), target).replace(row=jnp.int32(99))
    with pytest.raises(jax.errors.JaxRuntimeError, match="a robot must be on its map"):
        jax.block_until_ready(jax.jit(field)(belief))


@pytest.mark.parametrize("seed", range(4))
def test_beams_from_any_pose_equal_those_in_jax(target, seed):
    """From centres of cells along exact corners, from anywhere, from outside; with readings of noise."""
    rng, cast = np.random.default_rng(seed), jax.jit(beams.cast, static_argnames="native")
    ends_first = seed in (1, 2)
    fold = jax.jit(functools.partial(beams.fold, ends_first=ends_first), static_argnames="native")
    worlds, reach, extent = rng.random((2, *SHAPE)) < (0.02, 0.2)[seed % 2], jnp.float32(31.7), jnp.int32([35, 45])
    worlds[:, [0, -1]] = worlds[:, :, [0, -1]] = True
    occupied, base = jnp.asarray(worlds.reshape(-1, SHAPE[1])), SHAPE[0] * (seed // 2)
    grid = Grid(*jnp.asarray(rng.integers(0, 2, (2, *SHAPE)), jnp.int32))
    within = jnp.asarray(rng.random(SHAPE) < 0.7)
    for k in range(20):
        xy = jnp.float32(rng.integers(2, 30, 2) + 0.5 if k % 3 == 0 else rng.uniform(1, 34, 2))
        angle = np.arange(0, 2 * np.pi, np.pi / 60) + (0 if k % 2 else rng.random())
        direction = jnp.float32(np.stack([np.cos(angle), np.sin(angle)], axis=1))
        expected = cast(occupied, xy, direction, reach, base)
        reading = cast(occupied, xy, direction, reach, base, native=target)
        assert_equal(reading, expected)
        if k % 4 == 3:
            reading = reading._replace(distance=reading.distance + jnp.float32(rng.normal(0, 2, len(angle))))
        reading = reading._replace(speaks=jnp.asarray(rng.random(len(angle)) < 0.9))
        at = xy - (40 if k == 19 else 0)
        new = fold(grid, at, direction, reading, reach, extent)
        assert_equal(fold(grid, at, direction, reading, reach, extent, native=target), new)
        found, fresh = jax.jit(functools.partial(kernels.fold, ends_first=ends_first), static_argnums=0)(
            target, grid, at, direction, reading, reach, extent, within
        )
        assert_equal(found, new)
        known = [int((np.asarray(is_known(one)) & np.asarray(within)).sum()) for one in (grid, new)]
        assert int(fresh) == known[1] - known[0]
        grid = new


@pytest.mark.parametrize("size", [4096, 70])
def test_points_that_enter_a_map_equal_those_in_jax(target, size):
    """Of scans of noise, of a room, at the edge of the map, and of a map that is full."""
    own, rng = SlamSettings(), np.random.default_rng(size)
    angles = jnp.linspace(-3, 3, 61, dtype=jnp.float32)
    add = jax.jit(lambda *given: points.add(own, *given))
    one, other = (points.empty_map((200, 260, size), (1.0, 2.0), native) for native in (None, target))
    for k in range(12):
        ranges = rng.choice([0.5, 1.1, 2.0, 2.03, 9.0, np.nan], 61) if k % 2 else 1 + 0.01 * rng.random(61)
        pose = jnp.float32(rng.normal([1, 2, 0], [2, 2, 2]))
        scan = read_scan(own, jnp.float32(ranges), angles, 8.0)
        one, other = add(one, scan, pose), add(other, scan, pose)
        assert_equal(other, one.replace(native=target))
    assert (int(one.overflow) > 0) == (size == 70)


@pytest.mark.parametrize("centre", [(1.0, 2.0), (2.9, -0.4)])
def test_a_search_equals_that_in_jax(target, centre):
    """Round a place in the middle of the map and at its corner, where some points lie outside."""
    own, rng, window = SlamSettings(), np.random.default_rng(0), Window(2, 3, 160)
    angles = jnp.linspace(-3, 3, 61, dtype=jnp.float32)
    scan = read_scan(own, jnp.float32(rng.choice([0.8, 1.1, 2.0, 3.0, np.nan], 61)), angles, 8.0)
    known = points.add(own, points.empty_map((200, 260, 512), centre), scan, jnp.float32([1, 2, 0.3]))
    find = jax.jit(
        lambda known, start: search(own, known, scan, start, jnp.diag(jnp.float32([0.1, 0.1, 0.01])), window)
    )
    for start in rng.normal([1.1, 1.9, 0.3], [0.2, 0.2, 0.05], (5, 3)):
        one, other = (find(known.replace(native=native), jnp.float32(start)) for native in (None, target))
        assert_equal(other, one)
        assert one.cost < 1
