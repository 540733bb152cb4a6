"""The command `jexplore league`."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jexplore.cli.output.terminal import show_line, show_table
from jexplore.config import InputError


@dataclasses.dataclass(frozen=True)
class LeagueCommand:
    """Show a league that anybody can enter, or enter strategies.

    `show` prints the standings. `submit RUN` checks a folder of results of `jexplore compare` against the league's
    worlds, starts, settings and version, and writes a file for each of its strategies that is not entered yet.
    """

    action: Annotated[tyro.conf.Positional[Literal["show", "submit"]], tyro.conf.arg(metavar="[show | submit]")] = (
        "show"
    )
    """Show the standings, or submit a run."""
    run: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[RUN]")] = None
    """Folder of results to submit."""
    name: str = "exploration-240"
    """Name of the league."""
    entries: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: leagues/NAME)")] = None
    """Folder of the entries."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies import league

        folder = self.entries or Path("leagues", self.name)
        if (self.action == "submit") != (self.run is not None):
            raise InputError("expected the folder of a run with submit, and none with show: jexplore league submit RUN")
        if self.run is not None:
            for strategy, is_new in league.submit(self.run, self.name, folder).items():
                show_line(f"{strategy}: {'entered' if is_new else 'as entered before'}")
            print()
        show_table(league.league_text(folder, self.name))
        return None
