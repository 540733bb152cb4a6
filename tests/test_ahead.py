"""Programs compiled for a GPU that is not there: their texts read, their launches counted, their lanes simulated."""

import functools
import json
import os
import subprocess
import sys

import hypothesis.strategies as st
import jax
import numpy as np
import pytest
from hypothesis import given

from jexplore import planning
from jexplore.bench.ahead import estimate, hlo, launches, schedule, targets
from jexplore.bench.ahead.schedule import Plans
from jexplore.bench.engines import LIDAR, RULES, SEED
from jexplore.cli import main
from jexplore.config import Assumptions, InputError
from jexplore.engine import plugins
from jexplore.engine.lanes import SPAN
from jexplore.engine.lockstep import Group
from jexplore.exploration.site import kernels_for, line_of, prepare_site
from jexplore.grid import radius_d2
from jexplore.policies import parse_strategy
from jexplore.reach import ROUNDS, STRAIGHT
from jexplore.studies.checks import ready_worlds
from jexplore.worlds.starts import draw_starts

SMALL = "cave:width_m=6.4,height_m=6.4"

HLO = """HloModule jit_go_on, is_scheduled=true

%added (a: s32[], b: s32[]) -> s32[] {
  %a = s32[] parameter(0)
  %b = s32[] parameter(1)
  ROOT %sum = s32[] add(%a, %b)
}

%fused_scatter (map: s32[4,100], at: s32[10,2]) -> s32[4,100] {
  %map = s32[4,100]{1,0} parameter(0)
  %at = s32[10,2]{1,0} parameter(1)
  %one = s32[] constant(1)
  %ones = s32[10,1,1]{2,1,0} broadcast(%one), dimensions={}
  ROOT %put = s32[4,100]{1,0} scatter(%map, %at, %ones), update_window_dims={1,2}, to_apply=%added
}

%fused_gather (map: s32[4,100], at: s32[2]) -> s32[2,100] {
  %map.1 = s32[4,100]{1,0} parameter(0)
  %at.1 = s32[2]{0} parameter(1)
  ROOT %rows = s32[2,100]{1,0} gather(%map.1, %at.1), offset_dims={1}, slice_sizes={1,100}
}

%fused_cells (map: s32[4,100], at: s32[2]) -> s32[2,1] {
  %map.3 = s32[4,100]{1,0} parameter(0)
  %at.3 = s32[2]{0} parameter(1)
  %rows.3 = s32[2,1,100]{2,1,0} gather(%map.3, %at.3), offset_dims={1,2}, slice_sizes={1,100}
  %flat.3 = s32[2,100]{1,0} bitcast(%rows.3)
  ROOT %cells = s32[2,1]{1,0} gather(%flat.3, %at.3), offset_dims={1}, slice_sizes={1,1}
}

%step (s: (s32[], s32[4,100], pred[4])) -> (s32[], s32[4,100], pred[4]) {
  %s = (s32[], s32[4,100]{1,0}, /*index=2*/pred[4]{0}) parameter(0)
  %map.2 = s32[4,100]{1,0} get-tuple-element(%s), index=1
  %rest = s32[10,2]{1,0} constant({...})
  %scattered = s32[4,100]{1,0} fusion(%map.2, %rest), kind=kInput, calls=%fused_scatter
  %copied = s32[4,100]{1,0} copy(%scattered)
  ROOT %out = (s32[], s32[4,100]{1,0}, pred[4]{0}) tuple(%copied)
}

ENTRY %main (x: s32[4,100], at: s32[2]) -> s32[2,100] {
  %x = s32[4,100]{1,0} parameter(0)
  %y = s32[2]{0} parameter(1)
  %s.1 = (s32[], s32[4,100]{1,0}, /*index=2*/pred[4]{0}) tuple(%x)
  %outer = (s32[], s32[4,100]{1,0}, pred[4]{0}) while(%s.1), condition=%c, body=%step, metadata={op_name="jit(go_on)/while/body/decide/while/body/vmap(map)/while/body/vmap(wave)/while" stack_frame_id=3}
  %inner = (s32[], s32[4,100]{1,0}, pred[4]{0}) while(%outer), condition=%c, body=%step, metadata={op_name="jit(go_on)/while"}, backend_config={"known_trip_count":{"n":"4"}}
  %picked = s32[2,1]{1,0} fusion(%x, %y), kind=kLoop, calls=%fused_cells
  ROOT %gathered = s32[2,100]{1,0} fusion(%x, %y), kind=kLoop, calls=%fused_gather
}
"""  # noqa: E501

THUNKS = """001: kCopy  [source       | next=002 (1)] kCopy
002: kWhile [prev=001 (1) | sink        ]   \ncondition:
    003: kCustomKernel [source | sink] is_going grid: [1, 1, 1] threads: [32, 1, 1]  shared_memory: 0 bytes
  body:
    004: kCustomKernel [source | sink] scattered grid: [3, 2, 1] threads: [32, 1, 1]  shared_memory: 0 bytes
    005: kWhile [prev=001 (1) | sink        ]   \ncondition:
            No thunks.          body:
        000: kCommandBuffer [source | sink] \n            006: kCopy         [source       | sink ] kCopy
            007: kCustomKernel [source | sink] gathered grid: [1, 1, 1] threads: [64, 1, 1]  shared_memory: 0 bytes
    008: kCopy         [source       | sink ] kCopy
009: kCustomKernel  [prev=038 (1) | sink ] gathered grid: [1, 1, 1] threads: [64, 1, 1]  shared_memory: 0 bytes
"""

NAMES = {1: "copied", 2: "outer", 3: "c", 4: "scattered", 5: "inner", 6: "copied", 7: "gathered", 8: "copied",
         9: "gathered"}  # fmt: skip
METADATA = "".join(
    f'thunk_metadata {{\n  thunk_info {{\n    profile_annotation: "{name}"\n    thunk_id: {n}\n  }}\n}}\n'
    for n, name in NAMES.items()
)
PTX = {
    "scattered": ".visible .entry scattered(\n)\n{\n atom.relaxed.gpu.global.cas.b32 %r1, [%rd1], %r2, %r3;\n}",
    "gathered": ".visible .entry gathered(\n)\n{\n atom.global.add.u32 %r1, [%rd1], 1;\n}",
}


@pytest.fixture(scope="module")
def module():
    return hlo.Module(HLO)


@pytest.fixture(scope="module")
def steps(module):
    return launches.read(THUNKS, METADATA, module)


# ---------------------------------------------------------------- texts


def test_loops_have_their_scopes_and_turns(module):
    assert module.loops == {"outer": (None, "decide/map/wave"), "inner": (4, "")}


@pytest.mark.parametrize(
    ("op_name", "scope"),
    [
        ("jit(f)/while", ""),
        ("jit(f)/while/body/advance/vmap(recount)/while", "advance/recount"),
        ("jit(f)/while/body/fill/while/body/vmap(jit(searchsorted))/jit(g)/while", "fill"),
        ("jit(f)/while/body/vmap(vmap(wave))/while/body/closed_call/vmap()/while", "wave"),
    ],
)
def test_scopes_are_what_is_named(op_name, scope):
    assert hlo.scope_of(op_name) == scope


def test_traffic_by_hand(module):
    # Ten writes of 4 bytes, read and written, at ten places of 8 bytes each; the rest of the map is untouched.
    assert module.traffic("scattered") == (2 * 40 + 80, 10)
    # Two rows of 400 bytes read and written, and where they are.
    assert module.traffic("gathered") == (800 + 800 + 8, 0)
    # Of two rows one cell each: 8 bytes read, 8 written, and twice where they are, which lies in 8 bytes.
    assert module.traffic("picked") == (8 + 8 + 8, 0)
    assert module.traffic("copied") == (3200, 0)
    assert module.traffic("nobody") == (0, 0)
    assert module.has_axis("scattered", 4)
    assert not module.has_axis("gathered", 100)


@given(st.lists(st.tuples(st.sampled_from([("pred", 1), ("s8", 1), ("bf16", 2), ("s32", 4), ("u64", 8)]),
                          st.lists(st.integers(0, 9), max_size=3)), max_size=4))  # fmt: skip
def test_bytes_of_any_shape(arrays):
    texts = [f"{kind}[{','.join(map(str, dims))}]{{0}}" for (kind, _), dims in arrays]
    want = sum(size * int(np.prod(dims)) for (_, size), dims in arrays)
    assert hlo.bytes_of(f"({', '.join(texts)})") == want


def test_launches_by_hand(steps):
    copy, outer, last = steps
    assert copy == launches.Launch("copied", "", 0)
    assert last == launches.Launch("gathered", "gathered", 1, 64)
    assert (outer.name, outer.scope, outer.trips) == ("outer", "decide/map/wave", None)
    scattered, inner, _ = outer.body
    assert (scattered.blocks, scattered.threads) == (6, 192)
    assert (inner.trips, inner.condition) == (4, [])
    assert inner.body == [launches.Graph([copy, last])]
    # The condition, the scatter, four times two, the copy.
    assert launches.per_iteration(outer) == 1 + 1 + 8 + 1
    # A loop over data counts with one look at its condition.
    assert launches.per_turn(steps) == 3
    assert [loop.name for loop in launches.loops(steps)] == ["outer"]


def test_a_loop_in_a_graph_is_none_of_the_hosts(steps):
    assert [loop.name for loop in launches.host_decided(steps)] == ["outer"]
    graph = [launches.Graph(steps)]
    assert launches.host_decided(graph) == []
    assert [loop.name for loop in launches.loops(graph)] == ["outer"]


def test_slow_kernels_are_named(steps, module):
    assert launches.cas_loops(PTX, steps) == ["scattered"]
    assert [launches.kernel_of(text) for text in (*PTX.values(), "")] == ["scattered", "gathered", ""]
    # One block that moves 1608 bytes for an array whose leading axis is 2: 804 a lane.
    assert launches.single_blocks(steps, module, 2) == ["gathered"]
    assert launches.single_blocks(steps, module, 4) == []


@pytest.mark.parametrize("text", ["nonsense", "001: kWhile [a | b]\nbody:\n    002: kCopy [a | b] kCopy\n"])
def test_texts_of_another_form_are_refused(text, module):
    with pytest.raises(ValueError, match="expected"):
        launches.read(text, METADATA, module)


# ---------------------------------------------------------------- schedules


def plans(*moves, glances=(), pieces=()):
    n = len(moves)
    glances, pieces = (np.array([*some, *[0] * (n - len(some))]) for some in (glances, pieces))
    return Plans(np.array(moves), np.full(n, 3 * ROUNDS * STRAIGHT), np.arange(n) < n - 1, glances, pieces)


def test_a_schedule_by_hand(monkeypatch):
    """Two lanes, of which one is glanced at in a turn, one slot, three episodes: 2 steps and an end, which takes a
    search of two pieces; a step and an end; an end at once.
    """
    monkeypatch.setattr(schedule, "SPAN", 1)
    recorded = [plans(2, 0, glances=[0, 1], pieces=[0, 2]), plans(1, 0), plans(0)]
    done = schedule.simulate(recorded, np.array([0, 1, 2]), 2, 1)
    # Turn 1: both start, lane 0 decides and steps. 2: lane 1 decides, both step. 3: lane 0 is glanced at, nothing is
    # settled, the first piece. 4: the second piece, with which it ends; lane 1 decides its end. 5: both are measured,
    # the third episode starts and ends at once. 6: it is measured, and nothing is left to do.
    assert (done.turns, done.advanced, done.fills, done.glanced) == (6, 3, 5, 5)
    assert done.busy == 3 / 12
    assert done.full == 5 / 6


def test_without_glances_slots_are_taken(monkeypatch):
    monkeypatch.setattr(schedule, "SPAN", 1)
    done = schedule.simulate([plans(1, 0, pieces=[2, 1])], np.array([0]), 1, 0)
    # Two turns of a search, the second with a step; a third for the end; a fourth in which it is measured.
    assert (done.turns, done.advanced, done.glanced) == (4, 1, 3)


@pytest.mark.parametrize("n_glances", [0, 2])
def test_all_work_is_done_in_whatever_order(n_glances):
    rng = np.random.default_rng(3)
    recorded = []
    for _ in range(5):
        moves = rng.integers(0, 6, rng.integers(1, 9))
        glances = rng.integers(0, n_glances + 1, len(moves))
        recorded.append(plans(*moves, glances=glances, pieces=(glances == n_glances) * rng.integers(1, 5, len(moves))))
    queue = rng.integers(0, 5, 40)
    for n_lanes in (1, 7, 64):
        done = schedule.simulate(recorded, queue, n_lanes, n_glances)
        assert done.advanced == sum(recorded[i].moves.sum() for i in queue)
        needed = sum(len(recorded[i].moves) if n_glances else recorded[i].pieces.sum() for i in queue)
        assert done.glanced == needed
        assert 0 < done.full <= 1


@pytest.mark.jit
@pytest.mark.parametrize(("n_lanes", "windows"), [(3, (32,)), (16, ()), (7, (32, 48))])
def test_the_simulation_is_the_engine(n_lanes, windows, monkeypatch):
    """Turns, lanes that advanced, glances: those that the engine counts."""
    monkeypatch.setattr(planning, "WINDOWS", {0: windows})
    world, strategy, n = ready_worlds([SMALL], 0.1)[0], parse_strategy("closest+recheck"), 24
    site = prepare_site(world, LIDAR, RULES, kernels_for("lockstep", "gpu"))
    assert site.setup.windows == windows
    starts = draw_starts(world, SEED, n, RULES.clearance_m)
    line = line_of(site, site.with_strategy(strategy), starts, SEED, np.arange(n))
    group = Group([line], jax.local_devices()[:1])
    queue = jax.tree.map(lambda a: a[0], group.queue())
    lanes = jax.jit(functools.partial(group.engine.empty, n_lanes=n_lanes))(queue, group.common)
    lanes, usage = jax.jit(group.engine.go_on)(lanes, queue, np.int32(10**6), group.common)
    assert int(lanes.done) == n
    recorded = schedule.record(world, strategy, n)
    done = schedule.simulate(recorded, np.arange(n), n_lanes, len(windows))
    assert (done.turns, done.advanced, done.glanced) == tuple(map(int, (usage.turns, usage.advanced, usage.decided)))
    results = lanes.results[0]
    assert [len(one.moves) for one in recorded] == np.asarray(results.plans)[:n].tolist()
    assert not any(one.found[-1] for one in recorded)
    assert all(one.found[:-1].all() for one in recorded)
    assert {i for one in recorded for i in one.glances.tolist()} == set(range(len(windows) + 1))


# ---------------------------------------------------------------- estimates


def test_turns_of_loops_by_hand():
    """Eight turns, lanes filled three times, twelve cells to the farthest."""
    turns = estimate.loop_turns([plans(2, 0)], schedule.Schedule(8, 2, 3, 2, 1, 1, 1))
    assert turns == {"": (1, 8 / SPAN), "fill": (8 / SPAN, 3), "fill/flood": (3, 3 * (1.5 + 2))}


def test_writes_one_by_one(steps, module):
    assume = Assumptions(sync_us=0, launch_us=0, graph_us=0, node_us=0, bandwidth_tb_s=1e6, atomics_g_s=1e-9)
    turns = {"decide/map/wave": estimate.Turns(1, 1)}
    done = estimate.Estimator(module, targets.TARGETS["h100"], assume, turns).run(steps)
    # Ten writes, by six blocks of 132 processors.
    assert done.atomics == pytest.approx(10 * 132 / 6)


def test_an_estimate_by_hand(steps, module):
    """A sync costs 1000 s, a launch 100, a graph 10, a node in it 1; bytes cost nothing to speak of."""
    assume = Assumptions(sync_us=1e6, launch_us=1e5, graph_us=1e4, node_us=1e3, bandwidth_tb_s=1e6, atomics_g_s=1e6)
    turns = {"decide/map/wave": estimate.Turns(1, 2)}
    done = estimate.Estimator(module, targets.TARGETS["h100"], assume, turns).run(steps)
    # Three looks, two turns.
    assert done.n_syncs == 3
    assert done.syncs == pytest.approx(3)
    # Outside the graph two launches, three conditions, two scatters and two copies; two turns of four graphs of two.
    assert done.launches == pytest.approx(0.1 * (2 + 3 + 2 + 2) + 8 * (0.01 + 2 * 0.001))
    assert done.total == pytest.approx(done.syncs + done.launches, rel=1e-3)
    both = estimate.Seconds(1, 2, 3, 4, 5, 6).plus(estimate.Seconds(1, 1, 1, 1, 1, 1), 2)
    assert both == estimate.Seconds(3, 4, 5, 6, 7, 8)


def test_instructions_that_bytes_do_not_hide_by_hand(steps, module):
    """The last kernel: 64 threads of one instruction each, by one of 132 processors; a copy has none."""
    assert [launches.instructions_of(text) for text in (*PTX.values(), "")] == [1, 1, 0]
    assert launches.instructions_of(".entry a(\n)\n{\n .reg .b32 %r<2>;\n// no;\n$L: \n @%p bra $L;\n ret;\n}") == 2
    free = {"sync_us": 0, "launch_us": 0, "graph_us": 0, "node_us": 0, "atomics_g_s": 1e6}
    for bandwidth, want in ((1e6, 132.0), (1e-12 * 1608 * 2, 132 - 66.0), (1e-12 * 1608 / 2, 0.0)):
        assume = Assumptions(**free, bandwidth_tb_s=bandwidth, instructions_t_s=64e-12)
        done = estimate.Estimator(module, targets.TARGETS["h100"], assume, {}, kernels=PTX).run(steps[2:])
        assert done.instructions == pytest.approx(want, abs=1e-3)
    # A text without an entry is of no name, as the code of a copy is; nothing is hidden by bytes here.
    assume = Assumptions(**free, bandwidth_tb_s=1e6, instructions_t_s=64e-12)
    kernels = {**PTX, "": PTX["gathered"]}
    for threads, want in ((steps[0].threads, 0.0), (64, 1.0)):
        copy = steps[0]._replace(threads=threads)
        done = estimate.Estimator(module, targets.TARGETS["h100"], assume, {}, kernels=kernels).run([copy])
        assert done.instructions == pytest.approx(want, abs=1e-3)


def test_few_blocks_have_a_share_of_the_device(steps, module):
    """A kernel of one block reads 1608 bytes at a 132nd of the rate."""
    assume = Assumptions(sync_us=0, launch_us=0, graph_us=0, node_us=0, bandwidth_tb_s=1e-12 * 1608)
    done = estimate.Estimator(module, targets.TARGETS["h100"], assume, {}).run(steps[2:])
    assert done.total == pytest.approx(132)
    assume = Assumptions(0, 0, 0, 0)
    done = estimate.Estimator(module, targets.TARGETS["h100"], assume, {}).run(steps[:1])
    assert done.total == pytest.approx(3200 / (0.84 * 3352e9))


# ---------------------------------------------------------------- targets, wrong input


def test_a_target_says_its_drivers_version():
    assert 'driver_version: "12.9.0"' in targets.describe(targets.TARGETS["h100"], 12)
    text = targets.describe(targets.TARGETS["a100"], 13)
    assert 'driver_version: "13.9.0"' in text
    assert "{ major: 8 minor: 0 }" in text
    assert text.count("{") == text.count("}")


FITTING = {"jax-cuda13-plugin": "0.10.2", "jax-cuda13-pjrt": "0.10.2", "nvidia-cuda-nvcc": "13.0.48"}


def test_packages_that_fit_are_taken():
    assert targets.cuda_of(FITTING, "0.10.2") == 13
    old = {"jax-cuda12-plugin": "1.0", "jax-cuda12-pjrt": "1.0", "nvidia-cuda-nvcc-cu12": "12.9"}
    assert targets.cuda_of(old, "1.0") == 12


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"jax-cuda13-plugin": None}, "needs JAX's CUDA plugin: install jexplore.gpu-compile."),
        ({"jax-cuda13-pjrt": None}, "jax-cuda13-pjrt must be of jaxlib's version 0.10.2, got none"),
        ({"jax-cuda13-plugin": "0.11.0"}, "jax-cuda13-plugin must be of jaxlib's version 0.10.2, got 0.11.0"),
        ({"nvidia-cuda-nvcc": None}, "needs CUDA 13's compiler nvidia-cuda-nvcc, got none"),
        ({"nvidia-cuda-nvcc": "12.9.1"}, "needs CUDA 13's compiler nvidia-cuda-nvcc, got 12"),
    ],
)
def test_packages_that_do_not_fit_are_refused(changes, says):
    packages = {name: own for name, own in (FITTING | changes).items() if own is not None}
    with pytest.raises(InputError, match=says):
        targets.cuda_of(packages, "0.10.2")


def test_a_plugin_that_does_not_load_is_one_line(monkeypatch, capsys):
    def fail(**_):
        raise RuntimeError("libcuda\nis broken")

    monkeypatch.setattr("jax.experimental.topologies.get_topology_desc", fail)
    monkeypatch.setattr(targets, "cuda_of", lambda *_: 13)
    assert main.main(["bench", "--target", "h100"]) == 2
    said = capsys.readouterr().err
    assert said == (
        "jexplore: error: JAX's CUDA plugin does not load (libcuda is broken): install jexplore[gpu-compile]\n"
    )


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--target", "h10"], "target must be one of h100, h200, a100, got 'h10'"),
        (["--target", "h100", "--sides", "64"], "--sides is for measurements, got it with --target"),
        (["--target", "h100", "--quick"], "--cache and --quick are for measurements, got one with --target"),
        (["--target", "h100", "--batch-sizes", "0"], "batch-sizes must be an integer from 1 to 65536, got 0"),
        (["--target", "h100", "--assume.sync-us", "-1"], "assume.sync_us must be a number at least 0 "),
        (["--target", "h100", "--assume.atomics-g-s", "0"], "assume.atomics_g_s must be a number above 0 "),
        (["--target", "h100", "--assume.instructions-t-s", "0"], "assume.instructions_t_s must be a number above 0 "),
        (["--graphs"], "--graphs and --assume are for --target, got none"),
    ],
)
def test_wrong_options_are_one_line(options, says, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main.main(["bench", *options]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"jexplore: error: {says}")
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_plugin_without_a_gpu_is_kept_quiet(monkeypatch, tmp_path):
    """Where a plugin lies and no driver, JAX is kept to the CPU, unless somebody has said what it is to use."""
    (tmp_path / "jax_plugins" / "xla_cuda13").mkdir(parents=True)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setattr(sys, "platform", "linux")
    for name in [name for name in sys.modules if name.split(".")[0] == "jax_plugins"]:
        monkeypatch.delitem(sys.modules, name)
    assert plugins.is_idle(driver=(str(tmp_path / "nvidiactl"),))
    assert not plugins.is_idle(driver=(str(tmp_path),))
    monkeypatch.setattr(plugins, "is_idle", lambda: True)
    for before, after in ((None, "cpu"), ("cuda", "cuda")):
        monkeypatch.delenv("JAX_PLATFORMS", raising=False)
        if before is not None:
            monkeypatch.setenv("JAX_PLATFORMS", before)
        plugins.keep_to_cpu()
        assert plugins.os.environ["JAX_PLATFORMS"] == after


# ---------------------------------------------------------------- the real compiler


def missing():
    """What is missing to compile for a GPU; "" for nothing."""
    try:
        targets.cuda_of(targets.installed(), jax.lib.__version__)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.jit
@pytest.mark.skipif(bool(missing()), reason=missing())
def test_counts_of_the_program_compiled_for_an_h100(tmp_path):
    """A map that is just wide enough for glances."""
    world, out = "cave:width_m=12.8,height_m=9.6", tmp_path / "new"
    options = ("--target", "h100", "--worlds", world, "--batch-sizes", "64", "--episodes", "2", "--out", out)
    command = [sys.executable, "-m", "jexplore", "bench", *options]
    # As users compile: the tests' options of XLA, which leave out the pass that counts turns of loops, are for CPUs.
    env = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    ended = subprocess.run(command, env=env, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr
    (row,) = json.loads((out / "bench.json").read_text())["programs"]
    assert planning.windows(row["padded_shape"], radius_d2(RULES.clearance_m, 0.1)) == [64]
    assert set(row["launches_per_iteration"]) == {"turn", "fill", "fill/flood"}
    assert row["host_loops"] == 3
    # Episodes of so small a world are short, and lanes are filled more often than in the built-in ones (fewer than 2).
    assert 0 < row["host_syncs_per_turn"] <= 3
    assert 0 < row["launches_per_turn"] <= 260
    assert len(row["single_block_kernels"]) <= 1
    assert row["cas_loops"] == []
    assert row["lane_bytes_estimate"] == pytest.approx(row["lane_bytes"], rel=0.2)
    assert row["episodes_per_s"] > 0
