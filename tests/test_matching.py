"""Motion between two scans: rooms of line segments with exact ranges, then noise and missing beams."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.passages import cast

from jexplore.driving.building.walls import UNUSED_SLOT_M
from jexplore.driving.records import Walls
from jexplore.driving.sensing import matching
from jexplore.driving.vehicle import ANGLES_RAD, BEAMS, SCAN_RANGE_M
from jexplore.slam2d.scans import fit_lines

pytestmark = pytest.mark.jit

NAN, INF = math.nan, math.inf
SEEDS = 30
match = jax.jit(matching.match_scans)
match_all = jax.jit(
    jax.vmap(lambda before, after, guess: matching.match_scans(before, after, guess, guess)[0], in_axes=(0, 0, None))
)


def box(x0, y0, x1, y1):
    x, y = [[x0, y0, y1], [x1, y0, y1]], [[y0, x0, x1], [y1, x0, x1]]
    return Walls(x=jnp.array(x, jnp.float32), y=jnp.array(y, jnp.float32))


ROOM = box(-2, -1.5, 3, 1.5)
CORRIDOR = box(-UNUSED_SLOT_M, -1, UNUSED_SLOT_M, 1)
POSES = [(0.0, 0.0, 0.3), (0.5, 0.4, -1.9), (1.0, -0.5, math.pi)]
MOTIONS = [(0.0, 0.0, 0.25), (0.2, 0.0, 0.0), (0.15, 0.02, -0.25)]


SEEN = jax.jit(lambda walls, pose: cast(walls, pose, ANGLES_RAD, SCAN_RANGE_M))


def scans(walls, pose, motion):
    """Exact ranges before and after a motion in the robot's frame."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    ahead, aside, turn = motion
    after = pose[0] + cos * ahead - sin * aside, pose[1] + sin * ahead + cos * aside, pose[2] + turn
    return [np.array(SEEN(walls, jnp.asarray(at, jnp.float32))) for at in (pose, after)]


def matched(before, after, guess):
    return np.asarray(match(*(jnp.asarray(a, jnp.float32) for a in (before, after, guess, guess)))[0], float)


def off(found, motion):
    """`(metres, degrees)`."""
    error = found - motion
    return math.hypot(*error[:2]), abs(math.degrees(error[2]))


@pytest.mark.parametrize(("within", "there"), [(2.5, True), (1.5, False)])
def test_a_line_is_laid_through_five_points_within_reach(within, there):
    apart = float(ANGLES_RAD[1] - ANGLES_RAD[0])
    ranges = jnp.full(BEAMS, matching.MATCH.line_reach_m / within / apart)  # a wall around the scanner
    assert fit_lines(matching.MATCH, *matching._ends(ranges))[2][BEAMS // 2] == there


@pytest.mark.parametrize(("pose", "motion"), [*zip(POSES, MOTIONS)])
def test_in_a_room_a_wrong_guess_is_put_right(pose, motion):
    before, after = scans(ROOM, pose, motion)
    slip = 0.1 * motion[2]
    for error in ((0, 0, 0), (0, 0, slip), (0.05, 0, 0), (0, -0.05, 0), (-0.035, 0.035, slip), (0.035, 0.035, -slip)):
        metres, degrees = off(matched(before, after, np.add(motion, error)), motion)
        assert metres < 0.01, error
        assert degrees < 0.3, error


@pytest.mark.parametrize(("slip", "is_found"), [(0.4, True), (0.7, False)])
def test_a_turn_may_slip_by_two_fifths(slip, is_found):
    told = np.array([0.0, 0.0, 0.25])
    true = told * (1 - slip)
    found = matched(*scans(ROOM, POSES[0], tuple(true)), told)
    np.testing.assert_allclose(found, true if is_found else told, atol=0.01)


def test_what_comes_out_depends_on_what_is_seen_and_not_on_where():
    """The room and the robot in it, a quarter turn on and elsewhere."""
    one = matched(*scans(box(-2, -1.5, 3, 1.5), (0.5, 0.4, 0.2), (0.1, 0, 0.2)), (0.12, 0.02, 0.22))
    x, y = 10, -4
    turned = scans(box(x - 1.5, y - 2, x + 1.5, y + 3), (x - 0.4, y + 0.5, 0.2 + math.pi / 2), (0.1, 0, 0.2))
    np.testing.assert_allclose(matched(*turned, (0.12, 0.02, 0.22)), one, atol=1e-4)


@pytest.mark.parametrize("error", [(0.05, 0.05, 0.025), (0.05, -0.03, -0.03)])
@pytest.mark.parametrize("pose", [(3.0, 0.2, 0.1), (0.0, -0.3, math.pi - 0.2)])
def test_along_an_endless_passage_the_encoders_are_believed(pose, error):
    motion = 0.2, 0.02, 0.25
    found = matched(*scans(CORRIDOR, pose, motion), np.add(motion, error)) - motion
    # Errors along the passage and across it.
    along, across = ((v[0] + 1j * v[1]) * np.exp(1j * pose[2]) for v in (error, found))
    (wrong, _), (still, left) = ((z.real, z.imag) for z in (along, across))
    assert still == pytest.approx(wrong, abs=1e-3)
    assert abs(left) < 0.005
    assert abs(math.degrees(found[2])) < 0.2


@pytest.mark.parametrize(("sigma_m", "mean_m", "mean_deg"), [(0.01, 0.002, 0.1), (0.03, 0.005, 0.25)])
@pytest.mark.parametrize("pose", POSES[:1])
def test_with_noise_there_is_no_bias(sigma_m, mean_m, mean_deg, pose):
    """Over 30 seeds. A single match is off by less than a beam, and by less than half a degree for a centimetre."""
    motion = MOTIONS[2]
    noise = sigma_m * np.random.default_rng(5).normal(size=(2, SEEDS, BEAMS))
    before, after = np.array(scans(ROOM, pose, motion))[:, None] + noise
    guess = jnp.asarray(np.add(motion, (0, 0, 0.02)), jnp.float32)
    error = np.asarray(match_all(jnp.asarray(before, jnp.float32), jnp.asarray(after, jnp.float32), guess)) - motion
    assert np.abs(error[:, :2].mean(axis=0)).max() < mean_m
    assert abs(math.degrees(error[:, 2].mean())) < mean_deg
    assert np.abs(error[:, :2]).max() < sigma_m
    assert math.degrees(np.abs(error[:, 2]).max()) < 100 * sigma_m / 2


@pytest.mark.parametrize("nothing", [NAN, INF])
def test_without_points_the_encoders_are_believed(nothing):
    before, after = scans(ROOM, POSES[0], MOTIONS[2])
    none = np.full(BEAMS, nothing)
    guess = np.array([0.17, -0.02, 0.3], np.float32)
    for pair in ((none, after), (before, none), (none, none)):
        np.testing.assert_array_equal(matched(*pair, guess), guess.astype(float))


def test_walls_and_encoders_are_weighed_by_their_variances():
    """One straight wall ahead, met by some beams near the middle: least squares by hand."""
    before = np.full(BEAMS, NAN)
    beams = np.arange(BEAMS // 2 - 20, BEAMS // 2 + 21)
    before[beams] = 2 / np.cos(ANGLES_RAD[beams])
    guess = 0.04  # of more the match would be none
    doubt = matching.MATCH.way_m + matching.MATCH.way_share * guess
    # The points are symmetric about the axis: those ahead do not mix with the turn.
    walls = len(beams) / matching.MATCH.noise_m**2
    want = guess * doubt**-2 / (doubt**-2 + walls)
    found = matched(before, before, (guess, 0, 0))
    assert found[0] == pytest.approx(want, rel=0.1)
    assert np.abs(found[1:]).max() < 1e-3


LEVEL = jnp.zeros(2)
PUT_RIGHT = jax.jit(matching.correct_odometry)


def driven(walls, poses, odometry, key=None):
    """`(key, odometry)` after some poses, of which the encoders say others."""
    key = matching.no_key(jnp.asarray(odometry[0], jnp.float32)) if key is None else key
    now = jnp.asarray(odometry[0], jnp.float32)
    keys = []
    for i, pose in enumerate(poses):
        if i:
            now = now + jnp.asarray(np.subtract(odometry[i], odometry[i - 1]), jnp.float32)
        key, now, _ = PUT_RIGHT(key, now, now, SEEN(walls, jnp.asarray(pose, jnp.float32)), LEVEL)
        keys.append(np.asarray(key.pose).tolist())
    return keys, np.asarray(now)


def test_one_scan_serves_while_most_of_it_is_seen():
    along = [(0.21 * i - 1.5, 0.0, 0.0) for i in range(13)]
    keys, _ = driven(ROOM, along, along)
    assert {tuple(key) for key in keys} == {along[0]}
    turned = [(0.0, 0.0, 0.26 * i) for i in range(13)]  # of 180 degrees 60 % are left after 1.26 rad
    keys, _ = driven(ROOM, turned, turned)
    assert sorted({round(key[2], 1) for key in keys}) == pytest.approx([0, 1.3, 2.6], abs=0.05)


def test_encoders_that_measure_too_much_are_put_right_on_the_way():
    """By 10 % of the way and of every turn."""
    poses = [(0.2 * i - 1.5, 0.1, 0.1 * i) for i in range(13)]
    said = [(1.1 * (x + 1.5) - 1.5, y, 1.1 * turn) for x, y, turn in poses]
    _, found = driven(ROOM, poses, said)
    assert np.hypot(*np.subtract(found[:2], poses[-1][:2])) < 0.03
    assert abs(math.degrees(found[2] - poses[-1][2])) < 1
    assert np.hypot(*np.subtract(said[-1][:2], poses[-1][:2])) > 0.2


def test_a_match_far_from_what_the_encoders_say_is_none():
    """Ten degrees off after no turn at all: the walls are others."""
    before, after = scans(ROOM, POSES[0], (0.0, 0.0, math.radians(10)))
    guess = jnp.asarray([0.2, 0, 0], jnp.float32)
    found, share = match(jnp.asarray(before, jnp.float32), jnp.asarray(after, jnp.float32), guess, guess)
    assert found.tolist() == guess.tolist()
    assert float(share) == 0


def test_scans_of_two_planes_are_not_matched():
    """The robot leans by 10 degrees more: what it sees is not laid over what it saw."""
    key = matching.no_key(jnp.zeros(3))
    seen = [SEEN(ROOM, jnp.array([x, 0.0, 0.0])) for x in (-1.5, -1.3)]
    key, now, _ = PUT_RIGHT(key, jnp.zeros(3), jnp.zeros(3), seen[0], LEVEL)
    said = now + jnp.array([0.22, 0, 0])  # 2 cm too much
    for lean_deg, found_m in ((0.0, 0.2), (5.0, 0.2), (10.0, 0.22)):
        lean = jnp.asarray([math.radians(lean_deg), 0.0])
        fresh, after, _ = PUT_RIGHT(key, said, said, seen[1], lean)
        assert float(after[0]) == pytest.approx(found_m, abs=5e-3)
        assert (fresh.lean.tolist() == lean.tolist()) == (lean_deg in (0.0, 10.0))
