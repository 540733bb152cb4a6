"""The report of a run: one page with what was asked, tables, pictures and replays."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jexplore.config import Lidar, Rules
from jexplore.exploration.batch import Job, Outcomes
from jexplore.report.page.replay import ReplayData
from jexplore.report.page.report import report_page
from jexplore.studies.replays import MAX_PAIRS, replays_of

ELSEWHERE = ("summary", "worlds", "warnings", "standings", "tables", "orderings", "measured", "asked")
"""Entries of run.json that a report shows in another form, or not at all."""
PICTURES = {
    "compare.png": "Path lengths of all episodes, means with their intervals, and ratios to the first strategy",
    "coverage.png": "Share of what can be known along the path",
    "paths.png": "The map as each strategy saw it in episode 0, with its path",
    "waste.png": "Where path was wasted in episode 0",
    "league.png": "Path lengths as ratios to those of the first strategy, over all worlds",
    "reproduce.png": "Path lengths beside the paper's",
    "sweep.png": "Path lengths along the first setting that is varied",
    "sweep-map.png": "Path lengths over the first two settings that are varied",
    "episode.png": "The known map and the path at the end",
}
"""Captions of a run's pictures."""


def replays_for(
    jobs: Sequence[Job],
    record: Mapping[str, Any],
    firsts: Mapping[int, Outcomes] | None = None,
    labels: Sequence[str] = (),
) -> tuple[list[ReplayData], list[str]]:
    """Replay the first episodes of the first jobs, which have their scanners and rules: see `replays.replays_of`.

    Args:
      jobs: of a run.
      record: what its run.json holds, which says by what engine it was run.
      firsts: number of a job -> what it left, of the first jobs; where one is missing, they are run once
        more.
      labels: as in `replays.replays_of`.
    """
    have = [None if firsts is None else firsts.get(i) for i in range(min(len(jobs), MAX_PAIRS))]
    outcomes = [found for found in have if found is not None]
    engine = "jax" if record["engine"] == "jax" else "auto"
    known = outcomes if len(outcomes) == len(have) else None
    return replays_of(jobs, Lidar(), Rules(), outcomes=known, labels=labels, engine=engine)


def write_report(
    path: Path,
    title: str,
    record: Mapping[str, Any],
    tables: Iterable[tuple[str, Any]],
    pictures: Iterable[Path],
    replays: Sequence[ReplayData],
    notes: Iterable[str] = (),
) -> None:
    """Write the report of a run.

    Args:
      path: the file.
      title: of the page.
      record: what run.json holds.
      tables: pairs of a heading and a table.
      pictures: files that are there.
      replays, notes: from `replays_for`.
    """
    asked = {key: value for key, value in record.items() if key not in ELSEWHERE}
    figures = [(one.name, one.read_bytes(), PICTURES.get(one.name, one.stem)) for one in pictures]
    page = report_page(title, asked, tables, figures, replays, record.get("warnings", ()), notes=notes)
    path.write_text(page, encoding="ascii")
