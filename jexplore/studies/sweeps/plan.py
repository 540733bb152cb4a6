"""A sweep made ready: its settings checked, its work cut into units that share compiled programs."""

import collections
import dataclasses
import functools
import itertools
import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jexplore.arrays.padding import bucket
from jexplore.config import InputError, __version__, require_different
from jexplore.exploration.batch import Job
from jexplore.exploration.metrics import Metric
from jexplore.exploration.site import COARSE_M, reach_d2
from jexplore.exploration.team.jobs import team_jobs
from jexplore.policies import Strategy
from jexplore.raycast import scans_all_round
from jexplore.rules import Lidar, Rules
from jexplore.studies import checks
from jexplore.studies.metrics import ready_metrics
from jexplore.studies.results.provenance import own_digests, world_digest
from jexplore.studies.results.units import CELL_S, MIN_UNIT_EPISODES, UNIT_S
from jexplore.studies.sweeps.spec import MAX_TOTAL, Setting, Sweep, plain_spec
from jexplore.worlds.poses import read_start
from jexplore.worlds.world import World, ringed_shape

MAX_UNIT_EPISODES = 256  # episodes of a unit at most, about; one file each
FIRST_JOBS = 12  # that a report replays
MAX_SWEEP_UNITS = 4096  # larger sweeps have larger units


class SweepBlock(NamedTuple):
    """Some episodes of one strategy in one world and setting."""

    setting: int
    world: int
    strategy: int
    first: int
    n: int


@dataclasses.dataclass(frozen=True)
class SweepPlan:
    """A sweep that can be run."""

    spec: Sweep
    settings: list[Setting]
    strategies: list[Strategy]
    parameters: list[dict[str, Any]]
    """Of every strategy, those of its parameters that are settings."""
    metrics: dict[str, Metric]
    after: int = 0
    """Number of episodes that are left out, of each strategy in each world and setting: the first ones."""

    @property
    def reference(self) -> str:
        """Name of the first strategy."""
        return self.strategies[0].name

    @functools.cached_property
    def sharing(self) -> list[tuple[Lidar, Rules]]:
        """Return scanners and rules that bound those of all settings, see `site.prepare_site`."""
        widest: dict[int, Lidar] = {}
        for lidar in (setting.lidar for setting in self.settings):
            one = widest.get(lidar.n_beams, lidar)
            most = {name: max(getattr(one, name), getattr(lidar, name)) for name in ("range_m", "sigma_m", "dropout")}
            farther = max(one, lidar, key=lambda each: each.mount_m)
            most |= {"forward_m": farther.forward_m, "left_m": farther.left_m}
            widest[lidar.n_beams] = dataclasses.replace(lidar, **most)
        limits = {setting.rules.max_steps for setting in self.settings}
        return [(lidar, Rules(max_steps=limit)) for lidar in widest.values() for limit in limits]

    @property
    def episodes(self) -> int:
        """Return the number of episodes of the whole sweep."""
        return self.spec.episodes * len(self.settings) * len(self.spec.worlds) * len(self.strategies)

    @property
    def columns(self) -> list[str]:
        """Return columns of settings in the table of episodes."""
        own = dict.fromkeys(f"strategy.{key}" for parameters in self.parameters for key in parameters)
        return ["setting", *(key for key in self.settings[0].values if key != "seed"), *own]

    @functools.cached_property
    def measures(self) -> list[str]:
        """Return columns of measures that some of its episodes have."""
        return list(dict.fromkeys(name for one in self.settings for name in checks.measures_of(one.rules)))

    @functools.cached_property
    def places(self) -> list[World]:
        """Return the worlds in all their cell sizes."""
        sizes = dict.fromkeys(setting.cell_m for setting in self.settings)
        return [self.world(number, cell_m) for number in range(len(self.spec.worlds)) for cell_m in sizes]

    @functools.cached_property
    def programs(self) -> dict[Any, list[tuple[int, int]]]:
        """Return what each program is compiled for -> numbers of the settings and worlds that share it."""
        found = collections.defaultdict(list)
        for i, setting in enumerate(self.settings):
            for world in range(len(self.spec.worlds)):
                found[_program_key(self.world(world, setting.cell_m), setting)].append((i, world))
        return dict(found)

    @functools.cached_property
    def units(self) -> list[list[SweepBlock]]:
        """Cut the work into units, each of one program."""
        units = []
        for (padded, *_), pairs in self.programs.items():
            worth = round(UNIT_S / (CELL_S * padded[0] * padded[1]))  # so that large maps lose no more to a kill
            size = max(min(MAX_UNIT_EPISODES, max(MIN_UNIT_EPISODES, worth)), -(-self.episodes // MAX_SWEEP_UNITS))
            unit, room, firsts = [], size, range(self.after, self.spec.episodes, size)
            for (setting, world), first, strategy in itertools.product(pairs, firsts, range(len(self.strategies))):
                block = SweepBlock(setting, world, strategy, first, min(size, self.spec.episodes - first))
                if unit and block.n > room:
                    units.append(unit)
                    unit, room = [], size
                unit.append(block)
                room -= block.n
            units.append(unit)
        return units

    def asked(self, shard: tuple[int, int] | None = None) -> dict[str, Any]:
        """Return all that the results depend on, as plain values."""
        spec = plain_spec(self.spec)
        kinds = [(self.settings[i], world) for (i, world), *_ in self.programs.values()]  # one of each program
        measured = [(one, world, self.metrics | checks.measures_of(one.rules)) for one, world in kinds]
        none = np.zeros((0, 3), int)
        jobs = [
            Job(self.world(world, one.cell_m), strategy, none, lidar=one.lidar, rules=one.rules, metrics=metrics)
            for one, world, metrics in measured
            for strategy in self.strategies
        ]
        return {
            "version": __version__,
            "episodes": spec.pop("episodes"),
            "spec": spec,
            "digests": [world_digest(world) for world in self.places],
            "own": own_digests(jobs),
            "shard": None if shard is None else f"{shard[0] + 1}/{shard[1]}",
        }

    def size(self, unit: int) -> int:
        """Return the number of episodes of a unit."""
        return sum(block.n for block in self.units[unit])

    def world(self, number: int, cell_m: float) -> World:
        """Load a world."""
        return _loaded(os.fspath(self.spec.worlds[number]), cell_m)

    def starts(self, world: World, setting: Setting, n: int) -> np.ndarray:
        """Return the starts of the first episodes in a world."""
        start = read_start(self.spec.start, self.spec.start_m)
        return _starts(
            world.name, world.cell_m, setting.seed, setting.rules.clearance_m, setting.rules.near_m, n, start
        )

    def first_jobs(self) -> list[tuple[Job, dict[str, Any]]]:
        """Return episode 0 of the first settings, worlds and strategies, and the setting of each."""
        every = itertools.product(*(range(len(of)) for of in (self.settings, self.spec.worlds, self.strategies)))
        blocks = [SweepBlock(s, w, k, 0, 1) for s, w, k in itertools.islice(every, FIRST_JOBS)]
        return [(self.job(block, 0), self.settings[block.setting].values) for block in blocks]

    def job(self, block: SweepBlock, phase: int) -> Job:
        """Make the `Job` of a block."""
        setting = self.settings[block.setting]
        world = self.world(block.world, setting.cell_m)
        starts = self.starts(world, setting, self.spec.episodes)[block.first : block.first + block.n]
        metrics = self.metrics | checks.measures_of(setting.rules)
        own = setting.lidar, setting.rules, phase, metrics, setting.robot
        return team_jobs(
            [Job(world, self.strategies[block.strategy], starts, setting.seed, block.first, *own)], **setting.team
        )[0]


@functools.lru_cache(maxsize=256)
def _loaded(name, cell_m):
    return checks.ready_worlds([name], cell_m)[0]


@functools.lru_cache(maxsize=4096)
def _starts(name, cell_m, seed, clearance_m, near_m, n, start):
    rules = Rules(clearance_m=clearance_m, near_m=near_m)
    return checks.ready_starts(_loaded(name, cell_m), start, n, seed=seed, rules=rules)


def prepare_sweep(spec: Sweep) -> SweepPlan:
    """Check a sweep, before anything is compiled."""
    require_different("worlds", [os.fspath(world) for world in spec.worlds])
    _loaded.cache_clear()  # a file may have changed since
    _starts.cache_clear()
    settings, listed = spec.records(), spec.strategy_list()
    strategies = checks.ready_strategies([name for name, _ in listed])
    plan = SweepPlan(spec, settings, strategies, [own for _, own in listed], ready_metrics(spec.metrics))
    if plan.episodes > MAX_TOTAL:
        raise InputError(
            f"a sweep may have {MAX_TOTAL:,} episodes, got {plan.episodes:,}; use fewer settings or episodes"
        )
    checks.require_different_buildings(plan.places)
    checked = set()
    for i, setting in enumerate(settings):
        for number in range(len(spec.worlds)):
            world = plan.world(number, setting.cell_m)
            plan.starts(world, setting, 1)
            memory = number, setting.cell_m, setting.lidar, setting.rules.max_steps
            team = number, setting.cell_m, setting.rules, tuple(setting.team.items())
            if memory not in checked:
                checks.require_memory(world, setting.lidar, setting.rules)
            if setting.team and team not in checked:
                for strategy in range(len(strategies)):
                    plan.job(SweepBlock(i, number, strategy, 0, 1), 0)  # which refuses what cannot be
            checked |= {memory, team}
    return plan


def _program_key(world: World, setting: Setting) -> tuple[Any, ...]:
    """Return what must agree to share a program: shape of the padded map, beams, clearance, pose, team, ..."""
    lidar, rules, team = setting.lidar, setting.rules, setting.team
    return (
        tuple(bucket(side) for side in ringed_shape(world.occupied)),
        *(reach_d2(rules.clearance_m, world), lidar.n_beams, scans_all_round(lidar), world.cell_m > COARSE_M),
        *(rules.pose, rules.motion, rules.frontier_connectivity, rules.min_frontier_cells),
        rules.stop_at is not None or rules.return_home,
        *(*map(team.get, ("robots", "coordination")), "rendezvous" in str(team.get("contact"))),
        "range" in str(team.get("members")),
    )


def in_shard(units: int, shard: tuple[int, int] | None) -> list[int]:
    """Return numbers of the units that a shard `(i, n)` makes, i from 0."""
    return list(range(units)) if shard is None else list(range(shard[0], units, shard[1]))


def summary_lines(plan: SweepPlan, units: Sequence[int]) -> list[str]:
    """Return the lines that `--dry-run` prints for some units of a plan."""
    head = f"{len(plan.settings):,} settings x {len(plan.spec.worlds)} worlds x {len(plan.strategies)} strategies"
    return [
        f"{head} x {plan.spec.episodes:,} episodes = {plan.episodes:,} episodes",
        f"{len(units):,} units of about {plan.episodes / max(len(plan.units), 1):,.0f} episodes",
        f"{len(plan.programs):,} compiled programs, one for every size of map, clearance in cells and number of beams",
    ]
