"""Teams of random robots in random worlds, by the engine and by the oracle of the tests: is everything measured equal?

    python benchmarks/teams.py --cases 1000
    python benchmarks/teams.py --first 137 --cases 1 --coordination minpos --robots 3

Prints, for each coordination and size, how many cases were equal, how robots ended and how often they waited, and a
line for every case that was not equal; exit status 1 if there was any.
"""

import argparse
import itertools
import sys
from collections import Counter
from pathlib import Path

from jexplore.bench.tables import markdown

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from ref import team


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000, help="number of cases, of all programs together")
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each program")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", type=int, nargs="+", default=[2, 3, 5])
    parser.add_argument("--coordination", nargs="+", default=["independent", "minpos", "voronoi"])
    given = parser.parse_args()
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
