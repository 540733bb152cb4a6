"""Units of a sweep as tasks of a Ray cluster: done again where a worker dies, handed over in the driver as they come.

Ray is imported by the functions that need it.
"""

import collections
import contextlib
import dataclasses
import os
import pickle
import platform
import time
import uuid
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax

from jexplore.arrays.files import first_line
from jexplore.config import InputError, require_whole
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.engine.runner import Costs
from jexplore.policies.catalogue.entries import STRATEGIES, offered, register
from jexplore.studies.checks import ready_strategies
from jexplore.studies.metrics import ready_metrics
from jexplore.studies.results.provenance import digest
from jexplore.studies.sweeps.connection import connected, require_ray
from jexplore.studies.sweeps.plan import Plan
from jexplore.studies.sweeps.work import run_block_units, windows
from jexplore.version import __version__

if TYPE_CHECKING:
    import pandas as pd

RETRIES = 5  # times that a task is sent again whose worker has died
AHEAD = 2  # tasks sent for every one that can run: the next one waits at the worker, and no more results than these
LOOK_S = 5.0  # seconds after which it is looked again how large the cluster is


class Order(NamedTuple):
    """Data of a sweep that workers get once."""

    plan: Plan  # without its strategies and metrics, which workers make from their names
    strategies: list[str]
    registered: dict[str, Any]  # what names that were given in the driver stand for
    folder: str  # where the driver stands: names of files and modules are meant from there
    cpus: int
    gpus: int


class Made(NamedTuple):
    """Result of a task."""

    tables: "dict[int, pd.DataFrame]"  # number of a unit -> its table
    costs: Costs


_prepared: dict[str, tuple[Order, Plan]] = {}  # in a worker: the sweep it works for


def make_units(key: str, version: str, sent: list[Any], numbers: Sequence[int]) -> Made:
    """Make units of a sweep, in a worker.

    Args:
      key: of the sweep.
      version: of the driver's jexplore.
      sent: list of one reference to its `Order`.
      numbers: of the units.

    Returns:
      `Made`.

    Raises:
      InputError: this worker has another version or another world than the driver, or not what the sweep needs.
    """
    if key not in _prepared:
        _prepared.clear()
        _prepared[key] = _prepare(version, sent[0])
    order, plan = _prepared[key]
    _require_same_worlds(plan, numbers)
    tables: dict[int, Any] = {}
    how: dict[str, Any] = {"in_lanes": True} if order.gpus else {"workers": order.cpus}
    costs = run_block_units(plan, numbers, tables.__setitem__, **how)
    if costs.interrupted:
        raise KeyboardInterrupt
    return Made(tables, costs)


def _prepare(version, reference):
    """Prepare a worker for a sweep: its `Order` and `Plan`."""
    if version != __version__:
        raise InputError(
            f"the Ray worker on {platform.node()} has jexplore {__version__}, and the sweep is one of {version}: "
            "install the same version on every node"
        )
    ray = require_ray()
    try:
        order: Order = ray.get(reference)
    except (ImportError, ray.exceptions.RayError) as error:
        raise InputError(
            f"a strategy of the sweep does not come over to the Ray worker on {platform.node()}: {first_line(error)}; "
            "put it into a module there and name it module:function"
        ) from error
    with contextlib.suppress(OSError):  # another machine, without that folder
        os.chdir(order.folder)
    if not order.gpus:  # a node's GPU would be taken by every worker
        jax.config.update("jax_platforms", "cpu")
    start_backend(order.cpus)
    use_compilation_cache()
    for name, make in order.registered.items():
        register(name, make, replace=True)
    own = {"strategies": ready_strategies(order.strategies), "metrics": ready_metrics(order.plan.spec.metrics)}
    return order, dataclasses.replace(order.plan, **own)


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
    """Run units of a sweep as tasks of a Ray cluster.

    The cluster is the one that this process is connected to, that `RAY_ADDRESS` names, or that `ray start` has begun on
    this machine; otherwise one is started with all cores that this process may use, and ends with the call. Every node
    must have the same jexplore and find the same files of worlds under the same names; a strategy's module is searched
    in the driver's folder, if the node has it. A task whose worker dies is done again on another, up to `RETRIES`
    times.

    Args:
      plan: `Plan`.
      numbers: of the units, in order.
      on_unit: called in this process with the number of a unit and its table, as soon as it has come back; again if
        Ctrl-C interrupted the call.
      on_progress: called with the number of episodes that have come back.
      cpus: cores of a task, which makes one unit on them.
      gpus: GPUs of a task. With 1 or more it makes as many units as fit, those of JAX in lanes.

    Returns:
      `Costs`: `lanes` tasks at a time; `run_s` seconds by the clock, less those of compiling in every worker;
      `interrupted` after Ctrl-C.

    Raises:
      InputError: Ray is not installed, cannot be reached or has no such node; a worker's own refusal; a task whose
        workers die again and again.
      MemoryError: a worker's memory does not suffice.
    """
    cpus, gpus = require_whole("cpus", cpus, 1, 2**16), require_whole("gpus", gpus, 0, 2**10)
    ray = require_ray()
    if not numbers:
        return Costs(engine="ray")
    tasks = list(windows(plan, numbers)) if gpus else [[number] for number in numbers]
    sweep = _Sweep(ray, plan, cpus, gpus, on_unit, on_progress)
    began = time.perf_counter()
    try:
        with connected(ray) as is_own:
            began = time.perf_counter()
            try:
                sweep.run(tasks)
            finally:
                if not is_own:  # else all that runs ends with the connection
                    sweep.cancel()
            return sweep.total(time.perf_counter() - began)
    except KeyboardInterrupt:
        return sweep.total(time.perf_counter() - began, interrupted=True)


class _Sweep:
    """A sweep under way, in the driver."""

    def __init__(self, ray, plan, cpus, gpus, on_unit, on_progress):
        self.ray, self.plan, self.cpus, self.gpus = ray, plan, cpus, gpus
        self.on_unit, self.on_progress = on_unit, on_progress
        self.running: dict[Any, list[int]] = {}  # reference of a task -> its units
        self.costs, self.done, self.room = Costs(), 0, 1

    def run(self, tasks):
        """Run tasks, lists of units."""
        ray, waiting = self.ray, collections.deque(tasks)
        self.room, looked = self._room(), time.perf_counter()
        try:
            # A list holds the reference back from being fetched anew with every task.
            sent = [self._sent()]
            # Without max_calls Ray begins a new process, which compiles anew, for every task that has a GPU.
            resources = {"num_cpus": self.cpus, "num_gpus": self.gpus, "max_calls": 0}
            retried = {"max_retries": RETRIES, "retry_exceptions": [OSError, MemoryError]}
            make, key = ray.remote(**resources, **retried)(make_units), uuid.uuid4().hex
            while waiting or self.running:
                if time.perf_counter() - looked > LOOK_S:
                    self.room, looked = self._room() or self.room, time.perf_counter()
                while waiting and len(self.running) < AHEAD * self.room:
                    units = waiting.popleft()
                    self.running[make.remote(key, __version__, sent, units)] = units
                for reference in ray.wait(list(self.running), timeout=LOOK_S)[0]:
                    self._take(reference)
        except KeyboardInterrupt:
            self._take_finished()
            raise

    def cancel(self):
        """End the tasks that still run.

        One that has just ended must be left alone: Ray's own books would not agree, and it would end this process.
        """
        if not self.running:
            return
        with contextlib.suppress(Exception):  # the cluster may be gone
            for reference in self.ray.wait(list(self.running), num_returns=len(self.running), timeout=0)[1]:
                self.ray.cancel(reference, force=True)

    def total(self, spent_s, *, interrupted=False):
        """Return the `Costs` of all finished tasks."""
        costs = dataclasses.replace(self.costs, engine="ray", interrupted=interrupted)
        costs.lanes = costs.lanes if self.gpus else self.room
        costs.devices = self.room * self.gpus if self.gpus else 1
        costs.compile_s /= self.room
        costs.run_s = max(spent_s - costs.compile_s, 0.0)
        return costs

    def _sent(self):
        names = [strategy.name for strategy in self.plan.strategies]
        heads = {name.partition(":")[0].partition("+")[0] for name in names}
        own = {head: entry.make for head in heads if (entry := STRATEGIES.get(head)) and entry.is_own}
        registered = {head: make for head, make in own.items() if head not in offered()}
        bare = dataclasses.replace(self.plan, strategies=[], metrics={})
        try:
            return self.ray.put(Order(bare, names, registered, os.getcwd(), self.cpus, self.gpus))
        except (TypeError, pickle.PicklingError) as error:
            raise InputError(
                f"strategies that were registered here cannot be sent to Ray workers ({', '.join(registered)}): put "
                "them into a module and name them module:function"
            ) from error

    def _room(self):
        """Return the number of tasks that the cluster can run at a time."""
        nodes = [node["Resources"] for node in self.ray.nodes() if node["Alive"]]
        fit = [int(node.get("CPU", 0) // self.cpus) for node in nodes]
        if self.gpus:
            fit = [min(n, int(node.get("GPU", 0) // self.gpus)) for n, node in zip(fit, nodes)]
        if not sum(fit) and not self.running:
            what = f"{self.cpus} cores" + (f" and {self.gpus} GPUs" if self.gpus else "")
            raise InputError(f"no node of the Ray cluster has {what}, which a task is to have")
        return sum(fit)

    def _take(self, reference):
        """Hand over the results of a task."""
        try:
            made = self._made(reference, self.running[reference])
        except Exception:
            del self.running[reference]
            raise
        for number, table in made.tables.items():
            self.on_unit(number, table)
        del self.running[reference]
        self.costs = self.costs.plus(made.costs)
        self.done += sum(len(table) for table in made.tables.values())
        if self.on_progress is not None:
            self.on_progress(self.done)

    def _take_finished(self):
        """Hand over the results that have come back by now."""
        errors = self.ray.exceptions.RayError
        if not self.running:
            return
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
        except errors.WorkerCrashedError as error:
            raise InputError(
                f"{_called(numbers)} of the sweep could not be made: {RETRIES + 1} workers have died of it; is there "
                "enough memory for a worker on every core?"
            ) from error
        except errors.RayError as error:
            raise InputError(f"the Ray cluster is lost, or a part of it: {first_line(error)}") from error


def _called(numbers):
    return f"unit {numbers[0]}" if len(numbers) == 1 else f"units {numbers[0]} to {numbers[-1]}"
