"""Result files: written whole or not at all.

pandas, pyarrow and jax are imported by the functions that need them.
"""

import contextlib
import dataclasses
import datetime
import enum
import importlib.metadata
import json
import math
import os
import platform
import secrets
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jexplore.arrays.files import opened
from jexplore.config import GENERATOR, InputError, __version__

if TYPE_CHECKING:
    import pandas as pd

_PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "flax", "chex", "pandas", "pyarrow", "matplotlib", "pillow")


MAX_RECORD_BYTES = 2**26
"""Of a run.json that is read: starts and settings of a hundred thousand runs."""
MAX_TABLE_VALUES = 2**28
"""Of a table that is read: 2 GiB of numbers. A few bytes of a Parquet file may stand for as many equal ones."""


def reason(error):
    return (getattr(error, "strerror", None) or str(error)).splitlines()[0]


@contextlib.contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Provide a temporary path in the same folder that replaces `path` once the block has ended well.

    The data are synced before the replacement, so a reader finds the old file or the new one. If the block raises, the
    temporary file is removed and `path` stays as it was. A file that cannot be written is an `InputError`.
    """
    path = Path(path)
    part = path.parent / f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part"
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
        sync_folder(path.parent)
    except OSError as error:
        raise InputError(f"{path} must be a file that can be written: {reason(error)}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def sync_folder(folder):
    """Make a replacement in `folder` durable, where the system lets a folder be opened."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def write_parquet(episodes: "pd.DataFrame", path: str | os.PathLike[str]) -> None:
    """Write a DataFrame as Parquet, without its index, whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_pandas(episodes, preserve_index=False)
    with atomic(path) as part, open(part, "wb") as file:  # of a name that need not be UTF-8, as pyarrow would want it
        pq.write_table(table, file, write_page_checksum=True)


def read_parquet(path: str | os.PathLike[str], *, required: Sequence[str] = ()) -> "pd.DataFrame":
    """Read a DataFrame that `write_parquet` wrote; column types come back as they were."""
    import pandas as pd
    import pyarrow.parquet as pq

    with opened(path) as file:
        try:
            size = pq.read_metadata(file)
            if size.num_rows * size.num_columns > MAX_TABLE_VALUES:
                raise InputError(f"{path} has {size.num_rows} rows of {size.num_columns} columns, too many to be read")
            file.seek(0)
            table = pd.read_parquet(file)
        except InputError:
            raise
        except Exception as error:  # pyarrow and pandas raise many kinds of errors for a damaged file
            raise InputError(f"{path} must be a Parquet file: {reason(error)}") from error
    missing = [name for name in required if name not in table.columns]
    if missing:
        raise InputError(f"{path} must have the column {missing[0]}, got {', '.join(map(str, table.columns))}")
    return table


def jsonable(value: Any) -> Any:
    """Convert `value` to plain JSON types.

    Numbers and arrays of numpy and jax become numbers and lists; NaN, infinities and pandas' NA become None; records
    become objects, paths and times text, enumerations their names. Other types are a `TypeError`.
    """
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (datetime.datetime, datetime.date)):
        return value.isoformat()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: jsonable(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(item) for item in value]
    if type(value).__name__ == "NAType":
        return None
    if hasattr(value, "__array__"):
        return jsonable(np.asarray(value).tolist())
    raise TypeError(f"expected something that JSON can hold, got {type(value).__name__}")


def json_text(obj: Any) -> str:
    """Format `obj` as JSON (see `jsonable`), indented."""
    return json.dumps(jsonable(obj), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_json(obj: Any, path: str | os.PathLike[str]) -> None:
    """Write `obj` as JSON, whole or not at all."""
    text = json_text(obj)
    with atomic(path) as part:
        part.write_text(text, encoding="utf-8", errors="backslashreplace")  # arguments may be no UTF-8


def _version(package):
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def environment() -> dict[str, Any]:
    """Describe hardware and software of a run, for its record. Starts jax's backend."""
    import jax

    devices = jax.devices()
    return {
        "jexplore": __version__,
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
        "platform": platform.platform(),
        "machine": platform.machine(),
        "cpu_count": os.cpu_count(),
        "backend": devices[0].platform,
        "device": devices[0].device_kind,
        "device_count": len(devices),
        "generator": GENERATOR,
    }
