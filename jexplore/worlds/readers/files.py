"""Opening a map file: what can go wrong, told in one line."""

import contextlib
import os
from collections.abc import Iterator
from typing import BinaryIO

from jexplore.config import InputError


@contextlib.contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A regular file, open for reading.

    Args:
      path: the file.

    Returns:
      What a `with` statement takes; what goes wrong within it is told likewise.

    Raises:
      InputError: no such file, a directory or another thing that is no file, or not readable.
    """
    try:
        if os.path.isdir(path):
            raise InputError(f"{path!r}: is a directory; name a map file in it")
        if os.path.exists(path) and not os.path.isfile(path):
            raise InputError(f"{path!r}: is not a regular file")
        with open(path, "rb") as file:
            yield file
    except InputError:
        raise
    except FileNotFoundError:
        where = "" if os.path.isabs(path) else f" (looked in {os.getcwd()!r})"
        raise InputError(f"{path!r}: there is no such file{where}") from None
    except PermissionError:
        raise InputError(f"{path!r}: you have no permission to read it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path!r}: cannot be opened ({first_line(error)})") from None


def read_bytes(path: str | os.PathLike[str], max_bytes: int) -> bytes:
    """The content of a regular file.

    Args:
      path: the file.
      max_bytes: a larger file is refused before it is read.

    Returns:
      `bytes`, at least one.

    Raises:
      InputError: as `opened`, empty, or too large.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise InputError(f"{path!r}: has {size} bytes; at most {max_bytes} are read")
        content = file.read(max_bytes)
    if not content:
        raise InputError(f"{path!r}: is empty")
    return content


def told_kind(content: bytes) -> str:
    """What a file is by its first bytes, and what to do with it; empty where they do not tell."""
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
    """The content of a text file in UTF-8.

    Raises:
      InputError: as `read_bytes`, or not UTF-8 text.
    """
    content = read_bytes(path, max_bytes)
    if told_kind(content):
        raise InputError(f"{path!r}: is not the text that its name says, but {told_kind(content)}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path!r}: is not UTF-8 text (byte {error.start})") from None


def first_line(error: BaseException) -> str:
    """What an exception says, on one line."""
    return " ".join(str(error).split()) or type(error).__name__
