"""Every notebook runs from its first cell to its last, in an empty folder, with the installed package only."""

import os
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))
SMALL = os.environ.get("JEXPLORE_SMALL", "0") not in ("", "0")


def test_they_are_there():
    assert [path.name[:2] for path in NOTEBOOKS] == [f"0{i}" for i in range(1, 8)]
    assert sum(path.stat().st_size for path in NOTEBOOKS) < 1_000_000


@pytest.mark.skipif(not SMALL, reason="minutes: JEXPLORE_SMALL=1 runs them, at their small size")
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path):
    nbclient = pytest.importorskip("nbclient", reason="needs nbclient: pip install 'jexplore[notebooks]'")
    nbformat = pytest.importorskip("nbformat", reason="needs nbformat: pip install 'jexplore[notebooks]'")
    page = nbformat.read(path, as_version=4)
    assert page.metadata.kernelspec.name == "python3"
    nbclient.NotebookClient(page, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in page.cells if cell.cell_type == "code" for output in cell.outputs]
    assert outputs
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []
    assert any("image/png" in output.get("data", {}) for output in outputs)
