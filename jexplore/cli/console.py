"""What the commands have in common: lines and bars on stderr, and the folder that they write."""

import contextlib
import datetime
import os
import sys
import threading
import time

COMPILING = "jexplore: compiling (kept for later runs)"
LONGEST = 400  # characters of a message; a name or a file may be quoted in it
PATIENCE_S = 2.0  # work that lasts longer shows how far it is


def say(line, status):
    print(line if len(line) <= LONGEST else line[: LONGEST - 3] + "...", file=sys.stderr, flush=True)
    return status


class Progress:
    """A bar on stderr once work has lasted two seconds: how much is done, how fast it goes, how long it will take."""

    def __init__(self, total, unit):
        self.total, self.unit, self.bar = total, unit, None

    def update(self, done):
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

    def step(self, n=1):
        self.update(n + (0 if self.bar is None else self.bar.n))

    def close(self):
        if self.bar is not None:
            self.bar.close()


@contextlib.contextmanager
def progress_of(total, unit):
    progress = Progress(total, unit)
    try:
        yield progress
    finally:
        progress.close()


@contextlib.contextmanager
def note(text):
    """Says on stderr what takes so long, once, if it takes long; the block gets a function that calls it off."""
    timer = threading.Timer(PATIENCE_S, lambda: print(text, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield timer.cancel
    finally:
        timer.cancel()


@contextlib.contextmanager
def working(total, unit):
    """Progress of compiled work: a note while it compiles, then a bar. The block gets the function to call."""
    with progress_of(total, unit) as progress, note(COMPILING) as call_off:

        def on_progress(done):
            call_off()
            progress.update(done)

        yield on_progress


class Out:
    """Where a command writes. Refused before anything is computed, written when everything is."""

    def __init__(self, options, command):
        from jexplore.report import store

        self.given = None if options.out is None else os.path.expanduser(options.out)
        self.overwrite, self.command = options.overwrite, command
        self.began = time.perf_counter()
        self.now = datetime.datetime.now(datetime.UTC)
        store.check_out(self._folder(), self.overwrite)

    def _folder(self):
        from jexplore.report import store

        # A default name is looked for again when writing: another run may have taken it since.
        return store.default_out(self.command, self.now) if self.given is None else self.given

    def record(self, arguments, options, **found):
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

    def write(self, writers):
        """Writes the files, all or none. Returns a line that says where; said last, so that a reader of the output who
        goes away costs no results.
        """
        from jexplore.report import store

        folder = store.write_run(self._folder(), writers, self.overwrite)
        return f"wrote {', '.join(writers)} to {os.fspath(folder)}{os.sep}"
