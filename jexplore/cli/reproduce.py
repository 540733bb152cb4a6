"""The command `jexplore reproduce`."""

import dataclasses
import functools
from collections.abc import Sequence

from tyro.conf import Positional

from jexplore.cli.compare import FINISHING, finish_comparison, run_with_bar, show_finished
from jexplore.cli.options import EngineOptions, ResumeOptions, TimedOptions, fields_of, is_small
from jexplore.cli.output.console import Out, note_if_slow


@dataclasses.dataclass(frozen=True)
class Reproduce(EngineOptions, ResumeOptions, TimedOptions):
    """Reproduce a paper's tables: its strategies in its environments, next to its own figures.

    Prints a Markdown table an environment, and which orderings of the paper's means hold here. Writes episodes.parquet
    and run.json.
    """

    paper: Positional[str] = "holz2010"
    """Reproduce this paper: holz2010 (Holz, Basilico, Amigoni, Behnke 2010)."""
    maps: str | None = None
    """Read the paper's maps from this folder: stage/cave_filled.png, avz/avz5floor_open.yaml,
    stage/hospital_section.png. By default built-in counterparts stand in for them."""
    episodes: int = dataclasses.field(default_factory=lambda: 5 if is_small() else 100)
    """Number of episodes of each strategy in each environment. The first ones, as many as in the paper, are also
    reported alone."""
    seed: int = 0
    """Draw starts and all that is random from this seed."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies import reproduction

        with Out(self, arguments) as out:
            settings = fields_of(self, "maps episodes seed cell_m lidar rules robot")
            jobs = reproduction.prepare_paper(self.paper, **settings)
            made = run_with_bar(self, jobs, out)
            if made is None:
                return show_finished(out, lambda found, _: found.to_markdown(), lambda found, league: {})
            with note_if_slow(FINISHING):
                found = reproduction.reproduction_of(self.paper, self.maps, made)
                tables, orderings = (table.to_dict("records") for table in (found.tables, found.orderings))
                entries = {"notes": found.notes, "tables": tables, "orderings": orderings}
                record = functools.partial(out.record, **entries)
                return finish_comparison(out, made, found.to_markdown(), {}, record)
