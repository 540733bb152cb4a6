"""A sweep made ready: its settings checked, its work cut into units that share compiled programs."""

import collections
import dataclasses
import functools
import os
from collections.abc import Sequence
from typing import Any

from jexplore.arrays.padding import bucket
from jexplore.config import InputError, __version__, require_different
from jexplore.exploration.batch import Job
from jexplore.exploration.site import COARSE_M, reach_d2
from jexplore.exploration.team.jobs import team_jobs
from jexplore.raycast import scans_all_round
from jexplore.rules import Lidar, Rules
from jexplore.studies import checks
from jexplore.studies.metrics import ready_metrics
from jexplore.studies.results.provenance import own_digests, world_digest
from jexplore.studies.results.units import Block, Unit, unit_size
from jexplore.studies.sweeps.spec import MAX_TOTAL, Setting, Sweep, plain_spec
from jexplore.worlds.poses import read_start
from jexplore.worlds.world import World, ringed_shape

MAX_UNIT_EPISODES = 256  # episodes of a unit at most, about; one file each
FIRST_JOBS = 12  # that a report replays
MAX_SWEEP_UNITS = 4096  # larger sweeps have larger units


@dataclasses.dataclass(frozen=True)
class SweepPlan:
    """A sweep that can be run."""

    spec: Sweep
    settings: list[Setting]
    strategies: list[str]
    """Names."""
    parameters: list[dict[str, Any]]
    """Of every strategy, those of its parameters that are settings."""
    jobs: list[Job]
    """By setting, world and strategy."""
    after: int = 0
    """Number of episodes that are left out, of each strategy in each world and setting: the first ones."""

    @property
    def reference(self) -> str:
        """Name of the first strategy."""
        return self.strategies[0]

    def setting_of(self, job: int) -> int:
        """Return the number of the setting of a job."""
        return job // (len(self.jobs) // len(self.settings))

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
        return list(dict.fromkeys(name for job in self.jobs for name in job.metrics))

    @functools.cached_property
    def worlds(self) -> list[World]:
        """Return the worlds in all their cell sizes."""
        return list({id(job.world): job.world for job in self.jobs}.values())

    @functools.cached_property
    def programs(self) -> dict[Any, list[int]]:
        """Return what each program is compiled for -> numbers of the jobs that share it."""
        found = collections.defaultdict(list)
        for i, job in enumerate(self.jobs):
            found[_program_key(job)].append(i)
        return dict(found)

    @functools.cached_property
    def units(self) -> list[Unit]:
        """Cut the work into units, each of one program."""
        units, k, n = [], len(self.strategies), self.spec.episodes
        for (padded, *_), jobs in self.programs.items():  # so that large maps lose no more to a kill
            size = max(min(MAX_UNIT_EPISODES, unit_size(padded[0] * padded[1])), -(-self.episodes // MAX_SWEEP_UNITS))
            own, firsts = [], range(self.after, n, size)
            blocks = [Block(i, first, min(size, n - first)) for i in jobs for first in firsts]
            for block in sorted(blocks, key=lambda block: (block.job // k, block.first, block.job)):
                if own and sum(one.n for one in own) + block.n > size:
                    units.append(Unit(tuple(own), len(units)))
                    own = []
                own.append(block)
            units.append(Unit(tuple(own), len(units)))
        return units

    def asked(self, shard: tuple[int, int] | None = None) -> dict[str, Any]:
        """Return all that the results depend on, as plain values."""
        spec = plain_spec(self.spec)
        kinds = {(key, i % len(self.strategies)): self.jobs[i] for key, own in self.programs.items() for i in own[::-1]}
        return {
            "version": __version__,
            "episodes": spec.pop("episodes"),
            "spec": spec,
            "digests": [world_digest(world) for world in self.worlds],
            "own": own_digests(kinds.values()),  # of one setting and world of each program
            "shard": None if shard is None else f"{shard[0] + 1}/{shard[1]}",
        }

    def first_jobs(self) -> list[tuple[Job, dict[str, Any]]]:
        """Return episode 0 of the first settings, worlds and strategies, and the setting of each."""
        jobs = [job._replace(starts=job.starts[:1]) for job in self.jobs[:FIRST_JOBS]]
        return [(job, self.settings[self.setting_of(i)].values) for i, job in enumerate(jobs)]


def prepare_sweep(spec: Sweep) -> SweepPlan:
    """Check a sweep and load all that it needs, before anything is compiled."""
    names = [os.fspath(world) for world in spec.worlds]
    require_different("worlds", names)
    settings, listed = spec.records(), spec.strategy_list()
    strategies = checks.ready_strategies([name for name, _ in listed])
    total = spec.episodes * len(settings) * len(names) * len(strategies)
    if total > MAX_TOTAL:
        raise InputError(f"a sweep may have {MAX_TOTAL:,} episodes, got {total:,}; use fewer settings or episodes")
    sizes = dict.fromkeys(setting.cell_m for setting in settings)
    worlds = {
        (name, cell_m): world for cell_m in sizes for name, world in zip(names, checks.ready_worlds(names, cell_m))
    }
    checks.require_different_buildings(worlds.values())
    start, metrics = read_start(spec.start, spec.start_m), ready_metrics(spec.metrics)
    jobs, starts, checked = [], {}, set()
    for setting in settings:
        lidar, rules = setting.lidar, setting.rules
        own = metrics | checks.measures_of(rules)
        for name in names:
            world = worlds[name, setting.cell_m]
            where = name, setting.cell_m, setting.seed, rules.clearance_m, rules.near_m
            if where not in starts:
                starts[where] = checks.ready_starts(world, start, spec.episodes, seed=setting.seed, rules=rules)
            if (memory := (name, setting.cell_m, lidar, rules.max_steps)) not in checked:
                checks.require_memory(world, lidar, rules)
                checked.add(memory)
            more = setting.seed, 0, lidar, rules, 0, own, setting.robot
            jobs += team_jobs([Job(world, one, starts[where], *more) for one in strategies], **setting.team)
    return SweepPlan(spec, settings, [one.name for one in strategies], [own for _, own in listed], jobs)


def _program_key(job: Job) -> tuple[Any, ...]:
    """Return what must agree to share a program: shape of the padded map, beams, clearance, pose, team, ..."""
    world, lidar, rules, team = job.world, job.lidar, job.rules, job.team
    assert lidar is not None
    assert rules is not None
    return (
        tuple(bucket(side) for side in ringed_shape(world.occupied)),
        *(reach_d2(rules.clearance_m, world), lidar.n_beams, scans_all_round(lidar), world.cell_m > COARSE_M),
        *(rules.pose, rules.motion, rules.frontier_connectivity, rules.min_frontier_cells),
        rules.stop_at is not None or rules.return_home,
        team and (team.robots, team.coordinates, "rendezvous" in team.contact, any(m.range_m for m in team.members)),
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
