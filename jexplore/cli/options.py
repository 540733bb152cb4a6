"""The command line's options as frozen records, and their parsing: every mistake becomes one line.

The docstrings are the help texts. Importing this loads neither jax nor numpy.
"""

import contextlib
import dataclasses
import difflib
import io
import os
import re
from typing import Annotated, Literal

import tyro

from jexplore.config import InputError, Lidar, Rules
from jexplore.driving.settings import Noise, Tuning

SMALL = "JEXPLORE_SMALL"
"""Environment variable: set to anything but 0, the default comparison is a small one."""


def _is_small():
    return os.environ.get(SMALL, "0") not in ("", "0")


STRATEGIES = ("closest", "closest+recheck", "random")
"""What `jexplore compare` compares by default."""


def default_worlds():
    return ("cave", "maze") if _is_small() else ("cave", "office", "hospital")


def _default_episodes():
    return 5 if _is_small() else 20


def _default_paper_episodes():
    return 5 if _is_small() else 100


_Numbers = Annotated[tuple[int, ...] | None, tyro.conf.arg(metavar="N [N ...]", help_behavior_hint="")]
_Number = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]
_OwnNames = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]", help_behavior_hint="")]
_World = Annotated[str, tyro.conf.arg(metavar="WORLD")]
_Strategy = Annotated[str, tyro.conf.arg(metavar="STRATEGY")]
_Out = Annotated[str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: runs/<UTC time>-<command>)")]


@dataclasses.dataclass(frozen=True)
class Compare:
    """Compare strategies in worlds, all from the same starts.

    Prints a Markdown table and writes episodes.parquet, run.json, compare.png and paths.png.
    """

    worlds: _OwnNames = None
    """Worlds: names of generators such as cave#3, or map files; see `jexplore worlds` (default: cave office
    hospital)."""
    strategies: _OwnNames = None
    """Strategies; the others are compared with the first. See `jexplore strategies` (default: closest closest+recheck
    random)."""
    episodes: int = dataclasses.field(default_factory=_default_episodes)
    """Episodes of each strategy in each world."""
    seed: int = 0
    """Seed of starts and draws."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    start: Literal["random", "world"] = "random"
    """Starts drawn from the seed, or every world's own start for all episodes."""
    league: bool = False
    """Every strategy in 40 worlds of five kinds, unless --worlds and --strategies say otherwise: prints who ranks where
    over all worlds, and what a plan costs, and writes league.png instead of the pictures of single worlds."""
    engine: Literal["auto", "serial", "lockstep"] = "auto"
    """How episodes run: one after the other on each core, or many in lockstep, as suits a GPU. The results are equal.
    By default what suits the machine."""
    lanes: int | None = None
    """Episodes at a time in lockstep; by default as many as the memory holds."""
    out: _Out = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    lidar: Lidar = dataclasses.field(default_factory=Lidar)
    episode: Rules = dataclasses.field(default_factory=Rules)


@dataclasses.dataclass(frozen=True)
class Explore:
    """Run one episode and draw it.

    Writes episode.png, episode.gif (known map, frontiers, target, path) and run.json. It is episode 0 of a comparison
    with the same options.
    """

    world: _World = "cave"
    """World: a generator's name such as cave#3, or a map file; see `jexplore worlds`."""
    strategy: _Strategy = "closest+recheck"
    """Strategy; see `jexplore strategies`."""
    seed: int = 0
    """Seed of the start and the draws."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    start: Annotated[str, tyro.conf.arg(metavar="{random,world,ROW,COL,HEADING_DEG}")] = "random"
    """A start drawn from the seed, the world's own, or a cell and a heading that is a multiple of 45."""
    frames: int = 300
    """Frames of the animation at most, evenly spaced."""
    out: _Out = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    lidar: Lidar = dataclasses.field(default_factory=Lidar)
    episode: Rules = dataclasses.field(default_factory=Rules)


@dataclasses.dataclass(frozen=True)
class Reproduce:
    """Reproduce a paper's tables: its strategies in its environments, beside its own figures.

    Prints a Markdown table an environment, and which of the orderings that the paper claims hold here. Writes
    episodes.parquet, run.json and reproduce.png.
    """

    paper: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[PAPER]")] = "holz2010"
    """The paper: holz2010 (Holz, Basilico, Amigoni, Behnke 2010)."""
    maps: Annotated[str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of the paper's maps: stage/cave_filled.png, avz/avz5floor_open.yaml, stage/hospital_section.png.
    By default built-in counterparts stand in for them."""
    episodes: int = dataclasses.field(default_factory=_default_paper_episodes)
    """Episodes of each strategy in each environment; the first are also reported alone, as many as the paper's runs."""
    seed: int = 0
    """Seed of starts and draws."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    engine: Literal["auto", "serial", "lockstep"] = "auto"
    """How episodes run, as for `jexplore compare`."""
    lanes: int | None = None
    """Episodes at a time in lockstep; by default as many as the memory holds."""
    out: _Out = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    lidar: Lidar = dataclasses.field(default_factory=Lidar)
    episode: Rules = dataclasses.field(default_factory=Rules)


@dataclasses.dataclass(frozen=True)
class Segment:
    """Divide maps into rooms by their Voronoi graph, and score the rooms.

    Prints a Markdown table of scores a variant and writes segments.png, scores.parquet and run.json.
    """

    maps: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="MAP [MAP ...]")] = ()
    """Maps, as for `jexplore worlds`: map.png@0.05 (metres a pixel), map.yaml, or generators such as office#3."""
    truth: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="GT [GT ...]", help_behavior_hint="")] = None
    """Pictures of the maps with doorways closed by lines, in the same order and size; generators know their rooms."""
    variant: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]", help_behavior_hint="")] = (
        *("thrun", "wurm", "holz"),
    )
    """Variants: thrun, wurm, holz (default: all)."""
    partial: bool = False
    """Also segment the maps that an exploring robot has when it first knows 25, 50 and 75 % of what it will know."""
    cell_m: float = 0.05
    """Edge of a cell, metres."""
    prominence_m: float = 0.15
    """How much the clearance must rise on both sides of a critical point, metres; 0: any local minimum."""
    gamma: float = 3.0
    """How far apart two obstacle cells must be to have a Voronoi edge between them, cells."""
    metric: Literal["geodesic", "euclidean"] = "geodesic"
    """What "closest segment" means: along paths, or as the crow flies (the paper's letter)."""
    lines: bool = False
    """Split along the line between the two nearest obstacles (Thrun 1998)."""
    seed: int = 0
    """Seed of the episodes that partial maps come from."""
    out: _Out = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""


@dataclasses.dataclass(frozen=True)
class Trace:
    """Let a robot drive through a building and write its Behavioral Trace Map.

    Prints the node and link tables of run 0 and how many runs made the same map. Writes btm.json, btm.geojson (nav2
    Route Server), btm.graphml, btm.png, runs.parquet and run.json.
    """

    world: _World = "course"
    """A course such as course#3 or course:obstacle=stairs, or any world: see `jexplore worlds`."""
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")] = "kamui"
    """kamui (a crawler) or wheeled; with other measures kamui:width_m=0.6,max_slope_deg=8."""
    runs: int = 1
    """Runs, of every setting if some are swept."""
    noise_m: Annotated[float | None, tyro.conf.arg(metavar="M", help_behavior_hint="")] = None
    """Standard deviation of the scanners' ranges, metres: the same as --noise.range-m."""
    sweep: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUES [...]", help_behavior_hint="")] = ()
    """Thresholds to vary, all in one batch: votes=1,3,5 (a list), circle=1.1:2.0 (a range), noise.range_m=0,0.03.
    Lists make every combination; with a range, --settings draws by Latin hypercube."""
    settings: int = 100
    """Draws of a sweep over ranges."""
    start: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y DEG", help_behavior_hint="")] = None
    """Start in metres and degrees (default: the world's own)."""
    seed: int = 0
    """Seed of the noise."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    max_steps: int = 6000
    """Steps of 0.1 s after which a run ends as STEP_LIMIT."""
    animate: bool = False
    """Also write btm.html: what the operator sees of run 0, one file that replays without a network."""
    from_episode: bool = False
    """Instead of driving so, run an exploration episode and read the map off what it has seen (Voronoi graph)."""
    strategy: _Strategy = "closest+recheck"
    """Of that episode."""
    out: _Out = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    tuning: Tuning = dataclasses.field(default_factory=Tuning)
    noise: Noise = dataclasses.field(default_factory=Noise)


@dataclasses.dataclass(frozen=True)
class Worlds:
    """List the built-in worlds, or measure and picture some.

    Without names and --out, lists the generators and what they take. Else prints a table of the worlds named (by
    default every generator) and writes worlds.png.
    """

    worlds: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="[NAME ...]")] = ()
    """Generators such as cave#3, or map files: map.yaml (ROS), map.png@16x16 (metres), map.png@0.05 (metres a pixel),
    map.map (MovingAI), plan.json (HouseExpo)."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    out: _Out = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""


@dataclasses.dataclass(frozen=True)
class Bench:
    """Measure what everything costs on this machine.

    Kernels beside other libraries, episodes by batch size and by map size, an episode's parts, memory, compiling. Runs
    on one core, or on the first accelerator. Prints Markdown tables and writes bench.json, bench.png and run.json. A
    quiet machine gives good figures.
    """

    worlds: _OwnNames = None
    """Worlds in which episodes are run, as for `jexplore compare` (default: cave office hospital)."""
    strategies: _OwnNames = None
    """Strategies (default: closest+recheck)."""
    batch_sizes: _Numbers = None
    """Episodes of the serial engine, lanes in lockstep (default: 1 4 16 64; up to 4096 lanes on an accelerator)."""
    sides: _Numbers = None
    """Maps of so many cells a side, 32 to 2048, by which cost is measured (default: 64 128 256 512)."""
    engine: _OwnNames = None
    """Engines: serial, lockstep or both (default: what suits the machine)."""
    episodes: _Number = None
    """Least number of episodes in lockstep, and that of the serial engine by map size (default: 16)."""
    repeat: _Number = None
    """Turns of every measurement (default: 5)."""
    quick: bool = False
    """Smaller defaults: the cave, batches of 1 and 4, sides 64 and 128, 4 episodes, 2 turns."""
    cache: bool = False
    """Use compiled programs that earlier commands have kept: times of compiling are then those of loading."""
    out: _Out = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""


@dataclasses.dataclass(frozen=True)
class Strategies:
    """List strategies, modifiers, their parameters and sources."""


COMMANDS = {
    "compare": Compare,
    "explore": Explore,
    "reproduce": Reproduce,
    "segment": Segment,
    "trace": Trace,
    "worlds": Worlds,
    "strategies": Strategies,
    "bench": Bench,
}


def help_text():
    """What `jexplore --help` prints."""
    lines = ["usage: jexplore {" + ",".join(COMMANDS) + "} [options]", ""]
    lines += ["A laboratory for mobile-robot exploration.", "", "commands:"]
    lines += [f"  {name:<12}{(command.__doc__ or '').splitlines()[0]}" for name, command in COMMANDS.items()]
    lines += ["", "options:", "  -h, --help  show this, or the options of a command: jexplore compare --help"]
    return "\n".join([*lines, "  --version   show the version", ""])


def parse(arguments):
    """The record of a command and its options.

    Args:
      arguments: list of text, the command first.

    Returns:
      A record of a class in `COMMANDS`.

    Raises:
      InputError: an unknown command or option, a value of the wrong kind or out of bounds.
      SystemExit: with status 0, once help has been printed.
    """
    name, *rest = arguments
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, n=1, cutoff=0.5)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        what = "expected a command first" if name.startswith("-") else "unknown command"
        raise InputError(f"{what}: {name!r}; there are {', '.join(COMMANDS)}{hint}")

    def read():
        return tyro.cli(COMMANDS[name], prog=f"jexplore {name}", args=rest, config=(tyro.conf.FlagCreatePairsOff,))

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
    (r"^Error parsing [\w.-]*(lidar|episode|tuning|noise): ", ""),
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


def one_line(box):
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
