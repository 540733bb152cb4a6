"""Beams: pencil cases, parity with the float64 oracle, laws, noise, bad input."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import beams as oracle
from ref import maps
from scipy import stats

from jexplore import raycast
from jexplore.exploration.sensing import without_silent
from jexplore.grid import empty_grid
from jexplore.rules import Lidar

RIGHT_ANGLES = Lidar(n_beams=4, fov_deg=360, range_m=3)  # looks back, right, ahead, left
SHAPES = ((3, 3), (3, 9), (8, 7))

ROOM = maps.walls(maps.ROOM)


def sense(occupied, row, col, heading, lidar, cell_m=1.0):
    """One scan, folded into an empty map: `(hits, misses)`."""
    table = raycast.beam_table(lidar, cell_m, occupied.shape[1])
    seen = raycast.scan(jnp.asarray(occupied), row, col, heading, table)
    grid = raycast.fold(empty_grid(occupied.shape), row, col, heading, seen, table)
    return np.asarray(grid.hits), np.asarray(grid.misses)


def expected(occupied, row, col, heading, lidar, cell_m=1.0):
    """The same by the oracle."""
    hits, misses = np.zeros(occupied.shape, int), np.zeros(occupied.shape, int)
    reach = oracle.in_cells(lidar.range_m, cell_m)
    beams = oracle.scan(occupied, row, col, 45 * heading, lidar.n_beams, lidar.fov_deg, reach)
    oracle.fold(hits, misses, row, col, beams)
    return hits, misses


def draw_mounted(seed):
    """A scanner with a mount and a least range, in cells of a metre."""
    draw = np.random.default_rng(seed)
    forward, left = draw.choice([0, 0.5, -0.5, 1.0, *draw.uniform(-3, 3, 4)], 2)
    return Lidar(
        n_beams=int(draw.integers(1, 24)), fov_deg=float(draw.choice([90, 180, 270, 360])), range_m=6.0,
        min_range_m=float(draw.choice([0, 0.5, 2.0])), forward_m=float(forward), left_m=float(left),
        yaw_deg=float(draw.choice([0, 90, -45, 180, draw.uniform(-180, 180)])),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(12))
def test_a_mounted_scanner_as_the_oracle(seed):
    lidar, rng = draw_mounted(seed), np.random.default_rng(seed)
    occupied = np.pad(rng.random((12, 15)) < 0.06, 1, constant_values=True)
    row, col = np.argwhere(~occupied)[rng.integers((~occupied).sum())]
    table = raycast.beam_table(lidar, 1.0, occupied.shape[1])
    heading = int(rng.integers(8))
    seen = raycast.scan(jnp.asarray(occupied), row, col, heading, table)
    seen = without_silent(seen, table.blind[heading], True)
    grid = raycast.fold(empty_grid(occupied.shape), row, col, heading, seen, table)
    hits, misses = np.zeros(occupied.shape, int), np.zeros(occupied.shape, int)
    oracle.fold(hits, misses, row, col, oracle.mounted_scan(occupied, row, col, 45 * heading, lidar, 1.0))
    np.testing.assert_array_equal(grid.hits, hits)
    np.testing.assert_array_equal(grid.misses, misses)


# ---------------------------------------------------------------- by hand


def test_a_beam_enters_what_lies_nearer_than_the_range_and_nothing_at_it():
    for range_m, cells in ((0.5, 0), (0.51, 1), (1.5, 1), (2.5, 2), (2.51, 3)):
        table = raycast.beam_table(Lidar(n_beams=1, range_m=range_m), 1.0, 9)
        assert table.length[:, 0].tolist()[::2] == [cells] * 4
        assert np.isinf(table.entry[0, cells:, 0]).all()
        np.testing.assert_array_equal(table.entry[0, :cells, 0], 0.5 + np.arange(cells))
        np.testing.assert_array_equal(table.dcol[0, :cells, 0], 1 + np.arange(cells))
        assert not table.dcol[0, cells:, 0].any()


# ---------------------------------------------------------------- the oracle


@pytest.mark.parametrize(
    ("lidar", "cell_m"),
    [
        (Lidar(), 0.1),
        (Lidar(n_beams=1, range_m=1.0), 0.1),
        (Lidar(n_beams=13, fov_deg=360, range_m=2.0), 0.1),
        (Lidar(n_beams=8, fov_deg=360, range_m=7.0), 1.0),
        (Lidar(n_beams=4, fov_deg=90, range_m=0.3), 0.07),
    ],
    ids=lambda v: f"{v.n_beams}x{v.fov_deg:g}" if isinstance(v, Lidar) else str(v),
)
def test_the_beam_table_is_the_oracles(lidar, cell_m):
    width = 1000
    table = raycast.beam_table(lidar, cell_m, width)
    reach = round(lidar.range_m / cell_m, 9)
    for k in range(8):
        for b, angle in enumerate(oracle.lidar_angles(lidar.n_beams, lidar.fov_deg)):
            entries = oracle.beam_entries(*oracle.direction(45 * k + angle), reach)
            n = table.length[k, b]
            assert n == len(entries) < table.entry.shape[1]
            distance, drow, dcol = (np.array(v) for v in zip(*entries))
            np.testing.assert_array_equal(table.drow[k, :n, b], drow)
            np.testing.assert_array_equal(table.dcol[k, :n, b], dcol)
            np.testing.assert_array_equal(table.offset[k, :n, b], drow * width + dcol)
            np.testing.assert_allclose(table.entry[k, :n, b], distance, rtol=1e-6)
            assert not table.offset[k, n:, b].any()
    assert table.offset.shape[1] % raycast.BLOCK == 0
    assert table.offset.shape[1] == raycast.n_steps(reach)


@st.composite
def places(draw):
    """A ringed map, a free cell in it and one of the 8 headings."""
    height, width = draw(st.sampled_from(SHAPES))
    inner = draw(st.lists(st.booleans(), min_size=(height - 2) * (width - 2), max_size=(height - 2) * (width - 2)))
    occupied = np.ones((height, width), bool)
    occupied[1:-1, 1:-1] = np.reshape(inner, (height - 2, width - 2)) & (draw(st.integers(0, 2)) > 0)
    row, col = draw(st.integers(1, height - 2)), draw(st.integers(1, width - 2))
    return occupied, row, col, draw(st.integers(0, 7))


LIDARS = (Lidar(n_beams=7, range_m=4), Lidar(n_beams=12, fov_deg=360, range_m=9), Lidar(n_beams=1, range_m=2))


@pytest.mark.jit
@given(places(), st.sampled_from(LIDARS))
@settings(max_examples=60, deadline=None)
def test_scans_are_the_oracles(place, lidar):
    for got, want in zip(sense(*place, lidar), expected(*place, lidar)):
        np.testing.assert_array_equal(got, want)


# ---------------------------------------------------------------- laws


def test_nothing_is_counted_when_nothing_is_to_be():
    table = raycast.beam_table(RIGHT_ANGLES, 1.0, ROOM.shape[1])
    seen = raycast.scan(jnp.asarray(ROOM), 1, 2, 0, table)
    grid = raycast.fold(empty_grid(ROOM.shape), 1, 2, 0, seen, table, when=jnp.bool_(False))
    assert not np.asarray(grid.hits | grid.misses).any()


# ---------------------------------------------------------------- noise


def corridor(length):
    """One free row of that length between walls."""
    return np.pad(np.zeros((1, length), bool), 1, constant_values=True)


def noisy(key, occupied, row, col, heading, lidar, sigma_cells=0.0, dropout=0.0, extent=None):
    """`(seen, disturbed)`."""
    table = raycast.beam_table(lidar, 1.0, occupied.shape[1])
    seen = raycast.scan(jnp.asarray(occupied), row, col, heading, table)
    extent = jnp.asarray(occupied.shape if extent is None else extent)
    noise = {"sigma_cells": jnp.float32(sigma_cells), "dropout": jnp.float32(dropout)}
    return seen, raycast.disturb(key, seen, row, col, heading, table, extent, **noise)


def test_without_sigma_and_dropout_nothing_is_disturbed():
    lidar = Lidar(n_beams=16, fov_deg=360, range_m=3)  # beams at 45 degrees, which pass exact corners, among them
    for row, col in np.argwhere(~ROOM):
        for heading in (0, 1):
            seen, disturbed = noisy(jax.random.key(1), ROOM, row, col, heading, lidar)
            np.testing.assert_array_equal(disturbed.end, seen.end)
            np.testing.assert_array_equal(disturbed.hit, seen.hit)


@functools.cache
def many_readings(length, range_m, sigma_cells, dropout, n=4000):
    """Readings of one beam along a corridor that ends `length` cells ahead: `(end, hit)`, each `[n]`."""
    keys = jax.random.split(jax.random.key(7), n)
    one = jax.jit(
        jax.vmap(
            lambda k: noisy(
                k, corridor(60), 1, 60 - length, 0, Lidar(n_beams=1, range_m=range_m), sigma_cells, dropout
            )[1]
        )
    )
    seen = one(keys)
    return np.asarray(seen.end)[:, 0], np.asarray(seen.hit)[:, 0]


@pytest.mark.jit
def test_dropped_beams_tell_nothing_and_are_as_many_as_asked_for():
    end, hit = many_readings(9, 30, 0.0, 0.2)
    assert set(zip(end.tolist(), hit.tolist())) == {(0, False), (9, True)}
    assert stats.binomtest(int((~hit).sum()), hit.size, 0.2).pvalue > 1e-3


@pytest.mark.jit
def test_the_range_error_has_the_given_spread_and_no_bias_but_the_cells_own():
    """The wall's near edge is at 20.5 cells: a reading d falls into cell floor(d - 0.5), half a cell low on average."""
    end, hit = many_readings(20, 50, 3.0, 0.0)
    assert hit.all()
    error = end - 20.0
    inside = error < 0  # beyond the wall the map ends two cells on
    assert stats.binomtest(int(inside.sum()), end.size, 0.5).pvalue > 1e-3
    assert end.max() == 20  # the wall's cell is the last one inside the map
    for k in (-1, -2, -3):
        share = stats.norm.cdf(k)
        assert stats.binomtest(int((error < 3 * k).sum()), end.size, share).pvalue > 1e-3


@pytest.mark.jit
def test_a_reading_beyond_the_range_is_no_hit():
    """The wall's near edge is at 9.5 cells, the range is 10: with a sigma of 0.5 every sixth reading lies beyond."""
    end, hit = many_readings(9, 10, 0.5, 0.0)
    assert hit[end < 9].all()
    beyond = int((~hit).sum())
    assert stats.binomtest(beyond, hit.size, stats.norm.sf(1)).pvalue > 1e-3
    assert set(end[~hit]) == {10}


@pytest.mark.jit
def test_no_reading_ends_before_the_first_cell_or_outside_the_map():
    table = raycast.beam_table(Lidar(n_beams=9, fov_deg=360, range_m=30), 1.0, ROOM.shape[1])
    one = jax.jit(jax.vmap(
        lambda k: noisy(k, ROOM, 1, 2, 0, Lidar(n_beams=9, fov_deg=360, range_m=30), 5.0, extent=(5, 6))[1]
    ))  # fmt: skip
    seen = one(jax.random.split(jax.random.key(3), 500))
    end, hit = np.asarray(seen.end), np.asarray(seen.hit)
    assert (end >= 0).all()
    assert (end == 0).any()
    for b in range(9):
        e = end[hit[:, b], b]
        row, col = 1 + table.drow[0, e, b], 2 + table.dcol[0, e, b]
        assert ((row >= 0) & (row < 5) & (col >= 0) & (col < 6)).all()


def test_steps_inside_by_hand():
    table = raycast.beam_table(Lidar(n_beams=4, fov_deg=360, range_m=4), 1.0, 9)
    inside = raycast.steps_inside(table, 1, 2, 0, (5, 7))
    s = table.entry.shape[1]
    assert inside.tolist() == [2, 1, s, 3]  # back: columns 1, 0; right: row 0; ahead: all 4; left: rows 2 to 4


def test_different_keys_differ_and_equal_keys_agree():
    lidar = Lidar(n_beams=30, range_m=9)
    read = [noisy(jax.random.key(k), ROOM, 1, 2, 1, lidar, 2.0, 0.3)[1] for k in (1, 1, 2)]
    np.testing.assert_array_equal(read[0].end, read[1].end)
    assert (np.asarray(read[0].end) != np.asarray(read[2].end)).any()
