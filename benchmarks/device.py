"""Measure whole episodes on this machine's GPU: equal results, and episodes/s compared with all its CPU cores.

    python benchmarks/device.py [--seconds 400] [--episodes 65536] [--lanes]

Builds the CUDA library, checks that 1,000 episodes of each kind have the numbers of the CPU's native code, measures
rates in the worlds `cave` and `hospital`, occupancy and the share of each part in a warp's time, and, with `--lanes`,
the JAX lanes. Prints one line a measurement as it is made and a table at the end.
"""

import argparse
import itertools
import os
import subprocess
import sys
import time

import numpy as np

import jexplore as jx
from jexplore.engine.runner import on_cores, run_all
from jexplore.exploration.native import NativeRun, native_place
from jexplore.native import episodes, gpu
from jexplore.policies import parse_strategy
from jexplore.rules import Lidar, Rules
from jexplore.worlds.starts import draw_starts
from jexplore.worlds.world import ring_of

WORLDS = ("cave", "hospital")
STRATEGIES = ("closest", "closest+recheck", "random")
RULES, LIDAR = Rules(), Lidar()
CHECKED = 1000  # episodes of each kind that are compared
DRAWN = 512  # starts, which are repeated
COLUMNS = (
    "world",
    "strategy",
    "where",
    "episodes",
    "episodes/s",
    "warps an SM",
    "views MB",
    "making views s",
    "given up",
    "of the time",
)


def name_of_gpu():
    """Return what the driver calls the card, or why it was not asked."""
    ask = ["nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"]
    try:
        return subprocess.run(ask, capture_output=True, text=True, timeout=20, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError) as error:
        return f"no GPU: {error}"


class Case:
    """Episodes of a strategy in a world."""

    def __init__(self, world, strategy, rules=RULES, lidar=LIDAR):
        self.world, self.strategy, self.ring = world, parse_strategy(strategy), ring_of(world.occupied)
        self.place = native_place(episodes.load_episodes().loaded, world, self.strategy, lidar, rules)
        self.starts = draw_starts(world, 2, DRAWN, rules.clearance_m)

    def tasks(self, n):
        """Return n tasks, the starts repeated; each with draws of its own."""
        repeated = self.starts[np.arange(n) % len(self.starts)]
        at = repeated + np.array([self.ring, self.ring, 0])
        at[:, 2] //= 45
        return self.place.inner.tasks(at, 2, np.arange(n, dtype=np.int32))

    def on_gpu(self, loaded, n, **how):
        """Run n episodes on the GPU: `gpu.Played`."""
        return gpu.play(loaded, self.place.spec, self.place.given, self.tasks(n), np.zeros(1, np.int32), **how)

    def on_cpu(self, n, workers):
        """Run n episodes on the CPU: `([n, RESULT], seconds)`."""
        starts = self.starts[np.arange(n) % len(self.starts)]
        run = NativeRun(self.place, starts, 2, 0, np.arange(n))
        began = time.time()
        run_all([run], on_cores(workers))
        return run.table, time.time() - began


def check(loaded, cores):
    """Compare episodes on both: the number of those that differ."""
    cases = [
        (world, strategy, {}, {})
        for world, strategy in itertools.product(("cave", "office", "maze", "rooms"), STRATEGIES)
    ]
    cases.append(
        ("office", "closest", {"scan_every_m": 0.5, "arrival_m": 0.3, "look_around": False}, {"no_echo": "unknown"})
    )
    cases.append(
        ("cave", "random", {"clearance_m": 0.2, "near_m": 1.0, "max_plans": 9}, {"fov_deg": 70.0, "n_beams": 90})
    )
    unequal = 0
    for name, strategy, rules, lidar in cases:
        case = Case(jx.load_world(name), strategy, Rules(**rules), Lidar(**lidar))
        want, _ = case.on_cpu(CHECKED, cores)
        found = case.on_gpu(loaded, CHECKED)
        differ = (found.results != want).any(axis=1) & (found.results[:, 6] != 0)
        unequal += int(differ.sum())
        print(f"{name} {strategy} {rules or ''} {lidar or ''}: {CHECKED - differ.sum()} of {CHECKED} equal,"
              f" {found.measured.given_up} given up", flush=True)  # fmt: skip
    return unequal


def share(measured):
    """Return the share of each part in the time of all warps, as text."""
    *parts, whole = measured.clocks
    return ", ".join(f"{name} {100 * part / whole:.0f} %" for name, part in zip(gpu.PARTS, parts)) if whole else "-"


def row_of(case, name, found, n, label):
    """Return a row of `COLUMNS`."""
    m = found.measured
    return (case.world.name, name, label, n, f"{n / m.run_s:.0f}", m.warps_per_sm, f"{m.views_bytes / 1e6:.0f}",
            f"{m.views_s:.2f}", m.given_up, share(m))  # fmt: skip


def measure(loaded, clocked, n, cores, end):
    """Measure rates; yields rows of `COLUMNS`."""
    for name, strategy in itertools.product(WORLDS, STRATEGIES):
        if time.time() > end:
            print("no time left for", name, strategy)
            continue
        case, few = Case(jx.load_world(name), strategy), n if name == "cave" else n // 8
        if strategy == "closest+recheck":
            _, took = case.on_cpu(few // 32, cores)
            yield (name, strategy, f"{cores} cores", few // 32, f"{few // 32 / took:.0f}", *[""] * 5)
            yield row_of(case, strategy, case.on_gpu(clocked, few // 4), few // 4, "GPU, with clocks")
        yield row_of(case, strategy, case.on_gpu(loaded, few), few, "GPU")


def lanes(end):
    """Measure the JAX lanes; yields rows of `COLUMNS`."""
    for name, strategy, many in (("cave", "closest+recheck", 1024), ("cave", "distance-advantage+recheck", 1024)):
        if time.time() + 90 > end:
            print("no time left for lanes", name, strategy)
            continue
        found = jx.compare(name, [strategy], episodes=many, seed=2, engine="jax", lanes=many)
        yield (name, strategy, "GPU, JAX lanes", many, f"{found.episodes_per_s:.0f}", *[""] * 5)


def main():
    """Measure, and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=400, help="time for everything")
    parser.add_argument(
        "--episodes", type=int, default=65536, help="episodes a measurement in the cave; an eighth elsewhere"
    )
    parser.add_argument("--lanes", action="store_true", help="measure the JAX lanes as well")
    options = parser.parse_args()
    end, cores = time.time() + options.seconds, len(os.sched_getaffinity(0))
    print(f"{name_of_gpu()}; {cores} cores", flush=True)
    began = time.time()
    plain, clocked = gpu.load_gpu(), gpu.load_gpu(flags=("-DJEXPLORE_CLOCKS",))
    if plain.loaded is None or clocked.loaded is None:
        print(plain.why_not or clocked.why_not)
        return 1
    print(f"built in {time.time() - began:.0f} s, two libraries", flush=True)
    unequal, rows = check(plain.loaded, cores), []
    for row in itertools.chain(
        measure(plain.loaded, clocked.loaded, options.episodes, cores, end), lanes(end) if options.lanes else ()
    ):
        rows.append(row)
        print(*row, flush=True)
    print("\n| " + " | ".join(COLUMNS) + " |\n|" + " --- |" * len(COLUMNS))
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")
    print(f"\n{unequal} episodes differ")
    return int(unequal > 0)


if __name__ == "__main__":
    sys.exit(main())
