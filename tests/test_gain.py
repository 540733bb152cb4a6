"""Gain of a look-around: by hand, and compared with the whole map's entropy computed cell by cell."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import gain as oracle
from ref import maps

from jexplore.gain import Known, look, most, prospect, seen_within
from jexplore.grid import Grid, empty_grid
from jexplore.raycast import beam_table, square_side
from jexplore.rules import Lidar

CROSS = Lidar(n_beams=4, fov_deg=360, range_m=4.0)  # in cells of one metre: four cells back, right, ahead, left


def grid_of(text, grow=(0, 0)):
    """A `Grid`: `.` free, `#` occupied, `?` unknown, `m` 1 hit and 3 misses (free), `o` 1 hit and 1 miss."""
    wide = np.pad(maps.drawn(text), [(0, n) for n in grow], constant_values="?")
    hits = np.isin(wide, ["#", "m", "o"]).astype(np.int32)
    misses = (np.isin(wide, [".", "o"]) + 3 * (wide == "m")).astype(np.int32)
    return Grid(jnp.asarray(hits), jnp.asarray(misses))


def round_table(lidar, cell_m=1.0):
    """`Beams` of a look-around: they do not depend on the map's width."""
    return jax.device_put(beam_table(lidar, cell_m, 1)).all_round


def told_of(grid, row, col, lidar, **known):
    """`ViewGain` of a look."""
    beams = round_table(lidar)
    return look(prospect(Known(grid, jnp.float32(0.25), **known), beams), jnp.int32(row), jnp.int32(col), beams)


# ---------------------------------------------------------------- by hand


NOTHING = "????? ????? ?.??? ????? ?????"


def test_beyond_a_region_nothing_is_wanted():
    """A region that leaves out a cell says where the robot may be; one that leaves out none is no region."""
    region = np.ones((5, 5), bool)
    assert int(told_of(grid_of(NOTHING), 2, 1, CROSS, within=jnp.asarray(region)).unknown) == 16
    region[0, 0] = False
    assert int(told_of(grid_of(NOTHING), 2, 1, CROSS, within=jnp.asarray(region)).unknown) == 1 + 3 + 2 * 2


def test_mixed_cells_that_do_not_fit_are_counted():
    """256 have room on a small map; the gain of the others is not counted, that of unknown cells is."""
    hits, beams = np.ones((20, 20), np.int32), round_table(CROSS)
    margin, width = square_side(beams) // 2, 20 + square_side(beams) - 1
    grid = Grid(jnp.asarray(hits), jnp.asarray(hits))
    assert int(prospect(Known(grid, 0.25), beams).overflow) == 400 - 256
    grid = Grid(grid.hits, grid.misses.at[18:].set(0).at[:5].set(0))
    assert int(prospect(Known(grid, 0.25), beams).overflow) == 13 * 20 - 256
    grid = Grid(grid.hits.at[:6].set(0), grid.misses)
    ahead = prospect(Known(grid, 0.25), beams)
    assert int(ahead.overflow) == 0
    row, col = np.divmod(np.arange(120, 360), 20)
    np.testing.assert_array_equal(ahead.mixed[:240], (row + margin) * width + col + margin)
    assert (np.asarray(ahead.mixed[240:]) == width**2).all()
    np.testing.assert_array_equal(ahead.before, np.arange(256) < 240)


# ---------------------------------------------------------------- compared with the oracle

CASES = {
    "half plane": (Lidar(n_beams=19, range_m=0.6), (11, 14), (0, 0)),
    "quarter": (Lidar(n_beams=7, fov_deg=90, range_m=3.0), (9, 16), (4, 17)),
    "all round": (Lidar(n_beams=12, fov_deg=360, range_m=0.9), (13, 8), (20, 0)),
}


def random_counts(seed, shape, grow):
    """Counts of cells unknown, hit, missed or both; outermost cells that are known have been hit."""
    draw = np.random.default_rng(seed)
    kind = draw.choice(4, shape, p=[0.4, 0.1, 0.35, 0.15])
    ring = np.pad(np.zeros(np.subtract(shape, 2), bool), 1, constant_values=True)
    kind = np.where(ring & (kind == 2), 1, kind)
    hits = np.isin(kind, [1, 3]) * draw.integers(1, 5, shape)
    misses = np.isin(kind, [2, 3]) * draw.integers(1, 12, shape)
    where = draw.integers(1, np.subtract(shape, 1))
    hits[tuple(where)], misses[tuple(where)] = 0, 1
    return *(np.pad(a, [(0, n) for n in grow]) for a in (hits, misses)), tuple(int(v) for v in where)


@jax.jit
def everything(grid, outline, row, col, beams):
    known = Known(grid, jnp.float32(0.25), outline=outline)
    ahead = prospect(known, beams)
    limit = most(ahead, row[None], col[None], beams)[0]
    seen = seen_within(ahead.stops, ahead.unknown, row, col, beams, jnp.full(1, jnp.inf))
    return look(ahead, row, col, beams), limit, seen[0]


@pytest.mark.jit
@pytest.mark.parametrize("case", CASES)
def test_random_looks_tell_what_the_whole_map_tells(case):
    lidar, shape, grow = CASES[case]
    beams = round_table(lidar, 0.1)

    @given(st.integers(0, 2**32 - 1), st.booleans())
    @settings(max_examples=30)
    def check(seed, is_outlined):
        hits, misses, where = random_counts(seed, shape, grow)
        grid = Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))
        outline = jnp.asarray(shape if is_outlined else (0, 0), jnp.int32)
        told, limit, seen = everything(grid, outline, *map(jnp.int32, where), beams)
        size = lidar.n_beams, lidar.fov_deg, lidar.range_m * 10
        gain, unknown, known = oracle.look(hits, misses, *where, *size, outline=shape if is_outlined else None)
        assert float(told.gain) == pytest.approx(gain, abs=1e-3)
        assert (int(told.unknown), int(told.known)) == (unknown, known)
        assert int(seen) == unknown
        assert float(limit) >= float(told.gain)

    check()


@pytest.mark.jit
def test_what_a_place_can_tell_at_most_is_what_lies_in_reach():
    """All unknown cells of a square, and not those outside it: the bound is of use."""
    beams, shape = round_table(Lidar(n_beams=19, range_m=1.0), 0.1), (90, 120)
    grid = empty_grid(shape)
    grid = Grid(grid.hits, grid.misses.at[40:60].set(1))
    row, col = jnp.asarray([1, 45, 88]), jnp.asarray([1, 60, 118])
    side = square_side(beams)
    assert 2 * 10 < side < 50
    unknown = np.pad(np.asarray(grid.misses) == 0, side // 2, constant_values=True)
    for got, r, c in zip(most(prospect(Known(grid, 0.25), beams), row, col, beams), row, col):
        want = unknown[r : r + side, c : c + side].sum()
        assert want <= got <= 1.001 * want + 1
