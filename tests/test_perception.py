"""Perception of a scan: pencil scans, maps drawn by hand for every kind of divergence, height profiles."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.passages import EAST, FEATURES, WIDTHS_M, building, cast

from jexplore.arrays.delaunay import circumcircles, delaunay
from jexplore.driving import vehicle
from jexplore.driving.building import terrain
from jexplore.driving.sensing import ground_profile, obstacles, perception
from jexplore.driving.sensing.ground_profile import RISE_M
from jexplore.driving.settings import ROBOTS, Tuning, for_world
from jexplore.driving.vehicle import ANGLES_RAD, BEAMS, SCAN_RANGE_M

pytestmark = pytest.mark.jit

TUNING = for_world(Tuning(), is_course=True)
KAMUI = ROBOTS["kamui"]
TEN = math.radians(10)


points = jax.jit(perception.beam_points)
smoothed = jax.jit(perception.smooth_points)
sides = jax.jit(perception.sides)
front = jax.jit(perception.front)
clearances = jax.jit(perception.clearances)
resampled = jax.jit(perception.resample_walls, static_argnames="size")


def scan_of(lines, angles=ANGLES_RAD, range_m=SCAN_RANGE_M):
    """Ranges, float64, to the nearest of some segments `(x0, y0, x1, y1)` in the robot's frame."""
    ranges = np.full(len(angles), np.inf)
    for x0, y0, x1, y1 in lines:
        d, way = np.stack([np.cos(angles), np.sin(angles)]).astype(float), np.array([x1 - x0, y1 - y0])
        cross = d[0] * way[1] - d[1] * way[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            r = (x0 * way[1] - y0 * way[0]) / cross
            share = (x0 * d[1] - y0 * d[0]) / cross
        ranges = np.where((r > 0) & (share >= 0) & (share <= 1), np.minimum(ranges, r), ranges)
    return np.where(ranges < range_m, ranges, np.inf).astype(np.float32)


def points_of(lines, noise_m=0):
    return points(scan_of(lines) + np.float32(noise_m), ANGLES_RAD)


def test_points_by_hand():
    ranges = np.array([2, 1, np.inf, np.nan, 3, 4], np.float32)
    angles = np.radians([-90, 0, 0, 45, 90, 30]).astype(np.float32)
    xy, valid = points(ranges, angles)
    np.testing.assert_array_equal(valid, [True, True, False, False, True, True])
    np.testing.assert_allclose(xy, [[0, -2], [1, 0], [0, 0], [0, 0], [0, 3], [2 * math.sqrt(3), 2]], atol=1e-6)
    assert xy.dtype == jnp.float32


def test_a_few_beams_that_fail_are_bridged():
    ranges = np.full(BEAMS, 2.0, np.float32)
    ranges[100:] = 2.1
    for missed, n in (((50,), 0), ((50, 51, 52), 0), ((50, 51, 52, 53), 4), ((99, 100), 0), ((0, 1), 2), ((180,), 1)):
        some = ranges.copy()
        some[list(missed)] = np.nan
        xy, valid = points(some, ANGLES_RAD)
        assert BEAMS - int(np.sum(valid)) == n, missed
        distance = np.hypot(*np.asarray(xy).T)[np.asarray(valid)]
        assert distance.min() > 1.99
        assert distance.max() < 2.11
    for jump, gap, n in ((2.19, np.nan, 0), (2.1, np.inf, 1)):  # one wall, nothing there
        ranges[100:] = jump
        some = ranges.copy()
        some[99] = gap
        for scan in (some, some[::-1]):
            assert BEAMS - int(np.sum(points(scan, ANGLES_RAD)[1])) == n


def test_no_reading_at_all():
    for value in (np.inf, np.nan):
        xy, valid = points(np.full(BEAMS, value, np.float32), ANGLES_RAD)
        assert not np.asarray(valid).any()
        assert not np.asarray(xy).any()
        assert [float(v) for v in sides(xy, valid, 0, 5)] == [math.inf, math.inf]
        assert [float(v) for v in front(xy, valid, 0.39)] == [math.inf, math.inf]
        np.testing.assert_array_equal(smoothed(xy, valid, 0.1), xy)


DOTS = np.array([[0.5, 1.0], [1.0, 2.0], [1.5, 0.8], [0.5, -0.6], [1.0, -0.4], [2.0, -0.1], [-0.5, 0.2]], np.float32)
ALL = np.ones(len(DOTS), bool)


@pytest.mark.parametrize(
    ("from_m", "to_m", "left", "right"),
    [
        (0, 1.2, 1.0, 0.4),
        (0, 2.5, 0.8, 0.1),
        (0.6, 1.2, 2.0, 0.4),
        (1.0, 1.0, 2.0, 0.4),  # both ends belong to it
        (1.6, 2.5, math.inf, 0.1),
        (-1, 0, 0.2, math.inf),
    ],
)
def test_sides_by_hand(from_m, to_m, left, right):
    found = [float(v) for v in sides(DOTS, ALL, from_m, to_m)]
    assert found == pytest.approx([left, right])


def test_sides_leave_out_what_is_no_point_and_mirror():
    assert [float(v) for v in sides(DOTS, DOTS[:, 1] != 1, 0, 1.2)] == pytest.approx([2.0, 0.4])
    mirrored = DOTS * np.array([1, -1], np.float32)
    assert [float(v) for v in sides(mirrored, ALL, 0, 1.2)] == pytest.approx([0.4, 1.0])
    ahead = np.array([[1, 0]], np.float32)  # straight ahead: on both sides
    assert [float(v) for v in sides(ahead, ALL[:1], 0, 2)] == [0, 0]


def test_clearances_are_means_of_neighbours_and_a_post_counts():
    walls_ = (-9, 0.8, 9, 0.8), (-9, -1.2, 9, -1.2)
    noise_m = np.random.default_rng(3).normal(scale=0.03, size=(50, BEAMS)).astype(np.float32)
    ours = jax.jit(jax.vmap(lambda ranges: jnp.stack(clearances(*points(ranges, ANGLES_RAD), 0.35))))(
        scan_of(walls_) + noise_m
    )
    assert np.abs(ours.mean(axis=0) - np.array([0.8, 1.2])).max() < 0.03  # noise makes them hardly smaller
    xy, valid = points_of([*walls_, (0.2, 0.5, 0.3, 0.5)])
    assert [float(v) for v in clearances(xy, valid, 0.35)] == pytest.approx([0.5, 1.2], abs=1e-5)
    assert [float(v) for v in clearances(xy, valid & (xy[:, 1] > 0), 0.35)] == [pytest.approx(0.5), math.inf]


def test_front_is_as_wide_as_the_robot():
    dots = np.array([[3, 0], [2, 0.2], [1.5, -0.24], [1.0, 0.26], [-0.5, 0.0], [0.0, 0.0]], np.float32)
    there = np.ones(6, bool)
    assert [float(v) for v in front(dots, there, 0.5)] == [2.0, 1.5]
    assert [float(v) for v in front(dots, there, 0.54)] == [1.0, 1.5]
    assert [float(v) for v in front(dots, there, 0.42)] == [2.0, 3.0]
    assert [float(v) for v in front(dots, there, 0.3)] == [3.0, 3.0]
    assert [float(v) for v in front(dots, dots[:, 0] <= 0, 0.5)] == [math.inf, math.inf]


def test_smoothing_takes_the_mean_of_what_is_near():
    xy = np.array([[1, 0.0], [1, 0.05], [1.06, 0.1], [2, 0.1], [1, 0.15]], np.float32)
    valid = np.array([True, True, True, True, False])
    even = smoothed(xy, valid, 0.1)
    want = [[1, 0.025], [1.02, 0.05], [1.03, 0.075], [2, 0.1], [1, 0.15]]
    np.testing.assert_allclose(even, want, atol=1e-6)


def sampled(xy, valid, near_m=0.3, far_m=4.0, aside_m=2.5, spacing_m=0.2, size=perception.SCAN_POINTS):
    """`(along the walls, ends, spacing, overflow)`."""
    chosen, there, spacing, overflow = resampled(xy, valid, near_m, far_m, aside_m, spacing_m, size=size)
    assert chosen.shape == (size, 2)
    chosen, there, n = np.asarray(chosen), np.asarray(there), size - size // 4
    return chosen[:n][there[:n]], chosen[n:][there[n:]], float(spacing), int(overflow)


def test_points_follow_a_bend():
    xy = np.array([[1, 0], [2, 0], [2, 1], [1, 1]], np.float32)
    ticks, ends, spacing, _ = sampled(xy, np.ones(4, bool), spacing_m=0.5, size=16)
    assert spacing == 0.5
    want = [[1.25, 0], [1.75, 0], [2, 0.25], [2, 0.75], [1.75, 1], [1.25, 1]]
    np.testing.assert_allclose(ticks, want, atol=1e-6)
    np.testing.assert_array_equal(ends, xy[[0, 3]])


def test_a_jump_of_the_range_ends_a_wall_and_nothing_lies_in_between():
    xy, valid = points_of([(1.0, -3, 1.0, 0.01), (3.0, -9, 3.0, 9)])
    ticks, ends, _, _ = sampled(xy, valid, aside_m=2.0)
    assert len(ends) == 4
    np.testing.assert_allclose(np.sort(ends[:, 0]), [1, 1, 3, 3], atol=1e-5)
    assert (np.isclose(ticks[:, 0], 1, atol=1e-4) | np.isclose(ticks[:, 0], 3, atol=1e-4)).all()
    assert {1, 3} == set(np.round(ticks[:, 0]).astype(int).tolist())


def test_where_the_points_do_not_fit_the_spacing_grows():
    size = 8
    xy, valid = points_of([(-9, 1, 9, 1), (-9, -1, 9, -1)])
    ticks, ends, spacing, overflow = sampled(xy, valid, spacing_m=0.15, size=size)
    n_ticks = size - size // 4
    inside = np.asarray(xy)[(np.asarray(xy)[:, 0] > 0.3) & (np.asarray(xy)[:, 0] < 4)]
    total = 2 * (inside[:, 0].max() - inside[:, 0].min())
    assert spacing == pytest.approx(max(0.15, total / n_ticks), rel=1e-4)
    assert len(ticks) == pytest.approx(total / spacing, abs=1)
    right = ticks[ticks[:, 1] < 0]
    np.testing.assert_allclose(np.diff(right[:, 0]), spacing, atol=1e-4)
    assert len(ends) == min(4, size // 4)
    assert overflow == 4 - len(ends)


def test_far_bound_by_hand():
    assert float(perception.far_bound(4.0, 0.39, math.pi / 180, 0.2)) == pytest.approx(2.0076, abs=1e-3)
    assert float(perception.far_bound(4.0, 0.39, math.pi / 180, 1.0)) == 4.0
    assert float(perception.far_bound(4.0, 0.39, math.pi / 180, math.inf)) == 4.0
    assert float(perception.far_bound(4.0, 0.39, math.pi / 180, 0.0)) == 0.0


@jax.jit
def look_from(walls_, pose, tuning, noise_m):
    """`(divergence, centres in the world)`."""
    ranges = cast(walls_, pose, ANGLES_RAD, SCAN_RANGE_M) + noise_m
    xy, valid = points(ranges, ANGLES_RAD)
    beside = jnp.stack(sides(xy, valid, 0, KAMUI.length_m / 2)).min()
    found = perception.find_divergences(xy, valid, beside, tuning)
    return found, vehicle.to_odometry(pose)(found.centre)


QUIET = np.zeros(BEAMS, np.float32)


def seen_from(place, x, y, heading=EAST, tuning=TUNING, noise_m=QUIET):
    """Centres, relative to the crossing of the axes, and radii."""
    walls_, middle = place
    pose = np.array([middle[0] + x, middle[1] + y, heading], np.float32)
    found, centre = look_from(walls_, pose, tuning, noise_m)
    valid = np.asarray(found.valid)
    assert int(found.overflow) == 0
    return np.asarray(centre)[valid] - middle, np.asarray(found.radius)[valid]


@pytest.mark.parametrize("width_m", WIDTHS_M)
def test_a_straight_passage_shows_nothing(width_m):
    place = building("we", width_m)
    for x, y, heading in itertools.product((-3, -0.7), (-0.25, 0.1), (-0.15, 0, 0.1)):
        centres, *_ = seen_from(place, x, y * width_m, heading)
        assert len(centres) == 0


@pytest.mark.parametrize("name", FEATURES)
@pytest.mark.parametrize("width_m", WIDTHS_M)
def test_the_circle_lies_where_three_walls_are_equally_far(name, width_m):
    """Within 4 cm and 2 % of the width: corners are rounded by as much as points are smoothed and beams are apart."""
    arms, where, radius, _ = FEATURES[name]
    place = building(arms, width_m)
    for further, y, heading in itertools.product((0.5, 0.8, 1.0), (-0.1, 0.1), (-0.1, 0, 0.1)):
        back = width_m / 2 + further
        centres, radii = seen_from(place, -back, y * width_m, heading)
        assert len(centres) >= 1, (back, y, heading)
        np.testing.assert_allclose(
            centres, np.tile(np.array(where) * width_m, (len(centres), 1)), atol=0.04 + 0.02 * width_m
        )
        np.testing.assert_allclose(radii, radius * width_m, atol=0.04 + 0.02 * width_m)


def one_wall_by_angles(xy, valid, centre, corner, recess_m):
    """Return whether a circle touches one wall twice, a triangle at a time, by angles in double precision."""
    xy = xy.astype(float)
    angle = np.arctan2(*(xy - centre)[:, ::-1].T)
    corner = sorted(corner, key=lambda k: angle[k])
    for one, other in zip(corner, np.roll(corner, -1)):
        chord = xy[other] - xy[one]
        within = (angle - angle[one]) % (2 * np.pi) < (angle[other] - angle[one]) % (2 * np.pi)
        within &= valid & ~np.isin(np.arange(len(xy)), corner)
        if np.all((xy - xy[one])[within] @ [chord[1], -chord[0]] <= recess_m * np.hypot(*chord)):
            return True
    return False


def test_circles_that_touch_one_wall_twice_are_those_of_an_oracle_by_angles():
    rng = np.random.default_rng(6)

    @jax.jit
    def judged(xy, valid):
        triangles = delaunay(xy, valid)
        centre, _, _ = circumcircles(xy, triangles.corner)
        found = perception._on_one_wall(xy, valid, centre, triangles.corner, jnp.float32(0.1))
        return triangles, centre, found

    counts = np.zeros(2, int)
    for _ in range(12):
        ends = rng.uniform(-4, 4, (12, 2, 2))
        walls_ = [a + (b - a) * np.linspace(0, 1, max(2, int(np.hypot(*(b - a)) / 0.19)))[:, None] for a, b in ends]
        xy = np.concatenate(walls_)[:64].astype(np.float32)
        xy += rng.normal(scale=0.01, size=xy.shape).astype(np.float32)
        valid = rng.random(len(xy)) < 0.9
        triangles, centre, found = jax.tree.map(np.asarray, judged(xy, valid))
        for t in np.flatnonzero(triangles.valid):
            expected = one_wall_by_angles(xy, valid, centre[t], triangles.corner[t], 0.1)
            assert found[t] == expected
            counts[int(expected)] += 1
    assert counts.min() > 60


def test_every_triangle_keeps_to_its_bounds():
    rng = np.random.default_rng(3)
    walls_, middle = building("wesn", 2.0)
    n_kept = 0
    for _ in range(15):
        pose = np.array([*(middle + rng.uniform([-3, -0.4], [-1, 0.4])), rng.uniform(-0.4, 0.4)], np.float32)
        noise_m = rng.normal(scale=0.03, size=BEAMS).astype(np.float32)
        found, *_ = look_from(walls_, pose, TUNING, noise_m)
        assert found.corners.shape == (2 * perception.SCAN_POINTS, 3, 2)
        corners = np.asarray(found.corners)[np.asarray(found.valid)].astype(float)
        for triangle, centre, radius in zip(
            corners, *(np.asarray(a)[found.valid] for a in (found.centre, found.radius))
        ):
            np.testing.assert_allclose(np.hypot(*(triangle - centre).T), radius, rtol=1e-3)
            edges = [triangle[i - 2] - triangle[i - 1] for i in range(3)]
            assert min(np.hypot(*e) for e in edges) > TUNING.width_m - 1e-6
            angles = [math.degrees(math.acos(-a @ b / np.hypot(*a) / np.hypot(*b)))
                      for a, b in itertools.pairwise([*edges, edges[0]])]  # fmt: skip
            assert sum(angles) == pytest.approx(180, abs=0.01)
            assert max(angles) < 100.01
            assert radius < TUNING.open_m
            assert (np.hypot(*triangle.T) < TUNING.far_m).all()
            n_kept += 1
    assert n_kept > 8


GROUND_CELL_M = 0.05


def ground_of(heights):
    """Ground whose height depends on x alone."""
    rows = np.tile(np.asarray(heights, np.float32), (60, 1))
    return terrain.terrain_of(np.pad(rows, ((0, 0), (0, 130 - rows.shape[1])), mode="edge"), GROUND_CELL_M)


def slope_of(angle_rad):
    """Level up to x = 1.525 m, then 2 m up."""
    return np.concatenate([np.zeros(30), np.arange(41) * GROUND_CELL_M * math.tan(angle_rad)])


@jax.jit
def ahead_of(ground, x, heading, half_width_m):
    """The point that a robot measures, the true height above its own there, and its own."""
    pitch, roll, height, _ = terrain.attitude(ground, (x, 1.5, heading), KAMUI.length_m, KAMUI.width_m)
    down = vehicle.down_directions(KAMUI)
    mount = jnp.array([[KAMUI.scanner_x_m, 0.0, KAMUI.scanner_height_m]])
    direction, at = (terrain.turned(v, pitch, roll, heading) for v in (down, mount))
    ranges = terrain.look_at(ground, (x + at[0, 0], 1.5 + at[0, 1], height + at[0, 2]), direction)
    place = KAMUI.scanner_x_m, KAMUI.scanner_height_m
    seen_x, seen_z, found = ground_profile.ground_point(ranges, down, pitch, roll, place, half_width_m)
    there = terrain.height_at(ground, x + seen_x * jnp.cos(heading), 1.5 + seen_x * jnp.sin(heading))
    return seen_x, seen_z, found, there - height, height


def measured(ground, x, heading=0.0):
    seen_x, seen_z, found, want, _ = ahead_of(ground, *(np.float32(v) for v in (x, heading, KAMUI.width_m / 2)))
    assert bool(found)
    return float(seen_x), float(seen_z), float(want)


def test_level_ground_is_seen_at_the_height_of_the_scanner_ahead():
    x, z, _ = measured(ground_of(np.zeros(130)), 2.0)
    assert x == pytest.approx(KAMUI.scanner_x_m + KAMUI.scanner_height_m, abs=1e-3)  # at 45 degrees
    assert z == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("heading", [0.0, math.pi])
@pytest.mark.parametrize("angle", [TEN, -TEN])
def test_before_and_behind_a_bend_of_the_ground_its_true_height_is_seen(angle, heading):
    ground = ground_of(slope_of(angle))
    for x in np.linspace(0.6, 4.4, 9) if heading == 0 else np.linspace(1.8, 4.6, 9):
        _, z, want = measured(ground, x, heading)
        assert z == pytest.approx(want, abs=4e-3)


def test_ground_points_by_hand():
    direction = np.array([[1, 0, 0], [0, 0, -1], [0.6, 0.8, 0], [0.6, -0.8, 0]], np.float32)
    ranges = np.array([2, 1, 1, 1], np.float32)
    mount = 0.5, 1.5

    def seen(ranges, pitch=0.0, roll=0.0, half=5.0):
        x, z, found = ground_profile.ground_point(np.asarray(ranges, np.float32), direction, pitch, roll, mount, half)
        return (float(x), float(z)) if bool(found) else None

    nothing = [np.inf, np.nan, np.inf, np.nan]
    assert seen(nothing) is None
    assert seen([np.nan, 1, np.inf, np.nan]) == pytest.approx((0.5, 0.5))
    assert seen([2, np.inf, np.inf, np.nan]) == pytest.approx((2.5, 1.5))
    assert seen(ranges) == pytest.approx((np.mean([2.5, 0.5, 1.1, 1.1]), 1.25))
    assert seen(ranges, half=0.79) == pytest.approx((1.5, 1.0))  # without those aside
    assert seen([np.inf, np.inf, 1, 1], half=0.79) is None
    cos, sin = math.cos(0.3), math.sin(0.3)
    nose_down = seen([2, np.inf, np.inf, np.inf], pitch=0.3)
    assert nose_down == pytest.approx((2.5 * cos + 1.5 * sin, 1.5 * cos - 2.5 * sin))
    left_up = seen([np.inf, np.inf, 1, np.inf], roll=0.3)
    assert left_up == pytest.approx((1.1, 1.5 * cos + 0.8 * sin), abs=1e-6)


SLOTS_OF_PROFILE = 400
fit = jax.jit(ground_profile.profile)


def profile_of(x, z):
    """Fits, with slots to spare that hold what must not matter."""
    n = len(x)
    padded = np.full((2, SLOTS_OF_PROFILE), 7.5, np.float32)
    padded[0, n:] = np.inf  # as the engine leaves them
    padded[:, :n] = x, z
    found = fit(padded[0], padded[1], np.arange(SLOTS_OF_PROFILE) < n)
    assert int(found.count) == n
    return found


def by_polyfit(x, z):
    """`(residual variance, slope)`."""
    coefficients, residual, *_ = np.polyfit(x, z, 1, full=True)
    return residual[0] / (len(x) - 2), coefficients[0]


def staircase(x, tread_m, riser_m):
    return riser_m * np.floor(np.asarray(x) / tread_m)


WAY = np.arange(0.013, 3.0, 0.04)  # a point every step of 0.1 s at 0.4 m/s


@pytest.mark.parametrize("riser_m", [0.03, 0.1, 0.2])
@pytest.mark.parametrize("sign", [1, -1])
def test_stairs_leave_a_twelfth_of_the_riser_squared(riser_m, sign):
    found = profile_of(WAY, staircase(WAY, 0.3, sign * riser_m))
    assert float(found.variance_m2) == pytest.approx(riser_m**2 / 12, rel=0.1)
    assert float(found.slope) == pytest.approx(sign * riser_m / 0.3, rel=0.05)
    assert float(found.step_m) == pytest.approx(riser_m, abs=0.01)
    beyond_slope_m = riser_m * (1 - RISE_M / 0.3)
    assert float(found.highest_m) == pytest.approx(beyond_slope_m, abs=0.01)
    assert float(found.tread_wave_m2) == pytest.approx(riser_m**2 / (2 * math.pi**2), rel=0.15)  # of a sawtooth
    assert obstacles.is_stairs(found, TUNING)


def test_variance_and_slope_are_those_of_polyfit():
    rng = np.random.default_rng(6)
    for _ in range(20):
        n = int(rng.integers(4, 200))
        x = rng.uniform(0, 40) + np.cumsum(rng.uniform(0.01, 0.06, n))
        z = rng.normal() + rng.normal() * x + rng.normal(scale=rng.choice([0.003, 0.03, 0.3]), size=n)
        variance, slope = by_polyfit(x, z)
        found = profile_of(x, z)
        assert float(found.variance_m2) == pytest.approx(variance, rel=2e-2, abs=1e-7)
        assert float(found.slope) == pytest.approx(slope, abs=2e-3 * max(1, abs(slope)))


def test_the_order_of_the_points_does_not_matter():
    rng = np.random.default_rng(7)
    z = staircase(WAY, 0.28, 0.12) + rng.normal(scale=0.01, size=len(WAY))
    order = rng.permutation(len(WAY))
    one, other = profile_of(WAY, z), profile_of(WAY[order], z[order])
    assert float(one.variance_m2) == pytest.approx(float(other.variance_m2), rel=1e-3)
    assert float(one.slope) == pytest.approx(float(other.slope), rel=1e-3)
    assert float(one.step_m) == pytest.approx(float(other.step_m), abs=0.005)  # points at edges of the way's cells


@pytest.mark.parametrize("tread_m", [0.22, 0.25, 0.3, 0.31, 0.4])
def test_a_riser_is_told_through_noise(tread_m):
    rng = np.random.default_rng(0)
    for riser_m in (-0.06, 0.1, 0.2):
        z = staircase(WAY, tread_m, riser_m)
        assert float(profile_of(WAY, z).riser_m) == pytest.approx(abs(riser_m), rel=0.04)
        noisy = [profile_of(WAY, z + rng.normal(scale=0.01, size=len(WAY))).riser_m for _ in range(20)]
        np.testing.assert_allclose(noisy, abs(riser_m), atol=0.01)
    assert float(profile_of(WAY, 0 * WAY).riser_m) == 0


@pytest.mark.parametrize("edge", [0.5, 1.51, 2.03])
def test_one_step_in_level_ground(edge):
    found = profile_of(WAY, np.where(edge < WAY, 0.12, 0))
    assert float(found.step_m) == pytest.approx(0.12, abs=1e-4)
    assert float(profile_of(WAY, np.where(edge < WAY, -0.12, 0)).step_m) == pytest.approx(0.12, abs=1e-4)


@pytest.mark.parametrize("riser_m", [0.08, 0.15])
def test_stairs_as_the_robot_measures_them(riser_m):
    """Driven over, with the attitude: what stands at BTM's two obstacle nodes is stairs with this riser."""
    steps = np.repeat(np.arange(8), round(0.3 / GROUND_CELL_M)) * riser_m
    ground, way = ground_of(np.concatenate([np.zeros(20), steps])), np.arange(0.6, 2.6, 0.04, np.float32)
    seen = jax.vmap(ahead_of, (None, 0, None, None))(ground, way, np.float32(0), np.float32(KAMUI.width_m / 2))
    x, z = way + np.asarray(seen[0]), np.asarray(seen[1]) + seen[4]
    found = profile_of(x[x > 1.3], z[x > 1.3])
    assert obstacles.is_stairs(found, TUNING)
    assert float(found.step_m) == pytest.approx(riser_m, abs=0.015)
    assert float(found.slope) == pytest.approx(riser_m / 0.3, rel=0.15)
