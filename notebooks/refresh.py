"""Runs the notebooks and writes what they show back into them: `python notebooks/refresh.py [NAME ...]`.

Needs `pip install 'jexplore[notebooks]'`. Of what running leaves behind, only the outputs are kept: no times, no
versions.
"""

import base64
import io
import os
import sys
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

from jexplore.arrays.pictures import written

HERE = Path(__file__).resolve().parent
TIMEOUT_S = 300  # of a cell
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def executed(path: Path, folder: str | os.PathLike[str], **variables: str) -> nbformat.NotebookNode:
    """Run a notebook in another folder, as one without the repository would.

    Args:
      path: the notebook.
      folder: where it runs.
      **variables: of its environment, besides those of this process.
    """
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=TIMEOUT_S,
        kernel_name=KERNEL["name"],
        resources={"metadata": {"path": os.fspath(folder)}},
        record_timing=False,
        coalesce_streams=True,
    )
    quiet = {"TQDM_DISABLE": "1"}  # a bar that has ended is nothing to keep
    return client.execute(env={**os.environ, **quiet, **variables})


def stripped(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Strip a notebook to cells, outputs and the name of its kernel; its pictures small files."""
    notebook.metadata = nbformat.from_dict({"kernelspec": KERNEL, "language_info": {"name": "python"}})
    for number, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{number:02}", nbformat.from_dict({})
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", ()):
                picture = Image.open(io.BytesIO(base64.b64decode(output.data["image/png"])))
                output.data["image/png"] = base64.b64encode(written(picture)).decode("ascii")
    return notebook


def main(names: list[str]) -> None:
    """Run the notebooks whose names contain one of these; by default all."""
    for path in sorted(HERE.glob("*.ipynb")):
        if names and not any(name in path.name for name in names):
            continue
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            notebook = stripped(executed(path, folder))
        nbformat.write(notebook, path)
        print(f"{path.name}: {time.perf_counter() - began:.0f} s, {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
