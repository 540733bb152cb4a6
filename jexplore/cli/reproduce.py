"""The command `jexplore reproduce`."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Annotated

import tyro

from jexplore.cli.compare import FINISHING, finish_comparison, run_with_bar, show_finished
from jexplore.cli.options import EngineOptions, ResumeOptions, TimedOptions, fields_of, given_of, is_small
from jexplore.cli.output.console import Out, note_if_slow, progress_of, working
from jexplore.config import InputError


@dataclasses.dataclass(frozen=True)
class Reproduce(EngineOptions, ResumeOptions, TimedOptions):
    """Reproduce a paper's tables: its strategies in its environments, next to its own figures.

    Prints a Markdown table an environment, and which orderings of the paper's means hold here. Writes episodes.parquet,
    run.json and reproduce.png. For dare: its Table I next to ours; writes dare.parquet and run.json.
    """

    paper: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[PAPER]")] = "holz2010"
    """Reproduce this paper: holz2010 (Holz, Basilico, Amigoni, Behnke 2010) or dare (Cao et al. 2025), which has a
    scanner and rules of its own."""
    maps: Annotated[str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Read the paper's maps from this folder: stage/cave_filled.png, avz/avz5floor_open.yaml,
    stage/hospital_section.png; for dare 1.png to 100.png. By default built-in counterparts stand in for them, except
    for dare."""
    episodes: int = dataclasses.field(default_factory=lambda: 5 if is_small() else 100)
    """Number of episodes of each strategy in each environment. The first ones, as many as in the paper, are also
    reported alone. For dare the number of maps."""
    own_rules: bool = False
    """For dare: explore its maps by the rules of this package instead, with the league's strategies and bounds; writes
    episodes.parquet, bounds.parquet and paths.png."""
    seed: int = 0
    """Draw starts and all that is random from this seed."""
    cell_m: float = 0.1
    """Make the edge of a cell this long, in metres."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies import reproduction

        if self.paper == "dare":
            return self._dare(arguments)
        if self.own_rules:
            raise InputError("leave out --own-rules: it is of dare")
        with Out(self, "reproduce") as out:
            settings = fields_of(self, "maps episodes seed cell_m lidar rules robot")
            jobs = reproduction.prepare_paper(self.paper, **settings)
            made = run_with_bar(self, jobs, out)
            if made is None:
                return show_finished(
                    out, lambda found, _: found.to_markdown(), lambda found, league: {"reproduce.png": found.figure}
                )
            with note_if_slow(FINISHING):
                found = reproduction.reproduction_of(self.paper, self.maps, made)
                tables, orderings = (table.to_dict("records") for table in (found.tables, found.orderings))
                entries = {"notes": found.notes, "tables": tables, "orderings": orderings}
                record = functools.partial(out.record, arguments, self, **entries)
                return finish_comparison(out, made, found.to_markdown(), {"reproduce.png": found.figure}, record)

    def _dare(self, arguments):
        """Run the planners of DARE's Table I on its maps."""
        from jexplore.studies.dare.table import reproduce_dare

        if self.maps is None:
            raise InputError("dare has no built-in counterparts: name the folder of its maps with --maps DIR")
        for option in given_of(self, ("cell_m", "lidar", "rules", "robot", "engine", "lanes", "resume")):
            raise InputError(f"dare has rules of its own: leave out {option}")
        if self.own_rules:
            return self._own_rules(arguments, self.maps)
        with Out(self, "reproduce") as out:
            how = fields_of(self, "episodes seed workers")
            with progress_of(self.episodes, "maps") as progress:
                found = reproduce_dare(self.maps, **how, on_progress=progress.update)
            record = out.record(arguments, self, tables=found.table.to_dict("records"))
            return out.finish(record, {"dare.parquet": found.episodes}, found.to_markdown())

    def _own_rules(self, arguments, maps):
        """Explore DARE's maps by this package's rules."""
        from jexplore.studies.dare import own
        from jexplore.studies.results import saving

        with Out(self, "reproduce") as out:
            how = fields_of(self, "episodes seed workers")
            with working(self.episodes * (len(own.STRATEGIES) + 1), "episodes and bounds") as on_progress:
                found, bounds = own.explore_dare(maps, **how, on_progress=on_progress)
            files = {**saving.comparison_files(found), "bounds.parquet": bounds.table}
            drawn = {"paths.png": functools.partial(own.paths_figure, found)}
            record = out.record(arguments, self, interrupted=bounds.interrupted)
            return out.finish(record, files, own.own_text(found, bounds), drawn, interrupted=bounds.interrupted > 0)
