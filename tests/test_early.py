"""Names, files and numbers that cannot be: refused before jax is imported."""

import subprocess
import sys

import pytest

from jexplore.cli import main, names
from jexplore.config import InputError
from jexplore.learn.settings import TRAINER_SETTINGS
from jexplore.learn.training import TRAINERS
from jexplore.policies import MODIFIERS, STRATEGIES
from jexplore.policies.catalogue.entries import SYNONYMS, parameters
from jexplore.policies.learned import networks
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
    read, real = names.catalogue()["STRATEGIES"][name], parameters(STRATEGIES[name].make)
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


@pytest.mark.parametrize("name", GENERATORS)
def test_defaults_of_a_generator_are_let_through(name):
    names.check_world(name)


def test_networks_and_bounds_of_training_are_those_that_are_there():
    assert names.keys_of("jexplore.policies.learned.networks", "NETWORKS") == tuple(networks.NETWORKS)
    assert list(TRAINERS) == list(TRAINER_SETTINGS)


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
    (["sweep", "cells.yaml"], "cell_m must be a number at least 0.001"),
    (["sweep", "twice.yaml"], "worlds must differ, got 'cave' more than once"),
    (["compare", "--workers", "99999999"], "workers must be an integer from 1 to 1024"),
    (["compare", "--metric"], "--metric must name at least one, got none"),
    (["compare", "--metric", "mine"], "metric 'mine' must be module:function, got 'mine'"),
    (["compare", "--metric", "steps=mine:f"], "metric 'mine:f': its name must be new, and 'steps' is in the tables"),
    (["compare", "--metric", "2=mine:f"], "its name must be an identifier such as map_error, got '2'"),
    (["compare", "--metric", "no_such_module:f"], "no module 'no_such_module', neither installed nor in "),
    (["compare", "--metric", "json:loads", "loads=json:dumps"], "metrics must differ, got 'loads' more than once"),
    (["compare", "--metric", "json:loads,json:dumps"], "no name but several: metrics are given with spaces between"),
    (["sweep", "metrics.yaml"], "metric 'a': 3 is no metric: expected a function or module:function"),
    (["compare", "--episodes", "0"], "episodes must be an integer from 1 to 1000000, got 0"),
    (["compare", "--cell-m", "0"], "cell_m must be a number at least 0.001"),
    (["compare", "--start", "1,2"], "start must be random, world, cells such as 12,30,90"),
    (["compare", "--within", "0,0"], "within must be three or more corners"),
    (["compare", "--worlds", "cave", "cave"], "worlds must differ, got 'cave' more than once"),
    (["compare", "--strategies", "random", "random"], "strategies must differ, got 'random' more than once"),
    (["compare", "--worlds", "cave:width_m=abc"], "width_m must be a number, got 'abc'"),
    (["compare", "--worlds", "map.png@0.1:free=abc"], "free must be a number at least 0 and at most 255, got 'abc'"),
    (["compare", "--worlds", "map.yaml:free_max=100"], "free_max must be an integer from 0 to 99, got 100"),
    (["compare", "--worlds", "map.png"], "a picture needs a scale"),
    (["compare", "--worlds", "map.yaml@0.1"], "has its own scale"),
    (["compare", "--worlds", "map.png@0.1:inside=3"], "inside must be true or false, got 3"),
    (["compare", "--worlds", "scans.log:range_m=-1"], "range_m must be a number above 0"),
    (["compare", "--engine", "serial"], "invalid choice 'serial' for argument '--engine'"),
    (["reproduce", "holz2010", "--engine", "native"], "invalid choice 'native' for argument '--engine'"),
    (["trace", "--engine", "lockstep"], "invalid choice 'lockstep' for argument '--engine'"),
    (["sweep", "spec.yaml", "--engine", "serial"], "invalid choice 'serial' for argument '--engine'"),
    (["bench", "--engine", "auto", "lockstep"], "engine must be one of auto, jax, got 'lockstep'"),
    (["compare", "--lanes", "4"], "lanes are for the engine jax, got 4 for auto"),
    (["compare", "--lanes", "0"], "lanes must be an integer from 1"),
    (["compare", "--bounds", "--bound-seconds", "0"], "bound_seconds must be a number"),
    (["explore", "--frames", "0"], "frames must be an integer from 1 to 10000, got 0"),
    (["explore", "--episode", "-1"], "episode must be an integer from 0"),
    (["explore", "--within", "a,b 1,1 2,0"], "within must be three or more corners"),
    (["bench", "--sides", "64", "8"], "sides must be an integer from 32 to 2048, got 8"),
    (["bench", "--repeat", "0"], "repeat must be an integer from 1"),
    (["train", "--rounds", "0"], "rounds must be an integer from 1"),
    (["compare", "--worlds", "cave:free=5"], "cave: free must be a number at least 0.5 and at most 0.9, got 5"),
    (
        ["explore", "--world", "rooms:width_m=-1"],
        "rooms: width_m must be a number at least 5",
    ),
    (["bound", "maze:width_m=9000"], "'maze': 150 x 90000 cells are more than 4096 a side"),
    (
        ["compare", "--worlds", "cave", "--cell-m", "0.5"],
        "cave: cell_m must be a number at least 0.001",
    ),
    (
        ["segment", "office:furniture=1", "--cell-m", "0.25"],
        "office: furniture needs a cell_m of at most 0.2",
    ),
    (["trace", "--world", "course:repeat=1"], "course: repeat must be from 2 to 10, or 0 for none, got 1"),
    (["trace", "--world", "course:obstacle=ramp"], "course: obstacle must be one of slope, stairs"),
    (["sweep", "large.yaml"], "hospital: furniture needs a cell_m of at most 0.2, got 0.25"),
    (["train", "--algo", "sgd"], "unknown algorithm 'sgd' (there are: es, ppo)"),
    (
        ["train", "--network", "linaer"],
        "unknown network 'linaer'; did you mean 'linear'?",
    ),
    (["train", "--set", "pears=8"], "unknown setting of 'es': 'pears'; did you mean 'pairs'?"),
    (["train", "--set", "pairs=0"], "pairs must be an integer from 1 to 10000, got 0"),
    (["train", "--set", "pairs"], "expected NAME=NUMBER once in --set, got 'pairs'"),
    (["train", "--algo", "ppo", "--set", "gae=2"], "gae must be a number at least 0 and at most 1, got 2"),
    (["train", "--rounds", "12"], "rounds must be a multiple of check_every, 5, got 12"),
    (["train", "--worlds", "cave", "--validation", "cave"], "'cave' is in both the training and the validation worlds"),
    (["trace", "--runs", "0"], "runs must be an integer from 1"),
    (["trace", "--start", "nan", "1", "2"], "start x must be a number"),
    (["trace", "--sweep", "votes=1.5"], "votes must be integers"),
    (["trace", "--attribute", "victim"], "attribute must be NAME=VALUE@X,Y"),
    (["trace", "--tuning.votes", "99"], "tuning.votes must be an integer from 1 to 9, got 99"),
    (["trace", "--robot", "kamui:widht_m=1"], "there is no 'widht_m'"),
]


@pytest.fixture
def spec(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spec.yaml").write_text("worlds: [cave, kave]\nstrategies: [closest]\n")
    (tmp_path / "cells.yaml").write_text("worlds: [cave]\ncell_m: [0.1, 0]\n")
    (tmp_path / "large.yaml").write_text("worlds: ['hospital:furniture=0.5']\ncell_m: [0.1, 0.25]\n")
    (tmp_path / "metrics.yaml").write_text("worlds: [cave]\nmetrics: {a: 3}\n")
    (tmp_path / "twice.yaml").write_text("worlds: [cave, cave]\n")


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
