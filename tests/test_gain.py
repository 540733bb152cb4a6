"""Gain of a look-around: by hand, and compared with the whole map's entropy computed cell by cell."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import gain as oracle
from ref import maps

from jexplore.config import Lidar
from jexplore.gain import look, most, prospect, stops_and_unknown, unknown_seen, window_of
from jexplore.grid import Grid, empty_grid
from jexplore.raycast import all_round, beam_table

CROSS = Lidar(n_beams=4, fov_deg=360, range_m=4.0)  # in cells of one metre: four cells back, right, ahead, left


def grid_of(text, grow=(0, 0)):
    """`(Grid, extent)`: `.` free, `#` occupied, `?` unknown, `m` 1 hit and 3 misses (free), `o` 1 hit and 1 miss."""
    cells = maps.drawn(text)
    wide = np.pad(cells, [(0, n) for n in grow], constant_values="?")
    hits = np.isin(wide, ["#", "m", "o"]).astype(np.int32)
    misses = (np.isin(wide, [".", "o"]) + 3 * (wide == "m")).astype(np.int32)
    return Grid(jnp.asarray(hits), jnp.asarray(misses)), jnp.asarray(cells.shape, jnp.int32)


def told_of(grid, extent, row, col, lidar, cell_m=1.0):
    """`(ViewGain, scratch)` of a look."""
    shape = grid.hits.shape
    beams = all_round(jax.device_put(beam_table(lidar, cell_m, shape[1])))
    where = jnp.int32(row), jnp.int32(col)
    return look(prospect(grid, extent, jnp.float32(0.25)), *where, beams, empty_grid(shape))


# ---------------------------------------------------------------- by hand


def test_unknown_cells_in_sight_count_one_bit_each():
    """Ahead 2 unknown cells and the wall; back an obstacle, behind which nothing is seen; aside 1 and 1."""
    grid, extent = grid_of("""
        #######
        #?????#
        #?#.??#
        #?????#
        #######
    """)
    told, scratch = told_of(grid, extent, 2, 3, CROSS)
    assert (float(told.gain), int(told.unknown), int(told.known)) == (4, 4, 1)
    assert not np.asarray(scratch.hits).any()
    assert not np.asarray(scratch.misses).any()


def entropy(p):
    return -p * math.log2(p) - (1 - p) * math.log2(1 - p)


def test_mixed_cells_change_by_what_the_scan_adds():
    """1 hit of 4 beams passed becomes 1 of 5; 1 hit of 2 stops the beam and becomes 2 of 3."""
    grid, extent = grid_of("###### #.m.o# ######")
    told, _ = told_of(grid, extent, 1, 1, CROSS)
    assert (int(told.unknown), int(told.known)) == (0, 3)
    assert float(told.gain) == pytest.approx(entropy(1 / 4) - entropy(1 / 5) + entropy(1 / 2) - entropy(2 / 3))
    # Behind a wall it tells nothing.
    grid, extent = grid_of("###### #.#m.# ######")
    assert float(told_of(grid, extent, 1, 1, CROSS)[0].gain) == 0


def test_looks_can_make_the_map_less_certain():
    """3 hits of 10 stop a beam; one hit more brings the cell nearer to a half."""
    grid = Grid(jnp.asarray([[1, 1, 1], [1, 0, 3], [1, 1, 1]]), jnp.asarray([[0, 0, 0], [0, 1, 7], [0, 0, 0]]))
    told, _ = told_of(grid, jnp.asarray([3, 3]), 1, 1, CROSS)
    assert float(told.gain) == pytest.approx(entropy(3 / 10) - entropy(4 / 11))
    assert float(told.gain) < 0


def test_beams_end_at_the_outermost_cells_and_say_nothing_of_them():
    """Everything is unknown, the ring and the padding too: of the row 3 cells are seen, of the column 1."""
    text = "????? ????? ?.??? ????? ?????"
    for grow in ((0, 0), (3, 4)):
        grid, extent = grid_of(text, grow)
        told, _ = told_of(grid, extent, 2, 1, CROSS)
        assert (float(told.gain), int(told.unknown), int(told.known)) == (4, 4, 1)
        stops, unknown = stops_and_unknown(grid, extent, jnp.float32(0.25))
        inside = oracle.inner(grid.hits.shape, (5, 5))
        np.testing.assert_array_equal(stops, ~inside)
        assert not (np.asarray(unknown) & ~inside).any()
        assert np.asarray(unknown).sum() == 8


def test_mixed_cells_that_do_not_fit_are_counted():
    """256 have room on a small map; the gain of the others is not counted, that of unknown cells is."""
    hits = np.ones((20, 20), np.int32)
    grid, extent = Grid(jnp.asarray(hits), jnp.asarray(hits)), jnp.asarray([20, 20])
    assert int(prospect(grid, extent, 0.25).overflow) == 400 - 256
    grid = Grid(grid.hits, grid.misses.at[18:].set(0).at[:5].set(0))
    assert int(prospect(grid, extent, 0.25).overflow) == 13 * 20 - 256
    grid = Grid(grid.hits.at[:6].set(0), grid.misses)
    ahead = prospect(grid, extent, 0.25)
    assert int(ahead.overflow) == 0
    np.testing.assert_array_equal(ahead.mixed[:240], np.arange(120, 360))
    assert (np.asarray(ahead.mixed[240:]) == 400).all()
    np.testing.assert_array_equal(ahead.before, np.arange(256) < 240)


def test_the_window_holds_all_that_a_look_can_reach():
    for lidar, cell_m in ((CROSS, 1.0), (Lidar(), 0.1), (Lidar(range_m=0.05), 0.1)):
        beams = beam_table(lidar, cell_m, 100)
        farthest = max(np.abs(beams.drow).max(), np.abs(beams.dcol).max())
        assert window_of(beams, (1000, 1000))[0] // 2 >= farthest
        assert window_of(beams, (7, 9)) == (
            min(7, window_of(beams, (1000, 9))[0]),
            min(9, window_of(beams, (9, 1000))[1]),
        )


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
    ring = ~oracle.inner(shape, shape)
    kind = np.where(ring & (kind == 2), 1, kind)
    hits = np.isin(kind, [1, 3]) * draw.integers(1, 5, shape)
    misses = np.isin(kind, [2, 3]) * draw.integers(1, 12, shape)
    where = draw.integers(1, np.subtract(shape, 1))
    hits[tuple(where)], misses[tuple(where)] = 0, 1
    return *(np.pad(a, [(0, n) for n in grow]) for a in (hits, misses)), tuple(int(v) for v in where)


@jax.jit
def everything(grid, extent, row, col, beams):
    beams, p_free = all_round(beams), jnp.float32(0.25)
    ahead = prospect(grid, extent, p_free)
    told, scratch = look(ahead, row, col, beams, empty_grid(grid.hits.shape))
    limit = most(ahead, row[None], col[None], beams)[0]
    return told, scratch, limit, unknown_seen(grid, extent, p_free, row, col, beams)


@pytest.mark.jit
@pytest.mark.parametrize("case", CASES)
def test_random_looks_tell_what_the_whole_map_tells(case):
    lidar, shape, grow = CASES[case]
    beams = jax.device_put(beam_table(lidar, 0.1, shape[1] + grow[1]))

    @given(st.integers(0, 2**32 - 1))
    @settings(max_examples=30)
    def check(seed):
        hits, misses, where = random_counts(seed, shape, grow)
        args = *map(jnp.int32, where), beams
        grid = Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))
        told, scratch, limit, seen = everything(grid, jnp.asarray(shape, jnp.int32), *args)
        gain, unknown, known = oracle.look(
            hits, misses, shape, *where, lidar.n_beams, lidar.fov_deg, lidar.range_m * 10
        )
        assert float(told.gain) == pytest.approx(gain, abs=1e-3)
        assert (int(told.unknown), int(told.known)) == (unknown, known)
        assert int(seen) == unknown
        assert float(limit) >= float(told.gain)
        assert not np.asarray(scratch.hits).any()
        assert not np.asarray(scratch.misses).any()

    check()


@pytest.mark.jit
def test_what_a_place_can_tell_at_most_is_what_lies_in_reach():
    """All unknown cells of a window, and not those outside it: the bound is of use."""
    shape = (90, 120)
    grid, extent = empty_grid(shape), jnp.asarray(shape, jnp.int32)
    beams = all_round(jax.device_put(beam_table(Lidar(n_beams=19, range_m=1.0), 0.1, 120)))
    ahead = prospect(grid, extent, jnp.float32(0.25))
    row, col = jnp.asarray([1, 45, 88]), jnp.asarray([1, 60, 118])
    unknown = np.asarray(ahead.unknown)
    height, width = window_of(beams, shape)
    assert 2 * 10 < height < 50
    for got, r, c in zip(most(ahead, row, col, beams), row, col):
        top, left = (int(np.clip(a - n // 2, 0, m - n)) for a, n, m in zip((r, c), (height, width), shape))
        want = unknown[top : top + height, left : left + width].sum()
        assert want <= got <= 1.001 * want + 1
