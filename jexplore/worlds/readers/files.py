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


def read_text(path: str | os.PathLike[str], max_bytes: int) -> str:
    """The content of a text file in UTF-8.

    Raises:
      InputError: as `read_bytes`, or not UTF-8 text.
    """
    try:
        return read_bytes(path, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path!r}: is not UTF-8 text (byte {error.start})") from None


def first_line(error: BaseException) -> str:
    """What an exception says, on one line."""
    return " ".join(str(error).split()) or type(error).__name__
