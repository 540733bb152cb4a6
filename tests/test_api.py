"""The package's own names: loaded when first used, and nothing heavy before."""

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

import jexplore

HEAVY = ("jax", "numpy", "scipy", "pandas", "matplotlib", "flax", "PIL", "tqdm")


def loaded_after(code):
    """Which heavy packages a fresh interpreter holds after some code."""
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
    assert set(jexplore.__all__) == {*jexplore._MODULE_OF, "__version__"}
    for name in jexplore.__all__:
        if name in ("GymEnv", "GymVectorEnv") and importlib.util.find_spec("gymnasium") is None:  # an extra
            with pytest.raises(ImportError, match=r"pip install 'jexplore\[gym\]'"):
                getattr(jexplore, name)
        else:
            assert getattr(jexplore, name) is not None
        assert name in dir(jexplore)
    assert callable(jexplore.compare)
    with pytest.raises(AttributeError, match="no attribute 'compair'"):
        jexplore.compair  # noqa: B018


def test_no_name_hides_a_module():
    modules = {path.stem for path in Path(jexplore.__file__).parent.glob("*")}
    assert modules.isdisjoint(jexplore._MODULE_OF)


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(jexplore.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If) and isinstance(node.test, ast.Name)]
    seen = {alias.name: node.module.removeprefix("jexplore.") for node in block.body for alias in node.names}
    assert seen == jexplore._MODULE_OF
