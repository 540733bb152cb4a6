"""Pictures, tables, files. All that draws is imported below this package, which finds matplotlib a folder first."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path


def _find_folder():
    """Give matplotlib a folder for this process if there is no home: its import would fail or warn."""
    try:
        Path.home()
    except RuntimeError:
        if not os.environ.get("MPLCONFIGDIR"):
            os.environ["MPLCONFIGDIR"] = tempfile.mkdtemp(prefix="matplotlib-")
            atexit.register(shutil.rmtree, os.environ["MPLCONFIGDIR"], ignore_errors=True)


_find_folder()
