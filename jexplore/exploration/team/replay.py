"""A team's episode once more, from its record: the map that all robots' maps make, and where they were.

Times are on the team's clock, in units of `motion.LENGTHS`.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jexplore.engine.program import given_of
from jexplore.exploration.environment import blank_belief
from jexplore.exploration.site import Site, line_of
from jexplore.exploration.trail import Final
from jexplore.grid import Grid
from jexplore.planning import Belief
from jexplore.policies import Strategy
from jexplore.reach import HEADING, MOTIONS


def last_clock(final: Final) -> int:
    """Return when the last step of a team was made."""
    return max(int(way[-1, 2]) for way in final.ways or ())


def known_at(final: Final, counts: np.ndarray | None, clocks: Sequence[int]) -> np.ndarray:
    """Return how many cells of those that count, `[H, W]` bool, None: all, a team knew at some times: `[F]` int."""
    assert final.seen_at is not None
    seen_at = final.seen_at.ravel() if counts is None else final.seen_at[counts]
    return np.searchsorted(np.sort(seen_at), clocks, side="right")


def robot_at(way: np.ndarray, clocks: Sequence[int], heading_deg: int) -> dict[str, Any]:
    """Return the fields of a `RobotReplay` at some times; `way` as in `Final.ways`.

    Until its first step the robot is shown to look at `heading_deg`.
    """
    steps = np.searchsorted(way[:, 2], clocks, side="right") - 1
    moves = map(tuple, np.diff(way[:, :2], axis=0).tolist())
    headings = np.array([heading_deg, *(45 * HEADING[MOTIONS.index(move)] for move in moves)])
    targets = np.append(way[1:, 3:], [[-1, -1]], axis=0)
    where = {"rows": way[:, 0], "cols": way[:, 1], "steps": steps}
    return {**where, "heading_deg": headings[steps], "target": targets[steps]}


def team_beliefs(site: Site, strategy: Strategy, final: Final, start: Any, clocks: Iterable[int]) -> Iterator[Belief]:
    """Yield the first robot's belief with the map of all at some times: cells as they are in the end, once known.

    `start`: row, col, heading in degrees of the first robot. Maps have the site's ring and padding.
    """
    assert final.ways is not None
    assert final.seen_at is not None
    line = line_of(site, site.with_strategy(strategy), np.asarray(start, np.int32)[None], 0, [0])
    blank = blank_belief(jax.device_put(given_of(line, 0)))
    (height, width), ring = blank.driven.shape, site.ring
    rows, cols = final.seen_at.shape
    sides = (ring, height - rows - ring), (ring, width - cols - ring)
    for clock in clocks:
        known = final.seen_at <= clock
        hits, misses = (np.pad(np.where(known, counts, 0), sides) for counts in (final.hits, final.misses))
        grid = Grid(jnp.asarray(hits, jnp.int32), jnp.asarray(misses, jnp.int32))
        past = [way[way[:, 2] <= clock, :2] + ring for way in final.ways]
        driven = np.zeros((height, width), bool)
        driven[tuple(np.concatenate(past).T)] = True
        row, col = past[0][-1]
        yield blank.replace(grid=grid, driven=driven, row=row, col=col)
