"""Teams of random robots in random worlds, by the engine and by the oracle of the tests: is everything measured equal?

    python benchmarks/teams.py --cases 1000
    python benchmarks/teams.py --first 137 --cases 1 --coordination minpos --robots 3
    python benchmarks/teams.py --cost --robots 1 2 4 --coordination independent

Prints, for each coordination and size, how many cases were equal, how robots ended and how often they waited, and a
line for every case that was not equal; exit status 1 if there was any. With --cost the processor time of a turn of one
robot, in rooms of 10 x 8 m, to that in the smallest team.
"""

import argparse
import itertools
import sys
import time
from collections import Counter
from pathlib import Path

import jexplore as jx
from jexplore.bench.tables import markdown
from jexplore.exploration.batch import Job, run_jobs
from jexplore.exploration.team.team import Team, read_coordination
from jexplore.policies import strategy
from jexplore.rules import Lidar, Rules
from jexplore.worlds.starts import draw_starts

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from ref import team


def cost(coordinations, sizes):
    """Return a table of processor time; a turn is a step, a wait, a plan or a scan without a step."""
    world, rules = jx.load_world("rooms:width_m=10,height_m=8"), Rules()
    starts, rows, alone = draw_starts(world, 0, 4, rules.clearance_m), [], {}
    for coordination, n in itertools.product(coordinations, sorted(sizes)):
        job = Job(world, strategy("closest"), starts, team=Team(n, read_coordination(coordination)))
        run_jobs([job], Lidar(), rules, workers=1)  # compiles
        began = time.process_time()
        result = run_jobs([job], Lidar(), rules, workers=1).outcomes[0].result
        spent, counts = time.process_time() - began, result.metrics
        turns = int((counts.straight + counts.diagonal + counts.waits).sum() + result.plans.sum())
        us = 1e6 * spent / turns
        alone.setdefault(coordination, us)
        rows.append([coordination, str(n), str(turns), f"{us:.0f}", f"{us / alone[coordination]:.2f}"])
    return markdown(["coordination", "robots", "turns", "us a turn", "to the first"], rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000, help="number of cases, of all programs together")
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each program")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", type=int, nargs="+", default=[2, 3, 5])
    parser.add_argument("--coordination", nargs="+", default=["independent", "minpos", "voronoi"])
    parser.add_argument("--cost", action="store_true", help="measure the time of a turn instead")
    given = parser.parse_args()
    if given.cost:
        print(cost(given.coordination, given.robots))
        return 0
    kinds = list(itertools.product(given.coordination, given.robots))
    rows, unequal = [], 0
    for coordination, n in kinds:
        ends, waits, equal, of = Counter(), 0, 0, -(-given.cases // len(kinds))
        for number in range(given.first, given.first + of):
            told, robots = team.differences(team.draw_case(given.seed, number, coordination, n))
            ends.update(robot.ended for robot in robots)
            waits += sum(robot.waits for robot in robots)
            equal += not told
            for text in told[:3]:
                print(f"{coordination}, {n} robots, case {number}: {text[:200]}", flush=True)
        unequal += of - equal
        told = ", ".join(f"{name} {count}" for name, count in sorted(ends.items()))
        rows.append([coordination, str(n), f"{equal} of {of}", str(waits), told])
    print(markdown(["coordination", "robots", "equal", "waits", "ends of robots"], rows))
    return int(unequal > 0)


if __name__ == "__main__":
    sys.exit(main())
