"""A league under a name: what it takes, what it refuses, and its standings."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest
from ref.refusals import refused

from jexplore.cli import main
from jexplore.studies import comparison
from jexplore.studies.results import league
from jexplore.studies.results.loading import load, run_record
from jexplore.studies.statistics.league import standings

WORLDS = ("rooms#0:width_m=5,height_m=5", "rooms#1:width_m=5,height_m=5")
STRATEGIES = ["closest+recheck", "closest"]


@pytest.fixture(scope="module")
def run(jit_on, tmp_path_factory):
    """Folder of a comparison in the worlds of the league `tiny`."""
    folder = tmp_path_factory.mktemp("league") / "run"
    with jit_on():
        comparison.compare(WORLDS, STRATEGIES, episodes=1, out=folder)
    return folder


@pytest.fixture(autouse=True)
def _tiny(run, monkeypatch):
    first = load(run).episodes.query("strategy == 'closest'")
    digest = league.digest_of(run_record(run)["asked"], first)
    monkeypatch.setitem(league.LEAGUES, "tiny", league.League("0.1.0", WORLDS, digest))


def test_strategies_are_entered_once_and_ranked_as_in_their_run(run, tmp_path, capsys, printed):
    folder, found = tmp_path / "entries", load(run)
    assert league.submit(run, "tiny", folder) == {"closest+recheck": True, "closest": True}
    assert sorted(path.name for path in folder.iterdir()) == ["closest+recheck.json", "closest.json"]
    assert league.submit(run, "tiny", folder) == {"closest+recheck": False, "closest": False}
    kept = league.entries_table(folder, "tiny")
    for column in league.COLUMNS:
        own = found.episodes.sort_values(["strategy", "world"], key=lambda a: a if a.name == "world" else a.map(
            {name: i for i, name in enumerate(STRATEGIES)}))[column]  # fmt: skip
        if column in league.LENGTHS:
            assert kept[column].to_numpy() == pytest.approx(own.to_numpy(float), abs=1e-4)
        elif column != "explored_fraction":
            assert kept[column].tolist() == own.tolist()
    ours, theirs = standings(kept), standings(found.episodes)
    pd.testing.assert_frame_equal(ours, theirs, rtol=1e-3, check_exact=False)
    shown = printed(["league", "--name", "tiny", "--entries", str(folder)]).out
    assert "closest+recheck" in shown
    assert "ratio to the reference" in shown
    assert main.main(["league", "submit", str(run), "--name", "tiny", "--entries", str(folder)]) == 0
    assert capsys.readouterr().out.startswith("closest+recheck: as entered before\nclosest: as entered before\n\n")


def changed(run, folder, **asked):
    """Copy a run with another record."""
    folder.mkdir()
    for path in run.iterdir():
        if path.is_file():
            (folder / path.name).write_bytes(path.read_bytes())
    record = run_record(run)
    own = record["asked"]
    own |= {name: own[name] | value if isinstance(value, dict) else value for name, value in asked.items()}
    (folder / "run.json").write_text(json.dumps(record))
    return folder


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"version": "0.0.9"}, "version must be as the league's, got other '0.0.9'"),
        ({"worlds": [*WORLDS[:1]]}, f"worlds must be as the league's, got other {WORLDS[1]}"),
        ({"worlds": [*WORLDS, "cave"]}, "worlds must be as the league's, got other cave"),
        ({"worlds": [*WORLDS[::-1]]}, "worlds must be as the league's, got other order"),
        ({"seed": 3}, "seed must be as the league's, got other 3"),
        ({"episodes": 2}, "episodes must be as the league's, got other 2"),
        ({"digests": dict.fromkeys(WORLDS, "0")}, "worlds or starts are not those of tiny, though their names"),
        ({"command": "sweep"}, "not the folder of a comparison"),
        ({"rules": {"clearance_m": 1, "near_m": 0.4}}, "rules must be as the league's, got other clearance_m, near_m"),
    ],
)
def test_other_runs_are_refused(run, tmp_path, asked, message):
    other = changed(run, tmp_path / "other", **asked)
    refused(re.escape(message), league.submit, other, "tiny", tmp_path / "entries")
    assert not (tmp_path / "entries").exists()


def test_every_world_and_the_reference_are_needed(run, tmp_path):
    other = changed(run, tmp_path / "other")
    table = pd.read_parquet(other / "episodes.parquet")
    table[table["strategy"] == "closest"].to_parquet(other / "episodes.parquet")
    asked = other, "tiny", tmp_path / "entries"
    refused(r"closest\+recheck is missing: every submission runs it too", league.submit, *asked)
    table[(table["strategy"] != "closest") | (table["world"] != WORLDS[1])].to_parquet(other / "episodes.parquet")
    refused(f"closest must have one episode in each world, {WORLDS[1]} has none", league.submit, *asked)


def test_an_entry_with_other_episodes_is_kept(run, tmp_path):
    folder = tmp_path / "entries"
    league.submit(run, "tiny", folder)
    path = folder / "closest.json"
    entry = json.loads(path.read_text())
    entry["episodes"][1][league.COLUMNS.index("path_m")] += 0.1
    path.write_text(json.dumps(entry))
    refused(f"closest is entered with another episode in {WORLDS[1]}", league.submit, run, "tiny", folder)
    assert json.loads(path.read_text()) == entry


def test_files_that_are_no_entries_are_refused(run, tmp_path):
    refused(r"no entry of closest\+recheck there", league.entries_table, tmp_path / "nothing", "tiny")
    league.submit(run, "tiny", tmp_path)
    path = tmp_path / "closest.json"
    entry = json.loads(path.read_text())
    for text in ("[]", "{", json.dumps(entry | {"episodes": [[]]})):
        path.write_text(text)
        refused(r"closest\.json: not an entry of a league", league.read_entries, tmp_path, "tiny")
    for more in ({"version": "9"}, {"digest": ""}, {"episodes": entry["episodes"][:1]}):
        path.write_text(json.dumps(entry | more))
        refused(r"closest\.json: not an entry of tiny, version 0\.1\.0", league.read_entries, tmp_path, "tiny")
    refused("'tony'", league.read_entries, tmp_path, "tony")


def test_a_run_stands_with_submit_alone(printed):
    for words in (["submit"], ["show", "runs"]):
        assert "expected the folder of a run with submit" in printed(["league", *words], 2).err


def test_outside_a_checkout_one_line_says_where_entries_are(tmp_path, refuses):
    refuses(["league", "--entries", tmp_path / "none"], "of a checkout of the repository with --entries")


def test_the_entries_of_the_repository():
    folder = Path(__file__).parents[1] / "leagues" / "exploration-240"
    entries = league.read_entries(folder, "exploration-240")
    assert entries[0]["strategy"] == league.REFERENCE
    assert len(entries) == len(list(folder.glob("*.json"))) >= 8
    first, *others = (entry["episodes"] for entry in entries)
    starts = slice(0, 1 + len(league.WHOLE))
    assert all([row[starts] for row in rows] == [row[starts] for row in first] for rows in others)
