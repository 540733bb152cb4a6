"""The command `jexplore trace`."""

import dataclasses
import math
import sys
from collections.abc import Sequence
from typing import Annotated

import tyro

from jexplore.cli.console import COMPILING, Out, note, say, working
from jexplore.cli.options import EngineName, OneStrategy, OneWorld, OutFolder
from jexplore.config import InputError
from jexplore.driving.settings import Noise, Tuning


@dataclasses.dataclass(frozen=True)
class Trace:
    """Let a robot drive through a building and write its Behavioral Trace Map.

    Prints the node and link tables of run 0 and how many runs made the same map. Writes btm.json, btm.geojson (nav2
    Route Server), btm.graphml, btm.png, runs.parquet and run.json.
    """

    world: OneWorld = "course"
    """A course such as course#3 or course:obstacle=stairs, or any world: see `jexplore worlds`."""
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")] = "kamui"
    """kamui (a crawler) or wheeled; with other measures kamui:width_m=0.6,max_slope_deg=8."""
    runs: int = 1
    """Runs, of every setting if some are swept."""
    noise_m: Annotated[float | None, tyro.conf.arg(metavar="M", help_behavior_hint="")] = None
    """Standard deviation of the scanners' ranges, metres: the same as --noise.range-m."""
    sweep: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUES [...]", help_behavior_hint="")] = ()
    """Thresholds to vary, all in one batch: votes=1,3,5 (a list), circle=1.1:2.0 (a range), noise.range_m=0,0.03.
    Lists make every combination; with a range, --settings draws by Latin hypercube."""
    settings: int = 100
    """Draws of a sweep over ranges."""
    start: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y DEG", help_behavior_hint="")] = None
    """Start in metres and degrees (default: the world's own)."""
    seed: int = 0
    """Seed of the noise."""
    engine: EngineName = "auto"
    """How runs are made: one after the other on each core, or many in lockstep, as suits a GPU."""
    lanes: int | None = None
    """Runs at a time in lockstep; by default as many as the memory holds."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    max_steps: int = 6000
    """Steps of 0.1 s after which a run ends as STEP_LIMIT."""
    animate: bool = False
    """Also write btm.html: what the operator sees of run 0, one file that replays without a network."""
    from_episode: bool = False
    """Instead of driving so, run an exploration episode and read the map off what it has seen (Voronoi graph)."""
    strategy: OneStrategy = "closest+recheck"
    """Of that episode."""
    out: OutFolder = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    tuning: Tuning = dataclasses.field(default_factory=Tuning)
    noise: Noise = dataclasses.field(default_factory=Noise)

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Runs the command; returns the exit status, None for 0."""
        from jexplore.engine.backend import use_compilation_cache
        from jexplore.report import trace_tables
        from jexplore.studies.traces import tracing

        out = Out(self, "trace")
        noise = self.noise if self.noise_m is None else dataclasses.replace(self.noise, range_m=self.noise_m)
        if self.from_episode:
            return _trace_episode(out, self, arguments)
        if self.strategy != type(self)().strategy:
            raise InputError("--strategy goes with --from-episode")
        plan = tracing.prepare_trace(
            self.world,
            robot=self.robot,
            runs=self.runs,
            seed=self.seed,
            tuning=self.tuning,
            noise=noise,
            start=self.start,
            sweep=self.sweep,
            settings=self.settings,
            cell_m=self.cell_m,
            max_steps=self.max_steps,
        )
        use_compilation_cache()
        engine = None if self.engine == "auto" else self.engine
        with working(plan.runs * plan.settings, "runs") as on_progress:
            found = tracing.execute(plan, engine=engine, lanes=self.lanes, on_progress=on_progress)
        if found.driven is None:
            raise KeyboardInterrupt  # before the first run was finished
        files = _drawn(found)
        if self.animate and not found.report.costs.interrupted:
            from jexplore.report import operator_view
            from jexplore.studies.traces import recording

            try:
                with working(len(found.driven.truth), "steps") as on_progress:
                    page = operator_view.page(recording.record(plan, on_progress))
                files["btm.html"] = lambda path: path.write_text(page, encoding="utf-8")
            except KeyboardInterrupt:
                print("warning: interrupted, btm.html was left out", file=sys.stderr)
        text = trace_tables.tables(found.first) + "\n" + "\n".join(trace_tables.summary(found))
        costs = found.report.costs
        names = ("compile_s", "run_s", "engine", "devices", "lanes", "useful")
        entries = {"runs_per_s": len(found.table) / costs.run_s, **{name: getattr(costs, name) for name in names}}
        return _finish_trace(out, out.record(arguments, self, **entries), files, text, costs.interrupted)


def _drawn(found):
    """The pictures and tables of a `Traced`: `{name: writer}`."""
    from jexplore.report import plot, plot_traces, store
    from jexplore.studies.traces import recording

    plan, track = found.plan, found.driven
    figure = plot_traces.figure(
        found.first,
        recording.wall_lines(plan),
        recording.moved(track.estimate, plan.world.origin_m),
        recording.scan_points(plan, track),
        track.mode,
        recording.MODE_NAMES,
        f"{plan.robot.name} in {plan.world.name}",
        pitch_deg=track.pitch * (180 / math.pi),
    )
    return {
        **_exchanged(found.first),
        "btm.png": lambda path: plot.save_figure(figure, path),
        "runs.parquet": lambda path: store.write_parquet(found.table, path),
    }


def _exchanged(found):
    """Files of a Behavioral Trace Map for other programs: `{name: writer}`."""
    from jexplore.report import store
    from jexplore.tracemap import export, json_form

    files = {"btm.json": lambda path: store.write_json(json_form.to_json(found), path)}
    if any(link.end >= 0 for link in found.links):  # a route needs an edge
        route = export.geojson(found)
        files["btm.geojson"] = lambda path: store.write_json(route, path)
    graph = export.graphml(found)
    return {**files, "btm.graphml": lambda path: path.write_text(graph, encoding="utf-8")}


def _finish_trace(out, record, files, text, interrupted=False):
    from jexplore.report import store

    wrote = out.write({**files, "run.json": lambda path: store.write_json(record, path)})
    print(text)
    print(wrote)
    if interrupted:
        return say("jexplore: interrupted, what was finished was written", 130)
    return 0


def _trace_episode(out, options, arguments):
    """A map from what an exploration episode has seen."""
    from jexplore.report import plot, trace_tables
    from jexplore.studies.traces import extraction

    plain, own = type(options)(), ("world", "strategy", "seed", "cell_m", "tuning", "out", "overwrite", "from_episode")
    for field in dataclasses.fields(options):
        if field.name not in own and getattr(options, field.name) != getattr(plain, field.name):
            option = field.name.replace("_", "-")
            raise InputError(f"--from-episode takes no --{option}: an episode's robot is that of `jexplore explore`")
    with note(COMPILING):
        found = extraction.extracted(
            options.world,
            options.strategy,
            seed=options.seed,
            cell_m=options.cell_m,
            tuning=options.tuning,
        )
    files = {**_exchanged(found.map), "btm.png": lambda path: plot.save_figure(found.figure(), path)}
    text = trace_tables.tables(found.map) + "\n" + "\n".join(found.agreement())
    record = out.record(arguments, options, result=found.measures, agreement=found.agreement())
    return _finish_trace(out, record, files, text)
