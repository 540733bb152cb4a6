"""Reproduction of a paper's tables: its strategies in its environments, its figures and ours, and their orderings."""

import dataclasses
import functools
import itertools
import os
from collections.abc import Callable
from typing import Any

import pandas as pd
from scipy.stats import ttest_ind_from_stats

from jexplore.config import InputError, checked_names, require_engine, unknown
from jexplore.exploration.batch import Job
from jexplore.report import tables
from jexplore.studies.checks import LIDAR, ROBOT, RULES, LidarLike, RobotLike, RulesLike, prepare_jobs
from jexplore.studies.papers import PAPERS, Paper
from jexplore.studies.results.comparison import ComparisonResult, run_comparison
from jexplore.studies.results.progress import progress_bar
from jexplore.studies.statistics import paired

COUNTERPARTS = (
    "The worlds are built-in counterparts, NOT the paper's maps: ratios and orderings compare, metres do not."
)
MAPS = "The worlds are public maps of the paper's environments; that they equal the paper's own is not proven."


def find(name: str) -> Paper:
    if name not in PAPERS:
        raise unknown("paper", name, PAPERS)
    return PAPERS[name]


def world_names(paper: Paper, maps: str | os.PathLike[str] | None = None) -> dict[str, str]:
    """Return `{environment: name of its world}`: maps in the folder `maps`, by default the built-in counterparts."""
    if maps is None:
        return {name: environment.counterpart for name, environment in paper.environments.items()}
    folder = os.path.expanduser(maps)
    return {name: os.path.join(folder, found.file) + found.scale for name, found in paper.environments.items()}


def verdict(ours: paired.PairedRatio) -> str:
    """Decide whether a ratio's interval lies wholly below 1; "undecided" where it meets 1, is missing or of few."""
    if ours.n < paired.MIN_PAIRS:
        return "undecided"
    return "holds" if ours.high < 1 else "does not hold" if ours.low > 1 else "undecided"


@checked_names
@dataclasses.dataclass(frozen=True)
class ReproductionResult:
    """A paper's tables and ours. Tables are pandas DataFrames."""

    paper: Paper
    comparison: ComparisonResult
    worlds: dict[str, str]
    """Environment -> name of its world."""
    notes: tuple[str, ...]
    """Notes for reading the tables."""

    @functools.cached_property
    def tables(self) -> pd.DataFrame:
        """Tabulate results, one row an environment and strategy; columns of `by_world.summarise`, and the paper's.

        `ratio` is ours to the paper's reference strategy, paired; `first_mean` and `first_sd` are over the first
        episodes, `first_n` of them: as many as the paper has runs, or fewer where fewer have run.
        """
        published = [
            (name, self.worlds[name], strategy, *path, path[0] / environment.paths[self.paper.reference][0])
            for name, environment in self.paper.environments.items()
            for strategy, path in environment.paths.items()
        ]
        head = ["environment", "world", "strategy", "paper_mean", "paper_sd", "paper_ratio"]
        episodes, key = self.comparison.episodes, ["world", "strategy"]
        first = episodes[episodes["episode"] < self.paper.runs].groupby(key)["path_m"]
        first = first.agg(first_n="count", first_mean="mean", first_sd="std").reset_index()
        ours = self.comparison.summary.merge(first, on=key, how="left")
        return pd.DataFrame(published, columns=head).merge(ours, on=key)

    @functools.cached_property
    def orderings(self) -> pd.DataFrame:
        """Tabulate every pair of strategies, in the order of the paper's means: `a` shorter than `b`.

        `paper_p` is Welch's, of the paper's means, standard deviations and number of runs; `claimed`: whether its text
        says the order. `ratio` is our mean of a over that of b, paired, with its 95 % interval, p and verdict. Each
        interval stands alone: of twenty that are undecided in truth about one will seem decided.
        """
        episodes, runs = self.comparison.episodes, self.paper.runs
        paths_m, outcomes = (
            episodes.pivot(index="episode", columns=["world", "strategy"], values=value)
            for value in ("path_m", "outcome")
        )
        rows = []
        for name, environment in self.paper.environments.items():
            for a, b in itertools.combinations(sorted(environment.paths, key=lambda key: environment.paths[key][0]), 2):
                pair = [(self.worlds[name], a), (self.worlds[name], b)]
                ours = paired.finite_ratio(*paths_m.reindex(columns=pair).to_numpy().T)
                complete = (outcomes.reindex(columns=pair) == "COMPLETE").all(axis=1)
                paths = environment.paths[a], environment.paths[b]
                welch = ttest_ind_from_stats(*paths[0], runs, *paths[1], runs, equal_var=False)
                rows.append(
                    {
                        **{"environment": name, "a": a, "b": b, "claimed": {a, b} in self.paper.claimed},
                        **{"paper_ratio": paths[0][0] / paths[1][0], "paper_p": float(welch.pvalue)},
                        **{"ratio": ours.ratio, "ratio_low": ours.low, "ratio_high": ours.high, "p": ours.p},
                        **{"verdict": verdict(ours), "pairs": ours.n, "complete": int(complete.sum())},
                    }
                )
        return pd.DataFrame(rows)

    @property
    def agreement(self) -> str:
        """Say how many pairs of means have the paper's order, and which of its significant orderings hold."""
        ran = self.orderings[self.orderings["pairs"] > 0]
        significant = ran[ran["paper_p"] < 0.05]
        lines = []
        for name, rows in ran.groupby("environment", sort=False):
            same = len(rows[rows["ratio"] < 1])
            told = f"{same} of {len(rows)} pairs of means in the paper's order"
            lines.append(f"- {name}: {told}, Kendall's tau {2 * same / len(rows) - 1:.2f}.")
        for told, rows in (
            ("significant in the paper (Welch's t, p < 0.05)", significant),
            ("significant there and said by its text", significant[significant["claimed"]]),
        ):
            n = [list(rows["verdict"]).count(verdict) for verdict in ("holds", "undecided", "does not hold")]
            lines.append(f"- Of {len(rows)} orderings {told} {n[0]} hold, {n[1]} are undecided, {n[2]} do not hold.")
        return "\n".join(lines)

    def to_pandas(self) -> pd.DataFrame:
        """Return the table of episodes."""
        return self.comparison.episodes

    def to_markdown(self) -> str:
        """Format the notes, a table an environment, and the orderings."""
        text = [f"# {self.paper.title}\n", *(f"{note}\n" for note in self.notes)]
        for name, environment in self.paper.environments.items():
            rows = self.tables[self.tables["environment"] == name]
            text.append(f"## {name} ({environment.where}): {self.worlds[name]}\n")
            text.append(_table_text(rows) if len(rows) else "Nothing has run here.\n")
        return "\n".join([*text, "## Orderings\n", f"{self.agreement}\n", _orderings_text(self.orderings)])

    def _repr_markdown_(self):
        return self.to_markdown()

    def __repr__(self) -> str:
        return f"<Reproduction of {self.paper.title!r}, {len(self.comparison.episodes)} episodes>"


def _table_text(rows):
    n_first = int(rows["first_n"].fillna(0).max())
    head = ["strategy", "paper m", "n", "ours m", "95 % interval", f"ours m, first {n_first} episodes"]
    head += ["paper ratio", "our ratio", "explored", "outcomes"]
    lines = [
        [
            *(row.strategy, tables.spread_text(row.paper_mean, row.paper_sd), str(row.n)),
            *(tables.spread_text(row.mean, row.sd), tables.interval_text(row.ci_low, row.ci_high, 2)),
            *(tables.spread_text(row.first_mean, row.first_sd), tables.ratio_text(row.paper_ratio)),
            tables.ratio_text(row.ratio, row.ratio_low, row.ratio_high),
            *(tables.number_text(row.explored_fraction, 3), row.outcomes),
        ]
        for row in rows.itertuples()
    ]
    return tables.aligned_table(head, lines, left=("strategy", "outcomes"))


def _orderings_text(orderings):
    head = ["environment", "shorter in the paper", "than", "in its text", "paper ratio", "paper p", "our ratio"]
    head += ["verdict", "pairs", "both COMPLETE"]
    lines = [
        [
            *(row.environment, row.a, row.b, "yes" if row.claimed else ""),
            *(tables.ratio_text(row.paper_ratio), tables.number_text(row.paper_p, 3)),
            tables.ratio_text(row.ratio, row.ratio_low, row.ratio_high),
            *(row.verdict, str(row.pairs), str(row.complete)),
        ]
        for row in orderings.itertuples()
    ]
    return tables.aligned_table(head, lines, left=(*head[:4], "verdict"))


def prepare_paper(
    name: str, *, maps: str | os.PathLike[str] | None, episodes: int, seed: int, cell_m: float,
    lidar: LidarLike, rules: RulesLike, robot: RobotLike = ROBOT,
) -> list[Job]:  # fmt: skip
    """Check and load everything before `reproduce` runs. Arguments as there."""
    paper, jobs = find(name), []
    files = [environment.file for environment in paper.environments.values()]
    for file in () if maps is None else files:
        path = os.path.join(os.path.expanduser(maps or ""), file)
        if not os.path.isfile(path):
            raise InputError(f"maps must be a folder that holds {', '.join(files)}; there is no file {path}")
    for environment, world in world_names(paper, maps).items():
        strategies = sorted(paper.environments[environment].paths, key=lambda name: name != paper.reference)
        how = {"episodes": episodes, "seed": seed, "cell_m": cell_m, "start": "random", "lidar": lidar, "rules": rules}
        jobs += prepare_jobs([world], strategies, **how, robot=robot)
    return jobs


def reproduction_of(name: str, maps: str | os.PathLike[str] | None, found: ComparisonResult) -> ReproductionResult:
    """Compare the results of the jobs of `prepare_paper` with the paper."""
    paper = find(name)
    notes = COUNTERPARTS if maps is None else MAPS, paper.remark
    return ReproductionResult(paper, found, world_names(paper, maps), notes)


@checked_names
def reproduce(
    paper: str = "holz2010", *, maps: str | os.PathLike[str] | None = None,
    episodes: int = 100, seed: int = 0, cell_m: float = 0.1, lidar: LidarLike = LIDAR, rules: RulesLike = RULES,
    robot: RobotLike = ROBOT,
    engine: str = "auto", lanes: int | None = None, workers: int | None = None,
    on_progress: Callable[[int], Any] | None = None, progress: bool | None = None,
) -> ReproductionResult:  # fmt: skip
    """Run a paper's strategies in its environments, and compare tables and orderings.

    Args:
      paper: a key of `PAPERS`.
      maps: folder of the paper's maps (`Environment.file`); by default built-in counterparts stand in.
      episodes: of each strategy in each environment.
      seed, cell_m, lidar, rules, robot, engine, lanes, workers, on_progress, progress: as in `comparison.compare`.
    """
    require_engine(engine, lanes)
    how = {"cell_m": cell_m, "lidar": lidar, "rules": rules, "robot": robot}
    jobs = prepare_paper(paper, maps=maps, episodes=episodes, seed=seed, **how)
    with progress_bar(progress, sum(len(job.starts) for job in jobs), "episodes", on_progress) as moved:
        found = run_comparison(jobs, engine=engine, lanes=lanes, workers=workers, on_progress=moved)
    return reproduction_of(paper, maps, found)
