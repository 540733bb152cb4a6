"""What the commands have in common: lines and bars on stderr, and the folder that they write."""

import contextlib
import datetime
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

COMPILING = "jexplore: compiling (kept for later runs)"
LONGEST = 400  # characters of a message; a name or a file may be quoted in it
PATIENCE_S = 2.0  # work that lasts longer shows how far it is


def say(line: str, status: int) -> int:
    print(line if len(line) <= LONGEST else line[: LONGEST - 3] + "...", file=sys.stderr, flush=True)
    return status


class Progress:
    """A bar on stderr once work has lasted two seconds: how much is done, how fast it goes, how long it will take."""

    total: int
    unit: str
    bar: Any

    def __init__(self, total: int, unit: str) -> None:
        self.total, self.unit, self.bar = total, unit, None

    def update(self, done: int) -> None:
        from tqdm import tqdm

        if self.bar is None:  # the clock starts when work does, not when compiling does
            self.bar = tqdm(
                total=self.total,
                initial=done,
                unit=f" {self.unit}",
                bar_format="{l_bar}{bar}| {n_fmt}/{total_fmt}{unit} [{elapsed}<{remaining}, {rate_noinv_fmt}]",
                delay=PATIENCE_S,
                mininterval=0.5,
                leave=False,
                dynamic_ncols=True,
            )
        self.bar.update(done - self.bar.n)

    def step(self, n: int = 1) -> None:
        self.update(n + (0 if self.bar is None else self.bar.n))

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()


@contextlib.contextmanager
def progress_of(total: int, unit: str) -> Iterator[Progress]:
    progress = Progress(total, unit)
    try:
        yield progress
    finally:
        progress.close()


@contextlib.contextmanager
def note(text: str) -> Iterator[Callable[[], None]]:
    """Says on stderr what takes so long, once, if it takes long; the block gets a function that calls it off."""
    timer = threading.Timer(PATIENCE_S, lambda: print(text, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield timer.cancel
    finally:
        timer.cancel()


@contextlib.contextmanager
def working(total: int, unit: str) -> Iterator[Callable[[int], None]]:
    """Progress of compiled work: a note while it compiles, then a bar. The block gets the function to call."""
    with progress_of(total, unit) as progress, note(COMPILING) as call_off:

        def on_progress(done):
            call_off()
            progress.update(done)

        yield on_progress


class Out:
    """Where a command writes. Refused before anything is computed, written when everything is."""

    given: str | None
    overwrite: bool
    command: str
    began: float
    now: datetime.datetime

    def __init__(self, options: Any, command: str) -> None:
        from jexplore.report import folders

        self.given = None if options.out is None else os.path.expanduser(options.out)
        self.overwrite, self.command = options.overwrite, command
        self.began = time.perf_counter()
        self.now = datetime.datetime.now(datetime.UTC)
        folders.check_out(next(self._defaults()) if self.given is None else self.given, self.overwrite)

    def _defaults(self):
        from jexplore.report import folders

        return folders.default_outs(self.command, self.now)

    def record(self, arguments: Sequence[str], options: Any, **found: Any) -> dict[str, Any]:
        """What run.json holds."""
        from jexplore.report import store

        wall_s = time.perf_counter() - self.began
        return {
            "command": ["jexplore", *arguments],
            "started": self.now,
            **found,
            "wall_s": wall_s,
            "configuration": options,
            "environment": store.environment(),
        }

    def write(self, writers: Mapping[str, Callable[[Path], Any]]) -> str:
        """Writes the files, all or none. Returns a line that says where; said last, so that a reader of the output who
        goes away costs no results.
        """
        from jexplore.report import folders

        if self.given is None:
            folder = folders.write_new_run(self._defaults(), writers)
        else:
            folder = folders.write_run(self.given, writers, self.overwrite)
        return f"wrote {', '.join(writers)} to {os.fspath(folder)}{os.sep}"
