"""A scan counted into all cells round the robot at once, as beam by beam."""

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
from jexplore.grid import Grid, empty_grid, is_known
from jexplore.spans import FARTHEST, fold, spans_of
from jexplore.studies.checks import ready_worlds

LIDARS = (
    Lidar(n_beams=181, range_m=8),
    Lidar(n_beams=60, fov_deg=360, range_m=30),
    Lidar(n_beams=2, fov_deg=90, range_m=12),
    Lidar(n_beams=1, range_m=5),
    Lidar(n_beams=3, fov_deg=360, range_m=6),
    Lidar(n_beams=300, range_m=4),
    Lidar(n_beams=700, fov_deg=40, range_m=9),  # more of them in a cell than a byte holds
)
SHAPES = ((12, 15), (64, 9), (70, 9), (9, 70), (40, 40), (1, 1), (1, 9))


@functools.cache
def table(lidar, width):
    beams = raycast.beam_table(lidar, 1.0, width)
    return beams.replace(spans=spans_of(beams, int(lidar.range_m) + 1))


def counted(occupied, pose, seen, beams, when, grid):
    """A scan counted into a map by the spans, and known cells; the same beam by beam."""
    known = bits.pack(is_known(grid))
    by_spans, known = fold(grid, known, pose, seen, beams, when)
    by_beams = raycast.fold(grid, *pose, seen, beams, when=when, method="whole")
    return (by_spans, bits.unpack(known, occupied.shape[0])), (by_beams, is_known(by_beams))


@functools.partial(jax.jit, static_argnums=2)
def both(occupied, pose, lidar, when, ends, before):
    """`counted`; `ends`: what is left of each beam, thousandths; `before`: what the map already held."""
    beams = table(lidar, occupied.shape[1])
    seen = raycast.scan(occupied, *pose, beams, method="whole")
    end = seen.end * ends // 1000
    seen = raycast.Scan(end, seen.hit & ((ends == 1000) | (end % 2 == 0)))  # as noise makes of it
    return counted(occupied, pose, seen, beams, when, Grid(before // 2, before))


def assert_equal(found, expected):
    jax.tree.map(np.testing.assert_array_equal, found, expected)


def test_a_scan_by_hand():
    occupied = jnp.asarray(
        maps.walls("""
        #######
        #.....#
        #..#..#
        #.....#
        #######
    """)
    )
    lidar, blank = Lidar(n_beams=4, fov_deg=360, range_m=3), jnp.zeros((5, 7), jnp.int32)
    found, expected = both(occupied, (1, 2, 0), lidar, True, jnp.full(4, 1000), blank)
    want = ["..#....", "..#....", "..#....", "######.", "..#...."]
    assert ["".join(".#"[int(cell)] for cell in row) for row in np.asarray(found[1])[::-1]] == want
    assert found[0].misses[1].tolist() == [0, 1, 1, 1, 1, 1, 0]
    assert_equal(found, expected)


@pytest.mark.jit
@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**20), st.sampled_from(LIDARS), st.sampled_from(SHAPES), st.booleans(), st.booleans())
def test_a_scan_tells_what_its_beams_tell(seed, lidar, shape, when, noisy):
    draw = np.random.default_rng(seed)
    occupied = np.ones(shape, bool)
    middle = occupied[1:-1, 1:-1]
    middle[:] = draw.random(middle.shape) < draw.choice([0, 0.03, 0.3])
    pose = (*(int(draw.integers(min(1, n - 1), max(1, n - 1))) for n in shape), int(draw.integers(8)))
    occupied[pose[:2]] &= min(shape) > 1  # else there is no inside, and it stands in the only free cell
    ends = draw.integers(0, 1001, lidar.n_beams) if noisy else np.full(lidar.n_beams, 1000)
    before = jnp.asarray(np.maximum(draw.integers(-3, 4, shape), 0), jnp.int32)
    found, expected = both(jnp.asarray(occupied), pose, lidar, when, jnp.asarray(ends), before)
    inside = min(shape) > 1  # else beams leave the map, and what they count there is undefined
    assert_equal(found if inside else found[1], expected if inside else expected[1])
    assert not inside or bool((found[0].misses != before).any()) == when


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
        assert_equal(*counted(occupied, pose, seen, clipped, True, empty_grid(occupied.shape)))


@pytest.mark.jit
@pytest.mark.parametrize(("n_beams", "fov_deg"), [(1080, 270), (4096, 360)])
def test_as_many_beams_as_there_may_be(n_beams, fov_deg):
    """Their table has more groups than are summed up in one go; and room for a longer range than theirs."""
    beams = raycast.beam_table(Lidar(n_beams=n_beams, fov_deg=fov_deg, range_m=9), 1.0, 40, 14)
    beams = beams.replace(spans=spans_of(beams, 14))
    occupied = jnp.ones((33, 40), bool).at[1:-1, 1:-1].set(False).at[12, 20].set(True)
    for pose in ((1, 1, 1), (31, 38, 4), (14, 21, 3)):
        seen = raycast.scan(occupied, *pose, beams, method="whole")
        assert_equal(*counted(occupied, pose, seen, beams, True, empty_grid(occupied.shape)))


def test_spans_are_bounded():
    """What does not fit is counted otherwise."""
    beams = raycast.beam_table(Lidar(n_beams=9, range_m=6), 1.0, 20)
    assert spans_of(beams, FARTHEST + 1) is None
    assert spans_of(beams, FARTHEST).runs.nbytes < 31e6
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
