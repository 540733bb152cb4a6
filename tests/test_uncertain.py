"""Robots that do not know their pose: beams from any pose, motion with errors, outcomes, whole episodes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore import raycast
from jexplore.engine.program import Given
from jexplore.exploration import environment, site
from jexplore.exploration.state import Outcome, Stream
from jexplore.exploration.uncertain import closing, looking, moving
from jexplore.exploration.uncertain.poses import EIGHTH, beams_of, cell_of, rounded
from jexplore.grid import empty_grid
from jexplore.policies.closest import closest
from jexplore.rules import Lidar, Odometry, Rules
from jexplore.slam2d import beams
from jexplore.slam2d.beams import Reading, fold
from jexplore.slam2d.odometry import corrected, encoded, learned, spread, step_covariance, unknown_errors

EXACT = Odometry(length=0, turn=0, heading_deg_sqrt_m=0, slip=0)
ROUGH = Odometry(
    length=0.1, turn=0.1, heading_deg_sqrt_m=5, length_m_sqrt_rad=0.02, length_scale=1.05, turn_scale=0.95,
    heading_bias_deg_m=3, slip=0.05,
)  # fmt: skip
LIDAR = Lidar(n_beams=13, range_m=2.0)


def two_rooms():
    occupied = np.ones((30, 44), bool)
    occupied[2:28, 2:21] = occupied[2:28, 23:42] = occupied[11:19, 21:23] = False
    return jx.World(occupied=occupied, cell_m=0.1, name="two rooms")


@functools.cache
def begun(pose, odometry=EXACT, lidar=LIDAR):
    """An episode after its first scans, from one place: setup, run context, state."""
    own = site.prepare_site(two_rooms(), lidar, Rules(pose=pose, odometry=odometry, max_steps=200))
    numbers = jax.tree.map(jnp.asarray, own.numbers)
    scenes = jax.tree.map(lambda a: jnp.asarray(a)[None], own.truth)
    task = jnp.int32([12, 12, 2])
    given = Given(jax.random.key(3), jax.tree.map(jnp.asarray, own.beams), scenes, jnp.int32(0), numbers, task)
    setup = own.setup._replace(policy=closest()._replace(params=()))
    return setup, given, jax.jit(environment.begin, static_argnums=0)(setup, given)


# --- beams from any pose


def test_a_beam_by_pencil():
    occupied = np.ones((5, 8), bool)
    occupied[1:4, 1:7] = False
    xy, east = jnp.float32([1.5, 2.5]), jnp.float32([[1, 0]])
    found = beams.cast(jnp.asarray(occupied), xy, east, jnp.float32(20))
    assert found.hit[0]
    assert found.distance[0] == 5.5
    assert not beams.cast(jnp.asarray(occupied), xy, east, jnp.float32(5.5)).hit[0]
    extent = jnp.int32([5, 8])
    for off, hit in ((0.0, 7), (0.4, 7), (-0.4, 7), (0.6, 6)):  # error of the estimate to the left
        grid = beams.fold(empty_grid((5, 8)), xy - jnp.float32([off, 0]), east, found, jnp.float32(20), extent)
        first = 1 if off < 0.5 else 0
        np.testing.assert_array_equal(np.flatnonzero(grid.hits[2]), [hit])
        np.testing.assert_array_equal(np.flatnonzero(grid.misses[2]), np.arange(first, hit))
    silent = found._replace(speaks=jnp.zeros(1, bool))
    assert int(beams.fold(empty_grid((5, 8)), xy, east, silent, jnp.float32(20), extent).misses.sum()) == 1


def test_a_beam_does_not_free_the_cell_in_which_another_one_ends():
    """The second beam passes through the first one's last cell; of a cell that a beam ends in it tells nothing."""
    east, xy = jnp.float32([[1, 0], [1, 0]]), jnp.float32([1.5, 2.5])
    reading = beams.Reading(jnp.float32([2.5, 3.5]), jnp.ones(2, bool), jnp.ones(2, bool))
    for ends_first, misses in ((False, [0, 1, 2, 2, 1, 0, 0, 0]), (True, [0, 1, 2, 2, 0, 0, 0, 0])):
        grid = beams.fold(
            empty_grid((5, 8)), xy, east, reading, jnp.float32(20), jnp.int32([5, 8]), ends_first=ends_first
        )
        np.testing.assert_array_equal(grid.hits[2], [0, 0, 0, 0, 1, 1, 0, 0])
        np.testing.assert_array_equal(grid.misses[2], misses)


def test_what_lies_outside_the_map_is_not_counted():
    reading = beams.Reading(jnp.float32([3.0, 9.0]), jnp.array([True, False]), jnp.ones(2, bool))
    directions = jnp.float32([[-1, 0], [0, 1]])
    grid = beams.fold(
        empty_grid((6, 6)), jnp.float32([0.5, 1.5]), directions, reading, jnp.float32(9), jnp.int32([4, 6])
    )
    assert int(grid.hits.sum()) == 0
    np.testing.assert_array_equal(np.argwhere(grid.misses), [[1, 0], [2, 0], [3, 0]])
    far = beams.fold(
        empty_grid((6, 6)), jnp.float32([-40.5, 99.5]), directions, reading, jnp.float32(9), jnp.int32([6, 6])
    )
    assert int(far.hits.sum() + far.misses.sum()) == 0


@pytest.mark.jit
def test_on_the_lattice_cells_are_those_of_the_table():
    """At a cell's centre and headings of 45 degrees, exact corners included: hits and misses of every cell."""
    rng, lidar, shape = np.random.default_rng(0), Lidar(n_beams=181, range_m=8), (160, 160)
    table = jax.tree.map(jnp.asarray, raycast.beam_table(lidar, 0.1, shape[1]))
    directions = np.stack(raycast.exact_direction(45.0 * np.arange(8)[:, None] + raycast.beam_angles_deg(lidar)), -1)
    cast, fold = jax.jit(beams.cast), jax.jit(beams.fold)
    for heading in range(8):
        occupied = rng.random(shape) < (0.0, 0.01, 0.1)[heading % 3]
        occupied[[0, -1]] = occupied[:, [0, -1]] = True
        occupied, xy = jnp.asarray(occupied), jnp.float32([80.5, 78.5])
        seen = raycast.scan(occupied, 78, 80, heading, table)
        expected = raycast.fold(empty_grid(shape), 78, 80, heading, seen, table)
        direction, reach = jnp.float32(directions[heading]), table.reach
        found = fold(empty_grid(shape), xy, direction, cast(occupied, xy, direction, reach), reach, jnp.int32(shape))
        np.testing.assert_array_equal(found.hits, expected.hits)
        np.testing.assert_array_equal(found.misses, expected.misses)


# --- odometry


def test_the_stated_covariance_is_that_of_draws():
    noise = Odometry(length=0.1, turn=0.1, heading_deg_sqrt_m=5, length_m_sqrt_rad=0.02, slip=0)
    draws = np.random.default_rng(0).normal(size=(4, 20000)).astype(np.float32)
    way, turn = encoded(noise, jnp.float32(0.5), jnp.float32(0.7), jnp.float32(0.5), draws)
    sd = np.sqrt(np.diagonal(step_covariance(noise, jnp.float32(0.5), jnp.float32(0.7))))
    np.testing.assert_allclose([way.std(), turn.std()], sd[[0, 2]], rtol=0.02)
    assert np.all(np.diagonal(step_covariance(EXACT, jnp.float32(0), jnp.float32(0))) > 0)


@pytest.mark.parametrize("turn", [0.7, -2.0])
def test_known_errors_are_taken_out(turn):
    noise = Odometry(length_scale=1.25, turn_scale=1.0, heading_bias_deg_m=-3, slip=0.2)
    told = encoded(noise, jnp.float32(0.5), jnp.float32(turn), jnp.float32(0.5), jnp.zeros(4))
    errors = unknown_errors()._replace(error=jnp.float32([1, 1, -1]))
    np.testing.assert_allclose(corrected(noise, errors, *told, jnp.float32(0.5)), [0.5, 0.8 * turn], rtol=1e-5)
    assert corrected(noise, unknown_errors(), *told, jnp.float32(0.5)) == told


def test_errors_stay_where_rounding_leaves_no_knowledge():
    """The prior is singular: nothing can be inverted."""
    errors = unknown_errors()._replace(with_pose=jnp.eye(3))
    found = learned(errors, jnp.zeros((3, 3)), jnp.ones(3), jnp.zeros((3, 3)))
    jax.tree.map(np.testing.assert_array_equal, found, unknown_errors())


def turned_and_gone(numbers, moved, turn):
    """Pose and errors (logarithms of scales, rad/m) after a motion whose corrected report is given."""
    pose, (length, turned, bias) = numbers[:3], numbers[3:]
    off = -turned * turn - bias * np.hypot(*moved)
    cos, sin = np.cos(pose[2] + off), np.sin(pose[2] + off)
    way = (1 - length) * np.array([[cos, -sin], [sin, cos]]) @ moved
    return np.array([*(pose[:2] + way), pose[2] + off, *numbers[3:]])


@pytest.mark.jit
def test_systematic_errors_are_those_of_a_kalman_filter():
    """A filter of six numbers in float64, its derivatives by differences; a match measures at every third step."""
    rng = np.random.default_rng(1)
    size = np.array([np.log(1.05), np.hypot(np.log(0.95), np.log(0.95)), np.radians(3)])
    errors, covariance = unknown_errors(), jnp.zeros((3, 3))
    mean, own = np.zeros(6), np.diag([0.0, 0, 0, *size**2])
    predict, update = jax.jit(spread), jax.jit(learned)
    for step in range(30):
        moved_m, turn = rng.normal(0, 0.2, 2), rng.normal(0, 0.5)
        ends = [turned_and_gone(1e-5 * unit, moved_m, turn) for unit in (*np.eye(6), *-np.eye(6))]
        jacobian = (np.array(ends[:6]) - ends[6:]).T / 2e-5
        way = np.hypot(*moved_m)
        drawn = np.pad(np.asarray(step_covariance(ROUGH, jnp.float32(way), jnp.float32(turn))), (0, 3))
        drawn[:3, :3] = jacobian[:3, :3] @ drawn[:3, :3] @ jacobian[:3, :3].T
        own = jacobian @ own @ jacobian.T + drawn
        own[[0, 1], [0, 1]] += 0.75 * (way * own[2, 2]) ** 2
        errors, covariance = predict(ROUGH, errors, covariance, *map(jnp.float32, (moved_m, turn)))
        np.testing.assert_allclose(covariance, own[:3, :3], rtol=1e-3, atol=1e-5)
        if step % 3 == 2:
            across = rng.normal(size=(3, 2))  # of two directions of the pose the scan tells
            gain = own[:, :3] @ across @ np.linalg.inv(across.T @ own[:3, :3] @ across + 1e-4 * np.eye(2))
            off = gain @ rng.normal(0, 0.02, 2)
            mean, own = mean + off, own - gain @ across.T @ own[:3]
            errors = update(errors, covariance, *map(jnp.float32, (off[:3], own[:3, :3])))
            covariance = jnp.float32(own[:3, :3])
            np.testing.assert_allclose(errors.error * size, mean[3:], atol=1e-4)
            np.testing.assert_allclose(errors.covariance * np.outer(size, size), own[3:, 3:], atol=1e-5)


# --- motion


def moved(true, estimate, heading, drow, dcol, noise, draws):
    """The motion in plain numpy: true and estimated pose after it, headings in radians. No walls."""
    (x, y, own), target = estimate, np.floor(estimate[:2]) + 0.5 + [dcol, drow]
    wanted = target - [x, y]
    bearing, way = np.arctan2(wanted[1], wanted[0]), np.hypot(*wanted)
    turn = (bearing - own + np.pi) % (2 * np.pi) - np.pi
    told_turn = noise.turn_scale * turn * (1 + noise.turn * draws[1])
    way_m = way * 0.1
    told_turn += np.radians(noise.heading_deg_sqrt_m) * np.sqrt(way_m) * draws[2]
    told_turn += np.radians(noise.heading_bias_deg_m) * way_m
    told_m = noise.length_scale * way_m * (1 + noise.length * draws[0])
    told_m += noise.length_m_sqrt_rad * np.sqrt(abs(turn)) * draws[3]
    out = []
    for place, angle, length in (
        (true, true[2] + turn * (1 - noise.slip), way),
        (estimate, own + told_turn, told_m / 0.1),
    ):
        out.append([place[0] + length * np.cos(angle), place[1] + length * np.sin(angle), angle])
    return np.array(out)


@pytest.mark.parametrize("motion", [0, 3, 5])
def test_a_motion_is_that_of_plain_numpy(motion):
    _, given, state = begun("odometry", ROUGH)
    poses = state.poses.replace(
        true=state.poses.true + jnp.float32([0.3, -0.2, 0.1]),
        estimate=state.poses.estimate + jnp.float32([0.1, 0.2, -0.2]),
    )
    state = state.replace(poses=poses)
    key = jax.random.fold_in(jax.random.fold_in(given.key, Stream.ODOMETRY), poses.motions)
    (drow, dcol), heading = raycast_motion(motion)
    after, bumped = moving.turn_and_go(given, state, jnp.int32(heading), jnp.bool_(True), jnp.bool_(True))
    assert not bumped
    before = [np.append(p[:2], p[2] + state.heading * EIGHTH) for p in map(np.asarray, (poses.true, poses.estimate))]
    expected = moved(*before, state.heading, drow, dcol, ROUGH, np.asarray(jax.random.normal(key, (4,))))
    for found, one in zip((after.poses.true, after.poses.estimate), expected):
        np.testing.assert_allclose(found[:2], one[:2], atol=2e-4)
        off = float(found[2] + after.heading * EIGHTH - one[2])
        assert abs((off + np.pi) % (2 * np.pi) - np.pi) < 1e-4
    idle, bumped = moving.turn_and_go(given, state, jnp.int32(heading), jnp.bool_(True), jnp.bool_(False))
    assert not bumped
    jax.tree.map(np.testing.assert_array_equal, (idle.poses, idle.belief), (state.poses, state.belief))


@pytest.mark.jit
def test_the_covariance_of_a_pose_is_that_of_draws():
    """After a turn of 135 degrees and a step, which errs aside as the turn does."""
    noise = Odometry(length=0, turn=0.02, heading_deg_sqrt_m=5, slip=0)
    _, given, state = begun("odometry")
    state = state.replace(poses=state.poses.replace(covariance=jnp.zeros((3, 3))))
    given = given.replace(numbers=given.numbers.replace(unsure=given.numbers.unsure.replace(odometry=noise)))

    def off(key):
        after = moving.turn_and_go(given.replace(key=key), state, jnp.int32(5), jnp.bool_(True), jnp.bool_(True))[0]
        return (after.poses.estimate - after.poses.true) * jnp.float32([0.1, 0.1, 1]), after.poses.covariance

    offs, stated = jax.jit(jax.vmap(off))(jax.random.split(jax.random.key(0), 10_000))
    want = np.asarray(stated).mean(axis=0)
    units = np.sqrt(np.outer(np.diag(want), np.diag(want)))
    np.testing.assert_allclose(np.cov(offs.T) / units, want / units, atol=0.08)  # floors are 0.03


def raycast_motion(motion):
    from jexplore.reach import HEADING, MOTIONS

    return MOTIONS[motion], HEADING[motion]


def test_a_wall_stops_the_robot_and_enters_its_map():
    """It is nearer to it than it takes itself to be."""
    _, given, state = begun("odometry")
    own = state.poses
    state = state.replace(poses=own.replace(true=own.true.at[0].set(2.8)))
    after, bumped = moving.turn_and_go(given, state, jnp.int32(4), jnp.bool_(True), jnp.bool_(True))
    assert bumped
    assert int(after.poses.bumps) == 1
    wall = np.asarray(given.scenes.occupied[0])
    assert not wall[int(after.poses.true[1]), int(after.poses.true[0])]
    gone = np.asarray(own.estimate - after.poses.estimate)[0]
    assert 0.5 < gone < 0.95  # 0.8 to the wall, in eighths
    assert float(after.poses.way_m) == pytest.approx(0.1 * gone, rel=1e-4)
    row, col = int(state.belief.row), int(state.belief.col) - 1
    state = after.replace(belief=after.belief.replace(driven=after.belief.driven.at[row, col].set(True)))
    marked = moving.mark_bump(state, row, col, bumped).belief
    hits, misses = int(marked.grid.hits[row, col]), int(marked.grid.misses[row, col])
    assert hits == misses > 0
    assert not marked.driven[row, col]
    same = moving.mark_bump(after, row, col, jnp.bool_(False)).belief
    np.testing.assert_array_equal(same.grid.hits, after.belief.grid.hits)


def test_a_robot_is_in_another_cell_only_when_it_is_clearly_there():
    extent = jnp.int32([20, 20])
    for x, col in ((5.5, 5), (6.2, 5), (6.3, 6), (4.7, 4), (30.0, 18), (-3.0, 1)):
        found = cell_of(jnp.float32([x, 7.5, 0]), jnp.int32(7), jnp.int32(5), extent)
        assert (int(found[0]), int(found[1])) == (7, col)


def test_headings_are_rounded_to_the_lattice():
    poses = begun("odometry")[2].poses.replace(true=jnp.float32([1, 1, 1.0]), estimate=jnp.float32([1, 1, -0.6]))
    heading, turned = rounded(jnp.int32(0), poses)
    assert heading == 7
    np.testing.assert_allclose([turned.true[2], turned.estimate[2]], [1 + EIGHTH, -0.6 + EIGHTH], rtol=1e-5)


# --- outcomes


def test_an_enclosed_robot_is_inconsistent_and_another_one_blocked():
    _, _, state = begun("odometry")
    ended = state.replace(outcome=jnp.int32(Outcome.COMPLETE))
    assert environment.outcome_of(ended) == Outcome.BLOCKED  # the other room is unseen
    seen = ended.poses.seen
    whole = ended.replace(poses=ended.poses.replace(seen=seen.replace(misses=seen.misses + 1)))
    assert environment.outcome_of(whole) == Outcome.COMPLETE
    belief = ended.belief
    rows, cols = np.indices(belief.driven.shape)
    around = np.maximum(abs(rows - int(belief.row)), abs(cols - int(belief.col))) == 2
    walled = belief.replace(grid=belief.grid.replace(hits=belief.grid.hits + 1000 * jnp.asarray(around, jnp.int32)))
    assert environment.outcome_of(ended.replace(belief=walled)) == Outcome.INCONSISTENT


@pytest.mark.jit
def test_a_robot_whose_scans_do_not_match_is_lost():
    """Nothing lies within its scanner's range."""
    setup, given, state = begun("icp", lidar=LIDAR.replace(range_m=0.4))
    look = jax.jit(looking.look, static_argnums=0)
    assert state.outcome == Outcome.RUNNING
    state = state.replace(plan_active=jnp.bool_(True))
    scans = int(state.scans)
    unsure = state.poses.replace(covariance=jnp.diag(jnp.float32([0.1, 0.1, 0.2])) ** 2)
    state = look(setup, given, state.replace(poses=unsure), jnp.bool_(True))
    assert state.outcome == Outcome.RUNNING
    assert int(state.scans) == scans + 1
    assert int(state.poses.unmatched) > 0
    unsure = state.poses.replace(covariance=jnp.diag(jnp.float32([0.1, 0.1, 0.3])) ** 2)
    lost = look(setup, given, state.replace(poses=unsure), jnp.bool_(True))
    assert lost.outcome == Outcome.LOST
    undefined = unsure.replace(covariance=jnp.full((3, 3), jnp.nan))
    assert look(setup, given, state.replace(poses=undefined), jnp.bool_(True)).outcome == Outcome.LOST
    assert not lost.plan_active
    assert look(setup, given, state.replace(poses=unsure), jnp.bool_(False)).outcome == Outcome.RUNNING


def test_no_cell_of_a_scan_counts_as_wall_and_free():
    """At an estimated place walls run through cells, and beams that graze them pass where others end."""
    setup, given, state = begun("odometry", lidar=Lidar(n_beams=181, range_m=3.0))
    there = state.poses.replace(estimate=state.poses.true + jnp.float32([0.3, 0.4, 0.0]))
    blank = state.replace(belief=state.belief.replace(grid=empty_grid(state.belief.driven.shape)), poses=there)
    grid = looking.look(setup, given, blank, jnp.bool_(True)).belief.grid
    assert not jnp.any((grid.hits > 0) & (grid.misses > 0))
    own, extent = given.numbers.unsure, state.belief.extent
    direction = beams_of(own, blank.heading, there.estimate)
    reading = beams.cast(jnp.asarray(two_rooms().occupied), there.true[:2], direction, own.reach)
    plain = beams.fold(blank.belief.grid, there.estimate[:2], direction, reading, own.reach, extent)
    assert jnp.any((plain.hits > 0) & (plain.misses > 0))
    np.testing.assert_array_equal(plain.hits, grid.hits)


def test_a_scan_is_the_same_wherever_the_map_lies_among_others():
    occupied = jnp.asarray(two_rooms().occupied)
    xy, direction = jnp.float32([12.3, 9.7]), jnp.float32(np.c_[np.cos(np.arange(40)), np.sin(np.arange(40))])
    alone = beams.cast(occupied, xy, direction, jnp.float32(20))
    far_up = beams.cast(jnp.concatenate([~occupied] * 9 + [occupied]), xy, direction, jnp.float32(20), 270)
    jax.tree.map(np.testing.assert_array_equal, far_up, alone)


def test_a_robot_that_was_stopped_is_not_taken_to_be_in_the_wall():
    _, given, state = begun("odometry")
    row, col = int(state.belief.row), int(state.belief.col)
    east = int(np.flatnonzero(two_rooms().occupied[row, col:])[0]) - 1  # cells until the wall
    near = state.poses.replace(true=state.poses.true + jnp.float32([east + 0.3, 0, 0]))
    moved, bumped = moving.turn_and_go(given, state.replace(poses=near), jnp.int32(0), jnp.bool_(True), jnp.bool_(True))
    assert bumped
    assert (int(moved.belief.row), int(moved.belief.col)) == (row, col)


# --- wrong options


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pose": "gps"}, r"unknown pose 'gps' \(there are: true, odometry, icp, icp\+closing\)"),
        ({"odometry": {"slip": 0.7}}, "odometry.slip must be a number at least 0 and at most 0.5, got 0.7"),
        ({"odometry": {"length_scale": 0}}, "odometry.length_scale must be a number above 0 and at most 2, got 0"),
        ({"odometry": {"lenght": 0.1}}, "unknown field of odometry: 'lenght'; did you mean 'length'?"),
        ({"odometry": 0.1}, "odometry must be a jx.Odometry"),
        ({"odometry": {"length": "0.1"}}, "odometry.length must be a number at least 0 and at most 0.5, got '0.1'"),
        ({"odometry": {"turn": [0.1]}}, "odometry.turn must be a number at least 0 and at most 0.5, got "),
        ({"odometry": {"slip": None}}, "odometry.slip must be a number at least 0 and at most 0.5, got None"),
        ({"odometry": {"length": 0.1}}, "pose must be odometry or icp, got true"),
        (
            {"pose": "icp", "lidar": {"forward_m": 0.1}},
            "lidar.forward_m and left_m must be 0 where the pose is not given",
        ),
        ({"pose": "icp", "metrics": {"ate_m": abs}}, "its name must be new, and 'ate_m' is in the tables already"),
    ],
)
def test_wrong_options_are_refused_in_a_line(given, message):
    refused(message, jx.compare, two_rooms(), ["closest"], episodes=1, **given)


# --- whole episodes


STRATEGY, N = "closest+recheck", 3
NOISE = {"length": 0.05, "length_scale": 1.05, "heading_deg_sqrt_m": 2.0}
TOLD = {"told": lambda view: view.poses.errors.error[0], "told_turn": lambda view: view.poses.errors.error[1]}
SHORT = {"n_beams": 91, "range_m": 3.0}  # one room is not seen from the other


@pytest.fixture(scope="module")
def by_pose(jit_on):
    with jit_on():
        return {
            name: jx.compare(two_rooms(), STRATEGY, episodes=N, pose=pose, odometry=noise, lidar=SHORT, metrics=metrics)
            for name, pose, noise, metrics in (
                ("true", "true", None, {}),
                ("exact", "odometry", EXACT, TOLD),
                ("odometry", "odometry", NOISE, TOLD),
                ("icp", "icp", NOISE, TOLD),
            )
        }


@pytest.mark.jit
def test_without_errors_an_episode_is_that_of_a_given_pose(by_pose):
    expected, found = by_pose["true"].episodes, by_pose["exact"].episodes
    assert set(found) - set(expected) == {
        "ate_m",
        "end_error_m",
        "end_error_deg",
        "free_iou",
        "bumps",
        "unmatched",
        "loops",
        "told",
        "told_turn",
    }
    for name in expected:
        if expected[name].dtype.kind == "f":  # lengths are sums of rounded steps
            np.testing.assert_allclose(found[name], expected[name], rtol=1e-5)
        else:
            assert list(found[name]) == list(expected[name]), name
    own, others = (by_pose[name].progress["two rooms", STRATEGY] for name in ("exact", "true"))
    np.testing.assert_allclose(own, others, rtol=1e-5)
    np.testing.assert_allclose(found[["ate_m", "end_error_m", "end_error_deg", "bumps"]], 0, atol=1e-5)
    assert (found["free_iou"] == 1).all()


@pytest.mark.jit
def test_matching_scans_makes_better_maps_than_odometry(by_pose):
    odometry, icp = by_pose["odometry"].episodes, by_pose["icp"].episodes
    assert (icp["outcome"] == "COMPLETE").all()
    assert (icp["free_iou"] > 0.95).all()
    assert (icp["ate_m"] < 0.05).all()
    for worse in ("ate_m", "end_error_m", "end_error_deg"):
        assert icp[worse].mean() < odometry[worse].mean() / 2
    assert odometry["free_iou"].mean() < icp["free_iou"].mean()
    assert (odometry["told"] == 0).all()
    assert ((icp["told"] > 0.1) & (icp["told"] < 1.1)).all()  # about a metre is driven; 1: as long as it is
    assert (icp["told_turn"] > 0).all()  # slip
    assert "ate_m" in by_pose["icp"].summary


@pytest.mark.jit
def test_an_episode_is_drawn_with_both_ways_and_not_replayed(by_pose, tmp_path):
    one = jx.explore(two_rooms(), STRATEGY, episode=1, pose="icp", odometry=NOISE, lidar=SHORT)
    assert one.measures["path_m"] == by_pose["icp"].episodes["path_m"][1]
    final = one.final
    assert final.poses.shape == (one.measures["steps"] + 1, 5)
    np.testing.assert_allclose(final.poses[0, :3], [0, final.cols[0] + 0.5, final.rows[0] + 0.5], atol=0.5)
    true, own = final.poses[:, 1:3].astype(float) * 0.1, final.poses[:, 3:].astype(float) * 0.1
    true, own = true - true.mean(0), own - own.mean(0)
    u, _, v = np.linalg.svd(true.T @ own)  # Kabsch
    ate_m = np.sqrt(((true - own @ (u @ np.diag([1, np.linalg.det(u @ v)]) @ v).T) ** 2).sum(1).mean())
    assert one.measures["ate_m"] == pytest.approx(ate_m, rel=1e-2)
    assert one.measures["path_m_at_95"] <= one.measures["path_m"]
    labels = [text.get_text() for text in one.figure().legends[0].get_texts()]
    assert "estimated path" in labels
    assert len(one.plot().lines) >= 3
    refused("no replay, its pose was not given", one.save_gif, tmp_path / "a.gif")


@pytest.mark.jit
@pytest.mark.slow
@pytest.mark.parametrize(
    ("pose", "noise", "outcome"),
    [("icp", {"turn": 0.5, "slip": 0.5}, "LOST"), ("odometry", {"turn_scale": 2.0}, "INCONSISTENT")],
)
def test_bad_odometry_ends_episodes(pose, noise, outcome):
    """Half of every turn is lost on average, more than a search allows for; walls are counted all round the robot."""
    found = jx.compare(two_rooms(), STRATEGY, episodes=24, pose=pose, odometry=noise, lidar=SHORT)
    ended = found.episodes[found.episodes["outcome"] == outcome]
    assert len(ended) > 0
    assert (ended["unmatched"] > 0).all() if pose == "icp" else (ended["explored_fraction"] < 1).all()


@pytest.mark.jit
def test_an_environment_tells_what_the_robot_believes(by_pose):
    env = jx.Environment(two_rooms(), pose="icp", odometry=NOISE, lidar=SHORT, recheck=True, paths=True)
    expected = by_pose["icp"].episodes.iloc[0]
    start = [expected[name] for name in ("start_row", "start_col", "start_heading_deg")]
    key = jax.random.fold_in(jax.random.key(0), 0)
    state, view = env.reset(key, np.int32(start))
    total, done = 0.0, False
    while not done:
        cost = np.where(view.frontier, view.cost, np.iinfo(np.int32).max)
        action = np.int32(np.unravel_index(cost.argmin(), cost.shape))
        state, view, reward, done, info = env.step(key, state, action)
        total -= float(reward)
    assert total == pytest.approx(expected["path_m"], rel=1e-4)
    assert jx.Outcome(int(info["outcome"])).name == expected["outcome"]
    for name in ("ate_m", "free_iou", "bumps"):
        assert float(info[name]) == pytest.approx(expected[name], rel=1e-5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: jx.bound(two_rooms(), rules={"pose": "icp"}), "bounds are of robots whose pose is given"),
        (lambda: jx.train("cave", rules={"pose": "icp"}), "training and tuning are of robots whose pose is given"),
        (lambda: jx.sweep({"worlds": ["cave"], "pose": "gps"}), "unknown pose 'gps'"),
        (lambda: jx.sweep({"worlds": ["cave"], "rules": {"pose": "icp"}}), "unknown field of rules 'pose'"),
    ],
)
def test_what_needs_a_given_pose_says_so(call, message):
    refused(message, call)


SCANNER = Lidar(n_beams=91, range_m=3.0)


# --- loops: what robots believe follows their key scans, and maps are mended


@functools.cache
def driven(pose):
    """A robot that has driven sixteen steps in a room, three ahead, three to the left and so on."""
    setup, given, state = begun(pose, Odometry(**NOISE), SCANNER)
    look, go = jax.jit(looking.look, static_argnums=0), jax.jit(moving.turn_and_go)
    for k in range(16):
        state, _ = go(given, state, jnp.int32(k // 3 * 2), jnp.bool_(True), jnp.bool_(True))
        state = look(setup, given, state, jnp.bool_(True))
    return given, state


@pytest.mark.jit
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


@pytest.mark.jit
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
