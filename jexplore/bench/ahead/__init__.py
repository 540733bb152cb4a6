"""What the lockstep engine would do on a device that is not there: its program compiled ahead of time, its launches,
waits and bytes counted, the use of its lanes simulated from recorded episodes, and from all that an estimate.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from jexplore.arrays.padding import bucket
from jexplore.bench.ahead import launches, program, schedule, targets
from jexplore.bench.ahead.estimate import Estimator, loop_turns
from jexplore.bench.engines import REFILLS, RULES, SEED
from jexplore.bench.tables import MIB, markdown, percent
from jexplore.bench.timing import surroundings
from jexplore.config import Assumptions, require_whole
from jexplore.engine.backend import start_backend
from jexplore.engine.lanes import SPAN
from jexplore.grid import radius_d2
from jexplore.planning import windows
from jexplore.policies import Strategy, parse_strategy
from jexplore.studies.checks import ready_worlds
from jexplore.worlds.world import World, with_ring

WORLDS, LANES, EPISODES, STRATEGY = ("cave", "hospital"), (1024, 4096), 16, "closest+recheck"
CELL_M, MAX_LANES = 0.1, 2**16
A_LANE = (1, REFILLS)  # episodes a lane in the simulated queues; the estimate is for the last
GRAPHS = {"xla_gpu_enable_command_buffer": "FUSION,CUBLAS,CUSTOM_CALL,WHILE"}  # loops over data within CUDA graphs


@dataclasses.dataclass(frozen=True)
class Agenda:
    """What is to be compiled."""

    target: str
    device: Any
    worlds: list[World]
    strategy: Strategy
    lanes: tuple[int, ...]
    episodes: int  # to be recorded in each world
    assume: Assumptions
    options: dict[str, Any]  # of XLA

    @property
    def total(self) -> int:
        """Pieces of work, of which `run` tells when one is done."""
        return len(self.worlds) * (1 + len(self.lanes))


def prepare(
    target: str,
    *,
    worlds: Iterable[str] | None = None,
    lanes: Iterable[int] | None = None,
    episodes: int | None = None,
    assume: Assumptions | None = None,
    graphs: bool = False,
) -> Agenda:
    """Checks everything, and loads the plugin. What is None has a default.

    Args:
      target: one of `targets.TARGETS`.
      worlds: names.
      lanes: lanes for which the program is compiled.
      episodes: how many are recorded in each world.
      assume: `Assumptions`.
      graphs: whether loops over data go into CUDA graphs, which XLA does not do by itself.

    Returns:
      `Agenda`.

    Raises:
      InputError: a target that is not known, what the extra `gpu-compile` installs missing or unfit, worlds or numbers
        that cannot be used.
    """
    place = targets.target_of(target)
    counts = tuple(sorted({require_whole("batch-sizes", n, 1, MAX_LANES) for n in (LANES if lanes is None else lanes)}))
    episodes = require_whole("episodes", EPISODES if episodes is None else episodes, 1, 10_000)
    device = targets.compile_only(place)
    start_backend(1)
    buildings = [with_ring(world) for world in ready_worlds(WORLDS if worlds is None else tuple(worlds), CELL_M)]
    options = dict(GRAPHS) if graphs else {}
    return Agenda(
        target, device, buildings, parse_strategy(STRATEGY), counts, episodes, assume or Assumptions(), options
    )


def run(plan: Agenda, on_progress: Callable[[int], Any] = lambda done: None) -> dict[str, Any]:
    """Compiles, records, simulates, estimates.

    Args:
      plan: `Agenda`.
      on_progress: called with the number of pieces done so far.

    Returns:
      The report: dicts and lists that JSON can hold.
    """
    report = {
        "environment": surroundings(),
        "settings": {
            "target": plan.target, "packages": targets.installed(), "worlds": [world.name for world in plan.worlds],
            "strategy": plan.strategy.name, "lanes": list(plan.lanes), "episodes": plan.episodes,
            "assume": dataclasses.asdict(plan.assume), "options": plan.options,
        },
        "programs": [], "schedules": [],
    }  # fmt: skip
    done = 0
    for world in plan.worlds:
        recorded = schedule.record(world, plan.strategy, plan.episodes)
        on_progress(done := done + 1)
        for n_lanes in plan.lanes:
            rows, last = _schedules(world, recorded, n_lanes)
            report["schedules"] += rows
            made = program.compile_for(world, plan.strategy, n_lanes, plan.device, plan.options)
            report["programs"].append(_row(plan, world, made, recorded, last))
            on_progress(done := done + 1)
    return report


def _schedules(world, recorded, n_lanes):
    """Simulated schedules as rows, and the last of them."""
    shape, clearance_d2 = [bucket(side) for side in world.shape], radius_d2(RULES.clearance_m, world.cell_m)
    rows, last = [], None
    for a_lane in A_LANE:
        queue = np.random.default_rng(SEED).integers(0, len(recorded), a_lane * n_lanes)
        last = schedule.simulate(recorded, queue, n_lanes, len(windows(shape, clearance_d2, glances=True)))
        rows.append({
            "world": world.name, "lanes": n_lanes, "episodes": len(queue), "turns": last.turns, "busy": last.busy,
            "full": last.full, "fills": last.fills,
        })  # fmt: skip
    return rows, last


def _row(plan, world, made, recorded, order):
    """What a program does, and what it would take: a dict."""
    turns = loop_turns(recorded, order)
    estimator = Estimator(made.module, targets.TARGETS[plan.target], plan.assume, turns, made.kernels)
    seconds = estimator.run(made.steps)
    loops = launches.loops(made.steps)
    turn = next(loop for loop in loops if not loop.scope)
    each = 1e3 / order.turns
    return {
        "world": world.name, "shape": list(world.shape), "padded_shape": list(made.shape), "lanes": made.n_lanes,
        "launches_per_turn": launches.per_iteration(turn) / SPAN,
        "host_loops": len(launches.host_decided(made.steps)),
        "host_syncs_per_turn": seconds.n_syncs / order.turns,
        "launches_per_iteration": {loop.scope or "turn": launches.per_iteration(loop) for loop in loops},
        "single_block_kernels": launches.single_blocks(made.steps, made.module, made.n_lanes),
        "cas_loops": launches.cas_loops(made.kernels, made.steps),
        "lane_bytes": made.lane_bytes, "lane_temporary_bytes": made.temporary_bytes,
        "lane_bytes_estimate": made.estimate_bytes, "compile_s": made.compile_s,
        "ms_per_turn": {
            name: each * getattr(seconds, name)
            for name in ("total", "syncs", "launches", "memory", "atomics", "instructions")
        },
        "ms_per_turn_by_loop": {name or "turn": each * one.total for name, one in estimator.by_scope.items()},
        "iterations_per_turn": {name or "turn": one.iterations / order.turns for name, one in turns.items()},
        "episodes": order.episodes,
        "episodes_per_s": order.episodes / seconds.total,
    }  # fmt: skip


def tables(report: Mapping[str, Any]) -> str:
    """The report as Markdown."""
    programs, assume = report["programs"], report["settings"]["assume"]
    scopes = list(dict.fromkeys(scope for row in programs for scope in row["launches_per_iteration"]))
    counts = markdown(
        ["world", "lanes", "launches a turn", "loops by the host", "syncs a turn", "single blocks", "CAS loops",
         "MiB a lane", "temporary", "estimated", "compile s"],
        [[row["world"], row["lanes"], row["launches_per_turn"], row["host_loops"], row["host_syncs_per_turn"],
          len(row["single_block_kernels"]), len(row["cas_loops"]), row["lane_bytes"] / MIB,
          row["lane_temporary_bytes"] / MIB, row["lane_bytes_estimate"] / MIB, row["compile_s"]] for row in programs],
    )  # fmt: skip
    loops = markdown(
        ["loop", *(f"{row['world']}, {row['lanes']}" for row in programs)],
        [[scope, *(row["launches_per_iteration"].get(scope) for row in programs)] for scope in scopes],
    )
    orders = markdown(
        ["world", "lanes", "episodes", "turns", "lanes busy", "first glances full"],
        [[row["world"], row["lanes"], row["episodes"], row["turns"], percent(row["busy"]), percent(row["full"])]
         for row in report["schedules"]],
    )  # fmt: skip
    speeds = markdown(
        ["world", "lanes", "ms a turn", "syncs", "launches", "memory", "atomics", "instructions", "episodes/s"],
        [[row["world"], row["lanes"], *(row["ms_per_turn"][name] for name in
          ("total", "syncs", "launches", "memory", "atomics", "instructions")), row["episodes_per_s"]]
         for row in programs],
    )  # fmt: skip
    given = ", ".join(f"{name} {value:g}" for name, value in assume.items() if value is not None)
    return "\n\n".join((
        f"Compiled for {report['settings']['target']}, not run:\n\n{counts}",
        f"Launches of one turn of each loop, its condition included:\n\n{loops}",
        f"Schedule, simulated from {report['settings']['episodes']} recorded episodes a world:\n\n{orders}",
        f"Estimate ({given}; each after the other):\n\n{speeds}",
    ))  # fmt: skip
