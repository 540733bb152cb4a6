"""Connection to a Ray cluster, an existing one or one of our own.

Ray is imported by the functions that need it.
"""

import contextlib
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jexplore.arrays.files import first_line
from jexplore.config import InputError
from jexplore.engine.runner import own_cores

ANSWER_S = 5.0  # seconds in which a cluster must answer
SLOW = "timed out during startup"  # in what Ray says of a cluster that is slow to start
STORE_BYTES = 256 * 2**20  # of results, in a cluster of our own


def require_ray() -> Any:
    """Return the module ray.

    Raises:
      InputError: it is not installed.
    """
    try:
        import ray  # type: ignore[import-not-found]
        import ray.exceptions
    except ImportError:
        raise InputError("the engine ray needs Ray: pip install 'jexplore[ray]'") from None
    return ray


@contextlib.contextmanager
def connected(ray: Any) -> Iterator[bool]:
    """Connect to a cluster for a block.

    An existing connection of this process stays; otherwise the connection, and a cluster started with it, end with the
    block. The block gets whether that is so.

    Raises:
      InputError: no cluster exists and none can be started.
    """
    if ray.is_initialized():
        yield False
        return
    try:
        with contextlib.redirect_stdout(_Muted(sys.stdout) if sys.stdout else None):  # type: ignore[arg-type]
            with _handlers_kept():
                _connect(ray)
            yield True
    finally:
        ray.shutdown()


def _connect(ray):
    own: dict[str, Any] = {"address": "local", "num_cpus": own_cores(), "object_store_memory": STORE_BYTES}
    quiet = {"log_to_driver": False, "logging_level": logging.CRITICAL, "include_dashboard": False}
    how = {} if is_there() else own  # one that is there knows its cores itself, and Ray finds it
    try:
        begin(ray, **how, **quiet)
    except Exception as error:  # Ray raises bare ones
        what = "started here" if how else "used"
        raise InputError(f"no Ray cluster can be {what}: {first_line(error)}") from error


def begin(ray: Any, **how: Any) -> None:
    """Call `ray.init`, again if Ray's own patience of 30 s ends on a busy machine."""
    try:
        ray.init(**how)
    except Exception as error:
        ray.shutdown()
        if SLOW not in str(error):
            raise
        ray.init(**how)


def is_there() -> bool:
    """Return whether a cluster is available. Ray itself would wait for minutes for one that is gone.

    Raises:
      InputError: `RAY_ADDRESS` names one that does not answer.
    """
    given = os.environ.get("RAY_ADDRESS") or "auto"
    if given not in ("auto", "local"):
        if not _answers(given):
            raise InputError(
                f"no Ray cluster answers at RAY_ADDRESS={given}: start one (ray start --head), or unset RAY_ADDRESS to "
                "use the cores of this machine"
            )
        return True
    folder = os.environ.get("RAY_TMPDIR") or os.environ.get("TMPDIR") or "/tmp"
    try:  # where `ray start` says what it has begun
        begun = Path(folder, "ray", "ray_current_cluster").read_text(encoding="utf-8").strip()
    except OSError:
        return False
    return given == "auto" and _answers(begun)


def _answers(address: str) -> bool:
    host, _, port = address.rpartition("://")[2].rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), ANSWER_S).close()
    except (OSError, ValueError, OverflowError):
        return False
    return True


class _Muted:
    """A stream without what Ray's threads write there: what has become of workers, which is dealt with."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write text, whoever but Ray it comes from."""
        if threading.current_thread().name.startswith("ray_"):
            return len(text)
        return self.stream.write(text)

    def __getattr__(self, name):
        return getattr(self.stream, name)


@contextlib.contextmanager
def _handlers_kept():
    """Keep the handler for SIGTERM, which Ray replaces by its own."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)
