"""Files that somebody gives: every format by one function, what goes wrong in one line, in bounded time and memory."""

import json
import os

import numpy as np
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.arrays.files import MOST_LEVELS, json_of, read_json, read_text, read_yaml, yaml_of
from jexplore.policies.learned.model import load_model
from jexplore.report.store import read_parquet
from jexplore.studies.sweeps.spec import read_spec

READERS = (
    (jx.btm.read_btm, "btm.json"),
    (jx.load_world, "map.png@0.1"),
    (jx.load_world, "map.yaml"),
    (read_spec, "spec.yaml"),
    (load_model, "model.msgpack"),
    (read_parquet, "episodes.parquet"),
)


@pytest.mark.parametrize(("read", "name"), READERS)
def test_what_is_no_regular_file_is_refused_before_it_is_read(tmp_path, read, name):
    path = tmp_path / name.partition("@")[0]
    os.mkfifo(path)  # opening it would wait for a writer
    (tmp_path / "model.json").symlink_to("/dev/zero")  # reading it would not end
    refused("is not a regular file", read, str(tmp_path / name))
    path.unlink()
    path.symlink_to("/dev/zero")
    refused("is not a regular file", read, str(tmp_path / name))


def test_a_text_too_large_empty_or_in_other_bytes_is_refused(tmp_path):
    path = tmp_path / "text"
    path.write_text("12345")
    assert read_text(path, 5) == "12345"
    refused("'.*text': has 5 bytes; at most 4 are read", read_text, path, 4)
    path.write_bytes(b"")
    refused("is empty", read_text, path, 4)
    path.write_bytes(b"a\xff")
    refused(r"is not UTF-8 text \(byte 1\)", read_text, path, 4)


def test_json_is_told_with_its_line_and_nests_so_deep_and_no_deeper(tmp_path):
    refused(r"^x: is not valid JSON \(line 3: Expecting value\)$", json_of, "\n[\n}", "x")
    refused(r"^x: is not valid JSON \(Exceeds the limit .*\)$", json_of, "1" * 10_000, "x")
    for first, last in (("[", "]"), ('{"a":', "}")):
        ends = {n: first * n + "1" + last * n for n in (MOST_LEVELS, MOST_LEVELS + 1, 500, 10_000)}
        assert json.dumps(json_of(ends.pop(MOST_LEVELS), "x")).count(first[0]) == MOST_LEVELS
        for text in ends.values():
            refused(f"^x: lists and objects lie in each other more than {MOST_LEVELS} deep$", json_of, text, "x")
    (tmp_path / "bom.json").write_bytes(b"\xef\xbb\xbf[1]")
    assert read_json(tmp_path / "bom.json", 100) == [1]


def test_yaml_has_the_numbers_of_its_version_1_2():
    text = "[010, 4:30, 1e-3, 1e3, 0x10, 0o10, .5, 5., -3, +4, .inf, 1_000, 2026-01-02, no, true, ~]"
    wanted = [10, "4:30", 0.001, 1000.0, 16, 8, 0.5, 5.0, -3, 4, np.inf, "1_000", "2026-01-02", "no", True, None]
    assert repr(yaml_of(text, "x")) == repr(wanted)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: [1\nb: 2", "line 2, column 2: expected ',' or ']'"),
        ("a: 1\nb: 2\na: 3", "line 3, column 1: the key 'a' is there twice"),
        ("? [1]\n: 2", "a key must be a plain value"),
        ("a: &a [1]\nb: *a", "line 2, column 4: aliases are not read: write out what it stands for"),
        ("\n".join(f"{x}: &{x} [{', '.join([f'*{y}'] * 9)}]" for x, y in zip("bcdefghij", "abcdefghi")), "aliases"),
        ("[" * 2_000, f"more than {MOST_LEVELS} deep"),
        ("a: " + "1" * 9000, "Exceeds the limit"),
        ("!!python/object/apply:os.getcwd []", "could not determine a constructor"),
    ],
)
def test_bad_yaml_is_told_with_its_place(tmp_path, text, line):
    (tmp_path / "s.yaml").write_text(text)
    for read in (read_yaml, read_spec):
        refused(line, read, tmp_path / "s.yaml")
