"""Measure how often maps without a common frame are merged right: drifting parts of true maps of courses.

    python benchmarks/merging.py [--pairs 400] [--first 0] [--part overlap | apart | alike | driven | all]

Every part is grown along links from a start of its own, in the middle of a link or at a terminal node, to 30 to 100 %
of the links, has a frame of its own and an odometry that is wrong: lengths by one factor of 0.95 to 1.05, the heading
by a walk of 2 degrees a root metre, places by 0.05 m, bearings by 2 degrees, widths by 0.05 m. Thresholds were chosen
on courses #1000 and above.
"""

import argparse
import collections
import dataclasses
import itertools
import math
import random
import sys
import time
from pathlib import Path

from jexplore.report.tables import aligned_table
from jexplore.report.trace_tables import share
from jexplore.tracemap.merging.match import Merging
from jexplore.tracemap.merging.merge import merge_maps
from jexplore.tracemap.merging.rigid import apart_deg
from jexplore.tracemap.record import NOWHERE, STATUS, BtmMap, Link, Node
from jexplore.worlds import load_world

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from ref.parts import common, part_of

HEAD = ["pairs", "n", "right", "incomplete", "wrong", "refused", "of answers right"]
NEAR_M = 1.0  # starts of two maps so near to each other may be taken for one


def judged(one, other, merged):
    """`right`, `incomplete`, `wrong`, or how it was refused."""
    if merged.outcome is not Merging.MERGED:
        return merged.outcome.value
    back = {node: key for key, node in merged.nodes["1"].items()}
    pairs = {(a, back[node]) for a, node in merged.nodes["0"].items() if node in back}
    for a, b in pairs:
        if (a in one.true or b in other.true) and one.true.get(a) != other.true.get(b):
            near = one.map.nodes[a].type == "terminal" and math.dist(one.place[a], other.place[b]) < NEAR_M
            if not near:
                return "wrong"
        elif math.dist(one.place[a], other.place[b]) > NEAR_M:
            return "wrong"
    return "right" if {one.true.get(a) for a, _ in pairs} >= common(one, other) else "incomplete"


def truth_of(seed):
    """The true map of a course."""
    course = load_world(f"course#{seed}").course
    assert course is not None
    return course.topology


def overlapping(seed):
    """Two parts of one course that share at least three nodes."""
    rng, truth = random.Random(seed), truth_of(seed)
    while True:
        one, other = part_of(truth, rng), part_of(truth, rng)
        if len(common(one, other)) >= 3:
            return one, other


def apart(seed):
    """Parts of two courses, or of one that share nothing."""
    rng = random.Random(seed)
    truths = [truth_of(number) for number in (seed, seed + 1 if seed % 2 else seed)]
    for _ in range(10_000):
        one, other = part_of(truths[0], rng, least=0.15), part_of(truths[1], rng, least=0.15)
        if seed % 2 or not set(one.true.values()) & set(other.true.values()):
            if seed % 2:
                other = dataclasses.replace(other, true={a: -1 - b for a, b in other.true.items()},
                                            place={a: (x + 1e6, y) for a, (x, y) in other.place.items()})  # fmt: skip
            return one, other
    raise ValueError(f"course#{seed} has no two parts that share nothing")


def alike(seed):
    """Parts of a corridor with equal openings at equal distances; every fourth has a crossing in the middle."""
    rng = random.Random(seed)
    n = rng.randint(6, 14)
    gap = rng.uniform(3, 8)
    nodes = [Node(i, gap * i, 0.0, "divergence") for i in range(n)]
    links = [Link(i, i, i + 1, STATUS[True], 0.0, 180.0, gap, 2.0, opening_m=2.0) for i in range(n - 1)]
    ways = [(0, 180.0), (n - 1, 0.0), *((i, 90.0) for i in range(n))]
    links += [
        Link(n - 1 + i, at, NOWHERE, STATUS[False], bearing, opening_m=2.0) for i, (at, bearing) in enumerate(ways)
    ]
    if seed % 4 == 0:
        links.append(Link(len(links), n // 2, NOWHERE, STATUS[False], 270.0, opening_m=2.0))
    truth = BtmMap(tuple(nodes), tuple(links))
    while True:
        one, other = part_of(truth, rng), part_of(truth, rng)
        if len(common(one, other)) >= 3:
            return one, other


def driven(worlds, runs, errors=(1.0, 5.0)):
    """Maps that robots wrote in buildings, a start each, all pairs: rows of the table. Their true frames are one."""
    from jexplore.driving.settings import Noise
    from jexplore.studies.traces.tracing import trace

    for world in worlds:
        ran = trace(world, runs=runs, starts=runs, noise=Noise(range_m=0.01))
        maps = list(ran.maps.values())
        counts = collections.Counter()
        for one, other in itertools.combinations(maps, 2):
            merged = merge_maps([one, other])
            move, middle = merged.moves.get("1"), other.nodes[0]
            if merged.outcome is not Merging.MERGED or move is None:
                counts[merged.outcome.value] += 1
                continue
            off = math.dist(move.place(middle.x_m, middle.y_m), (middle.x_m, middle.y_m))
            is_right = off < errors[0] and abs(apart_deg(move.turn_deg, 0.0)) < errors[1]
            counts["right" if is_right else "wrong"] += 1
        yield _row(f"driven, {world}", counts)


PARTS = {"overlap": overlapping, "apart": apart, "alike": alike}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=400)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--part", choices=[*PARTS, "driven", "all"], default="all")
    parser.add_argument("--worlds", nargs="+", help="of --part driven")
    parser.add_argument("--runs", type=int, default=5, help="of --part driven, in each world")
    given = parser.parse_args()
    rows, spent = [], []
    if given.part == "driven":
        print(aligned_table(HEAD, driven(given.worlds or ["rooms", "rooms#1"], given.runs), left=HEAD[:1]))
        return
    for name in PARTS if given.part == "all" else [given.part]:
        counts, groups = collections.Counter(), collections.defaultdict(collections.Counter)
        for seed in range(given.first, given.first + given.pairs):
            one, other = PARTS[name](seed)
            began = time.perf_counter()
            merged = merge_maps([one.map, other.map])
            spent.append(time.perf_counter() - began)
            verdict = judged(one, other, merged)
            counts[verdict] += 1
            groups[_group(name, one, other)][verdict] += 1
        rows.append(_row(name, counts))
        rows += [_row(f"{name}, {key}", groups[key]) for key in sorted(groups) if key]
    print(aligned_table(HEAD, rows, left=HEAD[:1]))
    print(f"{1000 * sum(spent) / len(spent):.0f} ms a pair, {1000 * max(spent):.0f} at most")


def _group(name, one, other):
    """Return the key of a kind of pairs in the rows."""
    n = len(common(one, other))
    if name == "overlap":
        return "3 or 4 nodes in common" if n < 5 else "5 or 6" if n < 7 else "7 and more"
    if name == "alike":
        marked = all(any(len(part.map.bearings_deg(key)) == 4 for key in part.true) for part in (one, other))
        return "both have the crossing" if marked else "not both"
    return ""


def _row(name, counts):
    n, merged = sum(counts.values()), counts["right"] + counts["incomplete"] + counts["wrong"]
    refused = ", ".join(f"{counts[one.value]} {one.value}" for one in list(Merging)[1:])
    shares = [share(counts[key], n) for key in ("right", "incomplete", "wrong")]
    return [name, str(n), *shares, refused, share(counts["right"], merged) if merged else "-"]


if __name__ == "__main__":
    main()
