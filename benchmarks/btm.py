"""Measure the claims about trace maps: repeatability, accuracy, buildings, sensors, speed.

    python benchmarks/btm.py [--runs 1000] [--parts repeat place robots]
    python benchmarks/btm.py [--runs 1000] [--parts buildings halls furniture sensors steps speed] [--seed 0]
    python benchmarks/btm.py [--runs 1000] --parts buildings --worlds WORLD... [--perception triangles] [--starts 2]
    python benchmarks/btm.py [--runs 1000] --parts loops [--first 21]
    python benchmarks/btm.py --parts read-off --maps FOLDER

FOLDER has plans of buildings as NAME.png and, furnished, as NAME_furnitures.png, 0.05 m a pixel (Bormann et al. 2016).

Everything is printed as Markdown. 1000 runs of each take some twenty minutes on two cores.
"""

import argparse
import dataclasses
import functools
import os
from pathlib import Path

import numpy as np
import pandas as pd

from jexplore.driving.settings import Noise, Tuning, for_world
from jexplore.engine.backend import start_backend, use_compilation_cache
from jexplore.extraction.extract import extract
from jexplore.report.trace_tables import share
from jexplore.studies.traces import job, tracing
from jexplore.tracemap import record
from jexplore.tracemap.corrected import correct_map
from jexplore.tracemap.record import BtmMap
from jexplore.tracemap.similarity import code
from jexplore.worlds import load_world
from jexplore.worlds.world import World

STILL = Noise(attitude_deg=0, length=0, turn=0, heading_deg_sqrt_m=0, slip=0, beacon_m=0)
PARTS = (
    "repeat",
    "place",
    "robots",
    "buildings",
    "halls",
    "furniture",
    "sensors",
    "steps",
    "loops",
    "speed",
)
ERRORS = {
    "none besides 1 cm": {},
    "range noise 5 cm": {"range_m": 0.05},
    "range noise 8 cm": {"range_m": 0.08},
    "attitude noise 1 degree": {"attitude_deg": 1.0},
    "attitude noise 2 degrees": {"attitude_deg": 2.0},
    "10 % of the beams without a number": {"invalid": 0.1},
    "30 % of the beams without a number": {"invalid": 0.3},
    "slip 10 % of every turn": {"slip": 0.1},
    "slip 20 % of every turn": {"slip": 0.2},
    "encoders 2 % long, walk of 2 degrees": {"length_scale": 1.02, "turn_scale": 1.02, "heading_deg_sqrt_m": 2.0},
    "encoders 5 % long": {"length_scale": 1.05, "turn_scale": 1.05},
    "heading bias 3 degrees a metre": {"heading_bias_deg_m": 3.0},
    "5 cm, 1 degree, 10 % invalid, slip 10 %": {"range_m": 0.05, "attitude_deg": 1.0, "invalid": 0.1, "slip": 0.1},
}
# Times as many runs, where a rate lies near that which it is to have at least.
MORE_RUNS = {"range noise 5 cm": 4, "10 % of the beams without a number": 12}
BUILDINGS = ("rooms", "office", "hospital", "maze", "cave")
WORKERS = os.cpu_count() or 1


def traced(world, **options):
    plan = job.prepare_trace(world, **options)
    return tracing.execute(plan, workers=WORKERS)


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def head(*cells):
    print()
    row(*cells)
    row(*["---"] * len(cells))


def repeat(runs):
    head("world", "range noise m", "alike", "the true map", "contacts", "interventions")
    for world in ("course", "course:obstacle=stairs"):
        for sigma in (0.01, 0.03, 0.05):
            table = traced(world, runs=runs, noise=Noise(range_m=sigma)).table
            alike = int(table["code"].value_counts().iloc[0])
            right = share(int(table["true"].sum()), len(table))
            row(world, sigma, share(alike, len(table)), right, table["contacts"].sum(), table["interventions"].sum())


def place(runs):
    """Nodes and stubs of noiseless runs on many courses against the true topology."""
    head("courses", "the true map", "divergences within 2 cells", "stubs: precision", "recall", "largest error m")
    seeds, right, near, all_nodes, hits, ours, theirs, worst = max(20, runs // 20), 0, 0, 0, 0, 0, 0, 0.0
    for seed in range(seeds):
        found = traced(f"course#{seed}", noise=STILL)
        right += code(found.first) == code(found.truth)
        match = matched(found.first, found.truth)
        offs = [off for (node, _), off in match if node.type == "divergence"]
        near += sum(off <= 2 * found.plan.world.cell_m for off in offs)
        all_nodes += sum(node.type == "divergence" for node in found.first.nodes)
        worst = max([worst, *offs])
        here = stubs(found.first, found.truth, match)
        hits, ours, theirs = hits + here[0], ours + here[1], theirs + here[2]
    row(seeds, share(right, seeds), share(near, all_nodes), f"{hits}/{ours}", f"{hits}/{theirs}", f"{worst:.2f}")


def matched(found: BtmMap, true: BtmMap):
    """Nodes of a map with the nearest true one of their type, within a metre: `[((node, true), distance)]`."""
    pairs = []
    for node in found.nodes:
        others = [other for other in true.nodes if other.type == node.type]
        off = [float(np.hypot(node.x_m - o.x_m, node.y_m - o.y_m)) for o in others]
        if off and min(off) < 1:
            pairs.append(((node, others[int(np.argmin(off))]), min(off)))
    return pairs


def stubs(found: BtmMap, true: BtmMap, match):
    """Un-searched links within 30 degrees of a true one at the same node: `(hits, found, true)`."""

    def at(which: BtmMap, node):
        links = [link for link in which.links if link.start == node and link.end == record.NOWHERE]
        return [link.start_bearing_deg for link in links]

    hits = ours = theirs = 0
    for (node, other), _ in match:
        if node.type != "divergence":
            continue
        left = at(true, other.id)
        theirs += len(left)
        for bearing in at(found, node.id):
            ours += 1
            near = [b for b in left if abs((b - bearing + 180) % 360 - 180) < 30]
            if near:
                left.remove(near[0])
                hits += 1
    return hits, ours, theirs


def robots(runs):
    head("world", "range noise m", "width m", "the true map but for obstacles", "same as 0.39 m")
    for world in ("course", "course#5"):
        for sigma in (0.0, 0.01):
            maps = {}
            for width in (0.39, 0.60):
                found = traced(world, runs=runs, robot=f"kamui:width_m={width}", noise=Noise(range_m=sigma))
                results = [found.maps[i] for i in range(runs)]
                maps[width] = [code(m).replace("O:slope", "O") for m in results]
                true = code(found.truth).replace("O:slope", "O")
                right = sum(c == true for c in maps[width])
                same = sum(a == b for a, b in zip(maps[width], maps[0.39]))
                row(world, sigma, width, share(right, runs), share(same, runs))


def buildings(runs, seed=0, worlds=BUILDINGS, perception="auto", n=None):
    """Run in buildings, each from n starts, by default a twenty-fifth of `runs`, and compare with the true map.

    Truth: `extract` of the true map, as far as the robot gets; doors are those of the generator.
    """
    n = n or max(8, runs // 25)
    columns = ["building", "starts", "EXHAUSTED", "outcomes", "junctions", "doors"]
    more = [
        "false divergences",
        "took a place for another",
        "contacts a run",
        "steps refused",
        "steps a run",
        "drift m",
    ]
    head(*columns, *more)
    for world in worlds:
        table = traced(world, starts=n, seed=seed, noise=Noise(range_m=0.01), perception=perception).table
        done = table["outcome"] == "EXHAUSTED"
        outcomes = ", ".join(f"{name} {count}" for name, count in table["outcome"].value_counts().items())
        near = [part(table, f"{name}_reached", name) for name in ("junctions", "doors")]
        cells = [share(int(done.sum()), n), outcomes, *near]
        contacts, steps, drift = (table[name].mean() for name in ("contacts", "steps", "drift_m"))
        false = part(table, "false_divergences", "divergences")
        mistaken = share(int((table["mistaken"] > 0).sum()), n)
        row(
            world, n, *cells, false, mistaken, f"{contacts:.1f}", table["refused"].sum(), f"{steps:.0f}", f"{drift:.2f}"
        )


def drawn_hall(seed, low_m, high_m):
    """A hall with three or four passages, one in a wall, 1, 1.5 or 2 m wide and 3 to 12 m long."""
    cell_m, size, rng = 0.1, 460, np.random.default_rng(seed)
    extent = (rng.uniform(low_m, high_m, 2) / cell_m).astype(int)  # along x and y, cells
    half = int(rng.choice([1.0, 1.5, 2.0]) / cell_m / 2)
    low = (size - extent) // 2
    high = low + extent
    occupied, n_passages = np.ones((size, size), bool), int(rng.integers(3, 5))
    occupied[low[1] : high[1], low[0] : high[0]] = False
    for side in rng.permutation(4)[:n_passages]:
        axis, upper = side % 2, side > 1  # the wall lies across this axis
        along = int(rng.uniform(low[1 - axis] + 1.5 / cell_m, high[1 - axis] - 1.5 / cell_m))
        deep = int(rng.uniform(3, 12) / cell_m)
        span = slice(high[axis], high[axis] + deep) if upper else slice(low[axis] - deep, low[axis])
        door = slice(along - half, along + half)
        occupied[(door, span) if axis == 0 else (span, door)] = False
    return World(occupied=occupied, cell_m=cell_m, name=f"hall {seed}")


def halls(runs, seed=0):
    """Run in drawn halls that are wider than a place, a fiftieth of `runs` halls, two starts each.

    A passage is searched if a node of the map lies within a metre of its far end, a dead end of the true map.
    """
    n = max(1, runs // 50)
    head("halls", "runs", "EXHAUSTED", "passages searched", "false divergences", "took a place for another")
    for low_m, high_m in ((10, 14), (14, 20)):
        tables, searched, passages = [], 0, 0
        for number in range(seed * n, (seed + 1) * n):
            world = drawn_hall(number, low_m, high_m)
            found = traced(world, starts=2, seed=number, noise=Noise(range_m=0.01))
            tables.append(found.table)
            true = found.plan.truth.map
            ends = [node for node in true.nodes if len(true.bearings_deg(node.id)) == 1]
            nodes = [np.array([(node.x_m, node.y_m) for node in found.maps[i].nodes]) for i in (0, 1)]
            near = [np.hypot(*(at - (end.x_m, end.y_m)).T).min() < 1 for at in nodes for end in ends]
            searched, passages = searched + sum(near), passages + len(near)
        table = pd.concat(tables)
        done = share(int((table["outcome"] == "EXHAUSTED").sum()), len(table))
        mistaken = share(int((table["mistaken"] > 0).sum()), len(table))
        false = part(table, "false_divergences", "divergences")
        row(f"{low_m} to {high_m} m", len(table), done, share(searched, passages), false, mistaken)


def part(table, some, all_):
    """A share of sums, in percent; a dash where there is nothing."""
    return f"{100 * table[some].sum() / table[all_].sum():.1f} %" if table[all_].sum() else "–"


def sensors(runs):
    """Errors of the sensors one by one and together, and how high the scanner that looks ahead is mounted."""
    worlds = "course", "course#1", "course#7"
    head("error", "runs of each", *worlds, "of all")

    def told(name, each, robot, noise):
        tables = [traced(world, runs=each, robot=robot, noise=noise).table for world in worlds]
        true = [int(table["true"].sum()) for table in tables]
        row(name, each, *(share(n, each) for n in true), share(sum(true), len(worlds) * each))

    for name, change in ERRORS.items():
        noise = dataclasses.replace(Noise(range_m=0.01), **change)
        told(name, max(8, runs // 25) * MORE_RUNS.get(name, 1), "kamui", noise)
    for height in (0.35, 0.70):
        robot = f"kamui:scan_height_m={height}"
        told(f"scanner {height:.2f} m above the ground", max(8, runs // 25), robot, Noise(range_m=0.01))


def steps(runs):
    """Stairs, single steps, sills and a cross slope: what they are taken for, and how high."""
    each = max(8, runs // 25)
    head("obstacle", "range noise m", "runs", "typed as stairs", "the true map", "height m, 5 to 95 %", "steps refused")
    risers = {"stairs": (0.03, 0.05, 0.06, 0.10, 0.15, 0.20), "platform": (0.06, 0.15), "sill": (0.06, 0.12, 0.18)}
    obstacles = [f"{name},riser_m={riser}" for name, some in risers.items() for riser in some] + ["cross-slope"]
    for obstacle in obstacles:
        for sigma in (0.01, 0.03):
            found = traced(f"course:obstacle={obstacle}", runs=each, noise=Noise(range_m=sigma))
            nodes = [node for i in range(each) for node in found.maps[i].nodes if node.type == "obstacle"]
            typed = share(sum(node.obstacle == "stairs" for node in nodes), len(nodes)) if nodes else "–"
            heights = [node.step_m for node in nodes if node.step_m is not None]
            span = "{:.3f} to {:.3f}".format(*np.percentile(heights, [5, 95])) if heights else "–"
            right = share(int(found.table["true"].sum()), each)
            row(obstacle, sigma, each, typed, right, span, found.table["refused"].sum())


def loops(runs, first=21):
    """Ways round, equal junctions, encoders that are 5 % long: true maps, places that the robot took for others, how
    far places of true maps lie off, as written and corrected, root mean squares. Twenty courses each.
    """
    each, fresh = max(2, runs // 50), range(first, first + 20)
    which = f"#{fresh[0]} to #{fresh[-1]}"
    kinds = {
        "encoders 5 % long, #1 to #20": ([f"course#{seed}" for seed in range(1, 21)], 1.05),
        **{
            f"{n} way{'s' * (n > 1)} round, {which}": ([f"course#{seed}:loops={n}" for seed in fresh], 1.0)
            for n in (1, 2, 3)
        },
        "2 ways round, encoders 2 % long": ([f"course#{seed}:loops=2" for seed in fresh], 1.02),
        f"4 equal junctions, {which}": ([f"course#{seed}:repeat=4" for seed in fresh], 1.0),
        "4 equal junctions, encoders 2 % long": ([f"course#{seed}:repeat=4" for seed in fresh], 1.02),
    }
    head("courses", "runs", "true", "took a place for another", "outcomes", "off m", "corrected m")
    for kind, (worlds, scale) in kinds.items():
        noise, tables, off = Noise(range_m=0.01, length_scale=scale, turn_scale=scale), [], []
        for world in worlds:
            found = traced(world, runs=each, noise=noise)
            tables.append(found.table)
            right = [found.maps[i] for i in np.flatnonzero(found.table["true"])]
            off += [(off_m(m, found.truth), off_m(correct_map(m), found.truth)) for m in right]
        table = pd.concat(tables)
        right, n = table["true"].astype(bool), len(table)
        counts = (right, table["mistaken"] > 0)
        outcomes = ", ".join(f"{name} {count}" for name, count in table["outcome"].value_counts().items())
        row(kind, n, *(share(int(c.sum()), n) for c in counts), outcomes, *(f"{m:.2f}" for m in np.mean(off, axis=0)))


def off_m(found: BtmMap, true: BtmMap):
    """Compute the distance of nodes from the nearest true one of their type, root mean square."""
    off = [
        min(np.hypot(node.x_m - o.x_m, node.y_m - o.y_m) for o in true.nodes if o.type == node.type)
        for node in found.nodes
    ]
    return float(np.sqrt(np.mean(np.square(off))))


def furniture(runs):
    """Other courses than that of the paper: plain, furnished, and of other widths."""
    head("courses", "runs", "the true map", "not always")
    kinds = {
        "course#1 to #30": [f"course#{seed}" for seed in range(1, 31)],
        "furnished #0 to #20": [f"course#{seed}:furniture=true" for seed in range(21)],
        "1.2 to 3.0 m wide": [f"course:width_m={width:g}" for width in (1.2, 1.6, 2.4, 2.8, 3.0)],
    }
    each = max(3, runs // 300)
    for kind, worlds in kinds.items():
        right, missed = 0, []
        for world in worlds:
            table = traced(world, runs=each, noise=Noise(range_m=0.01)).table
            right += int(table["true"].sum())
            missed += [world.partition("#")[2] or world] if not table["true"].all() else []
        row(kind, each * len(worlds), share(right, each * len(worlds)), " ".join(missed) or "–")


def read_off(maps):
    """Nodes that are read off finished plans, plain and furnished."""
    head("plan", "nodes", "furnished", "times")
    ratios = []
    for path in sorted(Path(maps).glob("*_furnitures.png")):
        plans = path.with_name(path.name.replace("_furnitures", "")), path
        worlds = [load_world(f"{plan}@0.05") for plan in plans]
        free = [~world.occupied for world in worlds]
        open_m = for_world(Tuning(), is_course=False).open_m
        n = [len(extract(f, np.ones_like(f), world.cell_m, open_m=open_m).nodes) for f, world in zip(free, worlds)]
        ratios.append(n[1] / n[0])
        row(plans[0].stem, *n, f"{ratios[-1]:.2f}")
    row("mean", "", "", f"{np.mean(ratios):.2f}")


def speed(runs):
    head("runs", "noise m", "runs/s", "steps a run", "us a step and core", "compiling s")
    found = traced("course", runs=runs, noise=Noise(range_m=0.01))
    steps, rate = found.table["steps"].mean(), runs / found.costs.run_s
    each = f"{1e6 * WORKERS / rate / steps:.0f}"
    row(runs, 0.01, f"{rate:.1f}", f"{steps:.0f}", each, f"{found.costs.compile_s:.1f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--parts", nargs="*", default=PARTS, choices=(*PARTS, "read-off"))
    parser.add_argument("--seed", type=int, default=0, help="of the starts in buildings and their noise, and of halls")
    parser.add_argument("--worlds", nargs="+", default=BUILDINGS, help="of buildings")
    parser.add_argument("--perception", default="auto", help="in buildings")
    parser.add_argument("--starts", type=int, help="in a building")
    parser.add_argument("--first", type=int, default=21, help="course of loops and equal junctions, of twenty")
    parser.add_argument("--maps", help="folder with the plans of read-off")
    options = parser.parse_args()
    start_backend(WORKERS)
    use_compilation_cache()
    given = {
        "buildings": functools.partial(
            buildings, options.runs, options.seed, options.worlds, options.perception, options.starts
        ),
        "halls": functools.partial(halls, options.runs, options.seed),
        "loops": functools.partial(loops, options.runs, options.first),
        "read-off": functools.partial(read_off, options.maps),
    }
    if "read-off" in options.parts and options.maps is None:
        parser.error("read-off needs --maps")
    for part in options.parts:
        print(f"\n## {part}")
        given.get(part, lambda part=part: globals()[part](options.runs))()


if __name__ == "__main__":
    main()
