"""The grammar of world names, and their short forms. Plain Python: importing this loads neither jax nor numpy.

    generator[#seed][:key=value,...]        cave   cave#3   hospital#2:width_m=60,height_m=25
    module:function[#seed][:key=value,...]  mine:plan   mine:plan#3:doors=2
    file[@scale][:key=value,...]            map.yaml   map.png@16x16   map.png@0.05:free=150   plan.json
                                            scans.log   scans.log:range_m=20   run.mcap   run.bag:topic=/map,free_max=49

A name is a file if one of the known suffixes ends it or is followed by `@` or `:`; it is then cut there. A path may
itself contain `#`, `@` and `:`. Where there are several places to cut, the longest path that exists as a file is
taken, else the longest path. A folder with a `metadata.yaml` is a recording of ROS 2. Every other name is a
generator's.
"""

import collections
import dataclasses
import difflib
import itertools
import math
import os
import re
from collections.abc import Collection, Sequence
from typing import NamedTuple

from jexplore.config import MAX_SEED, InputError, require_number


class FileKind(NamedTuple):
    """A kind of map file."""

    suffixes: tuple[str, ...]  # in either case
    reader: str  # "module:function" in `readers`; its keyword parameters are `cell_m` and those of the name
    example: str
    content: str  # the examples' content that is read


FILES = {
    "ROS": FileKind(("yaml", "yml"), "ros:load_ros", "map.yaml", "a ROS map"),
    "image": FileKind(
        ("png", "pgm", "pbm", "ppm", "jpg", "jpeg", "bmp", "gif", "tif", "tiff"),
        "images:load_image",
        "map.png@16x16, map.png@0.05",
        "a picture, with its sides in metres or its metres a pixel",
    ),
    "HouseExpo": FileKind(("json",), "houseexpo:load_houseexpo", "plan.json", "a HouseExpo plan"),
    "CARMEN": FileKind(("log", "clf"), "carmen:load_carmen", "scans.log", "a CARMEN log"),
    "ROS bag": FileKind(("bag", "db3", "mcap"), "bags:load_bag", "run.bag, run.mcap", "a ROS bag"),
}

_KIND_OF = {suffix: name for name, kind in FILES.items() for suffix in kind.suffixes}
_CUT = re.compile(r"\.(" + "|".join(sorted(_KIND_OF, key=len, reverse=True)) + r")(?=$|[@:])", re.IGNORECASE)
_GENERATOR, _FOREIGN = (
    re.compile(rf"(?P<base>{base})(#(?P<seed>[^:]*))?(:(?P<parameters>.*))?", re.DOTALL)
    for base in (r"[A-Za-z_][\w-]*", r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
)
METADATA = "metadata.yaml"
"""The file that makes a folder a recording of ROS 2."""
INSIDE = ("inside", "inside_x_m", "inside_y_m")
"""Parameters of every map file: which of its floor is meant, see `regions.inside`."""
_Value = bool | int | float | str
LONGEST_NAME = 200  # characters of a file's name; file systems take 255 bytes with suffixes


@dataclasses.dataclass(frozen=True)
class WorldName:
    """A world name, taken apart."""

    name: str  # the whole, as the user typed it
    kind: str  # `generator`, or a key of `FILES`
    base: str
    """Name of the generator, `module:function` of a user's, or path of the file or the recording's folder."""
    seed: int = 0  # seed of a generator
    scale: float | tuple[float, float] | None = None
    """Text after the `@`: metres a pixel, or width and height in metres; None without one."""
    parameters: dict[str, _Value] = dataclasses.field(default_factory=dict)  # text after the `:`


def parse_name(name: str, *, generators: Collection[str]) -> WorldName:
    """Take a world name apart, and refuse one that names nothing; `generators` are the names of all generators."""
    cuts = [match.end() for match in _CUT.finditer(name)]
    if cuts:
        return _parse_file(name, _path_end(name, cuts))
    match = _GENERATOR.fullmatch(name)
    base = match["base"] if match else ""
    foreign = None if base in generators else _FOREIGN.fullmatch(name)
    if foreign is not None:
        match, base = foreign, foreign["base"]
    elif match is None or base not in generators:
        cuts = [len(name), *(colon.start() for colon in re.finditer(":", name))]
        if recordings := [cut for cut in cuts if recording_folder(name[:cut])]:
            return _parse_file(name, max(recordings))
        if os.path.isdir(name):
            raise InputError(f"{name!r}: is a directory; name a map file in it")
        if match is None or os.path.isfile(name):
            suffixes = ", ".join("." + suffix for suffix in _KIND_OF)
            raise InputError(f"{name!r}: is neither {', '.join(generators)} nor a map file ending in {suffixes}")
        raise InputError(
            f"{name!r}: there is no world {base!r}; there are {_there_are(base, generators)} and map files"
        )
    return WorldName(
        name=name,
        kind="generator",
        base=base,
        seed=0 if match["seed"] is None else _seed(name, match["seed"]),
        parameters={} if match["parameters"] is None else _parameters(name, match["parameters"]),
    )


def require_parameters(parsed: WorldName, permitted: Collection[str]) -> None:
    """Refuse a parameter other than the permitted ones."""
    for key in parsed.parameters:
        if key == "cell_m":
            raise InputError(f"{parsed.name!r}: cell_m is an option of its own, not a parameter of the world's name")
        if key not in permitted:
            there_are = f"it takes {_there_are(key, permitted)}" if permitted else "it takes none"
            raise InputError(f"{parsed.name!r}: there is no parameter {key!r}; {there_are}")


def short_names(names: Sequence[str]) -> list[str]:
    """Make short distinct names of worlds, or other files: of a path the shortest end that no other one has."""
    parts = []
    for name in names:
        cuts = [match.end() for match in _CUT.finditer(name)]
        cut = _path_end(name, cuts) if cuts else len(name.partition(":")[0])
        *folders, last = re.split(r"[/\\]", name[:cut])
        parts.append([*folders, last + name[cut:]])
    ends = collections.Counter(tuple(own[-n:]) for own in parts for n in range(1, len(own) + 1))
    return [
        next(("/".join(own[-n:]) for n in range(1, len(own)) if ends[tuple(own[-n:])] == 1), name)
        for name, own in zip(names, parts)
    ]


def file_names(texts: Sequence[str]) -> list[str]:
    """Make a file name, without suffix, for each text, such as `floor1/map.yaml-closest-0`; no two are equal, in any
    case.

    It has letters, digits and `.+=#-_`, up to `LONGEST_NAME` characters; a second equal one ends in `-2`.
    """
    made, taken = [], set()
    for text in texts:
        plain = re.sub(r"[^A-Za-z0-9_.+=#-]+", "_", text).lstrip(".-")[-LONGEST_NAME:] or "_"
        others = (f"{plain}-{i}" for i in itertools.count(2))
        name = next(one for one in itertools.chain([plain], others) if one.lower() not in taken)
        taken.add(name.lower())
        made.append(name)
    return made


def _path_end(name: str, cuts: list[int]) -> int:
    """Return the end of the path of a file: the longest that exists, else the longest."""
    return max(cuts, key=lambda cut: (os.path.isfile(name[:cut]), cut))


def _there_are(word: str, known: Collection[str]) -> str:
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return ", ".join(known) + (f" (did you mean {near[0]!r}?)" if near else "")


def recording_folder(path: str) -> str | None:
    """Return the folder of a recording of ROS 2 by its path or that of its `metadata.yaml`; None for another path."""
    folder = (os.path.dirname(path) or ".") if os.path.basename(path) == METADATA else path
    return folder if path and os.path.isfile(os.path.join(folder, METADATA)) else None


def _parse_file(name: str, cut: int) -> WorldName:
    path, rest = name[:cut], name[cut:]
    scale, colon, parameters = rest.partition(":")
    return WorldName(
        name=name,
        kind="ROS bag" if recording_folder(path) else _KIND_OF[path.rpartition(".")[2].lower()],
        base=path,
        scale=_scale(name, scale[1:]) if scale else None,
        parameters=_parameters(name, parameters) if colon else {},
    )


def _seed(name: str, text: str) -> int:
    if not re.fullmatch("[0-9]{1,10}", text) or int(text) > MAX_SEED:
        raise InputError(f"{name!r}: the seed after '#' must be an integer from 0 to {MAX_SEED}, got {text!r}")
    return int(text)


def _scale(name: str, text: str) -> float | tuple[float, float]:
    numbers = [_value(part) for part in re.split("[xX]", text)]
    if len(numbers) > 2 or any(isinstance(number, (bool, str)) for number in numbers):
        raise InputError(
            f"{name!r}: after '@' comes the size in metres, as 16x16, or the metres a pixel, as 0.05; got {text!r}"
        )
    for number in numbers:
        require_number(f"{name!r}: every number after '@'", number, low_open=True, high=1e6)
    return float(numbers[0]) if len(numbers) == 1 else (float(numbers[0]), float(numbers[1]))


def _parameters(name: str, text: str) -> dict[str, _Value]:
    parameters = {}
    for part in text.split(","):
        key, equals, value = part.partition("=")
        if not (key.isidentifier() and equals and value):
            raise InputError(f"{name!r}: parameters are written key=value,key=value; got {part!r}")
        if key in parameters:
            raise InputError(f"{name!r}: parameter {key!r} is given twice")
        parameters[key] = _value(value)
        if isinstance(parameters[key], float) and not math.isfinite(parameters[key]):
            raise InputError(f"{name!r}: {key} must be finite, got {value!r}")
    return parameters


def _value(text: str) -> _Value:
    """Convert `text` to a bool, an int or a float if possible."""
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        if re.fullmatch(r"[-+.\w]+", text, re.ASCII) and "_" not in text:
            try:
                return kind(text)
            except ValueError:
                continue
    return text
