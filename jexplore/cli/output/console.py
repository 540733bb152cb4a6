"""Common code of the commands: lines and bars on stderr, and their output folder."""

import contextlib
import datetime
import io
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from jexplore.arrays.files import first_line
from jexplore.cli.output.terminal import show_table
from jexplore.config import InputError

if TYPE_CHECKING:
    from jexplore.engine.runner import Costs
    from jexplore.report.folders import RunFolder
    from jexplore.report.ledger import Ledger

COMPILING = "jexplore: making programs ready (what is compiled is kept for later runs)"
under_way: "list[Out]" = []
"""Outputs being written by this process."""
MAX_MESSAGE_CHARS = 400  # a name or a file may be quoted in it
PATIENCE_S = 2.0  # work that lasts longer shows how far it is
SILENCE_S = 30.0  # between two lines of a log
INTERRUPTED = 130  # exit status of a run that was ended by Ctrl-C


def say(line: str, status: int) -> int:
    """Print a line on stderr, cut short, and return the exit status."""
    tell(line if len(line) <= MAX_MESSAGE_CHARS else line[: MAX_MESSAGE_CHARS - 3] + "...")
    return status


def _bar(total, done, unit):
    from tqdm import tqdm

    class Lines(tqdm):
        def display(self, msg=None, pos=None):
            if msg is None:  # else there is a bar to be cleared
                tell(f"jexplore: {self}")

    form = "{n_fmt}/{total_fmt}{unit} [{elapsed}<{remaining}, {rate_noinv_fmt}]"
    how: dict[str, Any] = {"total": total, "initial": done, "unit": f" {unit}", "delay": PATIENCE_S, "leave": False}
    if sys.stderr is not None and sys.stderr.isatty():
        return tqdm(**how, bar_format="{l_bar}{bar}| " + form, mininterval=0.5, dynamic_ncols=True)
    return Lines(**how, bar_format="{l_bar} " + form, mininterval=SILENCE_S, miniters=1, file=io.StringIO())


def tell(line: str) -> None:
    """Print a line on stderr."""
    if sys.stderr is not None:
        print(line, file=sys.stderr, flush=True)


@contextlib.contextmanager
def progress_of(total: int, unit: str) -> Iterator[Callable[[int], None]]:
    """Show progress, speed and remaining time on stderr: a bar on a terminal, elsewhere a line at times.

    The block gets the function to call with the number of finished things.
    """
    bars = []

    def update(done):
        if not bars:  # the clock starts when work does, not when compiling does
            bars.append(_bar(total, done, unit))
        bars[0].update(done - bars[0].n)

    try:
        yield update
    finally:
        for bar in bars:
            bar.close()


@contextlib.contextmanager
def note_if_slow(text: str) -> Iterator[Callable[[], None]]:
    """Name a slow step on stderr, once, if it takes long; the block gets a function that cancels the note."""
    timer = threading.Timer(PATIENCE_S, lambda: tell(text))
    timer.daemon = True
    timer.start()
    try:
        yield timer.cancel
    finally:
        timer.cancel()


@contextlib.contextmanager
def working(total: int, unit: str, note: str = COMPILING) -> Iterator[Callable[[int], None]]:
    """Show progress of work: a note until its first part is done, then a bar. The block gets the function to call."""
    with progress_of(total, unit) as update, note_if_slow(note) as call_off:

        def on_progress(done):
            call_off()
            update(done)

        yield on_progress


class Out:
    """Output folder of a command, claimed from beginning to end. A context manager."""

    run: "RunFolder"
    ledger: "Ledger | None" = None
    asked: dict[str, Any] | None = None
    units = wanted = 0
    was_finished = False
    """True once the folder is known to hold the whole run."""

    def __init__(self, options: Any, arguments: Sequence[str], command: str = "") -> None:
        """Check the options of the folder; `command` is the first of the arguments, unless it is given."""
        self.given = None if options.out is None else os.path.expanduser(options.out)
        if self.given is not None and self.given.startswith("~"):
            raise InputError(f"--out {self.given}: there is no such home folder; give the whole path")
        self.overwrite, self.resume = options.overwrite, getattr(options, "resume", False)
        self.trust = getattr(options, "trust", False)
        self.options, self.arguments, self.command = options, arguments, command or arguments[0]
        if self.resume and self.overwrite:
            raise InputError("--resume goes on with a run and --overwrite replaces it: give one of them")
        if self.resume and self.given is None:
            raise InputError("--resume goes on with the run in a folder: name it with --out DIR")
        if self.trust and not self.resume:
            raise InputError("--trust says how to go on with a run: give --resume as well")

    def __enter__(self) -> "Out":
        from jexplore.report import folders

        self.began = time.perf_counter()
        self.now = datetime.datetime.now(datetime.UTC)
        if self.given is None:
            claim = folders.claimed_new(self.command, self.now)
        else:
            claim = folders.claimed(self.given, overwrite=self.overwrite, resume=self.resume)
        self._stack = contextlib.ExitStack()
        self.run = self._stack.enter_context(claim)
        under_way.append(self)
        return self

    def __exit__(self, *error: Any) -> None:
        under_way.remove(self)
        self._stack.close()
        if error[0] is not None:
            self.say_kept(is_interrupted=error[0] is KeyboardInterrupt)

    def say_kept(self, *, is_interrupted: bool = True) -> None:
        """Tell how to continue a run that was ended, or after an interruption that nothing is stored."""
        done = {} if self.ledger is None else self.ledger.done
        if done and self.run.unfinished.exists():
            kept = f"{len(done)} of {self.wanted} units are kept"
            tell(f"jexplore: {kept}; --out {self.run.path} --resume goes on with them")
        elif is_interrupted and self.wanted and not done:
            tell("jexplore: no unit of work was finished: nothing is kept to go on with")

    def keep(
        self, asked: Mapping[str, Any], units: int | Callable[[int], int], shard: tuple[int, int] | None = None
    ) -> "Ledger | None":
        """Open the ledger of the run, as `ledger.open_ledger` does; None if the run is finished.

        Of the units those of a shard are made here, by default all.
        """
        from jexplore.report.ledger import open_ledger

        self.asked = {"command": self.command, **asked}
        self.ledger = open_ledger(self.run, self.asked, units, resume=self.resume, trust=self.trust)
        self.was_finished = self.ledger is None
        if self.ledger is not None:
            self.units = self.ledger.units
            self.wanted = self.units if shard is None else len(range(shard[0], self.units, shard[1]))
        return self.ledger

    def record(self, *, worlds: Sequence[Any] = (), costs: "Costs | None" = None, **found: Any) -> dict[str, Any]:
        """Return the content of run.json: with `World`s described, and with the costs of runs."""
        from jexplore.report import store
        from jexplore.studies.results import provenance

        wall_s = time.perf_counter() - self.began
        if costs is not None:
            found |= {"compile_s": costs.compile_s, "run_s": costs.run_s, **provenance.engine_of(costs)}
        if worlds:
            described = [world if isinstance(world, dict) else provenance.describe_world(world) for world in worlds]
            found |= {"worlds": described}
        return {
            "command": ["jexplore", *self.arguments],
            "started": self.now,
            **found,
            "wall_s": wall_s,
            "configuration": self.options,
            "environment": {**store.environment(), "commit": provenance.package_commit()},
        } | ({} if self.asked is None else {"asked": self.asked, "units": self.units})

    def finish(
        self, record: Mapping[str, Any], files: Mapping[str, Any], text: str,
        pictures: Mapping[str, Any] = MappingProxyType({}), *, interrupted: bool = False,
    ) -> int:  # fmt: skip
        """Write the files and run.json, all or none; print the text and add the pictures; return the exit status.

        Of a run that was finished before, only pictures that it lacks are written.

        Files and pictures are name -> content, see `folders.write_content`. A reader of the output who goes away costs
        neither results nor pictures.
        """
        if self.was_finished:
            pictures = {name: own for name, own in pictures.items() if not (self.run.path / name).is_file()}
        else:
            files = {**files, "run.json": record}
            self.run.write(files, is_finished=not interrupted)
        try:
            if text:
                show_table(text)
            sys.stdout.flush()
        finally:
            drawn = self.draw(pictures)
        if self.was_finished:
            what = f"drew {', '.join(drawn)}" if drawn else "nothing was left to do"
            print(f"{self.run.path}{os.sep} holds all of it: {what}")
            return 0
        print(f"wrote {', '.join([*files, *drawn])} to {self.run.path}{os.sep}")
        if interrupted:
            self.say_kept()
            return say("jexplore: interrupted, what was finished was written", INTERRUPTED)
        return 0

    def draw(self, pictures: Mapping[str, Any]) -> list[str]:
        """Add pictures to the output; return the names of those written.

        A failing one costs a warning; an interruption skips the rest.
        """
        drawn = []
        for name, content in pictures.items():
            try:
                self.run.add(name, content)
                drawn.append(name)
            except KeyboardInterrupt:
                print(f"warning: interrupted, {name} was left out", file=sys.stderr)
                break
            except Exception as error:
                print(f"warning: {name} could not be drawn: {first_line(error)}", file=sys.stderr)
        return drawn
