"""The command `jexplore trace`."""

import collections
import dataclasses
import functools
import math
import sys
from collections.abc import Sequence
from typing import Any, Literal

from jexplore.cli.options import CellOptions, EngineOptions, ResumeOptions, fields_of, given_of
from jexplore.cli.output.console import Out, note_if_slow, say, working
from jexplore.config import InputError
from jexplore.driving.settings import Noise, Tuning
from jexplore.report.tables import aligned_table, number_text
from jexplore.tracemap.json_form import to_json
from jexplore.tracemap.merging.limits import TeamLimits

SAME_WAY_M = 0.01  # two ways no farther apart than this are one


@dataclasses.dataclass(frozen=True)
class Trace(EngineOptions, ResumeOptions, CellOptions):
    """Let a robot drive through a building and write its Behavioral Trace Map.

    Prints the node and link tables of run 0 and how many runs made the same map. Writes btm.json, btm.png,
    runs.parquet and run.json.
    """

    world: str = "course"
    """Drive through this course, such as course#3 or course:obstacle=stairs, or any world; see `jexplore worlds`."""
    robot: str = "kamui"
    """Drive this robot: kamui (a crawler) or wheeled; with other measures kamui:width_m=0.6,max_slope_deg=8."""
    runs: int | None = None
    """Number of runs, of every setting if some are swept; by default one a start."""
    starts: int | None = None
    """Begin run i at draw i modulo this number of the seed; by default all runs begin at one place."""
    noise_m: float | None = None
    """Give the scanners' ranges this standard deviation, in metres, as --noise.range-m does."""
    sweep: tuple[str, ...] = ()
    """Vary these thresholds, all in one batch: votes=1,3,5 (a list), circle=1.1:2.0 (a range), noise.range_m=0,0.03, or
    other numbers of the robot, sensing.every_m=0.1,0.2. Lists make every combination; with a range, --settings are
    drawn by Latin hypercube."""
    settings: int = 100
    """Number of settings drawn in a sweep over ranges."""
    start: tuple[float, float, float] | None = None
    """Start at this x, y, in metres, and heading, in degrees (default: the world's own start)."""
    seed: int = 0
    """Draw the noise from this seed."""
    max_steps: int | None = None
    """End a run as STEP_LIMIT after this many steps of 0.1 s; by default 6000, more in a large building."""
    nodes: int | None = None
    """Most nodes of the map; by default 32 for a course with a goal, else more than the true map has."""
    links: int | None = None
    """Most links of the map; by default two a node."""
    perception: Literal["auto", "triangles", "map"] = "auto"
    """Perceive by triangles of single scans, as in the paper, or by a local map, on level ground (auto: triangles on
    courses and uneven ground)."""
    attribute: tuple[str, ...] = ()
    """Give the node that is nearest to a place in the building, in metres, an attribute: victim=true@12.5,4,
    radio_dbm=-61@3,8."""
    corrected: bool = False
    """Write the map of run 0 with places that fit the odometry along all its links: what has drifted until a place was
    met again is spread over the links (frame map)."""
    animate: bool = False
    """Also write btm.html, one file that replays without a network what the operator sees of run 0."""
    robots: int | None = None
    """Let this number of robots, 1 to 16, drive at the same time, and merge their maps whenever two are in contact."""
    contact: str = "all"
    """With --robots: which of them exchange maps: all, none or, within M metres, range:M."""
    team_starts: tuple[str, ...] = ("apart",)
    """With --robots: begin far from each other (apart), next to the first (together), or at X,Y,HEADING_DEG each."""
    limits: TeamLimits = dataclasses.field(default_factory=TeamLimits)
    tuning: Tuning = dataclasses.field(default_factory=Tuning)
    noise: Noise = dataclasses.field(default_factory=Noise)

    @property
    def own_noise(self) -> Noise:
        """Return the noise, with that of --noise-m."""
        return self.noise if self.noise_m is None else dataclasses.replace(self.noise, range_m=self.noise_m)

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies.traces import tracing
        from jexplore.studies.traces.job import prepare_trace

        for given in given_of(self, ("contact", "team_starts", "limits")) if self.robots is None else []:
            raise InputError(f"{given} goes with --robots")
        if self.noise_m is not None and self.noise.range_m not in (type(self)().noise.range_m, self.noise_m):
            raise InputError("--noise-m and --noise.range-m say the same: give one of them")
        with Out(self, arguments) as out:
            if self.robots is not None:
                alone = "runs starts sweep settings engine lanes corrected animate resume"
                for given in given_of(self, alone.split()):
                    raise InputError(f"--robots takes no {given}: every robot makes one run")
                return _trace_robots(out, self)
            own = fields_of(
                self, "robot runs starts seed tuning start sweep settings cell_m max_steps nodes links perception"
            )
            plan = prepare_trace(self.world, **own, noise=self.own_noise, attributes=self.attribute)
            if self.corrected and plan.perception == "map":
                raise InputError(
                    "--corrected goes with --perception triangles: a local map's pose has nothing to spread"
                )
            if plan.size[0] < plan.places:
                say(f"jexplore: note: the true map has {plan.places} nodes, this one has room for {plan.size[0]}", 0)
            ledger = out.keep(tracing.asked_of_runs(plan), len(tracing.run_blocks(plan)))
            if ledger is None:
                return out.finish({}, {}, "")
            return self._run(out, plan, ledger)

    def _run(self, out, plan, ledger):
        from jexplore.engine.backend import use_compilation_cache
        from jexplore.report import trace_tables
        from jexplore.studies.traces import tracing
        from jexplore.tracemap.corrected import correct_map

        use_compilation_cache()
        with working(plan.runs * plan.settings, "runs") as on_progress:
            how = {"on_progress": on_progress, "ledger": ledger}
            found = tracing.execute(plan, **fields_of(self, "engine lanes workers"), **how)
        costs = found.costs
        runs_per_s = (len(found.table) - found.resumed) / costs.run_s if costs.run_s else None
        missing = plan.runs * plan.settings - len(found.table)
        record = out.record(
            **{"runs_per_s": runs_per_s, "resumed": found.resumed, "interrupted": missing},
            **{"worlds": [plan.world], "costs": costs},
        )
        first = correct_map(found.first) if self.corrected else found.first
        files = {"btm.json": to_json(first), "runs.parquet": found.table}
        text = trace_tables.map_tables(first) + "\n" + "\n".join(trace_tables.summary(found))
        pictures: dict[str, Any] = {"btm.png": functools.partial(_draw, found, first)}
        if self.animate and not costs.interrupted:
            pictures["btm.html"] = functools.partial(_write_view, found)
        return out.finish(record, files, text, pictures, interrupted=costs.interrupted)


def _write_view(found, path):
    """Write the operator's page of run 0."""
    import numpy as np

    from jexplore.report import operator_view
    from jexplore.studies.traces import recording

    n = len(found.driven.truth)
    with working(n, "steps") as on_progress:
        seen = recording.record_run(found.plan, lambda done: on_progress(min(done, n)))
    way_m = recording.in_world_frame(found.driven.truth, found.plan.world.origin_m)[:, :2]
    m = min(n, len(seen.pose))
    off_m = np.hypot(*(seen.pose[:m, :2] - way_m[:m]).T).max()
    if len(seen.pose) != n or off_m > SAME_WAY_M:
        print(
            f"warning: {path.name} shows run 0 as it was driven once more, step by step: rounding differs, so that it "
            f"has {len(seen.pose)} steps (run 0 has {n}) and lies up to {off_m:.2f} m off",
            file=sys.stderr,
        )
    path.write_text(operator_view.page(seen), encoding="utf-8")


def _draw(found, first):
    """Draw a `TraceResult`, with the map of run 0 as it is written."""
    from jexplore.report import plot_traces
    from jexplore.studies.traces import recording

    plan, track, log = found.plan, found.driven, found.scans()
    return plot_traces.trace_figure(
        first,
        recording.wall_lines(plan),
        recording.in_world_frame(track.estimate, plan.world.origin_m),
        recording.beam_ends(log, log.odometry)[log.echo],
        track.mode,
        recording.MODE_NAMES,
        f"{plan.robot.name} in {plan.world.name}",
        pitch_deg=track.pitch * (180 / math.pi),
    )


def _trace_robots(out, options):
    """Run a team of trace robots, and write their maps, the merged ones, tables, a picture and the station's page.

    `options` are those of `jexplore trace`.
    """
    from jexplore.engine.backend import use_compilation_cache
    from jexplore.studies.traces.teams.clock import run_robots
    from jexplore.studies.traces.teams.team import merge_team, prepare_team, read_reach
    from jexplore.tracemap import json_form

    read_reach(options.contact)
    own = fields_of(options, "robot seed tuning start cell_m max_steps nodes links perception")
    starts = options.team_starts[0] if len(options.team_starts) == 1 else options.team_starts
    own |= {"noise": options.own_noise, "attributes": options.attribute}
    plan = prepare_team(options.world, options.robots, starts, **own)
    use_compilation_cache()
    with working(plan.runs, "robots") as on_progress:
        logs, costs = run_robots(plan, workers=options.workers, on_progress=on_progress)
    with note_if_slow("jexplore: merging maps"):
        found = merge_team(plan, logs, options.contact, options.limits, costs)
    files = {f"{name}.json": json_form.to_json(btm) for name, btm in {"btm": found.map, **found.maps}.items()}
    files |= {"station.html": found.page(), "teams.parquet": found.table, "contacts.parquet": found.contacts}
    record = out.record(
        groups=[
            {"robots": names, "outcome": merged.outcome.name, "apart": merged.left, "notes": merged.notes}
            for names, merged in found.groups.items()
        ],
        worlds=[plan.world],
        costs=costs,
    )
    return out.finish(record, files, _team_summary(found), {"team.png": found.figure})


def _team_summary(found):
    """Return the text that the command prints: the table of teams, outcomes, and how often robots merged their maps."""
    from jexplore.driving.mission import RunOutcome

    lines = [aligned_table(list(found.table), _rows(found.table), left=("outcome",))]
    ends = collections.Counter(RunOutcome(int(log.result.outcome)).name for log in found.logs)
    lines.append("outcomes: " + ", ".join(f"{name} {count}" for name, count in ends.most_common()))
    wrong, outcomes = found.contacts["wrong"], found.contacts["outcome"].value_counts()
    counts = ", ".join(f"{name} {count}" for name, count in outcomes.items())
    merged = f", of them {int((wrong > 0).sum())} with a wrong match" if len(wrong) else ""
    lines.append(f"merges of two robots in contact: {counts or 'none'}{merged}")
    for names, group in found.groups.items():
        apart = f", without {', '.join(group.left)}" if group.left else ""
        lines.append(f"{', '.join(names)} in the end: {group.outcome.name}{apart}")
    return "\n".join(lines)


def _rows(table):
    for row in table.itertuples(index=False):
        yield [value if isinstance(value, str) else number_text(value, int(value % 1 > 0)) for value in row]
