"""Files that somebody gives, one function for each format: what can go wrong is told in one line, and whatever a file
holds, reading it takes bounded time and memory.

Plain Python: importing this loads neither numpy nor jax.
"""

import contextlib
import gzip
import io
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO

from jexplore.config import InputError

MOST_LEVELS = 100
"""Lists and objects within each other. What walks over them calls itself once or twice a level, and Python ends that
after 1,000 calls."""
_TOO_DEEP = f"lists and objects lie in each other more than {MOST_LEVELS} deep"
MOST_SPEC_BYTES = 2**20  # of a YAML file. PyYAML reads about 100 kB in a second.


@contextlib.contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a regular file for reading; errors within the context too become an `InputError` of one line."""
    path = os.fspath(path)
    try:
        if os.path.isdir(path):
            raise InputError(f"{path!r}: is a directory; name a file in it")
        if os.path.exists(path) and not os.path.isfile(path):
            raise InputError(f"{path!r}: is not a regular file")
        with open(path, "rb") as file:
            yield file
    except InputError:
        raise
    except FileNotFoundError:
        raise missing(path) from None
    except PermissionError:
        raise InputError(f"{path!r}: you have no permission to read it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path!r}: cannot be opened ({first_line(error)})") from None


def read_bytes(path: str | os.PathLike[str], max_bytes: int) -> bytes:
    """Read a regular file of at least one byte; a larger one than `max_bytes` is refused before it is read."""
    told = repr(os.fspath(path))
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise InputError(f"{told}: has {size} bytes; at most {max_bytes} are read")
        content = file.read(max_bytes)
    if not content:
        raise InputError(f"{told}: is empty")
    return content


def told_kind(content: bytes) -> str:
    """Describe the kind of a file by its first bytes, and what to do with it; empty if unknown."""
    return next((what for start, what in _KINDS.items() if content.startswith(start)), "")


_BAG = "whose name must end in"
_PICTURE = "a picture, whose name must end as its format has it, with a scale: map.png@0.05"
_PACKED = "compressed; unpack it"
_KINDS = {
    b"#ROSBAG V": f"a bag of ROS 1, {_BAG} .bag",
    b"\x89MCAP0": f"a recording of ROS 2, {_BAG} .mcap",
    b"SQLite format 3": "an SQLite database; one that is a recording of ROS 2 has a name that ends in .db3",
    **dict.fromkeys((b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"II*\0", b"MM\0*", b"P4", b"P5", b"P6"), _PICTURE),
    **dict.fromkeys((b"\x1f\x8b", b"PK\3\4", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd"), _PACKED),
    **dict.fromkeys((b"\xff\xfe", b"\xfe\xff"), "text in UTF-16; save it as UTF-8"),
}


def read_text(path: str | os.PathLike[str], max_bytes: int) -> str:
    """Read a text file in UTF-8, as `read_bytes`; one whose name ends in `.gz` is unpacked."""
    content = read_bytes(path, max_bytes)
    if os.fspath(path).lower().endswith(".gz"):
        content = _unpacked(content, repr(os.fspath(path)), max_bytes)
    if told_kind(content):
        raise InputError(f"{os.fspath(path)!r}: is not the text that its name says, but {told_kind(content)}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{os.fspath(path)!r}: is not UTF-8 text (byte {error.start})") from None


def _unpacked(content, told, max_bytes):
    """Unpack the content of a file packed by gzip."""
    try:
        content = gzip.GzipFile(fileobj=io.BytesIO(content)).read(max_bytes + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{told}: cannot be unpacked ({first_line(error)})") from None
    if len(content) > max_bytes:
        raise InputError(f"{told}: has more than {max_bytes} bytes once unpacked; at most these are read")
    return content


def json_of(text: str, told: str) -> Any:
    """Parse a text in JSON, nested no deeper than `MOST_LEVELS`; `told` is its name in messages."""
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{told}: is not valid JSON (line {error.lineno}: {error.msg})") from None
    except RecursionError:
        raise InputError(f"{told}: {_TOO_DEEP}") from None
    except ValueError as error:  # of numbers with thousands of digits
        raise InputError(f"{told}: is not valid JSON ({first_line(error)})") from None
    require_shallow(found, told)
    return found


def read_json(path: str | os.PathLike[str], max_bytes: int) -> Any:
    """Read a JSON file: `read_text` and `json_of`."""
    return json_of(read_text(path, max_bytes), repr(os.fspath(path)))


def require_shallow(value: Any, told: str) -> None:
    """Refuse lists and mappings that lie in each other more than `MOST_LEVELS` deep: an `InputError`."""
    kinds, layer, levels = (Mapping, list, tuple), [value], 0
    while layer := [one for one in layer if isinstance(one, kinds)]:
        levels += 1
        if levels > MOST_LEVELS:
            raise InputError(f"{told}: {_TOO_DEEP}")
        layer = [inner for one in layer for inner in (one.values() if isinstance(one, Mapping) else one)]


def yaml_of(text: str, told: str) -> Any:
    """Parse a text in YAML, see `plain_yaml.Loader`, nested no deeper than `MOST_LEVELS`."""
    import yaml

    from jexplore.arrays.plain_yaml import Loader

    try:
        found = yaml.load(text, Loader)
    except RecursionError:
        raise InputError(f"{told}: {_TOO_DEEP}") from None
    except Exception as error:  # PyYAML raises ValueError, KeyError, AttributeError and more
        mark = getattr(error, "problem_mark", None)
        place = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        what = place + (getattr(error, "problem", None) or first_line(error))
        raise InputError(f"{told}: is not valid YAML ({what})") from None
    require_shallow(found, told)
    return found


def read_yaml(path: str | os.PathLike[str], max_bytes: int = MOST_SPEC_BYTES) -> Any:
    """Read a YAML file: `read_text` and `yaml_of`."""
    return yaml_of(read_text(path, max_bytes), repr(os.fspath(path)))


def missing(path: str) -> InputError:
    """Return the error for a missing file."""
    where = "" if os.path.isabs(path) else f" (looked in {os.getcwd()!r})"
    return InputError(f"{path!r}: there is no such file{where}")


def first_line(error: BaseException) -> str:
    """Return the first line of an exception's message, or the name of its type."""
    try:
        return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
    except Exception:  # of a user's class, whose `__str__` raises
        return type(error).__name__
