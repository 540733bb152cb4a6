"""The example scripts run as they stand, in a folder of their own, and say nothing on the error stream."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.py"))


def test_there_are_examples():
    assert {path.stem for path in EXAMPLES} >= {"own_strategy", "sweep"}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path, tmp_path):
    env = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}  # that of tests makes slow code
    command = [sys.executable, "-W", "error::UserWarning", str(path), "picture.png"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300, env=env)
    assert (done.returncode, done.stderr) == (0, "")
    assert "closest+recheck" in done.stdout
    assert "nan" not in done.stdout.lower()
    assert [file.name for file in tmp_path.iterdir()] == ["picture.png"]
    with Image.open(tmp_path / "picture.png") as picture:
        assert len(picture.convert("RGB").getcolors(10**6)) > 10
