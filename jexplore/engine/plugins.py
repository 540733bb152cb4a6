"""JAX's CUDA plugin where there is no GPU: kept from starting. Plain Python: importing this does not load jax."""

import importlib.util
import os
import sys
from pathlib import Path

FATAL = "3"  # level of XLA's messages with which the process ends
DRIVER = ("/dev/nvidiactl", "/dev/dxg", "/dev/nvhost-gpu", "/proc/driver/nvidia/version")
"""One of these is there where an NVIDIA driver is: on its own, under WSL, on a Jetson."""


def is_idle(driver: tuple[str, ...] = DRIVER) -> bool:
    """Whether JAX's CUDA plugin is installed on a machine without an NVIDIA driver, as for compiling only.

    Args:
      driver: paths of which one is there where a driver is.
    """
    spec = importlib.util.find_spec("jax_plugins") if sys.platform == "linux" else None
    folders = (spec and spec.submodule_search_locations) or ()
    has_plugin = any(next(Path(folder).glob("xla_cuda*"), None) for folder in folders)
    return has_plugin and not any(os.path.exists(path) for path in driver)


def keep_to_cpu() -> None:
    """Keeps JAX to the CPU where its CUDA plugin would only complain, unless `JAX_PLATFORMS` says what is wanted.

    This must come before jax is imported.
    """
    if "JAX_PLATFORMS" not in os.environ and is_idle():
        os.environ["JAX_PLATFORMS"] = "cpu"


def keep_compiler_quiet() -> None:
    """Keeps what XLA writes to stderr from users, such as that a slow compilation might be a bug of it, unless
    `TF_CPP_MIN_LOG_LEVEL` says what is wanted. What fails is raised in Python all the same.

    This must come before jax is imported.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", FATAL)
