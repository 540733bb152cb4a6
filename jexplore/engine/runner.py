"""Many runs: on the cores of a CPU one after the other, on an accelerator in lanes, with equal results.

A run is sequential and full of decisions. A CPU core makes runs one at a time with true control flow (`one_by_one`):
threads share one compiled program, and XLA releases the interpreter lock. An accelerator needs thousands of runs at
once (`lanes`). Several devices share the work through `shard_map`, each with its own part and no word between them;
several processes (`jax.distributed`) do as well.
"""

import dataclasses
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jexplore.config import InputError, require_engine, require_setting
from jexplore.engine.backend import start_backend
from jexplore.engine.lanes import run_in_lanes
from jexplore.engine.one_by_one import run_one_by_one
from jexplore.engine.program import Line


@dataclasses.dataclass
class Costs:
    """Costs of runs, and the use of their lanes."""

    compile_s: float = 0.0  # seconds spent compiling, or loading compiled programs
    run_s: float = 0.0  # seconds in which compiled programs ran
    engine: str = "auto"  # that was asked for
    levels: dict[str, list[str]] = dataclasses.field(default_factory=dict)  # name of a strategy -> what ran it
    why_not: list[str] = dataclasses.field(default_factory=list)  # lines: why there was no native code
    devices: int = 1
    lanes: int = 1  # most runs at a time on one device; one a worker where they come one after the other
    interrupted: bool = False  # whether Ctrl-C ended it early; what was finished then is there
    advanced: int = 0  # lanes that advanced, over all turns
    room: int = 0  # lanes that could have

    def plus(self, later: "Costs") -> "Costs":
        """Add the costs of two runs, one after the other."""
        total = dataclasses.replace(later)
        for name in ("compile_s", "run_s", "advanced", "room"):
            setattr(total, name, getattr(self, name) + getattr(later, name))
        names = dict.fromkeys([*self.levels, *later.levels])
        total.levels = {name: _joined(self.levels.get(name, ()), later.levels.get(name, ())) for name in names}
        total.why_not = _joined(self.why_not, later.why_not)
        total.interrupted = self.interrupted or later.interrupted
        return total

    @property
    def useful(self) -> float | None:
        """Share of the lanes that advanced, over all turns; None where runs come one after the other."""
        return self.advanced / self.room if self.room else None


def _joined(*lists):
    """Return the values of several lists, each once."""
    return list(dict.fromkeys(one for own in lists for one in own))


class Resources(NamedTuple):
    """Resources for making runs."""

    devices: list[Any]  # `jax.Device`
    in_lanes: bool  # whether runs advance together in lanes; else they come one after the other
    workers: int  # threads that make one run after the other
    lanes: int | None  # on each device; None: as many as its memory holds
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


def find_resources(
    *, engine: str = "auto", lanes: int | None = None, workers: int | None = None, in_lanes: bool | None = None
) -> Resources:
    """Find the devices, lanes and workers to run with. Starts JAX.

    Args:
      engine: one of `config.ENGINES`: "auto" takes the CPU where JAX has it, "jax" the devices that JAX puts first.
      lanes: lanes on each device; by default as many as its memory holds, at most 4096.
      workers: threads that make one run after the other on one device; by default the CPU cores that this process may
        use.
      in_lanes: True: lanes on the devices that JAX puts first, whatever they are; False: one run after the other on
        the CPU; None: lanes where the engine's devices are no CPU.

    Returns:
      `Resources`.

    Raises:
      InputError: an engine that does not exist, lanes or workers out of range, lanes where there are none to set, no
        CPU where it is needed because `JAX_PLATFORMS` leaves it out, 64-bit mode.
    """
    require_32_bits()
    require_engine(engine, lanes)
    if workers is not None:
        require_setting("workers", workers)
    cores = own_cores()
    start_backend(workers or cores)  # before anything else asks JAX for its devices
    devices, processes = jax.local_devices(), jax.process_count()
    if not in_lanes and (engine == "auto" or in_lanes is False):
        devices = cpu_devices() or devices
    on_cpu = devices[0].platform == "cpu"
    if in_lanes is None:
        in_lanes = not on_cpu
    if not in_lanes and not on_cpu:
        asked = jax.config.values["jax_platforms"]
        raise InputError(f"JAX_PLATFORMS must list cpu, where runs are made one after the other, got {asked!r}")
    if lanes is not None and not in_lanes:
        raise InputError(f"lanes are for a GPU, got {lanes} on a CPU")
    workers = (workers or cores) if len(devices) == 1 else 1
    return Resources(devices, in_lanes, workers, lanes, jax.process_index(), processes)


def level_of(line: Line, resources: Resources) -> str:
    """Name what runs a line."""
    if resources.in_lanes:
        return "JAX in lanes"
    return "JAX" if line.program.drive is None else "native driving"


def run_all(
    lines: Sequence[Line],
    resources: Resources,
    on_progress: Callable[[int], object] | None = None,
    on_line: Callable[[int], object] | None = None,
) -> Costs:
    """Make every run of every line.

    A run's result depends on its scene, program, numbers, task and key, not on what else runs, nor on the number
    of lanes, cores, devices or processes.

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

    costs = Costs(devices=len(resources.devices) * resources.processes)
    try:
        if resources.in_lanes:
            run_in_lanes(lines, resources.devices, resources.lanes, costs, progress)
        else:
            costs.lanes = resources.workers
            run_one_by_one(lines, resources.devices, resources.workers, costs, progress)
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
