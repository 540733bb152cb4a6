"""Starts of the robots of a team: together at the first one's, apart, or given."""

import numpy as np
from numpy.typing import ArrayLike

from jexplore.config import InputError
from jexplore.exploration.team.team import STARTS, Starts, Team
from jexplore.rules import Rules
from jexplore.worlds.starts import check_start, reached_from
from jexplore.worlds.world import World

_FAR = np.iinfo(np.int32).max


def steps_from(floor: np.ndarray, cell: tuple[int, int]) -> np.ndarray:
    """Return the straight steps from a cell to every cell of a floor: `[H, W]` int32; the largest where none leads."""
    height, width = floor.shape
    walled = np.zeros((height + 2, width + 2), bool)
    walled[1:-1, 1:-1] = floor
    steps = np.full(walled.size, _FAR, np.int32)
    open_, at, n = walled.ravel(), np.array([(cell[0] + 1) * (width + 2) + cell[1] + 1]), 0
    while at.size:
        steps[at], n = n, n + 1
        beside = np.unique(np.concatenate([at + 1, at - 1, at + width + 2, at - width - 2]))
        at = beside[open_[beside] & (steps[beside] == _FAR)]
    return steps.reshape(walled.shape)[1:-1, 1:-1]


def place_teams(world: World, starts: ArrayLike, team: Team, rules: Rules) -> np.ndarray:
    """Return where the robots of teams start, `[N, robots, 3]` int32; `starts` are those of the first robots, `[N, 3]`.

    Raises:
      InputError: as `place_team`.
    """
    firsts = [tuple(start) for start in np.asarray(starts).tolist()]
    near = {"clearance_m": rules.clearance_m, "near_m": rules.near_m}
    placed = {start: place_team(world, start, team.robots, team.starts, **near) for start in dict.fromkeys(firsts)}
    return np.stack([placed[start] for start in firsts])


def place_team(
    world: World, start: tuple[int, int, int], n: int, starts: Starts, *, clearance_m: float, near_m: float
) -> np.ndarray:
    """Return where the robots of a team start: `[n, 3]` int32, row, col, heading in degrees; the first at `start`.

    "together": the others stand on the clear cells with the fewest straight steps from the first; "apart": one after
    the other on the clear cell whose fewest steps from the robots before are most. Ties go to the lowest flat index.
    All have the heading of the first.

    Raises:
      InputError: there are fewer cells than robots; given starts that overlap, lie in a wall, or cannot be reached
        from the first.
    """
    if starts not in STARTS:
        return _given_starts(world, n, starts, clearance_m, near_m)
    row, col, heading = (int(value) for value in start)
    region = reached_from(world, row, col, clearance_m, near_m)
    region[row, col] = False
    cells = np.argwhere(region)
    if len(cells) < n - 1:
        raise InputError(
            f"{world.name or 'world'!r}: {n} robots do not fit: {len(cells) + 1} clear cells can be reached from "
            f"({row}, {col})"
        )
    floor = ~world.occupied if world.within is None else ~world.occupied & world.within
    steps, chosen = steps_from(floor, (row, col)), [(row, col)]
    if starts == "together":
        nearest = np.argsort(steps[region], kind="stable")[: n - 1]
        chosen += [(int(r), int(c)) for r, c in cells[nearest]]
    else:
        for _ in range(n - 1):
            r, c = cells[np.argmax(steps[region])]
            chosen.append((int(r), int(c)))
            steps = np.minimum(steps, steps_from(floor, chosen[-1]))
    return np.array([(*cell, heading) for cell in chosen], np.int32)


def _given_starts(world: World, n: int, starts: Starts, clearance_m: float, near_m: float) -> np.ndarray:
    if isinstance(starts, str) or len(starts) != n:
        form = f"{' or '.join(STARTS)}, or one row,col,heading_deg for each of {n} robots"
        raise InputError(f"team_starts must be {form}, got {starts!r}")
    own = [check_start(world, start, clearance_m, near_m) for start in starts]
    cells = [start[:2] for start in own]
    twice = next((cell for i, cell in enumerate(cells) if cell in cells[:i]), None)
    if twice:
        raise InputError(f"team_starts in {world.name or 'world'!r}: two robots start at {twice}")
    region = reached_from(world, *cells[0], clearance_m, near_m)
    for cell in cells[1:]:
        if not (reached_from(world, *cell, clearance_m, near_m) & region).any():
            raise InputError(f"team_starts in {world.name or 'world'!r}: no path leads from {cells[0]} to {cell}")
    return np.array(own, np.int32)
