"""Worlds for training, and what strategies take in them relative to the reference: path, or another measure."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from jexplore.config import InputError, unknown
from jexplore.exploration.batch import Job, run_jobs
from jexplore.exploration.results import columns
from jexplore.exploration.site import ROBOT
from jexplore.exploration.state import Outcome
from jexplore.policies import Strategy, parse_strategy
from jexplore.rules import Lidar, Rules
from jexplore.studies.checks import (
    LIDAR,
    RULES,
    LidarLike,
    RulesLike,
    WorldLike,
    ready_settings,
    ready_starts,
    ready_worlds,
    require_clearance,
    require_memory,
)
from jexplore.studies.statistics.by_world import DONE
from jexplore.studies.statistics.coverage import MEASURES
from jexplore.studies.statistics.league import LEAGUE_KINDS
from jexplore.worlds.world import World, with_ring

REFERENCE = "closest+recheck"
FAILED = 3.0  # ratio that an episode counts with that did not see everything
TRAINING = tuple(f"{kind}#{seed}" for seed in range(1000, 1008) for kind in LEAGUE_KINDS)
"""Worlds to learn in, unless said otherwise. Those of the league are #0 and on."""
VALIDATION = tuple(f"{kind}#{seed}" for seed in range(2000, 2004) for kind in LEAGUE_KINDS)
"""Worlds on which what was learned is watched."""


@dataclasses.dataclass(frozen=True, eq=False)
class Bank:
    """Worlds, a scanner and rules."""

    worlds: tuple[World, ...]  # each `with_ring`
    lidar: Lidar
    rules: Rules
    start: str = "random"
    """As in a comparison: drawn, or the world's own."""
    measure: str = "path_m"
    """Column of the table of episodes that is to be small, one of `coverage.MEASURES`."""

    def log_ratios(
        self, strategies: Sequence[Strategy], which: Sequence[int], seed: int, *, workers: int | None = None,
        on_progress: Callable[[int], object] | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Compute measures of N strategies relative to the reference's: `[N, K]` float64, see `log_ratio`.

        `which` are K numbers of worlds: an episode in each, from another start if a world occurs twice; the same for
        all strategies. `seed` is that of the starts and all other draws; `on_progress` as of `batch.run_jobs`.

        Raises:
          InputError: the reference finished no episode.
          KeyboardInterrupt: not all were made.
        """
        how: Any = {"workers": workers, "on_progress": on_progress}
        values = self.values([parse_strategy(REFERENCE), *strategies], which, seed, **how)
        if not np.isfinite(values[0]).any():
            names = ", ".join(sorted({str(self.worlds[i].name) for i in which}))
            raise InputError(f"{REFERENCE} finishes no episode in {names}: ratios to its measure have no meaning")
        return log_ratio(values[1:], values[0])

    def values(
        self, strategies: Sequence[Strategy], which: Sequence[int], seed: int, *, workers: int | None = None,
        on_progress: Callable[[int], object] | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Compute the measure of strategies, from the same starts: `[N, K]` float64, in the unit of its column.

        inf where an episode did not end COMPLETE or EXPLORED. Arguments as of `log_ratios`.

        Raises:
          KeyboardInterrupt: not all were made.
        """
        jobs, places = [], []
        for number, place, starts in self.episodes(which, seed):
            jobs += [Job(self.worlds[number], one, starts, seed) for one in strategies]
            places += [place] * len(strategies)
        report = run_jobs(jobs, self.lidar, self.rules, workers=workers, on_progress=on_progress)
        table = np.full((len(strategies), len(which)), np.inf)
        for i, (job, place, outcome) in enumerate(zip(jobs, places, report.outcomes)):
            found = outcome.result
            if np.any(found.outcome == Outcome.RUNNING):
                raise KeyboardInterrupt
            told = columns(found, job.starts, seed=seed, cell_m=job.world.cell_m, has_rooms=False, robot=ROBOT)
            table[i % len(strategies), place] = np.where(np.isin(told["outcome"], DONE), told[self.measure], np.inf)
        return table

    def some(self, draw: np.random.Generator, n: int) -> list[int]:
        """Draw n numbers of worlds in a random order, each as often as any other, or once more."""
        return draw.permutation(np.resize(draw.permutation(len(self.worlds)), n)).tolist()

    def episodes(self, which: Sequence[int], seed: int) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield worlds and starts: `(number of the world, its places in `which`, [n, 3] starts)` for each world."""
        numbers, counts = np.unique(which, return_counts=True)
        for number, n in zip(numbers.tolist(), counts.tolist()):
            place = np.flatnonzero(np.asarray(which) == number)
            yield number, place, ready_starts(self.worlds[number], self.start, n, seed=seed, rules=self.rules)


def log_ratio(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Compute logarithms of measures relative to the reference's.

    That of `FAILED` where a value is inf and the reference's finite, 0 where the reference's is inf or 0. `values`:
    `[..., K]`; `reference`: `[K]` in the same unit.
    """
    usable = np.isfinite(reference) & (reference > 0)
    ratio = values / np.where(usable, reference, 1.0)
    return np.where(usable, np.log(np.clip(np.where(np.isfinite(ratio), ratio, FAILED), 1e-3, None)), 0.0)


def prepare_bank(
    worlds: WorldLike | Sequence[WorldLike], *, cell_m: float = 0.1, lidar: LidarLike = LIDAR, rules: RulesLike = RULES,
    start: str = "random", measure: str = "path_m",
) -> Bank:  # fmt: skip
    """Make a `Bank`; refuse a world that cannot be loaded, is too large, or in which no robot can stand.

    `measure`: column that is to be small, one of `coverage.MEASURES`; times and energy are those of the default
    `jx.Robot`.
    """
    if measure not in MEASURES.values():
        raise unknown("measure", measure, MEASURES.values())
    lidar, rules = ready_settings(lidar, rules)
    rules.require_lattice("training and tuning are")
    ready = [with_ring(world) for world in ready_worlds(worlds, cell_m)]
    for world in ready:
        require_clearance(rules, world.cell_m, repr(world.name))
        require_memory(world, lidar, rules)
    return Bank(tuple(ready), lidar, rules, start, measure)
