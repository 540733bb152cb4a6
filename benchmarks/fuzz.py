"""Episodes at random, by the engine and by the plain-numpy oracle of the tests: is everything measured equal?

    python benchmarks/fuzz.py --cases 1000 --seed 0
    python benchmarks/fuzz.py --first 137 --cases 1    # a case alone
    python benchmarks/fuzz.py --native --cases 10000   # native code, also as a GPU runs it, and JAX
    python benchmarks/fuzz.py --alone --sanitize       # native code alone, with the compiler's sanitizers

Prints how many cases of each kind were equal, and a line for every one that was not; exit status 1 if there was any.
"""

import argparse
import functools
import os
import sys
import time
from collections import Counter
from pathlib import Path

from jexplore.bench.tables import markdown
from jexplore.config import InputError, require_whole
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.native import build

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from ref import fuzz, native

SHOWN = 3  # differences of a case that are printed
EVERY = 50  # cases after which progress is shown


def compare(seed, numbers, fixed, play):
    """Play cases of some programs: `(cases, unequal cases, steps and scans)`, the first two by kind.

    Args:
      seed, numbers, fixed: of `fuzz.draw_case`.
      play: of a case, returns a `fuzz.Verdict`.
    """
    cases, unequal, made = Counter(), Counter(), Counter()
    for i, number in enumerate(numbers, 1):
        case = fuzz.draw_case(seed, number, fixed)
        try:
            verdict = play(case)
        except Exception as error:
            error.add_note(f"in case {number} of seed {seed}: {case.lidar}, {case.rules}, cells of {case.cell_m} m")
            raise
        kinds = ["all", *fuzz.kinds_of(case, verdict)]
        cases.update(kinds)
        made.update(steps=verdict.steps, scans=verdict.scans)
        if verdict.differences:
            unequal.update(kinds)
            more = len(verdict.differences) - SHOWN
            text = "; ".join(verdict.differences[:SHOWN]) + (f"; {more} more" if more > 0 else "")
            print(f"case {number}: {text}", flush=True)
        if i % EVERY == 0:
            print(f"{i} cases up to {number}, {unequal['all']} unequal", file=sys.stderr, flush=True)
    return cases, unequal, made


def parse():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="default %(default)s")
    parser.add_argument("--first", type=int, default=0, help="number of the first case; default %(default)s")
    parser.add_argument("--native", action="store_true", help="without the oracle and noise")
    parser.add_argument("--alone", action="store_true", help="without JAX, the oracle and noise")
    parser.add_argument("--sanitize", action="store_true", help="sanitizers of addresses and undefined behaviour")
    return parser.parse_args()


def sanitize():
    """Build native code with sanitizers, in a process that begins with their libraries."""
    environment = native.sanitized_environment()
    if environment is None:
        raise InputError("--sanitize needs a C++ compiler with libasan.so and libstdc++.so")
    if os.environ.get("LD_PRELOAD") != environment["LD_PRELOAD"]:
        os.execve(sys.executable, [sys.executable, *sys.argv], environment)
    build.FLAGS = (*build.FLAGS, *native.SANITIZED)


def main():
    args = parse()
    for name, low in (("cases", 1), ("seed", 0), ("first", 0)):
        require_whole(f"--{name}", getattr(args, name), low, 2**31 - 1)
    if args.sanitize:
        sanitize()
    start_backend(1)
    use_compilation_cache()
    began, fixed = time.perf_counter(), fuzz.EXACT if args.native or args.alone else fuzz.MANY
    play = fuzz.compare_alone if args.alone else functools.partial(fuzz.compare, oracle=not args.native)
    cases, unequal, made = compare(args.seed, range(args.first, args.first + args.cases), fixed, play)
    took = time.perf_counter() - began
    order = sorted(cases, key=lambda kind: (kind != "all", *kind.partition(": ")[1::-1], -cases[kind]))
    rows = [[kind, cases[kind], cases[kind] - unequal[kind], unequal[kind]] for kind in order]
    print(markdown(["kind", "cases", "equal", "unequal"], rows))
    print(f"\n{made['steps']} steps, {made['scans']} scans, {len(fixed)} programs, {took:.0f} s")
    return int(unequal["all"] > 0)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InputError as error:
        print(f"{Path(sys.argv[0]).name}: error: {error}", file=sys.stderr)
        sys.exit(2)
