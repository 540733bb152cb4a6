"""The kernel in C++ that scans and counts: by hand, parity with the kernels in JAX, whole runs, no compiler."""

import dataclasses
import os
import subprocess
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref import maps
from ref.jobs import RULES, digest, some_jobs

import jexplore as jx
from jexplore import raycast
from jexplore.cli import main
from jexplore.config import InputError, InputWarning, Lidar
from jexplore.engine import native
from jexplore.exploration import batch, sensing
from jexplore.exploration.site import prepare_site
from jexplore.grid import Grid, empty_grid, is_known

RIGHT_ANGLES = Lidar(n_beams=4, fov_deg=360, range_m=3)  # looks back, right, ahead, left
LIDAR = Lidar(n_beams=37, range_m=2.0)
ROOMS = "rooms:width_m=6,height_m=5"
SHAPES = ((3, 3), (3, 9), (8, 7))

ROOM = maps.walls("""
    #######
    #.....#
    #..#..#
    #.....#
    #######
""")

needs_compiler = pytest.mark.skipif(not native.find_compiler(), reason="no C++ compiler")


@pytest.fixture(scope="module", autouse=True)
def _folder(tmp_path_factory):
    """A folder of its own for what is built."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("native")))
        yield


@pytest.fixture(scope="module")
def target(_folder):
    found = sensing.native_kernel()
    assert found.target is not None, found.why_not
    return found.target


def both(target, grid, occupied, stands, believes, lidar, when=True, free=True):
    """`(hits, misses, fresh)` by the kernel in C++ and by those in JAX."""
    table = raycast.beam_table(lidar, 1.0, occupied.shape[1])
    grid, occupied = jax.tree.map(jnp.asarray, (grid, occupied))
    ours, fresh = sensing.look(target, grid, occupied, stands, believes, jax.tree.map(jnp.asarray, table), when, free)
    seen = sensing.without_silent(raycast.scan(occupied, *stands, table), free)
    theirs = raycast.fold(grid, *believes, seen, table, when=when)
    n = np.sum(np.asarray(is_known(theirs))) - np.sum(np.asarray(is_known(grid)))
    return (ours.hits, ours.misses, fresh), (theirs.hits, theirs.misses, n)


@needs_compiler
def test_one_scan_by_hand(target):
    (hits, misses, fresh), _ = both(target, empty_grid(ROOM.shape), ROOM, (1, 2, 0), (1, 2, 0), RIGHT_ANGLES)
    assert maps.picture(np.asarray(hits), np.asarray(misses)) == [
        "??#????",
        "??.????",
        "??.????",
        "#.....?",  # ahead the range of 3 cells ends the beam after 3 cells entered
        "??#????",
    ]
    assert (int(np.max(hits)), int(np.max(misses)), int(fresh)) == (1, 1, 10)


@needs_compiler
def test_without_an_echo_a_beam_may_say_nothing(target):
    how = (1, 2, 0), (1, 2, 0), RIGHT_ANGLES, True, False
    for hits, misses, _ in both(target, empty_grid(ROOM.shape), ROOM, *how):
        assert maps.picture(np.asarray(hits), np.asarray(misses)) == [
            "??#????",
            "??.????",
            "??.????",
            "#..????",  # ahead nothing is seen within 3 cells
            "??#????",
        ]


@st.composite
def scenes(draw):
    """A walled map, counts made before, where a robot stands and believes to be, a scanner."""
    shape = draw(st.sampled_from(SHAPES))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    occupied = rng.random(shape) < draw(st.sampled_from([0, 0.2, 0.5]))
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    before = (rng.integers(0, 3, (2, *shape)) * (rng.random(shape) < 0.5)).astype(np.int32)
    row, col = (int(rng.integers(1, n - 1)) for n in shape)
    lidar = draw(st.sampled_from([RIGHT_ANGLES, LIDAR, Lidar(1, 90, 30), Lidar(12, 360, 0.5)]))
    return Grid(*before), occupied, (row, col, int(rng.integers(8))), lidar


@needs_compiler
@pytest.mark.jit
@settings(max_examples=80)
@given(scenes(), st.booleans(), st.booleans())
def test_parity_with_the_kernels_in_jax(target, scene, when, free):
    grid, occupied, pose, lidar = scene
    flags = jnp.bool_(when), jnp.bool_(free)
    jax.tree.map(np.testing.assert_array_equal, *both(target, grid, occupied, pose, pose, lidar, *flags))


@needs_compiler
@pytest.mark.jit
@pytest.mark.parametrize("heading", range(8))
def test_a_scan_is_counted_where_the_robot_believes_to_be(target, heading):
    """In a map of maps, and turned: it stands in the second room and believes to be in the middle of nowhere."""
    occupied, lidar = np.concatenate([np.ones_like(ROOM), ROOM]), Lidar(n_beams=9, fov_deg=180, range_m=2.5)
    grid = empty_grid(occupied.shape)
    stands, believes = (5 + 1, 2, 3), (4, 3, heading)
    jax.tree.map(np.testing.assert_array_equal, *both(target, grid, occupied, stands, believes, lidar))


@needs_compiler
@pytest.mark.jit
def test_nothing_beyond_the_map_is_touched(target):
    """Not that a scan ever leaves it: its walls are its outermost rows and columns. Without them a beam runs on from
    the end of a row into the next; before the first cell and after the last nothing is counted.
    """
    table = raycast.beam_table(RIGHT_ANGLES, 1.0, 3)
    open_field = jnp.zeros((3, 3), bool)
    grid, fresh = sensing.look(target, empty_grid((3, 3)), open_field, (1, 1, 0), (1, 1, 0), table)
    np.testing.assert_array_equal(grid.hits, np.zeros((3, 3)))
    np.testing.assert_array_equal(grid.misses, [[0, 2, 1], [1, 1, 1], [1, 2, 0]])
    assert int(fresh) == 7


# ---------------------------------------------------------------- whole runs


def run(**how):
    return batch.run_jobs(some_jobs(), LIDAR, RULES, engine="serial", workers=2, **how)


@needs_compiler
@pytest.mark.jit
def test_episodes_have_the_same_bits(target):
    ran = [run(), run(fast=True)]
    assert digest(ran[0]) == digest(ran[1])
    assert max(outcomes.result.scans.max() for outcomes in ran[0].outcomes) > 20


@needs_compiler
@pytest.mark.jit
def test_a_noisy_scanner_is_told_once(target):
    jobs = [job._replace(starts=job.starts[:1]) for job in some_jobs()[:2]]
    noisy = [job._replace(lidar=dataclasses.replace(LIDAR, sigma_m=0.03)) for job in jobs]
    how = {"engine": "serial", "workers": 1, "fast": True}
    text = r"^fast: the kernels in JAX make the scans where the scanner has noise or robots stay in a region$"
    with pytest.warns(InputWarning, match=text) as told:
        fast = batch.run_jobs(noisy, LIDAR, RULES, **how)
    assert len(told) == 1
    assert digest(fast) == digest(batch.run_jobs(noisy, LIDAR, RULES, **{**how, "fast": False}))


@needs_compiler
def test_a_noisy_scanner_keeps_the_kernels_in_jax(target):
    world = some_jobs()[0].world
    for sigma_m, own in ((0.0, target), (0.03, None)):
        assert prepare_site(world, Lidar(sigma_m=sigma_m), RULES, native=target).setup.native == own
    assert prepare_site(world, LIDAR, RULES).setup.native is None


def test_it_is_for_the_serial_engine():
    with pytest.raises(InputError, match=r"^fast is for the engine serial on a CPU, got lockstep on a CPU$"):
        batch.run_jobs(some_jobs(), LIDAR, RULES, engine="lockstep", fast=True)


@needs_compiler
@pytest.mark.jit
def test_the_command_writes_the_same_files(target, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ["--worlds", ROOMS, "--strategies", "closest", "--episodes", "3", "--no-report"]
    for folder, more in (("as-ever", []), ("fast", ["--fast"])):
        assert main.main(["compare", *options, "--lidar.range-m", "2", *more, "--out", folder]) == 0
    for name in ("episodes.parquet", "details.npz"):
        assert (tmp_path / "fast" / name).read_bytes() == (tmp_path / "as-ever" / name).read_bytes()


class _Asked(Exception):
    pass


@pytest.mark.parametrize(
    "ask",
    [
        lambda **how: jx.compare(ROOMS, "closest", episodes=1, **how),
        lambda **how: jx.explore(ROOMS, "closest", **how),
        lambda **how: jx.sweep({"worlds": [ROOMS], "strategies": ["closest"], "episodes": 1}, **how),
    ],
    ids=["compare", "explore", "sweep"],
)
def test_whoever_runs_episodes_hands_on_whether_it_is_asked_for(ask, monkeypatch):
    def asked(*args, fast=False, **how):
        raise _Asked(fast)

    monkeypatch.setattr(batch, "run_jobs", asked)
    for fast in (True, False):
        with pytest.raises(_Asked, match=str(fast)):
            ask(fast=fast)


def test_a_sweep_by_ray_has_none():
    with pytest.raises(
        InputError, match=r"^fast is for strategies by the engine serial on this machine's CPU, not for"
    ):
        jx.sweep({"worlds": [ROOMS], "strategies": ["closest"], "episodes": 1}, engine="ray", fast=True)


# ---------------------------------------------------------------- building


def test_no_compiler_is_told_and_the_run_goes_on(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    text = r"^fast: no C\+\+ compiler was found: expected one of c\+\+, .* in CXX; the kernels in JAX make the scans$"
    with pytest.warns(InputWarning, match=text):
        assert batch._native_for(batch.find_resources(engine="serial"), True) is None


@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
def test_a_compiler_that_fails_is_told_in_one_line(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiler = tmp_path / "fails"
    # Its first line is none of UTF-8.
    compiler.write_text("#!/bin/sh\nprintf '\\377\\n' >&2\necho 'look.cpp:1: error: no such thing' >&2\nexit 1\n")
    compiler.chmod(0o755)
    for command, why in (
        (str(compiler), f"{compiler} could not build sensing.cpp: look.cpp:1: error: no such thing"),
        ("false", "false could not build sensing.cpp: exit status 1"),
        ("no-such-compiler", "sensing.cpp could not be built by no-such-compiler or loaded: [Errno 2]"),
        ("c++ '-O2", 'CXX must be a command, got "c++ \'-O2": no closing quotation'),
    ):
        monkeypatch.setenv("CXX", command)
        found = sensing.native_kernel()
        assert found.target is None
        assert found.why_not.startswith(why)
    assert sorted(path.name for path in (tmp_path / "jexplore").iterdir()) == []


@needs_compiler
def test_it_is_built_once(target, monkeypatch):
    """Another process finds it, and its compiler is not asked."""
    native._loaded.cache_clear()
    monkeypatch.setattr(subprocess, "run", None)
    assert sensing.native_kernel().target == target


@needs_compiler
def test_what_does_not_load_is_built_anew(tmp_path):
    """A library that is not whole, and one without the handler."""
    (tmp_path / "other.cpp").write_text('extern "C" int other() { return 1; }\n')
    subprocess.run(
        [*native.find_compiler(), *native.FLAGS, tmp_path / "other.cpp", "-o", tmp_path / "other.so"], check=True
    )
    for name, content in (("empty.so", b""), ("of-another.so", (tmp_path / "other.so").read_bytes())):
        (tmp_path / name).write_bytes(content)
        how = sensing.SOURCE, sensing.SYMBOL, tmp_path / name, native.find_compiler()
        assert native._handler(*how)
        built = (tmp_path / name).read_bytes()
        assert built != content
        assert native._handler(*how)
        assert (tmp_path / name).read_bytes() == built


def test_nothing_is_built_unless_asked():
    """Nor is a compiler looked for."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert batch._native_for(batch.find_resources(engine="serial"), False) is None


# ---------------------------------------------------------------- known cells


def test_known_cells_of_a_square_by_hand():
    hits, misses = np.zeros((2, 5, 6), np.int32)
    hits[1, 1] = misses[1, 1] = misses[2, 3] = hits[4, 5] = 1  # one twice, the last one outside
    grid, corner = Grid(jnp.asarray(hits), jnp.asarray(misses)), jnp.asarray([1, 1])
    for within in (None, jnp.ones((5, 6), bool)):
        assert int(sensing.known_in(grid, corner, (3, 4), within)) == 2
        assert int(sensing.known_in(grid, corner * 0, (5, 6), within)) == 3
    assert int(sensing.known_in(grid, corner, (3, 4), jnp.zeros((5, 6), bool))) == 0


@pytest.mark.jit
@given(seed=st.integers(0, 2**30), shape=st.sampled_from(((1, 1), (5, 9), (40, 70))))
@settings(max_examples=50, deadline=None)
def test_known_cells_are_numpys(seed, shape):
    rng = np.random.default_rng(seed)
    hits, misses = rng.integers(0, 3, (2, *shape)) * (rng.random((2, *shape)) < 0.3)
    size = tuple((n + 1) // 2 for n in shape)
    corner = [int(rng.integers(0, n - m + 1)) for n, m in zip(shape, size)]
    square = (hits + misses)[corner[0] : corner[0] + size[0], corner[1] : corner[1] + size[1]]
    grid = Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))
    known = jax.jit(sensing.known_in, static_argnames=("size",))(grid, jnp.asarray(corner), size)
    assert int(known) == np.count_nonzero(square)
