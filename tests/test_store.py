"""Result files: round trips, atomicity, and folders that are refused."""

import dataclasses
import datetime
import enum
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jexplore.config import InputError
from jexplore.report import folders, ledger, store


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


def test_parquet_of_only_missing_rooms(tmp_path):
    table = episodes().assign(room_entries=pd.array([pd.NA, pd.NA], dtype="Int64"))
    store.write_parquet(table, tmp_path / "e.parquet")
    assert store.read_parquet(tmp_path / "e.parquet")["room_entries"].dtype == "Int64"


def test_json_whole(tmp_path):
    class Outcome(enum.IntEnum):
        COMPLETE = 0

    @dataclasses.dataclass
    class Point:
        x: float
        y: float

    value = {
        "n": np.int32(3),
        "x": np.float32(0.5),
        "missing": [math.nan, np.float64("nan"), math.inf, pd.NA, None],
        "array": np.array([[1.0, np.nan], [2.0, 3.0]]),
        "flag": np.bool_(True),
        "at": datetime.datetime(2026, 11, 21, 9, 30, tzinfo=datetime.UTC),
        "point": Point(1.0, math.nan),
        "outcome": Outcome.COMPLETE,
        "out": Path("runs") / "a",
        7: (1, "ü"),
    }
    store.write_json(value, tmp_path / "run.json")
    text = (tmp_path / "run.json").read_text(encoding="utf-8")
    assert json.loads(text) == {
        "n": 3,
        "x": 0.5,
        "missing": [None] * 5,
        "array": [[1.0, None], [2.0, 3.0]],
        "flag": True,
        "at": "2026-11-21T09:30:00+00:00",
        "point": {"x": 1.0, "y": None},
        "outcome": "COMPLETE",
        "out": os.path.join("runs", "a"),
        "7": [1, "ü"],
    }
    assert text.endswith("}\n")
    assert "ü" in text
    assert "NaN" not in text


def test_json_that_cannot_be_written_leaves_the_old_file(tmp_path):
    path = tmp_path / "run.json"
    store.write_json({"old": 1}, path)
    with pytest.raises(TypeError, match="got object"):
        store.write_json({"new": object()}, path)
    assert json.loads(path.read_text()) == {"old": 1}
    assert files(tmp_path) == ["run.json"]


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


def test_the_data_are_synced_before_the_replacement(tmp_path, monkeypatch):
    calls = []
    for name in ("fsync", "replace"):
        real = getattr(os, name)
        monkeypatch.setattr(store.os, name, lambda *args, name=name, real=real: (calls.append(name), real(*args)))
    store.write_json({}, tmp_path / "run.json")
    assert calls[:2] == ["fsync", "replace"]


def test_written_files_have_the_usual_permissions(tmp_path):
    (tmp_path / "usual").touch()
    store.write_json({}, tmp_path / "run.json")
    assert (tmp_path / "run.json").stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.parametrize(
    "write", [lambda path: store.write_json({}, path), lambda path: store.write_parquet(episodes(), path)]
)
def test_unwritable_places(tmp_path, write):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "missing" / "x", tmp_path / "file" / "x", tmp_path / "folder"):
        with pytest.raises(InputError) as caught:
            write(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
    assert files(tmp_path) == ["file", "folder"]


def test_unreadable_parquet(tmp_path):
    (tmp_path / "text.parquet").write_text("world,path_m\n")
    (tmp_path / "empty.parquet").touch()
    for name in ("text.parquet", "empty.parquet", "missing.parquet"):
        with pytest.raises(InputError, match=name) as caught:
            store.read_parquet(tmp_path / name)
        assert "\n" not in str(caught.value)
    store.write_parquet(episodes(), tmp_path / "e.parquet")
    with pytest.raises(InputError, match=r"must have the column plans, got world, episode, path_m, room_entries$"):
        store.read_parquet(tmp_path / "e.parquet", required=("world", "plans"))


ONE = {"run.json": lambda path: path.write_text("new")}


def write_run(path, writers, overwrite=False):
    with folders.claimed(path, overwrite=overwrite) as run:
        return run.write(writers)


def write_new_run(paths, writers):
    with folders.claimed_new(paths) as run:
        return run.write(writers)


def check_out(path, overwrite=False):
    with folders.claimed(path, overwrite=overwrite):
        pass


@pytest.mark.parametrize("name", ["run.json", "episodes.parquet", "compare.png"])
def test_a_folder_with_a_run_is_refused(tmp_path, name):
    (tmp_path / name).write_text("old")
    for take in (check_out, lambda path: write_run(path, ONE)):
        with pytest.raises(InputError, match=rf"holds a run \({name}\)"):
            take(tmp_path)
    assert (tmp_path / name).read_text() == "old"
    assert files(tmp_path) == [name]


def test_overwrite_removes_only_our_files(tmp_path):
    for name in ("run.json", "compare.png", "notes.txt", "photo.png"):
        (tmp_path / name).write_text(name)
    (tmp_path / "paths.png").symlink_to(tmp_path / "photo.png")
    assert write_run(tmp_path, ONE, overwrite=True) == tmp_path
    assert files(tmp_path) == ["notes.txt", "photo.png", "run.json"]
    assert (tmp_path / "photo.png").read_text() == "photo.png"
    assert (tmp_path / "run.json").read_text() == "new"


def test_overwrite_does_not_remove_folders(tmp_path):
    (tmp_path / "run.json").write_text("old")
    (tmp_path / "worlds.png").mkdir()
    with pytest.raises(InputError, match=r"worlds\.png must be a file"):
        write_run(tmp_path, ONE, overwrite=True)
    assert files(tmp_path) == ["run.json", "worlds.png"]


def test_what_is_no_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("keep")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    bad = [tmp_path / "file", tmp_path / "file" / "below", tmp_path / "dangling", "", f"{tmp_path}/nul\0l"]
    for path in bad:
        for overwrite in (False, True):
            for take in (check_out, lambda path, overwrite: write_run(path, ONE, overwrite)):
                with pytest.raises(InputError) as caught:
                    take(path, overwrite)
                assert "\n" not in str(caught.value)
    assert files(tmp_path) == ["dangling", "file"]


def test_nothing_is_left_half_made(tmp_path):
    for take in (check_out, lambda path: write_run(path, ONE)):
        with pytest.raises(InputError, match="must be a folder that can be written: File name too long"):
            take(tmp_path / "a" / "b" / ("x" * 300))
    assert files(tmp_path) == []


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / "run.json").write_text("old")

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(folders.os, "open", refuse)
    with pytest.raises(InputError, match="must be a folder that can be written: Permission denied"):
        write_run(tmp_path, ONE, overwrite=True)
    with pytest.raises(InputError, match="Permission denied"):
        write_run(tmp_path / "new" / "run", ONE)
    assert files(tmp_path) == ["run.json"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder(tmp_path):
    folder = tmp_path / "fixed"
    folder.mkdir(mode=0o555)
    for path in (folder, folder / "run"):
        with pytest.raises(InputError, match="Permission denied"):
            check_out(path)


def test_default_outs_are_unused(tmp_path):
    now = datetime.datetime(2026, 11, 21, 9, 30, 42)
    assert next(folders.default_outs("compare", now)) == Path("runs/20261121T093042Z-compare")
    names = [write_new_run(folders.default_outs("compare", now, root=tmp_path), ONE).name for _ in range(3)]
    assert names == ["20261121T093042Z-compare", "20261121T093042Z-compare-2", "20261121T093042Z-compare-3"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert all((tmp_path / name / "run.json").read_text() == "new" for name in names)


def test_a_name_that_another_run_takes_meanwhile_is_left_to_it(tmp_path):
    now = datetime.datetime(2026, 11, 21, 9, 30, 42)

    def names():
        for path in folders.default_outs("compare", now, root=tmp_path):
            if path.name.endswith("compare"):
                write_run(path, {"run.json": lambda path: path.write_text("theirs")})
            yield path

    made = write_new_run(names(), {"run.json": lambda path: path.write_text("mine")})
    assert made.name == "20261121T093042Z-compare-2"
    taken = tmp_path / "20261121T093042Z-compare"
    assert [(folder / "run.json").read_text() for folder in (taken, made)] == ["theirs", "mine"]


def test_processes_that_write_at_once_lose_no_run(tmp_path):
    code = """
import datetime, sys
from jexplore.report import folders
now = datetime.datetime(2026, 1, 1)
for i in range(8):
    text = f"{sys.argv[1]} {i}"
    writers = {"run.json": lambda path: path.write_text(text)}
    with folders.claimed_new(folders.default_outs("x", now, root=sys.argv[2])) as run:
        run.write(writers)
"""
    many = [subprocess.Popen([sys.executable, "-c", code, str(k), str(tmp_path)]) for k in range(3)]
    assert [process.wait(timeout=120) for process in many] == [0, 0, 0]
    texts = sorted(path.read_text() for path in tmp_path.glob("*/run.json"))
    assert texts == sorted(f"{k} {i}" for k in range(3) for i in range(8))
    assert len(list(tmp_path.iterdir())) == 24


def test_default_out_is_in_utc():
    zone = datetime.timezone(datetime.timedelta(hours=2))
    early = datetime.datetime(2026, 1, 1, 1, 0, 0, tzinfo=zone)
    assert next(folders.default_outs("x", early)).name == "20251231T230000Z-x"
    before = datetime.datetime.now(datetime.UTC).replace(microsecond=0, tzinfo=None)
    stamp = datetime.datetime.strptime(next(folders.default_outs("x")).name, "%Y%m%dT%H%M%SZ-x")
    assert 0 <= (stamp - before).total_seconds() < 60


def test_environment_is_json_and_names_what_matters(tmp_path):
    found = store.environment()
    store.write_json(found, tmp_path / "run.json")
    assert json.loads((tmp_path / "run.json").read_text()) == found
    assert found["numpy"] == np.__version__
    assert found["pandas"] == pd.__version__
    assert found["cpu_count"] >= 1
    assert found["device_count"] >= 1
    assert None not in (found["jexplore"], found["python"], found["jax"], found["jaxlib"], found["device"])


def test_a_missing_package_is_none():
    assert store._version("no-such-package-anywhere") is None


def test_check_leaves_everything_as_it_is(tmp_path):
    check_out(tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(InputError, match="holds a run"):
        check_out(tmp_path)
    check_out(tmp_path, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_a_run_is_written_whole(tmp_path):
    out = tmp_path / "a" / "b"
    writers = {"run.json": lambda path: path.write_text("new"), "paths.png": lambda path: path.write_text("new")}
    assert write_run(out, writers) == out
    (out / "compare.png").write_text("old")
    (out / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds a run"):
        write_run(out, writers)
    write_run(str(out), {"run.json": lambda path: path.write_text("newer")}, overwrite=True)
    assert {path.name: path.read_text() for path in out.iterdir()} == {"run.json": "newer", "notes.txt": "mine"}


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, InputError])
def test_a_run_that_fails_in_the_middle_leaves_everything_as_it_was(tmp_path, error):
    def fails(path):
        path.write_text("half")
        raise error

    writers = {"run.json": lambda path: path.write_text("new"), "paths.png": fails}
    with pytest.raises(error):
        write_run(tmp_path / "new" / "run", writers)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "run.json").write_text("old")
    with pytest.raises(error):
        write_run(tmp_path, writers, overwrite=True)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"run.json": "old"}


@pytest.mark.parametrize("moves", range(1, 7))
def test_an_interruption_while_files_are_moved_undoes_all_of_it(tmp_path, monkeypatch, moves):
    """Three files go, three come; whichever move is the last, the old run is whole and nothing new is left."""
    for name in ("run.json", "episodes.parquet", "paths.png"):
        (tmp_path / name).write_text("old")
    real, made = os.replace, []

    def replace(source, target):
        real(source, target)
        made.append(Path(target).name)
        if len(made) == moves:
            raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", replace)
    names = ("run.json", "compare.png", "episodes.parquet")
    writers = dict.fromkeys(names, lambda path: path.write_text("new"))
    with pytest.raises(KeyboardInterrupt):
        write_run(tmp_path, writers, overwrite=True)
    found = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert found == {"run.json": "old", "episodes.parquet": "old", "paths.png": "old"}
    assert made[0] == "run.json"  # it goes first and comes last
    assert "run.json" not in made[1 : min(moves, 5)]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(5, "Input/output error")])
def test_an_old_run_that_cannot_be_moved_back_is_not_lost(tmp_path, monkeypatch, error):
    """From the fifth move on nothing can be moved any more: the rest of the old run is where the message says."""
    for name in ("run.json", "episodes.parquet", "paths.png"):
        (tmp_path / name).write_text("old")
    real, made = os.replace, []

    def replace(source, target):
        made.append(target)
        if len(made) == 5:
            raise error
        if len(made) > 5:
            raise OSError(5, "Input/output error")
        real(source, target)

    monkeypatch.setattr(os, "replace", replace)
    names = ("run.json", "compare.png", "episodes.parquet")
    writers = dict.fromkeys(names, lambda path: path.write_text("new"))
    with pytest.raises(InputError, match=r"could not be replaced; its files are in .*old$") as caught:
        write_run(tmp_path, writers, overwrite=True)
    kept = Path(str(caught.value).rpartition(" ")[2])
    assert {path.name: path.read_text() for path in kept.iterdir()} == dict.fromkeys(
        ("run.json", "episodes.parquet", "paths.png"), "old"
    )


def test_a_second_interruption_does_not_stop_the_way_back(tmp_path, monkeypatch):
    for name in ("run.json", "episodes.parquet"):
        (tmp_path / name).write_text("old")
    real, made = os.replace, []

    def replace(source, target):
        made.append(target)
        if len(made) >= 3 and len(made) % 2:
            raise KeyboardInterrupt
        real(source, target)

    monkeypatch.setattr(os, "replace", replace)
    writers = dict.fromkeys(("run.json", "compare.png"), lambda path: path.write_text("new"))
    with pytest.raises(KeyboardInterrupt):
        write_run(tmp_path, writers, overwrite=True)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "run.json": "old",
        "episodes.parquet": "old",
    }


def test_two_that_write_into_one_folder_leave_one_whole_run(tmp_path):
    """Each overwrites what the other has written, again and again, and is refused while the other does; in the end
    everything is of one of them.
    """
    code = """
import sys
from jexplore.config import InputError
from jexplore.report import folders
done = 0
while done < 15:
    names = "run.json", "episodes.parquet"
    writers = {name: (lambda path: path.write_text(f"{sys.argv[1]} {done}")) for name in names}
    try:
        with folders.claimed(sys.argv[2], overwrite=True) as run:
            run.write(writers)
        done += 1
    except InputError as error:
        assert "is being written by" in str(error), error
"""
    many = [subprocess.Popen([sys.executable, "-c", code, str(k), str(tmp_path)]) for k in range(2)]
    assert [process.wait(timeout=120) for process in many] == [0, 0]
    assert files(tmp_path) == ["episodes.parquet", "run.json"]
    assert (tmp_path / "run.json").read_text() == (tmp_path / "episodes.parquet").read_text()


def test_a_run_on_a_full_disk_is_one_line(tmp_path):
    def fails(path):
        raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match="No space left on device"):
        write_run(tmp_path / "new", {"run.json": fails})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="file names are any bytes")
def test_a_folder_whose_name_is_no_text_holds_a_run(tmp_path):
    table = pd.DataFrame({"episode": [1, 2]})
    with folders.claimed(tmp_path / os.fsdecode(b"caf\xe9")) as run:
        kept = ledger.Ledger(run, {"of": os.fspath(run.path)}, 2)
        kept.put(1, table)
        kept.put_part(0, table[:1])
        again = ledger.Ledger(run, {"of": os.fspath(run.path)}, 2, resume=True)
        assert (again.done, again.parts) == ({1}, {0})
        pd.testing.assert_frame_equal(again.get(1), table)
        assert len(again.get(0)) == 1
        run.write({"episodes.parquet": lambda path: store.write_parquet(table, path)})
    pd.testing.assert_frame_equal(store.read_parquet(run.path / "episodes.parquet"), table)
