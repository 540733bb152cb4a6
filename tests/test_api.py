"""The package's own names: loaded when first used, and nothing heavy before."""

import ast
import enum
import inspect
import operator
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from ref.refusals import refused

import jexplore
from jexplore import btm
from jexplore.worlds import GENERATORS

HEAVY = ("jax", "numpy", "scipy", "pandas", "matplotlib", "flax", "PIL", "tqdm")


def loaded_after(code):
    """Return the heavy packages that a fresh interpreter holds after some code."""
    tail = f"\nimport sys\nprint(*(name for name in {HEAVY} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code + tail], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1].split()


def test_nothing_heavy_is_loaded():
    begin = "import jexplore; jexplore.__version__; dir(jexplore); jexplore.Lidar; jexplore.load_world\n"
    begin += (
        "from jexplore.cli.main import main; assert main(['--help']) == 0; assert main(['compare', '--help']) == 0\n"
    )
    begin += "assert main(['reproduce', '--help']) == 0; assert main(['compare', '--episodes', 'x']) == 2"
    assert loaded_after(begin) == []


@pytest.mark.slow
def test_the_probe_sees_what_is_loaded():
    assert "numpy" in loaded_after("import jexplore; jexplore.World")


def test_every_name_exists_and_is_told():
    assert len(dir(jexplore)) == len({*dir(jexplore)}) <= 46
    assert {*dir(jexplore)} - {*jexplore.__all__} == {*jexplore._LAZY.extras} == {"GymEnv", "GymVectorEnv"}
    for module, names in ((jexplore, jexplore.__all__), (btm, dir(btm))):
        for name in names:
            assert getattr(module, name) is not None
            assert not name.startswith("_") or name == "__version__"
    assert callable(jexplore.compare)
    assert callable(btm.trace)
    assert callable(btm.add_node)
    with pytest.raises(AttributeError, match=r"'jexplore\.btm' has no attribute 'traec'"):
        btm.traec  # noqa: B018
    with pytest.raises(AttributeError, match="no attribute 'compair'"):
        jexplore.compair  # noqa: B018


@pytest.mark.slow
@pytest.mark.parametrize("gymnasium", ["None", "types.ModuleType('gymnasium')"])
def test_a_missing_or_old_extra_costs_only_its_own_names(gymnasium):
    """Once without the package, and once with a version that lacks a needed part."""
    code = f"""
import inspect, pydoc, sys, types
sys.modules["gymnasium"] = {gymnasium}
import jexplore as jx
from jexplore import *
assert compare is jx.compare and "GymEnv" not in globals()
assert not hasattr(jx, "GymEnv") and not hasattr(jx, "GymVectorEnv")
assert "compare" in dict(inspect.getmembers(jx)) and "compare" in pydoc.render_doc(jx)
try:
    jx.GymEnv
except AttributeError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "'GymEnv'" in done.stdout
    assert "pip install 'jexplore[gym]'" in done.stdout


def public():
    """Functions of the package, and ways to make objects of its classes."""
    for name in [*jexplore.__all__, *(f"btm.{name}" for name in btm._LAZY.module_of)]:
        value = operator.attrgetter(name)(jexplore)
        name = name.removeprefix("btm.")
        if callable(value) and not (isinstance(value, type) and issubclass(value, (Exception, enum.Enum))):
            yield name, value


def test_an_unknown_keyword_argument_is_told_with_the_nearest():
    checked = 0
    for name, value in public():
        parameters = inspect.signature(value).parameters.values()
        if parameters and not any(p.kind is p.VAR_KEYWORD for p in parameters):
            refused(f"unknown argument of {name}: 'wrongly_named'", value, wrongly_named=1)
            last = [p.name for p in parameters][-1]
            refused(f"{last}_'; did you mean '{last}'", value, **{f"{last}_": 1})
            checked += 1
    assert checked > 50


@pytest.mark.parametrize(
    ("call", "hint"),
    [
        (lambda: jexplore.compare("cave", "closest", n_episodes=3), "did you mean 'episodes'"),
        (lambda: jexplore.Lidar(range=4), "did you mean 'range_m'"),
        (lambda: jexplore.Rules().replace(clearance=4), "did you mean 'clearance_m'"),
        (lambda: jexplore.compare("cave", "closest", range_m=4), "did you mean lidar={'range_m': ...}"),
        (lambda: jexplore.sweep({"worlds": "cave", "lidar": {"rang_m": 4}}), "did you mean 'range_m'"),
        (lambda: jexplore.btm.trace("course", run=3), "unknown argument of trace: 'run'; did you mean 'runs'"),
        (lambda: jexplore.btm.trace("course", tuning={"vote": 3}), "unknown field of tuning: 'vote'; did you"),
        (lambda: jexplore.World([[False]], resolution=1), r"resolution' \(there are"),
    ],
)
def test_the_nearest_name_is_the_one_that_was_meant(call, hint):
    refused(hint, call)


def test_signatures_and_pickles_are_those_of_the_functions():
    assert list(inspect.signature(jexplore.compare).parameters)[:2] == ["worlds", "strategies"]
    assert pickle.loads(pickle.dumps(jexplore.compare)) is jexplore.compare
    assert jexplore.Lidar(range_m=4).replace(n_beams=7) == jexplore.Lidar(range_m=4, n_beams=7)


def test_no_name_hides_a_module():
    modules = {path.stem for path in Path(jexplore.__file__).parent.glob("*")}
    assert modules & {*dir(jexplore)} == {"btm", "worlds"}  # which are these modules


@pytest.mark.parametrize("stub", ["__init__.pyi", "btm_names.pyi"])
def test_a_stub_has_each_name_once_and_in_the_form_that_is_read(stub):
    """Types: `known_types` of .ci/run."""
    text = (Path(jexplore.__file__).parent / stub).read_text(encoding="utf-8")
    names = [alias for node in ast.parse(text).body for alias in node.names]  # type: ignore[attr-defined]
    assert all(alias.name == alias.asname for alias in names)
    assert len(names) == len({alias.name for alias in names}) == text.count("\nfrom jexplore")
    lazy = jexplore._LAZY if stub == "__init__.pyi" else btm._LAZY
    assert list(lazy.module_of) == [alias.name for alias in names]


def test_no_public_function_hides_its_options():
    for name, value in public():
        kinds = [p.kind for p in inspect.signature(value).parameters.values()]
        assert inspect.Parameter.VAR_KEYWORD not in kinds or name in ("strategy",), name  # a strategy's own parameters


def test_the_packages_names_are_listed():
    worlds, strategies = jexplore.worlds(), jexplore.strategies()
    assert worlds.head[0] == "world"
    assert strategies.head[0] == "strategy"
    assert {row[0].split(",")[0] for row in worlds} >= {*GENERATORS, "map.yaml"}
    assert {row[0] for row in strategies} >= {"closest", "random"}
    for found in (worlds, strategies):
        assert len(found.to_pandas()) == len(found) == len(list(found))
        assert all(row[0].split(",")[0] in repr(found) for row in found)
        assert max(map(len, repr(found).splitlines())) <= 120
        assert found._repr_html_().count("<tr>") == 1 + len(found)
