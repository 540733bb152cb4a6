"""Comparisons from Python that are written, gone on with and read again, and their tables by strategy."""

import json
import pickle

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.cli import main
from jexplore.config import InputError
from jexplore.studies import comparison
from jexplore.studies.results import units

pytestmark = pytest.mark.jit
WORLD, STRATEGIES = "rooms:width_m=5,height_m=5", ["closest", "random+recheck"]
LIDAR = {"n_beams": 31, "range_m": 2}
COMMAND = ["compare", "--worlds", WORLD, "--strategies", *STRATEGIES, "--lidar.n-beams", "31", "--lidar.range-m", "2"]


@pytest.fixture(autouse=True)
def _small_units(monkeypatch):
    monkeypatch.setattr(units, "UNIT_S", 0.0)


def run(episodes=16, **how):
    return jx.compare(WORLD, STRATEGIES, episodes=episodes, lidar=LIDAR, **how)


@pytest.fixture(scope="module")
def found(jit_on, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    with jit_on(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(units, "UNIT_S", 0.0)
        return folder, run(out=folder)


def never(*args, **kwargs):
    raise AssertionError("this runs again")


def same(one, other):
    pd.testing.assert_frame_equal(one.episodes, other.episodes)
    assert one.progress.keys() == other.progress.keys()
    for pair in one.progress:
        np.testing.assert_array_equal(one.progress[pair], other.progress[pair])
    assert [world.name for world in one.worlds] == [world.name for world in other.worlds]


def test_the_folder_is_that_of_the_command(found, tmp_path, capsys):
    folder, made = found
    names = {path.name for path in folder.iterdir()}
    wanted = {"episodes.parquet", "details.parquet", "run.json", "compare.png", "coverage.svg", "paths.png"}
    assert names >= wanted | {"report.html"}
    assert not any(name.startswith(".") for name in names)
    page = json.loads((folder / "run.json").read_text())
    assert page["configuration"]["episodes"] == 16
    assert page["configuration"]["lidar"]["range_m"] == 2
    assert page["summary"][0]["strategy"] == "closest"
    same(jx.load(folder), made)
    # The command takes it for one of its own.
    assert main.main([*COMMAND, "--episodes", "16", "--out", str(folder), "--resume"]) in (0, None)
    assert "nothing was left to do" in capsys.readouterr().out


def test_a_finished_run_is_read_and_not_run(found, monkeypatch):
    folder, made = found
    monkeypatch.setattr(comparison, "run_comparison", never)
    same(run(out=folder, resume=True), made)


def test_a_run_that_broke_off_is_gone_on_with(found, tmp_path):
    def stop(done):
        if done >= 16:
            raise RuntimeError("the power fails")

    with pytest.raises(RuntimeError):
        run(out=tmp_path / "run", on_progress=stop, workers=1)  # unit by unit
    assert not (tmp_path / "run" / "run.json").exists()
    refused(r"go on with it \(resume=True\), replace it \(overwrite=True\)", run, out=tmp_path / "run")
    with pytest.raises(InputError, match=r"was not finished: replace it \(overwrite=True\) or choose another folder"):
        found[1].save(tmp_path / "run")
    again = run(out=tmp_path / "run", resume=True)
    assert again.resumed >= 8
    same(again, found[1])


def test_ways_and_maps_are_kept(found, tmp_path):
    made = run(8, keep="maps", out=tmp_path / "run")
    for read in (jx.load(tmp_path / "run"), run(8, keep="maps", out=tmp_path / "run", resume=True)):
        assert read.paths.keys() == made.paths.keys() == read.maps.keys()
        for pair, ways in made.paths.items():
            assert all(np.array_equal(a, b) for a, b in zip(ways, read.paths[pair], strict=True))
            np.testing.assert_array_equal(read.maps[pair], made.maps[pair])
    longer = run(9, keep="maps", out=tmp_path / "run", resume=True)
    assert longer.resumed == 16
    assert all(len(longer.paths[pair]) == len(longer.maps[pair]) == 9 for pair in made.paths)


@pytest.mark.slow
def test_results_are_saved_afterwards_and_once_more(found, tmp_path):
    made = run(8)
    assert made.save(tmp_path / "deep" / "one") == tmp_path / "deep" / "one"
    one = jx.load(tmp_path / "deep" / "one")
    same(one, made)
    one.save(tmp_path / "two", report=False)
    same(jx.load(tmp_path / "two"), made)
    assert not (tmp_path / "two" / "report.html").exists()
    refused("holds a run", made.save, tmp_path / "two")
    made.save(tmp_path / "two", overwrite=True)
    same(pickle.loads(pickle.dumps(made)), made)
    pickle.loads(pickle.dumps(made)).save(tmp_path / "three")
    same(jx.load(tmp_path / "three"), made)


@pytest.mark.parametrize(
    ("how", "line"),
    [
        ({"resume": True}, "name it with out"),
        ({"overwrite": True}, "name it with out"),
        ({"out": "x", "resume": True, "overwrite": True}, "give one of them"),
        ({"out": ""}, "must have a name"),
    ],
)
def test_what_cannot_be_written_is_refused_before_it_runs(how, line, monkeypatch):
    monkeypatch.setattr(comparison, "run_comparison", never)
    assert "--" not in refused(line, run, **how)


def test_another_run_is_not_gone_on_with(found, monkeypatch):
    monkeypatch.setattr(comparison, "run_comparison", never)
    refused("holds another run: its seed is 0, not 5", run, out=found[0], resume=True, seed=5)
    refused(r"allow overwriting \(overwrite=True\)$", run, out=found[0])


def test_results_are_iterated_over_by_strategy(found):
    made = found[1]
    assert list(made) == STRATEGIES == list(made.strategies)
    assert len(made) == 2
    assert "closest" in made
    assert "cloest" not in made
    for name in made:
        assert len(made[name]) == 16
        assert set(made[name]["strategy"]) == {name}
        assert made[name].index.tolist() == list(range(16))
    with pytest.raises(InputError, match="did you mean 'closest'"):
        made["cloest"]
