"""Common options of commands, and their parsing: every mistake becomes one line."""

import ast
import codecs
import collections
import contextlib
import dataclasses
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
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from jexplore.config import NUMBER_BOUNDS, InputError, require_engine, require_setting, unknown
from jexplore.rules import Lidar, Robot, Rules

SMALL = "JEXPLORE_SMALL"
"""Environment variable: set to anything but 0, the default comparison is a small one."""


def is_small() -> bool:
    return os.environ.get(SMALL, "0") not in ("", "0")


DEFAULT_STRATEGIES = ("closest", "closest+recheck", "random")
"""Default strategies of `jexplore compare`."""


def default_worlds() -> tuple[str, ...]:
    return ("cave", "maze") if is_small() else ("cave", "office", "hospital")


@dataclasses.dataclass(frozen=True)
class OutOptions:
    """Options of commands that write a folder."""

    out: str | None = None
    """Write into this folder; by default runs/<UTC time>-<command>."""
    overwrite: bool = False
    """Replace the run that the folder holds."""


@dataclasses.dataclass(frozen=True)
class ReportOptions(OutOptions):
    """Options of commands that write a page."""

    report: bool = dataclasses.field(default=True, metadata={"off": "Leave out report.html."})
    """Write report.html, the whole run in one page with replays."""


@dataclasses.dataclass(frozen=True)
class ResumeOptions(OutOptions):
    """Options of commands that can be continued."""

    resume: bool = False
    """Continue the run in the folder, if any: finished parts are not computed again. A comparison or sweep with a
    larger number of episodes keeps the earlier ones."""


@dataclasses.dataclass(frozen=True)
class TrustOptions(OutOptions):
    """Options of commands that use parts of earlier runs."""

    trust: bool = False
    """Take your own strategies and metrics for the same as in the parts that are there, even where nothing tells."""


@dataclasses.dataclass(frozen=True)
class WorkerOptions:
    """Options of commands that compute on many cores."""

    workers: int | None = None
    """Compute on this number of cores; by default on all that this process may use."""


@dataclasses.dataclass(frozen=True)
class EngineOptions(WorkerOptions):
    """Options of commands that run many episodes, or runs of a trace."""

    engine: Literal["auto", "jax"] = "auto"
    """Run episodes in native code where possible, on a GPU or a CPU, and in JAX for the rest (auto), or in JAX alone,
    on a GPU if available (jax). The results are equal. Trace runs are always in JAX: on a CPU (auto), or on a GPU if
    available (jax), and equal but for rounding."""
    lanes: int | None = None
    """With --engine jax on a GPU, run this number of episodes at a time; by default as many as its memory holds."""


@dataclasses.dataclass(frozen=True)
class CellOptions:
    """Options of commands that make worlds."""

    cell_m: float = 0.1
    """Make the edge of a cell this long, in metres."""


@dataclasses.dataclass(frozen=True)
class RobotOptions(CellOptions):
    """Options of the scanner and the rules."""

    lidar: Lidar = dataclasses.field(default_factory=Lidar)
    rules: Rules = dataclasses.field(default_factory=Rules)


@dataclasses.dataclass(frozen=True)
class TimedOptions(RobotOptions):
    """Options of the scanner, the rules and the robot's motions."""

    robot: Robot = dataclasses.field(default_factory=Robot)


@dataclasses.dataclass(frozen=True)
class SceneOptions(TimedOptions):
    """Options of where episodes happen, and of teams."""

    start: str = "random"
    """Start where the seed says (random), at the world's own start (world), in a cell (12,30,90: row, column, heading
    in degrees) or at a point of the map's frame in metres (2.0m,1.5m,90: x, y, yaw in degrees; 1.57rad: in radians)."""
    within: str | None = None
    """Have robots stay within a polygon, corners x,y in metres of the map's frame ('0,0 5,0 5,4'). Beams pass its
    edge; what lies outside is not to be explored."""
    from_map: str | None = None
    """Go on from a partial map of the same cells, such as explored.yaml of `jexplore explore`: what it shows is known
    from the beginning, and drawn starts lie where it shows free floor."""
    contact: str = "all"
    """Whom a robot hears: all, none, those within a distance (range:4, in metres) or in sight (line-of-sight, or within
    a distance line-of-sight:4), and whom they hear; with ,delay=10 a link must have held for ten steps, with ,loss=0.2
    it fails a fifth of the time."""
    team_starts: tuple[str, ...] = ("together",)
    """Start all robots next to the first (together), far from each other (apart), or in these cells (12,30,90 12,31,90:
    row, column, heading in degrees)."""
    members: tuple[str, ...] = ()
    """Give the robots different paces and scanners: a text for each robot of the largest team, such as pace=2 (a step
    takes twice the time), range=3 (its scanner reaches 3 m) or pace=2,range=3."""


def fields_in_order(kind: type) -> list[Any]:
    """Return the fields of a record as they are shown: its own, then those of its bases."""
    names = dict.fromkeys(name for one in kind.__mro__ for name in vars(one).get("__annotations__", {}))
    known: dict[str, Any] = {field.name: field for field in dataclasses.fields(kind)}
    return [known[name] for name in names if name in known]


def fields_of(options: Any, names: str) -> dict[str, Any]:
    """Return some fields of a record by name, for a function whose arguments are called the same."""
    return {name: getattr(options, name) for name in names.split()}


def given_of(options: Any, names: Sequence[str]) -> list[str]:
    """Return those of some fields of a record that are not at their defaults, as options of the command line."""
    plain = type(options)()
    return [f"--{name.replace('_', '-')}" for name in names if getattr(options, name) != getattr(plain, name)]


def help_text(commands: Mapping[str, type]) -> str:
    """Return the text of `jexplore --help`. `commands`: name -> class of its options."""
    lines = ["usage: jexplore {" + ",".join(commands) + "} [options]", ""]
    lines += ["A laboratory for mobile-robot exploration.", "", "commands:"]
    lines += [f"  {name:<12}{(command.__doc__ or '').splitlines()[0]}" for name, command in commands.items()]
    lines += ["", "options:", "  -h, --help  Show this, or the options of a command: jexplore compare --help."]
    return "\n".join([*lines, "  --version   Show the version.", ""])


EXAMPLES: dict[str, tuple[str, ...]] = {
    "compare": ("compare --worlds cave#3 office --strategies closest random --episodes 40",),
    "explore": ("explore --world map.yaml --start 2.0m,1.5m,90 --lidar.range-m 4",),
    "sweep": ("sweep spec.yaml --out runs/sweep", "sweep spec.yaml --out runs/sweep --shard 1/4"),
    "merge": ("merge runs/sweep-1 runs/sweep-2 --out runs/sweep",),
    "league": ("league", "league submit runs/mine"),
    "bound": ("bound cave#3 --starts 10 --seconds 30",),
    "train": ("train --out runs/model",),
    "tune": ("tune --strategies utility+recheck tour+recheck --out runs/tuned",),
    "reproduce": ("reproduce holz2010 --maps maps --episodes 50",),
    "segment": ("segment plan.png@0.05 --truth rooms.png",),
    "slam": ("slam robot.log.gz --out runs/slam",),
    "trace": ("trace --world course --robot kamui --out runs/trace",),
    "route": ("route --map runs/trace/btm.json --robot wheeled --from 4 --to 8",),
    "merge-maps": ("merge-maps a.json b.json --out global.json",),
    "station": ("station a.json b.json --out page.html",),
    "worlds": ("worlds", "worlds map.yaml cave#3 --geometry"),
    "strategies": ("strategies",),
    "bench": ("bench --quick",),
}
"""Command -> command lines that its help shows, without the program's name."""


def parse_options(arguments: Sequence[str], commands: Mapping[str, type]) -> Any:
    """Parse the command line into a command's record and its options.

    Raises:
      SystemExit: with status 0, once help has been printed.
    """
    name, *rest = arguments
    if name.startswith("-"):
        raise InputError(f"expected a command first, got {name!r} (there are: {', '.join(commands)})")
    if name not in commands:
        raise unknown("command", name, commands)
    page, said = _Page(), _Page()
    page.encoding = codecs.lookup(sys.stdout.encoding or "utf-8").name  # some say UTF-8, which tyro does not know
    page.coloured = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    how: Any = {"config": (tyro.conf.FlagCreatePairsOff,), "registry": _REGISTRY}
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(page):
            options = tyro.cli(commands[name], prog=f"jexplore {name}", args=rest, **how)
    except SystemExit as end:
        if end.code:
            raise InputError(one_line(said.getvalue() or page.getvalue())) from None
        width = shutil.get_terminal_size().columns
        for line in page.getvalue().splitlines():
            is_paragraph = len(line) > width and line[0].isalpha()  # all else has been folded
            print(textwrap.fill(line, width) if is_paragraph else line)
        print("\n".join(["examples:", *(f"  jexplore {line}" for line in EXAMPLES[name])]))
        raise
    _require_once(rest, commands[name])
    return options


def check_numbers(options: Any) -> None:
    """Refuse numbers out of bounds, and lanes that the engine has no use for, before anything heavy is imported."""
    if hasattr(options, "lanes"):
        require_engine(options.engine, options.lanes)
    for name, given in vars(options).items():
        if name in NUMBER_BOUNDS and given is not None:
            for one in given if isinstance(given, tuple) else (given,):
                require_setting(name, one)


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


@_REGISTRY.primitive_rule
def _numbers(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read an integer or another number; the message of a wrong one says which."""
    if info.type not in (int, float):
        return None

    def number(texts):
        try:
            return info.type(texts[0])
        except ValueError:
            kind = "an integer" if info.type is int else "a number"
            raise ValueError(f"must be {kind}, got {texts[0]!r}") from None

    def is_number(value):
        return isinstance(value, (int, info.type)) and not isinstance(value, bool)

    return PrimitiveConstructorSpec(1, info.type.__name__.upper(), number, is_number, lambda value: [str(value)])


@_REGISTRY.primitive_rule
def _optional(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read a type that may be None as the type: None cannot be given."""
    kinds = typing.get_args(info.type)
    if len(kinds) != 2 or kinds[1] is not types.NoneType:
        return None
    inner: Any = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(kinds[0], info.markers))
    return dataclasses.replace(
        inner,
        is_instance=lambda value: value is None or inner.is_instance(value),
        str_from_instance=lambda value: ["None"] if value is None else inner.str_from_instance(value),
    )


@_REGISTRY.struct_rule
def _records(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Convert a record to options: its docstrings as running text, and no empty defaults."""
    if not dataclasses.is_dataclass(info.type):
        return None
    kind: Any = info.type
    hints, texts, fields = _hints(kind), field_texts(kind), []
    for field in fields_in_order(kind):
        default = field.default
        if dataclasses.is_dataclass(field.default_factory):
            default = tyro.MISSING_NONPROP
        elif field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        text = field.metadata.get("off") if default is True else None
        how: Any = {"prefix_name": False} if field.metadata.get("short") else {}
        if metavar := metavar_of(field.name, hints[field.name]):
            how["metavar"] = metavar
        fields.append(
            StructFieldSpec(
                name=field.name,
                type=_with(hints[field.name], tyro.conf.arg(help_behavior_hint=_default_text, **how)),
                default=default,
                helptext=text or texts.get(field.name),
            )
        )
    return StructConstructorSpec(instantiate=kind, fields=tuple(fields))


def metavar_of(name: str, hint: Any) -> str | None:
    """Return what stands for the value of an option in its help: its own name for texts, None for one number."""
    kinds = str(typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint)
    word = name.strip("_").upper() if "str" in kinds else "N"
    return f"{word} [{word} ...]" if "..." in kinds else word if "str" in kinds else None


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
    texts = {}
    records: list[Any] = [one for one in reversed(kind.__mro__) if dataclasses.is_dataclass(one)]
    for one in records:
        body = ast.parse(textwrap.dedent(inspect.getsource(one))).body[0]
        assert isinstance(body, ast.ClassDef)
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


def one_line(box: str) -> str:
    """Convert tyro's box of several lines to one line: its message, and the first option that it guesses."""
    rows = [row.strip("│ ").strip() for row in box.splitlines() if row.strip("╭╰│ ")]
    message = itertools.takewhile(lambda row: set(row) != {"─"}, (row for row in rows if row[0] not in "╭╰"))
    text = " ".join(" ".join(message).split())
    text = re.sub(r"^Error parsing ([^-]\S*: )?", "", text)  # a record's own error names the field
    meant = re.search(r"Perhaps you meant:\s+(--[\w.-]+)", " ".join(rows))
    return text[0].lower() + text[1:].removesuffix(".") + (f"; did you mean {meant[1]}?" if meant else "")
