"""Which cells a scan reaches, all at once: those that counting it into an empty map makes known."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import maps

from jexplore import raycast
from jexplore.arrays import bits
from jexplore.config import Lidar
from jexplore.grid import empty_grid, is_known
from jexplore.spans import reached, spans_of

LIDARS = (
    Lidar(n_beams=181, range_m=8),
    Lidar(n_beams=60, fov_deg=360, range_m=30),
    Lidar(n_beams=2, fov_deg=90, range_m=12),
    Lidar(n_beams=1, range_m=5),
    Lidar(n_beams=3, fov_deg=360, range_m=6),
)
SHAPES = ((12, 15), (70, 9), (40, 40))


@functools.cache
def table(lidar, width):
    beams = raycast.beam_table(lidar, 1.0, width)
    return beams.replace(spans=spans_of(beams, int(lidar.range_m) + 1))


@functools.partial(jax.jit, static_argnums=2)
def both(occupied, pose, lidar, when, ends):
    """Cells reached, by the spans and by the map; `ends`: what is left of each beam, thousandths."""
    beams = table(lidar, occupied.shape[1])
    seen = raycast.scan(occupied, *pose, beams, method="whole")
    end = seen.end * ends // 1000
    seen = raycast.Scan(end, seen.hit & ((ends == 1000) | (end % 2 == 0)))  # as noise makes of it
    words, at = reached(seen, when, pose, beams.spans, occupied.shape)
    blank = jnp.zeros((-(-occupied.shape[0] // 32), occupied.shape[1]), jnp.uint32)
    by_spans = bits.unpack(jax.lax.dynamic_update_slice(blank, words, at), occupied.shape[0])
    grid = raycast.fold(empty_grid(occupied.shape), *pose, seen, beams, when=when, method="whole")
    return by_spans, is_known(grid)


def test_cells_reached_by_hand():
    occupied = jnp.asarray(
        maps.walls("""
        #######
        #.....#
        #..#..#
        #.....#
        #######
    """)
    )
    found, known = both(occupied, (1, 2, 0), Lidar(n_beams=4, fov_deg=360, range_m=3), True, jnp.full(4, 1000))
    want = ["..#....", "..#....", "..#....", "######.", "..#...."]
    assert ["".join(".#"[int(cell)] for cell in row) for row in np.asarray(found)[::-1]] == want
    np.testing.assert_array_equal(found, known)


@pytest.mark.jit
@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**20), st.sampled_from(LIDARS), st.sampled_from(SHAPES), st.booleans(), st.booleans())
def test_cells_reached_are_those_that_come_to_be_known(seed, lidar, shape, when, noisy):
    draw = np.random.default_rng(seed)
    occupied = np.ones(shape, bool)
    occupied[1:-1, 1:-1] = draw.random((shape[0] - 2, shape[1] - 2)) < draw.choice([0, 0.03, 0.3])
    pose = (*(int(draw.integers(1, n - 1)) for n in shape), int(draw.integers(8)))
    ends = draw.integers(0, 1001, lidar.n_beams) if noisy else np.full(lidar.n_beams, 1000)
    by_spans, known = both(jnp.asarray(occupied), pose, lidar, when, jnp.asarray(ends))
    np.testing.assert_array_equal(by_spans, known)
    assert bool(known.any()) == when


def test_beams_that_are_no_run_have_no_spans():
    beams = raycast.beam_table(Lidar(n_beams=9, range_m=6), 1.0, 20)
    assert spans_of(beams, 7) is not None
    assert spans_of(beams, 3) is None  # they go farther
    mixed = dataclasses.replace(
        beams, drow=beams.drow[..., ::2], dcol=beams.dcol[..., ::2], length=beams.length[..., ::2]
    )
    assert spans_of(mixed, 7) is not None
    order = np.array([0, 4, 1, 5, 2, 6, 3, 7, 8])
    mixed = dataclasses.replace(
        beams, drow=beams.drow[..., order], dcol=beams.dcol[..., order], length=beams.length[..., order]
    )
    assert spans_of(mixed, 7) is None
