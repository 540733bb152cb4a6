"""Localisation by scans: the point map, scan matching, search, one step of all, loops and their graph."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import slam as ref

from jexplore.arrays.poses import between, compose, placed, wrapped
from jexplore.slam2d.closing import Keys, Scanner, map_of
from jexplore.slam2d.graph import Loops, Steps, settle, surprise, turned_covariance
from jexplore.slam2d.mapping import Sizes, blank, close
from jexplore.slam2d.matching import Outcome, inverted, match
from jexplore.slam2d.points import REACH, PointMap, add, cell_m, cells_of, empty_map, partners
from jexplore.slam2d.scans import Scan, read_scan
from jexplore.slam2d.search import Window, most_steps, picture, search, step_cost
from jexplore.slam2d.settings import SlamSettings
from jexplore.slam2d.tracking import WIDE, locate, predict

OWN = SlamSettings()
SHAPE = (256, 320, 2048)  # 9 x 11 m
MIDDLE = (3.0, 2.0)
FAR = 80.0
PRIOR = np.diag(np.float32([0.05, 0.05, 0.03]) ** 2)
HERE = np.float32([1.5, 1.5, 0.3])
SETTLE, SURPRISE = jax.jit(settle), jax.jit(surprise)
LOCATE = jax.jit(lambda *place, window: locate(OWN, *place, window), static_argnames="window")
few = settings(max_examples=8)


def scan_of(pose, walls=ref.ROOM + ref.BOX, angles=ref.ANGLES, own=OWN):
    return read_scan(own, jnp.float32(ref.cast(pose, walls, angles)), jnp.float32(angles), FAR)


def map_from(*poses, walls=ref.ROOM + ref.BOX, own=OWN):
    points = empty_map(SHAPE, MIDDLE)
    for pose in poses:
        points = add(own, points, scan_of(pose, walls, own=own), jnp.float32(pose))
    return points


def stored(points):
    """Points of a map, `[n, 2]`, and normals, both sorted."""
    n = int(points.count)
    rows = np.c_[[np.asarray(a)[:n] for a in (points.x, points.y, points.normal_x, points.normal_y)]].T
    rows = rows[np.lexsort(rows[:, 1::-1].T)]
    return rows[:, :2], rows[:, 2:]


@pytest.fixture(scope="module")
def room():
    return map_from(HERE, HERE + np.float32([0.5, 0.2, 1.5]))


# --- poses


def test_poses_by_pencil():
    one, other = np.array([1.0, 2, np.pi / 2]), np.array([1.0, 3, np.pi])
    np.testing.assert_allclose(between(one, other), [1, 0, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(compose(one, np.array([1.0, 0, np.pi / 2])), [1, 3, -np.pi], atol=1e-12)
    np.testing.assert_allclose(placed(one, np.array([[0.0, 1]])), [[0, 2]], atol=1e-12)


# --- scans


@few
@given(st.floats(0.5, 5.5), st.floats(0.5, 2.4), st.floats(-3, 3))
def test_ends_and_normals_equal_the_scatter_matrix(x, y, heading):
    ranges = np.float32(ref.cast((x, y, heading)))
    ranges[::7] = [np.nan, np.inf, -1, 0, FAR, 81, 2, 3, 4][: len(ranges[::7])]
    scan = read_scan(OWN, jnp.float32(ranges), jnp.float32(ref.ANGLES), FAR)
    xy, normal, valid = ref.ends(OWN, ranges, ref.ANGLES)
    np.testing.assert_array_equal(scan.valid, valid)
    np.testing.assert_allclose(scan.xy, xy, atol=1e-5)
    is_lined = (normal != 0).any(axis=1)
    close = np.asarray((scan.normal != 0).any(axis=1)) == is_lined
    assert close.mean() > 0.95  # a point on the threshold may round otherwise
    np.testing.assert_allclose(np.asarray(scan.normal)[close], normal[close], atol=2e-3)


# --- the point map


def ask(points, xy):
    """Points of the map that stand for places, `[n, 2]`, and the squared distances."""
    x, y = jnp.float32(xy).T
    found = partners(points, *cells_of(OWN, points, x, y), x, y)
    return np.stack([found.x, found.y], axis=1), np.asarray(found.d2)


def test_a_full_map_counts_what_found_no_room():
    xy = jnp.float32([[0.01, 0.01], [0.01, 0.11], [0.11, 0.11], [0.11, 0.01], [9, 1]])
    points = add(OWN, empty_map((99, 99, 3)), Scan(xy, xy, jnp.ones(5, bool)), jnp.zeros(3))
    assert points.overflow == 1
    assert stored(points)[0].shape == (3, 2)


@few
@given(st.integers(0, 10**6))
def test_points_keep_their_distance_and_the_order_of_beams_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    xy = np.float32(rng.uniform(-0.3, 0.3, (30, 2)))
    scan = Scan(jnp.array(xy), jnp.array(np.float32(rng.normal(size=(30, 2)))), jnp.array(rng.random(30) < 0.9))
    pose, order = jnp.float32([0.2, 0.1, 1.0]), rng.permutation(30)
    points = add(OWN, empty_map((64, 64, 99)), scan, pose)
    found, normals = stored(points)
    expected = ref.add(OWN, [], xy.astype(float), np.asarray(scan.valid), np.asarray(pose, float))
    np.testing.assert_allclose(found, expected[np.lexsort(expected[:, ::-1].T)], atol=1e-5)
    shuffled = add(OWN, empty_map((64, 64, 99)), jax.tree.map(lambda a: a[order], scan), pose)
    for one, other in zip(stored(shuffled), (found, normals)):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(shuffled.near, points.near)
    xy = np.float32(rng.uniform(-0.3, 0.3, (30, 2)))
    later = add(OWN, points, Scan(jnp.array(xy), scan.normal, jnp.ones(30, bool)), pose)
    expected = ref.add(OWN, expected, xy.astype(float), np.ones(30, bool), np.asarray(pose, float))
    assert int(later.count) == len(expected)
    off = np.linalg.norm(stored(later)[0][:, None] - stored(later)[0][None], axis=2) + np.eye(int(later.count))
    assert off.min() >= 0.05 * (1 - 1e-3)


@pytest.mark.jit
def test_compiled_points_equally_far_do_not_wait_for_each_other():
    """Compiled squares of one range may round in two ways; the room and its beams are symmetric."""
    pose, angles = np.float32([3, 2, 0.5]), np.radians(np.linspace(-90, 90, 181))
    scan = scan_of(pose, ref.ROOM, angles)
    points = jax.jit(add)(OWN, empty_map(SHAPE, MIDDLE), scan, jnp.array(pose))
    expected = ref.add(OWN, [], np.asarray(scan.xy, float), np.asarray(scan.valid), np.asarray(pose, float))
    assert abs(int(points.count) - len(expected)) <= 2  # a distance on the threshold may round otherwise


@few
@given(st.integers(0, 10**6))
def test_partner_is_the_point_nearest_to_the_middle_of_the_cell(seed):
    rng = np.random.default_rng(seed)
    scan = Scan(jnp.float32(rng.uniform(0, 1, (60, 2))), jnp.ones((60, 2)), jnp.ones(60, bool))
    points = add(OWN, empty_map((64, 64, 99), (0.5, 0.5)), scan, jnp.zeros(3))
    xy = np.float32(rng.uniform(-0.3, 1.3, (30, 2)))
    tree = ref.KDTree(stored(points)[0])
    d, i = tree.query(ref.middles(OWN, xy, (0.5, 0.5), (64, 64)))
    found, d2 = ask(points, xy)
    near = d < (REACH + 1 - np.sqrt(0.5)) * cell_m(OWN)
    np.testing.assert_allclose(found[near], stored(points)[0][i[near]], atol=1e-5)
    exact = tree.query(xy)[0]
    assert (np.sqrt(d2[exact < OWN.gate_m]) < np.inf).all()
    assert (np.sqrt(d2)[near] <= exact[near] + 0.0495 + 1e-5).all()


# --- matching


def test_inverse_of_badly_scaled_matrices():
    a = np.array([[4e4, 5, 300], [5, 2e-3, 0.02], [300, 0.02, 50]])
    np.testing.assert_allclose(inverted(jnp.float32(a)) @ a, np.eye(3), atol=1e-2)


@pytest.mark.jit
@few
@given(st.floats(-0.06, 0.06), st.floats(-0.06, 0.06), st.floats(-0.03, 0.03))
def test_match_equals_plain_icp_and_finds_the_pose(room, dx, dy, turn):
    true = HERE + np.float32([0.2, -0.1, 0.2])
    start = true + np.float32([dx, dy, turn])
    scan = scan_of(true)
    found = jax.jit(match)(OWN, room, scan, jnp.array(start), jnp.array(PRIOR))
    own = [np.asarray(a) for a in (scan.xy, scan.normal, scan.valid)]
    expected = ref.match(OWN, *stored(room), own, start, PRIOR, MIDDLE, SHAPE[:2])
    np.testing.assert_allclose(found.pose, expected, atol=1e-3)
    np.testing.assert_allclose(found.pose, true, atol=0.03)
    assert found.outcome <= Outcome.UNSETTLED
    assert np.linalg.eigvalsh(found.covariance).min() > 0


def test_a_turned_and_moved_world_moves_the_answer(room):
    true, start = HERE + np.float32([0.2, -0.1, 0.2]), HERE + np.float32([0.22, -0.06, 0.22])
    move = np.float32([2.2, -3.4, 2.0])

    def moved(pose):
        return np.float32(compose(move.astype(float), np.asarray(pose, float)))

    points = map_from(HERE)
    turned = add(OWN, empty_map((512, 512, 2048)), scan_of(HERE), jnp.array(moved(HERE)))
    one = match(OWN, points, scan_of(true), jnp.array(start), jnp.array(PRIOR))
    other = match(OWN, turned, scan_of(true), jnp.array(moved(start)), jnp.array(PRIOR))
    off = np.asarray(other.pose) - moved(one.pose)
    np.testing.assert_allclose([*off[:2], wrapped(off[2])], 0, atol=2e-3)
    assert abs(float(one.fitness - other.fitness)) < 0.05


CORRIDOR = ((-50, -1, 50, -1), (-50, 1, 50, 1))


def test_a_corridor_follows_the_odometry_along_it():
    ranges = np.where(ref.cast((0, 0, 0), CORRIDOR) < 6, ref.cast((0, 0, 0), CORRIDOR), np.inf)
    scan = read_scan(OWN, jnp.float32(ranges), jnp.float32(ref.ANGLES), FAR)
    points = add(OWN, empty_map((99, 400, 999)), scan, jnp.zeros(3))
    found = match(OWN, points, scan, jnp.float32([0.3, 0.04, 0.01]), jnp.array(PRIOR))
    assert found.outcome == Outcome.DEGENERATE
    np.testing.assert_allclose(found.pose, [0.3, 0, 0], atol=0.02)
    along, across = np.sqrt(np.diag(found.covariance))[:2]
    assert along > 0.7 * 0.05 > across


@pytest.mark.parametrize("ranges", [np.full(61, np.inf), np.where(np.arange(61) == 30, 2.0, np.nan), np.full(61, -1.0)])
@pytest.mark.parametrize("is_empty", [True, False])
def test_scans_that_tell_nothing_keep_the_odometry(room, ranges, is_empty):
    points = empty_map(SHAPE, MIDDLE) if is_empty else room
    scan = read_scan(OWN, jnp.float32(ranges), jnp.float32(ref.ANGLES), FAR)
    found = match(OWN, points, scan, jnp.array(HERE), jnp.array(PRIOR))
    assert found.outcome == Outcome.FEW
    np.testing.assert_array_equal(found.pose, HERE)
    np.testing.assert_array_equal(found.covariance, PRIOR)
    assert np.isfinite(found.fitness)


def test_a_match_against_the_odometry_is_refused(room):
    certain = jnp.diag(jnp.float32([1e-3, 1e-3, 1e-3]) ** 2)
    found = match(OWN, room, scan_of(HERE), jnp.array(HERE + np.float32([0.05, 0, 0])), jnp.array(PRIOR))
    assert found.outcome == Outcome.MATCHED
    far = match(
        OWN.replace(noise_m=0.001, huber=1e3), room, scan_of(HERE), jnp.array(HERE + np.float32([0.05, 0, 0])), certain
    )
    assert far.outcome == Outcome.FAR
    np.testing.assert_array_equal(far.pose, HERE + np.float32([0.05, 0, 0]))


# --- search


def test_picture_equals_the_distances_by_a_tree(room):
    row, col = jnp.int32(100), jnp.int32(20)  # moved into the map: at the left
    found, first_row, first_col = picture(OWN, room, row, col, 160)
    assert (first_row, first_col) == (20, 0)
    expected = ref.picture(OWN, stored(room)[0], MIDDLE, SHAPE[:2])[20:180, :160]
    np.testing.assert_allclose(found * step_cost(OWN), expected, atol=3e-3)
    assert found.min() < 30
    assert found.max() == most_steps(OWN)


@pytest.mark.slow
def test_search_equals_trying_every_pose(room):
    window, true = Window(1, 2), HERE + np.float32([0.1, -0.07, 0.02])
    scan, prior = scan_of(true), np.diag(np.float32([0.2, 0.2, 0.1]) ** 2)
    found = search(OWN, room, scan, jnp.array(HERE), jnp.array(prior), window)
    cost, own = ref.picture(OWN, stored(room)[0], MIDDLE, SHAPE[:2]), [np.asarray(a) for a in scan.__dict__.values()]
    least, pose = ref.search(OWN, cost, MIDDLE, own, HERE, prior, 1, 2)
    np.testing.assert_allclose(found.cost, least, atol=1e-3)
    np.testing.assert_allclose(found.pose, pose, atol=1e-5)
    assert found.other > found.cost


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("off", [(0.35, -0.3, 0.15), (-0.4, 0.2, -0.18)])
def test_a_step_with_bad_odometry_is_searched_for(room, off):
    start, prior = HERE + np.float32(off), np.diag(np.float32([0.3, 0.3, 0.15]) ** 2)
    found = LOCATE(room, scan_of(HERE), start, prior, window=Window(3, 12))
    np.testing.assert_allclose(found.pose, HERE, atol=0.02)
    assert found.outcome == Outcome.MATCHED


@pytest.mark.slow
@pytest.mark.jit
def test_a_start_2_m_off_is_found_by_a_wide_window_and_not_believed_by_a_narrow_one(room):
    start, prior = HERE + np.float32([1.9, 0.6, 0.0]), np.diag(np.float32([1, 1, 0.1]) ** 2)
    narrow = LOCATE(room, scan_of(HERE), start, prior, window=Window(3, 12))
    assert narrow.fitness < 0.8
    wide = LOCATE(room, scan_of(HERE), start, prior, window=WIDE)
    np.testing.assert_allclose(wide.pose, HERE, atol=0.02)


FINS = tuple((x, y, x, 0.7 * y) for x in np.arange(-9.5, 10, 2) for y in (-1, 1))


@pytest.mark.slow
@pytest.mark.jit
def test_without_odometry_a_place_that_looks_like_another_is_ambiguous(room):
    prior = np.diag(np.float32([1, 1, 0.8]) ** 2)
    found = LOCATE(room, scan_of(HERE), HERE, prior, window=WIDE)
    assert found.outcome == Outcome.MATCHED
    np.testing.assert_allclose(found.pose, HERE, atol=0.02)
    walls = (*CORRIDOR, *FINS)
    rows = map_from((-2, 0, 0), (0, 0, 0), (2, 0, 0), walls=walls)
    found = LOCATE(rows, scan_of((0, 0, 0), walls), np.float32([-1, 0, 0]), prior, window=WIDE)  # halfway to another
    assert found.outcome == Outcome.AMBIGUOUS


def test_odometry_by_pencil():
    pose, covariance = predict(OWN, jnp.float32([1, 2, np.pi / 2]), jnp.float32([1, 0, 0]))
    np.testing.assert_allclose(pose, [1, 3, np.pi / 2], atol=1e-6)
    place, turn = OWN.way_m + OWN.way_share, np.radians(OWN.turn_deg + OWN.turn_deg_m)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [place, place, turn], rtol=1e-5)
    unknown = predict(OWN, jnp.zeros(3), None)[1]
    np.testing.assert_allclose(np.sqrt(np.diag(unknown)), [1, 1, np.pi / 4], rtol=1e-5)


# --- compiled


@pytest.mark.jit
def test_rows_of_a_batch_are_independent_and_nothing_is_nan(room):
    rng = np.random.default_rng(3)
    n = 200
    starts = np.float32(rng.uniform([-1, -1, -4], [7, 5, 4], (n, 3)))
    ranges = np.float32(rng.choice([0, -1, np.nan, np.inf, 1, 2, 3, 80], (n, 61)) * rng.uniform(0.9, 1.1, (n, 61)))
    ranges[::2] = [ref.cast(HERE) + rng.normal(0, 0.02, 61) for _ in ranges[::2]]
    starts[::2] = HERE + np.float32(rng.normal(0, 0.1, (n // 2, 3)))
    priors = np.float32(np.exp(rng.uniform(-14, 2, (n, 1, 1))) * np.eye(3))

    def one(ranges, start, prior):
        return match(OWN, room, read_scan(OWN, ranges, jnp.float32(ref.ANGLES), FAR), start, prior)

    together = jax.jit(jax.vmap(one))
    found = together(ranges, starts, priors)
    assert all(np.isfinite(a).all() for a in found)
    assert len(np.unique(found.outcome)) >= 4
    order = rng.permutation(n)
    again = together(ranges[order], starts[order], priors[order])
    for a, b in zip(found, again):
        np.testing.assert_array_equal(np.asarray(a)[order], b)


@pytest.mark.jit
def test_more_noise_is_never_better(room):
    """Of ranges and of the start, in the mean of 1,000 draws."""
    rng = np.random.default_rng(4)
    draws = np.float32(rng.normal(size=(1000, 61))), np.float32(rng.normal(size=(1000, 3)) * [0.05, 0.05, 0.03])
    clean, angles = jnp.float32(ref.cast(HERE)), jnp.float32(ref.ANGLES)

    @jax.jit
    def off_m(range_m, start):
        def one(draws):
            scan = read_scan(OWN, clean + range_m * draws[0], angles, FAR)
            return jnp.hypot(*(match(OWN, room, scan, HERE + start * draws[1], PRIOR).pose - HERE)[:2])

        return jnp.mean(jax.lax.map(one, draws))

    for levels in ([(sd, 1.0) for sd in (0.0, 0.01, 0.03, 0.1)], [(0.01, share) for share in (0.0, 1.0, 2.0, 4.0)]):
        errors = [off_m(*map(np.float32, level)) for level in levels]
        assert (np.diff(errors) > 0).all()


# --- loops


def test_a_map_of_key_scans_equals_adding_them(room):
    poses = np.stack([HERE, HERE + np.float32([0.5, 0.2, 1.5]), np.zeros(3, np.float32)])
    ranges = np.float32([ref.cast(pose) for pose in poses])
    keys = Keys(jnp.array(ranges), jnp.array(poses), jnp.array([True, True, False]))
    made = map_of(OWN, keys, Scanner(jnp.float32(ref.ANGLES), jnp.float32(FAR)), empty_map(SHAPE, MIDDLE))
    for one, other in zip(stored(made), stored(room)):
        np.testing.assert_allclose(one, other, atol=1e-5)


def ring(n, rng, sd=0.01):
    """A round way: true poses, poses by measured steps, these steps, one loop; float64."""
    true, poses = [np.zeros(3)], [np.zeros(3)]
    for _ in range(n - 1):
        true.append(compose(true[-1], np.array([1.0, 0, 2 * np.pi / n])))
    true = np.array(true)
    moved = np.concatenate([np.zeros((1, 3)), between(true[:-1], true[1:]) + rng.normal(0, sd, (n - 1, 3))])
    for step in moved[1:]:
        poses.append(compose(poses[-1], step))
    covariance = np.array([np.diag(rng.uniform(0.5, 2, 3)) * sd**2 for _ in range(n)])
    loops = Loops(np.array([[0, n - 1]]), between(true[:1], true[-1:]), covariance[:1])
    return true, np.array(poses), Steps(moved, covariance), loops


def added(loops, ends, moved):
    """Loops and one more, as certain as the first, and room for another."""
    none = np.array([-1, -1])
    return Loops(
        np.stack([*loops.ends, np.array(ends), none]),
        np.stack([*loops.moved, np.array(moved), np.zeros(3)]),
        np.stack([*loops.covariance, loops.covariance[0], np.zeros((3, 3))]),
    )


def single(tree):
    return jax.tree.map(lambda a: jnp.asarray(a, jnp.int32 if a.dtype.kind == "i" else jnp.float32), tree)


@pytest.mark.jit
@few
@given(st.integers(0, 10**6))
def test_graph_equals_a_general_solver(seed):
    true, poses, steps, loops = ring(7, np.random.default_rng(seed))
    loops = added(loops, [1, 4], between(true[1], true[4]) + 0.01)
    found, misfit2 = SETTLE(jnp.float32(poses), single(steps), single(loops), 1e9)
    ends = np.array([*((k, k + 1) for k in range(6)), *loops.ends[:2]])
    moved, covariance = (np.concatenate([a[1:], b[:2]]) for a, b in zip(steps, loops[1:]))
    expected = ref.settle(poses, ends, moved, np.linalg.inv(covariance))
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=2e-4)
    np.testing.assert_allclose(wrapped(found[:, 2] - expected[:, 2]), 0, atol=2e-4)
    assert misfit2[2] == 0


@pytest.mark.jit
def test_a_loop_closes_large_drift_and_a_wrong_one_counts_for_nothing():
    true, poses, steps, loops = ring(60, np.random.default_rng(5))
    open_m = np.hypot(*(poses - true)[:, :2].T).max()
    wrong = single(added(loops, [3, 40], [0.0, 0, 0]))
    found, misfit2 = SETTLE(jnp.float32(poses), single(steps), wrong, 10.0)
    assert open_m > 1
    np.testing.assert_allclose(found, SETTLE(jnp.float32(poses), single(steps), single(loops), 10.0)[0], atol=0.02)
    assert misfit2[1] > 1e4 > 10 > misfit2[0]


@pytest.mark.jit
@few
@given(st.integers(0, 10**6))
def test_a_loop_surprises_by_what_it_adds_to_the_least_misfit(seed):
    true, poses, steps, loops = ring(7, np.random.default_rng(seed), sd=0.003)
    loops = added(loops, [1, 4], between(true[1], true[4]) + 0.01)

    def least(n):
        """Poses settled with the chain and n loops, and their squared misfit."""
        ends = np.array([*((k, k + 1) for k in range(6)), *loops.ends[:n]])
        moved, covariance = (np.concatenate([a[1:], b[:n]]) for a, b in zip(steps, loops[1:]))
        found = ref.settle(poses, ends, moved, np.linalg.inv(covariance))
        off = between(found[ends[:, 0]], found[ends[:, 1]]) - moved
        off[:, 2] = wrapped(off[:, 2])
        return found, np.einsum("li,lij,lj", off, np.linalg.inv(covariance), off)

    (before, one), (_, both) = least(1), least(2)
    found = SURPRISE(jnp.float32(before), single(steps), single(loops), 1, 1e9)
    np.testing.assert_allclose(found, both - one, rtol=0.02, atol=0.05)


AROUND = np.float32(np.linspace(-np.pi, np.pi, 120, endpoint=False))
LANES = (
    *((-1, 0, 7, 0), (7, 0, 7, 3), (7, 3, -1, 3), (-1, 3, -1, 0)),  # a corridor of 1 m round a block
    *((0, 1, 6, 1), (6, 1, 6, 2), (6, 2, 0, 2), (0, 2, 0, 1)),
    *((x, y + up, x, y + up + long) for x, y, long in ((2.2, 0, 0.3), (4.5, 0.6, 0.4)) for up in (0, 2)),
)


def record(corners, seed):
    """Key scans along a way through the lanes, their chain, and true poses. The last corner's heading is the last's."""
    rng, true = np.random.default_rng(seed), []
    for (x, y), (u, v) in pairwise(corners):
        share = np.arange(0, 1, 0.5 / np.hypot(u - x, v - y))
        true += [(x + a * (u - x), y + a * (v - y), np.arctan2(v - y, u - x)) for a in share]
    true = np.array(true)
    sd, n = np.array([0.02, 0.02, np.radians(0.5)]), len(true)
    moved, poses = between(true[:-1], true[1:]) + rng.normal(0, sd, (n - 1, 3)), [true[0]]
    for step in moved:
        poses.append(compose(poses[-1], step))
    room, chain = ((0, 64 - n), (0, 0)), np.pad(moved, ((1, 64 - n), (0, 0)))
    way = np.cumsum(np.r_[0, np.hypot(*moved[:, :2].T)])
    mapping = blank(Sizes(64, 2, (16, 16, 16)), len(AROUND), poses[-1])
    mapping = mapping.replace(
        n_keys=jnp.int32(n),
        way=jnp.float32(way[-1]),
        pose_of=jnp.float32(np.pad(poses, room)),
        ranges_of=jnp.float32(np.pad([ref.cast(pose, LANES, AROUND) for pose in true], room)),
        way_of=jnp.float32(np.pad(way, room[0])),
        steps=Steps(jnp.float32(chain), jnp.tile(jnp.diag(jnp.float32(sd**2)), (64, 1, 1))),
    )
    return mapping, true


@pytest.mark.jit
@pytest.mark.slow
def test_a_ring_is_closed_and_corridors_alike_are_not_taken_for_one():
    """Both corridors look alike from their middle and lie 2 m apart: the scan alone is sure of the wrong one."""
    scanner = Scanner(jnp.asarray(AROUND), jnp.float32(FAR))
    looked = jax.jit(lambda own, mapping: close(own, mapping, scanner, jnp.bool_(True), Window(12, 12))[0])
    there_and_other = (-0.5, 0.5), (3.6, 0.5), (-0.5, 0.5), (-0.5, 2.5), (3.6, 2.5)
    round_about = (2, 0.5), (6.5, 0.5), (6.5, 2.5), (-0.5, 2.5), (-0.5, 0.5), (3.1, 0.5)
    for seed in range(3):
        alike, _ = record(there_and_other, seed)
        assert looked(OWN, alike).n_loops == 0
        assert looked(SlamSettings(close_doubt=1e6), alike).n_loops == 1
        ring, true = record(round_about, seed)
        closed = looked(OWN, ring)
        assert closed.n_loops == 1
        off = between(closed.pose_of[0], closed.pose) - between(true[0], true[-1])
        np.testing.assert_allclose(off[:2], 0, atol=0.03)
        assert looked(OWN, alike.replace(n_loops=jnp.int32(2))).n_loops == 2  # without room only loops count
        full = looked(OWN, ring.replace(n_loops=jnp.int32(2)))
        assert full.n_loops == 3
        np.testing.assert_array_equal(full.pose_of, ring.pose_of)


def test_a_covariance_turns_with_its_frame():
    turned = turned_covariance(jnp.diag(jnp.float32([1, 100, 5])), jnp.float32(np.pi / 2))
    np.testing.assert_allclose(turned, np.diag([100, 1, 5]), atol=1e-4)


def test_settings_refuse_numbers_that_make_no_sense():
    with pytest.raises(ValueError, match="noise_m must be a number above 0"):
        SlamSettings(noise_m=0)
    assert isinstance(empty_map((3, 3, 1)), PointMap)
