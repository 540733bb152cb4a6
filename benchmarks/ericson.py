"""Measure which rule of Ericson, Pedro, Jensfelt 2025 makes `distance-advantage` shorter than `closest`.

    python benchmarks/ericson.py [--worlds 8] [--kinds office]

Their public code (lericson/da, without map predictions) drives 0.841 of the nearest frontier's path. Its rules: both
strategies choose anew after every scan that changes the map; the advantage of a frontier cell is the mean path from it
to the known free cells within 15 m, not to the other frontier clusters, less the robot's path to it; no gain decides
which frontier cells count; the scanner sees 4.5 m all round; the robot is a point; cells are 0.25 m. Each row has these
rules, all but one, or none: in their place are ours. A ratio is over the worlds, one start each, with a 95 % interval.
"""

import argparse

import jax.numpy as jnp
import numpy as np

import jexplore as jx
from jexplore.arrays.loops import repeat
from jexplore.frontier import clear_cells
from jexplore.grid import is_free
from jexplore.planning import is_live, metres
from jexplore.policies.clusters import Best
from jexplore.policies.distance_advantage import distance_advantage
from jexplore.policies.policy import no_carry
from jexplore.reach import FAR, reach
from jexplore.studies.statistics.over_worlds import kind_of, mean_over_worlds

CELL_M = 0.25
AROUND = 61  # cells, across edges or corners, within which known free cells count
SCANNER = {"n_beams": 360, "fov_deg": 360, "range_m": 4.5}
POINT = {"clearance_m": 0, "near_m": 0, "frontier_connectivity": 4}


def mean_to_known(params, belief, at, beams):
    """Judge clusters by the mean path to known free cells around the robot, less the robot's own."""
    free = is_free(belief.grid, belief.model.p_free)
    rows, cols = jnp.indices(free.shape)
    counts = free & (jnp.maximum(abs(rows - belief.row), abs(cols - belief.col)) < AROUND)
    clear = clear_cells(belief.grid, p_free=belief.model.p_free, clearance_d2=belief.model.clearance_d2) | belief.driven

    def measure(state):
        i, means = state
        cost = reach(clear, at.row[i], at.col[i])
        near = counts & (cost < FAR)
        mean = jnp.sum(jnp.where(near, metres(cost, belief.model.cell_m), 0)) / jnp.maximum(jnp.sum(near), 1)
        return i + 1, means.at[i].set(mean)

    start = jnp.int32(0), jnp.zeros(at.row.shape)
    n = jnp.sum(at.used, dtype=jnp.int32)
    return repeat(lambda state: state[0] < n, measure, start)[1] - at.path_m, at.used


def advantage_over_cells():
    """The strategy of their code, its candidates one cell a cluster."""
    return jx.Policy(no_carry, Best(mean_to_known))


def at_every_step(policy):
    """Have a strategy choose anew after every step; a target that is reached is judged as ever."""

    def select(*given):
        carry, choice, route = policy.select(*given)
        return carry, choice.replace(is_view=choice.row >= 0), route

    def live(params, belief, beams, row, col):
        return (belief.row == row) & (belief.col == col) & is_live(belief, row, col)

    return policy._replace(select=select, live=live)


def ratio_of(worlds, over_cells, replan, scanner, point):
    """The table's cells of one set of rules: ratio, interval, and how many episodes completed."""
    policies = [jx.strategy("closest").policy, advantage_over_cells() if over_cells else distance_advantage()]
    policies = [at_every_step(policy) for policy in policies] if replan == "every step" else policies
    names = "closest", "distance advantage"
    strategies = [jx.policies.Strategy(name, policy, replan != "none") for name, policy in zip(names, policies)]
    own = {"lidar": SCANNER if scanner else {}, "rules": POINT if point else {}}
    found = jx.compare(worlds, strategies, episodes=1, cell_m=CELL_M, **own).episodes
    table = found.pivot(index="world", columns="strategy", values="path_m").reindex(worlds)
    whole = found.assign(done=found["outcome"] == "COMPLETE").groupby("world")["done"].all().reindex(worlds)
    logs = np.log(table[names[1]] / table[names[0]])[whole]
    mean, low, high, _ = mean_over_worlds(logs.to_numpy(), [kind_of(world) for world in logs.index])
    low, high, ratio = np.exp([low, high, mean])
    return [f"{table[names[0]][whole].mean():.1f}", f"{ratio:.3f} [{low:.3f}, {high:.3f}]", f"{whole.sum()}"]


ROWS = {  # (over cells, replan, scanner, point)
    "all of theirs": (True, "every step", True, True),
    "but the mean over other clusters": (False, "every step", True, True),
    "but re-checking alone": (True, "recheck", True, True),
    "but on to the target": (True, "none", True, True),
    "but 180 degrees, 8 m": (True, "every step", False, True),
    "but 0.3 m of clearance": (True, "every step", True, False),
    "all of ours": (False, "recheck", False, False),
    "ours, chosen at every step": (False, "every step", False, False),
    "ours, on to the target": (False, "none", False, False),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=8, help="of each kind")
    parser.add_argument("--kinds", nargs="+", default=["office"])
    parser.add_argument("--rows", nargs="+", choices=tuple(ROWS), default=list(ROWS))
    given = parser.parse_args()
    worlds = [f"{kind}#{seed}" for kind in given.kinds for seed in range(given.worlds)]
    print("| rules | closest, m | distance advantage / closest | worlds |\n| --- | ---: | ---: | ---: |")
    for name in given.rows:
        print("|", " | ".join([name, *ratio_of(worlds, *ROWS[name])]), "|", flush=True)


if __name__ == "__main__":
    main()
