"""Folders that are claimed, and units that survive whatever ends a run."""

import json
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pandas as pd
import pytest

from jexplore.config import InputError, Lidar
from jexplore.report import ledger
from jexplore.report.folders import LOCK, OLD, PART, UNFINISHED, claimed

ASKED = {"command": "compare", "worlds": ["cave"], "episodes": 3, "lidar": [Lidar()]}
HOLD = """
import sys, time
from jexplore.report import folders
with folders.claimed(sys.argv[1]) as run:
    print("mine", flush=True)
    time.sleep(60)
"""


def texts(**files):
    return {name.replace("_", "."): (lambda path, text=text: path.write_text(text)) for name, text in files.items()}


def names(folder):
    return sorted(path.name for path in Path(folder).iterdir())


def held(folder):
    """Another process that has the folder."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "mine\n"
    return process


def test_a_folder_is_its_holders_until_that_is_killed(tmp_path):
    process = held(tmp_path / "run")
    try:
        for _ in range(2):  # being refused changes nothing
            with (
                pytest.raises(InputError, match=f"is being written by process {process.pid} on "),
                claimed(tmp_path / "run", overwrite=True),
            ):
                pass
    finally:
        process.kill()
        process.communicate()
    assert names(tmp_path / "run") == [LOCK]  # left behind, and no lock any more
    with claimed(tmp_path / "run") as run:
        run.write(texts(run_json="{}"))
    assert names(tmp_path / "run") == ["run.json"]


def test_a_claim_that_keeps_nothing_leaves_nothing(tmp_path):
    with claimed(tmp_path / "a" / "b"):
        assert names(tmp_path / "a" / "b") == [LOCK]
    assert names(tmp_path) == []
    with pytest.raises(ZeroDivisionError), claimed(tmp_path / "a" / "b"):
        raise ZeroDivisionError
    assert names(tmp_path) == []


def test_a_file_is_added_whole_or_not_at_all(tmp_path):
    def fails(path):
        path.write_text("half")
        raise ValueError("no")

    with claimed(tmp_path) as run:
        run.write(texts(run_json="{}"))
        run.add("compare.png", lambda path: path.write_text("picture"))
        with pytest.raises(ValueError, match="no"):
            run.add("compare.png", fails)
        assert names(tmp_path) == [LOCK, "compare.png", "run.json"]
    assert (tmp_path / "compare.png").read_text() == "picture"


@pytest.mark.parametrize("moved", range(5))
def test_a_holder_that_is_killed_while_files_are_moved_leaves_one_whole_run(tmp_path, moved):
    """The first `moved` moves (old run.json away, old table away, new table in, new run.json in) have been made."""
    stage = tmp_path / f".123-ab{PART}"
    (stage / OLD).mkdir(parents=True)
    for name in ("run.json", "episodes.parquet"):
        (tmp_path / name).write_text("old")
        (stage / name).write_text("new")
    moves = [(tmp_path, stage / OLD, name) for name in ("run.json", "episodes.parquet")]
    moves += [(stage, tmp_path, name) for name in ("episodes.parquet", "run.json")]
    for source, target, name in moves[:moved]:
        os.replace(source / name, target / name)
    with claimed(tmp_path, overwrite=True):
        pass
    assert names(tmp_path) == ["episodes.parquet", "run.json"]
    want = "new" if moved == 4 else "old"
    assert {(tmp_path / name).read_text() for name in names(tmp_path)} == {want}


def table(*values):
    return pd.DataFrame({"value": list(values), "bytes": [b"x"] * len(values)})


def begin(path, units=4, asked=ASKED, **options):
    """Opens a ledger, and lets go of the folder: `(done, left, damaged, tables)`."""
    with claimed(path, **options) as run, warnings.catch_warnings(record=True, action="always") as told:
        book = ledger.Ledger(run, asked, units, resume=options.get("resume", False))
        damaged = [str(one.message).partition(" was damaged, and its unit is made again")[0] for one in told]
        return set(book.done), book.left, damaged, {unit: book.get(unit)["value"].tolist() for unit in book.done}


def leave(path, *units):
    """A run that was ended when it had finished some units."""
    with claimed(path) as run:
        book = ledger.Ledger(run, ASKED, 4)
        for unit in units:
            book.put(unit, table(unit, unit + 0.5))


def test_what_is_finished_is_there_again(tmp_path):
    leave(tmp_path, 2, 0)
    assert names(tmp_path) == [UNFINISHED]
    assert names(tmp_path / UNFINISHED) == ["000000.parquet", "000002.parquet", "asked.json"]
    assert begin(tmp_path, resume=True) == ({0, 2}, [1, 3], [], {0: [0, 0.5], 2: [2, 2.5]})
    with claimed(tmp_path, resume=True) as run:
        ledger.Ledger(run, ASKED, 4, resume=True).put(1, table(7))
    assert begin(tmp_path, resume=True)[3] == {0: [0, 0.5], 1: [7], 2: [2, 2.5]}


def test_a_folder_with_an_unfinished_run_is_not_taken_by_mistake(tmp_path):
    leave(tmp_path, 0)
    with pytest.raises(InputError, match=r"holds a run that was not finished: .*--resume.*--overwrite"):
        begin(tmp_path)
    assert begin(tmp_path, overwrite=True)[:2] == (set(), [0, 1, 2, 3])  # thrown away when the new one begins


def test_resume_starts_where_nothing_is(tmp_path):
    assert begin(tmp_path / "new", resume=True)[:2] == (set(), [0, 1, 2, 3])
    (tmp_path / "empty").mkdir()
    assert begin(tmp_path / "empty", resume=True)[:2] == (set(), [0, 1, 2, 3])


@pytest.mark.parametrize(
    ("change", "units", "message"),
    [
        ({"episodes": 5}, 4, r"its episodes is 3, not 5"),
        ({"lidar": [Lidar(range_m=4)]}, 4, r"its lidar is "),
        ({"command": "reproduce"}, 4, r'its command is "compare", not "reproduce"'),
        ({"seed": 1}, 4, r"its seed is null, not 1"),
        ({}, 5, r"its units is 4, not 5"),
    ],
)
def test_another_run_is_not_gone_on_with(tmp_path, change, units, message):
    leave(tmp_path, 0)
    with pytest.raises(InputError, match=f"holds another run: {message}.*--overwrite"):
        begin(tmp_path, units=units, asked={**ASKED, **change}, resume=True)
    assert begin(tmp_path, resume=True)[0] == {0}


def test_a_finished_run_is_known(tmp_path):
    page = {"asked": {**ASKED, "lidar": [ledger.jsonable(Lidar())]}, "units": 4}
    with claimed(tmp_path) as run:
        run.write({"run.json": lambda path: path.write_text(json.dumps(page))})
    with claimed(tmp_path, resume=True) as run:
        assert ledger.is_finished(run, ASKED, 4)
        with pytest.raises(InputError, match="its units is 4, not 5"):
            ledger.is_finished(run, ASKED, 5)
    for page in ([1], {"asked": [1]}, {"asked": {"own": [1]}}, {"asked": {"spec": "x"}, "units": 3}):  # something else
        (tmp_path / "run.json").write_text(json.dumps(page))
        with (
            claimed(tmp_path, resume=True) as run,
            pytest.raises(InputError, match="does not say what"),
        ):
            ledger.is_finished(run, ASKED, 4)
    (tmp_path / "run.json").write_text("{")
    with claimed(tmp_path, resume=True) as run, pytest.raises(InputError, match="is not valid JSON"):
        ledger.is_finished(run, ASKED, 4)
    (tmp_path / "run.json").rename(tmp_path / "compare.png")
    with claimed(tmp_path, resume=True) as run, pytest.raises(InputError, match=r"holds a run \(compare.png\)"):
        ledger.is_finished(run, ASKED, 4)


@pytest.mark.parametrize("cut", [0, 3, 100, -1])
def test_a_unit_cut_short_is_made_again(tmp_path, cut):
    leave(tmp_path, 0, 1)
    file = tmp_path / UNFINISHED / "000001.parquet"
    file.write_bytes(file.read_bytes()[:cut])
    (tmp_path / UNFINISHED / ".000002.parquet.1-ab.part").write_bytes(b"half")  # its writer was killed
    assert begin(tmp_path, resume=True) == ({0}, [1, 2, 3], ["000001.parquet"], {0: [0, 0.5]})
    assert names(tmp_path / UNFINISHED) == ["000000.parquet", "asked.json"]


@pytest.mark.parametrize("at", [4, 30, 55])
def test_a_unit_damaged_inside_is_made_again(tmp_path, at):
    """Nothing is told as kept that cannot be read."""
    leave(tmp_path, 0, 1)
    file = tmp_path / UNFINISHED / "000000.parquet"
    data = bytearray(file.read_bytes())
    data[at : at + 8] = bytes(byte ^ 4 for byte in data[at : at + 8])
    file.write_bytes(data)
    assert begin(tmp_path, resume=True) == ({1}, [0, 2, 3], ["000000.parquet"], {1: [1, 1.5]})


def shorter(episodes):
    """A run of 2 episodes a unit that goes on with runs of fewer."""

    def units_of(rows):
        for unit in range(episodes // 2):
            own = rows[rows["value"].between(2 * unit, 2 * unit + 1)]
            if len(own):
                yield unit, own.reset_index(drop=True), len(own) == 2

    def asked(n):
        return {key: value for key, value in {**ASKED, "episodes": n}.items() if key != "command"}

    return ledger.Shorter(episodes, asked, lambda folder: pd.read_parquet(folder / "episodes.parquet"), units_of)


def lengthen(path, episodes, **change):
    asked = {**ASKED, "episodes": episodes, **change}
    with claimed(path, resume=True) as run:
        assert not ledger.is_finished(run, asked, episodes // 2, shorter=shorter(episodes))
        book = ledger.Ledger(run, asked, episodes // 2, resume=True, shorter=shorter(episodes))
        found = {unit: book.get(unit)["value"].tolist() for unit in sorted(book.done)}
        return found | {unit: book.get(unit)["value"].tolist() for unit in sorted(book.parts)}


def test_a_run_goes_on_with_more_episodes(tmp_path):
    with claimed(tmp_path) as run:
        book = ledger.Ledger(run, {**ASKED, "episodes": 5}, 3)
        for unit, values in enumerate([(0, 1), (2, 3), (4,)]):
            book.put(unit, table(*values))
    assert lengthen(tmp_path, 8) == {0: [0, 1], 1: [2, 3], 2: [4]}
    assert lengthen(tmp_path, 8) == {0: [0, 1], 1: [2, 3], 2: [4]}  # after whatever has ended it
    assert lengthen(tmp_path, 10) == {0: [0, 1], 1: [2, 3], 2: [4]}
    with claimed(tmp_path, resume=True) as run:
        book = ledger.Ledger(run, {**ASKED, "episodes": 10}, 5, resume=True, shorter=shorter(10))
        book.put(2, table(4, 5))
    assert lengthen(tmp_path, 12) == {0: [0, 1], 1: [2, 3], 2: [4, 5]}
    assert len(names(tmp_path / UNFINISHED)) == 4  # with the page, nothing of shorter runs
    for episodes, change, says in (
        (10, {}, "holds a run of 12 episodes, more than 10: ask for 12 or more"),
        (14, {"seed": 1}, "its seed is null, not 1"),
        (12, {"seed": 1}, "its seed is null, not 1"),
    ):
        with pytest.raises(InputError, match=says):
            begin_longer(tmp_path, episodes, change)


def begin_longer(path, episodes, change):
    other = shorter(episodes)
    asks = other._replace(asked=lambda n: {**other.asked(n), **change})
    with claimed(path, resume=True) as run:
        ledger.Ledger(run, {**ASKED, "episodes": episodes, **change}, episodes // 2, resume=True, shorter=asks)


def test_a_finished_run_goes_on_with_more_episodes(tmp_path):
    page = {"asked": ledger.jsonable({**ASKED, "episodes": 4}), "units": 2}
    files = {"episodes.parquet": lambda path: table(0, 1, 2, 3).to_parquet(path)}
    with claimed(tmp_path) as run:
        run.write({**files, "run.json": lambda path: path.write_text(json.dumps(page))})
    (tmp_path / UNFINISHED).mkdir()  # as of a process that was killed before the page was there
    (tmp_path / UNFINISHED / "000003.parquet").write_bytes(b"half")
    with claimed(tmp_path, resume=True) as run:
        assert ledger.is_finished(run, {**ASKED, "episodes": 4}, 2, shorter=shorter(4))
    assert lengthen(tmp_path, 6) == {0: [0, 1], 1: [2, 3]}
    assert "run.json" in names(tmp_path)  # the shorter one stays until the longer one is there


def test_growing_loses_nothing_when_it_is_ended(tmp_path, monkeypatch):
    with claimed(tmp_path) as run:
        book = ledger.Ledger(run, {**ASKED, "episodes": 4}, 2)
        for unit in (0, 1):
            book.put(unit, table(2 * unit, 2 * unit + 1))
    write = ledger.write_json

    def ended(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(ledger, "write_json", ended)
    with pytest.raises(KeyboardInterrupt):
        lengthen(tmp_path, 8)
    monkeypatch.setattr(ledger, "write_json", write)
    with claimed(tmp_path, resume=True) as run:
        assert ledger.Ledger(run, {**ASKED, "episodes": 4}, 2, resume=True).done == {0, 1}
    assert lengthen(tmp_path, 8) == {0: [0, 1], 1: [2, 3]}


@pytest.mark.parametrize("finished", [False, True])
def test_a_strategy_that_cannot_be_told_is_trusted_or_refused(tmp_path, finished):
    def opened(own, **how):
        asked = {**ASKED, "own": {f"strategy {name!r}": digest for name, digest in own.items()}}
        with claimed(tmp_path, resume=True) as run:
            if finished:
                return ledger.is_finished(run, asked, 4, **how)
            return ledger.Ledger(run, asked, 4, resume=True, **how).done

    asked = {**ASKED, "own": {"strategy 'mine'": "a", "strategy 'asks'": None}}
    with claimed(tmp_path) as run:
        if finished:
            page = {"asked": ledger.jsonable(asked), "units": 4}
            run.write({"run.json": lambda path: path.write_text(json.dumps(page))})
        else:
            ledger.Ledger(run, asked, 4).put(0, table(1))
    with pytest.raises(InputError, match=r"'asks', which calls back into Python, .* --trust goes on if you know"):
        opened({"mine": "a", "asks": None})
    with pytest.raises(InputError, match="its strategy 'mine' computes something else now"):
        opened({"mine": "b", "asks": None})
    assert opened({"mine": "b", "asks": None}, trust=True) == (True if finished else {0})


def test_a_page_that_cannot_be_read_is_told(tmp_path):
    leave(tmp_path, 0)
    (tmp_path / UNFINISHED / "asked.json").write_text("{")
    with pytest.raises(
        InputError, match=r"asked.json': is not valid JSON .*: it must say what the run is asked; use --overwrite"
    ):
        begin(tmp_path, resume=True)


def test_a_full_disk_leaves_what_was_finished(tmp_path, monkeypatch):
    leave(tmp_path, 0)

    def full(self, file, **options):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    with claimed(tmp_path, resume=True) as run:
        book = ledger.Ledger(run, ASKED, 4, resume=True)
        monkeypatch.setattr(pd.DataFrame, "to_parquet", full)
        with pytest.raises(InputError, match="No space left on device"):
            book.put(1, table(1))
        assert book.done == {0}
    assert begin(tmp_path, resume=True)[0] == {0}


def test_a_finished_run_leaves_no_units(tmp_path):
    with claimed(tmp_path) as run:
        ledger.Ledger(run, ASKED, 4).put(0, table(1))
        run.write(texts(run_json="{}"), is_finished=False)
        assert names(tmp_path) == [LOCK, UNFINISHED, "run.json"]
        run.write(texts(run_json="{}"))
    assert names(tmp_path) == ["run.json"]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_lock_that_cannot_be_had_is_left_out(tmp_path, monkeypatch):
    """On a file system without locks a run goes on without."""
    import fcntl

    def refuse(handle, how):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with claimed(tmp_path) as run:
        run.write(texts(run_json="{}"))
    assert names(tmp_path) == ["run.json"]


def test_units_without_their_page_are_nobodys(tmp_path):
    """As a process leaves them that is killed while it throws them away."""
    leave(tmp_path, 0, 1)
    (tmp_path / UNFINISHED / "asked.json").unlink()
    assert begin(tmp_path, resume=True)[:2] == (set(), [0, 1, 2, 3])


def test_what_ends_before_any_unit_leaves_nothing(tmp_path):
    begin(tmp_path / "run")
    assert names(tmp_path) == []
