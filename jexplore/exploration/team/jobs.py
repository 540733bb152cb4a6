"""Jobs of teams: every strategy by every size and coordination, checked before anything is compiled."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from jexplore.config import InputError, shown
from jexplore.exploration.batch import Job
from jexplore.exploration.team.starts import place_teams
from jexplore.exploration.team.team import (
    INDEPENDENT,
    Starts,
    Team,
    read_contact,
    read_coordination,
    read_members,
    read_robots,
)
from jexplore.policies.closest import is_nearest
from jexplore.users import import_object
from jexplore.worlds.poses import read_start

Coordinate: TypeAlias = str | Callable[..., Any]
CoordinationLike: TypeAlias = Coordinate | Sequence[Coordinate]
"""A coordination or several: names, "module:function", or functions of a `JointView`."""


def team_jobs(
    jobs: Sequence[Job],
    robots: int | Sequence[int] | None = None,
    coordination: CoordinationLike = INDEPENDENT,
    contact: str = "all",
    team_starts: Starts | Sequence[str] = "together",
    members: str | Sequence[str] = (),
    start: Any = "random",
) -> list[Job]:
    """Return the jobs of teams made of those of one robot, each of them for every team; these where `robots` is None.

    A team of one has no coordination: it comes once. `start` is what the jobs' starts are made of.

    Raises:
      InputError: an option that has no meaning without `robots`; a pose that is not given, metrics; a team that
        cannot be.
    """
    starts = _read_starts(team_starts)
    if robots is None:
        if (coordination, contact, starts) != (INDEPENDENT, "all", "together") or members not in ((), [], ""):
            raise InputError("coordination, contact, team_starts and members are for teams: give robots, such as 1 2 4")
        return list(jobs)
    teams = _teams(robots, coordination, contact, starts)
    if start != "random" and not isinstance(teams[0].starts, str):
        raise InputError("team_starts are the starts of all robots: leave out start")
    made = []
    for job in jobs:
        assert job.rules is not None
        job.rules.require_lattice("teams are")
        if job.metrics:
            raise InputError("metrics are of one robot: leave out metrics or robots")
        if read_contact(contact, job.world.cell_m).rendezvous and (job.rules.stop_at or job.rules.return_home):
            raise InputError("robots that have a rendezvous do not stop early or return home: leave out one of them")
        assert job.lidar is not None
        robots_are = read_members(members, job.lidar)
        if robots_are and len(robots_are) != max(team.robots for team in teams):
            raise InputError(f"members must be one for each robot of the largest team, got {len(robots_are)}")
        own = job.starts
        for team in teams:
            if team.coordination is not None and not is_nearest(job.strategy.policy):
                raise InputError(
                    f"coordination {team.coordinates} chooses targets itself: give it the strategy closest or "
                    f"closest+recheck, got {job.strategy.name}"
                )
            if not isinstance(team.starts, str):
                own = np.tile(np.array(team.starts[:1]), (len(job.starts), 1))
            place_teams(job.world, own, team, job.rules)
            name = team.label(job.strategy.name)
            team = team._replace(members=robots_are[: team.robots])
            made.append(job._replace(team=team, strategy=job.strategy._replace(name=name), starts=own))
    return made


def _teams(robots: int | Sequence[int], coordination: CoordinationLike, contact: Any, own: Starts) -> list[Team]:
    """Return every team that is asked for, in order."""
    if not isinstance(contact, str):
        raise InputError(f"contact must be a text such as all or range:5, got {shown(contact)}")
    given: list[Any] = list(coordination) if isinstance(coordination, list | tuple) else [coordination]
    is_theirs = [isinstance(one, str) and ":" in one for one in given]  # "module:function"
    ways = [read_coordination(import_object(*one.split(":", 1)) if own else one) for one, own in zip(given, is_theirs)]
    names = [INDEPENDENT if one is None else one.name for one in ways]
    if not names or len(set(names)) < len(names):
        raise InputError(f"coordination must be one or several different ones, got {', '.join(names) or 'none'}")
    teams: dict[Team, None] = {}
    sizes = read_robots(robots)
    if not isinstance(own, str) and len(own) != max(sizes):
        raise InputError(f"team_starts must be one for each robot of the largest team, {max(sizes)}, got {len(own)}")
    for size in sizes:
        for one in ways:
            teams[Team(size, one if size > 1 else None, contact, own if isinstance(own, str) else own[:size])] = None
    return list(teams)


def _read_starts(starts: Starts | Sequence[str]) -> Starts:
    """Return starts as a `Team` has them: a word, or given ones."""
    if isinstance(starts, str) and "," not in starts:
        return starts
    starts = (starts,) if isinstance(starts, str) else starts
    form = f"team_starts must be together, apart, or row,col,heading_deg of each robot, got {shown(starts)}"
    if not isinstance(starts, list | tuple | np.ndarray):
        raise InputError(form)
    given: list[Any] = [read_start(start) if isinstance(start, str) and "," in start else start for start in starts]
    if given in (["together"], ["apart"]):
        return str(given[0])
    is_pose = [isinstance(one, tuple | list | np.ndarray) and len(one) == 3 for one in given]
    if not all(is_pose) or not all(isinstance(x, int | np.integer) for one in given for x in one):
        raise InputError(form)
    return tuple((int(row), int(col), int(heading)) for row, col, heading in given)
