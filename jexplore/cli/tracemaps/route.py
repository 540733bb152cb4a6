"""The command `jexplore route`."""

import contextlib
import dataclasses
import functools
from collections.abc import Sequence
from typing import Annotated, Any

import tyro

from jexplore.cli.options import given_of
from jexplore.cli.output.console import COMPILING, Out, note_if_slow
from jexplore.cli.output.terminal import show_line, show_table
from jexplore.config import InputError
from jexplore.driving.settings import Noise

NO_ROUTE = 1  # exit status


@dataclasses.dataclass(frozen=True)
class RouteCommand:
    """Find the shortest way over a Behavioral Trace Map that a robot may use.

    Prints a table of links and by which way to leave every node; then the links that the robot may not use, with all
    reasons, and what the map does not say. With --drive the robot then follows it in the true building, and what it
    finds otherwise there is told. Without a way, or where it does not arrive, the exit status is 1. With --out it
    writes route.json, route.png and run.json, and with --drive btm.json, the map with what was found.
    """

    map: str | None = None
    """Go over this map, the btm.json of `jexplore trace`."""
    robot: str = "kamui"
    """Go with this robot: kamui (a crawler) or wheeled; with other measures kamui:width_m=0.6,max_slope_deg=8."""
    from_: Annotated[str | None, tyro.conf.arg(name="from")] = None
    """Begin at the node of this id, or at the one that is nearest to X,Y, in metres; by default at the map's first."""
    to: str | None = None
    """Go to a node, named alike, or to the nearest link that is un-searched: unsearched."""
    known_only: bool = False
    """Refuse searched links of which the map does not have width, step, inclination and roll."""
    drive: str | None = None
    """Let the robot follow the way to its last node in this building, that of the map: course:obstacle=none."""
    noise_m: float = 0.01
    """Give its scanners' ranges this standard deviation, in metres."""
    seed: int = 0
    """Draw the noise from this seed."""
    within_m: float = 2.0
    """Take a node for X,Y that lies no farther from it than this, in metres."""
    out: str | None = None
    """Write into this folder; by default nothing is written."""
    overwrite: bool = False
    """Replace the run that the folder holds."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        for name, given in (("--map", self.map), ("--to", self.to)):
            if given is None:
                raise InputError(f"expected {name}: jexplore route --map btm.json --robot wheeled --from 0 --to 4")
        if self.overwrite and self.out is None:
            raise InputError("--overwrite goes with --out DIR")
        if self.drive is None and given_of(self, ("noise_m", "seed")):
            raise InputError("--noise-m and --seed go with --drive WORLD")
        if self.drive is not None:
            from jexplore.studies.checks import ready_worlds

            Noise(range_m=self.noise_m)
            ready_worlds(self.drive, 0.1)
        from jexplore.tracemap.json_form import read_btm

        btm = read_btm(str(self.map))
        with contextlib.ExitStack() as stack:
            out = None if self.out is None else stack.enter_context(Out(self, arguments))
            route = self._found(btm)
            status, changed = _tell(btm, route), btm
            if self.drive is not None and not status:
                status, changed = self._followed(btm, route)
            if out is not None:
                _write(out, self.drive is not None, btm, route, changed)
            return status

    def _found(self, btm) -> Any:
        from jexplore.engine.backend import use_compilation_cache
        from jexplore.studies.traces import routes

        use_compilation_cache()
        start = btm.nodes[0].id if self.from_ is None and btm.nodes else self.from_ or ""
        with note_if_slow(COMPILING):
            return routes.route(
                btm, self.robot, start, self.to or "", known_only=self.known_only, within_m=self.within_m
            )

    def _followed(self, btm, route):
        """Drive the route; return the exit status, and the map with the findings."""
        if not route.links:
            show_line("driven: nothing, for the way has no link")
            return 0, btm
        from jexplore.studies.traces.following import follow

        with note_if_slow(COMPILING):
            found = follow(str(self.drive), btm, [route], self.robot, noise=Noise(range_m=self.noise_m), seed=self.seed)
        row = found.table.iloc[0]
        told = f"{row['outcome']} after {row['path_m']:.2f} m, {row['off_m']:.2f} m from where the map has the end"
        show_line(f"driven: {told}; {row['missed']} of {row['places']} places missed, {row['extra']} more found")
        for line in found.changes:
            show_line(f"found: {line}", indent=7)
        return (0 if row["outcome"] == "ARRIVED" else NO_ROUTE), found.map


def _tell(btm, route) -> int:
    """Print a route, or the reason for having none; return the exit status."""
    from jexplore.report import trace_tables

    if route.is_found:
        show_table(trace_tables.route_table(route))
    else:
        show_line(f"no route: {route.trouble}")
    for title, lines in (("refused", trace_tables.refused_lines(btm, route)), ("unknown", route.unknown)):
        for line in lines:
            show_line(f"{title}: {line}", indent=len(title) + 2)
    return 0 if route.is_found else NO_ROUTE


def _write(out, has_driven, btm, route, changed):
    """Write the findings and draw them."""
    from jexplore.report import plot_traces, store
    from jexplore.tracemap import json_form

    record = out.record(map=btm.attributes)
    found = {**store.jsonable(route), "is_found": route.is_found}
    for name in ("refused", "barriers"):
        found[name] = [{"id": own, "reasons": list(why)} for own, why in getattr(route, name)]
    files = {"route.json": found}
    if has_driven:
        files["btm.json"] = json_form.to_json(changed)
    title = route.trouble or f"{route.robot}, node {route.start} to {route.end}, {route.length_m:.2f} m"
    figure = functools.partial(plot_traces.trace_figure, btm, None, title=title, route=route)
    out.finish(record, files, "", {"route.png": figure})
