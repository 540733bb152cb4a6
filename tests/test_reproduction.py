"""Papers reproduced: their figures, their claims on tables by hand, small real runs, refusals."""

import json
import math
import shutil

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from ref.refusals import refused
from scipy import stats

import jexplore
from jexplore.exploration import batch
from jexplore.rules import Lidar
from jexplore.studies import papers
from jexplore.studies.reproduction import ReproductionResult, prepare_paper, reproduce, verdict, world_names
from jexplore.studies.results.columns import COLUMNS
from jexplore.studies.results.comparison import ComparisonResult
from jexplore.studies.statistics import paired
from jexplore.studies.statistics.paired import PairedRatio

LIDAR, CLI_LIDAR = Lidar(n_beams=37, range_m=2.0), ("--lidar.n-beams", "37", "--lidar.range-m", "2")
HERE = ("random", "closest", "closest+recheck")
SEGMENT = "closest+recheck+segment"
PAPER = papers.HOLZ2010


def tiny(*worlds):
    """The paper with two environments, in these worlds, and with the strategies `HERE`."""
    environments = {
        name: PAPER.environments[name]._replace(
            counterpart=world, paths={key: PAPER.environments[name].paths[key] for key in HERE}
        )
        for name, world in zip(("Cave", "AVZ"), worlds)
    }
    return PAPER._replace(environments=environments)


def made(means, *, paper=PAPER, n=12, spread=1e-4, outcomes=()):
    """A reproduction of made-up episodes: `means` {environment: {strategy: path length}}, with noise of `spread`."""
    worlds, rng, tables = world_names(paper), np.random.default_rng(0), []
    for environment, paths in means.items():
        ordered = sorted(paths, key=lambda name: name != "closest")
        for strategy in ordered:
            table = pd.DataFrame(0, index=range(n), columns=list(COLUMNS))
            path_m = paths[strategy] * rng.uniform(1 - spread, 1 + spread, n)
            outcome = ["COMPLETE"] * (n - len(outcomes)) + list(outcomes)
            found = {"world": worlds[environment], "strategy": strategy, "episode": range(n), "path_m": path_m}
            tables.append(table.assign(**found, outcome=outcome, explored_fraction=1.0))
    comparison = ComparisonResult(pd.concat(tables, ignore_index=True), (), 1.0, 1.0)
    return ReproductionResult(paper, comparison, worlds, ("a note",))


def as_published():
    return {name: {key: path[0] for key, path in found.paths.items()} for name, found in PAPER.environments.items()}


def test_the_orderings_hold_in_the_papers_own_figures():
    found = made(as_published())
    table = found.orderings
    assert table["environment"].value_counts().to_dict() == {"Cave": 15, "AVZ": 10, "Hospital": 10}
    assert set(table["verdict"]) == {"holds"}
    np.testing.assert_allclose(table["ratio"], table["paper_ratio"], rtol=1e-3)
    assert (table["paper_ratio"] < 1).all()
    first = table.iloc[0]
    assert (first["a"], first["b"], first["paper_ratio"]) == ("closest+recheck", SEGMENT, 70.45 / 72.89)
    assert "- Cave: 15 of 15 pairs of means in the paper's order, Kendall's tau 1.00." in found.agreement


def test_of_sixteen_orderings_that_the_text_says_its_figures_bear_out_twelve():
    table = made(as_published()).orderings
    claimed = table[table["claimed"]]
    assert len(claimed) == 16
    assert claimed["paper_p"][claimed["paper_p"] > 0.05].round(2).sort_values().tolist() == [0.22, 0.63, 0.70, 0.80]
    want = stats.ttest_ind_from_stats(72.89, 5.77, 10, 70.45, 0.97, 10, equal_var=False).pvalue
    assert table["paper_p"].iloc[0] == pytest.approx(want)


def test_where_nothing_differs_or_all_is_noise_nothing_is_decided():
    equal = {place: dict.fromkeys(paths, 100.0) for place, paths in as_published().items()}
    found = made(equal, spread=0.0).orderings
    assert set(found["verdict"]) == {"undecided"}  # one episode repeated: however clear, no more than one pair
    assert set(found["pairs"]) == {1}
    found = made({"Cave": dict.fromkeys(HERE, 100.0)}, spread=0.5).orderings
    assert set(found["verdict"]) == {"undecided"}
    ran = found[found["pairs"] > 0]
    assert len(ran) == 3
    assert (ran["ratio_low"] < 1).all()
    assert (ran["ratio_high"] > 1).all()


@pytest.mark.parametrize(
    ("low", "high", "n", "told"),
    [
        (0.8, 0.9, 20, "holds"),
        (0.8, 0.9, 5, "undecided"),
        (1.1, 1.2, 20, "does not hold"),
        (0.9, 1.1, 20, "undecided"),
        (0.9, 1.0, 20, "undecided"),
        (math.nan, math.nan, 20, "undecided"),
    ],
)
def test_verdicts(low, high, n, told):
    assert verdict(PairedRatio((low + high) / 2, low, high, math.nan, n)) == told


def test_tables_by_hand():
    found = made(
        {"Cave": {"random": 200.0, "closest": 100.0, "closest+recheck": 90.0}}, spread=0.0, outcomes=["BLOCKED"]
    )
    table = found.tables
    assert table["strategy"].tolist() == list(HERE)  # the paper's order
    assert table["paper_mean"].tolist() == [102.84, 73.71, 70.45]
    assert table["mean"].tolist() == pytest.approx([200, 100, 90])
    assert table["ratio"].tolist() == pytest.approx([2.0, 1.0, 0.9])
    assert table["paper_ratio"].tolist() == pytest.approx([102.84 / 73.71, 1.0, 70.45 / 73.71])
    assert table["n"].tolist() == [12] * 3
    assert table["first_n"].tolist() == [10] * 3
    assert table["outcomes"].tolist() == ["COMPLETE 11, BLOCKED 1"] * 3
    assert set(found.orderings["complete"][found.orderings["pairs"] > 0]) == {11}
    text = found.to_markdown()
    assert text == found._repr_markdown_()
    assert "## Hospital (Table 3, Figure 8c): hospital\n\nNothing has run here." in text


@pytest.fixture
def no_run(monkeypatch):
    monkeypatch.setattr(batch, "run_jobs", lambda *_, **__: pytest.fail("ran"))


def folder_of_maps(path, but=None):
    """Small maps under the names that the paper's have."""
    for environment in PAPER.environments.values():
        if environment.file == but:
            continue
        file = path / environment.file
        file.parent.mkdir(exist_ok=True)
        if file.suffix == ".yaml":
            head = "resolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
            file.write_text(f"image: {file.stem}.pgm\n{head}")
            file = file.with_suffix(".pgm")
        grey = np.full((60, 80), 255, np.uint8)
        grey[[0, -1]], grey[:, [0, -1]] = 0, 0
        Image.fromarray(grey).save(file)
    return path


def test_a_missing_map_is_named(tmp_path, no_run):
    missing = PAPER.environments["AVZ"].file
    folder_of_maps(tmp_path, but=missing)
    refused(f"there is no file {tmp_path / missing}$", reproduce, maps=tmp_path)


def test_maps_are_loaded_at_their_scale(tmp_path, monkeypatch):
    short = {
        name: found._replace(paths={"closest": (1, 1), "random": (2, 1)}) for name, found in PAPER.environments.items()
    }
    monkeypatch.setitem(papers.PAPERS, "tiny", PAPER._replace(environments=short))
    folder_of_maps(tmp_path)
    jobs = prepare_paper("tiny", maps=tmp_path, episodes=2, seed=0, cell_m=0.1, lidar=LIDAR, rules=jexplore.Rules())
    assert [job.strategy.name for job in jobs] == ["closest", "random"] * 3
    names = [f"{tmp_path}/{name}" for name in ("stage/cave_filled.png@16x16", "avz/avz5floor_open.yaml")]
    assert [job.world.name for job in jobs[::2]] == [*names, f"{tmp_path}/stage/hospital_section.png@49.3x20.1"]
    assert [tuple(side // 10 for side in job.world.shape) for job in jobs[::2]] == [(16, 16), (3, 4), (20, 49)]
    shutil.rmtree(tmp_path / "stage")  # names are still known when the run has ended
    assert world_names(PAPER, tmp_path)["Cave"] == names[0]


@pytest.mark.filterwarnings("ignore:.*no way leads to 6 m2")  # closets of avz5floor_open
def test_the_maps_of_the_paper_can_be_loaded(maps):
    shorter = {name: found._replace(paths={"closest": (1, 1)}) for name, found in PAPER.environments.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(papers.PAPERS, "tiny", PAPER._replace(environments=shorter))
        jobs = prepare_paper("tiny", maps=maps, episodes=1, seed=0, cell_m=0.1, lidar=Lidar(), rules=jexplore.Rules())
    assert [round(job.world.free_m2) for job in jobs] == [192, 314, 887]


@pytest.fixture(scope="module")
def small():
    """The name of a small paper in two tiny worlds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(papers.PAPERS, "tiny", tiny("cave:width_m=6.4,height_m=6.4", "cave#1:width_m=6.4,height_m=6.4"))
        yield "tiny"


@pytest.fixture(scope="module")
def ran(small, jit_on):
    with jit_on():
        return reproduce(small, episodes=3, seed=1, lidar=LIDAR)


def test_a_small_run(ran):
    table = ran.to_pandas()
    assert list(table.columns) == list(COLUMNS)
    assert len(table) == 2 * 3 * 3
    assert ran.tables["environment"].tolist() == ["Cave"] * 3 + ["AVZ"] * 3
    for row in ran.tables.itertuples():
        ours = table[(table["world"] == row.world) & (table["strategy"] == row.strategy)]["path_m"]
        theirs = table[(table["world"] == row.world) & (table["strategy"] == "closest")]["path_m"]
        assert row.mean == pytest.approx(ours.mean())
        assert row.ratio == pytest.approx(paired.paired_ratio(ours, theirs).ratio)
    assert ran.orderings["pairs"].tolist() == [3] * 6
    assert "NOT the paper's maps" in ran.to_markdown()
    assert "18 episodes" in repr(ran)


@pytest.mark.jit
def test_the_command_writes_a_whole_run(ran, small, tmp_path, printed):
    out = tmp_path / "run"
    command = ["reproduce", small, "--episodes", "3", "--seed", "1", "--out", str(out), *CLI_LIDAR]
    said = printed(command).out
    assert said.startswith(ran.to_markdown())
    assert said.splitlines()[-1] == f"wrote episodes.parquet, details.parquet, run.json to {out}/"
    pd.testing.assert_frame_equal(pd.read_parquet(out / "episodes.parquet"), ran.to_pandas())
    record = json.loads((out / "run.json").read_text())
    assert [row["paper_mean"] for row in record["tables"]] == ran.tables["paper_mean"].tolist()
    assert [row["verdict"] for row in record["orderings"]] == ran.orderings["verdict"].tolist()
    assert record["notes"] == list(ran.notes)
    assert record["interrupted"] == 0
    assert "holds a run" in printed(command, 2).err


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("holz2011", "unknown paper 'holz2011'; did you mean 'holz2010'? (there are: holz2010"),
        ("tiny --episodes 0", "episodes must be an integer from 1"),
        ("tiny --maps nowhere", "there is no file nowhere/stage/cave_filled.png"),
    ],
)
def test_bad_input_is_one_line(command, message, small, no_run, refuses, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refuses(["reproduce", *command.split()], message)
    assert list(tmp_path.iterdir()) == []
