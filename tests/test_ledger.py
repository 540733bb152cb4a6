"""Folders that are claimed, and units that survive whatever ends a run."""

import datetime
import json
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pandas as pd
import pyarrow.parquet
import pytest
from ref.refusals import refused

from jexplore.config import InputError, InputWarning
from jexplore.report import folders, ledger
from jexplore.report.folders import LOCK, UNFINISHED, claimed
from jexplore.report.ledger import open_ledger
from jexplore.rules import Lidar

ASKED = {"command": "compare", "worlds": ["cave"], "episodes": 3, "lidar": [Lidar()]}


def texts(*names, text="new"):
    return dict.fromkeys(names, lambda path: path.write_text(text))


def write(path, *names, text="new", **options):
    with claimed(path, **options) as run:
        return run.write(texts(*names, text=text))


def names(folder):
    return sorted(path.name for path in Path(folder).iterdir())


def content(folder):
    return {path.name: path.read_text() for path in Path(folder).iterdir()}


def python(code, *arguments):
    return subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], stdout=subprocess.PIPE, text=True)


HOLD = """
import sys, time
from jexplore.report import folders
with folders.claimed(sys.argv[1]) as run:
    print("mine", flush=True)
    time.sleep(900)
"""


def test_a_folder_is_its_holders_until_that_is_killed(tmp_path):
    process = python(HOLD, tmp_path / "run")
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "mine\n"
        for _ in range(2):  # being refused changes nothing
            refused(f"is being written by process {process.pid} on ", write, tmp_path / "run", overwrite=True)
    finally:
        process.kill()
        process.communicate()
    assert names(tmp_path / "run") == [LOCK]  # left behind, and no lock any more
    write(tmp_path / "run", "run.json")
    assert names(tmp_path / "run") == ["run.json"]


def test_a_lock_that_cannot_be_had_is_left_out(tmp_path, monkeypatch):
    """On a file system without locks a run goes on without."""
    fcntl = pytest.importorskip("fcntl")

    def refuse(handle, how):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refuse)
    write(tmp_path, "run.json")
    assert names(tmp_path) == ["run.json"]


def test_a_claim_that_keeps_nothing_leaves_nothing(tmp_path):
    with claimed(tmp_path / "a" / "b"):
        assert names(tmp_path / "a" / "b") == [LOCK]
    assert names(tmp_path) == []
    with pytest.raises(ZeroDivisionError), claimed(tmp_path / "a" / "b"):
        raise ZeroDivisionError
    assert names(tmp_path) == []


def test_only_files_of_a_run_are_replaced_and_only_when_allowed(tmp_path):
    out = tmp_path / "a" / "b"
    assert write(out, "run.json", "compare.svg") == out
    (out / "notes.txt").write_text("mine")
    (out / "photo.png").write_text("mine")
    (out / "episode.gif").symlink_to(out / "photo.png")
    before = content(out)
    for name in ("run.json", "compare.svg"):
        refused(rf"holds a run \({name}\): choose another folder or allow overwriting", write, out, "run.json")
        assert content(out) == before
        (out / name).unlink()
        del before[name]
    write(str(out), "run.json", text="newer", overwrite=True)
    assert content(out) == {"run.json": "newer", "notes.txt": "mine", "photo.png": "mine"}
    (out / "worlds.png").mkdir()
    refused(r"worlds\.png must be a file", write, out, "run.json", overwrite=True)


def test_what_is_no_folder_is_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("keep")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    bad = ["file", "file/below", "dangling", "nul\0l", f"a/b/{'x' * 300}"]
    for path in [*(f"{tmp_path}/{name}" for name in bad), ""]:
        for overwrite in (False, True):
            refused(r"^[^\n]*$", write, path, "run.json", overwrite=overwrite)
    assert names(tmp_path) == ["dangling", "file"]

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(folders.os, "open", refuse)
    for path in (tmp_path, tmp_path / "new" / "run"):
        refused("must be a folder that can be written: Permission denied", write, path, "run.json")
    assert names(tmp_path) == ["dangling", "file"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, InputError, OSError(28, "No space left on device")])
def test_a_file_that_fails_leaves_everything_as_it_was(tmp_path, error):
    def fails(path):
        path.write_text("half")
        raise error

    expected = pytest.raises(InputError, match="No space") if isinstance(error, OSError) else pytest.raises(error)
    writers = {**texts("run.json"), "episode.gif": fails}
    with expected, claimed(tmp_path / "new" / "run") as run:
        run.write(writers)
    assert names(tmp_path) == []
    write(tmp_path, "run.json", text="old")
    with expected, claimed(tmp_path, overwrite=True) as run:
        run.write(writers)
    with expected, claimed(tmp_path, overwrite=True) as run:
        run.add("episode.gif", fails)
    assert content(tmp_path) == {"run.json": "old"}
    with claimed(tmp_path, overwrite=True) as run:
        run.add("episode.gif", lambda path: path.write_text("picture"))
    assert content(tmp_path) == {"run.json": "old", "episode.gif": "picture"}


KILLED = """
import os, sys
from pathlib import Path
from jexplore.report import folders

def begin(folder, last):
    steps = 0
    def counted(act):
        def step(*arguments, **options):
            nonlocal steps
            steps += 1
            if steps == last:
                os.kill(os.getpid(), int(sys.argv[2]))
            return act(*arguments, **options)
        return step
    with folders.claimed(folder, overwrite=True) as run:
        folders.os.replace = counted(os.replace)
        Path.unlink, Path.rmdir = counted(Path.unlink), counted(Path.rmdir)
        run.write(dict.fromkeys(("run.json", "compare.svg", "episodes.parquet"), lambda path: path.write_text("new")))

for folder in sorted(Path(sys.argv[1]).iterdir()):
    pid = os.fork()
    if not pid:
        try:
            begin(folder, int(folder.name))
        except KeyboardInterrupt:
            os._exit(1)
        os._exit(0)
    print(int(folder.name), int(os.waitpid(pid, 0)[1] != 0))
"""


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("how", ["SIGKILL", "SIGINT"])
def test_one_whole_run_is_there_whenever_the_writer_is_ended(tmp_path, how):
    """Nine steps: the new run counts, three old files go, it is moved, three files come, their folder goes."""
    for step in range(1, 12):
        write(tmp_path / f"{step:02d}", "run.json", "episodes.parquet", "episode.gif", text="old")
    said, _ = python(KILLED, tmp_path, int(getattr(signal, how))).communicate(timeout=300)
    ended = {int(step): int(failed) for step, failed in map(str.split, said.splitlines())}
    assert ended == {step: int(step <= 10) for step in range(1, 12)}  # the tenth is of what follows
    for step in ended:
        folder = tmp_path / f"{step:02d}"
        if how == "SIGKILL":  # no mixture is taken for a run: readers look for run.json
            assert (folder / "run.json").exists() == (step <= 2 or step >= 9)
            with claimed(folder, overwrite=True):
                pass
        assert content(folder) == (
            dict.fromkeys(("run.json", "episodes.parquet", "episode.gif"), "old")
            if step == 1
            else dict.fromkeys(("run.json", "episodes.parquet", "compare.svg"), "new")
        ), step


OVERWRITES = """
import sys
from jexplore.config import InputError
from jexplore.report import folders
done = 0
while done < 15:
    writers = dict.fromkeys(("run.json", "episodes.parquet"), lambda path: path.write_text(f"{sys.argv[2]} {done}"))
    try:
        with folders.claimed(sys.argv[1], overwrite=True) as run:
            run.write(writers)
        done += 1
    except InputError as error:
        assert "is being written by" in str(error), error
"""
TAKES_NEW_NAMES = """
import datetime, os, sys
from jexplore.report import folders
os.chdir(sys.argv[1])
for i in range(8):
    writers = {"run.json": lambda path: path.write_text(f"{sys.argv[2]} {i}")}
    with folders.claimed_new("x", datetime.datetime(2026, 1, 1)) as run:
        run.write(writers)
"""


@pytest.mark.slow
def test_processes_that_write_at_once_lose_no_run(tmp_path):
    """Two overwrite what the other has written, and are refused while the other does; three take new names."""
    one, many = tmp_path / "one", tmp_path / "runs"
    all_of_them = [python(OVERWRITES, one, k) for k in range(2)] + [
        python(TAKES_NEW_NAMES, tmp_path, k) for k in range(3)
    ]
    for process in all_of_them:
        process.communicate(timeout=300)
        assert process.returncode == 0
    assert len(set(content(one).values())) == 1
    assert names(one) == ["episodes.parquet", "run.json"]
    runs = sorted((folder / "run.json").read_text() for folder in many.iterdir())
    assert runs == sorted(f"{k} {i}" for k in range(3) for i in range(8))


def test_new_folders_are_unused_and_named_in_utc(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    early = datetime.datetime(2026, 1, 1, 1, 0, 0, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))
    for _ in range(3):
        with folders.claimed_new("x", early) as run:
            run.write(texts("run.json"))
    first = "20251231T230000Z-x"
    assert names(tmp_path / "runs") == [first, f"{first}-2", f"{first}-3"]


def table(*values):
    return pd.DataFrame({"value": list(values), "bytes": [b"x"] * len(values)})


def begin(path, units=4, asked=ASKED, resume=True, **options):
    """Open a ledger, and let go of the folder: unit -> its values."""
    with claimed(path, resume=resume, **options) as run:
        book = open_ledger(run, asked, units, resume=resume)
        assert book is not None
        return {unit: book.done[unit]["value"].tolist() for unit in sorted(book.done)}


def leave(path, *units, asked=ASKED):
    """A run that was ended when it had finished some units."""
    with claimed(path) as run:
        book = open_ledger(run, asked, 4)
        assert book is not None
        for unit in units:
            book.put(unit, table(unit, unit + 0.5))


def test_what_is_finished_is_there_again(tmp_path):
    leave(tmp_path, 2, 0)
    assert names(tmp_path) == [UNFINISHED]
    assert names(tmp_path / UNFINISHED) == ["000000.parquet", "000002.parquet", "asked.json"]
    assert begin(tmp_path) == {0: [0, 0.5], 2: [2, 2.5]}
    refused(r"holds a run that was not finished: .*--resume.*--overwrite", begin, tmp_path, resume=False)
    assert begin(tmp_path, resume=False, overwrite=True) == {}  # thrown away when the new one begins
    assert names(tmp_path) == []  # what ends before any unit leaves nothing
    assert begin(tmp_path / "new") == {}


def test_units_without_their_page_are_nobodys(tmp_path):
    """As a process leaves them that is killed while it throws them away."""
    leave(tmp_path, 0, 1)
    (tmp_path / UNFINISHED / "asked.json").unlink()
    assert begin(tmp_path) == {}


@pytest.mark.parametrize(
    ("change", "units", "message"),
    [
        ({"episodes": 5}, 4, r"its episodes is 3, not 5"),
        ({"lidar": [Lidar(range_m=4)]}, 4, r"its lidar is "),
        ({"command": "reproduce"}, 4, r'its command is "compare", not "reproduce"'),
        ({"seed": 1}, 4, r"its seed is null, not 1"),
        ({}, 5, r"its units is 4, not 5"),
        ({"own": {"strategy 'mine'": "b"}}, 4, r"its strategy 'mine' computes something else now"),
    ],
)
def test_another_run_is_not_gone_on_with(tmp_path, change, units, message):
    asked = {**ASKED, "own": {"strategy 'mine'": "a"}}
    leave(tmp_path, 0, asked=asked)
    refused(f"holds another run: {message}", begin, tmp_path, units=units, asked={**asked, **change})
    assert begin(tmp_path, asked=asked) == {0: [0, 0.5]}


def finish(path, asked, rows=()):
    page = {"asked": ledger.jsonable(asked), "units": 4}
    files = {"episodes.parquet": lambda path: table(*rows).to_parquet(path)}
    with claimed(path) as run:
        run.write({**files, "run.json": lambda path: path.write_text(json.dumps(page))})


def reopened(path, asked, **how):
    with claimed(path, resume=True) as run:
        return open_ledger(run, asked, 4, resume=True, **how)


def test_a_finished_run_is_known(tmp_path):
    asked = {**ASKED, "own": {"strategy 'mine'": "a"}}
    finish(tmp_path, asked)
    assert reopened(tmp_path, asked) is None
    other = {**asked, "own": {"strategy 'mine'": "b"}}
    refused("its strategy 'mine' computes something else now", reopened, tmp_path, other)
    assert reopened(tmp_path, other, trust=True) is None
    for page, message in (
        *((json.dumps(page), "does not say what") for page in ([1], {"asked": [1]})),
        ("{", r"is not valid JSON .*: it must say what the run is asked; use --overwrite"),
    ):
        (tmp_path / "run.json").write_text(page)
        refused(message, reopened, tmp_path, ASKED)
    (tmp_path / "run.json").unlink()
    refused(r"holds a run \(episodes.parquet\)", reopened, tmp_path, ASKED)


@pytest.mark.parametrize("damage", [0, 3, 100, -1, *((at, at + 8) for at in (4, 30, 55))])
def test_a_unit_that_is_damaged_is_made_again(tmp_path, damage):
    """Cut short, or changed within: nothing is told as kept that cannot be read."""
    leave(tmp_path, 0, 1)
    file = tmp_path / UNFINISHED / "000001.parquet"
    data = bytearray(file.read_bytes())
    if isinstance(damage, tuple):
        data[slice(*damage)] = bytes(byte ^ 4 for byte in data[slice(*damage)])
    else:
        data = data[:damage]
    file.write_bytes(data)
    (tmp_path / UNFINISHED / ".000002.parquet.1-ab.part").write_bytes(b"half")  # its writer was killed
    with pytest.warns(InputWarning, match=r"^000001.parquet was damaged, and its unit is made again$"):
        assert begin(tmp_path) == {0: [0, 0.5]}
    assert names(tmp_path / UNFINISHED) == ["000000.parquet", "asked.json"]


def longer(path, episodes, **change):
    """The ledger of a run of 2 episodes a unit that continues runs of fewer."""
    with claimed(path, resume=True) as run, warnings.catch_warnings(action="error"):
        asked = {**ASKED, **change, "episodes": episodes}
        book = open_ledger(run, asked, lambda n: (episodes - n) // 2, resume=True)
        if book is None or book.done:
            return book
        book.put(0, table(1))
        return book


def test_a_finished_run_goes_on_with_more_episodes(tmp_path):
    finish(tmp_path, {**ASKED, "episodes": 4}, range(4))
    assert longer(tmp_path, 4) is None
    for _ in range(2):  # begun, and gone on with after whatever has ended it
        book = longer(tmp_path, 10)
        assert book is not None
        assert (book.after, book.units, set(book.done)) == (4, 3, {0})
        assert "run.json" in names(tmp_path)  # the shorter one stays until the longer one is there
    for episodes, change, says in (
        (12, {}, "holds a run of 10 episodes that was not finished: finish these, then ask for more"),
        (8, {}, "holds a run of 10 episodes, more than 8: ask for 10 or more"),
        (10, {"seed": 1}, "its seed is null, not 1"),
    ):
        refused(says, longer, tmp_path, episodes, **change)
    with claimed(tmp_path, resume=True) as run:
        run.forget()
    refused("its seed is null, not 1", longer, tmp_path, 12, seed=1)


def test_a_full_disk_leaves_what_was_finished(tmp_path, monkeypatch):
    leave(tmp_path, 0)

    def full(table, file, **options):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    with claimed(tmp_path, resume=True) as run, monkeypatch.context() as patch:
        book = open_ledger(run, ASKED, 4, resume=True)
        assert book is not None
        patch.setattr(pyarrow.parquet, "write_table", full)
        refused("No space left on device", book.put, 1, table(1))
        assert set(book.done) == {0}
    assert begin(tmp_path) == {0: [0, 0.5]}


def test_a_full_disk_leaves_no_lock(tmp_path, monkeypatch):
    def full(handle, text):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with (
            pytest.raises(InputError, match="must be a folder that can be written: No space left"),
            claimed(tmp_path / "run"),
        ):
            pass
    assert names(tmp_path) == []


def test_a_finished_run_leaves_no_units(tmp_path):
    leave(tmp_path, 0)
    with claimed(tmp_path, resume=True) as run:
        run.write(texts("run.json"), is_finished=False)
        assert names(tmp_path) == [LOCK, UNFINISHED, "run.json"]
        run.write(texts("run.json"))
    assert names(tmp_path) == ["run.json"]


@pytest.mark.skipif(sys.platform != "linux", reason="file names are any bytes")
def test_a_folder_whose_name_is_no_text_holds_a_run(tmp_path):
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    leave(folder, 1, asked={**ASKED, "of": os.fspath(folder)})
    assert begin(folder, asked={**ASKED, "of": os.fspath(folder)}) == {1: [1, 1.5]}
