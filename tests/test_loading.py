"""Folders of runs that lack something, or hold what this version does not know: told in one line."""

import json

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.config import __version__
from jexplore.report import store
from jexplore.studies.results.columns import COLUMNS
from jexplore.studies.results.loading import load, merge

RECORD = {
    "command": ["jexplore", "compare"],
    "configuration": {"lidar": {"range_m": 4.0}, "rules": {}},
    "environment": {"jexplore": __version__},
    **{"compile_s": 1.0, "run_s": 1.0, "interrupted": False, "resumed": 0},
}
WORLD = {"occupied": np.ones((3, 3), bool), "cell_m": 0.1, "origin_m": np.zeros(2), "name": np.str_("w")}
DETAILS = {f"world/0/{name}": value for name, value in WORLD.items()}


@pytest.fixture
def folder(tmp_path):
    """Of a comparison without an episode, whose record is changed and written by `write`."""
    store.write_parquet(pd.DataFrame({name: [] for name in COLUMNS}), tmp_path / "episodes.parquet")
    np.savez(tmp_path / "details.npz", **DETAILS)

    def write(record):
        (tmp_path / "run.json").write_text(json.dumps(record))
        return tmp_path

    return write


def test_a_whole_folder_is_read(folder):
    found = load(folder(RECORD))
    assert (found.lidar, [world.name for world in found.worlds]) == (jx.Lidar(range_m=4.0), ["w"])


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


@pytest.mark.parametrize("missing", ["world/0/cell_m", "world/0/name", "first/0/0/cols"])
def test_incomplete_details_are_refused(folder, missing):
    first = {"strategy": np.str_("s"), "state": np.zeros((3, 3), int), "rows": [1], "cols": [1], "path_m": 0.0}
    whole = DETAILS | {f"first/0/0/{name}": value for name, value in first.items()}
    path = folder(RECORD)
    np.savez(path / "details.npz", **{name: value for name, value in whole.items() if name != missing})
    refused(f"must hold a whole run of this version: there is no '{missing}'", load, path)
    np.savez(path / "details.npz", **whole, progress=np.zeros((2, 100)))
    refused("details.npz must have the progress of 0 episodes", load, path)
    (path / "details.npz").unlink()
    refused("details.npz': there is no such file", load, path)


@pytest.mark.parametrize("text", ["{", "[" * 600 + "]" * 600, "[]", "3", '"a"', ""])
def test_a_record_that_is_none_is_one_line(folder, text):
    path = folder(RECORD)
    (path / "run.json").write_text(text)
    refused("run.json('|.*must be the record of a run)", load, path)


@pytest.mark.parametrize("shard", ["1", "a/b", "1/999999999999", [1, 2], {"a": 1}])
def test_a_part_of_no_number_is_refused(folder, shard):
    refused("must hold a part of a sweep", merge, [folder({**RECORD, "asked": {"command": "sweep", "shard": shard}})])
