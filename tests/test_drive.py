"""Native code that drives inside a program of JAX's: by hand, the bits of JAX, no compiler."""

import dataclasses
import os
import shutil
import subprocess
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ref import beams as oracle
from ref import episodes, maps
from ref.jobs import RULES, digest, some_jobs

import jexplore as jx
from jexplore.config import InputWarning
from jexplore.engine.backend import cache_folder
from jexplore.engine.program import Given
from jexplore.exploration import batch, environment, site
from jexplore.exploration.site import drive_for, prepare_site
from jexplore.exploration.state import Outcome, Setup
from jexplore.native import build, drive
from jexplore.policies import Strategy
from jexplore.policies.closest import closest
from jexplore.rules import Lidar
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World

RIGHT_ANGLES = Lidar(n_beams=4, fov_deg=360, range_m=3)  # looks back, right, ahead, left
LIDAR = Lidar(n_beams=37, range_m=2.0)

ROOM = maps.walls(maps.ROOM)

needs_compiler = pytest.mark.skipif(not build.find_compiler(), reason="no C++ compiler")


@pytest.fixture(scope="module")
def target():
    found = drive.load_driving()
    assert found.loaded is not None, found.why_not
    return found.name


def setting(native, occupied=ROOM, lidar=RIGHT_ANGLES, start=(1, 2, 0)):
    """`(setup, given)` of an episode of `closest`, cells of a metre."""
    strategy, rules = Strategy("closest", closest(), False), jx.Rules(clearance_m=0, near_m=0)
    setup = Setup(strategy.policy._replace(params=()), 1, False, 100, native=native)
    truth, beams = jax.tree.map(jnp.asarray, (
        episodes.truth_of(occupied, None, occupied.shape), episodes.beams_of(lidar, 1.0, occupied.shape[1], None)
    ))  # fmt: skip
    numbers = jax.tree.map(jnp.asarray, episodes.numbers_of(strategy, lidar, rules, 1.0, 20, episodes.ROBOT))
    return setup, Given(jax.random.key(0), beams, truth, jnp.int32(0), numbers, jnp.asarray(start, jnp.int32))


def assert_equal(one, other):
    """Arrays alone: a belief says which native code plans with it."""
    for ours, theirs in zip(jax.tree.leaves(jax.device_get(one)), jax.tree.leaves(jax.device_get(other)), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def begun(setup, given):
    return jax.jit(environment.begin, static_argnums=0)(setup, given)


# ---------------------------------------------------------------- by hand


@needs_compiler
@pytest.mark.jit
@pytest.mark.parametrize(
    ("own", "row_1", "row_0"),
    [
        ({}, "#.....?", "??#????"),  # ahead the range of 3 cells ends the beam after 3 cells entered
        ({"no_echo": "unknown"}, "#..????", "??#????"),  # ahead nothing is seen within 3 cells
        ({"min_range_m": 1}, "#.....?", "???????"),  # the wall to the right is half a cell away
    ],
)
def test_the_first_scan_by_hand(target, own, row_1, row_0):
    state = begun(*setting(target, lidar=dataclasses.replace(RIGHT_ANGLES, **own)))
    found = maps.picture(np.asarray(state.belief.grid.hits), np.asarray(state.belief.grid.misses))
    assert found == ["??#????", "??.????", "??.????", row_1, row_0]
    if not own:
        assert (int(state.n_known), int(state.scans)) == (10, 1)
        assert state.trail[0].tolist() == [8 * (1 * 7 + 2), 10, 0]


@pytest.mark.slow
@needs_compiler
@pytest.mark.jit
@pytest.mark.parametrize(
    "own",
    [
        {"forward_m": 0.25, "min_range_m": 0.3},
        {"forward_m": -0.1, "left_m": 0.2, "yaw_deg": 30, "no_echo": "unknown"},
        {"left_m": 0.15, "yaw_deg": 180, "fov_deg": 360, "min_range_m": 0.05},
    ],
)
def test_episodes_of_a_mounted_scanner_as_the_simulator(target, own):
    """The oracle's scans, with JAX and native code driving."""
    lidar = Lidar(**{"n_beams": 37, "range_m": 2.0, **own})
    world = jx.load_world("rooms:width_m=6,height_m=5", cell_m=0.1)
    start, how = tuple(draw_starts(world, 3, 1, 0.2)[0].tolist()), {"cell_m": 0.1}
    episode = world.occupied, start, "closest+recheck", lidar, jx.Rules(clearance_m=0.2)
    want = episodes.replay(*episode, **how, sense=lambda *pose: oracle.mounted_scan(world.occupied, *pose, lidar, 0.1))
    assert want.steps > 20
    for native in (False, True):
        assert episodes.differences(*episodes.play(*episode, **how, native=native), want, **how) == []


@needs_compiler
@pytest.mark.jit
def test_a_map_without_walls_all_round_is_refused(target):
    occupied = ROOM.copy()
    occupied[2, 6] = False
    with pytest.raises(jax.errors.JaxRuntimeError, match="a robot must be on a map with walls all round"):
        jax.block_until_ready(begun(*setting(target, occupied)))


# ---------------------------------------------------------------- compared with JAX


@needs_compiler
@pytest.mark.jit
def test_jax_goes_on_where_native_code_has_driven(target):
    """Known cells are counted right, whoever counted them before."""

    def turn(setup, given, state):
        carry, choice, route = environment.decide(setup, given, state)
        return environment.commit(setup, given, state.replace(carry=carry), choice, route)

    turn, go = (jax.jit(f, static_argnums=0) for f in (turn, environment.drive))
    occupied, _ = maps.cluttered(1, 24, 26)
    start = (*episodes.clear_cells(occupied, 0)[0], 0)
    (own, given), (other, _) = (setting(native, occupied, LIDAR, start) for native in (target, None))
    mixed, reference = begun(own, given), begun(other, given)
    for plan in range(40):
        assert_equal(mixed, reference)
        if reference.outcome != Outcome.RUNNING:
            break
        mixed = go(own if plan % 2 else other, given, turn(other, given, mixed))
        reference = go(other, given, turn(other, given, reference))
    assert plan > 4


@needs_compiler
@pytest.mark.jit
@pytest.mark.parametrize(
    "name",
    [
        "closest",
        pytest.param("gain-rate+recheck:samples=60", marks=pytest.mark.slow),
        pytest.param("distance-advantage+recheck", marks=pytest.mark.slow),
    ],
)
def test_episodes_have_the_same_bits(target, name, monkeypatch):
    """A strategy of JAX's; one that says whether its view points are live; one that chooses among clusters."""
    jobs = some_jobs([name])
    assert (jobs[0].strategy.policy.live is not None) == name.startswith("gain")
    monkeypatch.setattr(batch, "is_native", lambda *_: False)
    ran = [batch.run_jobs(jobs, LIDAR, RULES, engine=engine, workers=2, keep="maps") for engine in ("jax", "auto")]
    assert [report.costs.levels for report in ran] == [{name: ["JAX"]}, {name: ["native driving"]}]
    assert digest(ran[0]) == digest(ran[1])
    assert_equal(*([outcomes.records for outcomes in report.outcomes] for report in ran))
    assert max(outcomes.result.scans.max() for outcomes in ran[0].outcomes) > 20


@pytest.mark.slow
@needs_compiler
@pytest.mark.jit
def test_steps_of_an_environment_have_the_same_bits(target, monkeypatch):
    occupied, rooms = maps.cluttered(1, 40, 44)

    def steps(native):
        monkeypatch.setattr(site, "load_driving", lambda: build.Library(None, name=native))
        env = jx.Environment(
            World(occupied=occupied, rooms=rooms, name="cluttered"), lidar=LIDAR, recheck=True, paths=True
        )
        keys = jax.random.split(jax.random.key(1), 2)
        state, view = jax.vmap(env.reset)(keys)
        found = []
        for _ in range(3):
            cost = jnp.where(view.frontier, view.cost, 2**30).reshape(2, -1)
            action = jnp.stack(jnp.divmod(jnp.argmin(cost, axis=1), view.cost.shape[-1]), axis=1).astype(jnp.int32)
            state, view, *told = jax.vmap(env.step)(keys, state, action)
            found.append((state.episode, view, told))
        return found

    ours, theirs = steps(target), steps(None)
    assert_equal(ours, theirs)
    assert int(jnp.min(ours[-1][0].scans)) > 2


# ---------------------------------------------------------------- who is driven by it


@needs_compiler
@pytest.mark.jit
def test_one_robot_on_a_cpu_is_driven_by_native_code(target):
    assert drive_for("cpu").name == target
    assert drive_for("gpu").name is None


@needs_compiler
def test_a_noisy_scanner_is_left_to_jax(target):
    world = some_jobs()[0].world
    for sigma_m, own in ((0.0, target), (0.03, None)):
        assert prepare_site(world, Lidar(sigma_m=sigma_m), RULES, native=target).setup.native == own


@pytest.mark.slow
def test_without_jit_nothing_is_built_or_called():
    assert drive_for("cpu").name is None
    (setup, given), (as_jax, _) = setting("no such target"), setting(None)
    assert_equal(environment.begin(setup, given), environment.begin(as_jax, given))


# ---------------------------------------------------------------- building


@pytest.mark.jit
@pytest.mark.usefixtures("forgetful")
def test_no_compiler_is_told_once_and_jax_drives(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    text = r"^no C\+\+ compiler was found: expected one of c\+\+, .* in CXX: JAX does without native code"
    with pytest.warns(InputWarning, match=text) as told:
        assert drive_for("cpu").name is None
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert drive_for("cpu").name is None


@pytest.mark.usefixtures("forgetful")
@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
def test_a_compiler_that_fails_is_told_in_one_line(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiler = tmp_path / "fails"
    # Its first line is not UTF-8.
    compiler.write_text("#!/bin/sh\nprintf '\\377\\n' >&2\necho 'look.cpp:1: error: no such thing' >&2\nexit 1\n")
    compiler.chmod(0o755)
    for command, why in (
        (str(compiler), f"{compiler} could not build drive.cc: look.cpp:1: error: no such thing"),
        ("false", "false could not build drive.cc: exit status 1"),
        ("no-such-compiler", "drive.cc could not be built by no-such-compiler or loaded: [Errno 2]"),
        ("c++ '-O2", 'CXX must be a command, got "c++ \'-O2": no closing quotation'),
    ):
        monkeypatch.setenv("CXX", command)
        found = drive.load_driving()
        assert found.loaded is None
        assert found.why_not.startswith(why)
    assert sorted(path.name for path in (tmp_path / "jexplore").iterdir()) == []


@pytest.mark.usefixtures("forgetful")
def test_a_folder_that_cannot_be_made_is_told(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    found = drive.load_driving()
    assert found.loaded is None
    assert "drive.cc could not be built" in found.why_not or "no C++ compiler" in found.why_not


@needs_compiler
def test_it_is_built_once(target, forgetful, monkeypatch):
    """Another process finds it, and its compiler is not asked."""
    monkeypatch.setattr(subprocess, "run", None)
    assert drive.load_driving().name == target


@needs_compiler
def test_what_does_not_load_is_built_anew(target, forgetful, monkeypatch, tmp_path):
    whole = cache_folder() / f"{target}.so"
    monkeypatch.setattr(build.subprocess, "run", lambda command, **_: shutil.copy(whole, command[-1]))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "jexplore").mkdir()
    library = tmp_path / "jexplore" / f"{target}.so"
    library.write_bytes(b"not whole")
    assert drive.load_driving().name == target
    assert library.stat().st_size > 1000
