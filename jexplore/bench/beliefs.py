"""An episode that was run, and what its kernels saw: every scan, and the belief at every plan."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jexplore.bench.engines import LIDAR, RULES, SEED
from jexplore.exploration.batch import Final
from jexplore.exploration.episode import Track
from jexplore.exploration.site import Site, prepare
from jexplore.studies import explore
from jexplore.worlds.world import World, draw_starts


class Recording(NamedTuple):
    """What an episode met."""

    world: World
    strategy: str
    site: Site
    hits: np.ndarray  # [H, W] int32, the last map, without padding
    misses: np.ndarray  # [H, W] int32
    poses: np.ndarray  # [n, 3] int32, row, col, heading (units of 45 degrees) of every scan
    beliefs: list  # `planning.Belief` at every plan, the last one, that found nothing, included
    targets: list  # (row, col) chosen there; None for the last


def _episode(world, strategy, start, run):
    """The first of some episodes as a `explore.Episode`."""
    grid, trail = run.last
    trail = np.asarray(trail)[: int(run.result.straight[0] + run.result.diagonal[0]) + 1]
    height, width = world.shape
    padded = grid.hits.shape[1]
    spot, target = trail[:, Track.SPOT], trail[:, Track.TARGET]
    rows, cols = np.divmod(spot // 4, padded)
    target_rows, target_cols = np.where(target < 0, -1, np.divmod(target, padded))
    hits, misses = (np.asarray(a)[:height, :width] for a in (grid.hits, grid.misses))
    final = Final(hits, misses, rows, cols, target_rows, target_cols, spot % 4, trail[:, Track.KNOWN])
    start = tuple(int(value) for value in start)
    return explore.Episode(world, strategy.name, start, SEED, LIDAR, RULES, final, {}, 0.0, 0.0)  # type: ignore[arg-type]


def record(compiler, world, strategy, reach):
    """Runs episode 0 of a strategy in a world and keeps its scans, and its belief at every plan: a `Recording`.

    Args:
      compiler: `Compiler`.
      world, strategy: `World`, `Strategy`.
      reach: one of `reach.METHODS`, for the beliefs.
    """
    starts = draw_starts(world, SEED, 1, RULES.clearance_m)
    episode = _episode(world, strategy, starts[0], compiler.serial(world, strategy).run(starts))
    site, final, first = prepare(world, LIDAR, RULES), episode.final, episode.start[2] // 45
    poses, beliefs, targets = [], [], []
    headings = explore.headings_of(final, first)
    last = len(headings) - 1
    for step, _, belief, _ in explore._states(episode):
        row, col = int(final.rows[step]), int(final.cols[step])
        all_round = [first + 8 // site.first_scans * k for k in range(site.first_scans)]
        turns = all_round if step == 0 else [headings[step]]
        turns = turns + [headings[step] + 2 * k for k in range(1, int(final.looked[step]) + 1)]
        poses += [(row, col, turn % 8) for turn in turns]
        now = int(final.target_rows[step]), int(final.target_cols[step])
        following = None if step == last else (int(final.target_rows[step + 1]), int(final.target_cols[step + 1]))
        if step == 0 or following != now:
            beliefs.append(dataclasses.replace(belief, reach=reach))
            targets.append(following)
    return Recording(world, strategy.name, site, final.hits, final.misses, np.array(poses, np.int32), beliefs, targets)
