"""A team of trace robots in one building: their maps, merged whenever two of them are in contact."""

import dataclasses
import itertools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.sparse.csgraph import connected_components

from jexplore.config import InputError, as_record, checked_names, require_whole, shown
from jexplore.driving.batch import pose_in, require_start
from jexplore.driving.settings import Noise, Robot, Tuning
from jexplore.engine.runner import Costs
from jexplore.exploration.team.starts import place_team
from jexplore.exploration.team.team import MOST_ROBOTS, STARTS
from jexplore.report.page.station import MapPanel
from jexplore.report.plot_traces import team_figure
from jexplore.studies.results.progress import progress_bar
from jexplore.studies.traces.job import AUTO, START_CLEARANCE_M, TraceJob, prepare_trace
from jexplore.studies.traces.options import floats_of, require_start_pose
from jexplore.studies.traces.recording import wall_lines
from jexplore.studies.traces.station import GLOBAL_MAP, WHY, page_from
from jexplore.studies.traces.teams.clock import EXCHANGE_STEPS, RobotLog, run_robots
from jexplore.studies.traces.teams.counts import first_found, sizes_of, team_row, wrong_matches
from jexplore.studies.traces.tracing import map_of
from jexplore.tracemap.merging.limits import Limits, TeamLimits
from jexplore.tracemap.merging.match import Merging
from jexplore.tracemap.merging.merge import MergeResult, merge_maps
from jexplore.tracemap.merging.rigid import Move
from jexplore.tracemap.record import BtmMap
from jexplore.worlds.world import World

NEW_NODES = 3  # nodes that one of two maps must have more than at the last attempt: what a merge must have in common
NAME = "robot-{}"
COLUMNS = "step", "one", "other", "away_m", "nodes_one", "nodes_other", "outcome", "matched", "wrong"
TeamStarts = str | Sequence[str | Sequence[float]]


@checked_names
@dataclasses.dataclass(frozen=True)
class TraceTeamResult:
    """Result of `trace_team`. Robots are called robot-0, robot-1, ..."""

    plan: TraceJob
    contact: str
    maps: dict[str, BtmMap]
    """Name of a robot -> its map in the end, in its own odometry frame."""
    contacts: pd.DataFrame
    """A row for every attempt of two robots to merge their maps: step, robots, distance, nodes of their maps, outcome,
    nodes matched, of these wrong."""
    groups: dict[tuple[str, ...], MergeResult]
    """Robots of which each has been in contact with another of them, two or more -> their maps of the end, merged."""
    table: pd.DataFrame
    """A row for every size of team: the first of the robots alone, the first two, four, ..., all; see `team_row`."""
    logs: tuple[RobotLog, ...]
    costs: Costs

    @property
    def map(self) -> BtmMap:
        """Return the map of most robots; of teams without contact that of robot-0."""
        most = max(self.groups.values(), key=lambda merged: len(merged.moves), default=None)
        return self.maps[NAME.format(0)] if most is None else most.map

    def figure(self) -> Figure:
        """Draw the robots' true ways, where they tried to merge their maps, and `map`."""
        origin, tried = np.asarray(self.plan.world.origin_m), []
        for row in self.contacts.to_dict("records"):
            exchange = int(row["step"]) // EXCHANGE_STEPS - 1
            at = np.mean([self.logs[int(row[name])].place(exchange) for name in ("one", "other")], axis=0) + origin
            tried.append((float(at[0]), float(at[1]), str(row["outcome"])))
        ways = [log.truth[:, :2] + origin for log in self.logs]
        title = f"{len(ways)} robots in {self.plan.world.name}, contact {self.contact}"
        return team_figure(wall_lines(self.plan), ways, tried, self.map, title)

    def page(self) -> str:
        """Return the station's page: the merged map of every group, and each robot's own. HTML, plain ASCII."""
        panels, said, why = [], [], dict.fromkeys(self.maps, "")
        for merged in self.groups.values():
            said += merged.notes
            if merged.left:
                why |= dict.fromkeys(merged.left, f" Stands apart: {WHY[merged.outcome]}.")
            if len(names := tuple(merged.moves)) > 1:
                whole = GLOBAL_MAP if len(self.groups) == 1 else f"map of {' and '.join(names)}"
                first = next(name for name, move in merged.moves.items() if move == Move())
                panels.append(MapPanel(whole, merged.map, names, f"In the frame of {first}."))
        panels += [MapPanel(name, btm, (name,), f"As it was written.{why[name]}") for name, btm in self.maps.items()]
        return page_from(panels, said, f"{len(self.maps)} robots in {self.plan.world.name}")


def read_reach(contact: Any) -> float:
    """Return within how many metres robots of a contact exchange maps; -1 for none."""
    word, _, metres = str(contact).partition(":")
    reach_m = {"all": (math.inf,), "none": (-1.0,)}.get(str(contact), floats_of(metres) if word == "range" else ())
    if len(reach_m) != 1 or (word == "range" and reach_m[0] < 0):
        raise InputError(f"contact of trace robots must be all, none or range:METRES, got {shown(contact)}")
    return reach_m[0]


def place_robots(plan: TraceJob, n: int, starts: TeamStarts) -> np.ndarray:
    """Return the starts of n robots, the first at that of the plan: `[n, 3]`, see `pose_in`.

    `together` and `apart` as `place_team`, robot i turned by i / n of a circle; or x, y, metres, and heading, degrees,
    of each robot.
    """
    world, (x, y, heading) = plan.world, plan.begins[0]
    if isinstance(starts, str) and starts in STARTS:
        cell = int(y / world.cell_m), int(x / world.cell_m), 0
        cells = place_team(world, cell, n, starts, clearance_m=START_CLEARANCE_M, near_m=START_CLEARANCE_M)
        places = (cells[:, 1::-1] + 0.5) * world.cell_m
        turned = heading + 2 * np.pi * np.arange(n) / n
        return np.vstack([plan.begins[:1], np.column_stack([places, turned])[1:]]).astype(np.float32)
    given = [starts] if isinstance(starts, str) else list(starts)
    if len(given) != n:
        form = f"{' or '.join(STARTS)}, or x,y,heading_deg of each robot"
        raise InputError(f"team_starts must be {form}: {n} robots need {n} starts, got {shown(starts)}")
    return np.stack([pose_in(world, _pose(one)) for one in given])


def _pose(given):
    pose = floats_of(given)
    if len(pose) != 3:
        raise InputError(f"a start of team_starts must be x,y,heading_deg, got {shown(given)}")
    require_start_pose(pose)
    return pose


@checked_names
def trace_team(
    world: str | os.PathLike[str] | World = "rooms", *,
    robots: int = 2, contact: str = "all", team_starts: TeamStarts = "apart",
    limits: Limits | Mapping[str, Any] | None = None,
    robot: str | Robot = "kamui", seed: int = 0, start: tuple[float, float, float] | None = None,
    tuning: Tuning | Mapping[str, Any] | None = None, noise: Noise | Mapping[str, Any] | None = None,
    cell_m: float = 0.1, max_steps: int | None = None, attributes: Sequence[str] = (),
    nodes: int | None = None, links: int | None = None, perception: str = AUTO,
    workers: int | None = None, on_progress: Callable[[int], Any] | None = None,
    progress: bool | None = None,
) -> TraceTeamResult:  # fmt: skip
    """Let several robots drive through a building at the same time, and merge their maps where they are in contact.

    Every robot has errors and an odometry of its own and drives as it would alone: the robots neither see nor steer by
    each other. Maps are exchanged every `EXCHANGE_STEPS` steps. Two robots in contact merge what they then have with
    `merge_maps`, and again whenever one of their maps has `NEW_NODES` nodes more, until it succeeds; then anew at their
    next contact. A robot whose run has ended stays where it is.

    Args:
      robots: 1 to 16.
      contact: "all", "none", or "range:M", within M metres, also through walls.
      team_starts: see `place_robots`.
      limits: of merging, `TeamLimits` or others.
      start: of the first robot, without given `team_starts`.
      world, robot, seed, tuning, noise, cell_m, max_steps, attributes, nodes, links: see `prepare_trace`.
      perception: see `prepare_trace`.
      workers, on_progress, progress: see `trace`.
    """
    read_reach(contact)
    limits = limits if isinstance(limits, Limits) else as_record("limits", limits or {}, TeamLimits)
    plan = prepare_team(
        world, robots, team_starts, robot=robot, seed=seed, tuning=tuning, noise=noise, start=start, cell_m=cell_m,
        max_steps=max_steps, attributes=attributes, nodes=nodes, links=links, perception=perception,
    )  # fmt: skip
    with progress_bar(progress, plan.runs, "robots", on_progress) as moved:
        logs, costs = run_robots(plan, workers=workers, on_progress=moved)
    return merge_team(plan, logs, contact, limits, costs)


def prepare_team(
    world: str | os.PathLike[str] | World, robots: int, team_starts: TeamStarts = "apart", **how: Any
) -> TraceJob:
    """Check all that a team needs, and return its runs, one a robot; `how` as of `prepare_trace`."""
    n = require_whole("robots", robots, 1, MOST_ROBOTS)
    if not (isinstance(team_starts, str) and team_starts in STARTS) and how.get("start") is not None:
        raise InputError("start and given team_starts exclude each other: give one of them")
    plan = prepare_trace(world, runs=n, **how)
    plan = dataclasses.replace(plan, begins=place_robots(plan, n, team_starts))
    for pose in plan.begins:
        require_start(plan.world, plan.building, plan.robot, pose)
    return plan


def merge_team(
    plan: TraceJob, logs: Sequence[RobotLog], contact: str, limits: Limits | None = None, costs: Costs | None = None
) -> TraceTeamResult:
    """Merge the maps of finished runs as robots in contact do: see `trace_team`."""
    limits = limits or TeamLimits()
    last = max(len(log.truth) for log in logs) // EXCHANGE_STEPS
    maps = {NAME.format(i): _map_at(plan, log, last) for i, log in enumerate(logs)}
    near = _contacts(logs, read_reach(contact), last)
    rows = [row for pair, exchanges in near.items() for row in _attempts(plan, logs, pair, exchanges, limits)]
    contacts = pd.DataFrame(sorted(rows, key=lambda row: row["step"]), columns=list(COLUMNS))
    first, groups, table = [first_found(plan, log) for log in logs], {}, []
    for n in sizes_of(len(logs)):
        groups = {names: merge_maps([maps[name] for name in names], names, limits=limits) for names in _groups(near, n)}
        table.append(team_row(plan, logs[:n], first[:n], maps, groups))
    costs = costs or Costs()
    return TraceTeamResult(plan, contact, maps, contacts, groups, pd.DataFrame(table), tuple(logs), costs)


def _map_at(plan, log, exchange):
    """Return the map that a robot has at an exchange."""
    if exchange not in log.maps:
        held = jax.tree.map(lambda a: np.asarray(a)[None], log.held(exchange))
        log.maps[exchange] = map_of(plan, held, 0)
    return log.maps[exchange]


def _contacts(logs, reach_m, last):
    """Return the exchanges at which robots are in contact: pair of numbers -> `[n]` int, from 0 to `last`."""
    places = np.stack([[log.place(exchange) for exchange in range(last + 1)] for log in logs])
    pairs = itertools.combinations(range(len(logs)), 2)
    found = {(i, j): np.flatnonzero(np.hypot(*(places[i] - places[j]).T) <= reach_m) for i, j in pairs}
    return {pair: exchanges for pair, exchanges in found.items() if len(exchanges)}


def _groups(near, n):
    """Return the groups of the first n robots that contacts join, of two or more: tuples of names."""
    graph = np.zeros((n, n), bool)
    for pair in near:
        if max(pair) < n:
            graph[pair] = True
    _, group = connected_components(graph, directed=False)
    found = [tuple(NAME.format(i) for i in np.flatnonzero(group == one)) for one in np.unique(group)]
    return [names for names in found if len(names) > 1]


def _attempts(plan, logs, pair, exchanges, limits):
    """Yield the attempts of two robots to merge their maps at the exchanges at which they are in contact."""
    tried, is_merged, before = np.zeros(2, int), False, -2
    for exchange in exchanges:
        is_merged, before = is_merged and exchange == before + 1, exchange
        held = [logs[i].held(exchange) for i in pair]
        nodes = np.array([int(own.map.n_nodes) for own in held])
        if is_merged or nodes.min() < NEW_NODES or (nodes - tried).max() < NEW_NODES:
            continue
        tried, names = nodes, [NAME.format(i) for i in pair]
        merged = merge_maps([_map_at(plan, logs[i], exchange) for i in pair], names, limits=limits)
        is_merged = merged.outcome is Merging.MERGED
        away_m = float(np.hypot(*np.subtract(*(logs[i].place(exchange) for i in pair))))
        wrong = wrong_matches(merged, dict(zip(names, (own.node_at for own in held)))) if is_merged else 0
        values = EXCHANGE_STEPS * (exchange + 1), *pair, away_m, *nodes, merged.outcome.name, merged.matched, wrong
        yield dict(zip(COLUMNS, values))
