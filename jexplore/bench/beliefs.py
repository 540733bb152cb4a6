"""An episode that was run, and what its kernels saw: every scan, and the belief at every plan."""

from typing import NamedTuple

import jax
import numpy as np

from jexplore.bench.engines import LIDAR, RULES, SEED, Compiler
from jexplore.exploration import replay
from jexplore.exploration.site import Site, prepare_site
from jexplore.exploration.trail import decode
from jexplore.planning import Belief
from jexplore.policies import Strategy
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import World


class Recording(NamedTuple):
    """Scans, plans and motions of an episode."""

    world: World
    strategy: str
    site: Site
    hits: np.ndarray  # [H, W] int32, the last map, without padding
    misses: np.ndarray  # [H, W] int32
    poses: np.ndarray  # [n, 3] int32, row, col, heading (units of 45 degrees) of every scan
    beliefs: list[Belief]  # `planning.Belief` at every plan, the last one, that found nothing, included
    targets: list[tuple[int, int] | None]  # (row, col) chosen there; None for the last


def record(compiler: Compiler, world: World, strategy: Strategy) -> Recording:
    """Run episode 0 of a strategy in a world and keep its scans, and its belief at every plan: a `Recording`.

    Args:
      compiler: `Compiler`.
      world, strategy: `World` with a ring, `Strategy`.
    """
    starts = draw_starts(world, SEED, 1, RULES.clearance_m)
    run = compiler.one_by_one(world, strategy).run(starts)
    result = jax.tree.map(lambda a: a[0], run.result)
    final = decode(jax.tree.map(np.asarray, run.last), result, world.shape)
    site, first = prepare_site(world, LIDAR, RULES), int(starts[0][2]) // 45
    n = site.setup.first_scans
    row, col = (int(a) for a in starts[0][:2])
    poses = [(row, col, (first + 8 // n * k) % 8) for k in range(n)]
    beliefs, targets = [], []
    for turn in replay.turns(site, strategy, starts[0], SEED, 0, final.plans):
        moments = [(moment.row, moment.col, moment.heading) for moment in turn.moments]
        if turn.belief is not None:
            poses += moments
            beliefs.append(turn.belief)
            targets.append(turn.plan and turn.plan.target)
    return Recording(world, strategy.name, site, final.hits, final.misses, np.array(poses, np.int32), beliefs, targets)
