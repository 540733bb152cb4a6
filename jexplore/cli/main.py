"""The command line: `jexplore compare`, `explore`, `league`, `bound`, `train`, `tune`, `reproduce`, `segment`, `slam`,
`trace`, `route`, `merge-maps`, `station`, `worlds`, `strategies`, `bench`.

Importing this loads neither jax nor numpy; every command imports its modules when it runs. Wrong input ends with one
line and status 2 and leaves no files, an interruption with one line and status 130; a comparison or reproduction then
keeps its finished part.
"""

import io
import os
import sys
from collections.abc import Sequence

from jexplore.cli.bench import Bench
from jexplore.cli.bound import Bound
from jexplore.cli.compare import Compare, Reproduce
from jexplore.cli.explore import Explore
from jexplore.cli.listings import LeagueCommand, Strategies, Worlds
from jexplore.cli.options import check_numbers, help_text, parse_options
from jexplore.cli.output.console import INTERRUPTED, say
from jexplore.cli.output.signals import Signals
from jexplore.cli.output.terminal import plain_warnings
from jexplore.cli.segment import Segment
from jexplore.cli.slam import Slam
from jexplore.cli.sweep import Merge, SweepCommand
from jexplore.cli.tracemaps.joining import MergeMaps, Station
from jexplore.cli.tracemaps.route import RouteCommand
from jexplore.cli.tracemaps.trace import Trace
from jexplore.cli.train import Train, Tune
from jexplore.config import InputError, __version__
from jexplore.engine.plugins import keep_compiler_quiet, keep_to_cpu

COMMANDS: dict[str, type] = {
    "compare": Compare,
    "explore": Explore,
    "sweep": SweepCommand,
    "merge": Merge,
    "league": LeagueCommand,
    "bound": Bound,
    "train": Train,
    "tune": Tune,
    "reproduce": Reproduce,
    "segment": Segment,
    "slam": Slam,
    "trace": Trace,
    "route": RouteCommand,
    "merge-maps": MergeMaps,
    "station": Station,
    "worlds": Worlds,
    "strategies": Strategies,
    "bench": Bench,
}
"""Name -> its options: a frozen record whose `execute(arguments)` runs the command. Docstrings are help texts."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command, by default that of this process.

    Returns:
      The exit status: 0; 2 for wrong input; 1 where there is no route, or memory or the reader of the output is
        gone; 130 if interrupted, 143 by SIGTERM, 129 by SIGHUP.
    """
    own, signals = argv is None, Signals()
    try:
        return _run(list(sys.argv[1:] if argv is None else argv), signals, own)
    finally:
        signals.end()


def _run(arguments, signals, own):
    """Run a command; `own`: as that of this process, not of a program that calls it."""
    ended_by = signals.ended_by
    keep_to_cpu()
    keep_compiler_quiet()
    if sys.stdout is None:  # closed by the shell
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    if own and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    try:
        with plain_warnings():
            status = _dispatch(arguments, signals if own else None)
        return ended_by[-1] + 128 if status == INTERRUPTED else status
    except InputError as error:
        return say(f"jexplore: error: {' '.join(str(error).split())}", 2)
    except KeyboardInterrupt:
        status = say("jexplore: interrupted, no results were written", ended_by[-1] + 128)
        if own:
            os._exit(status)  # at once: a program that is being compiled cannot be stopped in another way
        return status
    except (MemoryError, RuntimeError) as error:  # XLA's is a RuntimeError
        if isinstance(error, RuntimeError) and "RESOURCE_EXHAUSTED" not in str(error):
            raise
        return say("jexplore: error: out of memory; use a larger --cell-m, fewer episodes or fewer --lanes", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter complains when it ends
        return 1
    except OSError as error:  # files are checked below: this is the standard output
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return say(f"jexplore: error: cannot write the output: {error.strerror or error}", 1)


def _dispatch(arguments, signals):
    if not arguments:
        raise InputError(f"expected a command: {', '.join(COMMANDS)}; see jexplore --help")
    if arguments[0] in ("-h", "--help"):
        print(help_text(COMMANDS), end="")
    elif arguments[0] == "--version":
        print(f"jexplore {__version__}")
    else:
        try:
            options = parse_options(arguments, COMMANDS)
        except SystemExit:  # help has been printed
            return 0
        if signals is not None:
            signals.listen()
        check_numbers(options)
        status = options.execute(arguments) or 0
        sys.stdout.flush()
        return status
    sys.stdout.flush()
    return 0
