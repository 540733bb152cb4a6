"""Common options of commands, and their parsing: every mistake becomes one line."""

import ast
import codecs
import collections
import contextlib
import dataclasses
import difflib
import inspect
import io
import itertools
import os
import re
import shutil
import sys
import textwrap
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import tyro
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from jexplore.config import InputError

SMALL = "JEXPLORE_SMALL"
"""Environment variable: set to anything but 0, the default comparison is a small one."""


def is_small() -> bool:
    return os.environ.get(SMALL, "0") not in ("", "0")


STRATEGIES = ("closest", "closest+recheck", "random")
"""Default strategies of `jexplore compare`."""


def default_worlds() -> tuple[str, ...]:
    return ("cave", "maze") if is_small() else ("cave", "office", "hospital")


Numbers = Annotated[tuple[int, ...] | None, tyro.conf.arg(metavar="N [N ...]", help_behavior_hint="")]
Number = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]
OwnNames = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]", help_behavior_hint="")]
MetricNames = Annotated[
    tuple[str, ...], tyro.conf.arg(metavar="MODULE:FUNCTION [MODULE:FUNCTION ...]", help_behavior_hint="")
]
OneWorld = Annotated[str, tyro.conf.arg(metavar="WORLD")]
OneStrategy = Annotated[str, tyro.conf.arg(metavar="STRATEGY")]
OwnModel = Annotated[str | None, tyro.conf.arg(metavar="MODEL", help_behavior_hint="(default: closest)")]
StartText = Annotated[str, tyro.conf.arg(metavar="START")]
PolygonText = Annotated[str | None, tyro.conf.arg(metavar="CORNERS")]
MapFile = Annotated[str | None, tyro.conf.arg(metavar="MAP.yaml")]
OutFolder = Annotated[
    str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: runs/<UTC time>-<command>)")
]
EngineName = Literal["auto", "jax"]


def help_text(commands: Mapping[str, type]) -> str:
    """Return the text of `jexplore --help`. `commands`: name -> class of its options."""
    lines = ["usage: jexplore {" + ",".join(commands) + "} [options]", ""]
    lines += ["A laboratory for mobile-robot exploration.", "", "commands:"]
    lines += [f"  {name:<12}{(command.__doc__ or '').splitlines()[0]}" for name, command in commands.items()]
    lines += ["", "options:", "  -h, --help  Show this, or the options of a command: jexplore compare --help."]
    lines += ["  --version   Show the version."]
    return "\n".join([*lines, "  --completion  Print what completes commands and options in bash and zsh.", ""])


EXAMPLES: dict[str, tuple[str, ...]] = {
    "compare": ("compare --worlds cave#3 office --strategies closest random --episodes 40",),
    "explore": ("explore --world map.yaml --start 2.0m,1.5m,90 --lidar.range-m 4",),
    "sweep": ("sweep spec.yaml --out runs/sweep", "sweep spec.yaml --out runs/sweep --shard 1/4"),
    "merge": ("merge runs/sweep-1 runs/sweep-2 --out runs/sweep",),
    "bound": ("bound cave#3 --starts 10 --seconds 30",),
    "train": ("train --out runs/model",),
    "reproduce": ("reproduce holz2010 --maps maps --episodes 50",),
    "segment": ("segment plan.png@0.05 --truth rooms.png",),
    "trace": ("trace --world course --robot kamui --out runs/trace",),
    "route": ("route --map runs/trace/btm.json --robot wheeled --from 4 --to 8",),
    "merge-maps": ("merge-maps a.json b.json --out global.json",),
    "station": ("station a.json b.json --out page.html",),
    "worlds": ("worlds", "worlds map.yaml cave#3 --geometry"),
    "strategies": ("strategies",),
    "bench": ("bench --quick",),
}
"""Command -> command lines that its help shows, without the program's name."""


def completion_text(commands: Mapping[str, type]) -> str:
    """Return a script by which bash, and zsh after `bashcompinit`, complete commands, options and files."""
    cases = "\n".join(f'    {name}) words="{" ".join(option_names(kind))}" ;;' for name, kind in commands.items())
    return f"""_jexplore() {{
  local words
  case ${{COMP_WORDS[1]}} in
{cases}
  esac
  [ "$COMP_CWORD" -gt 1 ] || words="{" ".join(commands)} --help --version --completion"
  COMPREPLY=($(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}"))
}}
complete -o default -F _jexplore jexplore
"""


def option_names(kind: type, prefix: str = "--") -> list[str]:
    """Return the options of a command, in order, those of the records in it as `--lidar.range-m`."""
    names = []
    for field in dataclasses.fields(kind):
        name = prefix + field.name.rstrip("_").replace("_", "-")
        own = _hints(kind)[field.name]
        if dataclasses.is_dataclass(own):
            names += option_names(typing.cast(type, own), f"{name}.")
        elif tyro.conf.Positional not in getattr(own, "__metadata__", ()):
            names.append(f"{prefix}no-{field.name.replace('_', '-')}" if field.default is True else name)
    return names


def parse(arguments: Sequence[str], commands: Mapping[str, type]) -> Any:
    """Parse the command line into a command's record and its options.

    Args:
      arguments: list of text, the command first.
      commands: name -> class of its options.

    Returns:
      A record of one of these classes.

    Raises:
      InputError: an unknown command or option, one that is repeated, a value of the wrong kind or out of bounds.
      SystemExit: with status 0, once help has been printed.
    """
    name, *rest = arguments
    if name not in commands:
        near = difflib.get_close_matches(name, commands, n=1, cutoff=0.5)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        what = "expected a command first" if name.startswith("-") else "unknown command"
        raise InputError(f"{what}: {name!r}; there are {', '.join(commands)}{hint}")

    def read():
        return tyro.cli(
            commands[name],
            prog=f"jexplore {name}",
            args=rest,
            config=(tyro.conf.FlagCreatePairsOff,),
            registry=_REGISTRY,
        )

    said = _Page()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            options = read()
    except SystemExit as end:
        if end.code:
            raise InputError(_stray(rest, one_line(said.getvalue())) or f"wrong options for {name}") from None
        _show_help(read)
        print("\n".join(["examples:", *(f"  jexplore {line}" for line in EXAMPLES[name])]))
        raise
    _require_once(rest, commands[name])
    return options


def _stray(arguments, line):
    """Explain an unknown option; name the option before it that does not take the value."""
    word = line.removeprefix("unknown option ").partition(";")[0]
    if word == line or word.startswith("-") or word not in arguments:
        return line
    before = [text for text in arguments[: arguments.index(word)] if text.startswith("--")]
    return f"unexpected {word!r}: {before[-1]} takes fewer values" if before else f"unexpected {word!r}"


def _show_help(read):
    """Print the requested help again, with the colours and the characters of the standard output."""
    page = _Page()
    page.encoding = codecs.lookup(sys.stdout.encoding or "utf-8").name  # some say UTF-8, which tyro does not know
    page.coloured = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    with contextlib.redirect_stdout(page), contextlib.suppress(SystemExit):
        read()
    width = shutil.get_terminal_size().columns
    for line in page.getvalue().splitlines():
        is_paragraph = len(line) > width and line[0].isalpha()  # all else has been folded
        print(textwrap.fill(line, width) if is_paragraph else line)


def _require_once(arguments, command):
    """Refuse an option that is given again: the parser would take the last and drop what came before."""
    options = itertools.takewhile(lambda text: text != "--", arguments)
    given = collections.Counter(text.partition("=")[0].replace("_", "-") for text in options if text[:2] == "--")
    for option, n in given.items():
        if n > 1:
            kind = _hints(command).get(option[2:].replace("-", "_"))
            hint = f"; it takes all its values at once: {option} A B" if ", ..." in str(kind) else ""
            raise InputError(f"{option} is given {'twice' if n == 2 else f'{n} times'}, and can be given once{hint}")


_REGISTRY = ConstructorRegistry()


@_REGISTRY.struct_rule
def _records(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Convert a record to options: its docstrings as running text, and no empty defaults."""
    if not dataclasses.is_dataclass(info.type):
        return None
    kind: Any = info.type
    hints, texts, fields = _hints(kind), field_texts(kind), []
    for field in dataclasses.fields(kind):
        default = field.default
        if dataclasses.is_dataclass(field.default_factory):
            default = tyro.MISSING_NONPROP
        elif field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        hint = hints[field.name]
        kinds = [one for one in typing.get_args(hint) if one is not type(None)]
        metavar = kinds[0].__name__.upper() if isinstance(hint, types.UnionType) and kinds[0] in (int, float) else None
        text = field.metadata.get("off") if default is True else None
        fields.append(
            StructFieldSpec(
                name=field.name,
                type=_with(hint, tyro.conf.arg(metavar=metavar, help_behavior_hint=_default_text)),
                default=default,
                helptext=text or texts.get(field.name),
            )
        )
    return StructConstructorSpec(instantiate=kind, fields=tuple(fields))


def _hints(kind):
    return typing.get_type_hints(kind, include_extras=True)


def _with(hint: Any, settings: Any) -> Any:
    """Add settings for its option to a type, after those that it has already."""
    inner, *own = typing.get_args(hint) if typing.get_origin(hint) is Annotated else (hint,)
    return Annotated[inner, settings, *own]


def _default_text(default):
    return "" if default in ("", "None", "True", "False") else f"(default: {default})"


def field_texts(kind: type) -> dict[str, str]:
    """Return the docstrings below the fields of a record, `{name: text}`, each on one line."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    texts = {}
    for field, below in zip(body.body, body.body[1:]):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                texts[name] = " ".join(text.split())
    return texts


class _Page(io.StringIO):
    """Takes what tyro prints, for which it looks like a file: no colours, and the frames that `one_line` knows."""

    encoding = "utf-8"
    coloured = False

    def isatty(self):
        return self.coloured


_REWORDED = (
    (r"^Error parsing [\w.-]*(lidar|rules|tuning|noise|limits): ", ""),
    (r"^Error parsing (\S+): invalid literal for int\(\).*?: (.*)$", r"\1 must be an integer, got \2"),
    (r"^Error parsing (\S+): could not convert string to float: (.*)$", r"\1 must be a number, got \2"),
    (
        r"^Error parsing (\S+): no type matching \{None\}\|INT .*? from \[(.*?)\]\. .*$",
        r"\1 must be an integer, got \2",
    ),
    (
        r"^Error parsing (\S+): no type matching \{None\}\|FLOAT .*? from \[(.*?)\]\. .*$",
        r"\1 must be a number, got \2",
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
    (
        r"^invalid choice (.*) for argument '(.*)'\. Expected one of \((.*)\) ?\.$",
        lambda found: found[2] + " must be one of " + found[3].replace("'", "") + ", got " + found[1],
    ),
    (r"^Missing value for argument '(.*)'\..*$", r"\1 needs a value"),
    (r"^Unrecognized options: (\S+?)(, .*)?$", r"unknown option \1"),
)
"""tyro's words, and ours where they are plainer."""


def one_line(box: str) -> str:
    """Convert tyro's box of several lines to one line."""
    rows = [row.strip("│ ").strip() for row in box.splitlines() if row.strip() and row.strip()[0] not in "╭╰"]
    parts = [[]]
    for row in rows:
        parts[-1].append(row) if set(row) != {"─"} else parts.append([])
    text = " ".join(" ".join(parts[0]).split())
    for pattern, better in _REWORDED:
        text = re.sub(pattern, better, text)
    meant = re.search(r"Perhaps you meant:\s+(--[\w.-]+)", " ".join(row for part in parts[1:] for row in part))
    return text + (f"; did you mean {meant[1]}?" if meant else "")
