"""Sweeps: what they may be asked, how they are cut, and that every row is the one that a comparison has."""

import itertools
import json
import re

import numpy as np
import pandas as pd
import pytest
import yaml
from ref.refusals import refused

import jexplore as jx
from jexplore.arrays.plain_yaml import Loader, dump
from jexplore.cli import main
from jexplore.config import InputError
from jexplore.engine import devices
from jexplore.engine.runner import Costs
from jexplore.exploration import batch
from jexplore.report.ledger import Work
from jexplore.rules import Lidar, Rules
from jexplore.studies.results import units
from jexplore.studies.results.columns import COLUMNS
from jexplore.studies.results.units import run_units
from jexplore.studies.sweeps import plan as plans
from jexplore.studies.sweeps import run as runs
from jexplore.studies.sweeps.axes import Range
from jexplore.studies.sweeps.plan import in_shard, prepare_sweep
from jexplore.studies.sweeps.run import sweep
from jexplore.studies.sweeps.spec import Sweep, plain_spec, read_spec, sweep_from

WORLDS = ["rooms:width_m=5,height_m=5", "maze:width_m=5,height_m=5"]
SMALL = {"n_beams": 31}


def test_lists_are_axes_of_the_product():
    spec = Sweep(["a"], seed=[0, 1], lidar={"range_m": [4, 8], "n_beams": 31}, rules={"clearance_m": [0.2, 0.3]})
    assert spec.expanded() == [
        {"seed": seed, "cell_m": 0.1, "lidar.range_m": far, "lidar.n_beams": 31, "rules.clearance_m": clear}
        for seed, far, clear in itertools.product([0, 1], [4, 8], [0.2, 0.3])
    ]
    assert spec.records()[1][1:5] == (0, 0.1, Lidar(n_beams=31, range_m=4), Rules(clearance_m=0.3))
    assert Sweep(["a"]).expanded() == [{"seed": 0, "cell_m": 0.1}]


def test_settings_one_by_one():
    spec = Sweep(["a"], seed=[5, 6], settings=[{"lidar.range_m": 4, "rules.clearance_m": 0.2}, {"lidar.range_m": 8}])
    assert spec.expanded() == [
        {"seed": seed, "cell_m": 0.1, "lidar.range_m": far, "rules.clearance_m": clear}
        for far, clear in ((4, 0.2), (8, 0.3))  # 0.3 is the default
        for seed in (5, 6)
    ]
    assert [one["cell_m"] for one in Sweep(["a"], settings=[{"cell_m": 0.2}]).expanded()] == [0.2]


def test_ranges_are_drawn_from():
    asked = {"lidar": {"range_m": {"low": 2, "high": 10}}, "rules": {"near_m": Range(0.01, 1.0, log=True)}}
    spec = sweep_from({"worlds": ["a"], "cell_m": [0.1, 0.2], "draws": 200, **asked})
    found = spec.expanded()
    assert len(found) == 200
    far, near = (np.array([one[name] for one in found]) for name in ("lidar.range_m", "rules.near_m"))
    for values, low, high in ((far, 2, 10), (np.log(near), np.log(0.01), 0)):
        assert low <= values.min() <= values.max() <= high
        counts, _ = np.histogram(values, 4, (low, high))
        assert counts.min() >= 48  # of 50: Sobol draws are even
    assert {one["cell_m"] for one in found} == {0.1, 0.2}
    assert found == sweep_from(plain_spec(spec)).expanded()  # drawn again the same
    whole = Sweep(["a"], draws=8, rules={"max_steps": Range(100, 200)}).expanded()
    assert all(isinstance(one["rules.max_steps"], int) for one in whole)


def test_parameters_of_strategies_are_axes():
    spec = Sweep(["a"], ["closest", {"name": "distance-advantage+recheck", "weight": [0.5, 2]}, {"name": "gain-rate"}])
    assert spec.strategy_list() == [
        ("closest", {}),
        ("distance-advantage+recheck:weight=0.5", {"weight": 0.5}),
        ("distance-advantage+recheck:weight=2", {"weight": 2}),
        ("gain-rate", {}),
    ]
    assert Sweep(["a"], {"name": "tour"}).strategy_list() == [("tour", {})]


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ([], "must be a mapping with worlds"),
        ({"worlds": []}, "worlds must name at least one"),
        ({"worlds": {"a": 1}}, "worlds must be a list"),
        ({"worlds": [3]}, "worlds must be names or files, got 3"),
        ({"worlds": ["a"], "strategys": ["closest"]}, "unknown key 'strategys'; did you mean 'strategies'?"),
        ({"worlds": ["a"], "lidar": {"rang_m": 3}}, "unknown field of lidar 'rang_m'; did you mean 'range_m'?"),
        ({"worlds": ["a"], "lidar": 3}, "lidar must be a mapping"),
        ({"worlds": ["a"], "rules": {"clearance_m": []}}, "rules.clearance_m must have at least one value"),
        ({"worlds": ["a"], "rules": {"clearance_m": -1}}, "rules.clearance_m must be a number at least 0"),
        ({"worlds": ["a"], "cell_m": 0}, "cell_m must be a number at least 0.001"),
        ({"worlds": ["a"], "draws": 3}, "draws goes with a range"),
        ({"worlds": ["a"], "lidar": {"range_m": {"low": 1, "high": 3}}}, "say how many settings are drawn"),
        ({"worlds": ["a"], "draws": 3, "lidar": {"range_m": {"low": 1}}}, "a range has low and high"),
        ({"worlds": ["a"], "draws": 3, "lidar": {"range_m": {"low": 3, "high": 1}}}, "high must be a number above 3"),
        ({"worlds": ["a"], "draws": 3, "lidar": {"range_m": {"low": 0, "high": 1, "log": True}}}, "low must be"),
        ({"worlds": ["a"], "draws": 3, "lidar": {"range_m": {"lo": 1, "high": 3}}}, "unknown word in the range"),
        ({"worlds": ["a"], "settings": [{"lidar.rangem": 3}]}, "unknown setting 'lidar.rangem'; did you mean 'li"),
        ({"worlds": ["a"], "settings": [3]}, "settings must be mappings"),
        ({"worlds": ["a"], "settings": [{"lidar.range_m": 3}] * 2}, "settings must differ"),
        ({"worlds": ["a"], "seed": [1, 1]}, "settings must differ"),
        (
            {"worlds": ["a"], "lidar": {"range_m": 2}, "settings": [{"lidar.range_m": 3}]},
            "lidar.range_m is given twice",
        ),
        ({"worlds": ["a"], "seed": list(range(1000)), "cell_m": [0.1 + i for i in range(101)]}, "100,000 settings"),
        ({"worlds": ["a"], "strategies": [{"nam": "x"}]}, "a strategy must be a name, or a mapping"),
        ({"worlds": ["a"], "strategies": [{"name": "x", "mode": None}]}, "x: mode must be a number, a truth value or"),
        ({"worlds": ["a"], "strategies": [{"name": "x", "mode": ["a,b"]}]}, "a plain word, got 'a,b'"),
        ({"worlds": ["a"], "settings": [{"seed": 3}, {"seed": 3.0}]}, "settings must differ"),
    ],
)
def test_what_no_sweep_may_be_asked(page, message):
    def read():
        spec = sweep_from(page, "s.yaml")
        return spec.strategy_list(), spec.records()

    assert message in refused(None, read)


def test_what_a_plan_refuses():
    small = {"worlds": WORLDS[:1], "strategies": ["closest"]}
    for change, message in (
        ({"worlds": WORLDS[:1] * 2}, "worlds must differ"),
        ({"worlds": [WORLDS[0], "rooms#0:width_m=5,height_m=5"]}, "are the same building"),
        ({"strategies": [{"name": "closest", "speed": 3}]}, "speed"),
        ({"rules": {"clearance_m": 3.0}}, "clearance"),
        ({"start": "world"}, "has no start of its own"),
        ({"episodes": 90_000_000, "strategies": ["closest", "random"]}, "100,000,000 episodes, got 180,000,000"),
    ):
        refused(message, prepare_sweep, sweep_from({**small, **change}))
    for bad in (3, [WORLDS]):
        with pytest.raises(InputError, match=r"must be a jx\.Sweep, a mapping or a YAML file"):
            sweep(bad)  # type: ignore[arg-type]


@pytest.mark.parametrize("word", ["010", "0o10", "0x1f", "1e3", "true", "~", "", "no", "4:30", "<<", ".5", 8, 1e-5])
def test_what_is_written_as_yaml_is_read_back(word):
    assert yaml.load(dump({"a": [word]}), Loader) == {"a": [word]}


def test_units_share_programs_and_miss_nothing(monkeypatch):
    monkeypatch.setattr(units, "UNIT_S", 10.0)  # in so small worlds the largest units
    spec = Sweep(
        WORLDS, ["closest", "random"], episodes=40, lidar={"range_m": [1, 2]}, rules={"clearance_m": [0.2, 0.3]}
    )
    plan = prepare_sweep(spec)
    assert len(plan.programs) == 2  # one a clearance; both worlds have one size
    blocks = [block for unit in plan.units for block in unit.blocks]
    assert sorted(blocks) == [(job, 0, 40) for job in range(4 * 2 * 2)]
    for unit in plan.units:
        assert len({plan.jobs[block.job].rules.clearance_m for block in unit.blocks}) == 1
        assert unit.n <= 256
    large = prepare_sweep(Sweep(WORLDS[:1], ["closest"], episodes=1000))
    assert [(block.first, block.n) for unit in large.units for block in unit.blocks] == [
        *((first, 256) for first in (0, 256, 512)),
        (768, 232),
    ]
    parts = [in_shard(len(plan.units), (i, 3)) for i in range(3)]
    assert sorted(itertools.chain(*parts)) == in_shard(len(plan.units), None) == list(range(len(plan.units)))
    assert run_units(plan.jobs, plan.units, []).tables == []  # a shard without a unit
    assert plan.episodes == 4 * 2 * 2 * 40


@pytest.fixture(scope="module")
def asked():
    return {
        "worlds": WORLDS,
        "strategies": ["closest+recheck", {"name": "distance-advantage", "weight": [0.5, 2]}, "random"],
        "episodes": 3,
        "lidar": {**SMALL, "range_m": [1, 2.5], "sigma_m": [0, 0.03]},
        "rules": {"p_free": [0.2, 0.3], "clearance_m": 0.2, "max_steps": [None, 60]},
    }


@pytest.fixture(scope="module")
def found(asked, jit_on):
    with jit_on():
        before = devices._compiled.cache_info().misses
        result = sweep(asked, workers=2)
        return result, devices._compiled.cache_info().misses - before


@pytest.mark.slow
@pytest.mark.jit
def test_every_row_is_that_of_a_comparison(found, asked):
    result, _ = found
    table = result.to_pandas()
    assert len(table) == 16 * 2 * 4 * 3
    assert result.columns[1:] == (
        *("cell_m", "lidar.n_beams", "lidar.range_m", "lidar.sigma_m", "rules.p_free", "rules.clearance_m"),
        *("rules.max_steps", "strategy.weight"),
    )
    for setting in (3, 14):
        own = table[table["setting"] == setting]
        row = own.iloc[0]
        lidar = Lidar(n_beams=31, range_m=row["lidar.range_m"], sigma_m=row["lidar.sigma_m"])
        most = None if pd.isna(row["rules.max_steps"]) else int(row["rules.max_steps"])
        rules = Rules(p_free=row["rules.p_free"], clearance_m=0.2, max_steps=most)
        names = list(dict.fromkeys(own["strategy"]))
        alone = jx.compare(WORLDS, names, episodes=3, lidar=lidar, rules=rules).to_pandas()
        pd.testing.assert_frame_equal(own[list(COLUMNS)].reset_index(drop=True), alone)
    assert table.groupby("strategy")["strategy.weight"].agg(lambda w: w.iloc[0]).to_dict() == {
        "closest+recheck": pytest.approx(np.nan, nan_ok=True),
        "distance-advantage:weight=0.5": 0.5,
        "distance-advantage:weight=2": 2.0,
        "random": pytest.approx(np.nan, nan_ok=True),
    }


@pytest.mark.slow
@pytest.mark.jit
def test_settings_that_differ_in_numbers_share_one_program(found):
    assert found[1] == 1


NATIVE = {
    **{"worlds": WORLDS, "strategies": ["closest+recheck", "random"], "episodes": 3},
    "lidar": {**SMALL, "range_m": [1, 2.5], "sigma_m": [0, 0.03]},
    "rules": {"p_free": [0.2, 0.3], "clearance_m": 0.2},
}
"""A sweep that native code runs."""


def test_how_robots_learn_their_pose_may_stand_in_the_rules():
    rules = Rules(pose="icp", odometry={"length": 0.3})
    ready = Sweep(worlds=["cave"], strategies=["closest"], rules=rules).records()[0].rules
    assert (ready.pose, ready.odometry.length) == ("icp", 0.3)
    refused("pose is given twice", Sweep, worlds=["cave"], strategies=["closest"], rules=rules, pose="odometry")
    with pytest.raises(InputError, match="pose must be one of true, odometry, icp"):
        Sweep(worlds=["cave"], strategies=["closest"], pose={"low": 0, "high": 1}, draws=2).records()


@pytest.mark.slow
@pytest.mark.jit
def test_interruption_keeps_whole_units(monkeypatch):
    run = batch.run_jobs

    def stop(jobs, *rest, **how):
        def on_job(place, outcomes, on_job=how["on_job"]):
            if place >= 15:
                raise KeyboardInterrupt
            on_job(place, outcomes)

        return run(jobs, *rest, **{**how, "on_job": on_job})

    monkeypatch.setattr(batch, "run_jobs", stop)
    monkeypatch.setattr(plans, "MAX_UNIT_EPISODES", 32)
    found = sweep(NATIVE, workers=1)
    assert found.costs.interrupted
    assert len(found.episodes) % 30 == 0  # ten blocks of three make a unit
    assert found.missing == 96 - len(found.episodes)
    monkeypatch.setattr(batch, "run_jobs", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        sweep(NATIVE)


YAML = """
worlds: ["rooms:width_m=5,height_m=5"]
strategies: [closest+recheck, {name: distance-advantage, weight: [0.5, 2]}]
episodes: 24
lidar: {n_beams: 31, range_m: [1, 2.5]}
rules: {clearance_m: 0.2, p_free: [0.2, 0.3]}
"""


@pytest.mark.slow
@pytest.mark.jit
def test_the_command_and_its_parts(tmp_path, capsys, printed, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.yaml").write_text(YAML)
    said = printed(["sweep", "s.yaml", "--dry-run"]).out
    assert said.startswith("4 settings x 1 worlds x 3 strategies x 24 episodes = 288 episodes\n2 units of about 144")
    assert "1 compiled programs" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.yaml"]
    said = printed(["sweep", "s.yaml", "--out", "whole"]).out
    assert "| rooms:width_m=5,height_m=5 |" in said
    names = "episodes.parquet, summary.csv, asked.yaml, run.json, sweep.png, report.html"
    assert said.splitlines()[-1] == f"wrote {names} to whole/"
    files = [*names.split(", "), "sweep.svg"]
    assert sorted(path.name for path in (tmp_path / "whole").iterdir()) == sorted(files)
    whole = jx.load("whole")
    assert whole.spec == read_spec("s.yaml")
    pd.testing.assert_frame_equal(pd.read_csv("whole/summary.csv"), whole.summary, check_dtype=False)
    monkeypatch.setattr(plans, "MAX_UNIT_EPISODES", 100)
    for i in (1, 2, 3):
        assert main.main(["sweep", "s.yaml", "--shard", f"{i}/3", "--out", f"part{i}", "--no-report"]) == 0
    assert len(jx.load("part2").episodes) == 96
    for given, message in (
        (["part1", "part3"], "all parts must be given, and 2/3 are not"),
        (["part1", "part1", "part2"], "part1 is part 1/3, and so is part1"),
        (["part1", "whole"], "whole must hold a part of a sweep"),
        (["nowhere"], "nowhere must be the folder of a run"),
        ([], "expected the folders of all parts, got none"),
    ):
        capsys.readouterr()
        assert message in printed(["merge", *given, "--out", "merged"], 2).err
    assert main.main(["merge", "part3", "part1", "part2", "--out", "merged"]) == 0
    pd.testing.assert_frame_equal(jx.load("merged").episodes, whole.episodes)
    assert json.loads((tmp_path / "merged" / "run.json").read_text())["parts"] == ["part3", "part1", "part2"]
    (tmp_path / "s.yaml").write_text(YAML.replace("24", "23"))
    assert main.main(["sweep", "s.yaml", "--out", "whole", "--resume"]) == 2
    assert "holds a run of 24 episodes, more than 23: ask for 24 or more" in capsys.readouterr().err
    (tmp_path / "s.yaml").write_text(YAML.replace("24", "25"))
    assert main.main(["sweep", "s.yaml", "--out", "whole", "--resume", "--no-report"]) == 0
    longer = jx.load("whole")
    assert longer.resumed == 288
    pd.testing.assert_frame_equal(
        longer.episodes[longer.episodes["episode"] < 24].reset_index(drop=True), whole.episodes
    )
    pd.testing.assert_frame_equal(longer.episodes, sweep("s.yaml").episodes)


def test_parts_that_were_not_continued_alike_do_not_merge(tmp_path, capsys, printed, monkeypatch):
    """Part 2 is made with 11 episodes and continued to 20, which cuts its work in another way than part 1 at once."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plans, "MAX_UNIT_EPISODES", 8)

    def run_units(jobs, all_units, numbers, *, ledger, earlier, **how):
        work = Work(numbers, ledger)
        for number in work.left:
            work.put(number, pd.concat([made(jobs[i], first, n) for i, first, n in all_units[number].blocks]))
        return units.Ran([*earlier, *work.results], Costs(), 0)

    def made(job, first, n):
        rows = {name: np.zeros(n) for name in COLUMNS} | {"setting": 0, "world": WORLDS[0]}
        rows |= {"strategy": job.strategy.name, "outcome": "COMPLETE"}
        rows |= {"episode": np.arange(first, first + n), "cell_m": 0.1}
        return pd.DataFrame(rows)

    def sweep_part(episodes, *options):
        asked = {"worlds": WORLDS[:1], "strategies": ["closest"], "episodes": episodes}
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(asked))
        assert main.main(["sweep", "s.yaml", "--no-report", *options]) == 0

    monkeypatch.setattr(runs, "run_units", run_units)
    for part in (1, 2):
        sweep_part(11, "--shard", f"{part}/2", "--out", f"short{part}")
    sweep_part(20, "--shard", "2/2", "--out", "short2", "--resume")
    assert main.main(["sweep", "s.yaml", "--shard", "1/2", "--out", "short2", "--resume"]) == 2
    assert 'its shard is "2/2", not "1/2"' in capsys.readouterr().err
    sweep_part(20, "--shard", "1/2", "--out", "part1")
    capsys.readouterr()
    said = printed(["merge", "part1", "short2", "--out", "merged"], 2).err
    assert re.search(r"must hold each episode once: \d+ are there twice and \d+ nowhere, .*continue all", said)
    sweep_part(20, "--shard", "1/2", "--out", "short1", "--resume")
    assert main.main(["merge", "short1", "short2", "--out", "./short1/", "--overwrite"]) == 2
    assert "must be a folder of its own, got that of the part short1" in capsys.readouterr().err
    assert main.main(["merge", "short1", "short2", "--out", "merged", "--no-report"]) == 0
    assert jx.load("merged").episodes["episode"].tolist() == list(range(20))


def test_what_settings_leave_out_is_the_sweeps_own():
    spec = Sweep(["a"], seed=7, cell_m=0.2, settings=[{"seed": 1, "cell_m": 0.1}, {"lidar.range_m": 4}])
    assert spec.expanded() == [
        {"seed": 1, "cell_m": 0.1, "lidar.range_m": 8.0},
        {"seed": 7, "cell_m": 0.2, "lidar.range_m": 4},
    ]


@pytest.mark.parametrize(
    "text",
    ["!!int foo", "!!timestamp foo", "[" * 3000, "&a [*a]", "[a]\nworlds: [b]", "[cave]\ncell_m: {a: 1}",
     "[a]\nsettings: [{lidar.range_m: [4, 8]}]", "[a]\nlidar: {range_m: [[4, 8]]}",
     "[a]\nsettings: [{tuning.votes: 3}]",
     "[a]\nseed: -1\ndraws: 3\nlidar: {range_m: {low: 1, high: 2}}"],
)  # fmt: skip
def test_odd_yaml_is_one_line(text, tmp_path):
    (tmp_path / "s.yaml").write_text(f"worlds: {text}\n")

    def read():
        return read_spec(tmp_path / "s.yaml").records()

    refused(None, read)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "expected a file that says what is varied: jexplore sweep SPEC.yaml"),
        (["s.yaml", "--shard", "0/3"], "--shard must be I/N with I from 1 to N, such as 1/4, got '0/3'"),
        (["s.yaml", "--shard", "half"], "--shard must be I/N"),
        (["s.yaml", "--shard", "9/9"], "the sweep has only 2 units"),
    ],
)
def test_bad_commands_are_one_line(options, message, tmp_path, refuses, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.yaml").write_text(YAML)
    refuses(["sweep", *options], message)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.yaml"]
