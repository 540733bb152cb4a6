"""Runs that are ended in every way, and gone on with: nothing is lost, nothing is made twice."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jexplore.cli import main
from jexplore.cli.output import signals
from jexplore.report.ledger import Ledger
from jexplore.rules import Lidar
from jexplore.studies import comparison
from jexplore.studies.results import comparison as results
from jexplore.studies.results import units
from jexplore.studies.results.loading import load

pytestmark = [pytest.mark.jit, pytest.mark.skipif(os.name != "posix", reason="signals")]
WORLD, STRATEGIES = "rooms:width_m=5,height_m=5", ["closest", "random+recheck"]
OPTIONS = ["--lidar.n-beams", "31", "--lidar.range-m", "2"]
COMMAND = ["compare", "--worlds", WORLD, "--strategies", *STRATEGIES, *OPTIONS]
HELD = """
import sys, threading
from concurrent.futures import ThreadPoolExecutor
from jexplore.cli.main import main
from jexplore.cli.output.console import under_way
from jexplore.engine import threads
from jexplore.studies.results import units

most, heard, hear = int(sys.argv.pop(1)), threading.Event(), threads.Interruption.hear

def tell(self):
    hear(self)
    heard.set()

class Pool(ThreadPoolExecutor):
    def submit(self, call, *arguments):
        def hold():
            if under_way and under_way[0].ledger and len(under_way[0].ledger.done) >= most:
                heard.wait()
            return call(*arguments)
        return super().submit(hold)

threads.Interruption.hear, threads.ThreadPoolExecutor, units.UNIT_S = tell, Pool, 0.0
sys.exit(main())
"""
"""A command with units of 8 episodes. When it has kept `most` of them, calls wait for Ctrl-C before they begin: however
fast this machine is, it does not come to its end before the test ends it."""


@pytest.fixture(autouse=True)
def _small_units(monkeypatch):
    monkeypatch.setattr(units, "UNIT_S", 0.0)


def begin(folder, most, *options):
    command = [sys.executable, "-c", HELD, str(most), *COMMAND, "--out", str(folder), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def shards(folder):
    return sorted(path.name for path in (folder / ".unfinished").glob("*.parquet"))


def is_any_whole(folder):
    """Tell whether an episode has been finished by every strategy."""
    rows = [pd.read_parquet(folder / ".unfinished" / name, columns=["episode"]) for name in shards(folder)]
    return bool(rows) and (pd.concat(rows)["episode"].value_counts() == len(STRATEGIES)).any()


def wait_for(process, folder, n):
    wait_until(process, lambda: len(shards(folder)) >= n)


def wait_until(process, is_ready):
    deadline = time.monotonic() + 300
    while not is_ready():
        assert time.monotonic() < deadline
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.01)


def wait_asleep(process):
    """Wait until the main thread of a process that has nothing else to wait for sleeps."""
    state = Path(f"/proc/{process.pid}/stat")
    if state.exists():
        wait_until(process, lambda: state.read_text().rpartition(")")[2].split()[0] == "S")
    else:
        time.sleep(2)


def files(folder):
    return sorted(path.name for path in Path(folder).iterdir())


@pytest.fixture(scope="module")
def want(jit_on):
    with jit_on():
        return comparison.compare(WORLD, STRATEGIES, episodes=240, lidar=Lidar(n_beams=31, range_m=2))


@pytest.mark.slow
def test_a_run_that_is_killed_again_and_again_comes_out_the_same(want, tmp_path, capsys, monkeypatch):
    folder, before = tmp_path / "run", 0
    for _ in range(2):
        process = begin(folder, before + 5, "--episodes", "240", "--resume")
        wait_for(process, folder, before + 5)
        process.kill()
        process.communicate()
        before = len(shards(folder))
        assert "run.json" not in files(folder)
    kept, made, put = set(shards(folder)), [], Ledger.put
    monkeypatch.setattr(Ledger, "put", lambda self, unit, table: made.append(unit) or put(self, unit, table))
    assert main.main([*COMMAND, "--out", str(folder), "--episodes", "240", "--resume"]) == 0
    assert sorted(made) == [unit for unit in range(60) if f"{unit:06d}.parquet" not in kept]  # none is made twice
    assert files(folder) == [
        *("compare.png", "compare.svg", "coverage.png", "coverage.svg", "details.parquet", "episodes.parquet"),
        *("paths.png", "report.html", "run.json"),
    ]
    pd.testing.assert_frame_equal(pd.read_parquet(folder / "episodes.parquet"), want.episodes)
    assert json.loads((folder / "run.json").read_text())["resumed"] == 8 * before
    assert capsys.readouterr().out.startswith(want.to_markdown())
    found = load(folder)
    for key, rows in want.progress.items():
        np.testing.assert_array_equal(found.progress[key], rows)
    (ours,), (theirs,) = found.first.values(), want.first.values()
    for one, other in zip(ours, theirs):
        assert [one.strategy, one.cell_m, one.path_m] == [other.strategy, other.cell_m, other.path_m]
        for name in ("state", "rows", "cols"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert found.to_markdown() == want.to_markdown()
    assert found.worlds[0].occupied.tolist() == want.worlds[0].occupied.tolist()


@pytest.mark.slow
def test_control_c_keeps_what_is_finished(want, tmp_path, capsys, printed):
    folder = tmp_path / "run"
    process = begin(folder, 5, "--episodes", "2000")
    wait_until(process, lambda: is_any_whole(folder))
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=300)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    *_, kept, end = said.splitlines()
    assert kept.endswith(f"are kept; --out {folder} --resume goes on with them")
    assert end == "jexplore: interrupted, what was finished was written"
    table, record = pd.read_parquet(folder / "episodes.parquet"), json.loads((folder / "run.json").read_text())
    assert 0 < len(table) == 4000 - record["interrupted"]
    assert record["warnings"][0] == f"interrupted: {record['interrupted']} episodes are missing"
    assert table.groupby("strategy")["episode"].agg(list).map(tuple).nunique() == 1
    few = table[(table["strategy"] == "closest") & (table["episode"] < 240)]
    assert len(few)
    pd.testing.assert_frame_equal(few.reset_index(drop=True), want.episodes.iloc[few["episode"]].reset_index(drop=True))
    assert main.main([*COMMAND, "--episodes", "1999", "--out", str(folder), "--resume"]) == 2
    assert "holds a run of 2000 episodes, more than 1999: ask for 2000 or more" in capsys.readouterr().err
    assert "holds a run" in printed([*COMMAND, "--episodes", "2000", "--out", str(folder)], 2).err


@pytest.mark.slow
def test_what_a_batch_system_ends_is_kept(want, tmp_path):
    """Threads are at work that does not come to its end; the process does not wait for it."""
    assert signals.GRACE_S + signals.LAST_S < 2
    folder = tmp_path / "run"
    process = begin(folder, 2, "--episodes", "160")
    wait_for(process, folder, 2)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=300)
    assert process.returncode == 143, said
    assert f"are kept; --out {folder} --resume goes on with them" in said
    assert "Traceback" not in said
    assert main.main([*COMMAND, "--episodes", "160", "--out", str(folder), "--resume"]) == 0
    rows = want.episodes[want.episodes["episode"] < 160].reset_index(drop=True)
    pd.testing.assert_frame_equal(pd.read_parquet(folder / "episodes.parquet"), rows)


COMPILES = """
import ctypes, signal, sys, types
from jexplore.cli import main
from jexplore.cli.output.console import Out

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which nohup, where the tests run under it, lets processes ignore

def command(arguments, signals):
    signals.listen()
    options = types.SimpleNamespace(out=arguments[0], overwrite=False)
    with Out(options, ["explore"]) as out:
        out.keep({}, 1)
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
        print("begun", flush=True)
        ctypes.CDLL(None).sleep(900)  # as a compiler does: in C, and no signal ends it

main._dispatch = command
sys.exit(main.main())
"""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_what_cannot_be_interrupted_is_ended(name, status, tmp_path):
    program = [sys.executable, "-c", COMPILES, str(tmp_path / "made" / "run")]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline() == "begun\n"
    wait_asleep(process)
    process.send_signal(getattr(signal, name))
    heard = "jexplore: interrupted: what is under way comes to its end first; Ctrl-C once more ends at once\n"
    if name == "SIGINT":
        assert process.stderr.readline() == heard
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=300)
    assert process.returncode == status
    by = "a second Ctrl-C" if name == "SIGINT" else name
    kept = "jexplore: no unit of work was finished: nothing is kept to go on with"
    assert said.splitlines() == [kept, f"jexplore: ended at once by {by}"]
    assert files(tmp_path) == []  # the folders that were made for it are gone


def test_a_finished_run_is_not_run_again(tmp_path, printed, monkeypatch):
    command = [*COMMAND, "--episodes", "3", "--out", str(tmp_path / "run"), "--resume"]
    table = printed(command).out.split("\n\n")[0]
    monkeypatch.setattr(results, "run_comparison", lambda *_, **__: pytest.fail("it began"))
    said = printed(command).out
    assert said.startswith(table)
    assert said.splitlines()[-1].endswith("nothing was left to do")
    for name in ("coverage.png", "coverage.svg", "report.html"):
        (tmp_path / "run" / name).unlink()
    assert printed(command).out.splitlines()[-1].endswith("drew coverage.png, report.html")
    assert {"coverage.png", "coverage.svg", "report.html"} <= set(files(tmp_path / "run"))


@pytest.mark.slow
def test_a_strategy_that_was_written_anew_is_another_run(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file, command = tmp_path / "mine_again.py", [*COMMAND, "--episodes", "2", "--out", "run", "--no-report", "--resume"]
    command[command.index("--strategies") + 1 : command.index("--strategies") + 2] = ["mine_again:far"]
    file.write_text("def far(view):\n    return view.cost\n")
    assert main.main(command) == 0
    file.write_text("def far(view):  # the same\n    return view.cost\n")
    assert main.main(command) == 0
    file.write_text("def far(view):\n    return view.cost * 2\n")
    assert main.main(command) == 2
    assert (
        "holds another run: its strategy 'mine_again:far' computes something else now; choose another"
        in capsys.readouterr().err
    )
    assert main.main([*command, "--trust"]) == 0


def test_a_picture_that_fails_costs_no_data(tmp_path, printed, monkeypatch):
    def fails(self):
        raise RuntimeError("no ink\nat all")

    monkeypatch.setattr(comparison.ComparisonResult, "compare_figure", fails)
    said = printed([*COMMAND, "--episodes", "3", "--out", str(tmp_path)])
    assert "warning: compare.png could not be drawn: no ink\n" in said.err
    assert said.out.splitlines()[-1].startswith(
        "wrote episodes.parquet, details.parquet, run.json, coverage.png, paths.png, report"
    )
    assert "compare.png" not in files(tmp_path)
