"""How long a run in lockstep would take on a device: launches, waits and bytes counted, their costs assumed."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from jexplore.bench.ahead import launches
from jexplore.bench.ahead.hlo import Module
from jexplore.bench.ahead.launches import Graph, Launch, Loop, Step
from jexplore.bench.ahead.schedule import Plans, Schedule
from jexplore.bench.ahead.targets import REACHED, Target
from jexplore.config import Assumptions
from jexplore.engine.lanes import SPAN
from jexplore.reach import ROUNDS, STRAIGHT


class Turns(NamedTuple):
    """How often a loop is met, and how often it goes round, in a whole run."""

    entries: float
    iterations: float


@dataclasses.dataclass
class Seconds:
    """Where time goes."""

    syncs: float = 0.0
    launches: float = 0.0
    memory: float = 0.0
    atomics: float = 0.0
    n_syncs: float = 0.0  # how often the host waited
    instructions: float = 0.0  # what kernels take beyond moving bytes, as they execute more than that hides

    def plus(self, other: "Seconds", times: float = 1.0) -> Self:
        """With so many times another, added in place."""
        for field in dataclasses.fields(self):
            name = field.name
            setattr(self, name, getattr(self, name) + times * getattr(other, name))
        return self

    @property
    def total(self) -> float:
        """All together."""
        return self.syncs + self.launches + self.memory + self.atomics + self.instructions


def loop_turns(recorded: Sequence[Plans], schedule: Schedule) -> dict[str, Turns]:
    """How often each loop of a run goes round, by its scope. What is not listed goes round once.

    Args:
      recorded: list of `Plans`.
      schedule: `Schedule` of them.
    """
    farthest = float(np.mean([plans.cost[-1] for plans in recorded if len(plans.cost)] or [0]))
    spans, fills = schedule.turns / SPAN, schedule.fills
    return {
        "": Turns(1, spans),
        "fill": Turns(spans, fills),
        "fill/flood": Turns(fills, fills * (farthest / (2 * ROUNDS * STRAIGHT) + 2)),
    }


class Estimator:
    """What the steps of a program cost."""

    def __init__(
        self,
        module: Module,
        target: Target,
        assume: Assumptions,
        turns: Mapping[str, Turns],
        kernels: Mapping[str, str] | None = None,
    ) -> None:
        """`turns`: how often its loops go round, from `loop_turns`; `kernels`: name -> PTX."""
        self.instructions = {name: launches.instructions_of(text) for name, text in (kernels or {}).items()}
        rate = assume.bandwidth_tb_s
        self.module, self.target, self.assume, self.turns = module, target, assume, turns
        self.rate = target.bandwidth * REACHED if rate is None else 1e12 * rate
        self.by_scope: dict[str, Seconds] = {}  # what each loop costs in the whole run, without those in it

    def run(self, steps: Iterable[Step]) -> Seconds:
        """A whole run of a program: `Seconds`."""
        self.by_scope = {"": Seconds()}
        self._steps(steps, 1.0, "", False)
        total = Seconds()
        for one in self.by_scope.values():
            total.plus(one)
        return total

    def _steps(self, steps, times, scope, in_graph):
        for step in steps:
            if isinstance(step, Launch):
                self.by_scope[scope].plus(self._launch(step, in_graph), times)
            elif isinstance(step, Graph):
                self.by_scope[scope].launches += times * self.assume.graph_us * 1e-6
                self._steps(step.steps, times, scope, True)
            elif step.trips is not None:
                self._steps(step.body, times * step.trips, scope, in_graph)
            else:
                self._loop(step, times, in_graph)

    def _loop(self, loop: Loop, times, in_graph):
        turns = self.turns.get(loop.scope, Turns(times, times))
        looks = turns.entries + turns.iterations
        own = self.by_scope.setdefault(loop.scope, Seconds())
        if not in_graph:
            own.plus(Seconds(syncs=self.assume.sync_us * 1e-6, n_syncs=1), looks)
        self._steps(loop.condition, looks, loop.scope, in_graph)
        self._steps(loop.body, turns.iterations, loop.scope, in_graph)

    def _launch(self, step: Launch, in_graph):
        moved = self.module.traffic(step.name)
        share = min(1.0, step.blocks / self.target.cores) if step.blocks else 1.0
        memory = moved.n_bytes / (self.rate * share)
        executed = step.threads * self.instructions.get(step.kernel, 0)
        return Seconds(
            launches=1e-6 * (self.assume.node_us if in_graph else self.assume.launch_us),
            memory=memory,
            atomics=moved.atomics / (1e9 * self.assume.atomics_g_s * share),
            instructions=max(0.0, executed / (1e12 * self.assume.instructions_t_s * share) - memory),
        )
