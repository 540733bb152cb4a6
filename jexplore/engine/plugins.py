"""JAX's CUDA plugin where there is no GPU: kept from starting. Plain Python: importing this does not load jax."""

import importlib.util
import logging
import os
import sys
from pathlib import Path

FATAL = "3"  # level of XLA's messages with which the process ends
DRIVER = ("/dev/nvidiactl", "/dev/dxg", "/dev/nvhost-gpu", "/proc/driver/nvidia/version")
"""One of these is there where an NVIDIA driver is: on its own, under WSL, on a Jetson."""


def is_idle(driver: tuple[str, ...] = DRIVER) -> bool:
    """Return whether JAX's CUDA plugin is installed on a machine without an NVIDIA driver, as for compiling only.

    Of the paths `driver` one exists with a driver.
    """
    spec = importlib.util.find_spec("jax_plugins") if sys.platform == "linux" else None
    folders = (spec and spec.submodule_search_locations) or ()
    has_plugin = any(next(Path(folder).glob("xla_cuda*"), None) for folder in folders)
    return has_plugin and not any(os.path.exists(path) for path in driver)


def keep_to_cpu() -> None:
    """Restrict JAX to the CPU if its CUDA plugin could only fail, unless `JAX_PLATFORMS` is set.

    This must come before jax is imported.
    """
    if "JAX_PLATFORMS" not in os.environ and is_idle():
        os.environ["JAX_PLATFORMS"] = "cpu"


def keep_compiler_quiet() -> None:
    """Silence messages on stderr: XLA's, such as about slow compilation, unless `TF_CPP_MIN_LOG_LEVEL` is set; JAX's of
    callbacks that raise.

    Errors are raised in Python all the same. This must come before jax is imported.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", FATAL)
    logging.getLogger("jax._src.callback").setLevel(logging.CRITICAL)
