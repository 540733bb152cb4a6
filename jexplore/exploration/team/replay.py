"""A team's episode once more, from its record: the map that all robots' maps make, and where they were."""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.engine.program import given_of
from jexplore.exploration.environment import blank_belief
from jexplore.exploration.motion import LENGTHS
from jexplore.exploration.site import Site, line_of
from jexplore.exploration.trail import Final
from jexplore.grid import Grid
from jexplore.planning import Belief
from jexplore.policies import Strategy
from jexplore.reach import HEADING, MOTIONS


class RobotAt(NamedTuple):
    """A robot of a team at some time."""

    step: int  # steps made
    row: int
    col: int
    heading_deg: int
    target: tuple[int, int] | None  # row, col of what it goes to


class TeamFrame(NamedTuple):
    """A team at some time."""

    clock_m: float  # metres of way
    belief: Belief  # the first robot's, with the map of all; with the site's ring and padding
    n_known: int  # cells
    robots: list[RobotAt]


def last_clock(final: Final) -> int:
    """Return when the last step of a team was made, in units of `motion.LENGTHS`."""
    return max(int(way[-1, 2]) for way in final.ways or ())


def _robot_at(way: np.ndarray, clock: int, heading_deg: int) -> RobotAt:
    step = int(np.searchsorted(way[:, 2], clock, side="right")) - 1
    row, col = way[step, :2].tolist()
    if step:
        motion = row - int(way[step - 1, 0]), col - int(way[step - 1, 1])
        heading_deg = 45 * HEADING[MOTIONS.index(motion)]
    target = way[min(step + 1, len(way) - 1), 3:].tolist() if step + 1 < len(way) else (-1, -1)
    return RobotAt(step, row, col, heading_deg, None if target[0] < 0 else (target[0], target[1]))


def team_frames(site: Site, strategy: Strategy, final: Final, start: Any, clocks: Iterable[int]) -> Iterator[TeamFrame]:
    """Yield a team at some times, in units of `motion.LENGTHS`: cells as they are in the end, once they are known.

    `start`: row, col, heading in degrees of the first robot; until its first step every robot is shown to look there.
    """
    assert final.ways is not None
    assert final.seen_at is not None
    line = line_of(site, site.with_strategy(strategy), np.asarray(start, np.int32)[None], 0, [0])
    blank = blank_belief(jax.device_put(given_of(line, 0)))
    (height, width), ring = blank.driven.shape, site.ring
    rows, cols = final.seen_at.shape
    sides = (ring, height - rows - ring), (ring, width - cols - ring)
    cell_m = float(site.numbers.model.cell_m)
    counted = True if blank.within is None else np.asarray(blank.within)[ring : ring + rows, ring : ring + cols]
    for clock in clocks:
        known = final.seen_at <= clock
        hits, misses = (np.pad(np.where(known, counts, 0), sides) for counts in (final.hits, final.misses))
        driven = np.zeros((height, width), bool)
        robots = [_robot_at(way, clock, int(start[2])) for way in final.ways]
        for way, robot in zip(final.ways, robots):
            driven[way[: robot.step + 1, 0] + ring, way[: robot.step + 1, 1] + ring] = True
        here = {"row": np.int32(robots[0].row + ring), "col": np.int32(robots[0].col + ring)}
        grid = Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))
        belief = blank.replace(grid=grid, driven=driven, **here)
        yield TeamFrame(clock / LENGTHS[0] * cell_m, belief, int((known & counted).sum()), robots)
