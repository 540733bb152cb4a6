"""JAX made ready: threads for the workers, and a folder of compiled programs."""

import contextlib
import os
from pathlib import Path

import jax

from jexplore.engine.plugins import is_idle


def start_backend(workers: int) -> None:
    """Start JAX with as many threads as there will be workers, which call compiled programs at the same time.

    XLA runs programs on a pool of its own, which must have a thread for every worker. It also splits operations of a
    few thousand elements over the threads of that pool, which costs a lone worker more than it gains (measured: a tenth
    of an episode's time on a quiet machine, a third on a busy one): so one worker gets one thread. JAX reads the size
    of the pool from the variable NPROC when it is first used; a later call changes nothing: that costs speed only.
    """
    if not jax.config.values["jax_platforms"] and is_idle():
        jax.config.update("jax_platforms", "cpu")  # the plugin for CUDA would only complain
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = str(workers)
    try:
        jax.local_devices()
    finally:
        if before is None:
            del os.environ["NPROC"]
        else:
            os.environ["NPROC"] = before


def cache_folder() -> Path:
    """Return the folder of compiled programs, made if missing: `$XDG_CACHE_HOME/jexplore` (`~/.cache/jexplore`).

    Raises OSError if it cannot be made, RuntimeError without a home.
    """
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jexplore"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def use_compilation_cache() -> None:
    """Keep compiled programs on disk, so that a later process need not compile them again.

    In `$JAX_COMPILATION_CACHE_DIR` if that is set, else in `cache_folder()`. No home or a folder that cannot be written
    means no cache.
    """
    if jax.config.values["jax_compilation_cache_dir"] is None:
        with contextlib.suppress(OSError, RuntimeError):
            jax.config.update("jax_compilation_cache_dir", str(cache_folder()))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
