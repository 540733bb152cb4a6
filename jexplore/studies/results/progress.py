"""Progress bars of functions."""

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterator
from typing import Any


@contextlib.contextmanager
def progress_bar(
    progress: bool | None, total: int, unit: str, on_progress: Callable[[int], object] | None = None
) -> Iterator[Callable[[int], object] | None]:
    """Provide the function that work calls with the number of finished things; it moves a bar, if requested.

    Without `progress` there is a bar in a notebook, unless there is an `on_progress`, which is called with the same
    numbers.
    """
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    in_notebook = shell is not None and "IPKernelApp" in shell.config
    if not (in_notebook and on_progress is None if progress is None else progress):
        yield on_progress
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of tqdm: that without ipywidgets the bar is text
        from tqdm.auto import tqdm
    form = "{l_bar}{bar}| {n_fmt}/{total_fmt}{unit} [{elapsed}<{remaining}, {rate_noinv_fmt}]"
    look: dict[str, Any] = {"bar_format": form, "dynamic_ncols": True, "leave": False}
    with tqdm(total=total, desc="compiling", unit=f" {unit}", **look) as bar:

        def moved(done):
            bar.set_description_str(None, refresh=False)
            bar.update(done - bar.n)
            if on_progress is not None:
                on_progress(done)

        yield moved
