"""A team's episode as a program of the engine, and what it measures."""

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jexplore.arrays.loops import take_one
from jexplore.arrays.padding import within
from jexplore.engine.program import Given, Line, Program
from jexplore.exploration import environment
from jexplore.exploration.episode import CPU_OPTIONS
from jexplore.exploration.motion import tick
from jexplore.exploration.results import energy_j, path_m
from jexplore.exploration.sensing import explorable_and_knowable, first_known
from jexplore.exploration.site import Site, tasks_of
from jexplore.exploration.state import Numbers, Result, Setup
from jexplore.exploration.team.environment import advance, begin, decide
from jexplore.exploration.team.state import (
    ENDED,
    TeamSetup,
    TeamState,
    TeamTask,
    given_of_robot,
    is_done,
    must_decide,
    own_cells,
    paced_ms,
)
from jexplore.exploration.team.team import Contact, Team, read_contact
from jexplore.exploration.trail import Final
from jexplore.raycast import Beams, beam_table
from jexplore.rules import Lidar, Robot


class TeamCounts(NamedTuple):
    """Counts of a team's robots: `Result.metrics` of a team."""

    straight: Array  # [N] int32, straight steps
    diagonal: Array  # [N] int32, diagonal steps
    time_ms: Array  # [N] int32
    waits: Array  # [N] int32
    own: Array  # [N] int32, cells that each has seen itself
    seen: Array  # int32, cells that any of them has seen itself
    whole: Array  # [2] int32, straight steps and waits, and diagonal steps, when all was known that is in the end
    links: Array  # int32, sum over all steps of the others that the robot heard


def finish(setup: TeamSetup, given: Given, team: TeamState) -> Result:
    """Return the `Result` of a team: as of a robot alone, but for these.

    Steps, as a length, are the clock of the robot that ends last, in units of the way of one of pace 1; `straight_at`
    and all such the clock when that much was known; counts of turns, scans, plans and the like are sums; known cells
    those that any robot knows; the outcome the highest code, the time the longest. A team of one has the result of a
    robot alone.
    """
    robots, log = team.robots, team.log
    last = jnp.argmax(team.clock)
    start = take_one(robots.belief.start, 0)
    area = None if robots.belief.within is None else robots.belief.within[0]
    explorable, knowable = explorable_and_knowable(given_of_robot(given, 0), start[0], start[1], area)
    at, along, reached = first_known(log[:, 0], team.n_log - 1, team.n_known, knowable)
    at, along, whole = log[at], jnp.where(reached[:, None], log[along], -1), log[team.n_log - 1, 1:3]
    end = jax.vmap(lambda state: tick(given.numbers.clock, state, state.heading, jnp.bool_(False), jnp.bool_(True), 0))
    times, paces = end(robots), given.task.paces
    times["time_ms"] = paced_ms(times["time_ms"], paces)
    own = own_cells(robots, team.own, team.shared)
    own = own if area is None else own & area
    each, seen = jnp.sum(own, axis=(1, 2), dtype=jnp.int32), jnp.sum(jnp.any(own, axis=0), dtype=jnp.int32)
    names = ("turns", "scans", "plans", "exhausted", "room_entries", "saturated", "refused", "overflow")
    return Result(
        straight=paces[last] * (robots.straight[last] + team.waits[last]),
        diagonal=paces[last] * robots.diagonal[last],
        outcome=jnp.max(jax.vmap(environment.outcome_of)(robots)),
        n_known=team.n_known,
        explored=jnp.sum(explorable & (team.seen_at < ENDED), dtype=jnp.int32),
        explorable=jnp.sum(explorable, dtype=jnp.int32),
        straight_at=at[:, 1],
        diagonal_at=at[:, 2],
        straight_along=along[:, 1],
        diagonal_along=along[:, 2],
        time_ms=jnp.max(times["time_ms"]),
        starts=jnp.sum(times["starts"], dtype=jnp.int32),
        time_at=at[:, 3],
        time_along=along[:, 3],
        metrics=TeamCounts(
            robots.straight, robots.diagonal, times["time_ms"], team.waits, each, seen, whole, team.links
        ),
        **{name: jnp.sum(getattr(robots, name), dtype=jnp.int32) for name in names},
    )


def _drive(setup: TeamSetup, given: Given, team: TeamState) -> TeamState:
    """Let robots act until one must plan."""
    is_under_way = program_of(setup).is_under_way
    return lax.while_loop(is_under_way, lambda team: advance(setup, given, team), team)


def detail_of(team: TeamState) -> tuple[Array, ...]:
    """Return the detailed record of a team: the map that all robots' maps make, when; their ways and steps."""
    grid = team.robots.belief.grid
    return jnp.max(grid.hits, axis=0), jnp.max(grid.misses, axis=0), team.seen_at, team.way, team.robots.steps


def program_of(setup: TeamSetup) -> Program:
    """Return the exploration of a team as a `Program`."""
    return Program(
        setup=setup,
        begin=begin,
        advance=advance,
        is_done=is_done,
        finish=finish,
        detail=detail_of,
        decide=decide,
        must_decide=must_decide,
        drive=_drive if setup.native else None,
        cpu_options=CPU_OPTIONS,
    )


def team_line(
    site: Site, fitted: tuple[Setup, Numbers], team: Team, lidar: Lidar, starts: np.ndarray, seed: int, which: Any,
    detailed: int,
) -> Line:  # fmt: skip
    """Make the `Line` of a team's episodes; arguments as of `site.line_of`, `starts` are `[N, robots, 3]`."""
    setup, numbers = fitted
    kinds, n, cell_m = (np.int32, np.bool_, np.int32, np.float32, np.int32), len(starts), float(numbers.model.cell_m)
    contact = read_contact(team.contact, cell_m)
    robot = setup._replace(native=None, capacity=1, ends=setup.ends and not contact.rendezvous)
    native = None if setup.policy.live is not None else setup.native
    own = TeamSetup(robot, team.robots, team.coordination, setup.capacity, contact.rendezvous > 0, native)
    paces = np.tile(np.array([one.pace for one in team.members] or [1] * team.robots, np.int32), (n, 1))
    beams = of_ranges(site.beams, lidar.without_noise(), cell_m, [one.range_m for one in team.members])
    tasks = tasks_of(starts.reshape(-1, 3), site.ring).reshape(starts.shape)
    task = TeamTask(tasks, Contact(*(np.full(n, value, kind) for value, kind in zip(contact, kinds))), paces)
    return Line(program_of(own), beams, site.truth, numbers, seed, task, which, detailed)


def of_ranges(beams: Beams, lidar: Lidar, cell_m: float, ranges_m: Sequence[float | None]) -> Beams:
    """Return beams of which lengths and ranges have a leading axis N, a robot's each; these where all ranges are None.

    `beams`: of the scanner with the longest range.
    """
    if not any(ranges_m):
        return beams
    own = [beam_table(lidar.replace(range_m=one or lidar.range_m), cell_m, 1) for one in ranges_m]
    around: Any = beams.all_round
    if around is not None:
        around = around.replace(length=np.stack([one.all_round.length for one in own]))
    length: Any = np.stack([one.length for one in own])
    return beams.replace(length=length, reach=np.stack([one.reach for one in own]), all_round=around)


def decode(found: tuple[np.ndarray, ...], shape: tuple[int, int], ring: int) -> Final:
    """Make `Final` of what `detail_of` gave: the team's map, the way of the first robot, those of all in `ways`."""
    hits, misses, seen_at, way, steps = found
    walks = []
    for own, n in zip(way, steps):
        cells, targets = (np.stack(np.divmod(own[: n + 1, i], hits.shape[1]), axis=1) - ring for i in (0, 2))
        targets[own[: n + 1, 2] < 0] = -1
        walks.append(np.concatenate([cells, own[: n + 1, 1:2], targets], axis=1))
    none = np.zeros(len(walks[0]), np.int32)
    rows, cols = walks[0][:, :2].T
    maps = within(hits, shape, ring), within(misses, shape, ring)
    return Final(*maps, rows, cols, none, none, plans=None, ways=walks, seen_at=within(seen_at, shape, ring))


SECONDS = "time_s_at_50", "time_s_at_90", "time_s_at_95", "time_s_at_99", "area_s"
"""Columns of times to known shares, in seconds."""


def team_columns(result: Result, team: Team, cell_m: float, robot: Robot) -> dict[str, Any]:
    """Return the columns of a table of episodes that are a team's own, and the energy of all robots: arrays `[n]`.

    `path_m_at_100`: the clock when all was known that is in the end; `path_sum_m`: ways of all robots; `overlap`: what
    each has seen itself, as shares of what all have, summed, less 1; `share_sd`: standard deviation of these shares;
    `waits`: of all robots; `connected`: mean over all steps of the share of the others that the robot heard, 1 for a
    robot alone, NaN where no robot made a step. Times in seconds to known shares are NaN for several robots, and the
    energy where a pace is not 1.
    """
    is_paced = any(one.pace != 1 for one in team.members)
    n, counts = len(result.outcome), cast(Any, result.metrics)
    share = counts.own / np.maximum(counts.seen, 1)[:, None]
    steps = (counts.straight + counts.diagonal).sum(axis=1)
    heard = np.where(steps > 0, counts.links / np.maximum(steps * (team.robots - 1), 1), np.nan)
    sums = {name: getattr(counts, name).sum(axis=1) for name in ("straight", "diagonal", "time_ms")}
    return {
        "robots": np.full(n, team.robots, np.int64),
        "path_m_at_100": path_m(counts.whole[:, 0], counts.whole[:, 1], cell_m),
        "path_sum_m": path_m(counts.straight, counts.diagonal, cell_m).sum(axis=1),
        "overlap": share.sum(axis=1) - 1,
        "share_sd": share.std(axis=1),
        "waits": counts.waits.sum(axis=1).astype(np.int64),
        "connected": heard if team.robots > 1 else np.ones(n),
        "coordination": [team.coordinates] * n,
        "contact": [team.contact] * n,
        "energy_j": np.full(n, np.nan) if is_paced else energy_j(result.replace(**sums), robot, cell_m),
        **(dict.fromkeys(SECONDS, np.full(n, np.nan)) if team.robots > 1 else {}),
    }
