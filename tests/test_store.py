"""Result files: round trips and atomicity."""

import dataclasses
import datetime
import enum
import json
import math
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ref.refusals import refused

from jexplore.config import InputError
from jexplore.report import store


def episodes():
    return pd.DataFrame(
        {
            "world": ["office#1", "höhle/$x|y.png@16x16"],
            "episode": np.array([0, 1], dtype=np.int64),
            "path_m": [0.1 + 0.2, math.nan],
            "room_entries": pd.array([3, pd.NA], dtype="Int64"),
        },
        index=[5, 9],
    )


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def test_parquet_round_trip_is_exact(tmp_path):
    store.write_parquet(episodes(), tmp_path / "episodes.parquet")
    back = store.read_parquet(tmp_path / "episodes.parquet", required=("world", "path_m"))
    pd.testing.assert_frame_equal(back, episodes().reset_index(drop=True), check_exact=True)
    assert back["room_entries"].dtype == "Int64"
    assert files(tmp_path) == ["episodes.parquet"]


def test_json_whole(tmp_path):
    class Outcome(enum.IntEnum):
        COMPLETE = 0

    @dataclasses.dataclass
    class Point:
        x: float
        y: float

    at = datetime.datetime(2026, 11, 21, 9, 30, tzinfo=datetime.UTC)
    pairs = [
        (np.int32(3), 3),
        (np.float32(0.5), 0.5),
        ([math.nan, np.float64("nan"), math.inf, pd.NA, None], [None] * 5),
        (np.array([[1.0, np.nan], [2.0, 3.0]]), [[1.0, None], [2.0, 3.0]]),
        (np.bool_(True), True),
        (at, "2026-11-21T09:30:00+00:00"),
        (Point(1.0, math.nan), {"x": 1.0, "y": None}),
        (Outcome.COMPLETE, "COMPLETE"),
        (Path("runs") / "a", os.path.join("runs", "a")),
        ({7: (1, "ü")}, {"7": [1, "ü"]}),
    ]
    store.write_json([value for value, _ in pairs], tmp_path / "run.json")
    text = (tmp_path / "run.json").read_text(encoding="utf-8")
    assert json.loads(text) == [expected for _, expected in pairs]
    assert text.endswith("]\n")
    assert "ü" in text
    assert "NaN" not in text


def test_a_failure_in_the_middle_leaves_the_old_file(tmp_path):
    path = tmp_path / "run.json"
    path.write_text("old")

    def write_half():
        with store.atomic(path) as part:
            part.write_text("ne")
            raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        write_half()
    assert path.read_text() == "old"
    assert files(tmp_path) == ["run.json"]


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, monkeypatch):
    def full(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store.os, "fsync", full)
    with pytest.raises(InputError, match=r"run\.json must be a file that can be written: No space left on device$"):
        store.write_json({}, tmp_path / "run.json")
    assert files(tmp_path) == []


@pytest.mark.parametrize(
    "write", [lambda path: store.write_json({}, path), lambda path: store.write_parquet(episodes(), path)]
)
def test_unwritable_places(tmp_path, write):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "missing" / "x", tmp_path / "file" / "x", tmp_path / "folder"):
        assert str(path) in refused(None, write, path)
    assert files(tmp_path) == ["file", "folder"]


def test_unreadable_parquet(tmp_path):
    (tmp_path / "text.parquet").write_text("world,path_m\n")
    (tmp_path / "empty.parquet").touch()
    for name in ("text.parquet", "empty.parquet", "missing.parquet"):
        refused(name, store.read_parquet, tmp_path / name)
    store.write_parquet(episodes(), tmp_path / "e.parquet")
    with pytest.raises(InputError, match=r"must have the column plans, got world, episode, path_m, room_entries$"):
        store.read_parquet(tmp_path / "e.parquet", required=("world", "plans"))


def test_environment_is_json_and_names_what_matters(tmp_path):
    found = store.environment()
    store.write_json(found, tmp_path / "run.json")
    assert json.loads((tmp_path / "run.json").read_text()) == found
    assert found["numpy"] == np.__version__
    assert found["pandas"] == pd.__version__
    assert found["cpu_count"] >= 1
    assert found["device_count"] >= 1
    assert None not in (found["jexplore"], found["python"], found["jax"], found["jaxlib"], found["device"])
