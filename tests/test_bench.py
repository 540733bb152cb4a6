"""`jexplore bench` and the yardstick run and find right answers; how fast is no matter of a test."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image
from ref.results import result

from jexplore import bench
from jexplore.bench import engines, kernels, oracles, plots, rates, tables, timing
from jexplore.cli import main
from jexplore.config import InputError
from jexplore.policies import parse_strategy
from jexplore.report import store
from jexplore.studies.checks import ready_worlds
from jexplore.worlds.world import World, with_ring

SMALL = "cave:width_m=6.4,height_m=6.4"
YARDSTICK = Path(__file__).resolve().parents[1] / "benchmarks" / "yardstick.py"


def command(*options):
    return [sys.executable, "-m", "jexplore", "bench", *map(str, options)]


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The folder of one benchmark, and what it printed."""
    out = tmp_path_factory.mktemp("runs") / "new"
    options = ("--worlds", SMALL, "--sides", 32, "--batch-sizes", 2, "--episodes", 3)
    ended = subprocess.run(
        command(*options, "--repeat", 1, "--cache", "--out", out), capture_output=True, text=True, timeout=600
    )
    assert ended.returncode == 0, ended.stderr
    return out, ended.stdout


@pytest.fixture(scope="module")
def report(ran):
    return json.loads((ran[0] / "bench.json").read_text())


def test_files_and_tables(ran, report):
    out, said = ran
    assert sorted(path.name for path in out.iterdir()) == ["bench.json", "bench.png", "run.json"]
    with Image.open(out / "bench.png") as image:
        image.verify()
    for title in ("Kernels:", "Episodes by batch size:", "Episodes by map size:", "Programs:"):
        assert title in said
    assert "| NO |" not in said
    assert {"jexplore", "jax", "device", "cpu", "cores"} <= set(report["environment"])
    assert report["settings"]["engines"] == ["auto", "jax"]
    record = json.loads((out / "run.json").read_text())
    assert record["command"][:2] == ["jexplore", "bench"]
    assert record["measured"] == report["settings"]


def test_every_kernel_gives_the_references_answer(report):
    names = [
        *("scan", "scan and fold", "plan"),
        *("masks", "clusters", "reach", "flood", "nearest site"),
    ]
    assert [row["kernel"] for row in report["kernels"]] == names
    for row in report["kernels"]:
        assert row["references"]
        assert row["equal"] is True, row["kernel"]
        assert row["cpu_us"]["median"] >= row["cpu_us"]["min"] > 0
        if row["kernel"] == "plan":
            assert row["k"] is row["floor_us"] is None
        else:
            assert row["k"] == pytest.approx(row["floor_us"] / row["us"])
        assert row["compile_s"] > 0
    assert [row.get("side") for row in report["kernels"]] == [None] * 3 + [32] * 5


def test_both_engines_give_the_same(report):
    for rows in (report["batches"], report["sides"]):
        assert [row["engine"] for row in rows] == ["auto", "jax"]
        assert [row["level"] for row in rows] == ["native on a CPU", "JAX"]
        assert all(row["equal"] is True for row in rows)
        for row in rows:
            assert row["lanes"] is row["useful"] is None
            assert row["quality"]["complete"] == 1
            assert row["episodes_per_s"] > 0
        assert rows[1]["lane_bytes"] > 0
    assert {program["level"] for program in report["programs"]} == {"JAX"}
    assert all(program["trace_s"] > 0 and program["compile_s"] > 0 for program in report["programs"])


@pytest.mark.jit
def test_lanes_and_native_driving_are_measured_as_well(monkeypatch):
    """As of a strategy without native episodes, next to an accelerator."""
    monkeypatch.setattr(engines, "is_native", lambda *_: False)
    monkeypatch.setattr(engines, "has_lanes", lambda engine: engine == "jax")
    (world,), strategy = ready_worlds([SMALL], 0.1), parse_strategy("closest")
    wanted = [("auto", 2), ("jax", 2)]
    driven, lanes = engines.measure_episodes(engines.Compiler(), with_ring(world), strategy, wanted, 3, 1)
    assert [row["level"] for row in (driven, lanes)] == ["native driving", "JAX in lanes"]
    assert driven["equal"] is lanes["equal"] is True
    assert lanes["lanes"] == 2
    assert 0 < lanes["useful"] <= 1
    assert lanes["episodes"] == 4
    assert lanes["lane_bytes_estimate"] > 0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--worlds", "nowhere"), "'nowhere'"),
        (("--strategies", "dreams"), "'dreams'"),
        (("--engine", "warp"), "engine must be one of auto, jax, got 'warp'"),
        (("--engine",), "got none"),
        (("--batch-sizes", "0"), "batch_sizes must be an integer from 1"),
        (("--sides", "31"), "sides must be an integer from 32 to 2048, got 31"),
        (("--sides", "2049"), "sides must be an integer from 32 to 2048, got 2049"),
        (("--sides", "64", "64"), "different integers"),
        (("--sides", "x"), "--sides: Could not find valid parse"),
        (("--sides",), "sides must be one or more"),
        (("--episodes", "0"), "episodes must be an integer from 1"),
        (("--repeat", "0"), "repeat must be an integer from 1"),
        (("--lanes", "1"), "--lanes"),
    ],
)
def test_wrong_input_is_one_line_before_anything_runs(options, says, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench, "run_bench", lambda *_, **__: pytest.fail("it ran"))
    assert main.main(["bench", *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert says in said.err
    assert list(tmp_path.iterdir()) == []


def test_a_taken_folder_is_refused(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(bench, "prepare_bench", lambda **_: pytest.fail("it began"))
    store.write_json({}, tmp_path / "bench.json")
    assert main.main(["bench", "--out", str(tmp_path)]) == 2
    assert "holds a run (bench.json)" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c(tmp_path):
    out = tmp_path / "out"
    process = subprocess.Popen(command("--quick", "--out", out), stderr=subprocess.PIPE, text=True)
    time.sleep(4)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "interrupted, no results were written" in said
    assert not out.exists()


def test_defaults_suit_the_machine():
    plan = bench.prepare_bench(worlds=[SMALL], sides=[32])
    assert plan.engines == ("auto", "jax")
    assert plan.batches == dict.fromkeys(plan.engines, (1, 4, 16, 64))
    assert plan.episodes == 16
    assert plan.sized[0].shape == (32, 32)
    quick = bench.prepare_bench(quick=True, batch_sizes=[8, 2], engine=["jax"])
    assert [world.name for world in quick.worlds] == ["cave"]
    assert quick.sides == (64, 128)
    assert quick.batches == {"jax": (2, 8)}
    assert [world.shape for world in quick.sized] == [(64, 64), (128, 128)]


def test_a_wrong_kernel_is_told():
    occupied = np.ones((12, 14), bool)
    occupied[1:-1, 1:-1] = False
    world = World(occupied=occupied, name="empty")
    for kernel in kernels.whole_map(world):
        ours = kernel.step(0, None, kernel.arguments)
        answers = [reference.answer() for reference in kernel.references]
        assert all(reference.agree(ours, answer) for reference, answer in zip(kernel.references, answers)), kernel.name
        wrong = jax.tree.map(lambda a: np.asarray(a) + np.asarray(1, a.dtype), ours)
        assert not any(reference.agree(wrong, answer) for reference, answer in zip(kernel.references, answers)), (
            kernel.name
        )


def test_same_sees_one_bit():
    first, second = result(3), result(2)
    assert engines.same([first, second])
    second.known[1] += 1
    assert not engines.same([first, second])


def test_dijkstra_round_a_corner():
    # From (0, 0), next to a wall at (0, 1): the diagonal past it is no way, north and then east is.
    traversable = np.array([[1, 0, 1], [1, 1, 1]], bool)
    cost, target = oracles.dijkstra(traversable, 0, 0, np.zeros((2, 3), bool), False)
    one, far = 2**16, 2**30
    assert cost.tolist() == [[0, far, 4 * one], [one, 2 * one, 3 * one]]
    assert target == -1
    graph = oracles.motion_graph(traversable)
    assert oracles.graph_costs(graph, (2, 3), 0, 0).tolist() == cost.tolist()


def test_dijkstra_of_a_diagonal():
    graph = oracles.motion_graph(np.ones((3, 2), bool))
    one, diagonal = oracles.STRAIGHT, oracles.DIAGONAL
    expected = [[one, 0], [diagonal, one], [diagonal + one, 2 * one]]
    assert oracles.graph_costs(graph, (3, 2), 0, 1).tolist() == expected


def test_dijkstra_stops_at_the_lowest_of_equal_goals():
    goals = np.zeros((3, 3), bool)
    goals[[0, 1, 1, 2], [1, 0, 2, 1]] = True
    cost, target = oracles.dijkstra(np.ones((3, 3), bool), 1, 1, goals, True)
    assert (target, cost[1, 1], cost.reshape(-1)[target]) == (1, 0, 2**16)


def test_clusters_in_order_of_their_lowest_cell():
    frontier = np.array([[0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 0, 0]], bool)
    labels, sizes = oracles.clusters(frontier)
    assert labels.tolist() == [[-1, -1, -1, 0], [1, -1, -1, -1], [-1, 1, -1, -1]]
    assert sizes.tolist() == [1, 2]


def test_turns_go_forwards_and_backwards():
    called = []
    found = timing.interleaved({name: lambda name=name: called.append(name) or name for name in "ab"}, 3)
    assert called == ["a", "b", "b", "a", "a", "b"]
    assert [answer for answer, _ in found["b"]] == ["b"] * 3


@pytest.mark.jit
def test_a_floor_is_the_larger_of_its_parts():
    assert rates.floor_s(rates.Effort()) == 0
    assert rates.floor_s(rates.Effort(ops=1000)) == pytest.approx(1000 * rates.op_s())
    both = rates.Effort(bytes=2**14, gathers=10)
    assert rates.floor_s(both) == max(rates.copy_s(2**14), 10 * rates.gather_s())
    assert rates.copy_s(3 * 2**12) > 0


def test_table():
    text = tables.markdown(["a", "b", "c", "d"], [[None, True, 0.012345, "x|y"], [1, False, 1234.5, ""]])
    cells = [line.replace("\\|", "/").strip("|").split("|") for line in text.splitlines()]
    rows = [[cell.strip() for cell in line] for line in cells[2:]]
    assert rows == [["–", "yes", "0.0123", "x/y"], ["1", "NO", "1234", ""]]
    assert text.startswith("| a")


def test_pictures_have_logarithmic_axes(report):
    axes = plots.figure(report).axes
    assert [(ax.get_xscale(), ax.get_yscale()) for ax in axes[:3]] == [("log", "log")] * 3
    assert len(axes[2].lines) == 5


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--yardstick", "/no/such/yardstick.py"), "--yardstick"),
        (("--episodes", "0"), "--episodes"),
        (("--out", "/no/such/folder/x.json"), "--out"),
    ],
)
def test_yardstick_refuses_wrong_input(options, says):
    ended = subprocess.run([sys.executable, YARDSTICK, *options], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    assert says in ended.stderr.strip().splitlines()[-1]


def test_errors_are_the_packages_own():
    with pytest.raises(InputError, match="repeat must be an integer"):
        bench.prepare_bench(repeat=1001)
