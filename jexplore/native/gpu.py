"""Batches of whole episodes by an NVIDIA GPU: a warp an episode. Built by nvcc on first use."""

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, Structure, c_char_p, c_double, c_int, c_int32, c_int64, c_void_p
from typing import NamedTuple

import jax
import numpy as np

from jexplore.native.build import FOLDER, Library, load_library
from jexplore.native.episodes import RESULT, TASK, Given, Spec, as_struct

SOURCES = tuple(FOLDER / name for name in ("gpu.cu", "warp_host.h", "warp.h", "world.h", "rules.h"))
COMPILERS = ("nvcc", "/usr/local/cuda/bin/nvcc")
FLAGS = ("-std=c++17", "-O3", "-shared", "-Xcompiler", "-fPIC", "-cudart", "static")
PARTS = ("scan", "masks", "search", "way")  # `Part` in warp.h


class Measured(Structure):
    """Measures of a run."""

    _fields_ = [
        ("prepare_s", c_double), ("views_s", c_double), ("run_s", c_double), ("views_bytes", c_int64),
        ("memory_bytes", c_int64), ("warps_per_sm", c_int32), ("n_sms", c_int32), ("given_up", c_int32),
        ("padding", c_int32), ("clocks", c_int64 * (len(PARTS) + 1)),
    ]  # fmt: skip


class Played(NamedTuple):
    """Results of some episodes."""

    results: np.ndarray  # [n, RESULT] int32; outcome 0 where an episode was given up, which a CPU then runs
    measured: Measured


def load_gpu(flags: Sequence[str] = ()) -> Library:
    """Return the library for this machine's kind of GPU, built if need be.

    `flags`: of nvcc, besides `FLAGS`; "-DJEXPLORE_CLOCKS" has the time of each part told.
    """
    found = load_library(SOURCES, (*FLAGS, "-arch=native", *flags), "NVCC", COMPILERS)
    if found.loaded is not None:
        found.loaded.jexplore_gpu_episodes.argtypes = [
            POINTER(Spec), c_void_p, c_void_p, c_int64, c_void_p, c_void_p, c_int, POINTER(Measured), c_char_p,
            c_int64,
        ]  # fmt: skip
    return found


def device_count() -> int:
    """Return how many GPUs NVIDIA's driver has; 0 without one, or where `JAX_PLATFORMS` leaves them out.

    Nothing is built for that.
    """
    if not {"cuda", "gpu"} & {*(jax.config.values["jax_platforms"] or "cuda").split(",")}:
        return 0
    try:
        driver, n = ctypes.CDLL("libcuda.so.1"), c_int(0)
        return n.value if not (driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(n))) else 0
    except (OSError, AttributeError):
        return 0


def play(
    loaded: ctypes.CDLL, spec: Spec, given: Given, tasks: np.ndarray, stop: np.ndarray, *, warps: int = 0
) -> Played | None:
    """Run episodes in one world, as `episodes.World.play`; goals and regions of the tasks are found here.

    `warps`: most on a multiprocessor; 0: as many as fit. Returns None if the world does not suit. Raises MemoryError if
    the GPU has too little, RuntimeError at an error of CUDA.
    """
    keep, tasks = [], np.ascontiguousarray(tasks, TASK)
    results, measured, why = np.zeros((len(tasks), RESULT), np.int32), Measured(), ctypes.create_string_buffer(500)
    code = loaded.jexplore_gpu_episodes(
        ctypes.byref(spec), ctypes.byref(as_struct(given, keep)), tasks.ctypes.data, len(tasks), results.ctypes.data,
        stop.ctypes.data, warps, ctypes.byref(measured), why, len(why),
    )  # fmt: skip
    if code == 1:
        raise MemoryError("the GPU has too little memory")
    if code == 3:
        raise RuntimeError(why.value.decode(errors="replace"))
    return None if code == 2 else Played(results, measured)
