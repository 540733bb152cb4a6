"""Lower bounds for teams: how early none can have seen everything."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse.csgraph import minimum_spanning_tree

from jexplore.exploration.batch import Job
from jexplore.exploration.team.starts import place_teams
from jexplore.raycast import scans_all_round
from jexplore.studies.bounds.floor import Floor, low_metres
from jexplore.studies.bounds.scene import Scene, prepare_scene
from jexplore.studies.bounds.search import Budget
from jexplore.studies.results.columns import RATIO_COLUMNS


def team_low(scene: Scene, witnesses: Sequence[int], starts: np.ndarray) -> int:
    """Return a cost that the robot with the longest way of a team cannot stay below, if the team sees all witnesses.

    The larger of two: the way from the nearest start to where the farthest witness is seen; and the N-th part, rounded
    up, of the least tree that joins all starts, as one, and the regions from which some witnesses are seen, which the
    ways of all robots together are no shorter than. Of these, the best of the first ones in the order in which each is
    the farthest from those before.

    Args:
      scene: of the first robot's start.
      witnesses: cells of the scene.
      starts: `[N, 2 or more]` int, row and col of each robot.
    """
    floor = Floor(scene, scene.any, Budget(None, 1))
    places = floor.numbers((starts[:, 0] + scene.pad) * scene.width + starts[:, 1] + scene.pad)
    regions = [places, *map(floor.region, witnesses)]
    apart = np.array([[away[region].min() for region in regions] for away in map(floor.away_from, regions)], np.float64)
    apart = np.minimum(apart, apart.T)  # a cost is of a path, and the same both ways
    chosen, least, tree = [0], apart[0].copy(), 0.0
    while least.max() > 0:
        chosen.append(int(np.argmax(least)))
        least = np.minimum(least, apart[chosen[-1]])
        edges = minimum_spanning_tree(apart[np.ix_(chosen, chosen)] + 1)  # it leaves out edges of 0
        tree = max(tree, edges.sum() - edges.nnz)
    return max(int(apart[0].max()), -(-int(tree) // len(starts)))


def with_team_ratios(episodes: pd.DataFrame, bounds: Any, jobs: Sequence[Job]) -> pd.DataFrame:
    """Replace the ratios of `beside.with_bound_ratios` of teams of several robots: to the `team_low` of their starts.

    Their way is the time until all was known; no walk was looked for. `bounds` are a `BoundsResult` of the first
    robots' starts, with its witnesses; teams without a job in `jobs`, as of a loaded run, have no ratio.
    """
    table = episodes.copy()
    table.loc[table["robots"] > 1, [*RATIO_COLUMNS]] = np.nan
    at = {
        (row["world"], row["start_row"], row["start_col"], row["start_heading_deg"]): number
        for number, row in enumerate(bounds.table.to_dict("records"))
    }
    lows: dict[Any, float] = {}
    for job in jobs:
        if job.team is None or job.team.robots == 1:
            continue
        assert job.rules is not None
        assert job.lidar is not None
        for episode, start in enumerate(map(tuple, job.starts.tolist())):
            number, key = at.get((job.world.name, *start)), (job.world.name, start, job.team.robots, job.team.starts)
            if number is None:
                continue
            if key not in lows:
                scene = prepare_scene(job.world, start, job.lidar, job.rules, scans_all_round(job.lidar))
                (starts,) = place_teams(job.world, [start], job.team, job.rules)
                rows, cols = bounds.witnesses[number].T
                lows[key] = 0.0  # enclosed
                if scene is not None:
                    seen = (rows + scene.pad) * scene.width + cols + scene.pad
                    lows[key] = low_metres(team_low(scene, seen, starts), job.world.cell_m)
            own = (table["world"] == job.world.name) & (table["strategy"] == job.strategy.name)
            own &= (table["episode"] == episode) & (table["outcome"] == "COMPLETE")
            table.loc[own, RATIO_COLUMNS[1]] = table.loc[own, "path_m_at_100"] / (lows[key] or np.nan)
    return table
