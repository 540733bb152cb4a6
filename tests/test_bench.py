"""`jexplore bench` and the yardstick run and find right answers; how fast is no matter of a test."""

import json
import runpy
from pathlib import Path

import pytest
from ref.results import result

from jexplore import bench
from jexplore.cli import main
from jexplore.engine.runner import Costs
from jexplore.exploration.batch import Outcomes
from jexplore.native.build import find_compiler

SMALL = "cave:width_m=6.4,height_m=6.4"
YARDSTICK = Path(__file__).resolve().parents[1] / "benchmarks" / "yardstick.py"


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.skipif(not find_compiler(), reason="no C++ compiler")
def test_both_engines_are_measured_and_give_the_same(tmp_path, capsys):
    out = tmp_path / "new"
    options = ("--worlds", SMALL, "--batch-sizes", 2, "--repeat", 1, "--cache")
    assert not main.main(["bench", *map(str, options), "--out", str(out)])
    said = capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir()) == ["bench.json", "run.json"]
    assert "| NO |" not in said
    report, record = (json.loads((out / name).read_text()) for name in ("bench.json", "run.json"))
    assert {"jexplore", "jax", "device", "cpu", "cores"} <= set(report["environment"])
    assert record["command"][:2] == ["jexplore", "bench"]
    assert record["measured"] == report["settings"]
    rows = report["batches"]
    assert [row["engine"] for row in rows] == ["auto", "jax"]
    assert [row["level"] for row in rows] == ["native on a CPU", "JAX"]
    for row in rows:
        assert row["equal"] is True
        assert row["episodes"] == 2
        assert row["quality"]["complete"] == 1
        assert row["episodes_per_s"] > 0
    assert [row["compile_s"] > 0 for row in report["batches"]] == [False, True]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--engine", "warp"), "engine must be one of auto, jax, got 'warp'"),
        (("--engine",), "got none"),
        (("--batch-sizes", "64", "64"), "different integers"),
        (("--batch-sizes",), "batch_sizes must be one or more"),
    ],
)
def test_wrong_input_is_one_line_before_anything_runs(options, says, refuses, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench, "run_bench", lambda *_, **__: pytest.fail("it ran"))
    refuses(["bench", *options], says)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_leaves_nothing(tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(bench, "run_once", interrupted)
    out = tmp_path / "out"
    assert main.main(["bench", "--worlds", SMALL, "--out", str(out)]) == 130
    assert "interrupted, no results were written" in capsys.readouterr().err
    assert not out.exists()


def test_defaults_suit_the_machine(monkeypatch):
    plan = bench.prepare_bench(worlds=[SMALL])
    assert plan.batches == dict.fromkeys(("auto", "jax"), (1, 4, 16, 64))
    quick = bench.prepare_bench(quick=True, batch_sizes=[8, 2], engine=["jax"])
    assert [job.world.name for job in quick.jobs] == ["cave"]
    assert quick.batches == {"jax": (2, 8)}
    monkeypatch.setattr(bench, "has_lanes", lambda engine: engine == "jax")
    assert bench.prepare_bench(worlds=[SMALL]).batches["jax"][-1] == 4096


def test_lanes_are_filled_again_and_one_other_bit_is_told(monkeypatch):
    monkeypatch.setattr(bench, "has_lanes", lambda engine: engine == "jax")
    asked = []

    def play(job, engine, lanes=None):
        asked.append((len(job.starts), engine, lanes))
        found = result(len(job.starts))
        found.n_known[1] += engine == "jax"
        return bench.Finished([Outcomes(found, None)], Costs(levels={"closest": [engine]}))

    monkeypatch.setattr(bench, "run_once", play)
    plan = bench.prepare_bench(worlds=[SMALL], strategies=["closest"])
    rows = bench.measure_episodes(plan.jobs[0], [("auto", 2), ("jax", 4)], 1)
    assert asked[:2] == [(2, "auto", None), (8, "jax", 4)]
    assert [row["equal"] for row in rows] == [False, False]


@pytest.mark.parametrize(
    ("options", "says"),
    [(("--yardstick", "/no/such/yardstick.py"), "--yardstick"), (("--out", "/no/such/folder/x.json"), "--out")],
)
def test_yardstick_refuses_wrong_input(options, says, capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", [str(YARDSTICK), *options])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(YARDSTICK), run_name="__main__")
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
