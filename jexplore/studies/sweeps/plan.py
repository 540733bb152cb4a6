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
from jexplore.policies.catalogue.joined import join_strategies
from jexplore.raycast import scans_all_round
from jexplore.rules import Lidar, Rules
from jexplore.studies import checks
from jexplore.studies.metrics import ready_metrics
from jexplore.studies.results.provenance import own_digests, world_digest
from jexplore.studies.results.units import CELL_S, MIN_UNIT_EPISODES, UNIT_S
from jexplore.studies.sweeps.spec import MAX_TOTAL, Sweep, plain_spec, robot_of, team_of
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
    settings: list[dict[str, Any]]
    records: list[tuple[int, float, Lidar, Rules]]
    strategies: list[Strategy]
    parameters: list[dict[str, Any]]
    """Of every strategy, those of its parameters that are settings."""
    shapes: dict[tuple[int, float], tuple[int, int]]
    """(world, cell size) -> shape of the world with its ring."""
    digests: list[str]
    """Of every world and cell size."""
    units: list[list[SweepBlock]]
    programs: int
    """Programs that are compiled for it."""
    metrics: dict[str, Metric] = dataclasses.field(default_factory=dict)

    @property
    def reference(self) -> str:
        """Name of the first strategy."""
        return self.strategies[0].name

    @functools.cached_property
    def together(self) -> list[Strategy]:
        """Make the strategies share a program."""
        return join_strategies(self.strategies)

    @functools.cached_property
    def sharing(self) -> list[tuple[Lidar, Rules]]:
        """Return scanners and rules that bound those of all settings, see `site.prepare_site`."""
        widest: dict[int, Lidar] = {}
        for record in self.records:
            lidar: Lidar = record[2]
            one = widest.get(lidar.n_beams, lidar)
            most = {name: max(getattr(one, name), getattr(lidar, name)) for name in ("range_m", "sigma_m", "dropout")}
            farther = max(one, lidar, key=lambda each: each.mount_m)
            most |= {"forward_m": farther.forward_m, "left_m": farther.left_m}
            widest[lidar.n_beams] = dataclasses.replace(lidar, **most)
        limits = {rules.max_steps for *_, rules in self.records}
        return [(lidar, Rules(max_steps=limit)) for lidar in widest.values() for limit in limits]

    @property
    def episodes(self) -> int:
        """Return the number of episodes of the whole sweep."""
        return self.spec.episodes * len(self.settings) * len(self.spec.worlds) * len(self.strategies)

    @property
    def columns(self) -> list[str]:
        """Return columns of settings in the table of episodes."""
        own = dict.fromkeys(f"strategy.{key}" for parameters in self.parameters for key in parameters)
        return ["setting", *(key for key in self.settings[0] if key != "seed"), *own]

    @functools.cached_property
    def measures(self) -> list[str]:
        """Return columns of measures that some of its episodes have."""
        return list(dict.fromkeys(name for *_, rules in self.records for name in checks.measures_of(rules)))

    @functools.cached_property
    def kinds(self) -> dict[str, str]:
        """Return columns of settings and the types of their values, see `column_type`."""
        given = {name: [setting[name] for setting in self.settings] for name in self.settings[0]}
        own = {f"strategy.{key}": [one.get(key) for one in self.parameters] for one in self.parameters for key in one}
        found = given | own
        return {name: column_type(found[name]) for name in self.columns if name in found}

    def asked(self, shard: tuple[int, int] | None = None) -> dict[str, Any]:
        """Return all that the results depend on, as plain values."""
        spec = plain_spec(self.spec)
        return {
            "version": __version__,
            "episodes": spec.pop("episodes"),
            "spec": spec,
            "digests": self.digests,
            "own": own_digests(self._one_of_each_kind()),
            "shard": None if shard is None else f"{shard[0] + 1}/{shard[1]}",
        }

    def after(self, n: int) -> "SweepPlan":
        """Return the plan of the episodes from number n on."""
        given = self.spec, self.settings, self.records, self.shapes
        units, programs = _cut(*given, len(self.strategies), self.episodes, n)
        return dataclasses.replace(self, units=units, programs=programs)

    def _one_of_each_kind(self):
        """Yield one of all settings and worlds that share a program, with every strategy: `Job`s of no episode."""
        kinds = {}
        for _, cell_m, lidar, rules in self.records:
            for world in range(len(self.spec.worlds)):
                key = _program_key(self.world(world, cell_m), lidar, rules)
                kinds.setdefault(key, (world, cell_m, lidar, rules))
        for world, cell_m, lidar, rules in kinds.values():
            for strategy in self.strategies:
                own = {"lidar": lidar, "rules": rules, "metrics": self.metrics | checks.measures_of(rules)}
                yield Job(self.world(world, cell_m), strategy, np.zeros((0, 3), int), **own)

    def size(self, unit: int) -> int:
        """Return the number of episodes of a unit."""
        return sum(block.n for block in self.units[unit])

    def world(self, number: int, cell_m: float) -> World:
        """Load a world."""
        return _loaded(os.fspath(self.spec.worlds[number]), cell_m)

    def starts(self, world: World, seed: int, clearance_m: float, near_m: float) -> np.ndarray:
        """Return the starts of all episodes in a world."""
        return _starts(world.name, world.cell_m, seed, clearance_m, near_m, self.spec.episodes, _start_of(self.spec))

    def first_jobs(self) -> list[tuple[Job, dict[str, Any]]]:
        """Return episode 0 of the first settings, worlds and strategies, and the setting of each."""
        every = itertools.product(*(range(len(of)) for of in (self.settings, self.spec.worlds, self.strategies)))
        blocks = [SweepBlock(s, w, k, 0, 1) for s, w, k in itertools.islice(every, FIRST_JOBS)]
        return [(self.job(block, 0), self.settings[block.setting]) for block in blocks]

    def job(self, block: SweepBlock, phase: int) -> Job:
        """Make the `Job` of a block."""
        seed, cell_m, lidar, rules = self.records[block.setting]
        world = self.world(block.world, cell_m)
        starts = self.starts(world, seed, rules.clearance_m, rules.near_m)[block.first : block.first + block.n]
        team = team_of(self.settings[block.setting])
        strategy = (self.strategies if team else self.together)[block.strategy]
        robot = robot_of(self.settings[block.setting])
        metrics = self.metrics | checks.measures_of(rules)
        job = Job(world, strategy, starts, seed, block.first, lidar, rules, phase, metrics, robot)
        return team_jobs([job], **team)[0]


@functools.lru_cache(maxsize=256)
def _loaded(name, cell_m):
    return checks.ready_worlds([name], cell_m)[0]


@functools.lru_cache(maxsize=4096)
def _starts(name, cell_m, seed, clearance_m, near_m, n, start):
    rules = Rules(clearance_m=clearance_m, near_m=near_m)
    return checks.ready_starts(_loaded(name, cell_m), start, n, seed=seed, rules=rules)


def _start_of(spec):
    return read_start(spec.start, spec.start_m)


def column_type(values: Sequence[Any]) -> str:
    """Return the type of a column that holds these values: "bool", "int64", "float64", or "text"."""
    if all(isinstance(value, bool) for value in values):
        return "bool"
    if all(isinstance(value, int) and not isinstance(value, bool) for value in values):
        return "int64"
    if all(value is None or (isinstance(value, (int, float)) and not isinstance(value, bool)) for value in values):
        return "float64"
    return "text"


def prepare_sweep(spec: Sweep) -> SweepPlan:
    """Check a sweep and cut its work, before anything is compiled."""
    names = [os.fspath(world) for world in spec.worlds]
    require_different("worlds", names)
    _loaded.cache_clear()  # a file may have changed since
    _starts.cache_clear()
    settings, records, listed = spec.expanded(), spec.records(), spec.strategy_list()
    strategies = checks.ready_strategies([name for name, _ in listed])
    total = spec.episodes * len(settings) * len(spec.worlds) * len(strategies)
    if total > MAX_TOTAL:
        raise InputError(f"a sweep may have {MAX_TOTAL:,} episodes, got {total:,}; use fewer settings or episodes")
    shapes, digests = {}, []
    for world, name in enumerate(names):
        for cell_m in dict.fromkeys(cell_m for _, cell_m, _, _ in records):
            loaded = _loaded(name, cell_m)
            shapes[world, cell_m] = ringed_shape(loaded.occupied)
            digests.append(world_digest(loaded))
    checks.require_different_buildings(_loaded(names[world], cell_m) for world, cell_m in shapes)
    checked = set()
    for seed, cell_m, lidar, rules in records:
        for name in names:
            _starts(name, cell_m, seed, rules.clearance_m, rules.near_m, 1, _start_of(spec))
            if (name, cell_m, lidar, rules.max_steps) not in checked:
                checked.add((name, cell_m, lidar, rules.max_steps))
                checks.require_memory(_loaded(name, cell_m), lidar, rules)
    units, programs = _cut(spec, settings, records, shapes, len(strategies), total)
    parameters, metrics = [own for _, own in listed], ready_metrics(spec.metrics)
    plan = SweepPlan(spec, settings, records, strategies, parameters, shapes, digests, units, programs, metrics)
    teams = {(tuple(team_of(own).items()), records[i][1], records[i][3]): i for i, own in enumerate(settings)}
    for (team, *_), i in teams.items():
        for world, strategy in itertools.product(range(len(names)), range(len(strategies))) if team else ():
            plan.job(SweepBlock(i, world, strategy, 0, 1), 0)  # which refuses what cannot be
    return plan


def _program_key(world, lidar, rules):
    """Return what must agree to share a program: shape of the padded map, clearance, beams, frontier, pose, ..."""
    padded = tuple(bucket(side) for side in ringed_shape(world.occupied))
    around = scans_all_round(lidar)
    frontier = rules.frontier_connectivity, rules.min_frontier_cells
    ends = rules.stop_at is not None or rules.return_home
    own = reach_d2(rules.clearance_m, world), lidar.n_beams, around, world.cell_m > COARSE_M, rules.pose, rules.motion
    return padded, *own, *frontier, ends


def _cut(spec, settings, records, shapes, n_strategies, total, after=0):
    """Divide the work into blocks, those that share a program together: `(units, number of programs)`."""
    by_key = collections.defaultdict(list)
    loaded = {(world, cell_m): _loaded(os.fspath(spec.worlds[world]), cell_m) for world, cell_m in shapes}
    for i, (_, cell_m, lidar, rules) in enumerate(records):
        for world in range(len(spec.worlds)):
            own = settings[i]
            team = *map(own.get, ("robots", "coordination")), "rendezvous" in str(own.get("contact"))
            team = *team, "range" in str(own.get("members"))
            by_key[*_program_key(loaded[world, cell_m], lidar, rules), *team].append((i, world))
    units = []
    for (padded, *_), pairs in by_key.items():
        worth = round(UNIT_S / (CELL_S * padded[0] * padded[1]))  # so that large maps lose no more to a kill
        size = max(min(MAX_UNIT_EPISODES, max(MIN_UNIT_EPISODES, worth)), -(-total // MAX_SWEEP_UNITS))
        unit, room = [], size
        for (setting, world), first, strategy in itertools.product(
            pairs, range(after, spec.episodes, size), range(n_strategies)
        ):
            block = SweepBlock(setting, world, strategy, first, min(size, spec.episodes - first))
            if unit and block.n > room:
                units.append(unit)
                unit, room = [], size
            unit.append(block)
            room -= block.n
        units.append(unit)
    return units, len(by_key)


def in_shard(units: int, shard: tuple[int, int] | None) -> list[int]:
    """Return numbers of the units that a shard `(i, n)` makes, i from 0."""
    return list(range(units)) if shard is None else list(range(shard[0], units, shard[1]))


def summary_lines(plan: SweepPlan, units: Sequence[int]) -> list[str]:
    """Return the lines that `--dry-run` prints for some units of a plan."""
    head = f"{len(plan.settings):,} settings x {len(plan.spec.worlds)} worlds x {len(plan.strategies)} strategies"
    return [
        f"{head} x {plan.spec.episodes:,} episodes = {plan.episodes:,} episodes",
        f"{len(units):,} units of about {plan.episodes / max(len(plan.units), 1):,.0f} episodes",
        f"{plan.programs:,} compiled programs, one for every size of map, clearance in cells and number of beams",
    ]
