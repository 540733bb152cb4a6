"""Names and files that stand for nothing: refused before jax is imported."""

import subprocess
import sys

import pytest

from jexplore.cli import main, names
from jexplore.config import InputError
from jexplore.policies import MODIFIERS, STRATEGIES, parameters_of
from jexplore.policies.catalogue.entries import SYNONYMS
from jexplore.worlds import GENERATORS, generator_parameters

OURS = [name for name, entry in STRATEGIES.items() if not entry.is_own]


def test_what_is_read_off_the_source_is_what_is_there():
    tables = names.catalogue()
    assert list(tables["STRATEGIES"]) == OURS
    assert tables["MODIFIERS"] == MODIFIERS
    assert tables["SYNONYMS"] == SYNONYMS
    assert set(SYNONYMS.values()) <= set(OURS)
    assert not set(SYNONYMS) & set(OURS)


@pytest.mark.parametrize("name", OURS)
def test_parameters_of_a_strategy_are_read_off_its_source(name):
    read, real = names.catalogue()["STRATEGIES"][name], parameters_of(name)
    assert list(read) == list(real)
    for key, value in read.items():
        assert value is names.UNREAD or value == real[key]


@pytest.mark.parametrize("name", GENERATORS)
def test_parameters_of_a_generator_are_read_off_its_source(name):
    module, _, function = GENERATORS[name].partition(":")
    read = {key: value for key, value in names.signature(module, function).items() if key not in ("seed", "cell_m")}
    real = generator_parameters(name)
    assert list(read) == list(real)
    for key, value in read.items():
        assert value is names.UNREAD or value == real[key]


def test_a_default_that_is_no_plain_value_is_not_guessed():
    (parameter,) = [p for p in names.signature("jexplore.policies.room_wise", "segmented").items() if p[0] == "ratio"]
    assert parameter == ("ratio", names.UNREAD)


REFUSED = [
    (["compare", "--strategies", "nearest"], "unknown strategy 'nearest'; did you mean 'closest'?"),
    (["compare", "--strategies", "Next_Best_View"], "did you mean 'decision-theoretic'?"),
    (["compare", "--strategies", "closets"], "did you mean 'closest'?"),
    (["compare", "--strategies", "closest,random"], "strategies are given with spaces between, closest random"),
    (["compare", "--worlds", "cave, office#2"], "worlds are given with spaces between, cave office#2"),
    (["explore", "--world", "cave,office"], "'cave,office' is no name but several: world must be one of them"),
    (["compare", "--worlds", "cave:widht_m=3"], "there is no parameter 'widht_m'"),
    (["compare", "--worlds", "nope.png@0.1"], "'nope.png': there is no such file (looked in "),
    (["bound", "caev"], "did you mean 'cave'?"),
    (["bench", "--strategies", "closest+rechek"], "did you mean 'recheck'?"),
    (["train", "--validation", "caev"], "did you mean 'cave'?"),
    (["train", "--model", "nope.msgpack"], "there is no such file"),
    (["explore", "--strategy", "utility:betta=1"], "unknown parameter of 'utility': 'betta'; did you mean 'beta'?"),
    (["explore", "--strategy", "utility:beta=x"], "expected a number for beta in 'utility:beta=x', got 'x'"),
    (["explore", "--strategy", "no_such_module:f"], "no module 'no_such_module', neither installed nor in "),
    (["segment", "nope"], "there is no world 'nope'"),
    (["route", "--map", "nope.json", "--to", "3"], "there is no such file"),
    (["trace", "--robot", "kamuy"], "robot must be one of kamui, wheeled, got 'kamuy'"),
    (["merge", "nope"], "there is no such file"),
    (["sweep", "nope.yaml"], "'nope.yaml': there is no such file"),
    (["sweep", "spec.yaml"], "there is no world 'kave'"),
]


@pytest.fixture
def spec(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spec.yaml").write_text("worlds: [cave, kave]\nstrategies: [closest]\n")


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=lambda case: " ".join(case)[:40])
def test_names_are_refused_in_one_line(arguments, message, spec, capsys, monkeypatch):
    monkeypatch.setattr(main.COMMANDS[arguments[0]], "execute", lambda *_: pytest.fail("it began"))
    assert main.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert message in said


def test_refusing_loads_no_jax(spec):
    program = f"""
import sys
from jexplore.cli import main
for arguments in {[arguments for arguments, _ in REFUSED]!r}:
    assert main.main(arguments) == 2, arguments
    assert "jax" not in sys.modules, arguments
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-500:]


def test_ray_that_is_not_there_is_told_first(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(names.importlib.util, "find_spec", lambda name: None)
    (tmp_path / "spec.yaml").write_text("worlds: [cave]\n")
    assert main.main(["sweep", str(tmp_path / "spec.yaml"), "--engine", "ray", "--out", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err == "jexplore: error: the engine ray needs Ray: pip install 'jexplore[ray]'\n"
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "name",
    [
        "closest",
        "closest+recheck+segment=voronoi:ratio=0.5",
        "utility:beta=2",
        "learned:path=x",
        "json:loads",
        "random",
    ],
)
def test_what_may_be_right_is_let_through(name):
    names.check_strategy(name)


def test_a_registered_name_is_known(monkeypatch):
    monkeypatch.setitem(STRATEGIES, "mine", STRATEGIES["closest"]._replace(is_own=True))
    names.check_strategy("mine+recheck:anything=1")
    with pytest.raises(InputError, match="'mein'; did you mean 'mine'"):
        names.check_strategy("mein")


def test_a_name_that_tables_cannot_hold_is_refused():
    for check in (names.check_world, names.check_strategy):
        with pytest.raises(InputError, match="must be UTF-8"):
            check("caf\udce9.png@0.1")


def test_a_value_too_many_is_told_with_its_option(capsys):
    assert main.main(["explore", "--world", "cave", "office"]) == 2
    assert capsys.readouterr().err == "jexplore: error: unexpected 'office': --world takes fewer values\n"
