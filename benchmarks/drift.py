"""Measure the effect of drift on maps, and their bytes.

    python benchmarks/drift.py [--runs 16] [--world course] [--parts drift memory paths] [--out FOLDER]

Tables are printed as Markdown. With --out the table of runs is kept as drift.parquet, the figure as drift.png. 16 runs
of every value take some minutes on two cores, the plans of `memory` one.
"""

import argparse
import collections
import dataclasses
import os
import sys
from pathlib import Path

import numpy as np
from parts.drift.storage import storage
from parts.drift.study import drift

from jexplore.driving.settings import Noise
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.grid import centre_of
from jexplore.report.plot import save_figure
from jexplore.report.trace_tables import share
from jexplore.studies.bounds.bound import bound
from jexplore.studies.comparison import compare
from jexplore.studies.traces.job import START_CLEARANCE_M
from jexplore.studies.traces.tracing import trace
from jexplore.worlds import load_world
from jexplore.worlds.starts import draw_starts

STRATEGIES = ("closest", "closest+recheck", "random+recheck")
BUILDINGS = ("rooms:width_m=8,height_m=8", "course:loops=1")
PARTS = ("drift", "memory", "paths")
PLANS = (
    "course",
    "rooms",
    "office:width_m=20,height_m=14",
    "office",
    "office:width_m=60,height_m=40",
    "office:width_m=120,height_m=60",
    "hospital",
    "hospital:width_m=100,height_m=40",
)


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def head(*cells):
    print()
    row(*cells)
    row(*["---"] * len(cells))


def told(n):
    if n % 10 == 0:
        print(n, "runs", file=sys.stderr, flush=True)


def drifting(given):
    """Structure, coordinates and grid map over every error of the odometry."""
    found = drift(given.world, runs=given.runs, seed=given.seed, on_progress=told)
    if given.out is not None:
        Path(given.out).mkdir(parents=True, exist_ok=True)
        found.runs.to_parquet(Path(given.out) / "drift.parquet")
        save_figure(found.figure(), Path(given.out) / "drift.png")
    head("error", "value", "the true map", "nodes off by m", "cells on a wall", "wall drawn twice")
    for line in found.summary.to_dict("records"):
        right = "–" if np.isnan(line["true"]) else share(round(line["true"] * line["n"]), line["n"])
        cells = [f"{line['node_error_m']:.2f}", *(f"{100 * line[name]:.0f} %" for name in ("on_wall", "doubled"))]
        row(line["error"], f"{line['value']:g}", right, *cells)


def memory(given):
    """Bytes of plans that grow: read off as a map of passages, packed as a grid, as a pose graph."""
    del given
    head("plan", "map: JSON kB", "compressed", "packed", "compressed", "grid kB", "compressed", "pose graph kB")
    names = "btm_json", "btm_json_zlib", "btm_packed", "btm_packed_zlib", "grid_packed", "grid_packed_zlib"
    for plan in PLANS:
        found = storage(plan)
        row(plan, *(f"{found[name] / 1000:.2f}" for name in (*names, "pose_graph")))


def paths(given):
    """Compare the ways of a tracing robot with frontier strategies and one that knows the map, from one start."""
    head("building", "starts", "who", "way m", "times the shortest known", "ended complete")
    for name in given.buildings:
        world = load_world(name)
        starts = draw_starts(world, given.seed, given.starts, START_CLEARANCE_M)
        ways, known = collections.defaultdict(list), []
        for start in starts:
            here = dataclasses.replace(world, start=tuple(int(n) for n in start))
            shortest = bound(here, starts=1, start="world", seconds=5.0).table["high_m"].iloc[0]
            known.append(shortest)
            x_m, y_m = centre_of(start[0], start[1], cell_m=world.cell_m, origin_m=world.origin_m)
            run = trace(
                here,
                start=(x_m, y_m, float(start[2])),
                noise=Noise(range_m=0.01),
                seed=given.seed,
            ).table
            ways["robot that traces"].append((run["path_m"].iloc[0], run["outcome"].iloc[0] == "EXHAUSTED"))
            episodes = compare(here, STRATEGIES, episodes=1, start="world", seed=given.seed).episodes
            for episode in episodes.to_dict("records"):
                ways[episode["strategy"]].append((episode["path_m"], episode["outcome"] == "COMPLETE"))
        row(name, len(starts), "knows the map", f"{np.mean(known):.1f}", "1", "–")
        for who, found in ways.items():
            times = np.mean([way / shortest for (way, _), shortest in zip(found, known)])
            done = f"{sum(ended for _, ended in found)} of {len(found)}"
            row(name, len(starts), who, f"{np.mean([way for way, _ in found]):.1f}", f"{times:.2f}", done)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=16, help="of every value")
    parser.add_argument("--world", default="course", help="of the part drift")
    parser.add_argument("--parts", nargs="*", default=PARTS, choices=PARTS)
    parser.add_argument("--buildings", nargs="*", default=BUILDINGS, help="of the part paths")
    parser.add_argument("--starts", type=int, default=3, help="in each of these buildings")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="folder for the table of runs and the figure")
    given = parser.parse_args()
    start_backend(os.cpu_count() or 1)
    use_compilation_cache()
    for part in given.parts:
        print(f"\n## {part}")
        {"drift": drifting, "memory": memory, "paths": paths}[part](given)


if __name__ == "__main__":
    main()
