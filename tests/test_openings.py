"""Openings and ways out of places: rings of points by hand, every kind of divergence, rooms with corners and doors."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref.passages import FEATURES, WIDTHS_M, building, wall

from jexplore.driving import vehicle
from jexplore.driving.building import walls
from jexplore.driving.sensing import exits, openings, surround
from jexplore.driving.settings import Tuning, for_world
from jexplore.driving.vehicle import ANGLES_RAD, SCAN_RANGE_M
from jexplore.worlds import load_world

pytestmark = pytest.mark.jit

TUNING = for_world(Tuning(), is_course=True)


K = 8
P = 1000
find_openings = jax.jit(openings.find_openings, static_argnames="size")
find_exits = jax.jit(exits.find_exits, static_argnames="size")


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
    assert found.bearing.shape == found.across.shape == found.width_m.shape == valid.shape == (size,)
    assert found.middle.shape == (size, 2)
    assert not valid[valid.sum() :].any()
    return found


def bearings_of(xy, *args, **more):
    """`(bearings in degrees, widths, overflow)` of the openings, in their order."""
    found = openings_of(xy, *args, **more)
    valid = np.asarray(found.valid)
    return np.degrees(found.bearing)[valid], np.asarray(found.width_m)[valid], int(found.overflow)


def rows_of(xy, *args, **more):
    """`(bearing and direction of the passage in degrees, middle)` of every opening, its width."""
    found = openings_of(xy, *args, **more)
    valid = np.asarray(found.valid)
    rows = np.stack([np.degrees(found.bearing), np.degrees(found.across), *np.asarray(found.middle).T], axis=1)
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
        np.testing.assert_allclose(wrapped_deg(2 * (found[:, :2] - lean_deg)), 0, atol=1.5)  # either way
        away = np.hypot(*found[:, 2:].T)
        assert ((away > 0.6) & (away < 1.12)).all()
        np.testing.assert_allclose(wrapped_deg(np.degrees(np.arctan2(*found[:, :1:-1].T)) - found[:, 1]), 0, atol=1.5)
        np.testing.assert_allclose(widths, 2, atol=0.01)


def room(length_m, *doors, side=()):
    """Return a room 3 m wide, from 1.5 m east of the middle to `length_m` west; doors 0.5 m wide there and north."""
    north, west = [(-length_m, 1.5)], [(-1.5, 1.5)]

    def cut(parts, at):
        pieces = [piece for low, high in parts for piece in ((low, min(high, at - 0.25)), (max(low, at + 0.25), high))]
        return [(low, high) for low, high in pieces if high > low]

    for at in doors:
        west = cut(west, at)
    for at in side:
        north = cut(north, at)
    parts = [wall((1.5, 1.5), (-1.5, 1.5)), wall((-length_m, 1.5), (-1.5, -1.5))]
    parts += [wall(part, (1.5, 1.5)) for part in north] + [wall((-length_m, -length_m), part) for part in west]
    return np.concatenate(parts)


@pytest.mark.parametrize(("length_m", "n"), [(2.0, 0), (3.0, 0), (5.0, 1)])
def test_the_rest_of_a_room_is_no_opening_where_it_is_a_corner(length_m, n):
    """A circle of 1.5 m touches three of its walls; the search circle leaves a gap of 3 m at 1.68 m to the west.

    The gap counts if the wall beyond is farther behind it than 0.65 of that, 3.63 m from the centre, and if there is no
    other, as the one of 1.1 m to the east.
    """
    xy = room(length_m)
    door = xy[(xy[:, 0] < 1.4) | (np.abs(xy[:, 1]) > 0.5)]
    found, widths = rows_of(door, radius_m=1.5)
    assert len(found) == 1 + n
    np.testing.assert_allclose(sorted(widths), [1.1, 3][: 1 + n], atol=0.02)
    found, widths = rows_of(xy, radius_m=1.5)
    assert np.abs(found[:, 0]) == pytest.approx([180], abs=0.1)
    np.testing.assert_allclose(widths, [3], atol=0.01)


@pytest.mark.parametrize("length_m", [2.0, 3.0])
def test_the_door_of_a_pocket_counts_instead_of_the_gap_before_it(length_m):
    found, widths = rows_of(room(length_m, 0.0), radius_m=1.5)
    assert len(found) == 1
    assert np.abs(found[0, :2]) == pytest.approx([180, 180], abs=1)
    assert found[0, 2:] == pytest.approx([-length_m, 0], abs=0.05)
    assert widths == pytest.approx([0.5], abs=0.1)
    behind = wall((-length_m - 2, -length_m - 2), (-0.36, 0.36))  # the part of a wall that is seen through it
    assert len(rows_of(np.concatenate([room(length_m, 0.0), behind]), radius_m=1.5)[0]) == 1


def test_a_door_bears_as_its_passage_does_if_it_is_seen_nearly_so():
    """Within 30 degrees, and unless another opening bears nearly alike; else as it is seen from the centre."""
    found, _ = rows_of(room(3.0, 0.8), radius_m=1.5)  # seen at 165 degrees
    assert np.abs(found[:, :2]) == pytest.approx(np.full((1, 2), 180), abs=1.5)
    found, _ = rows_of(room(3.0, side=(-2.4,)), radius_m=1.5)  # in the wall to the north, seen at 148 degrees
    assert found == pytest.approx(np.array([[148, 90, -2.4, 1.5]]), abs=1.5)
    found, _ = rows_of(room(3.0, -0.9, 0.9), radius_m=1.5)  # two in one wall
    assert found[:, 0] == pytest.approx([-163, 163], abs=1.5)
    assert np.abs(found[:, 1]) == pytest.approx([180, 180], abs=1.5)


@functools.partial(jax.jit, static_argnames="far_m")
def look_round(walls_, poses, noise_m, far_m=4.0):
    """Return points round a robot at the last of some poses, in the world: `(points, valid)`."""

    def looked(carry, at):
        around, before = carry
        pose, noise_m = at
        ahead, aside = vehicle.to_robot(before)(pose[:2])
        around = surround.move_surround(around, ahead, aside, pose[2] - before[2], far_m=far_m)
        around = surround.add_scan(around, walls.cast(walls_, pose, ANGLES_RAD, SCAN_RANGE_M) + noise_m)
        return (around, pose), 0

    (around, pose), _ = jax.lax.scan(looked, (surround.empty_surround(), poses[0]), (poses, noise_m))
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
    # Of 2.4 m a passage is known 1.8 widths far and may pass for a pocket, whose door is seen askew.
    assert off.min(axis=0).max() < (12 if width_m < 2.4 else 16)
    np.testing.assert_allclose(widths, width_m, rtol=0.15)
    assert overflow == 0
    assert len(bearings_of(xy, centre, circle_m, 0.8 * width_m)[0]) == len(want)
    assert len(bearings_of(xy, centre, circle_m, 1.25 * width_m)[0]) == 0  # too wide a robot


def seen_from(occupied, centre, cell_m=0.1):
    """Return the ends of beams a degree apart round a place: `[360, 2]`."""
    made = jax.tree.map(np.asarray, walls.walls_of(occupied, cell_m))
    angles = np.radians(np.arange(360)).astype(np.float32)
    ranges = np.asarray(walls.cast(made, (*np.float32(centre), np.float32(0)), angles, 20.0))
    return np.asarray(centre) + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], 1)


def passage(*doors):
    """A passage of 2.4 m along x, from 4 to 6.4 m, with doors of 1 m in its walls: (where they begin, upper or not)."""
    occupied = np.ones((104, 240), bool)
    occupied[40:64, 2:-2] = False
    occupied[2:38, 2:-2] = occupied[66:-2, 2:-2] = False  # one long room on either side
    for begins, upper in doors:
        occupied[slice(64, 66) if upper else slice(38, 40), begins : begins + 10] = False
    return occupied


def exits_of(xy, centre=(0, 0), radius_m=1.1, size=K):
    """Middles of the ways out of a place, `[n, 2]`, in their order, and how many are too many."""
    numbers = np.float32(centre), np.float32(radius_m), np.float32(TUNING.width_m)
    found = find_exits(*padded(xy), *numbers, circle=1.5, size=size)
    return np.asarray(found.middle)[np.asarray(found.valid)] + centre, int(found.overflow)


@pytest.mark.slow
@pytest.mark.parametrize("askew", [0, 8, -11])
def test_doors_that_face_each_other_askew_belong_to_one_place(askew):
    centre = (12.0, 5.2)
    middles, _ = exits_of(seen_from(passage((115, False), (115 + askew, True)), centre), centre, 1.2)
    assert len(middles) == 4
    for door in ((12.0, 4.0), (12.0 + askew / 10, 6.4)):
        assert np.min(np.hypot(*(middles - door).T)) < 0.25
    towards = np.arctan2(*(middles - centre).T[::-1])  # in the order of their bearings, and none twice
    assert (np.diff(towards) > 0.3).all()
    # One whose middle lies outside the circle is not of the place.
    assert len(exits_of(seen_from(passage((115, False), (133, True)), centre), centre, 1.2)[0]) == 3


# Walls of a passage along x, of which a search circle has 1.65 m, the wider one 2.48 m.


def lower(*x):
    return wall(x, (-1.1, -1.1))


def upper(*x):
    return wall(x, (1.1, 1.1))


def end(x):
    return wall((x, x), (-1.1, 1.1))


PARTED = {
    # To the west the passage and a gap in its upper wall, closed by its end, are one gap, whose door is the one in that
    # wall. The passage counts instead; the door to the east does besides, though both lead north.
    "a gap and a passage": (
        [lower(-3.7, 5), upper(-1.4, 0.6), upper(1.7, 5), end(-3.7)],
        [(-1.02, 0), (0.74, 0), (1.15, 1.1)],
    ),
    # To the east are two, one in either wall. The wide one gives way to the passage, that of 1.2 m stays.
    "a gap and a door": (
        [lower(-4, 2.5), upper(-4, 1.6), end(3.7)],
        [(3.1, -1.1), (1.05, 0), (-0.88, 0)],
    ),
    # There is no passage beyond the gap to the east; what the wider circle has besides lies elsewhere: it stays.
    "a gap and a door elsewhere": (
        [lower(-4, -1.7), lower(-0.5, 1.7), upper(-1.5, 3.1), end(3.1)],
        [(-1.1, -1.1), (2.4, -1.1), (-0.73, 0)],
    ),
    # From one end of a wall to the other, round the south: its middle lies on the wall, behind the centre.
    "more than half a turn": ([upper(-3, 2), end(2), wall((1, 2), (-2, -2))], [(0, 1.1)]),
}


@pytest.mark.parametrize("name", PARTED)
def test_a_gap_that_leads_aside_is_parted_where_the_wider_circle_has_a_passage(name):
    parts, want = PARTED[name]
    middles, overflow = exits_of(np.concatenate(parts))
    assert middles.shape == (len(want), 2)
    np.testing.assert_allclose(middles, want, atol=0.06)
    assert overflow == 0


def four_doors(behind):
    """A room of 6 m with a door in the middle of every wall, and walls of such extent 1.4 m behind them."""
    sides = []
    for turns, extent in enumerate(behind):
        side = [wall((-3, -0.45), (3, 3)), wall((0.45, 3), (3, 3)), wall(extent, (4.4, 4.4))]
        for _ in range(turns):
            side = [xy[:, ::-1] * (1, -1) for xy in side]
        sides += side
    return sides


def test_what_a_place_has_too_many_of_is_counted():
    """Four ways out, of which the search circle has three, or, of a wide room, one; and three, of which it has two."""
    askew = [lower(-5, -0.5), lower(0.5, 5), upper(-5, 0.6), upper(1.6, 5)]
    some = PARTED["a gap and a door"][0]
    for parts, radius_m, n in ((askew, 1.1, 4), (four_doors([(-3, 3)] * 4), 3.0, 4), (some, 1.1, 3)):
        middles, overflow = exits_of(np.concatenate(parts), radius_m=radius_m, size=1)
        assert (len(middles), overflow) == (1, n - 1)


def test_a_room_and_its_mirror_image_have_equally_many_too_many():
    """In one sense of rotation five doors are found, in the other four."""
    parts = four_doors([(-3, 3), (-0.9, 0.4), (-3, -0.2), (-3, 3)])
    one, other = (exits_of(np.concatenate(parts) * (sign, 1), radius_m=3.0, size=1)[1] for sign in (1, -1))
    assert one == other == 4


def test_what_is_seen_from_the_side_is_a_wall():
    """A square room with a gap of a metre in one wall: from the wall's own line it is hardly to be seen."""
    side = np.linspace(-1, 1, 41)
    rest = side[(side < 0) | (side > 0.9)]
    walls = [(x, -1) for x in side] + [(-1, y) for y in side] + [(1, y) for y in side] + [(x, 1) for x in rest]
    for seen_from, n in ((None, 1), ((0.0, 0.0), 1), ((-0.95, 0.98), 0)):
        assert openings_of(walls, seen_from=seen_from).valid.sum() == n
    for seen_from in (None, (-0.5, 0.0)):  # the only wall leaves its way out: the gap ends where it begins
        assert openings_of([(1.0, 0.0)], seen_from=seen_from).valid.sum() == 1


def drawn_room(rng):
    """A room of 4 to 9.6 m in a grid of decimetres, with doors 0.8 to 1.2 m wide to passages or corridors: the grid,
    the middles of the doors, metres, from that of the room, and where that is.
    """
    w = int(rng.integers(40, 97))
    h, wall = int(np.clip(w * rng.uniform(0.77, 1.3), 40, 96)), int(rng.integers(1, 5))
    middles, doors = [], []
    for side in rng.choice(4, size=rng.integers(1, 5), replace=False):
        length, depth = (w, h) if side % 2 == 0 else (h, w)
        door = int(rng.integers(8, 13))
        at, is_corridor = int(rng.integers(3, length - door - 3)), bool(rng.integers(2))
        doors.append((side, slice(at, at + door), is_corridor))
        along, out = (at + door / 2 - length / 2) / 10, depth / 20
        middles.append([(along, -out), (out, along), (along, out), (-out, along)][side])
    occupied = np.ones((220, 220), bool)
    occupied[60 : 60 + h, 60 : 60 + w] = False
    for side, at, is_corridor in doors:
        length, depth = (w, h) if side % 2 == 0 else (h, w)
        view = occupied if side % 2 == 0 else occupied.T
        door = slice(60 + at.start, 60 + at.stop)
        beyond = slice(40, 80 + length) if is_corridor else door
        far = 60 + depth if side in (1, 2) else 60
        step = 1 if side in (1, 2) else -1
        for rows, cols in ((range(wall), door), (range(wall, wall + (20 if is_corridor else 35)), beyond)):
            for k in rows:
                view[far + step * k - (step < 0), cols] = False
    return occupied, np.array(middles), np.array([60 + w / 2, 60 + h / 2]) / 10


def counted(rng, n):
    """Count the rooms, of n, with exactly their doors, and missed doors, at 1 cm of range noise."""
    right, missed = 0, 0
    for _ in range(n):
        occupied, doors, middle = drawn_room(rng)
        turn, noise_m = rng.uniform(-math.pi, math.pi), rng.normal(scale=0.01, size=(2, len(ANGLES_RAD)))
        poses = np.array([(*middle, turn), (*middle, turn + math.pi)], np.float32)
        room_walls = jax.tree.map(jnp.asarray, walls.walls_of(occupied, 0.1))
        xy, known = look_round(room_walls, poses, noise_m.astype(np.float32), far_m=8.0)
        radius_m = 0.05 + np.min(np.hypot(*(np.asarray(xy)[np.asarray(known)] - middle).T))
        at = exits_of(np.asarray(xy)[np.asarray(known)], middle.astype(np.float32), radius_m)[0] - middle
        near = np.hypot(*(at[:, None] - doors).transpose(2, 0, 1)) < 0.8 if len(at) else np.zeros((0, len(doors)), bool)
        right += bool(near.any(0).all() and near.any(1).all())
        missed += int((~near.any(0)).sum())
    return right, missed


@pytest.mark.slow
def test_wide_rooms_have_the_openings_that_are_their_doors():
    """Of sixty rooms; where doors are not looked for wall by wall, 42, and 23 are missed."""
    right, missed = counted(np.random.default_rng(21), 60)
    assert right >= 50
    assert missed <= 8


def test_a_passage_and_the_mouth_of_another_are_two_exits():
    """In the office's lower corridor: one jamb of the mouth lies outside the search circle, and the somewhat wider one
    has both; still another door along the wall made one gap of all behind them in the wider one.
    """
    centre, world = np.array((18.33, 5.37)), load_world("office")
    corridor = seen_from(world.occupied, centre - world.origin_m, world.cell_m) + world.origin_m
    middles, _ = exits_of(corridor, centre, 1.04)
    towards = np.degrees(np.arctan2(*(middles - centre).T[::-1]))
    np.testing.assert_allclose(towards, [-90, 8, 124, 175], atol=6)
