"""Units of a sweep as tasks of a Ray cluster: done again where a worker dies, handed over in the driver as they come.

Ray is imported by the functions that need it.
"""

import collections
import contextlib
import dataclasses
import logging
import os
import platform
import signal
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax

from jexplore.config import InputError, require_whole
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.engine.runner import Costs, own_cores
from jexplore.policies.catalogue.own import first_line
from jexplore.studies.checks import ready_strategies
from jexplore.studies.results.provenance import digest
from jexplore.studies.sweeps.plan import Plan
from jexplore.studies.sweeps.work import added, run_block_units, windows
from jexplore.version import __version__

if TYPE_CHECKING:
    import pandas as pd

RETRIES = 5  # times that a task is sent again whose worker has died
AHEAD = 2  # tasks sent for every one that can run: the next one waits at the worker, and no more results than these
LOOK_S = 5.0  # seconds after which it is looked again how large the cluster is
STORE_BYTES = 256 * 2**20  # of results, in a cluster of our own


class Order(NamedTuple):
    """What workers get of a sweep, once."""

    plan: Plan  # without its strategies, which workers make from their names
    strategies: list[str]
    version: str
    folder: str  # where the driver stands: names of files and modules are meant from there
    cpus: int
    gpus: int


class Made(NamedTuple):
    """What a task returns."""

    tables: "dict[int, pd.DataFrame]"  # number of a unit -> its table
    costs: Costs


_prepared: dict[str, tuple[Order, Plan]] = {}  # in a worker: the sweep it works for


def make_units(key: str, sent: "list[Any]", numbers: Sequence[int]) -> Made:
    """Makes units of a sweep: what runs in a worker.

    Args:
      key: of the sweep.
      sent: list of one reference to its `Order`.
      numbers: of the units.

    Returns:
      `Made`.

    Raises:
      InputError: this worker has another version or another world than the driver, or not what the sweep needs.
    """
    if key not in _prepared:
        _prepared.clear()
        _prepared[key] = _prepare(sent[0])
    order, plan = _prepared[key]
    _require_same_worlds(plan, numbers)
    tables: dict[int, Any] = {}
    how: dict[str, Any] = {} if order.gpus else {"engine": "serial", "workers": order.cpus}
    costs = run_block_units(plan, numbers, tables.__setitem__, **how)
    if costs.interrupted:
        raise KeyboardInterrupt
    return Made(tables, costs)


def _prepare(reference):
    """A worker made ready for a sweep: its `Order` and `Plan`."""
    import ray

    order = ray.get(reference)
    if order.version != __version__:
        raise InputError(
            f"the Ray worker on {platform.node()} has jexplore {__version__}, and the sweep is one of {order.version}: "
            "install the same version on every node"
        )
    with contextlib.suppress(OSError):  # another machine, without that folder
        os.chdir(order.folder)
    if not order.gpus:  # a node's GPU would be taken by every worker
        jax.config.update("jax_platforms", "cpu")
    start_backend(order.cpus)
    use_compilation_cache()
    return order, dataclasses.replace(order.plan, strategies=ready_strategies(order.strategies))


def _require_same_worlds(plan, numbers):
    sizes = list(dict.fromkeys(cell_m for _, cell_m, _, _ in plan.records))
    blocks = [block for number in numbers for block in plan.units[number]]
    for world, cell_m in {(block.world, plan.records[block.setting][1]): None for block in blocks}:
        if digest(plan.world(world, cell_m)) != plan.digests[world * len(sizes) + sizes.index(cell_m)]:
            raise InputError(
                f"{os.fspath(plan.spec.worlds[world])!r} is another world for the Ray worker on {platform.node()} than "
                "here: every node must have the same file, in the same place"
            )


def run_units(
    plan: Plan,
    numbers: Sequence[int],
    on_unit: Callable[[int, "pd.DataFrame"], object],
    *,
    on_progress: Callable[[int], object] | None = None,
    cpus: int = 1,
    gpus: int = 0,
) -> Costs:
    """Runs units of a sweep as tasks of a Ray cluster.

    The cluster is the one that this process is connected to, that `RAY_ADDRESS` names, or that `ray start` has begun
    on this machine; where there is none, one is started with all cores that this process may use, and ends with the
    call. Every node must have the same jexplore and find the same files of worlds under the same names; a strategy's
    module is looked for in the driver's folder, where the node has it. A task whose worker dies is done again on
    another, up to `RETRIES` times.

    Args:
      plan: `Plan`.
      numbers: of the units, in order.
      on_unit: called in this process with the number of a unit and its table, as soon as it has come back.
      on_progress: called with the number of episodes that have come back.
      cpus: cores of a task, which makes one unit with the engine serial.
      gpus: GPUs of a task. With 1 or more it makes as many units as fit, in lockstep.

    Returns:
      `Costs`: `lanes` tasks at a time; `run_s` seconds by the clock, less those of compiling in every worker;
      `interrupted` after Ctrl-C.

    Raises:
      InputError: Ray is not installed, cannot be reached or has no such node; what a worker refuses; a task whose
        workers die again and again.
      MemoryError: a worker's memory does not suffice.
    """
    cpus, gpus = require_whole("cpus", cpus, 1, 2**16), require_whole("gpus", gpus, 0, 2**10)
    ray = _ray()
    if not numbers:
        return Costs(engine="ray")
    tasks = list(windows(plan, numbers)) if gpus else [[number] for number in numbers]
    sweep = _Sweep(ray, plan, cpus, gpus, on_unit, on_progress)
    with _connected(ray):
        return sweep.run(tasks)


class _Sweep:
    """A sweep under way, in the driver."""

    def __init__(self, ray, plan, cpus, gpus, on_unit, on_progress):
        self.ray, self.plan, self.cpus, self.gpus = ray, plan, cpus, gpus
        self.on_unit, self.on_progress = on_unit, on_progress
        self.running: dict[Any, list[int]] = {}  # reference of a task -> its units
        self.costs, self.done = Costs(), 0

    def run(self, tasks):
        """Runs tasks, lists of units: `Costs`."""
        ray, waiting, began = self.ray, collections.deque(tasks), time.perf_counter()
        names = [strategy.name for strategy in self.plan.strategies]
        bare = dataclasses.replace(self.plan, strategies=[])
        room, looked = self._room(), time.perf_counter()
        interrupted = False
        try:
            # A list holds the reference back from being fetched anew with every task.
            sent = [ray.put(Order(bare, names, __version__, os.getcwd(), self.cpus, self.gpus))]
            # Without max_calls Ray begins a new process, which compiles anew, for every task that has a GPU.
            resources = {"num_cpus": self.cpus, "num_gpus": self.gpus, "max_calls": 0}
            retried = {"max_retries": RETRIES, "retry_exceptions": [OSError, MemoryError]}
            make, key = ray.remote(**resources, **retried)(make_units), uuid.uuid4().hex
            while waiting or self.running:
                if time.perf_counter() - looked > LOOK_S:
                    room, looked = self._room() or room, time.perf_counter()
                while waiting and len(self.running) < AHEAD * room:
                    units = waiting.popleft()
                    self.running[make.remote(key, sent, units)] = units
                for reference in ray.wait(list(self.running), timeout=LOOK_S)[0]:
                    self._take(reference)
        except KeyboardInterrupt:
            interrupted = True
            self._take_finished()
        finally:
            for reference in self.running:
                with contextlib.suppress(Exception):  # the cluster may be gone
                    ray.cancel(reference, force=True)
        costs = dataclasses.replace(self.costs, engine="ray", interrupted=interrupted)
        costs.lanes = costs.lanes if self.gpus else room
        costs.devices = room * self.gpus if self.gpus else 1
        costs.compile_s /= room
        costs.run_s = max(time.perf_counter() - began - costs.compile_s, 0.0)
        return costs

    def _room(self):
        """Tasks that the cluster can run at a time."""
        nodes = [node["Resources"] for node in self.ray.nodes() if node["Alive"]]
        fit = [int(node.get("CPU", 0) // self.cpus) for node in nodes]
        if self.gpus:
            fit = [min(n, int(node.get("GPU", 0) // self.gpus)) for n, node in zip(fit, nodes)]
        if not sum(fit) and not self.running:
            what = f"{self.cpus} cores" + (f" and {self.gpus} GPUs" if self.gpus else "")
            raise InputError(f"no node of the Ray cluster has {what}, which a task is to have")
        return sum(fit)

    def _take(self, reference):
        """Hands over what a task has made."""
        numbers = self.running[reference]
        made = self._made(reference, numbers)
        for number, table in made.tables.items():
            self.on_unit(number, table)
        del self.running[reference]
        self.costs = added(self.costs, made.costs)
        self.done += sum(len(table) for table in made.tables.values())
        if self.on_progress is not None:
            self.on_progress(self.done)

    def _take_finished(self):
        """Hands over what has come back by now."""
        errors = self.ray.exceptions.RayError
        with contextlib.suppress(errors, InputError, MemoryError):  # it is the interruption that is told
            for reference in self.ray.wait(list(self.running), num_returns=len(self.running), timeout=0)[0]:
                self._take(reference)

    def _made(self, reference, numbers):
        errors = self.ray.exceptions
        try:
            return self.ray.get(reference)
        except errors.RayTaskError as error:
            if isinstance(error.cause, (InputError, MemoryError)):
                raise error.cause from None
            if "failed to import" in str(error):
                raise InputError(
                    f"a Ray worker cannot import jexplore {__version__}: every node must have it"
                ) from error
            raise
        except errors.OutOfMemoryError as error:
            raise MemoryError(first_line(error)) from error
        except errors.RayError as error:
            which = f"unit {numbers[0]}" if len(numbers) == 1 else f"units {numbers[0]} to {numbers[-1]}"
            raise InputError(
                f"{which} could not be made, tried {RETRIES + 1} times: {first_line(error)} (the other units that are "
                "finished are kept; is there enough memory for a worker on every core?)"
            ) from error


def _ray():
    try:
        import ray
        import ray.exceptions
    except ImportError:
        raise InputError("the engine ray needs Ray: pip install 'jexplore[ray]'") from None
    return ray


@contextlib.contextmanager
def _connected(ray) -> Iterator[None]:
    """A connection to a cluster, for a while, unless there is one already."""
    if ray.is_initialized():
        yield
        return
    try:
        with _handlers_kept():
            _connect(ray)
        yield
    finally:
        ray.shutdown()


def _connect(ray):
    quiet = {"log_to_driver": False, "logging_level": logging.CRITICAL, "include_dashboard": False}
    try:
        try:
            ray.init(num_cpus=own_cores(), object_store_memory=STORE_BYTES, **quiet)
        except ValueError as error:
            if "existing cluster" not in str(error):
                raise
            ray.init(**quiet)  # there is one, which knows its own cores
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        where = os.environ.get("RAY_ADDRESS")
        raise InputError(
            f"no Ray cluster {'at RAY_ADDRESS=' + where if where else 'can be reached or started here'}: "
            f"{first_line(error)}"
        ) from error


@contextlib.contextmanager
def _handlers_kept():
    """Ray puts a handler of its own in the place of the one for SIGTERM."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)
