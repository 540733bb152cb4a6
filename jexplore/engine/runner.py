"""Many runs: on the cores of a CPU one after the other, on an accelerator in lockstep, with equal results.

A run is serial and full of decisions. A CPU core makes runs one at a time with true control flow (engine "serial"):
threads share one compiled program, and XLA releases the interpreter lock. An accelerator needs thousands of runs at
once (engine "lockstep"). Several devices share the work through `shard_map`, each with its own part and no word between
them; several processes (`jax.distributed`) do as well.
"""

import dataclasses
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jexplore.config import InputError, require_setting
from jexplore.engine import lockstep, serial
from jexplore.engine.backend import start_backend
from jexplore.engine.program import Line

ENGINES = ("serial", "lockstep")


@dataclasses.dataclass
class Costs:
    """Costs of runs, and the use of their lanes."""

    compile_s: float = 0.0  # seconds spent compiling, or loading compiled programs
    run_s: float = 0.0  # seconds in which compiled programs ran
    engine: str = "serial"
    devices: int = 1
    lanes: int = 1  # most runs at a time on one device; in the serial engine one a worker
    interrupted: bool = False  # whether Ctrl-C ended it early; what was finished then is there
    advanced: int = 0  # lanes that advanced, over all turns
    room: int = 0  # lanes that could have

    def plus(self, later: "Costs") -> "Costs":
        """Add the costs of two runs, one after the other."""
        total = dataclasses.replace(later)
        for name in ("compile_s", "run_s", "advanced", "room"):
            setattr(total, name, getattr(self, name) + getattr(later, name))
        total.engine = (
            later.engine if self.engine == later.engine or not self.run_s else f"{self.engine}+{later.engine}"
        )
        total.interrupted = self.interrupted or later.interrupted
        return total

    @property
    def useful(self) -> float | None:
        """Share of the lanes that advanced, over all turns; None if none could, as in the serial engine."""
        return self.advanced / self.room if self.room else None


class Resources(NamedTuple):
    """Resources for making runs."""

    engine: str
    devices: list[Any]  # `jax.Device`
    workers: int  # threads of the serial engine
    lanes: int | None  # on each device in lockstep; None: as many as its memory holds
    process: int
    processes: int

    def own(self, n: int) -> np.ndarray:
        """Return numbers of the runs, of n, that this process makes: int array."""
        return np.arange(self.process, n, self.processes)


def own_cores() -> int:
    """Return CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cpu_devices() -> list[Any]:
    """Return the CPU as JAX devices; none if `JAX_PLATFORMS` excludes it."""
    try:
        return jax.local_devices(backend="cpu")
    except RuntimeError:
        return []


def require_32_bits() -> None:
    """Refuse jax's 64-bit mode, which may be switched on at any time.

    Raises:
      InputError: saying so.
    """
    if jax.config.values["jax_enable_x64"]:
        raise InputError("jax_enable_x64 is on, and jexplore computes in 32 bits: switch it off")


def find_resources(*, engine: str | None = None, lanes: int | None = None, workers: int | None = None) -> Resources:
    """Find the available resources and apply the request. Starts JAX.

    Args:
      engine: one of `ENGINES`; by default serial, or lockstep for lanes on an accelerator and without a CPU in JAX.
      lanes: lanes on each device in lockstep; by default as many as its memory holds, at most 4096.
      workers: threads of the serial engine on one device; by default the CPU cores that this process may use.

    Returns:
      `Resources`. The serial engine always uses the CPU.

    Raises:
      InputError: an engine that does not exist, lanes or workers out of range, lanes for the serial engine, the serial
        engine where `JAX_PLATFORMS` leaves out the CPU, 64-bit mode.
    """
    require_32_bits()
    if engine is not None and engine not in ENGINES:
        raise InputError(f"engine must be one of {', '.join(ENGINES)}, got {engine!r}")
    for name, value in (("lanes", lanes), ("workers", workers)):
        if value is not None:
            require_setting(name, value)
    cores = own_cores()
    start_backend(workers or cores)  # before anything else asks JAX for its devices
    devices, processes = jax.local_devices(), jax.process_count()
    on_cpu = devices[0].platform == "cpu"
    if engine is None:
        engine = "lockstep" if not on_cpu and (lanes is not None or not cpu_devices()) else "serial"
    if lanes is not None and engine == "serial":
        raise InputError(f"lanes are for the engine lockstep, got {lanes} for serial")
    if engine == "serial" and not on_cpu:
        devices = cpu_devices()
        if not devices:
            asked = jax.config.values["jax_platforms"]
            raise InputError(f"JAX_PLATFORMS must list cpu for the engine serial, got {asked!r}")
    workers = (workers or cores) if len(devices) == 1 else 1
    return Resources(engine, devices, workers, lanes, jax.process_index(), processes)


def run_all(
    lines: Sequence[Line],
    resources: Resources,
    on_progress: Callable[[int], object] | None = None,
    on_line: Callable[[int], object] | None = None,
) -> Costs:
    """Make every run of every line.

    A run's result depends on its scene, program, numbers, task and key, not on what else runs, nor on the engine, or
    the number of lanes, cores, devices or processes.

    Ctrl-C ends it early: the lines then hold the finished runs; without any, the interruption is raised.

    Args:
      lines: list of `Line`, each with at least one run. In every process the same, but for `which`.
      resources: `Resources`.
      on_progress: called regularly with the number of finished runs, from the calling thread.
      on_line: called from the calling thread with the number of a line once all its runs have come back: soon after,
        or, if several processes share the work, at the end.

    Returns:
      `Costs`.

    Raises:
      MemoryError: a device's memory does not suffice, not even for half the lanes.
    """
    told = set()

    def tell():
        for i, line in enumerate(lines):
            if on_line is not None and i not in told and line.finished[line.which].all():
                told.add(i)
                on_line(i)

    def progress(done):
        if on_progress is not None:
            on_progress(done)
        if resources.processes == 1:
            tell()

    costs = Costs(engine=resources.engine, devices=len(resources.devices) * resources.processes)
    try:
        if resources.engine == "serial":
            costs.lanes = resources.workers
            serial.run_lines(lines, resources.devices, resources.workers, costs, progress)
        else:
            lockstep.run_lines(lines, resources.devices, resources.lanes, costs, progress)
    except KeyboardInterrupt:
        if resources.processes > 1 or not any(line.finished.any() for line in lines):
            raise
        costs.interrupted = True
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" in str(error):
            raise MemoryError(str(error)) from error
        raise
    _make_room(lines, resources.processes > 1)
    if resources.processes > 1:
        _across_processes(lines)
    tell()
    return costs


def _make_room(lines, with_kept):
    """Allocate results of untouched lines, and their records."""
    known = {}
    for line in lines:
        if line.results is None or (with_kept and line.kept is None):
            if line.kind not in known:
                known[line.kind] = line.shapes()
            shapes = known[line.kind]
            line.make_room(shapes[0])
            if with_kept:
                line.kept = jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), shapes[1])


def _across_processes(lines):
    """Gather the results of all processes in every process."""
    from jax.experimental import multihost_utils

    def total(parts):  # every run was made in one process, zeros elsewhere
        return np.asarray(parts).sum(axis=0, dtype=parts.dtype)

    for line in lines:
        line.results, line.finished = jax.tree.map(
            total, multihost_utils.process_allgather((line.results, line.finished))
        )
        line.kept = multihost_utils.broadcast_one_to_all(line.kept)  # from the first process, which makes the first run
