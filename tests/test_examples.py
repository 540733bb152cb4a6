"""The example scripts run, with fewer episodes, in a folder of their own, and say nothing on the error stream."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import jexplore as jx

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
STUDIES = [EXAMPLES / "own_strategy.py", EXAMPLES / "sweep.py", EXAMPLES / "certain.py"]


@pytest.mark.slow
@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_an_example_runs(path, tmp_path):
    code, n = re.subn(r"""(episodes=|"episodes": )\d+""", r"\g<1>3", path.read_text(encoding="utf-8"))
    assert n == 1
    code = code.replace('compare("office"', 'compare("rooms:width_m=8,height_m=6"')
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


def nearest(view):
    """The strategy `closest` as a user's score, which native code cannot run: the episode runs in JAX."""
    return -view.cost


@pytest.mark.jit
@pytest.mark.parametrize(
    ("name", "cell_m", "episode", "exhausted"),
    [
        ("cave#3:width_m=9,height_m=8", 0.15, 2, 1),
        pytest.param("rooms#0:width_m=8,height_m=6", 0.1, 0, 0, marks=pytest.mark.slow),
    ],
)
def test_the_written_out_episode_is_that_of_explore(name, cell_m, episode, exhausted):
    module = runpy.run_path(str(EXAMPLES / "episode.py"))
    world = jx.load_world(name, cell_m=cell_m)
    runs = [jx.explore(world, strategy, episode=episode) for strategy in ("closest", nearest)]
    robot = module["Robot"](world, runs[0].start)
    robot.explore()
    for found in runs:
        assert robot.path == list(zip(found.final.rows, found.final.cols))
        np.testing.assert_array_equal(robot.grid.hits, found.final.hits)
        np.testing.assert_array_equal(robot.grid.misses, found.final.misses)
    assert len(robot.path) > 50
    assert len((EXAMPLES / "episode.py").read_text(encoding="utf-8").splitlines()) <= 150
    assert robot.exhausted.sum() == runs[0].measures["exhausted"] == exhausted


@pytest.mark.slow
@pytest.mark.jit
def test_the_written_out_episode_runs_as_a_script(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["episode.py", "maze:width_m=6,height_m=6"])
    runpy.run_path(str(EXAMPLES / "episode.py"), run_name="__main__")
    assert capsys.readouterr().out.splitlines()[-1] == "jx.explore drove the same cells"


@pytest.mark.slow
@pytest.mark.jit
def test_the_policy_runs():
    restless = runpy.run_path(str(EXAMPLES / "policy.py"))["restless"]
    found = jx.compare("maze:width_m=6,height_m=6", restless, episodes=1)
    assert found.episodes["outcome"].tolist() == ["COMPLETE"]
