"""Opening a map file: what can go wrong, told in one line."""

import os

from jexplore.config import InputError


def read_bytes(path: str | os.PathLike[str], max_bytes: int) -> bytes:
    """The content of a regular file.

    Args:
      path: the file.
      max_bytes: a larger file is refused before it is read.

    Returns:
      `bytes`, at least one.

    Raises:
      InputError: no such file, a directory or another thing that is no file, not readable, empty, or too large.
    """
    try:
        if os.path.isdir(path):
            raise InputError(f"{path!r}: is a directory; name a map file in it")
        if os.path.exists(path) and not os.path.isfile(path):
            raise InputError(f"{path!r}: is not a regular file")
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > max_bytes:
                raise InputError(f"{path!r}: has {size} bytes; at most {max_bytes} are read")
            content = file.read(max_bytes)
    except InputError:
        raise
    except FileNotFoundError:
        where = "" if os.path.isabs(path) else f" (looked in {os.getcwd()!r})"
        raise InputError(f"{path!r}: there is no such file{where}") from None
    except PermissionError:
        raise InputError(f"{path!r}: you have no permission to read it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path!r}: cannot be opened ({first_line(error)})") from None
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
