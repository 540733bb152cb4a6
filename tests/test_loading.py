"""Folders of runs that lack something, or hold what this version does not know: told in one line."""

import json

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.config import __version__
from jexplore.report import store
from jexplore.studies.results import details
from jexplore.studies.results.columns import COLUMNS
from jexplore.studies.results.comparison import ComparisonResult
from jexplore.studies.results.loading import load, merge

RECORD = {
    "command": ["jexplore", "compare"],
    "configuration": {"lidar": {"range_m": 4.0}, "rules": {}},
    "environment": {"jexplore": __version__},
    **{"compile_s": 1.0, "run_s": 1.0, "interrupted": False, "resumed": 0},
}
EPISODES = pd.DataFrame({name: [0] for name in COLUMNS} | {"world": ["w"], "strategy": ["s"]})
SEEN = details.Seen("s", np.zeros((3, 3), np.uint8), np.arange(2), np.arange(2), 0.1, 1.5)
FOUND = ComparisonResult(
    EPISODES,
    (jx.World(np.ones((3, 3), bool), name="w", start=(1, 1, 45)),),
    1.0,
    1.0,
    details=pd.DataFrame({details.PROGRESS: [np.arange(100.0)], details.SEEN: [SEEN]}),
)


@pytest.fixture
def folder(tmp_path):
    """Of a comparison of one episode, whose record is changed and written by `write`."""
    store.write_parquet(EPISODES, tmp_path / "episodes.parquet")
    store.write_parquet(details.details_of(FOUND), tmp_path / details.DETAILS)

    def write(record):
        (tmp_path / "run.json").write_text(json.dumps(record))
        return tmp_path

    return write


def test_a_whole_folder_is_read(folder):
    found = load(folder(RECORD))
    assert (found.lidar, [world.start for world in found.worlds]) == (jx.Lidar(range_m=4.0), [(1, 1, 45)])
    assert repr(found.first) == repr(FOUND.first)
    np.testing.assert_array_equal(found.progress["w", "s"], FOUND.progress["w", "s"])


@pytest.mark.parametrize("name", sorted(RECORD))
def test_a_record_without_an_entry_is_refused(folder, name):
    record = {key: value for key, value in RECORD.items() if key != name}
    if name == "environment":  # which nothing needs
        load(folder(record))
    else:
        refused(
            f"its command is|must hold a whole run of this version: there is no '{name}|'lidar'", load, folder(record)
        )


@pytest.mark.parametrize("name", ["command", "configuration", "environment", "asked"])
@pytest.mark.parametrize("value", [[], {}, None, "text", [["jexplore", "compare"]]])
def test_a_record_with_anything_in_anythings_place_is_one_line(folder, name, value):
    path = folder({**RECORD, name: value})
    if (name, value) in (("environment", {}), ("asked", {})):
        load(path)
    else:
        refused("run.json must be the record of a run: its|must hold a whole run", load, path)
    refused("run.json must be the record of a run: its|must hold a part of a sweep", merge, [path])


def test_a_field_of_a_later_version_is_told_with_both_versions(folder):
    later = {**RECORD, "configuration": {"lidar": {"colour": 3}, "rules": {}}, "environment": {"jexplore": "99.0"}}
    refused(f"colour.*; jexplore '99.0' wrote it, this is {__version__}$", load, folder(later))


def test_incomplete_details_are_refused(folder):
    path = folder(RECORD)
    whole = pd.read_parquet(path / details.DETAILS)
    for name in (details.WORLD, details.PROGRESS, details.SEEN):
        store.write_parquet(whole.drop(columns=name), path / details.DETAILS)
        refused(f"details.parquet must have the column {name}", load, path)
    store.write_parquet(whole.assign(_world=[b"x"]), path / details.DETAILS)
    refused("must hold a whole run of this version: No data left", load, path)
    store.write_parquet(pd.concat([whole, whole]), path / details.DETAILS)
    refused("details.parquet must have a row for each of 1 episodes", load, path)
    (path / details.DETAILS).unlink()
    refused("details.parquet': there is no such file", load, path)


@pytest.mark.parametrize("text", ["{", "[" * 600 + "]" * 600, "[]", "3", '"a"', ""])
def test_a_record_that_is_none_is_one_line(folder, text):
    path = folder(RECORD)
    (path / "run.json").write_text(text)
    refused("run.json('|.*must be the record of a run)", load, path)


@pytest.mark.parametrize("shard", ["1", "a/b", "1/999999999999", [1, 2], {"a": 1}])
def test_a_part_of_no_number_is_refused(folder, shard):
    refused("must hold a part of a sweep", merge, [folder({**RECORD, "asked": {"command": "sweep", "shard": shard}})])
