"""Worlds to learn in, and how long the paths of strategies are there beside those of the reference."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jexplore.config import InputError, Lidar, Rules
from jexplore.exploration.batch import Job, run_jobs
from jexplore.exploration.results import path_m
from jexplore.exploration.state import Outcome
from jexplore.policies import Strategy, parse_strategy
from jexplore.studies.checks import (
    LIDAR,
    RULES,
    WorldLike,
    ready_starts,
    ready_worlds,
    require_clearance,
    require_memory,
)
from jexplore.studies.statistics.league import LEAGUE_KINDS
from jexplore.worlds.world import World

REFERENCE = "closest+recheck"
FAILED = 3.0  # ratio that an episode counts with that did not see everything
TRAINING = tuple(f"{kind}#{seed}" for seed in range(1000, 1008) for kind in LEAGUE_KINDS)
"""Worlds to learn in, unless said otherwise. Those of the league are #0 and on."""
VALIDATION = tuple(f"{kind}#{seed}" for seed in range(2000, 2004) for kind in LEAGUE_KINDS)
"""Worlds on which what was learned is watched."""


@dataclasses.dataclass(frozen=True)
class Bank:
    """Worlds, a scanner and rules."""

    worlds: tuple[World, ...]
    lidar: Lidar
    rules: Rules
    start: str = "random"
    """As in a comparison: drawn, or the world's own."""

    def log_ratios(
        self, strategies: Sequence[Strategy], which: Sequence[int], seed: int, *, workers: int | None = None
    ) -> np.ndarray:
        """How long the paths of strategies are beside those of the reference, from the same starts.

        Args:
          strategies: N of them.
          which: K numbers of worlds; an episode in each, of one that is there twice from two starts.
          seed: of the starts and of all that is random.
          workers: cores; by default all.

        Returns:
          `[N, K]` float64, logarithms; that of `FAILED` where an episode did not end COMPLETE and the reference's did;
            0 where the reference's did not, or saw all from the start.
        """
        everyone = [parse_strategy(REFERENCE), *strategies]
        numbers, counts = np.unique(which, return_counts=True)
        jobs, starts = [], {}
        for number, n in zip(numbers.tolist(), counts.tolist()):
            world = self.worlds[number]
            starts[number] = ready_starts(world, self.start, n, seed=seed, rules=self.rules)
            jobs += [Job(world, one, starts[number], seed) for one in everyone]
        report = run_jobs(jobs, self.lidar, self.rules, engine="serial", workers=workers)
        table = np.full((len(everyone), len(which)), np.nan)
        place = {number: np.flatnonzero(np.asarray(which) == number) for number in numbers.tolist()}
        for i, (job, outcome) in enumerate(zip(jobs, report.outcomes)):
            found = outcome.result
            if np.any(found.outcome == Outcome.RUNNING):
                raise KeyboardInterrupt
            lengths = path_m(found.straight, found.diagonal, job.world.cell_m)
            lengths = np.where(found.outcome == Outcome.COMPLETE, lengths, np.inf)
            table[i % len(everyone), place[numbers.tolist()[i // len(everyone)]]] = lengths
        reference = table[0]
        usable = np.isfinite(reference) & (reference > 0)
        ratio = table[1:] / np.where(usable, reference, 1.0)
        return np.where(usable, np.log(np.clip(np.where(np.isfinite(ratio), ratio, FAILED), 1e-3, None)), 0.0)


def prepare_bank(
    worlds: WorldLike | Sequence[WorldLike],
    *,
    cell_m: float = 0.1,
    lidar: Lidar = LIDAR,
    rules: Rules = RULES,
    start: str = "random",
) -> Bank:
    """A `Bank`.

    Raises:
      InputError: a world that cannot be loaded, or is too large, or in which no robot can stand.
    """
    ready = ready_worlds(worlds, cell_m)
    for world in ready:
        require_clearance(world, rules)
        require_memory(world, lidar, rules)
    return Bank(tuple(ready), lidar, rules, start)


def require_apart(training: Bank, validation: Bank) -> None:
    """Refuse to watch on what is trained on.

    Raises:
      InputError: naming the world.
    """
    names = {world.name for world in training.worlds}
    for world in validation.worlds:
        if world.name in names:
            raise InputError(f"world {world.name!r} is in both the training and the validation worlds")
