"""`jexplore trace`: what it writes, what it says, what it refuses."""

import contextlib
import dataclasses
import io
import json
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from ref.refusals import refused

from jexplore.cli import main
from jexplore.cli.tracemaps import trace
from jexplore.driving import batch
from jexplore.engine.runner import Costs
from jexplore.report import operator_view, plot_traces, trace_tables
from jexplore.studies.traces import job, recording, tracing
from jexplore.tracemap import corrected, json_form
from jexplore.tracemap.merging.rigid import Move, moved_map
from jexplore.tracemap.record import BtmMap, check_map
from jexplore.tracemap.similarity import code

AWAY_M = 100.0  # m; the corrected map is shifted by this here, so that it is known again


@pytest.fixture(scope="module")
def made(tmp_path_factory, jit_on):
    """The folder of a sweep of two settings with a run of each; what was printed; the maps drawn."""
    out, drawn, figure = tmp_path_factory.mktemp("runs") / "new", [], plot_traces.trace_figure
    with jit_on(), pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as said:
        patch.setattr(corrected, "correct_map", lambda btm: moved_map(btm, Move(AWAY_M)))
        patch.setattr(
            plot_traces,
            "trace_figure",
            lambda btm, *more, **options: drawn.append(btm) or figure(btm, *more, **options),
        )
        options = "--noise-m 0.01 --runs 1 --sweep votes=5,1 --seed 3 --corrected"
        assert main.main(["trace", *options.split(), "--out", str(out)]) == 0
    return out, said.getvalue(), drawn


@pytest.fixture(scope="module")
def ran(made):
    return made[0]


def test_files(ran):
    names = ["btm.json", "btm.png", "run.json", "runs.parquet"]
    assert sorted(path.name for path in ran.iterdir()) == names
    found = json_form.read_btm(ran / "btm.json")
    assert [node.type[0] for node in found.nodes] == list("tooodffdt")
    table = pd.read_parquet(ran / "runs.parquet")
    assert table["setting"].tolist() == [0, 1]
    assert table["run"].tolist() == [0, 0]
    assert table["votes"].tolist() == [5, 1]
    assert table["code"][0] == code(found)
    assert table["outcome"][0] == "GOAL"
    record = json.loads((ran / "run.json").read_text())
    assert record["command"][:2] == ["jexplore", "trace"]
    assert record["configuration"]["noise_m"] == 0.01
    assert record["runs_per_s"] > 0
    with Image.open(ran / "btm.png") as image:
        assert min(image.size) > 300


@pytest.mark.slow
@pytest.mark.jit
def test_the_page_shows_the_run_that_was_made(tmp_path, capsys):
    options = ["--noise-m", "0.01", "--animate", "--max-steps", "1000", "--out", str(tmp_path / "new")]
    assert main.main(["trace", *options]) == 0
    assert recording._view.__wrapped__._cache_size() == 1  # the page's steps are one program
    page = (tmp_path / "new" / "btm.html").read_text(encoding="utf-8")
    assert "kamui in course" in page
    assert "branch selection" in page
    assert len(page) > 200_000


class Recorded(NamedTuple):
    """The part of a `RunRecording` that is compared with the run."""

    pose: np.ndarray


def result_of(table, **changes):
    """Return a result with a table and a run 0 of five steps at the origin; `changes` of the plan."""
    plan = dataclasses.replace(job.prepare_trace("course"), **changes)
    driven = batch.Driven(np.zeros((5, 3)), np.zeros((5, 3)), np.zeros(5), np.zeros(5))
    return tracing.TraceResult(plan, table, BtmMap((), ()), driven, Costs())


@pytest.mark.parametrize(
    ("n", "off_m", "warns"), [(5, 0.0, False), (5, 0.005, False), (7, 0.0, True), (4, 0.0, True), (5, 0.25, True)]
)
def test_a_page_of_another_run_says_so(n, off_m, warns, tmp_path, monkeypatch, capsys):
    """Run 0 had five steps; progress never goes beyond them."""

    def record(plan, on_progress):
        for done in range(1, n + 1):
            on_progress(done)
        pose = np.tile([7.0, 8.0, 0.0], (n, 1))
        pose[2, 1] += off_m
        return Recorded(pose)

    monkeypatch.setattr(recording, "record_run", record)
    monkeypatch.setattr(operator_view, "page", lambda seen: "a page")
    counts = []
    monkeypatch.setattr(trace, "working", lambda total, unit: contextlib.nullcontext(counts.append))
    world = dataclasses.replace(job.prepare_trace("course").world, origin_m=(7.0, 8.0))
    trace._write_view(result_of(pd.DataFrame(), world=world), tmp_path / "btm.html")
    assert (tmp_path / "btm.html").read_text() == "a page"
    assert max(counts) <= 5
    said = capsys.readouterr().err
    assert (f"it has {n} steps (run 0 has 5) and lies up to {off_m:.2f} m off" in said) == warns


def test_files_text_and_picture_show_one_map(made):
    out, said, drawn = made
    found = json_form.read_btm(out / "btm.json")
    assert min(node.x_m for node in found.nodes) > 0.9 * AWAY_M
    assert trace_tables.map_tables(found) in said
    assert [check_map(one) for one in drawn] == [found]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--world", "curse"), "there is no world 'curse'"),
        (("--start", "0.1", "0.1", "0"), "lies in a wall"),
        (("--start", "2.5", "27", "east"), "--start: Could not parse arguments ['2.5', '27', 'east']"),
        (("--start", "2.5", "27", "nan"), "start heading must be a number"),
        (("--sweep", "circle=0.2,1.5"), "tuning.circle"),
        (("--contact", "none"), "--contact goes with --robots"),
    ],
)
def test_what_is_refused(options, says, refuses, tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "run_missions", lambda *_, **__: pytest.fail("it began"))
    refuses(["trace", *options, "--out", tmp_path / "new"], says)
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
@pytest.mark.jit
def test_an_interruption_keeps_what_is_finished(tmp_path, capsys):
    def interrupt(done):
        if done > 8:  # a unit
            raise KeyboardInterrupt

    plan = job.prepare_trace("course", runs=40, seed=3, max_steps=100)
    found = tracing.execute(plan, workers=1, on_progress=interrupt)
    assert found.costs.interrupted
    assert len(found.table) in range(8, 40, 8)
    assert found.table["run"].tolist() == list(range(len(found.table)))
    assert set(found.table["outcome"]) == {"STEP_LIMIT"}


@pytest.mark.parametrize(
    ("text", "want"),
    [
        ("victim=true@12.5,4", ("victim", True, (12.5, 4.0))),
        ("radio_dbm=-61@-3,8e0", ("radio_dbm", -61, (-3.0, 8.0))),
        ("mail=a@b=c@1,2", ("mail", "a@b=c", (1.0, 2.0))),
        ('note={"by": "op"}@0,0', ("note", {"by": "op"}, (0.0, 0.0))),
    ],
)
def test_attributes_by_hand(text, want):
    assert job.attributes_of([text]) == (want,)


@pytest.mark.parametrize("text", ["victim=1", "=1@2,3", "victim=1@2", "victim@2,3", "a=1@2,nan"])
def test_attributes_that_are_none(text):
    refused("attribute must be NAME=VALUE@X,Y", job.prepare_trace, "course", attributes=[text])


def test_an_attribute_that_json_cannot_hold():
    refused("attributes must be what JSON can hold", job.attributes_of, ["heat=1e999@0,0"])
    assert job.attributes_of(["deep=" + "[" * 100_000 + "@0,0"])[0][1].startswith("[[")
    refused("start and starts exclude each other", job.prepare_trace, "course", starts=2, start=(2.5, 27.0, 0.0))


@pytest.mark.slow
def test_the_nearest_node_in_truth_gets_an_attribute(ran, jit_on):
    found = json_form.read_btm(ran / "btm.json")
    goal = found.nodes[-1]
    with jit_on():
        marked = tracing.trace(
            "course", attributes=[f"victim=true@{goal.x_m - AWAY_M},{goal.y_m}", "radio=-40@0,27"], workers=1
        )
    assert [node.attributes.get("victim") for node in marked.first.nodes] == [None] * (len(found.nodes) - 1) + [True]
    assert marked.first.nodes[0].attributes["radio"] == -40
    assert marked.first.attributes["frame"] == "odom"


def test_starts_are_drawn_and_a_run_is_held_against_a_topology_only_from_its_start():
    plan = job.prepare_trace("course#3", starts=3, seed=4)
    own = job.prepare_trace("course#3", runs=2)
    assert (plan.runs, len(plan.begins), own.runs, len(own.begins)) == (3, 3, 2, 1)
    assert len({tuple(pose) for pose in plan.begins.tolist()}) == 3
    assert plan.starts_of(np.array([0, 1, 3])).tolist() == plan.begins[[0, 1, 0]].tolist()
    assert plan.topology is None
    assert own.topology is own.world.course.topology
    again = job.prepare_trace("course#3", starts=2, runs=5, seed=4)
    assert again.begins.tolist() == plan.begins[:2].tolist()
    assert again.runs == 5


@pytest.mark.slow
def test_on_a_course_without_a_goal_every_start_has_its_own_truth():
    plan = job.prepare_trace("course:loops=1", starts=12, seed=1)
    assert np.isnan(plan.building.goal).all()
    assert plan.size == (32, 64)
    assert plan.max_steps >= 100 * plan.world.free_m2
    assert {len(own) for own in plan.truths} == {0, 1, 2}, "in a circle, on a link, square to a link"
    for pose, own in zip(plan.begins, plan.truths):
        for true in own:
            assert (true.nodes[0].x_m, true.nodes[0].y_m) == pytest.approx(pose[:2].tolist())
            assert len(true.links) == len(true.nodes) == 10
    assert plan.topology == (plan.truths[0] or (None,))[0]
    own = job.prepare_trace("course:loops=1")
    assert own.topology == own.world.course.topology
    assert job.prepare_trace("course:loops=2,repeat=10").size == (64, 128)
    assert job.prepare_trace("course#2").size == (32, 64)


def summed(true):
    """Return lines about runs of two settings of which `true` made the true map."""
    n = len(true)
    table = pd.DataFrame({name: np.zeros(n, int) for name in trace_tables.NOTED} | {
        "run": range(n), "outcome": "EXHAUSTED", "code": "T", "setting": np.arange(n) % 2, "nodes": 1,
        "true": pd.array(true, dtype="boolean"),
    })  # fmt: skip
    return trace_tables.summary(result_of(table, settings=2))


def test_runs_without_a_truth_do_not_count():
    told = summed([True, False, None, True])
    assert told[2].startswith("that of the true topology: 66.7 % ")
    assert told[2].endswith(" of 3 runs that began on a link")
    assert "true map" in told[-1]
    nobody = summed([None] * 4)
    assert not any("true" in line for line in nobody)
    assert "alike" in nobody[-1]
    assert summed([True, False])[2].endswith("]")
