"""The package's own names: loaded when first used, and nothing heavy before."""

import ast
import enum
import inspect
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import jexplore

HEAVY = ("jax", "numpy", "scipy", "pandas", "matplotlib", "flax", "PIL", "tqdm")


def loaded_after(code):
    """Return the heavy packages that a fresh interpreter holds after some code."""
    tail = f"\nimport sys\nprint(*(name for name in {HEAVY} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code + tail], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1].split()


@pytest.mark.parametrize(
    "code",
    [
        "import jexplore; jexplore.__version__; dir(jexplore); jexplore.Lidar; jexplore.GENERATORS",
        "from jexplore.cli.main import main; assert main(['--help']) == 0",
        "from jexplore.cli.main import main; assert main(['compare', '--help']) == 0",
        "from jexplore.cli.main import main; assert main(['reproduce', '--help']) == 0",
        "from jexplore.cli.main import main; assert main(['compare', '--episodes', 'x']) == 2",
    ],
)
def test_nothing_heavy_is_loaded(code):
    assert loaded_after(code) == []


def test_the_probe_sees_what_is_loaded():
    assert "numpy" in loaded_after("import jexplore; jexplore.World")


def test_every_name_exists_and_is_told():
    assert {*jexplore.__all__, *jexplore._OF_EXTRAS} == {*jexplore._MODULE_OF, "__version__"}
    for name in jexplore._MODULE_OF:
        if name not in jexplore._OF_EXTRAS:
            assert getattr(jexplore, name) is not None
        assert name in dir(jexplore)
    assert callable(jexplore.compare)
    with pytest.raises(AttributeError, match="no attribute 'compair'"):
        jexplore.compair  # noqa: B018


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
    for name in jexplore.__all__:
        value = getattr(jexplore, name)
        if callable(value) and not (isinstance(value, type) and issubclass(value, (Exception, enum.Enum))):
            yield name, value


def test_an_unknown_keyword_argument_is_told_with_the_nearest():
    checked = 0
    for name, value in public():
        parameters = inspect.signature(value).parameters.values()
        if parameters and not any(p.kind is p.VAR_KEYWORD for p in parameters):
            with pytest.raises(jexplore.InputError, match=f"unknown argument of {name}: 'wrongly_named'"):
                value(wrongly_named=1)
            last = [p.name for p in parameters][-1]
            with pytest.raises(jexplore.InputError, match=f"{last}_'; did you mean '{last}'"):
                value(**{f"{last}_": 1})
            checked += 1
    assert checked > 50


@pytest.mark.parametrize(
    ("call", "hint"),
    [
        (lambda: jexplore.compare("cave", "closest", n_episodes=3), "did you mean 'episodes'"),
        (lambda: jexplore.Lidar(range=4), "did you mean 'range_m'"),
        (lambda: jexplore.Rules().replace(clearance=4), "did you mean 'clearance_m'"),
        (lambda: jexplore.compare("cave", "closest", range_m=4), "did you mean lidar={'range_m': ...}"),
        (lambda: jexplore.explore("cave", "closest", clearance=4), "did you mean rules={'clearance_m': ...}"),
        (lambda: jexplore.Environment("cave", sigma=4), "did you mean lidar={'sigma_m': ...}"),
        (lambda: jexplore.sweep({"worlds": "cave", "lidar": {"rang_m": 4}}), "did you mean 'range_m'"),
        (lambda: jexplore.compare("cave", "closest", lidar={"range_mm": 4}), "did you mean 'range_m'"),
        (lambda: jexplore.trace("course", run=3), "unknown argument of trace: 'run'; did you mean 'runs'"),
        (lambda: jexplore.drift("course", sed=3), "did you mean 'seed'"),
        (lambda: jexplore.trace("course", tuning={"vote": 3}), "unknown field of tuning: 'vote'; did you mean 'votes'"),
        (lambda: jexplore.drift("course", noise={"slipp": 3}), "unknown field of noise: 'slipp'; did you mean 'slip'"),
        (
            lambda: jexplore.segment_maps("rooms", ratios=1),
            "unknown argument of segment_maps: 'ratios'; did you mean 'ratio'",
        ),
        (lambda: jexplore.Lidar(fov=90), "did you mean 'fov_deg'"),
        (lambda: jexplore.World([[False]], resolution=1), r"resolution' \(there are"),
    ],
)
def test_the_nearest_name_is_the_one_that_was_meant(call, hint):
    with pytest.raises(jexplore.InputError, match=hint) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_signatures_and_pickles_are_those_of_the_functions():
    assert list(inspect.signature(jexplore.compare).parameters)[:2] == ["worlds", "strategies"]
    assert pickle.loads(pickle.dumps(jexplore.compare)) is jexplore.compare
    assert jexplore.Lidar(range_m=4).replace(n_beams=7) == jexplore.Lidar(range_m=4, n_beams=7)


def test_no_name_hides_a_module():
    modules = {path.stem for path in Path(jexplore.__file__).parent.glob("*")}
    assert modules.isdisjoint(jexplore._MODULE_OF)


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(jexplore.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If) and isinstance(node.test, ast.Name)]
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    seen = {
        alias.name: node.module.removeprefix("jexplore.")
        for node in imports
        for alias in node.names
        if not alias.asname
    }
    assert seen == jexplore._MODULE_OF


def test_the_packages_names_are_listed():
    worlds, strategies = jexplore.worlds(), jexplore.strategies()
    assert worlds.head[0] == "world"
    assert strategies.head[0] == "strategy"
    assert {row[0].split(",")[0] for row in worlds} >= {*jexplore.GENERATORS, "map.yaml"}
    assert {row[0] for row in strategies} >= {"closest", "random"}
    for found in (worlds, strategies):
        assert len(found.to_pandas()) == len(found) == len(list(found))
        assert all(row[0].split(",")[0] in repr(found) for row in found)
        assert max(map(len, repr(found).splitlines())) <= 120
        assert found._repr_html_().count("<tr>") == 1 + len(found)
