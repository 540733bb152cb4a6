"""The commands `jexplore worlds`, `jexplore strategies` and `jexplore league`."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from jexplore.cli.options import CellOptions, OutOptions
from jexplore.cli.output.console import Out, note_if_slow, working
from jexplore.cli.output.terminal import show_line, show_table
from jexplore.config import InputError, require_number


@dataclasses.dataclass(frozen=True)
class Worlds(OutOptions, CellOptions):
    """List the built-in worlds, or measure and picture some.

    Without names, --geometry and --out, it lists the generators and what they take. Otherwise it prints a table of the
    worlds named, by default of every generator, and writes worlds.png.
    """

    worlds: Positional[tuple[str, ...]] = ()
    """Measure these worlds: generators such as cave#3, or map files: map.yaml (ROS), map.png@16x16 (metres),
    map.png@0.05 (metres a pixel), plan.json (HouseExpo), scans.log (CARMEN), run.bag (ROS)."""
    geometry: bool = False
    """Also measure rooms, openings, corridors, ways round and furniture; rooms that are not known are found first."""
    clearance_m: float = 0.30
    """Tell of floor that a robot of this clearance does not reach, and by --geometry the share that it does, in metres.
    """

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.worlds import GENERATORS, generator_parameters, known_generators

        if not self.worlds and self.out is None and not self.geometry:
            show_line("Built-in worlds. A name may carry a seed and parameters: hospital#3:width_m=60,height_m=25")
            print()
            for name in known_generators():
                defaults = " ".join(f"{key}={value}" for key, value in generator_parameters(name).items())
                show_line(f"  {name:<10}{defaults}", indent=12)
            print()
            show_line(
                "Map files: map.yaml (ROS), map.png@16x16 (metres), map.png@0.05 (metres a pixel), plan.json, "
                "scans.log, run.bag, run.mcap"
            )
            return None
        from jexplore.engine.backend import use_compilation_cache
        from jexplore.report.plots import maps
        from jexplore.report.tables import aligned_table
        from jexplore.studies.checks import ready_worlds
        from jexplore.studies.geometry import geometry, geometry_table
        from jexplore.studies.results.provenance import describe_world
        from jexplore.worlds.regions import warn_of_floor
        from jexplore.worlds.starts import start_region

        with Out(self, arguments) as out:
            require_number("clearance_m", self.clearance_m, high=100)
            with note_if_slow("jexplore: loading worlds"):
                worlds = ready_worlds(self.worlds or tuple(GENERATORS), self.cell_m)
            for world in worlds:
                warn_of_floor(world, start_region(world, self.clearance_m), self.clearance_m, drawn=True)
            described, rows, measured = list(map(describe_world, worlds)), [], []
            for world, about in zip(worlds, described):
                height, width = world.shape
                start = "-" if world.start is None else "{},{},{}".format(*world.start)
                size = f"{width * world.cell_m:.1f} x {height * world.cell_m:.1f}"
                n_rooms = "-" if about["rooms"] is None else str(about["rooms"])
                rows.append((world.name, f"{width} x {height}", size, f"{world.free_m2:.1f}", n_rooms, start))
            if self.geometry:
                use_compilation_cache()
                with working(len(worlds), "worlds") as on_progress:
                    for world, about in zip(worlds, described):
                        measured.append(geometry(world, clearance_m=self.clearance_m))
                        about["geometry"] = dataclasses.asdict(measured[-1])
                        on_progress(len(measured))
            figure = functools.partial(maps.worlds_figure, [(world.name, world) for world in worlds])
            left = ["world", "cells", "metres", "free m²", "rooms", "start"]
            text = aligned_table(left, rows, left=left)
            text += f"\n{geometry_table(measured)}" if measured else ""
            return out.finish(out.record(worlds=described), {"worlds.png": figure}, text)


@dataclasses.dataclass(frozen=True)
class Strategies:
    """List strategies, modifiers, their parameters and sources."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.policies import MODIFIERS
        from jexplore.policies.catalogue.grammar import strategies
        from jexplore.report.tables import aligned_table

        found = strategies()
        show_table(aligned_table(found.head, found.rows, left=found.head))
        head = ["modifier", "meaning"]
        modifiers = [(f"+{name}", text) for name, text in MODIFIERS.items()]
        show_table(aligned_table(head, modifiers, left=head))
        show_line("Names are put together as strategy+modifier:parameter=value,..., such as closest+recheck")
        show_line("One's own: module:function+modifier:parameter=value,..., of a module here or installed")


@dataclasses.dataclass(frozen=True)
class LeagueCommand:
    """Show a league that anybody can enter, or enter strategies.

    `show` prints the standings. `submit RUN` checks a folder of results of `jexplore compare` against the league's
    worlds, starts, settings and version, and writes a file for each of its strategies that is not entered yet.
    """

    action: Positional[Literal["show", "submit"]] = "show"
    """Show the standings, or submit a run."""
    run: Positional[Path | None] = None
    """Folder of results to submit."""
    name: str = "exploration-240"
    """Name of the league."""
    entries: Path | None = None
    """Folder of the entries; by default leagues/NAME."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies.results import league

        folder = self.entries or Path("leagues", self.name)
        if (self.action == "submit") != (self.run is not None):
            raise InputError("expected the folder of a run with submit, and none with show: jexplore league submit RUN")
        league.league_of(self.name)
        if not folder.is_dir():
            raise InputError(
                f"no entries in {folder}: an installed package has none; give leagues/{self.name} of a checkout of the "
                "repository with --entries"
            )
        if self.run is not None:
            for strategy, is_new in league.submit(self.run, self.name, folder).items():
                show_line(f"{strategy}: {'entered' if is_new else 'as entered before'}")
            print()
        show_table(league.league_text(folder, self.name))
        return None
