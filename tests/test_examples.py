"""The example scripts run, with fewer episodes, in a folder of their own, and say nothing on the error stream."""

import re
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
    code, n = re.subn(r"""(episodes=|"episodes": )\d+""", r"\g<1>3", path.read_text(encoding="utf-8"))
    assert n == 1
    script, here = tmp_path / path.name, tmp_path / "here"
    script.write_text(code, encoding="utf-8")
    here.mkdir()
    command = [sys.executable, "-W", "error::UserWarning", str(script), "picture.png"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=here, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert "closest+recheck" in done.stdout
    assert "nan" not in done.stdout.lower()
    assert [file.name for file in here.iterdir()] == ["picture.png"]
    with Image.open(here / "picture.png") as picture:
        assert len(picture.convert("RGB").getcolors(10**6)) > 10
