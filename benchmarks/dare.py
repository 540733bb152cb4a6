"""Run the planners of DARE's Table I on its 100 test maps, next to its figures.

    python benchmarks/dare.py --maps DIR [--episodes 100] [--scanners dare ariadne bare]
    python benchmarks/dare.py --maps DIR --own-rules

DIR holds 1.png to 100.png of the repository marmotlab/DARE. With --own-rules the league's strategies explore these maps
by the rules of this package, with lower bounds.
"""

import argparse

from parts.dare import own, rules, table


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", required=True, help="folder of 1.png to 100.png")
    parser.add_argument("--episodes", type=int, default=table.MAPS, help="number of maps")
    parser.add_argument("--scanners", nargs="+", choices=tuple(rules.SCANNERS), default=["dare"])
    parser.add_argument("--own-rules", action="store_true", help="explore by the rules of this package")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int)
    options = parser.parse_args()
    how = {"episodes": options.episodes, "seed": options.seed, "workers": options.workers}
    if options.own_rules:
        print(own.own_text(*own.explore_dare(options.maps, **how)))
        return
    for scanner in options.scanners:
        print(f"scanner {scanner}\n")
        print(table.reproduce_dare(options.maps, **how, scanner=scanner).to_markdown())


if __name__ == "__main__":
    main()
