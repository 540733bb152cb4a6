"""Devices that programs can be compiled for without having one: what XLA must know of them, and the plugin it needs."""

import logging
import re
from importlib.metadata import PackageNotFoundError, distributions, version
from typing import Any, NamedTuple

from jexplore.config import InputError

EXTRA = "install jexplore[gpu-compile]"
DRIVER = "{cuda}.9.0"  # with none, or with 12.0, loops fall out of CUDA graphs, and nothing says so
REACHED = 0.84  # share of the memory's rate that a plain copy reaches


class Target(NamedTuple):
    """A device, from its maker's data sheet."""

    name: str
    capability: tuple[int, int]
    cores: int  # multiprocessors
    lanes: int  # single precision, a multiprocessor
    shared_bytes: int  # a multiprocessor
    shared_block_bytes: int  # most that a block can ask for
    cache_bytes: int  # level 2
    clock_ghz: float
    memory_bytes: int
    bandwidth: int  # bytes/s


TARGETS = {
    "h100": Target(
        "NVIDIA H100 80GB HBM3", (9, 0), 132, 128, 233472, 232448, 50 * 2**20, 1.98, 80 * 2**30, 3352 * 10**9
    ),
    "h200": Target("NVIDIA H200", (9, 0), 132, 128, 233472, 232448, 60 * 2**20, 1.98, 141 * 10**9, 4800 * 10**9),
    "a100": Target(
        "NVIDIA A100-SXM4-80GB", (8, 0), 108, 64, 167936, 166912, 40 * 2**20, 1.41, 80 * 2**30, 2039 * 10**9
    ),
}
"""Name -> what is compiled for."""


def target_of(name: str) -> Target:
    """The `Target` of a name; refuses others."""
    if name not in TARGETS:
        raise InputError(f"target must be one of {', '.join(TARGETS)}, got {name!r}")
    return TARGETS[name]


def describe(target: Target, cuda: int) -> str:
    """What XLA wants to be told of a device: a protocol buffer as text.

    Args:
      target: `Target`.
      cuda: major version.
    """
    driver, (major, minor) = DRIVER.format(cuda=cuda), target.capability
    device = {
        "threads_per_block_limit": 1024,
        "threads_per_warp": 32,
        "threads_per_core_limit": 2048,
        "shared_memory_per_block": 49152,
        "shared_memory_per_block_optin": target.shared_block_bytes,
        "shared_memory_per_core": target.shared_bytes,
        "registers_per_block_limit": 65536,
        "registers_per_core_limit": 65536,
        "core_count": target.cores,
        "fpus_per_core": target.lanes,
        "block_dim_limit_x": 2**31 - 1,
        "block_dim_limit_y": 65535,
        "block_dim_limit_z": 65535,
        "memory_bandwidth": target.bandwidth,
        "device_memory_size": target.memory_bytes,
        "l2_cache_size": target.cache_bytes,
        "clock_rate_ghz": target.clock_ghz,
        "driver_version": f'"{driver}"',
        "runtime_version": f'"{driver}"',
        "cuda_compute_capability": f"{{ major: {major} minor: {minor} }}",
    }
    inside = "\n".join(f"  {key}: {value}" for key, value in device.items())
    return (
        f"gpu_device_info {{\n{inside}\n}}\n"
        f'platform_name: "CUDA"\ndevice_description_str: "{target.name}"\n'
        f"runtime_version {{ major: {cuda} }}\ndnn_version_info {{ major: 9 }}\n"
    )


def installed() -> dict[str, str]:
    """Installed packages of JAX and of CUDA's compiler: name -> version."""
    found = {}
    for one in distributions():
        name = (one.metadata["Name"] or "").lower()
        if re.fullmatch(r"jax-cuda\d+-(plugin|pjrt)|nvidia-cuda-nvcc(-cu\d+)?", name):
            found[name] = one.version
    return found


def cuda_of(packages: dict[str, str], jaxlib: str) -> int:
    """The major version of CUDA that installed packages are for.

    Args:
      packages: as from `installed`.
      jaxlib: version of jaxlib.

    Raises:
      InputError: no plugin, one of another version than jaxlib, or a compiler of CUDA of another version.
    """
    plugins = [int(found[1]) for name in packages if (found := re.fullmatch(r"jax-cuda(\d+)-plugin", name))]
    if not plugins:
        raise InputError(f"compiling for a GPU needs JAX's CUDA plugin: {EXTRA}")
    cuda = max(plugins)
    for part in ("plugin", "pjrt"):
        name = f"jax-cuda{cuda}-{part}"
        if packages.get(name) != jaxlib:
            raise InputError(f"{name} must be of jaxlib's version {jaxlib}, got {packages.get(name, 'none')}: {EXTRA}")
    compilers = {int(own.partition(".")[0]) for name, own in packages.items() if name.startswith("nvidia-cuda-nvcc")}
    if cuda not in compilers:
        others = ", ".join(map(str, sorted(compilers))) or "none"
        raise InputError(f"jax-cuda{cuda}-plugin needs CUDA {cuda}'s compiler nvidia-cuda-nvcc, got {others}: {EXTRA}")
    return cuda


def compile_only(target: Target) -> Any:
    """A JAX device that programs can be compiled for, and nothing run on.

    Raises:
      InputError: what the extra installs is missing, does not fit, or does not load.
    """
    from jax.experimental import topologies

    try:
        cuda = cuda_of(installed(), version("jaxlib"))
    except PackageNotFoundError:
        raise InputError(f"compiling for a GPU needs jaxlib as a package: {EXTRA}") from None
    logger = logging.getLogger("jax._src.xla_bridge")  # would write a plugin's whole traceback
    logger.disabled, before = True, logger.disabled
    try:
        text = describe(target, cuda)
        found = topologies.get_topology_desc(platform="cuda", topology="1x1x1", target_config=text)
        return found.devices[0]
    except (NotImplementedError, RuntimeError, OSError, ValueError) as error:
        says = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"JAX's CUDA plugin does not load ({says}): {EXTRA}") from None
    finally:
        logger.disabled = before
