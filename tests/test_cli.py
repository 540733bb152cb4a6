"""The command line: what it writes, what it says, what it refuses, how it ends."""

import json
import os
import shlex
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import jexplore
from jexplore.cli import main, options
from jexplore.config import InputError
from jexplore.exploration import batch
from jexplore.learn.settings import TRAINER_SETTINGS
from jexplore.learn.training import TRAINERS
from jexplore.policies import STRATEGIES
from jexplore.policies.catalogue.entries import SYNONYMS
from jexplore.report import folders, store
from jexplore.studies.results.columns import COLUMNS

LIDAR = ("--lidar.n-beams", "37", "--lidar.range-m", "1")


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """Two small rooms as an image of 34 x 22 pixels."""
    grey = np.full((22, 34), 255, np.uint8)
    grey[[0, -1]], grey[:, [0, -1]] = 0, 0
    grey[:, 17], grey[8:16, 17] = 0, 255
    path = tmp_path_factory.mktemp("maps") / "plan.png"
    Image.fromarray(grey).save(path)
    return path


@pytest.fixture(scope="module")
def world(plan):
    return f"{plan}@0.1"


@pytest.fixture(scope="module")
def ran(world, tmp_path_factory, jit_on):
    """The folder of one comparison."""
    out = tmp_path_factory.mktemp("runs") / "new" / "run"
    strategies = ("closest", "random", "closest+recheck")
    with jit_on():
        status = main.main(
            [
                *("compare", "--worlds", world, "--strategies", *strategies, "--episodes", "3", "--seed", "3"),
                *("--out", str(out), *LIDAR),
            ]
        )
    assert status == 0
    return out


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def test_compare_writes_a_whole_run(ran, world):
    assert files(ran) == [
        *("compare.png", "compare.svg", "coverage.png", "coverage.svg", "details.parquet", "episodes.parquet"),
        *("paths.png", "report.html", "run.json"),
    ]
    table = pd.read_parquet(ran / "episodes.parquet")
    assert list(table.columns) == list(COLUMNS)
    assert table["world"].tolist() == [world] * 9
    assert table["strategy"].tolist() == ["closest"] * 3 + ["random"] * 3 + ["closest+recheck"] * 3
    assert table["room_entries"].isna().all()
    for name in ("compare.png", "paths.png"):
        with Image.open(ran / name) as image:
            image.verify()


@pytest.mark.jit
def test_compare_again_is_the_same_and_prints_the_table(ran, world, tmp_path, printed, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["compare", "--worlds", world, "--strategies", "closest", "random", "--episodes", "2", "--seed", "3"]
    said = printed([*command, *LIDAR]).out
    assert said.startswith("| world ")
    assert "| random " in said
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.endswith("Z-compare")
    wrote = "episodes.parquet, details.parquet, run.json, coverage.png, compare.png, paths.png, report.html"
    assert said.splitlines()[-1] == f"wrote {wrote} to runs/{folder.name}/"
    again, whole = (pd.read_parquet(at / "episodes.parquet") for at in (folder, ran))
    pd.testing.assert_frame_equal(again, whole[(whole["episode"] < 2)][:4].reset_index(drop=True))


def test_a_run_is_not_overwritten(ran, world, refuses, monkeypatch):
    monkeypatch.setattr(batch, "run_jobs", lambda *_, **__: pytest.fail("ran"))
    before = (ran / "run.json").read_bytes()
    refuses(["compare", "--worlds", world, "--out", ran], "holds a run")
    refuses(["explore", "--world", world, "--out", ran], "holds a run")
    refuses(["worlds", world, "--out", ran], "holds a run")
    assert (ran / "run.json").read_bytes() == before


@pytest.mark.jit
def test_explore_overwrites_when_told(ran, world, tmp_path, capsys):
    (tmp_path / "run.json").write_text("old")
    (tmp_path / "compare.png").write_text("old")
    (tmp_path / "mine.txt").write_text("mine")
    command = ["explore", "--world", world, "--strategy", "closest", "--seed", "3", *LIDAR, "--out", str(tmp_path)]
    assert main.main([*command, "--overwrite", "--frames", "7"]) == 0
    own = ["episode.gif", "episode.png", "explored.pgm", "explored.yaml", "mine.txt", "report.html", "run.json"]
    assert files(tmp_path) == own
    row = pd.read_parquet(ran / "episodes.parquet").iloc[0]
    assert json.loads((tmp_path / "run.json").read_text())["result"]["path_m"] == row["path_m"]
    assert f"path_m             {row['path_m']:.3f}" in capsys.readouterr().out
    with Image.open(tmp_path / "episode.gif") as image:
        assert image.n_frames == 7


@pytest.mark.jit
def test_an_interruption_is_one_line_and_leaves_the_old_run(ran, world, tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    command = ["explore", "--world", world, "--strategy", "closest", "--seed", "3", *LIDAR, "--out", str(tmp_path)]
    (tmp_path / "run.json").write_text("old")
    for module, where in ((folders, "write_json"), (store, "environment")):
        with monkeypatch.context() as patch:
            patch.setattr(module, where, interrupted)
            assert main.main([*command, "--overwrite"]) == 130
        said = capsys.readouterr()
        assert said.err.endswith("jexplore: interrupted, no results were written\n")
        assert files(tmp_path) == ["run.json"]
        assert (tmp_path / "run.json").read_text() == "old"


def test_version_and_help(printed):
    assert printed(["--version"]).out == f"jexplore {jexplore.__version__}\n"
    said = printed(["--help"]).out
    assert all(f"\n  {name} " in said for name in main.COMMANDS)
    assert "--lidar.range-m" in printed(["explore", "--help"]).out


def test_examples_of_help_are_commands(printed):
    assert list(options.EXAMPLES) == list(main.COMMANDS)
    for name, examples in options.EXAMPLES.items():
        for example in examples:
            command, *rest = shlex.split(example)
            assert command == name
            assert type(options.parse_options([name, *rest], main.COMMANDS)) is main.COMMANDS[name]
    assert f"  jexplore {options.EXAMPLES['merge'][0]}\n" in printed(["merge", "--help"]).out


def test_the_defaults_are_smaller_on_request(monkeypatch):
    large = options.parse_options(["compare"], main.COMMANDS)
    monkeypatch.setenv(options.SMALL, "1")
    small = options.parse_options(["compare"], main.COMMANDS)
    assert small.episodes < large.episodes / 3
    monkeypatch.setenv(options.SMALL, "0")
    assert options.parse_options(["compare"], main.COMMANDS) == large


BAD_INPUT = [
    ("", "expected a command"),
    ("compar", "unknown command 'compar'; did you mean 'compare'? (there are: compare, "),
    ("--worlds cave", "expected a command first"),
    ("compare --epsodes 3", "unrecognized options: --epsodes, 3; did you mean --episodes?"),
    ("compare extra", "unrecognized options: extra"),
    ("compare --episodes x", "--episodes: must be an integer, got 'x'"),
    ("compare --episodes", "missing value for argument '--episodes'"),
    ("compare --cell-m x", "--cell-m: must be a number, got 'x'"),
    ("compare --engine x", "invalid choice 'x' for argument '--engine'. Expected one of ('auto', 'jax')"),
    ("bench --batch-sizes x", "--batch-sizes: Could not find valid parse for arguments: ['x']"),
    ("compare --worlds cave --worlds maze", "--worlds is given twice, and can be given once; it takes all its values"),
    ("compare --seed 1 --seed 2 --seed 2", "--seed is given 3 times, and can be given once"),
    ("explore --lidar.range_m 3 --lidar.range-m 4", "--lidar.range-m is given twice"),
    # numbers
    ("explore --frames 0", "frames must be an integer from 1 to 10000, got 0"),
    ("compare --lidar.n-beams 0", "lidar.n_beams must be an integer from 1 to 4096"),
    ("compare --rules.max-steps nan", "--rules.max-steps: must be an integer"),
    ("compare --lidar.range-m 1000 --lidar.n-beams 4096 --cell-m 0.02 --worlds maze", "GiB"),
    # names and files
    ("compare --worlds missing.png@0.1", "'missing.png': there is no such file (looked in "),
    ("compare --worlds caf\udce9.png@0.1", "must be UTF-8"),
    ("compare --strategies Next_Best_View", "did you mean 'decision-theoretic'?"),
    ("compare --strategies random random", "strategies must differ, got 'random' more than once"),
    ("explore --strategy utility:betta=1", "unknown parameter of 'utility': 'betta'; did you mean 'beta'?"),
    ("explore --strategy no_such_module:f", "no_such_module"),
    (
        "explore --start 1,2 --world maze",
        "start must be random, world, cells such as 12,30,90 (row, column, degrees) or",
    ),
    ("explore --within 0,0 --world maze", "within must be three or more corners"),
    ("tune --trials 0", "trials must be an integer from 1 to 10000, got 0"),
    ("tune --world-seeds 0", "world_seeds must be an integer from 1 to 1000, got 0"),
    ("tune --strategies closest+recheck", "'closest+recheck' has no setting with bounds to be tuned"),
    ("tune --strategies utility:beta=1,min_gain=1", "has no setting with bounds to be tuned"),
    ("compare --tuned nope.json", "there is no such file"),
    ("train --model nope.msgpack", "there is no such file"),
    ("route --map nope.json --to 3", "there is no such file"),
    ("sweep nope.yaml", "'nope.yaml': there is no such file"),
    ("sweep spec.yaml", "there is no world 'kave'"),
    ("compare --resume", "--resume goes on with the run in a folder: name it with --out DIR"),
    ("compare --resume --overwrite --out x", "--resume goes on with a run and --overwrite replaces it"),
    ("compare --trust --out x", "--trust says how to go on with a run"),
]


@pytest.mark.parametrize(("command", "message"), BAD_INPUT)
def test_bad_input_is_one_line(command, message, refuses, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(batch, "run_jobs", lambda *_, **__: pytest.fail("ran"))
    (tmp_path / "spec.yaml").write_text("worlds: [maze, kave]\nstrategies: [closest]\n")
    refuses(command.split(" ") if command else [], message)
    assert files(tmp_path) == ["spec.yaml"]


def test_tables_of_names_agree():
    assert set(SYNONYMS.values()) <= set(STRATEGIES)
    assert not set(SYNONYMS) & set(STRATEGIES)
    assert list(TRAINERS) == list(TRAINER_SETTINGS)


def test_a_message_stays_on_one_line(refuses, monkeypatch):
    def fails(*_):
        raise InputError("first\nsecond")

    monkeypatch.setattr(main, "_dispatch", fails)
    assert refuses(["worlds"], "first second").endswith("first second\n")


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8 bytes")])
def test_memory_that_runs_out_is_one_line(error, printed, monkeypatch):
    def fails(*_):
        raise error

    monkeypatch.setattr(main, "_dispatch", fails)
    assert printed(["worlds"], 1).err.startswith("jexplore: error: out of memory")


@pytest.mark.slow
def test_without_a_home(tmp_path):
    program = """
import os, pwd, sys
def nobody(*_):
    raise KeyError("uid not found")
pwd.getpwuid = pwd.getpwnam = nobody
from jexplore.cli import main
from jexplore.engine.backend import use_compilation_cache
use_compilation_cache()
import jax
assert jax.config.values["jax_compilation_cache_dir"] is None
status = main.main(["worlds", "rooms:width_m=6,height_m=5", "--out", "run"])
raise SystemExit(status)
"""
    no_home = ("HOME", "XDG_", "MPLCONFIGDIR", "JAX_COMPILATION_CACHE_DIR")
    own = {name: value for name, value in os.environ.items() if not name.startswith(no_home)}
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=own, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert files(tmp_path) == ["run"]
    assert files(tmp_path / "run") == ["run.json", "worlds.png"]


def test_python_m_and_exit_status():
    command = [sys.executable, "-m", "jexplore"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"jexplore {jexplore.__version__}\n")
    done = subprocess.run([*command, "compare", "--episodes", "x"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
