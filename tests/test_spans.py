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
from jexplore.config import Lidar, Rules
from jexplore.exploration.site import kernels_for, prepare_site
from jexplore.grid import empty_grid, is_known
from jexplore.spans import FARTHEST, reached, spans_of
from jexplore.studies.checks import ready_worlds

LIDARS = (
    Lidar(n_beams=181, range_m=8),
    Lidar(n_beams=60, fov_deg=360, range_m=30),
    Lidar(n_beams=2, fov_deg=90, range_m=12),
    Lidar(n_beams=1, range_m=5),
    Lidar(n_beams=3, fov_deg=360, range_m=6),
)
SHAPES = ((12, 15), (70, 9), (40, 40), (1, 1), (1, 9))


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
    inside = occupied[1:-1, 1:-1]
    inside[:] = draw.random(inside.shape) < draw.choice([0, 0.03, 0.3])
    pose = (*(int(draw.integers(min(1, n - 1), max(1, n - 1))) for n in shape), int(draw.integers(8)))
    occupied[pose[:2]] &= min(shape) > 1  # else there is no inside, and it stands in the only free cell
    ends = draw.integers(0, 1001, lidar.n_beams) if noisy else np.full(lidar.n_beams, 1000)
    by_spans, known = both(jnp.asarray(occupied), pose, lidar, when, jnp.asarray(ends))
    np.testing.assert_array_equal(by_spans, known)
    assert bool(known.any()) == when


@pytest.mark.jit
@pytest.mark.parametrize("lidar", [LIDARS[0], LIDARS[1]], ids=lambda lidar: f"{lidar.n_beams} beams")
def test_spans_need_not_go_farther_than_the_map(lidar):
    far = dataclasses.replace(lidar, range_m=60)
    beams = raycast.beam_table(far, 1.0, 15)
    clipped = beams.replace(spans=spans_of(beams, 15))
    assert clipped.spans.radius == 15
    occupied = jnp.ones((12, 15), bool).at[1:-1, 1:-1].set(False).at[6, 7].set(True)
    for pose in ((1, 1, 1), (10, 13, 5), (5, 7, 2)):
        seen = raycast.scan(occupied, *pose, clipped, method="whole")
        words, at = reached(seen, True, pose, clipped.spans, occupied.shape)
        blank = jnp.zeros((1, 15), jnp.uint32)
        known = is_known(raycast.fold(empty_grid(occupied.shape), *pose, seen, beams, method="whole"))
        np.testing.assert_array_equal(bits.unpack(jax.lax.dynamic_update_slice(blank, words, at), 12), known)


def test_spans_are_bounded():
    """What does not fit is counted otherwise."""
    beams = raycast.beam_table(Lidar(n_beams=9, range_m=6), 1.0, 20)
    assert spans_of(beams, FARTHEST + 1) is None
    assert spans_of(beams, FARTHEST).places.nbytes < 34e6
    world = ready_worlds(["cave:width_m=6.4,height_m=6.4"], 0.1)[0]
    spans = prepare_site(world, Lidar(range_m=60), Rules(), kernels_for("lockstep", "gpu")).beams.spans
    assert spans.radius == 64


def test_beams_that_are_no_run_have_no_spans():
    beams = raycast.beam_table(Lidar(n_beams=9, range_m=6), 1.0, 20)
    assert spans_of(beams, 7) is not None
    mixed = dataclasses.replace(
        beams, drow=beams.drow[..., ::2], dcol=beams.dcol[..., ::2], length=beams.length[..., ::2]
    )
    assert spans_of(mixed, 7) is not None
    order = np.array([0, 4, 1, 5, 2, 6, 3, 7, 8])
    mixed = dataclasses.replace(
        beams, drow=beams.drow[..., order], dcol=beams.dcol[..., order], length=beams.length[..., order]
    )
    assert spans_of(mixed, 7) is None
