"""The benchmarks run and find right answers; how fast is no matter of a test."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"


def bench(script, *options):
    """Runs a benchmark in its own process."""
    command = [sys.executable, str(FOLDER / script), *map(str, options)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.fixture
def oracles(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    return __import__("oracles")


def test_dijkstra_round_a_corner(oracles):
    # From (0, 0), beside a wall at (0, 1): the diagonal past it is no way, north and then east is.
    traversable = np.array([[1, 0, 1], [1, 1, 1]], bool)
    cost, target = oracles.dijkstra(traversable, 0, 0, np.zeros((2, 3), bool), False)
    one, far = 2**16, 2**30
    assert cost.tolist() == [[0, far, 4 * one], [one, 2 * one, 3 * one]]
    assert target == -1


def test_dijkstra_stops_at_the_lowest_of_equal_goals(oracles):
    goals = np.zeros((3, 3), bool)
    goals[[0, 1, 1, 2], [1, 0, 2, 1]] = True
    cost, target = oracles.dijkstra(np.ones((3, 3), bool), 1, 1, goals, True)
    assert (target, cost[1, 1], cost.reshape(-1)[target]) == (1, 0, 2**16)


def test_clusters_in_order_of_their_lowest_cell(oracles):
    frontier = np.array([[0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 0, 0]], bool)
    labels, sizes = oracles.clusters(frontier)
    assert labels.tolist() == [[-1, -1, -1, 0], [1, -1, -1, -1], [-1, 1, -1, -1]]
    assert sizes.tolist() == [1, 2]


def test_episodes(tmp_path):
    out = tmp_path / "episodes.json"
    options = ("--episodes", 3, "--repeat", 1, "--workers", 1, 2, "--no-yardstick", "--no-memory", "--out", out)
    ended = bench("episodes.py", "--worlds", "cave:width_m=6.4,height_m=6.4", *options)
    assert ended.returncode == 0, ended.stderr
    report = json.loads(out.read_text())
    assert {"environment", "episodes", "repeat", "cases", "memory", "yardstick"} <= set(report)
    assert {"jexplore", "jax", "device", "cpu", "cores"} <= set(report["environment"])
    (case,) = report["cases"]
    assert case["quality_equal"] is True
    assert case["quality"]["complete"] == 1
    assert case["quality"]["path_m"]["mean"] > 0
    assert case["compile_s"] > 0
    assert case["episode_mib"] > 0
    assert set(case["workers"]) == {"1", "2"}
    keys = {"s_per_episode", "cpu_s_per_episode", "episodes_per_s", "steps_per_s", "scans_per_s", "plans_per_s"}
    assert keys <= set(case["workers"]["1"])
    assert keys | {"speedup", "speedup_of_control"} <= set(case["workers"]["2"])
    assert f"| {case['world']} | closest+recheck |" in ended.stdout


def test_kernels(tmp_path):
    out = tmp_path / "kernels.json"
    small = "cave:width_m=6.4,height_m=6.4"
    ended = bench("kernels.py", "--world", small, "--maps", small, "--repeat", 1, "--out", out)
    assert ended.returncode == 0, ended.stderr
    report = json.loads(out.read_text())
    names = ["scan", "scan and fold", "plan", "masks", "clusters", "reachability map", "nearest site"]
    assert [kernel["kernel"] for kernel in report["kernels"]] == names
    for kernel in report["kernels"]:
        assert kernel["equal"] is True, kernel["kernel"]
        assert kernel["cpu_us"]["median"] >= kernel["cpu_us"]["min"] > 0
    shares = [window["share"] for window in report["kernels"][2]["windows"].values()]
    assert sum(shares) == pytest.approx(1)


@pytest.mark.parametrize(
    ("script", "options", "says"),
    [
        ("episodes.py", ("--worlds", "nowhere"), "nowhere"),
        ("episodes.py", ("--out", "/no/such/folder/x.json"), "--out"),
        ("episodes.py", ("--yardstick", "/no/such/yardstick.py", "--out", "x.json"), "--yardstick"),
        ("episodes.py", ("--episodes", "0"), "--episodes"),
        ("kernels.py", ("--maps", "nowhere"), "nowhere"),
    ],
)
def test_wrong_input_is_one_line_before_anything_runs(script, options, says):
    ended = bench(script, *options)
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    assert says in ended.stderr.strip().splitlines()[-1]
