"""The code in the documentation runs, its commands parse, its links lead somewhere, and its lists are complete."""

import importlib.util
import itertools
import os
import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest
import yaml

import jexplore as jx
from jexplore.cli.main import COMMANDS, main
from jexplore.cli.options import parse_options
from jexplore.config import InputError
from jexplore.policies.catalogue import entries
from jexplore.report.folders import OUR_FILES
from jexplore.studies.results.columns import COLUMNS
from jexplore.studies.sweeps.spec import sweep_from

ROOT = Path(__file__).resolve().parents[1]
TOP = ("README.md", "CONTRIBUTING.md", "benchmarks/README.md")
PAGES = [*TOP, *sorted(page.relative_to(ROOT).as_posix() for page in (ROOT / "docs").rglob("*.md"))]
API = [page for page in PAGES if page.startswith("docs/reference/api/")]
EXCERPT = "<!-- excerpt: "
RUN_ELSEWHERE = ("CONTRIBUTING.md", "docs/tutorial.md")  # by .ci/run, and by a test of its own
NO_COMMANDS_OF_OURS = (
    "python3 -m venv",
    "pip install",
    ".venv/bin/",
    ".ci/run",
    "python benchmarks/",
    "python examples/",
    "sbatch",
    "jupyter",
)
PARSED_ONLY = {
    ".venv/bin/jexplore compare": "the first run: .ci/run has it",
    "jexplore compare --league": "hours",
    "jexplore league submit": "needs what the line before writes; tests/test_league_entries.py",
    "jexplore reproduce": "needs the paper's maps",
    "jexplore compare --worlds MAPS/": "needs the paper's maps",
    "jexplore slam": "needs a recorded log; tests/test_slam_logs.py",
    "jexplore bench": "measures this machine for minutes, or needs a compiler for a GPU; tests/test_bench.py",
    "jexplore train": "minutes of compiling; tests/test_training.py",
    "jexplore tune": "minutes of compiling; tests/test_tuning.py",
    "jexplore compare --strategies closest+recheck learned+recheck:path=trained/": "needs what `train` writes",
    "jexplore trace --runs 100": "a program for many settings at once; tests/test_tracing.py",
    "jexplore trace --world rooms --robots": "minutes of driving; tests/test_trace_teams.py",
    "jexplore merge parts/*": "needs the parts that 16 machines wrote",
}
"""Beginnings of command lines of which only the options are checked -> why they are not run."""
FROM_ELSEWHERE = {"docs/how-to/own-map.md": "docs/tutorial.md", "docs/how-to/cluster.md": "docs/how-to/sweep.md"}
"""Pages that go on with files of another page."""
SMALL = {
    **{name: f"rooms#{i}:width_m=8,height_m=6" for i, name in enumerate(("cave", "office", "office#1", "maze"), 10)},
    **{f"rooms#{i}": f"rooms#{i}:width_m=8,height_m=6" for i in range(3)},
}
"""Worlds of commands that run episodes -> those that stand for them here, all of one size."""


def script(name):
    """A script of `docs/`, as a module."""
    spec = importlib.util.spec_from_file_location(f"{name}_of_the_docs", ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def text_of(page):
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(text):
    """Return fenced blocks: pairs of the language and the content; `excerpt` as language of a block marked so."""
    for before, spaces, language, body in re.findall(r"([^\n]*)\n( *)```(\w*)\n(.*?)^ *```$", text, re.S | re.M):
        body = re.sub(rf"^{spaces}", "", body, flags=re.M)
        yield "excerpt" if before.startswith(EXCERPT) else language, body


def python_in(page):
    return [body for language, body in blocks(text_of(page)) if language == "python"]


def languages_in(page):
    return [language for language, _ in blocks(text_of(page))]


def commands_in(page):
    """Command lines that begin with jexplore, in blocks and in the text: lists of words."""
    text = text_of(page)
    fenced = [body for language, body in blocks(text) if language in ("sh", "bash", "")]
    lines = [line for body in fenced for line in body.replace("\\\n", " ").splitlines()]
    lines += re.findall(
        r"`(jexplore [^`]*)`", re.sub(r"^ *```.*?^ *```$", "", text, flags=re.S | re.M).replace("\n", " ")
    )
    for line in lines:
        # What stands before it: variables, a launcher, the folder of an environment, another command.
        match = re.match(r"(?:.* && )?(?:\w+=\S+ |srun )*(?:\.venv/bin/)?jexplore (.*)", line.strip())
        if match and not match[1].startswith("-"):
            yield shlex.split(re.sub(r"\$\w+", "7", re.sub(r"\s#\s.*", "", match[1])))


def small(code):
    """The same with few episodes, and the sweep without noise, for which native code drives."""
    return re.sub(r"(episodes(?:=|: ))\d+", r"\g<1>2", code).replace("sigma_m: [0, 0.02]", "sigma_m: 0")


def made_small(words):
    """A command with one episode a world, in small worlds, few frames, no page of replays."""
    if words[0] in ("compare", "explore", "segment", "bound"):
        words = [SMALL.get(word, word) for word in words if not re.match(r"office#[02]", word)]
    numbers = {"--episodes": "1", "--starts": "1", "--seconds": "1", "--frames": "5"}
    words = [numbers.get(before, word) for before, word in itertools.pairwise(["", *words])]
    words += ["--no-report"] if words[0] in ("compare", "explore", "merge") else []
    return words + (["--frames", "5"] if words[0] == "explore" and "--frames" not in words else [])


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """Return an empty folder to work in, in which modules are found, and no trace remains afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    monkeypatch.setattr(entries, "STRATEGIES", dict(entries.STRATEGIES))
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "") or "").startswith(str(tmp_path)):
            del sys.modules[name]


def write_files(page, desk):
    """Writes the blocks of a page that have the name of a file."""
    for language, body in blocks(text_of(page)):
        name = re.match(r"# (\w+\.(?:py|yaml))\n", body)
        if name and language in ("python", "yaml"):
            (desk / name[1]).write_text(small(body), encoding="utf-8")


def run_blocks(page, desk):
    """Runs what a page shows, block after block, commands at a small size: the names that Python has in the end."""
    found = {"__name__": "page"}
    write_files(page, desk)
    for language, body in blocks(text_of(page)):
        if language == "python":
            exec(compile(small(body), page, "exec"), found)
        elif language == "sh":
            for line in body.replace("\\\n", " ").splitlines():
                run_line(page, re.sub(r" +# .*", "", " ".join(line.split())))
    return found


def run_line(page, line):
    """Runs a line of a shell block, if it is a command of ours and small enough."""
    line = line.rpartition(" && ")[2].removeprefix("JEXPLORE_SMALL=1 ")
    if line.startswith((*NO_COMMANDS_OF_OURS, *PARSED_ONLY)):
        return
    words = shlex.split(line)
    assert words[0] == "jexplore", f"{page}: {line}"
    words += ["--no-report"] if words[1] == "sweep" else []  # the tutorial's has one
    assert main(made_small(words[1:])) in (0, None), f"{page}: {line}"


@pytest.mark.jit
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[] if page == "README.md" else pytest.mark.slow)
        for page in PAGES
        if page not in RUN_ELSEWHERE and set(languages_in(page)) & {"python", "sh"}
    ],
)
def test_what_a_page_shows_runs(page, desk, capsys):
    import matplotlib.pyplot as plt

    if page in FROM_ELSEWHERE:
        write_files(FROM_ELSEWHERE[page], desk)
        for script in sorted(desk.glob("draw_*.py")):
            exec(compile(script.read_text(encoding="utf-8"), script.name, "exec"), {"__name__": "__main__"})
    found = run_blocks(page, desk)
    plt.close("all")
    assert "jx" in found or not python_in(page)


@pytest.mark.slow
@pytest.mark.jit
def test_the_tutorial_from_an_empty_folder_to_a_figure(desk, capsys):
    ran = []
    for language, body in blocks(text_of("docs/tutorial.md")):
        name = re.match(r"# (\w+\.(?:py|yaml))\n", body)
        if language in ("python", "yaml"):
            assert name, "every file of the tutorial says how it is called"
            (desk / name[1]).write_text(small(body), encoding="utf-8")
            if language == "python":
                exec(compile(body, name[1], "exec"), {"__name__": "__main__"})
        elif "pip install" not in body:
            for words in (line.split() for line in body.replace("\\\n", " ").splitlines()):
                if words[0] == "jexplore":
                    assert main(made_small(words[1:])) in (0, None), capsys.readouterr().err
                    ran.append(words[1])
    assert ran == ["worlds", "explore", "sweep", "sweep", "compare"]
    assert (desk / "own_figure.png").stat().st_size > 5000
    assert jx.load("answer").to_pandas()["strategy"].unique().tolist() == ["closest+recheck", "mine:outward+recheck"]
    assert {"sweep.png", "report.html"} <= {file.name for file in (desk / "answer").iterdir()}


def test_excerpts_name_what_there_is():
    some = [(page, body) for page in PAGES for language, body in blocks(text_of(page)) if language == "excerpt"]
    assert some
    for page, body in some:
        compile(body, page, "exec")
        for name in re.findall(r"\bjx\.(\w+)", body):
            assert name in dir(jx), f"{page}: jx.{name}"


def test_page_of_an_episode_shows_the_whole_example():
    def lines(text):
        return [line.strip() for line in text.splitlines() if line.strip()]

    page = script("generate").filled(text_of("docs/tutorial-episode.md"))
    shown = [body for language, body in blocks(page) if language == "python"]
    _, code = text_of("examples/episode.py").split('"""\n', 1)
    assert lines("\n".join(shown)) == lines(code.partition('if __name__ == "__main__"')[0])


@pytest.mark.parametrize("page", PAGES)
def test_commands_parse(page):
    for words in commands_in(page):
        try:
            assert isinstance(parse_options(words, COMMANDS), COMMANDS[words[0]])
        except InputError as error:
            pytest.fail(f"{page}: jexplore {' '.join(words)}: {error}")


def test_commands_are_found():
    found = [words for page in PAGES for words in commands_in(page)]
    assert {words[0] for words in found} == set(COMMANDS)
    assert ["compare"] in found  # the README's first command
    assert ["sweep", "spec.yaml", "--shard", "7/16", "--workers", "7", "--out", "parts/7", "--resume"] in found


def test_specs_of_sweeps_can_be_run():
    specs = [(page, body) for page in PAGES for language, body in blocks(text_of(page)) if language == "yaml"]
    assert len(specs) >= 2
    for page, body in specs:
        spec = sweep_from(yaml.safe_load(body), page)
        assert len(spec.records()) == len(spec.expanded()) > 1


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    text = re.sub(r"^ *```.*?^ *```$", "", text_of(page), flags=re.S | re.M)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = target.partition("#")
        if ":" in path:
            continue
        file = (ROOT / page).parent / path if path else ROOT / page
        assert file.exists(), f"{page}: {target}"
        if anchor:
            assert anchor in anchors(file.read_text(encoding="utf-8")), f"{page}: {target}"


def anchors(text):
    """Anchors of the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_readme_is_short_and_begins_with_what_is_run():
    text = text_of("README.md")
    assert len(text.splitlines()) <= 150
    first, second = [body for language, body in blocks(text) if language == "sh"][:2]
    assert first.endswith("&& .venv/bin/jexplore compare\n")
    assert second == ".venv/bin/pip install '.[test]' && .venv/bin/pytest -n 2\n"


def test_every_public_name_is_in_the_reference():
    lists = re.findall(r"^Names: .*(?:\n.+)*", "\n".join(map(text_of, API)), re.M)
    named = [name for text in lists for name in re.findall(r"`jx\.([\w.]+)`", text)]
    there = {*dir(jx), *(f"btm.{name}" for name in jx.btm._LAZY.module_of)} - {"__version__", "btm", "worlds"}
    assert len(lists) == len(API)
    assert sorted(named) == sorted(there)


@pytest.mark.slow
def test_the_site_has_whole_docstrings_and_files_of_the_repository(tmp_path):
    script("generate").write_site(tmp_path / "site")
    page = (tmp_path / "site" / "reference" / "api" / "steps.md").read_text(encoding="utf-8")
    assert "\n::: jexplore.Environment\n" in page
    assert "Names:" not in page
    for part in ("commands", "strategies", "worlds"):
        assert "| --- |" in (tmp_path / "site" / "reference" / f"{part}.md").read_text(encoding="utf-8"), part
    assert "(../results/measured/exploration.md#" in (tmp_path / "site" / "reference" / "worlds.md").read_text(
        encoding="utf-8"
    )
    listed = {leaf for _, leaf in leaves(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])}
    there = {path.relative_to(tmp_path / "site").as_posix() for path in (tmp_path / "site").rglob("*.md")}
    assert listed == there


def leaves(tree):
    """Pairs of the title and the page in a nested `nav`."""
    for entry in tree:
        for title, below in entry.items():
            yield from [(title, below)] if isinstance(below, str) else leaves(below)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_the_reference(name, capsys, monkeypatch):
    monkeypatch.setattr(shutil, "get_terminal_size", lambda *_: os.terminal_size((300, 100)))
    with pytest.raises(SystemExit):
        parse_options([name, "--help"], COMMANDS)
    told = set(re.findall(r"│ (--[\w.-]+)", capsys.readouterr().out))
    page = script("generate").commands_text(COMMANDS)
    own = re.search(rf"^## jexplore {name}\n(.*?)(?=^## )", page, re.S | re.M)[1]
    link = r"\[`--(\w+)\.\*`\]\(#options-of-\1\)"
    parts = re.findall(link, own)
    for part in parts:  # options of rules lead to others
        section = re.search(rf"^## Options of {part}\n.*?(?=^## |\Z)", page, re.S | re.M)[0]
        own += section
        parts += re.findall(link, section)
    assert set(re.findall(r"^\| `(--[\w.-]+)", own, re.M)) == told
    assert told or name == "strategies"


def test_files_and_columns_are_explained():
    page = text_of("docs/reference/files.md")
    names = [name for name in (*OUR_FILES, *COLUMNS) if not re.match(r"robot-[1-9]", name)]
    assert [name for name in names if f"`{name}`" not in page] == []


def test_the_citation_is_of_this_version():
    page = yaml.safe_load(text_of("CITATION.cff"))
    assert page["version"] == jx.__version__
    assert {"cff-version", "message", "title", "authors"} <= page.keys()


def test_every_picture_is_drawn_by_the_script_and_shown():
    images = ROOT / "docs" / "images"
    there = {path.relative_to(images).as_posix() for path in images.rglob("*") if path.is_file()}
    drawn = {picture for one in script("pictures").DRAWN.values() for picture in one.files}
    shown = {name for page in PAGES for name in re.findall(r"\]\([./\w]*images/([\w./-]+)\)", text_of(page))}
    assert there == drawn == shown
    assert sum((images / name).stat().st_size for name in there) < 1_500_000  # the repository carries them


@pytest.mark.slow
def test_the_picture_of_the_worlds_is_not_stale(tmp_path):
    """The cheapest of them; `python docs/pictures.py --check` draws all."""
    pictures = script("pictures")
    for picture, path in pictures.draw("worlds", tmp_path).items():
        assert pictures.difference(pictures.IMAGES / picture, path) is None, "run `python docs/pictures.py worlds`"
