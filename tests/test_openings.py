"""Openings of places: rings of points by hand, every kind of divergence."""

import functools
import math

import jax
import numpy as np
import pytest
from ref.passages import FEATURES, WIDTHS_M, building, cast, wall

from jexplore.driving import vehicle
from jexplore.driving.records import Surround
from jexplore.driving.sensing import openings, surround
from jexplore.driving.settings import Tuning, for_world
from jexplore.driving.vehicle import ANGLES_RAD, SCAN_RANGE_M

pytestmark = pytest.mark.jit

TUNING = for_world(Tuning(), is_course=True)


K = 8
P = 1000
find_openings = jax.jit(openings.find_openings, static_argnames="size")


def padded(xy):
    """`P` points of which these are valid: one program for all."""
    xy = np.asarray(xy, np.float32).reshape(-1, 2)
    assert len(xy) <= P
    return np.pad(xy, ((0, P - len(xy)), (0, 0))), np.arange(P) < len(xy)


def openings_of(xy, centre=(0, 0), radius_m=1.0, width_m=TUNING.width_m, size=K, circle=1.5, seen_from=None):
    numbers = np.float32(centre), np.float32(radius_m), np.float32(width_m)
    seen_from = None if seen_from is None else np.float32(seen_from)
    found = find_openings(*padded(xy), *numbers, circle=circle, size=size, seen_from=seen_from)
    valid = np.asarray(found.valid)
    assert found.bearing.shape == found.width_m.shape == valid.shape == (size,)
    assert found.middle.shape == (size, 2)
    assert not valid[valid.sum() :].any()
    return found


def bearings_of(xy, *args, **more):
    """`(bearings in degrees, widths, overflow)` of the openings, in their order."""
    found = openings_of(xy, *args, **more)
    valid = np.asarray(found.valid)
    return np.degrees(found.bearing)[valid], np.asarray(found.width_m)[valid], int(found.overflow)


def rows_of(xy, *args, **more):
    """`(bearing in degrees, middle)` of every opening, its width."""
    found = openings_of(xy, *args, **more)
    valid = np.asarray(found.valid)
    rows = np.stack([np.degrees(found.bearing), *np.asarray(found.middle).T], axis=1)
    return rows[valid], np.asarray(found.width_m)[valid]


def wrapped_deg(angle):
    return (np.asarray(angle) + 180) % 360 - 180


def polar(degrees, distance=1.0):
    angle = np.radians(degrees)
    return np.stack([distance * np.cos(angle), distance * np.sin(angle)], -1)


def test_openings_of_a_ring_by_hand():
    """A ring of points 3 degrees apart, with gaps of 30 degrees to the east, 60 to the north and 6 to the west."""
    around = np.arange(1, 360, 3)
    away = np.abs(wrapped_deg(around[:, None] - np.array([0, 90, 180])))
    ring = polar(around[(away >= [15, 30, 3]).all(1)])
    bearings, widths, overflow = bearings_of(ring)
    np.testing.assert_allclose(bearings, [1.0, 89.5], atol=1.6)
    assert widths == pytest.approx([2 * math.sin(math.radians(15)), 1], abs=0.08)
    assert overflow == 0
    assert len(bearings_of(ring, width_m=0.9)[0]) == 1  # a wider robot fits through one only
    assert len(bearings_of(ring, width_m=1.2)[0]) == 0
    assert len(bearings_of(ring, width_m=0.08)[0]) == 3


def test_openings_in_order_and_the_circular_pair():
    corners = polar([-135, -45, 45, 135])
    bearings, widths, _ = bearings_of(corners)
    np.testing.assert_allclose(np.abs(bearings), [90, 0, 90, 180], atol=1e-3)
    assert bearings[0] < 0 < bearings[2]
    assert widths == pytest.approx([math.sqrt(2)] * 4, abs=1e-5)
    bearings, widths, overflow = bearings_of(corners, size=1)
    np.testing.assert_allclose(bearings, [-90], atol=1e-3)
    assert (len(widths), overflow) == (1, 3)


def test_of_one_direction_the_nearest_point_counts():
    corners = np.concatenate([polar([-135, -45, 45, 135]), polar([-45, 45, 0, 90], 1.1)])
    np.testing.assert_allclose(bearings_of(corners, circle=1.05)[1], [math.sqrt(2)] * 4, atol=1e-5)
    east = np.hypot(1.1 - math.sqrt(0.5), math.sqrt(0.5))
    widths = bearings_of(corners)[1]
    np.testing.assert_allclose(widths, [math.sqrt(2), east, east, east, east, math.sqrt(2)], atol=1e-5)


def test_where_a_gap_is_more_than_half_a_turn_it_lies_on_the_other_side():
    bearings, _, _ = bearings_of(polar([-60, -30, 0, 30, 60]), width_m=0.6)
    np.testing.assert_allclose(np.abs(bearings), [180], atol=1e-3)
    bearings, _, _ = bearings_of(polar(np.arange(30, 151, 10)))
    np.testing.assert_allclose(bearings, [-90], atol=1e-3)


def test_without_points_there_is_no_opening():
    assert len(bearings_of(np.zeros((0, 2)))[0]) == 0
    assert len(bearings_of(polar([0, 120, 240], 3.0))[0]) == 0  # all beyond the circle
    assert len(bearings_of(polar([0, 120, 240], 3.0), radius_m=3.001)[0]) == 3
    for few in ([30], [30, 30.1]):  # round one point alone everything is open
        assert len(bearings_of(polar(few))[0]) == 1


def test_openings_turn_and_move_with_the_points():
    rng = np.random.default_rng(4)
    around = np.concatenate([np.arange(a, b, 2.0) for a, b in ((-170, -100), (-60, -10), (30, 60), (100, 150))])
    ring = polar(around, 1 + 0.02 * rng.normal(size=len(around)))
    bearings, widths, _ = bearings_of(ring)
    assert len(bearings) == 4
    for degrees in (7.3, 90, -123.4):
        turn = np.radians(degrees)
        moved = ring @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + [5, -3]
        after, after_widths, _ = bearings_of(moved, centre=(5, -3))
        order = np.argsort(wrapped_deg(bearings + degrees))
        np.testing.assert_allclose(wrapped_deg(after - (bearings + degrees)[order]), 0, atol=0.5)
        np.testing.assert_allclose(after_widths, widths[order], atol=0.02)


def test_the_narrowest_place_of_an_opening_and_the_direction_square_to_it():
    """A passage 2 m wide to both sides: the walls of the gap lie 0.6 to 1.12 m ahead of the centre."""
    for lean_deg in (0, 20, -20):
        xy = np.concatenate([wall((-3, 3), (1, 1)), wall((-3, 3), (-1, -1))])
        turn = math.radians(lean_deg)
        found, widths = rows_of(xy @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]))
        np.testing.assert_allclose(wrapped_deg(2 * (found[:, :1] - lean_deg)), 0, atol=1.5)  # either way
        away = np.hypot(*found[:, 1:].T)
        assert ((away > 0.6) & (away < 1.12)).all()
        np.testing.assert_allclose(wrapped_deg(np.degrees(np.arctan2(*found[:, :0:-1].T)) - found[:, 0]), 0, atol=1.5)
        np.testing.assert_allclose(widths, 2, atol=0.01)


@functools.partial(jax.jit, static_argnames="far_m")
def look_round(walls_, poses, noise_m, far_m=4.0):
    """Return points round a robot at the last of some poses, in the world: `(points, valid)`."""

    def looked(carry, at):
        around, before = carry
        pose, noise_m = at
        ahead, aside = vehicle.to_robot(before)(pose[:2])
        around = surround.move_surround(around, ahead, aside, pose[2] - before[2], far_m=far_m)
        around = surround.add_scan(around, cast(walls_, pose, ANGLES_RAD, SCAN_RANGE_M) + noise_m)
        return (around, pose), 0

    (around, pose), _ = jax.lax.scan(looked, (Surround(), poses[0]), (poses, noise_m))
    xy, known = surround.known_points(around)
    return vehicle.to_odometry(pose)(xy), known


def on_the_way(arms, width_m, where):
    """Return the points known to a robot that came from the west and turned, relative to the axes' crossing."""
    walls_, middle = building(arms, width_m)
    x, y = middle + np.array(where) * width_m
    poses = [(x - back, y, 0.0) for back in np.linspace(2.2, 0, 23)]
    poses += [(x, y, turn) for turn in np.linspace(0, math.pi, 22)[1:]]
    xy, known = look_round(walls_, np.array(poses, np.float32), np.zeros((len(poses), len(ANGLES_RAD)), np.float32))
    return np.asarray(xy)[np.asarray(known)] - middle


@pytest.mark.parametrize("name", FEATURES)
@pytest.mark.parametrize("width_m", WIDTHS_M)
def test_every_divergence_has_its_openings(name, width_m):
    arms, where, radius, want = FEATURES[name]
    xy = on_the_way(arms, width_m, where)
    centre, circle_m = np.array(where) * width_m, radius * width_m
    bearings, widths, overflow = bearings_of(xy, centre, circle_m)
    assert len(bearings) == len(want)
    off = np.abs(wrapped_deg(bearings[:, None] - np.degrees(want)))
    assert off.min(axis=0).max() < 13
    np.testing.assert_allclose(widths, width_m, rtol=0.15)
    assert overflow == 0
    assert len(bearings_of(xy, centre, circle_m, 0.8 * width_m)[0]) == len(want)
    assert len(bearings_of(xy, centre, circle_m, 1.25 * width_m)[0]) == 0  # too wide a robot


def test_what_is_seen_from_the_side_is_a_wall():
    """A square room with a gap of a metre in one wall: from the wall's own line it is hardly to be seen."""
    side = np.linspace(-1, 1, 41)
    rest = side[(side < 0) | (side > 0.9)]
    walls = [(x, -1) for x in side] + [(-1, y) for y in side] + [(1, y) for y in side] + [(x, 1) for x in rest]
    for seen_from, n in ((None, 1), ((0.0, 0.0), 1), ((-0.95, 0.98), 0)):
        assert openings_of(walls, seen_from=seen_from).valid.sum() == n
    for seen_from in (None, (-0.5, 0.0)):  # the only wall leaves its way out: the gap ends where it begins
        assert openings_of([(1.0, 0.0)], seen_from=seen_from).valid.sum() == 1
