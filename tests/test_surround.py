"""Points around the robot: pencil places, parity with plain numpy, and that a memory does not drift."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.passages import cast

from jexplore.driving.params.tree import P
from jexplore.driving.records import Surround, Walls
from jexplore.driving.sensing import surround
from jexplore.driving.sensing.surround import DIRECTIONS, SECTORS
from jexplore.driving.settings import ROBOTS
from jexplore.driving.vehicle import ANGLES_RAD, BEAMS, SCAN_RANGE_M

pytestmark = pytest.mark.jit
KAMUI = ROBOTS["kamui"]
ADD_SCAN, MOVE, EDGE = (jax.jit(f) for f in (surround.add_scan, surround.move_surround, surround.voronoi_edge))
FREE_TURN = jax.jit(lambda around: surround.free_turn(around, KAMUI))
FREE_LENGTHS = jax.jit(lambda around: surround.free_lengths(around, KAMUI))
NAN, INF = math.nan, math.inf
SEEDS = range(4)
STEP = math.pi / surround.TURN_STEPS
ROOM = 1.8, 1.3, -1.2, -1.7  # its walls at x, y, x and y, the robot's middle at 0


def of(*xy):
    """A `Surround` of some points `(x, y)`, each in its direction."""
    out = np.full((2, SECTORS), INF)
    for x, y in xy:
        out[:, round(math.degrees(math.atan2(y, x)) + 180) % SECTORS] = x, y
    return Surround(*jnp.asarray(out, jnp.float32))


def known_of(around):
    """The points that are known: `[N, 2]` float64."""
    xy, known = surround.known_points(around)
    return np.asarray(xy, float)[np.asarray(known)]


def at(around, degrees):
    """The point in a direction."""
    return float(around.x_m[degrees + 180]), float(around.y_m[degrees + 180])


def drawn(rng, low_m, high_m, share=0.7):
    """Points in some of the sectors, off their borders: `[N, 2]` float64."""
    angle = np.radians(np.arange(-180, 180) + rng.uniform(-0.4, 0.4, SECTORS))[rng.random(SECTORS) < share]
    return (rng.uniform(low_m, high_m, len(angle)) * np.stack([np.cos(angle), np.sin(angle)])).T


def scan(**degrees):
    """A scan without any reading but for these: `left_90=2.0` for the beam at 90 degrees."""
    out = np.full(BEAMS, NAN, np.float32)
    for name, range_m in degrees.items():
        side, angle = name.split("_")
        out[90 + int(angle) * (1 if side == "left" else -1)] = range_m
    return jnp.asarray(out)


def room_scan(heading):
    right, up, left, down = ROOM
    x, y = [[right, down, up], [left, down, up]], [[up, left, right], [down, left, right]]
    return cast(Walls(x=jnp.array(x), y=jnp.array(y)), (0.0, 0.0, heading), ANGLES_RAD, SCAN_RANGE_M)


def test_nothing_is_known_at_first():
    around = Surround()
    xy, known = surround.known_points(around)
    assert not known.any()
    np.testing.assert_array_equal(xy, np.zeros((SECTORS, 2)))
    assert [float(v) for v in EDGE(around)] == [0, 0]
    assert [float(v) for v in FREE_TURN(around)] == pytest.approx([math.pi] * 2)
    assert np.isinf(FREE_LENGTHS(around)).all()
    assert not surround.known_points(MOVE(around, 1.0, 2.0, 3.0))[1].any()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_motion_is_rigid(seed):
    rng = np.random.default_rng(seed)
    xy = drawn(rng, 0.2, 6.0)
    ahead, aside, turn = rng.uniform(-1, 1, 3) * (0.5, 0.5, math.pi)
    z = (xy @ (1, 1j) - (ahead + 1j * aside)) * np.exp(-1j * turn)
    z = z[np.abs(z) < 4.0]
    found = known_of(MOVE(of(*xy), ahead, aside, turn, far_m=4.0)) @ (1, 1j)
    assert len(found) == len(z) < len(xy)
    np.testing.assert_allclose(found, z, atol=1e-5)


def test_of_two_points_in_one_direction_the_nearer_is_kept():
    both = Surround(*jnp.full((2, SECTORS), INF).at[:, 10].set([-2, -0.004]).at[:, 20].set([-1, 0.002]))
    np.testing.assert_allclose(known_of(ADD_SCAN(both, jnp.full(BEAMS, NAN))), [[-1, 0.002]], atol=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_seen_is_what_a_loop_over_all_directions_finds(seed):
    rng = np.random.default_rng(seed)
    xy = drawn(rng, 0.3, 4.4)
    ranges = rng.uniform(0.3, 6, BEAMS).astype(np.float32)
    ranges[rng.random(BEAMS) < 0.2] = NAN
    ranges[rng.random(BEAMS) < 0.2] = INF
    want = np.full((SECTORS, 2), INF)
    degrees = np.round(np.degrees(np.arctan2(xy[:, 1], xy[:, 0]))).astype(int)
    for sector, angle in enumerate(range(-180, 180)):
        (old,) = np.nonzero(degrees % 360 == angle % 360)
        if len(old):
            want[sector] = xy[old[0]]
        range_m = ranges[angle + 90] if abs(angle) <= 90 else NAN
        if not np.isnan(range_m):
            way = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
            want[sector] = way * range_m if np.isfinite(range_m) else INF
    # The points of memory lie in any order: where in the arrays they are does not count.
    order = rng.permutation(SECTORS)
    before = Surround(*(jnp.asarray(a)[order] for a in (of(*xy).x_m, of(*xy).y_m)))
    after = ADD_SCAN(before, jnp.asarray(ranges))
    np.testing.assert_allclose(np.stack([after.x_m, after.y_m], axis=1), want, atol=1e-5)


@pytest.mark.parametrize("goes_on_seeing", [True, False])
def test_a_full_turn_in_place_keeps_every_point_at_its_place(goes_on_seeing):
    """Points are not moved to the middles of their directions: with every step of 8.6 degrees that would add up."""
    around = ADD_SCAN(Surround(), room_scan(0.0))
    around = MOVE(around, 0.0, 0.0, math.pi)
    around = ADD_SCAN(around, room_scan(math.pi))
    steps = 42
    for i in range(1, steps + 1):
        around = MOVE(around, 0.0, 0.0, 2 * math.pi / steps)
        heading = math.pi + i * 2 * math.pi / steps
        around = ADD_SCAN(around, room_scan(heading) if goes_on_seeing else jnp.full(BEAMS, NAN))
    xy = known_of(around)
    right, up, left, down = ROOM
    x, y = -xy.T  # the robot looks west, as before
    off = np.minimum(np.minimum(right - x, x - left), np.minimum(up - y, y - down))
    assert len(xy) > 0.95 * SECTORS  # of two in one direction one is forgotten
    assert np.abs(off).max() < 0.02


def beside(left_m, right_m, turn=0.0):
    """Return a passage along x with walls at these distances; the robot is turned to the left in it."""
    x = np.arange(-3, 3, 0.02)
    walls = [(x, np.full_like(x, left_m)), (x, np.full_like(x, -right_m))]
    z = np.concatenate([x + 1j * y for x, y in walls]) * np.exp(-1j * turn)
    return of(*sorted(zip(z.real, z.imag), key=lambda xy: -math.hypot(*xy)))  # the nearest last: it stays


@pytest.mark.parametrize(("left_m", "right_m", "degrees"), [(1, 1, 0), (1, 1, -50), (0.6, 1.4, 20), (1.2, 0.5, -20)])
def test_the_edge_of_a_passage_is_its_middle(left_m, right_m, degrees):
    along, off = EDGE(beside(left_m, right_m, math.radians(degrees)))
    assert math.degrees(float(along)) == pytest.approx(-degrees, abs=2)  # points lie 2 cm apart
    assert float(off) == pytest.approx((right_m - left_m) / 2, abs=1e-3)


def test_the_edge_is_square_to_the_difference_of_both_directions():
    along, off = EDGE(of((1, 1), (-3, -3 * math.sqrt(3))))  # at 45 and at -120 degrees
    assert math.degrees(float(along)) == pytest.approx(-37.5)
    assert float(off) == pytest.approx((6 - math.sqrt(2)) / 2)
    one, other = (r * np.array([math.cos(a), math.sin(a)]) for r, a in ((1, math.radians(175)), (2, math.radians(10))))
    along, off = EDGE(of(one, other))  # the edge leads ahead
    assert (math.degrees(float(along)), float(off)) == pytest.approx((-87.5, -0.5), abs=1e-3)
    for one in ((1, 1), (1, -1)):  # without points on both sides no edge exists
        assert [float(v) for v in EDGE(of(one))] == [0, 0]


def meets(xy, turn, length_m, width_m):
    """Return whether a rectangle, turned, has a point inside."""
    z = xy @ (1, 1j) * np.exp(-1j * turn)
    return bool(np.any((np.abs(z.real) < length_m / 2) & (np.abs(z.imag) < width_m / 2)))


def free_until(xy, sign, step, margin_m):
    """Compute the turn of a rectangle with a margin, in steps, before it has a point inside, radians."""
    turns = np.arange(1, round(math.pi / step) + 1)
    met = (n for n in turns if meets(xy, sign * n * step, KAMUI.length_m + 2 * margin_m, KAMUI.width_m + 2 * margin_m))
    return (next(met, turns[-1] + 1) - 1) * step


@pytest.mark.parametrize("seed", SEEDS)
def test_free_turns_are_those_of_a_rectangle_that_is_turned(seed):
    rng = np.random.default_rng(seed)
    xy = drawn(rng, 0.25, 0.6, share=rng.choice([0.004, 0.01, 0.03]))
    xy = xy[~((np.abs(xy[:, 0]) < KAMUI.length_m / 2) & (np.abs(xy[:, 1]) < KAMUI.width_m / 2))]
    found = [float(v) for v in FREE_TURN(of(*xy))]
    want = [free_until(xy, sign, STEP, P.sensing.outline_margin_m) for sign in (1, -1)]
    np.testing.assert_allclose(found, want, atol=1e-5)
    # In fine steps, without the margin: as far as it says, nothing is touched.
    for angle, sign in zip(found, (1, -1)):
        assert angle <= free_until(xy, sign, math.radians(0.25), 0.0) + 1e-5


@pytest.mark.parametrize("seed", SEEDS)
def test_ways_are_free_strips(seed):
    rng = np.random.default_rng(seed)
    xy = drawn(rng, 0.4, 4.4, share=rng.choice([0.02, 0.1, 0.5]))
    found = np.asarray(FREE_LENGTHS(of(*xy)))
    assert found.shape == (DIRECTIONS,)
    half = KAMUI.width_m / 2 + P.sensing.outline_margin_m
    for way_m, direction in zip(found, np.arange(DIRECTIONS) * math.radians(5) - math.pi):
        z = xy @ (1, 1j) * np.exp(-1j * direction)
        if np.min(np.abs(np.abs(z.imag) - half)) < 1e-4 or np.min(np.abs(z.real)) < 1e-4:
            continue  # a matter of rounding
        before = z.real[(z.real > 0) & (np.abs(z.imag) < half)]
        assert way_m == pytest.approx(min(before, default=INF) - KAMUI.length_m / 2, abs=1e-5)
