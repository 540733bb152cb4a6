"""Many runs: on the cores of a CPU one after the other, on an accelerator in lanes, with equal results.

A run is sequential and full of decisions. A CPU core makes runs one at a time with true control flow (`one_by_one`):
threads share one compiled program, and XLA releases the interpreter lock. An accelerator needs thousands of runs at
once (`lanes`).
"""

import abc
import dataclasses
import os
import re
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax

from jexplore.config import InputError, require_engine, require_setting
from jexplore.engine.backend import start_backend
from jexplore.engine.devices import Device
from jexplore.engine.lanes import run_in_lanes
from jexplore.engine.one_by_one import pieces_of
from jexplore.engine.program import Line, Runs
from jexplore.engine.threads import Pieces, share_out

_RAISED = re.compile(r'.*CpuCallback.*File "([^"]*)", line (\d+), in [^\n]*\n([^\n]*)', re.DOTALL)
"""Message of JAX for what a callback has raised: its last frame and error."""


@dataclasses.dataclass
class Costs:
    """Costs of runs."""

    compile_s: float = 0.0  # seconds spent compiling, or loading compiled programs
    run_s: float = 0.0  # seconds in which compiled programs ran
    engine: str = "auto"  # that was asked for
    levels: dict[str, list[str]] = dataclasses.field(default_factory=dict[str, list[str]])  # strategy -> what ran it
    why_not: list[str] = dataclasses.field(default_factory=list[str])  # lines: why there was no native code
    lanes: int = 1  # most runs at a time; one a worker where they come one after the other
    interrupted: bool = False  # whether Ctrl-C ended it early; what was finished then is there

    def plus(self, later: "Costs") -> "Costs":
        """Add the costs of two runs, one after the other."""
        names = dict.fromkeys([*self.levels, *later.levels])
        return dataclasses.replace(
            later,
            compile_s=self.compile_s + later.compile_s,
            run_s=self.run_s + later.run_s,
            levels={name: _joined(self.levels.get(name, ()), later.levels.get(name, ())) for name in names},
            why_not=_joined(self.why_not, later.why_not),
            interrupted=self.interrupted or later.interrupted,
        )


def _joined(*lists: Iterable[str]) -> list[str]:
    """Return the values of several lists, each once."""
    return list(dict.fromkeys(one for own in lists for one in own))


class OwnRuns(Runs, abc.ABC):
    """Runs that make themselves, piece by piece, on the cores of a CPU: in native code."""

    @abc.abstractmethod
    def pieces(self) -> Pieces:
        """Return the rest."""

    @abc.abstractmethod
    def give_up(self) -> None:
        """Make calls that are under way return soon."""


class Resources(NamedTuple):
    """Resources for making runs."""

    device: Device | None  # None: native code alone
    in_lanes: bool  # whether runs advance together in lanes; else they come one after the other
    workers: int  # threads that make one run after the other
    lanes: int | None  # None: as many as the device's memory holds


def on_cores(workers: int | None = None) -> Resources:
    """Return resources for runs in native code alone: threads, by default one a core. JAX is not started."""
    if workers is not None:
        require_setting("workers", workers)
    return Resources(None, False, workers or own_cores(), None)


def own_cores() -> int:
    """Return CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cpu_devices() -> list[Device]:
    """Return the CPU as JAX devices; none if `JAX_PLATFORMS` excludes it."""
    try:
        return jax.local_devices(backend="cpu")
    except RuntimeError:
        return []


def require_32_bits() -> None:
    """Refuse jax's 64-bit mode, which may be switched on at any time."""
    if jax.config.values["jax_enable_x64"]:
        raise InputError("jax_enable_x64 is on, and jexplore computes in 32 bits: switch it off")


def find_resources(
    *, engine: str = "auto", lanes: int | None = None, workers: int | None = None, in_lanes: bool | None = None
) -> Resources:
    """Find the device, lanes and workers to run with. Starts JAX.

    Args:
      engine: one of `config.ENGINES`: "auto" takes the CPU where JAX has it, "jax" the device that JAX puts first.
      lanes: by default as many as the device's memory holds, at most 4096.
      workers: threads that make one run after the other; by default the CPU cores that this process may use.
      in_lanes: True: lanes on the device that JAX puts first, whatever it is; False: one run after the other on the
        CPU; None: lanes where the engine's device is no CPU.

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
    devices = jax.local_devices()
    if not in_lanes and (engine == "auto" or in_lanes is False):
        devices = cpu_devices() or devices
    device, on_cpu = devices[0], devices[0].platform == "cpu"
    if in_lanes is None:
        in_lanes = not on_cpu
    if not in_lanes and not on_cpu:
        asked = jax.config.values["jax_platforms"]
        raise InputError(f"JAX_PLATFORMS must list cpu, where runs are made one after the other, got {asked!r}")
    if lanes is not None and not in_lanes:
        raise InputError(f"lanes are for a GPU, got {lanes} on a CPU")
    return Resources(device, in_lanes, workers or cores, lanes)


def level_of(line: Line, resources: Resources) -> str:
    """Name what runs a line."""
    if resources.in_lanes:
        return "JAX in lanes"
    return "JAX" if line.program.drive is None else "native driving"


def run_all(
    work: Sequence[Line | OwnRuns],
    resources: Resources,
    on_progress: Callable[[int], object] | None = None,
    on_finished: Callable[[int], object] | None = None,
    first: Callable[[Callable[[], object]], object] = lambda tell: None,
) -> Costs:
    """Make every run of every line.

    A run's result depends on its scene, program, numbers, task and key, not on what else runs, nor on the number
    of lanes or cores.

    Where runs come one after the other, all of `work` is made in the order given, and `threads.share_out` cuts it into
    calls. In lanes the lines come last: they have the device for themselves.

    Ctrl-C ends it early: `work` then holds the finished runs; without any, the interruption is raised.

    Args:
      work: `Line`s, each with at least one run, and `OwnRuns`.
      on_progress: called regularly with the number of finished runs, from the calling thread.
      on_finished: called from the calling thread with the number of a line soon after all its runs have come back.
      first: called before all else with a function to be called when runs have come back.

    Raises:
      MemoryError: a device's memory does not suffice for the lanes.
    """
    told: set[int] = set()

    def announce() -> None:
        for i, own in enumerate(work):
            if on_finished is not None and i not in told and own.is_finished:
                told.add(i)
                on_finished(i)

    def tell(_: int = 0) -> None:
        if on_progress is not None:
            on_progress(sum(own.n_finished for own in work))
        announce()

    lines = [own for own in work if isinstance(own, Line)]
    costs = Costs()
    try:
        first(tell)
        _run(work, lines, resources, costs, tell)
    except KeyboardInterrupt:
        if not any(own.n_finished for own in work):
            raise
        costs.interrupted = True
    except jax.errors.JaxRuntimeError as error:
        raise _plainly(error) from error
    _make_room(lines)
    announce()
    return costs


def _plainly(error: Exception) -> Exception:
    """Return the error that says what an error of JAX means; itself if that is not known."""
    if "RESOURCE_EXHAUSTED" in str(error):
        return MemoryError(f"{error} (fewer lanes need less)")
    if raised := _RAISED.match(str(error)):
        file, line, what = raised.groups()
        return InputError(f"a function that JAX calls back raised {what} at {file}:{line}")
    return error


def _run(
    work: Sequence[Line | OwnRuns], lines: list[Line], resources: Resources, costs: Costs, tell: Callable[..., None]
) -> None:
    """Run `run_all` without what comes after an interruption."""
    began, own = time.perf_counter(), [each for each in work if not isinstance(each, Line)]
    pieces: dict[int, Pieces] = {}
    if resources.device and not resources.in_lanes:
        compiled = pieces_of(lines, resources.device, resources.workers)
        pieces = {id(line): each for line, each in zip(lines, compiled)}
        costs.compile_s += time.perf_counter() - began
        began = time.perf_counter()

    def give_up() -> None:
        for each in own:
            each.give_up()

    pieces |= {id(each): each.pieces() for each in own}
    try:
        share_out([pieces[id(each)] for each in work if id(each) in pieces], resources.workers, tell, give_up)
    finally:
        costs.run_s += time.perf_counter() - began
    if resources.device and resources.in_lanes:
        run_in_lanes(lines, resources.device, resources.lanes, costs, tell)
    else:
        costs.lanes = resources.workers


def _make_room(lines: Sequence[Line]) -> None:
    """Allocate results of untouched lines."""
    shapes: dict[Any, Any] = {}
    for line in lines:
        if line.results is None:
            if line.kind not in shapes:
                shapes[line.kind] = line.shapes()
            line.make_room(shapes[line.kind])
