"""The command `jexplore reproduce`."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Annotated

import tyro

from jexplore.cli.compare import FINISHING, finish, run_with_bar
from jexplore.cli.console import Out, note
from jexplore.cli.options import EngineName, OutFolder, is_small
from jexplore.config import Lidar, Rules


def default_paper_episodes() -> int:
    return 5 if is_small() else 100


@dataclasses.dataclass(frozen=True)
class Reproduce:
    """Reproduce a paper's tables: its strategies in its environments, beside its own figures.

    Prints a Markdown table an environment, and which of the orderings that the paper claims hold here. Writes
    episodes.parquet, run.json and reproduce.png.
    """

    paper: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[PAPER]")] = "holz2010"
    """The paper: holz2010 (Holz, Basilico, Amigoni, Behnke 2010)."""
    maps: Annotated[str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of the paper's maps: stage/cave_filled.png, avz/avz5floor_open.yaml, stage/hospital_section.png.
    By default built-in counterparts stand in for them."""
    episodes: int = dataclasses.field(default_factory=default_paper_episodes)
    """Episodes of each strategy in each environment; the first are also reported alone, as many as the paper's runs."""
    seed: int = 0
    """Seed of starts and draws."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    engine: EngineName = "auto"
    """How episodes run, as for `jexplore compare`."""
    lanes: int | None = None
    """Episodes at a time in lockstep; by default as many as the memory holds."""
    out: OutFolder = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    lidar: Lidar = dataclasses.field(default_factory=Lidar)
    rules: Rules = dataclasses.field(default_factory=Rules)

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Runs the command; returns the exit status, None for 0."""
        from jexplore.studies import reproduction

        out = Out(self, "reproduce")
        jobs = reproduction.prepare_paper(
            self.paper,
            maps=self.maps,
            episodes=self.episodes,
            seed=self.seed,
            cell_m=self.cell_m,
            lidar=self.lidar,
            rules=self.rules,
        )
        report = run_with_bar(self, jobs)
        with note(FINISHING):
            found = reproduction.assemble(self.paper, self.maps, jobs, report, self.rules)
            tables, orderings = (table.to_dict("records") for table in (found.tables, found.orderings))
            entries = {"notes": found.notes, "tables": tables, "orderings": orderings}
            record = functools.partial(out.record, arguments, self, **entries)
            figures = {"reproduce.png": found.figure()}
            return finish(out, found.comparison, report, found.to_markdown(), figures, record)
