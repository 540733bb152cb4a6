"""Routes over a map: the cost of planning, and the share that another robot drives to their end.

    python benchmarks/routes.py [--parts planning driven] [--routes 400] [--seed 0 1] [--repeat 7]
                                [--buildings courses office]

Planning: a street map of 1,000 nodes, three of four streets there, for 16 robots of 0.3 to 0.9 m and 625 pairs of
nodes. Lengths are held against networkx, for the narrowest and the widest.

Driven: a crawler writes the map, a wheeled robot follows routes over it in the building. Half of the routes lie on
courses without an obstacle (#0 to #9), half in the office; each seed has maps of its own. The crawler's own run, 1 cm
of range noise, gives the map, by triangles on courses, by a local map in the office; routes are drawn among all that
the wheeled robot may use between its nodes. Arrived: the robot says so and truly stands within 1.5 m of where the map
has the end. Where it does not fit at the start, for the map has drifted, it has not arrived. Printed as Markdown.
"""

import argparse
import math
import os
import statistics
import time

import networkx
import numpy as np
import pandas as pd

import jexplore as jx
from jexplore.bench.tables import markdown
from jexplore.driving.batch import building_of
from jexplore.driving.records import Building
from jexplore.driving.settings import Noise
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.report.trace_tables import share
from jexplore.studies import checks
from jexplore.studies.traces import following, job, routes, tracing
from jexplore.tracemap.record import BtmMap, Link, Node
from jexplore.worlds.world import World

WORLDS = {"courses": [f"course#{i}:obstacle=none" for i in range(10)], "office": ["office"]}
NEAR_M = 1.5
NOISE = Noise(range_m=0.01)
WORKERS = os.cpu_count() or 1
SUMS = "places", "missed", "extra", "refused_links", "refused", "contacts"
SIDE, NODES, ROBOTS, PAIRS = 32, 1000, 16, 625


def streets(rng: np.random.Generator) -> BtmMap:
    """Nodes 5 m apart in rows, and links of any width between neighbours, some of them wanting."""
    nodes = tuple(Node(i, i % SIDE * 5.0, i // SIDE * 5.0, "divergence") for i in range(NODES))
    links = []
    for i in range(NODES):
        for j in (i + 1 if (i + 1) % SIDE else NODES, i + SIDE):
            if j < NODES and rng.random() < 0.75:
                length, width, posture = 5 + rng.random(), rng.uniform(0.4, 1.5), rng.uniform(0, 12)
                values = (float(value) for value in (length, width, posture, 0.0, 0.0))
                links.append(Link(len(links), i, j, "searched", 0.0, 180.0, *values))
    return BtmMap(nodes, tuple(links))


def planning(seed: int, repeat: int) -> str:
    """Measure the cost of many robots and pairs: a table."""
    rng = np.random.default_rng(seed)
    btm = streets(rng)
    robots = [f"kamui:width_m={width:.2f}" for width in np.linspace(0.3, 0.9, ROBOTS)]
    pairs = [(int(a), int(b)) for a, b in rng.integers(0, NODES, (PAIRS, 2))]
    clock, cpu = [], []
    for _ in range(repeat):
        began, used = time.perf_counter(), time.process_time()
        found = jx.btm.routes(btm, robots, pairs)
        clock.append(time.perf_counter() - began)
        cpu.append(time.process_time() - used)
    began, equal = time.process_time(), True
    for own in found[:: ROBOTS - 1]:  # of the narrowest and of the widest
        graph = networkx.MultiGraph()
        graph.add_nodes_from(range(NODES))
        shut = {number for number, _ in own[0].refused}
        graph.add_weighted_edges_from((x.start, x.end, x.length_m) for x in btm.links if x.id not in shut)
        lengths = {end: networkx.single_source_dijkstra_path_length(graph, end) for _, end in pairs}
        equal &= all(
            math.isclose(route.length_m, lengths[end].get(start, math.inf), abs_tol=0.001 * max(len(route.links), 1))
            for (start, end), route in zip(pairs, own)
        )
    oracle = (time.process_time() - began) / 2
    there = sum(route.is_found for of in found for route in of)
    row = [f"{ROBOTS} x {PAIRS}", f"{NODES}, {len(btm.links)}", there]
    row += [statistics.median(clock), min(clock), statistics.median(cpu), oracle, equal]
    head = ["robots x pairs", "nodes, links", "ways found", "s by the clock", "least", "CPU s"]
    return markdown([*head, "networkx, lengths alone, CPU s a robot", "equal"], [row])


def driven(world: str, n: int, seed: int):
    """The table of n routes in a world, and how many of them begin where the robot does not fit."""
    plan = job.prepare_trace(world, noise=NOISE, seed=seed)
    found = tracing.execute(plan, workers=WORKERS).first
    ids = [node.id for node in found.nodes]
    rng = np.random.default_rng(seed)
    pairs = [(a, b) for a in ids for b in ids if a != b]
    order = [pairs[i] for i in rng.permutation(len(pairs))]
    able = [route for route in routes.routes(found, ["wheeled"], order)[0] if route.links]
    chosen = [able[i % len(able)] for i in range(n)] if able else []
    (ready,) = checks.ready_worlds([world], 0.1)
    building = building_of(ready)
    there = [route for route in chosen if fits(ready, building, found, route)]
    if not there:
        raise SystemExit(f"{world}, seed {seed}: no route that the robot can drive")
    table = following.follow(world, found, there, "wheeled", noise=NOISE, seed=seed, workers=WORKERS).table
    return table, n - len(there)


def fits(world: World, building: Building, btm: BtmMap, route: routes.Route) -> bool:
    """Return whether the robot fits at the beginning of a route: the map is off by its writer's odometry."""
    try:
        following.start_of(world, building, routes.robot_of("wheeled"), btm, route)
    except jx.InputError:
        return False
    return True


def drives(n_routes: int, seeds: list[int], buildings: list[str]) -> str:
    """Count the routes that are driven to their end: a table."""
    rows = []
    for name in buildings:
        each = -(-n_routes // len(buildings) // len(WORLDS[name]) // len(seeds))
        tables, unfit = zip(*(driven(world, each, seed) for world in WORLDS[name] for seed in seeds))
        found = pd.concat(tables)
        n, says = len(found) + sum(unfit), found["outcome"] == "ARRIVED"
        off_m = found["off_m"][says]
        told = ", ".join(f"{outcome} {k}" for outcome, k in found["outcome"].value_counts().sort_index().items())
        told += f", does not fit at the start {sum(unfit)}" if any(unfit) else ""
        row = [name, n, share(int((off_m < NEAR_M).sum()), n), share(int(says.sum()), n), told]
        row += [f"{off_m.median():.2f}, {off_m.quantile(0.95):.2f}, {off_m.max():.2f}", f"{found['path_m'].mean():.1f}"]
        rows.append([*row, *(int(found[column].sum()) for column in SUMS)])
    columns = ["building", "routes", "arrived", "says so", "outcomes", "off then: median, 95 %, most, m", "m a route"]
    return markdown([*columns, "places", "missed", "extra", "refused links driven", "steps refused", "contacts"], rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=("planning", "driven"), default=["planning", "driven"])
    parser.add_argument("--routes", type=int, default=400)
    parser.add_argument("--seed", type=int, nargs="+", default=[0])
    parser.add_argument("--buildings", nargs="+", choices=list(WORLDS), default=list(WORLDS))
    parser.add_argument("--repeat", type=int, default=7)
    options = parser.parse_args()
    start_backend(WORKERS)
    if "planning" in options.parts:
        print(planning(options.seed[0], options.repeat), end="\n\n")
    if "driven" in options.parts:
        use_compilation_cache()
        print(drives(options.routes, options.seed, options.buildings))


if __name__ == "__main__":
    main()
