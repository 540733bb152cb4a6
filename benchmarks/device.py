"""Measure the engines on this machine's GPU: equal results, and episodes/s beside all its CPU cores.

    python benchmarks/device.py [--seconds 500] [--small]

Prints one row a measurement as it is made, then all of them as a table. A part for which no time is left is skipped and
named; one that fails is reported, and the others go on. `--small` makes a tiny run on any machine.
"""

import argparse
import os
import subprocess
import sys
import time

import jax

import jexplore as jx

EQUAL = ("path_m", "steps", "plans", "scans")  # columns that devices must agree on, to the bit
COLUMNS = ("engine", "world", "strategy", "lanes", "episodes", "wall s", "episodes/s", "without compiling")


def measure(engine, world, strategy, episodes, lanes=None):
    """Run episodes once; return a row of `COLUMNS`."""
    began = time.time()
    result = jx.compare(world, [strategy], episodes=episodes, seed=2, engine=engine, lanes=lanes)
    took = time.time() - began
    return (engine, world, strategy, lanes or "", episodes, f"{took:.2f}", f"{episodes / took:.0f}",
            f"{result.episodes_per_s:.0f}")  # fmt: skip


def compare_devices(episodes):
    """Run the same episodes in both engines; return the columns of `EQUAL` that differ."""
    strategies = ["closest", "closest+recheck"]
    options = {"episodes": episodes, "seed": 5}
    serial = jx.compare("cave", strategies, engine="serial", **options).to_pandas()
    lockstep = jx.compare("cave", strategies, engine="lockstep", lanes=episodes, **options).to_pandas()
    return [c for c in EQUAL if not (serial[c].to_numpy() == lockstep[c].to_numpy()).all()]


def name_of_gpu():
    """Return what the driver calls the card, or why it was not asked."""
    ask = ["nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"]
    try:
        return subprocess.run(ask, capture_output=True, text=True, timeout=20, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError) as error:
        return f"no GPU: {error}"


def plan(small, cores):
    """Return the measurements: (arguments of `measure`, seconds that must be left before it begins)."""
    if small:
        return [(("lockstep", "cave", "closest+recheck", 16, 8), 0), (("serial", "cave", "closest+recheck", 8), 0)]
    parts = []
    for world, each in (("cave", 32), ("hospital", 8)):
        parts += [(("lockstep", world, "closest+recheck", 2 * lanes, lanes), 60) for lanes in (1024, 4096)]
        parts.append((("serial", world, "closest+recheck", each * cores), 40))
    parts.append((("lockstep", "cave", "closest+recheck", 2 * 16384, 16384), 80))
    parts.append((("lockstep", "cave", "distance-advantage+recheck", 2 * 4096, 4096), 90))
    return parts


def main():
    """Measure, and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=500, help="time for everything")
    parser.add_argument("--small", action="store_true")
    options = parser.parse_args()
    end, cores, failed = time.time() + options.seconds, len(os.sched_getaffinity(0)), 0
    print(f"{name_of_gpu()}; {jax.devices()}, {cores} cores, jax {jax.__version__}", flush=True)
    differ = compare_devices(8 if options.small else 64)
    print("differ between devices:" if differ else "equal on both devices:", *(differ or EQUAL), flush=True)
    rows = []
    for arguments, needs_s in plan(options.small, cores):
        if end - time.time() < needs_s:
            print("no time left for", *arguments)
            continue
        try:
            rows.append(measure(*arguments))
            print(*rows[-1], flush=True)
        except Exception as error:  # the others are worth having
            failed += 1
            print("FAILED", *arguments, repr(error), flush=True)
    print("\n| " + " | ".join(COLUMNS) + " |\n|" + " --- |" * len(COLUMNS))
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")
    return bool(differ or failed)


if __name__ == "__main__":
    sys.exit(main())
