"""Sweeps as tasks of a Ray cluster: results are those of one process, whatever dies, and nothing is left behind."""

import dataclasses
import json
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
import yaml

import jexplore as jx
from jexplore.cli import main
from jexplore.config import InputError
from jexplore.policies.catalogue import entries
from jexplore.studies.sweeps import cluster, connection, plan, run, spec, work

NEEDED = "Ray is not installed (the extra ray)"
PROC = pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="processes are looked for in /proc")
pytestmark = [
    pytest.mark.jit,
    # Ray begins processes by fork and exec, at once; JAX warns of any fork, where other tests have begun it.
    pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning"),
]
WORLDS = ("rooms:width_m=5,height_m=5", "rooms#3:width_m=5,height_m=5")
LIDAR = {"n_beams": 31, "range_m": 2}
SPEC = spec.Sweep(WORLDS, ("closest", "closest+recheck"), episodes=60, lidar=LIDAR, rules={"p_free": [0.3, 0.5]})
FAR = "def far(view, weight=1.0):\n    return weight * view.cost\n"


@pytest.fixture
def ray():
    return pytest.importorskip("ray", reason=NEEDED)


@pytest.fixture(scope="module")
def workers():
    """A cluster of two cores that is said to have a GPU as well."""
    ray = pytest.importorskip("ray", reason=NEEDED)
    own = {"address": "local", "num_cpus": 2, "num_gpus": 1, "object_store_memory": connection.STORE_BYTES}
    connection.begin(ray, **own, include_dashboard=False, log_to_driver=False, logging_level=logging.CRITICAL)
    yield ray
    ray.shutdown()


@pytest.fixture(scope="module")
def planned():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "UNIT", 40)
        return plan.prepare_sweep(SPEC)


@pytest.fixture(scope="module")
def want(planned, jit_on):
    """Units in this process: number -> table."""
    tables = {}
    with jit_on():
        work.run_block_units(planned, range(len(planned.units)), tables.__setitem__, engine="jax", workers=1)
    return tables


class Taken(dict):
    """Tables of units, each of which comes once."""

    def __setitem__(self, number, table):
        assert number not in self
        super().__setitem__(number, table)


def require_same(found, want):
    assert sorted(found) == sorted(want)
    for number, table in want.items():
        pd.testing.assert_frame_equal(found[number], table, check_exact=True)


def processes():
    """Processes that this one has begun, and theirs: pid -> title."""
    parents, titles = {}, {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            titles[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ")
        except OSError:  # it has ended
            continue

    def is_ours(pid):
        return pid in parents and (parents[pid] == os.getpid() or is_ours(parents[pid]))

    return {pid: title for pid, title in titles.items() if is_ours(pid)}


def busy():
    return [pid for pid, title in processes().items() if title.startswith("ray::make_units")]


def alive(pids):
    """Those that still run; one that has ended and waits for its parent has no command line."""
    return [pid for pid in pids if (file := Path(f"/proc/{pid}/cmdline")).exists() and file.read_text()]


def wait_until(what, seconds=60):
    deadline = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return found


def test_without_ray_one_is_told_how_to_install_it(planned, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"^the engine ray needs Ray: pip install 'jexplore\[ray\]'$"):
        cluster.run_units(planned, [0], print)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "ray://127.0.0.1:1", "127.0.0.1:x", "127.0.0.1:999999"])
def test_an_address_where_none_answers(ray, planned, monkeypatch, address):
    monkeypatch.setenv("RAY_ADDRESS", address)
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    with pytest.raises(InputError, match=f"^no Ray cluster answers at RAY_ADDRESS={address}: start one"):
        cluster.run_units(planned, [0], print)


def test_a_cluster_that_is_gone_is_not_looked_for(tmp_path, monkeypatch):
    """The file in which `ray start` says where it is stays when the machine goes down."""
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    assert not connection.is_there()
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "ray_current_cluster").write_text("127.0.0.1:1")
    assert not connection.is_there()


def test_of_no_units_nothing_is_begun(ray, planned, monkeypatch):
    monkeypatch.setattr(ray, "init", None)
    assert cluster.run_units(planned, [], print).engine == "ray"


@pytest.mark.parametrize(("how", "message"), [({"cpus": 0}, "cpus must be"), ({"gpus": 0.5}, "gpus must be")])
def test_resources_are_whole_numbers(planned, how, message):
    with pytest.raises(InputError, match=message):
        cluster.run_units(planned, [0], print, **how)


def test_results_are_those_of_one_process(workers, planned, want):
    taken, told = Taken(), []
    costs = cluster.run_units(planned, range(len(planned.units)), taken.__setitem__, on_progress=told.append)
    require_same(taken, want)
    assert told == sorted(told)
    assert told[-1] == planned.episodes == 480
    assert (costs.engine, costs.lanes, costs.devices, costs.interrupted) == ("ray", 2, 1, False)
    assert costs.levels == {"closest": ["native on a CPU"], "closest+recheck": ["native on a CPU"]}
    assert costs.run_s > 0
    assert workers.is_initialized()  # it was there before


def test_a_task_may_have_a_gpu(workers, planned, want):
    """As far as it can be tested without one: a task has many units, and leaves their device to JAX."""
    taken, told = Taken(), []
    numbers = [1, 4, 5]
    costs = cluster.run_units(planned, numbers, taken.__setitem__, on_progress=told.append, gpus=1)
    require_same(taken, {number: want[number] for number in numbers})
    assert told == [sum(len(want[number]) for number in numbers)]
    assert costs.devices == 1


@pytest.mark.parametrize(("how", "what"), [({"cpus": 3}, "3 cores"), ({"gpus": 2}, "1 cores and 2 GPUs")])
def test_a_task_that_no_node_can_run(workers, planned, how, what):
    with pytest.raises(InputError, match=f"^no node of the Ray cluster has {what}, which a task is to have$"):
        cluster.run_units(planned, [0], print, **how)


@PROC
def test_units_of_a_killed_worker_are_made_again(workers, planned, want, capfd):
    taken, killed = Taken(), []

    def on_unit(number, table):
        taken[number] = table
        if len(taken) == 2:
            killed.append(wait_until(busy)[0])
            os.kill(killed[-1], signal.SIGKILL)

    costs = cluster.run_units(planned, range(len(planned.units)), on_unit)
    require_same(taken, want)
    assert len(killed) == 1
    assert alive(killed) == []
    assert not costs.interrupted
    assert capfd.readouterr().err == ""


@PROC
def test_ctrl_c_keeps_what_has_come_back_and_ends_the_rest(workers, planned, want):
    taken = {}

    def on_unit(number, table):
        taken[number] = table
        if len(taken) == 3:
            os.kill(os.getpid(), signal.SIGINT)

    costs = cluster.run_units(planned, range(len(planned.units)), on_unit)
    assert costs.interrupted
    assert 3 <= len(taken) < len(want)
    require_same(taken, {number: want[number] for number in taken})
    wait_until(lambda: not busy(), seconds=5)


def test_strategies_of_the_drivers_folder_and_registered_ones(workers, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(FAR)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(entries, "STRATEGIES", dict(entries.STRATEGIES))
    monkeypatch.setattr(cluster, "STRATEGIES", entries.STRATEGIES)
    cell = {"__name__": "__main__"}  # as in a notebook
    exec(FAR, cell)
    jx.register("farthest", cell["far"])
    asked = {"worlds": WORLDS[:1], "strategies": ("mine:far", {"name": "farthest+recheck", "weight": [1, 2]})}
    found, want = (run.sweep({**asked, "episodes": 5, "lidar": LIDAR}, engine=one) for one in ("ray", "jax"))
    pd.testing.assert_frame_equal(found.episodes, want.episodes, check_exact=True)
    assert len(found.episodes) == 15


def refused(ready):
    with pytest.raises(InputError) as told:
        cluster.run_units(ready, [0], print)
    assert type(told.value) is InputError
    return str(told.value)


def test_what_a_worker_refuses_is_told_in_one_line(workers, planned, tmp_path, monkeypatch):
    """A module that has been broken since, a map that is another, one that is gone, another version."""
    (tmp_path / "mine.py").write_text(FAR)
    monkeypatch.chdir(tmp_path)
    rows = ["@" * 30, *["@" + "." * 28 + "@"] * 28, "@" * 30]
    for name in ("one.map", "two.map"):
        Path(name).write_text("\n".join(["type octile", "height 30", "width 30", "map", *rows, ""]))
    few = {"episodes": 2, "lidar": LIDAR}
    mine = plan.prepare_sweep(spec.Sweep(WORLDS[:1], "mine:far", **few))
    one, two = (plan.prepare_sweep(spec.Sweep(name, "closest", **few)) for name in ("one.map", "two.map"))
    Path("mine.py").write_text("1 / 0\n")
    assert refused(mine) == "module 'mine' does not import: ZeroDivisionError: division by zero"
    Path("one.map").write_text(Path("one.map").read_text().replace(".@\n", "@@\n", 1))
    assert refused(one).startswith("'one.map' is another world for the Ray worker on ")
    Path("two.map").unlink()
    assert refused(two).startswith("'two.map'")
    monkeypatch.setattr(cluster, "__version__", "0.0.0")
    assert "and the sweep is one of 0.0.0: install the same version on every node" in refused(planned)


def test_a_unit_that_kills_its_workers_is_given_up(workers, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cluster, "RETRIES", 1)
    Path("mine.py").write_text(FAR)
    ready = plan.prepare_sweep(spec.Sweep(WORLDS[:1], "mine:far", episodes=2, lidar=LIDAR))
    Path("mine.py").write_text("import os, pathlib\npathlib.Path(f'died{os.getpid()}').touch()\nos._exit(1)\n")
    assert refused(ready).startswith("unit 0 of the sweep could not be made: 2 workers have died of it; ")
    assert len(list(tmp_path.glob("died*"))) == 2


def shards(folder):
    return {path.name: path.stat().st_mtime_ns for path in (folder / ".unfinished").glob("*.parquet")}


@PROC
def test_a_command_that_is_ended_goes_on_and_leaves_nothing_behind(workers, tmp_path, monkeypatch):
    """With a cluster of its own, and then with one that was there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", "/tmp")
    asked, folder, before = dataclasses.replace(SPEC, episodes=130), tmp_path / "run", set(processes())
    Path("sweep.yaml").write_text(yaml.safe_dump(spec.plain(asked)))
    command = ["sweep", "sweep.yaml", "--engine", "ray", "--no-report", "--out", "run"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, "-m", "jexplore", *command], **pipes)
    wait_until(lambda: shards(folder))
    own = set(processes()) - before
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert len(own) > 4
    assert alive(own) == []
    assert said.splitlines()[-1] == "jexplore: interrupted, what was finished was written"
    assert "ray" not in said.replace(str(tmp_path), "")
    kept = shards(folder)

    assert main.main([*command, "--resume"]) == 0
    found = pd.read_parquet(folder / "episodes.parquet")
    assert len(found) == 1040
    assert not found.duplicated(["setting", "world", "strategy", "episode"]).any()
    assert json.loads((folder / "run.json").read_text())["resumed"] == 130 * len(kept)
