"""Measure the cost of a plan of each strategy on one core, on maps of 160 x 160 and 256 x 256 cells.

    taskset -c 0 python benchmarks/strategies.py
    taskset -c 0 python benchmarks/strategies.py closest utility     # of these alone

Every strategy plans on the same maps: those at which `closest+recheck` made its plans.
"""

import os
import sys

from jexplore.bench.plans import plan_costs
from jexplore.bench.tables import markdown
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.policies import parse_strategy
from jexplore.policies.room_wise import own_segment
from jexplore.worlds import load_world

WORLDS = ("cave", "cave:width_m=25.6,height_m=25.6", "office:width_m=25.6,height_m=25.6")
NAMES = (
    *("closest", "closest+segment", "random", "decision-theoretic:samples=100", "decision-theoretic:samples=500"),
    *("gain-rate", "utility", "distance-advantage", "small-first", "tour", "mcdm"),
)


def main(names):
    start_backend(1)
    use_compilation_cache()
    repeat = int(os.environ.get("REPEAT", "5"))
    kinds = () if names else ("holz", "voronoi")
    names = names or NAMES
    params = {kind: parse_strategy(f"closest+segment={kind}").policy.params for kind in kinds}
    others = {
        f"the segmentation alone: {kind}": lambda belief, own=own: own_segment(own, belief)
        for kind, own in params.items()
    }
    costs = {world: plan_costs(load_world(world), names, others=others, repeat=repeat) for world in WORLDS}
    rows = [[name, *(costs[world][name] for world in WORLDS)] for name in (*names, *others)]
    print(markdown(["ms a plan", *WORLDS], rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
