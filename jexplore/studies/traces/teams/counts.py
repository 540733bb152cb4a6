"""Places of the plan that a team of trace robots has found, and when."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jexplore.btm import DIVERGENCE, FREE_SPACE
from jexplore.studies.traces.job import TraceJob
from jexplore.studies.traces.teams.clock import EXCHANGE_STEPS, RobotLog
from jexplore.tracemap.merging.merge import MergeResult
from jexplore.tracemap.record import NODE_TYPES, BtmMap

WRONG_M = 2.0  # m; nodes of one place truly lie no farther apart: both robots were in its circle
SHARE = 0.9  # of the junctions, whose time is told
MERGED_TYPES = NODE_TYPES[DIVERGENCE], NODE_TYPES[FREE_SPACE]


def sizes_of(n: int) -> list[int]:
    """Return the sizes of teams that n robots are counted as: 1, 2, 4, ... and n."""
    return sorted({*(1 << i for i in range(n.bit_length())), n})


def junctions_at(plan: TraceJob, places: np.ndarray) -> np.ndarray:
    """Return the junction that is nearest to each place: `[n]` int, -1 if it is not within its circle.

    `places` are `[n, 2]`, metres, in the building's frame.
    """
    truth = plan.truth
    at, around_m = truth.marks[~truth.is_door, :2] - plan.world.origin_m, truth.marks[~truth.is_door, 2]
    if not len(at) or not len(places):
        return np.full(len(places), -1)
    off_m = np.hypot(*(places[:, None] - at).transpose(2, 0, 1))
    nearest = off_m.argmin(axis=1)
    return np.where(off_m.min(axis=1) <= around_m[nearest], nearest, -1)


def wrong_matches(merged: MergeResult, node_at: Mapping[str, Any]) -> int:
    """Count nodes of a merged map whose robots truly were at different places; `node_at` as of `Held`, by map."""
    together: dict[int, list[np.ndarray]] = {}
    for name, nodes in merged.nodes.items():
        for key, node in nodes.items():
            together.setdefault(node, []).append(node_at[name][key])
    return sum(any(np.hypot(*(at - own[0])) > WRONG_M for at in own) for own in together.values())


def first_found(plan: TraceJob, log: RobotLog) -> np.ndarray:
    """Return the first steps at which a robot was at the junctions and at which its map had them: `[2, J]`; inf: never.

    Of the map they are those of the next exchange.
    """
    truth = plan.truth
    marks = truth.marks[~truth.is_door] - [*plan.world.origin_m, 0.0]
    found = np.full((2, len(marks)), math.inf)
    for j, (x, y, radius) in enumerate(marks):
        near = np.hypot(log.truth[:, 0] - x, log.truth[:, 1] - y) < radius
        found[0, j] = near.argmax() + 1 if near.any() else math.inf
    for exchange in range(len(log.exchanges) + 1):
        held = log.held(exchange)
        is_one = np.isin(held.map.kind, (DIVERGENCE, FREE_SPACE)) & (np.arange(len(held.node_at)) < held.map.n_nodes)
        own = junctions_at(plan, held.node_at[is_one])
        own = own[own >= 0]
        found[1, own] = np.minimum(found[1, own], EXCHANGE_STEPS * (exchange + 1))
    return found


def _steps_until(first: np.ndarray, count: int) -> float:
    """Return the step at which a share of `count` junctions has been found; NaN: never."""
    wanted = math.ceil(SHARE * count)
    last = np.sort(first)[wanted - 1] if wanted else 0.0
    return float(last) if math.isfinite(last) else math.nan


def _junctions_in(plan, btm, node_at):
    """Return the junctions of the nodes of a map: id -> junction."""
    ids = [node.id for node in btm.nodes if node.type in MERGED_TYPES]
    own = junctions_at(plan, np.asarray(node_at)[ids])
    return {key: int(junction) for key, junction in zip(ids, own) if junction >= 0}


def team_row(
    plan: TraceJob, logs: Sequence[RobotLog], first: Sequence[np.ndarray], maps: Mapping[str, BtmMap],
    groups: Mapping[tuple[str, ...], MergeResult],
) -> dict[str, Any]:  # fmt: skip
    """Return the findings of a team, a row of `TraceTeamResult.table`.

    `first` are `first_found` of its robots. The columns:

    - `robots`; `steps`: until the last of them has ended
    - `junctions`: of the plan; `reached`: at which a robot was; `one`, `all`: in the map of one robot, mean, and of any
    - `steps_reached_90`: until 90 % of the plan's junctions were reached
    - `steps_mapped_90`: until 90 % of the junctions that their finished maps hold were in one of their maps
    - `outcome`: of merging the finished maps of the largest group; `apart`: robots that are not in its merged map
    - `merged`: junctions in that map; `doubled`: further nodes at a junction, beyond those of one robot's own map;
      `wrong`: its nodes that are truly different places
    """
    node_at = {name: log.result.node_at for name, log in zip(maps, logs)}
    own = {name: _junctions_in(plan, maps[name], at) for name, at in node_at.items()}
    reached, mapped = np.min(first, axis=0)
    union = max(groups.values(), key=lambda merged: len(merged.moves), default=None)
    alone = next(iter(maps))
    nodes = {alone: {node.id: node.id for node in maps[alone].nodes}} if union is None else union.nodes
    at_junction: dict[int, set[int]] = {}
    for name, moved in nodes.items():
        for key, junction in own[name].items():
            at_junction.setdefault(junction, set()).add(moved[key])
    most = {j: max(list(own[name].values()).count(j) for name in nodes) for j in at_junction}
    return {
        "robots": len(logs),
        "steps": max(len(log.truth) for log in logs),
        "junctions": len(reached),
        "reached": int(np.isfinite(reached).sum()),
        "steps_reached_90": _steps_until(reached, len(reached)),
        "one": float(np.mean([len({*found.values()}) for found in own.values()])),
        "all": len({junction for found in own.values() for junction in found.values()}),
        "steps_mapped_90": _steps_until(mapped, int(np.isfinite(mapped).sum())),
        "outcome": "" if union is None else union.outcome.name,
        "apart": len(logs) - len(nodes),
        "merged": len(at_junction),
        "doubled": sum(max(len(at) - most[j], 0) for j, at in at_junction.items()),
        "wrong": 0 if union is None else wrong_matches(union, node_at),
    }
