"""The notebooks: committed files are small, clean and shown; and, with nbclient, every one runs.

Running them needs `pip install '.[notebooks]'`; without it these tests are skipped.
"""

import ast
import base64
import json
import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
PATHS = sorted(FOLDER.glob("*.ipynb"))
NAMES = (
    "first_episode",
    "inside_the_kernels",
    "own_strategy",
    "compare",
    "rooms",
    "traces",
    "sweep",
    "learned",
    "maps_shared",
    "drift",
    "teams",
)
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}
MOST_BYTES = 150_000  # of a notebook
each = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)


def outputs(notebook):
    """All outputs of its cells."""
    return [output for cell in notebook["cells"] for output in cell.get("outputs", ())]


def faults(notebook):
    """Return forbidden outputs of a notebook: errors, and text on the error stream."""
    for output in outputs(notebook):
        if output["output_type"] == "error":
            yield f"{output['ename']}: {output['evalue']}"
        elif output.get("name") == "stderr":
            yield "".join(output["text"])


def pictures(notebook):
    """The PNG files that a notebook shows."""
    found = (output.get("data", {}).get("image/png") for output in outputs(notebook))
    return [base64.b64decode("".join(text)) for text in found if text]


def test_they_are_all_there():
    assert [path.stem for path in PATHS] == [f"{i:02}_{name}" for i, name in enumerate(NAMES, 1)]
    assert sum(path.stat().st_size for path in PATHS) < 1_000_000


@each
def test_what_is_committed(path):
    assert path.stat().st_size < MOST_BYTES
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert notebook["metadata"] == {"kernelspec": KERNEL, "language_info": {"name": "python"}}
    assert all(cell["metadata"] == {} for cell in notebook["cells"])
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))  # run once, from top to bottom
    assert list(faults(notebook)) == []
    assert len(pictures(notebook)) >= 2
    assert all(png.startswith(b"\x89PNG") for png in pictures(notebook))
    assert "".join(notebook["cells"][0]["source"]).startswith("# ")


@each
def test_they_need_only_what_is_installed_with_the_package(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    lines = "".join("".join(cell["source"]) + "\n" for cell in cells if cell["cell_type"] == "code").splitlines()
    code = "\n".join(line for line in lines if not line.startswith("%"))
    roots = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            roots |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            roots.add(str(node.module).split(".")[0])
    assert roots <= {"os", "jax", "jexplore", "matplotlib", "numpy", "pandas"}


@pytest.mark.slow
@each
def test_it_runs(path, tmp_path):
    """At the small size, in an empty folder, as it stands: no error, nothing on the error stream, pictures shown."""
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    tool = runpy.run_path(str(FOLDER / "refresh.py"))
    inline = "module://matplotlib_inline.backend_inline"
    notebook = tool["stripped"](tool["executed"](path, tmp_path, JEXPLORE_SMALL="1", MPLBACKEND=inline))
    assert list(faults(notebook)) == []
    assert len(pictures(notebook)) == len(pictures(json.loads(path.read_text(encoding="utf-8"))))
    assert list(tmp_path.iterdir()) == []
