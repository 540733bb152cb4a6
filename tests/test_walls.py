"""Walls as segments: pencil maps, parity with the ray caster that traces cells, laws, and that nothing leaks."""

import math

import jax
import numpy as np
import pytest
from ref import beams as oracle
from ref import maps
from ref.passages import cast

from jexplore.driving.building.walls import UNUSED_SLOT_M, meets, segments, walls_of
from jexplore.driving.records import Walls

QUARTERS = np.radians([0, 90, 180, -90]).astype(np.float32)
BOX = maps.walls("""
    #####
    #...#
    #...#
    #####
""")


def by_hand(lines, n):
    out = np.full((n, 3), UNUSED_SLOT_M, np.float32)
    if lines:
        out[: len(lines)] = lines
    return out


def test_a_map_without_free_cells_has_no_walls():
    walls = walls_of(np.ones((3, 4), bool), 0.1)
    np.testing.assert_array_equal(walls.x, by_hand([], 32))
    np.testing.assert_array_equal(walls.y, by_hand([], 32))
    assert segments(walls).shape == (0, 4)
    assert np.isinf(cast(walls, (0.2, 0.2, 0.3), QUARTERS, 9.0)).all()


def test_a_wall_at_the_range_or_beyond_gives_inf():
    walls = walls_of(BOX, 1.0)
    pose = 2.0, 2.0, 0.0
    np.testing.assert_array_equal(cast(walls, pose, QUARTERS[:1], 2.0), [np.inf])
    np.testing.assert_allclose(cast(walls, pose, QUARTERS[:1], 2.001), [2.0], atol=1e-6)
    np.testing.assert_array_equal(np.isinf(cast(walls, pose, QUARTERS, 1.5)), [True, False, False, False])


@pytest.mark.parametrize(("quarter", "aside"), [(0, 1e-3), (1, 0.01), (2, 0.5), (3, 1e-3)])
def test_a_beam_exactly_along_a_wall_reaches_the_end_of_the_passage(quarter, aside):
    passage = np.pad(np.zeros((1, 30), bool), 1, constant_values=True)
    occupied = np.rot90(passage, quarter)
    walls = walls_of(occupied, 1.0)
    x, y = [(3, 1 + aside), (1 + aside, 29), (29, 2 - aside), (2 - aside, 3)][quarter]
    heading = [0, -math.pi / 2, math.pi, math.pi / 2][quarter]
    ahead, behind = cast(walls, (x, y, heading), np.array([0, math.pi], np.float32), 100.0)
    assert float(ahead) == pytest.approx(28, abs=1e-3)
    assert float(behind) == pytest.approx(2, abs=1e-3)


CELL_M = 0.5
SHAPE = (20, 24)
MULTIPLE = 256
RANGE_M = 6.0
BEAMS = 256
FAN = np.linspace(-math.pi, math.pi, BEAMS, endpoint=False, dtype=np.float32)


def cluttered(rng):
    occupied = rng.random(SHAPE) < rng.choice([0.02, 0.1, 0.3])
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    return occupied


@jax.jit
def by_segments(walls, pose):
    return cast(walls, pose, FAN, RANGE_M)


def by_cells(occupied, pose):
    """The oracle's ranges, metres; inf without a hit."""
    (col, x), (row, y) = (divmod(float(v) / CELL_M, 1) for v in pose[:2])
    found = (
        oracle.cast(occupied, int(row), int(col), math.degrees(pose[2] + angle), RANGE_M / CELL_M, x, y)
        for angle in FAN
    )
    return np.array([math.inf if hit is None else CELL_M * distance for _, hit, distance in found])


@pytest.mark.jit
def test_ranges_are_those_of_the_cells():
    """Beams that pass a corner or the end of the range by a hair may go either way: as a beam next to them."""
    rng = np.random.default_rng(1)
    direct = 0
    for _ in range(12):
        occupied = cluttered(rng)
        walls = walls_of(occupied, CELL_M, multiple=MULTIPLE)
        assert walls.x.shape == walls.y.shape == (MULTIPLE, 3)
        row, col = rng.choice(np.argwhere(~occupied))
        x, y = (np.float32((v + rng.uniform(0.02, 0.98)) * CELL_M) for v in (col, row))
        heading = np.float32(rng.uniform(-4, 4))
        got = by_segments(walls, (x, y, heading))
        want, *others = (by_cells(occupied, (x, y, np.float32(heading + hair))) for hair in (0, 4e-4, -4e-4))
        same = np.isclose(got, want, atol=2e-4, rtol=1e-4)
        direct += int(same.sum())
        low, high = np.minimum(*others) - 1e-3, np.maximum(*others) + 1e-3
        assert (same | ((low <= got) & (got <= high))).all()
    assert direct >= 0.99 * 12 * BEAMS


def test_a_beam_through_the_touching_corners_of_two_blocks_is_stopped():
    occupied = maps.walls("""
        ######
        #..#.#
        #.#..#
        #....#
        ######
    """)
    walls = walls_of(occupied, 1.0)  # the blocks touch at (3, 3)
    diagonal = np.array([3 * math.pi / 4], np.float32)
    for aside in (0.25, 0.5, 0.75):
        for sign, heading in ((1, 0.0), (-1, math.pi)):
            seen = cast(walls, (3 + sign * aside, 3 - sign * aside, heading), diagonal, 9.0)
            assert float(seen[0]) == pytest.approx(math.sqrt(2) * aside, abs=1e-3)


@pytest.mark.jit
def test_nothing_leaks_where_two_walls_meet():
    """Beams aimed at the inner corners of a room, from everywhere in it, end there."""
    room = np.pad(np.zeros((6, 9), bool), 1, constant_values=True)
    walls = walls_of(room, 0.1)
    corner = np.array([[0.1, 0.1], [1.0, 0.1], [0.1, 0.7], [1.0, 0.7]])
    one = jax.jit(lambda pose, angles: cast(walls, pose, angles, 50.0))
    rng = np.random.default_rng(2)
    for _ in range(30):
        place = rng.uniform([0.11, 0.11], [0.99, 0.69]).astype(np.float32)
        way = corner - place
        ranges = one((*place, np.float32(0)), np.arctan2(way[:, 1], way[:, 0]).astype(np.float32))
        np.testing.assert_allclose(ranges, np.hypot(*way.T), atol=2e-3)


@pytest.mark.jit
def test_padding_adds_nothing():
    """Not even for beams along the diagonal, where the unused slots lie."""
    rng = np.random.default_rng(3)
    occupied = cluttered(rng)
    row, col = np.argwhere(~occupied)[7]
    for heading in (0.0, math.pi / 4, 0.3):
        pose = tuple(np.float32(v) for v in ((col + 0.5) * CELL_M, (row + 0.5) * CELL_M, heading))
        few, many = (by_segments(walls_of(occupied, CELL_M, multiple=m), pose) for m in (1, MULTIPLE))
        np.testing.assert_array_equal(few, many)
    none = Walls(x=np.full((4, 3), UNUSED_SLOT_M, np.float32), y=np.full((4, 3), UNUSED_SLOT_M, np.float32))
    assert np.isinf(cast(none, (0.0, 0.0, 0.0), FAN, 1000.0)).all()


@pytest.mark.jit
def test_more_range_changes_no_reading():
    rng = np.random.default_rng(6)
    walls = walls_of(cluttered(rng), CELL_M, multiple=MULTIPLE)
    pose = np.float32(5.2), np.float32(4.1), np.float32(1.0)
    far = np.asarray(by_segments(walls, pose))
    one = jax.jit(lambda limit: cast(walls, pose, FAN, limit))
    for limit in (0.5, 1.0, 3.0):
        np.testing.assert_array_equal(one(np.float32(limit)), np.where(far < limit, far, np.inf))


rectangle_meets = jax.jit(meets)


@pytest.mark.jit
def test_a_rectangle_in_a_box():
    walls = walls_of(BOX, 1.0)  # free from (1, 1) to (4, 3)
    for pose, length, width, want in (
        ((2.5, 2, 0), 2.9, 1.9, False), ((2.5, 2, 0), 3.1, 1.9, True), ((2.5, 2, 0), 2.9, 2.1, True),
        ((2.5, 2, math.pi / 2), 1.9, 2.9, False), ((2.5, 2, math.pi / 2), 2.9, 0.1, True),
        ((2.5, 2, 0.3), 2.2, 0.9, False), ((2.5, 2, 0.8), 2.2, 0.9, True), ((2.5, 2, 0), 50, 50, True),
    ):  # fmt: skip
        assert bool(rectangle_meets(walls, np.float32(pose), length, width)) is want, (pose, length, width)
    none = walls_of(np.ones((3, 3), bool), 1.0)
    assert not rectangle_meets(none, np.float32([1.5, 1.5, 0.2]), 9.0, 9.0)


@pytest.mark.jit
def test_a_rectangle_meets_a_wall_where_one_of_its_points_lies_in_one():
    rng = np.random.default_rng(8)
    occupied = np.pad(rng.random((14, 18)) < 0.12, 1, constant_values=True)
    walls, free, hits = walls_of(occupied, 0.5), np.argwhere(~occupied), 0
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 81), np.linspace(-0.5, 0.5, 61))

    def covered(pose, length, width):  # by points at most 2 cm apart
        along, across, (x, y, heading) = u * length, v * width, pose
        col = np.floor((x + np.cos(heading) * along - np.sin(heading) * across) / 0.5).astype(int)
        row = np.floor((y + np.sin(heading) * along + np.cos(heading) * across) / 0.5).astype(int)
        inside = (row >= 0) & (row < occupied.shape[0]) & (col >= 0) & (col < occupied.shape[1])
        return bool((occupied[row[inside], col[inside]]).any() or not inside.all())

    for _ in range(150):
        row, col = free[rng.integers(len(free))]
        pose = np.float32([(col + rng.random()) * 0.5, (row + rng.random()) * 0.5, rng.uniform(-4, 4)])
        length, width = rng.uniform(0.2, 1.5), rng.uniform(0.1, 1.0)
        met = bool(rectangle_meets(walls, pose, length, width))
        assert met or not covered(pose, length - 1e-4, width - 1e-4)
        assert not met or covered(pose, length + 0.05, width + 0.05)
        hits += met
    assert 20 < hits < 130
