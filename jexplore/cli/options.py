"""What the options of commands have in common, and their parsing: every mistake becomes one line."""

import contextlib
import difflib
import io
import os
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import tyro

from jexplore.config import InputError

SMALL = "JEXPLORE_SMALL"
"""Environment variable: set to anything but 0, the default comparison is a small one."""


def is_small() -> bool:
    return os.environ.get(SMALL, "0") not in ("", "0")


STRATEGIES = ("closest", "closest+recheck", "random")
"""What `jexplore compare` compares by default."""


def default_worlds() -> tuple[str, ...]:
    return ("cave", "maze") if is_small() else ("cave", "office", "hospital")


Numbers = Annotated[tuple[int, ...] | None, tyro.conf.arg(metavar="N [N ...]", help_behavior_hint="")]
Number = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]
OwnNames = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]", help_behavior_hint="")]
OneWorld = Annotated[str, tyro.conf.arg(metavar="WORLD")]
OneStrategy = Annotated[str, tyro.conf.arg(metavar="STRATEGY")]
OutFolder = Annotated[
    str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: runs/<UTC time>-<command>)")
]
EngineName = Literal["auto", "serial", "lockstep"]


def help_text(commands: Mapping[str, type]) -> str:
    """What `jexplore --help` prints. `commands`: name -> class of its options."""
    lines = ["usage: jexplore {" + ",".join(commands) + "} [options]", ""]
    lines += ["A laboratory for mobile-robot exploration.", "", "commands:"]
    lines += [f"  {name:<12}{(command.__doc__ or '').splitlines()[0]}" for name, command in commands.items()]
    lines += ["", "options:", "  -h, --help  show this, or the options of a command: jexplore compare --help"]
    return "\n".join([*lines, "  --version   show the version", ""])


def parse(arguments: Sequence[str], commands: Mapping[str, type]) -> Any:
    """The record of a command and its options.

    Args:
      arguments: list of text, the command first.
      commands: name -> class of its options.

    Returns:
      A record of one of these classes.

    Raises:
      InputError: an unknown command or option, a value of the wrong kind or out of bounds.
      SystemExit: with status 0, once help has been printed.
    """
    name, *rest = arguments
    if name not in commands:
        near = difflib.get_close_matches(name, commands, n=1, cutoff=0.5)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        what = "expected a command first" if name.startswith("-") else "unknown command"
        raise InputError(f"{what}: {name!r}; there are {', '.join(commands)}{hint}")

    def read():
        return tyro.cli(commands[name], prog=f"jexplore {name}", args=rest, config=(tyro.conf.FlagCreatePairsOff,))

    said = _Page()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            return read()
    except SystemExit as end:
        if end.code:
            raise InputError(one_line(said.getvalue()) or f"wrong options for {name}") from None
    return read()  # help was asked for: once more, now in the terminal's width and colours


class _Page(io.StringIO):
    """Takes what tyro prints, for which it looks like a file: no colours, and the frames that `one_line` knows."""

    encoding = "utf-8"


_REWORDED = (
    (r"^Error parsing [\w.-]*(lidar|rules|tuning|noise): ", ""),
    (r"^Error parsing (\S+): invalid literal for int\(\).*?: (.*)$", r"\1 must be an integer, got \2"),
    (r"^Error parsing (\S+): could not convert string to float: (.*)$", r"\1 must be a number, got \2"),
    (
        r"^Error parsing (\S+): no type matching \{None\}\|INT .*? from \[(.*?)\]\. .*$",
        r"\1 must be an integer, got \2",
    ),
    (
        r"^Error parsing (\S+): no type matching \{None\}\|\{\[INT .*? from (\[.*?\])\. .*$",
        r"\1 must be integers, got \2",
    ),
    (
        r"^Error parsing (\S+): no type matching \{None\}\|\{FLOAT FLOAT FLOAT\} .*? from (\[.*?\])\. .*$",
        r"\1 must be three numbers, got \2",
    ),
    (r"^Error parsing ", ""),
    (r"^invalid choice (.*) for argument '(.*)'\. Expected one of \((.*)\) ?\.$", r"\2 must be one of \3, got \1"),
    (r"^Missing value for argument '(.*)'\..*$", r"\1 needs a value"),
    (r"^Unrecognized options: (\S+?)(, .*)?$", r"unknown option \1"),
)
"""tyro's words, and ours where they are plainer."""


def one_line(box: str) -> str:
    """What tyro's box of several lines says, as one line."""
    rows = [row.strip("│ ").strip() for row in box.splitlines() if row.strip() and row.strip()[0] not in "╭╰"]
    parts = [[]]
    for row in rows:
        parts[-1].append(row) if set(row) != {"─"} else parts.append([])
    text = " ".join(" ".join(parts[0]).split())
    for pattern, better in _REWORDED:
        text = re.sub(pattern, better, text)
    meant = re.search(r"Perhaps you meant:\s+(--[\w.-]+)", " ".join(row for part in parts[1:] for row in part))
    return text + (f"; did you mean {meant[1]}?" if meant else "")
