"""Kernels one by one, on one core, on what an episode showed them; each beside another answer to the same question.

    python benchmarks/kernels.py --out kernels.json

See README.md in this folder for the columns.
"""

import argparse
import math
import statistics
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import oracles
from jax import lax
from jax.experimental.compilation_cache import compilation_cache
from scipy import ndimage
from timing import (
    at_least_one,
    check_out,
    finish,
    guarded,
    interleaved,
    markdown,
    one_core,
    ratio,
    spread,
    surroundings,
    timed,
)

from jexplore import batch, bits, navigate, replay
from jexplore.distance import nearest_site
from jexplore.frontier import frontier_clusters, plan_masks
from jexplore.grid import empty_grid
from jexplore.raycast import fold, scan
from jexplore.reach import FAR, NO_MOTION, reach
from jexplore.world import World, clear_cells, draw_start
from jexplore.worlds import load_world

CALL_S = 0.02  # seconds that one timed call should last
PLAN_PASSES = 10  # plans from the same belief in one timed call
CLUSTERS = 256  # slots
NEVER = 123_456_789  # a value that no result holds, which the compiler cannot know
TARGETS_US = {"scan and fold": 60.0, "plan": 250.0}


class Kernel(NamedTuple):
    """A kernel on one input, and the answer that it is compared with."""

    name: str
    on: str  # what it works on
    step: Any  # (never, i, last output, arguments) -> output; `never` is False, in a way the compiler cannot tell
    start: Any  # pytree like the output
    arguments: Any  # pytree of arrays
    units: int  # calls in a row that make up one measured pass
    reference: str  # what the other answer is
    other: Any  # function of no arguments: the other answer, for `units` calls
    native: bool  # whether the other answer is worth timing
    agree: Any  # (output, other answer) -> bool
    note: Any = None  # function of the other answer: a dict to be added to the report


@jax.jit
def _never(out):
    """False, but only known when the output is."""
    return jax.tree.leaves(out)[0].reshape(-1)[-1] == NEVER


def looped(step):
    """The kernel in a loop inside a program, so that calling it is not measured: `f(passes, units, out, arguments)`."""

    def run(passes, units, out, arguments):
        def body(i, out):
            return step(_never(out), i % units, out, arguments)

        return lax.fori_loop(0, passes * units, body, out)

    return jax.jit(run)


def blank(step, arguments):
    """Zeros like the kernel's output."""
    like = jax.eval_shape(lambda a: step(False, 0, None, a), arguments)
    return jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), like)


def measure(kernel, repeat):
    """Times one kernel: a dict for the report."""
    start, arguments = jax.device_put((kernel.start, kernel.arguments))
    program = looped(kernel.step)
    units = np.int32(kernel.units)
    compiled, compiling = timed(lambda: program.lower(np.int32(1), units, start, arguments).compile())

    def ours(passes=1):
        return jax.block_until_ready(compiled(np.int32(passes), units, start, arguments))

    answer, expected = ours(), kernel.other()
    equal = bool(kernel.agree(jax.tree.map(np.asarray, answer), expected))
    _, once = timed(ours)
    passes = max(1, math.ceil(CALL_S / max(once.wall, 1e-6)))
    tasks = {"ours": lambda: ours(passes)}
    if kernel.native:
        tasks["reference"] = kernel.other
    runs = interleaved(tasks, repeat)
    calls = {"ours": passes * kernel.units, "reference": kernel.units}
    wall = {name: [1e6 * took.wall / calls[name] for _, took in turns] for name, turns in runs.items()}
    cpu = {name: [1e6 * took.cpu / calls[name] for _, took in turns] for name, turns in runs.items()}
    return {
        "kernel": kernel.name,
        "on": kernel.on,
        "reference": kernel.reference,
        "compile_s": compiling.wall,
        "us": spread(wall["ours"]),
        "cpu_us": spread(cpu["ours"]),
        "reference_us": spread(wall["reference"]) if kernel.native else None,
        "reference_cpu_us": spread(cpu["reference"]) if kernel.native else None,
        "ratio": ratio(cpu["ours"], cpu["reference"]) if kernel.native else None,
        "target_us": TARGETS_US.get(kernel.name),
        "equal": equal,
        **(kernel.note(expected) if kernel.note else {}),
    }


class Recording(NamedTuple):
    """What an episode met."""

    name: str
    episode: Any  # `replay.Episode`
    site: Any  # `batch.Prepared`
    poses: np.ndarray  # [n, 3] int32, row, col, heading (units of 45 degrees) of every scan
    beliefs: list  # `navigate.Belief` at every plan, the last one, that found nothing, included
    targets: list  # (row, col) chosen there; None for the last


def record(name):
    """Runs one episode of closest+recheck and keeps its scans, and its belief at every plan."""
    episode = replay.explore(name, "closest+recheck")
    site = batch.prepare(episode.world, episode.lidar, episode.rules)
    final, first = episode.final, episode.start[2] // 45
    poses, beliefs, targets = [], [], []
    headings = replay.headings_of(final, first)
    last = len(headings) - 1
    for step, _, belief, _ in replay._states(episode):
        row, col = int(final.rows[step]), int(final.cols[step])
        all_round = [first + 8 // site.first_scans * k for k in range(site.first_scans)]
        turns = all_round if step == 0 else [headings[step]]
        turns = turns + [headings[step] + 2 * k for k in range(1, int(final.looked[step]) + 1)]
        poses += [(row, col, turn % 8) for turn in turns]
        now = int(final.target_rows[step]), int(final.target_cols[step])
        following = None if step == last else (int(final.target_rows[step + 1]), int(final.target_cols[step + 1]))
        if step == 0 or following != now:
            beliefs.append(belief)
            targets.append(following)
    return Recording(name, episode, site, np.array(poses, np.int32), beliefs, targets)


def scans(recording):
    """Ranges, and scan with update, along an episode's whole way."""
    truth, beams = recording.site.truth.occupied, recording.site.beams
    arguments = (truth, beams, recording.poses)
    offset, length, occupied = (np.asarray(a) for a in (beams.offset, beams.length, truth))
    row, col, heading = recording.poses.T.copy()
    n, width = len(recording.poses), occupied.shape[1]

    def other(update):
        hits, misses = np.zeros((2, occupied.size), np.int32)
        end, visited = oracles.walk(
            occupied.reshape(-1), offset, length, row * width + col, heading, hits, misses, update
        )
        return end, hits.reshape(occupied.shape), misses.reshape(occupied.shape), visited

    def ranges(_, i, ends, arguments):
        truth, beams, poses = arguments
        row, col, heading = poses[i]
        return lax.dynamic_update_slice(ends, scan(truth, row, col, heading, beams).end[None], (i, jnp.int32(0)))

    def update(_, i, grid, arguments):
        truth, beams, poses = arguments
        row, col, heading = poses[i]
        return fold(grid, row, col, heading, scan(truth, row, col, heading, beams), beams)

    def same_map(grid, expected):
        height, width = recording.episode.world.shape
        episode = recording.episode.final.hits, recording.episode.final.misses
        return all(
            np.array_equal(ours, theirs) and np.array_equal(ours[:height, :width], seen)
            for ours, theirs, seen in zip((grid.hits, grid.misses), expected[1:3], episode)
        )

    def visited(expected):
        return {"cells_visited": expected[3] / n}

    shared = {
        "on": f"{recording.name}, {n} scans", "arguments": arguments, "units": n,
        "reference": "cell by cell, numba", "native": oracles.NATIVE, "note": visited,
    }  # fmt: skip
    ends = np.zeros((n, length.shape[1]), np.int32)
    return [
        Kernel("scan", step=ranges, start=ends, other=lambda: other(False),
               agree=lambda ends, expected: np.array_equal(ends, expected[0]), **shared),
        Kernel("scan and fold", step=update, start=jax.tree.map(np.asarray, empty_grid(occupied.shape)),
               other=lambda: other(True), agree=same_map, **shared),
    ]  # fmt: skip


def _inside(belief):
    shape = belief.driven.shape
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    return (rows < int(belief.extent[0])) & (cols < int(belief.extent[1]))


def _oracle_masks(belief):
    return oracles.masks(
        np.asarray(belief.grid.hits), np.asarray(belief.grid.misses), np.asarray(belief.driven),
        np.asarray(belief.exhausted), _inside(belief), int(belief.row), int(belief.col),
        p_free=float(belief.p_free), near_d2=int(belief.near_d2), clearance_d2=belief.clearance_d2,
    )  # fmt: skip


def mask_kernel(recording):
    """Traversable and frontier cells of a whole map, half-way through an episode."""
    belief = recording.beliefs[len(recording.beliefs) // 2]

    def step(never, _, out, arguments):
        belief, inside = arguments
        return plan_masks(
            belief.grid, belief.driven, belief.exhausted, inside, belief.row + never, belief.col,
            p_free=belief.p_free, near_d2=belief.near_d2, clearance_d2=belief.clearance_d2,
        )  # fmt: skip

    def agree(out, expected):
        height = belief.driven.shape[0]
        return all(np.array_equal(bits.unpack(ours, height), theirs) for ours, theirs in zip(out, expected))

    arguments = (belief, _inside(belief))
    start = jax.tree.map(
        lambda x: np.zeros(x.shape, x.dtype), jax.eval_shape(lambda a: step(False, 0, 0, a), arguments)
    )
    height, width = belief.driven.shape
    return Kernel(
        "masks", f"{recording.name}, {height} x {width}", step, start, arguments, 1, "scipy.ndimage",
        lambda: _oracle_masks(belief), True, agree,
    )  # fmt: skip


def cluster_kernel(recording):
    """Groups of frontier cells, half-way through an episode."""
    belief = recording.beliefs[len(recording.beliefs) // 2]
    frontier = _oracle_masks(belief)[1]

    def step(never, _, out, frontier):
        return frontier_clusters(frontier.at[0, 0].set(never), max_clusters=CLUSTERS)

    def agree(out, expected):
        labels, sizes = expected
        count = len(sizes)
        fits = int(out.count) == count and int(out.overflow) == 0
        return fits and np.array_equal(out.label, labels) and np.array_equal(out.size[:count], sizes)

    start = blank(step, jnp.asarray(frontier))
    height, width = frontier.shape
    return Kernel(
        "clusters", f"{recording.name}, {height} x {width}", step, start, frontier, 1, "scipy.ndimage",
        lambda: oracles.clusters(frontier), True, agree,
    )  # fmt: skip


def reach_kernel(world):
    """The whole reachability map of a world's clear cells."""
    row, col, _ = draw_start(world, 0, 0, 0.3)
    clear = clear_cells(world.occupied, 0.3, world.cell_m)
    nothing = np.zeros_like(clear)

    def step(never, _, out, arguments):
        clear, row, col = arguments
        return reach(clear.at[0, 0].set(never), row, col)

    height, width = clear.shape
    return Kernel(
        "reachability map", f"{world.name.partition(':')[0]}, {height} x {width}", step,
        np.zeros(clear.shape, np.int32), (clear, np.int32(row), np.int32(col)), 1, "Dijkstra with a heap, numba",
        lambda: oracles.dijkstra(clear, row, col, nothing, False)[0], oracles.NATIVE, np.array_equal,
    )  # fmt: skip


def site_kernel(world):
    """Distance to the nearest wall, and which cell that is."""
    walls = world.occupied

    def step(never, _, out, walls):
        return nearest_site(walls.at[0, 0].set(~never))

    def agree(out, expected):
        d2, site = out
        rows, cols = np.indices(walls.shape)
        at = np.divmod(site, walls.shape[1])
        own = (at[0] - rows) ** 2 + (at[1] - cols) ** 2
        return np.array_equal(d2, np.rint(expected[0] ** 2)) and walls[at].all() and np.array_equal(own, d2)

    height, width = walls.shape
    start = (np.zeros(walls.shape, np.int32), np.zeros(walls.shape, np.int32))
    return Kernel(
        "nearest site", f"{world.name.partition(':')[0]}, {height} x {width}", step, start, walls, 1, "scipy.ndimage",
        lambda: ndimage.distance_transform_edt(~walls, return_indices=True), True, agree,
    )  # fmt: skip


@jax.jit
def _plans(passes, belief, route):
    """`passes` plans from the same belief."""

    def body(_, state):
        choice, route = state
        never = choice.cost == NEVER
        return navigate.nearest_frontier(belief.replace(row=belief.row + never), route)

    zero = jnp.int32(0)
    return lax.fori_loop(0, passes, body, (navigate.Choice(zero, zero, zero, zero), route))


def _decider(belief, route):
    """The window that settles a plan: its side, or "whole map"."""
    for side, swept in ((navigate.WAVE, False), (navigate.SWEEP, True)):
        if side < max(route.shape) and not bool(_undecided(belief, route, side=side, swept=swept)):
            return str(side)
    return "whole map"


@jax.jit(static_argnames=("side", "swept"))
def _undecided(belief, route, *, side, swept):
    return navigate._nearest_in_window(belief, route, side, swept)[0]


def measure_plans(recording, repeat):
    """Times every plan of an episode: a dict for the report."""
    shape = recording.beliefs[0].driven.shape
    route = jnp.full(shape, NO_MOTION, jnp.int8)
    compiled, compiling = timed(lambda: _plans.lower(np.int32(1), recording.beliefs[0], route).compile())
    found = [jax.tree.map(int, compiled(np.int32(1), belief, route)[0]) for belief in recording.beliefs]
    deciders = [_decider(belief, route) for belief in recording.beliefs]
    judged = [_oracle_masks(belief) for belief in recording.beliefs]
    places = [(int(belief.row), int(belief.col)) for belief in recording.beliefs]

    def other():
        return [oracles.dijkstra(mask, *at, goals, True) for (mask, goals), at in zip(judged, places)]

    def wanted(cost, target):
        at = divmod(int(target), shape[1]) if target >= 0 else (-1, -1)
        return (*at, int(cost[at]) if target >= 0 else FAR)

    equal = all(
        (choice.row, choice.col, choice.cost) == wanted(*theirs)
        and (choice.row, choice.col) == (own if own is not None else (-1, -1))
        for choice, theirs, own in zip(found, other(), recording.targets)
    )
    passes = np.int32(PLAN_PASSES)

    def ours():
        return [
            timed(lambda belief=belief: jax.block_until_ready(compiled(passes, belief, route)))[1]
            for belief in recording.beliefs
        ]

    runs = interleaved({"ours": ours, "reference": other}, repeat)
    times = [turn for turn, _ in runs["ours"]]  # of every turn: of every plan
    others = [took for _, took in runs["reference"]]
    n = len(recording.beliefs)
    by_plan = np.array([[1e6 * took.cpu / passes for took in turn] for turn in times])  # [repeat, plans]
    by_clock = np.array([[1e6 * took.wall / passes for took in turn] for turn in times])
    windows = {}
    for name in dict.fromkeys([str(navigate.WAVE), str(navigate.SWEEP), "whole map"]):
        of = [i for i, decider in enumerate(deciders) if decider == name]
        windows[name] = {
            "share": len(of) / n,
            "us": statistics.median(np.median(by_plan, axis=0)[of].tolist()) if of else None,
        }
    theirs = [1e6 * took.cpu / n for took in others]
    return {
        "kernel": "plan",
        "on": f"{recording.name}, {n} plans",
        "reference": "masks given, heap Dijkstra up to the first frontier, numba",
        "compile_s": compiling.wall,
        "us": spread(by_clock.mean(axis=1).tolist()),
        "cpu_us": spread(by_plan.mean(axis=1).tolist()),
        "reference_us": spread([1e6 * took.wall / n for took in others]) if oracles.NATIVE else None,
        "reference_cpu_us": spread(theirs) if oracles.NATIVE else None,
        "ratio": ratio(by_plan.mean(axis=1).tolist(), theirs) if oracles.NATIVE else None,
        "target_us": TARGETS_US["plan"],
        "equal": equal,
        "windows": windows,
    }


def table(report):
    """The report as Markdown."""
    rows = [
        [
            k["kernel"], k["on"], k["compile_s"], k["cpu_us"]["median"], k["cpu_us"]["min"], k["us"]["median"],
            k["target_us"], k["reference_cpu_us"] and k["reference_cpu_us"]["median"], k["ratio"], k["reference"],
            "yes" if k["equal"] else "NO",
        ]
        for k in report["kernels"]
    ]  # fmt: skip
    header = [
        "kernel", "on", "compile s", "CPU µs", "least", "µs by the clock", "target µs", "reference CPU µs", "ratio",
        "reference", "equal",
    ]  # fmt: skip
    parts = [markdown(header, rows)]
    for k in report["kernels"]:
        if "windows" in k:
            rows = [[name, f"{100 * w['share']:.0f} %", w["us"]] for name, w in k["windows"].items()]
            parts.append(f"Plans on {k['on']}:\n\n" + markdown(["decided by", "share", "CPU µs (median)"], rows))
    return "\n\n".join(parts)


def parse():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", default="cave", help="where the episode is recorded; as for jexplore explore")
    parser.add_argument(
        "--maps", nargs="+", help="worlds for the whole-map kernels; default: a cave and an office of 256 x 256 cells",
        default=[f"{name}:width_m=25.6,height_m=25.6" for name in ("cave", "office")],
    )  # fmt: skip
    parser.add_argument("--repeat", type=at_least_one, default=7, help="turns of ours and the reference")
    parser.add_argument("--out", type=Path, help="JSON file")
    return parser.parse_args()


def main():
    args = parse()
    check_out(args.out)
    maps: list[World] = [load_world(name) for name in args.maps]
    load_world(args.world)
    batch.start_backend(1)
    report = {"environment": surroundings(), "repeat": args.repeat}
    if not oracles.NATIVE:
        print("Without numba (extra bench) its references are checked, but not timed.", file=sys.stderr)
    recording = record(args.world)
    # Recording reads and keeps compiled programs; from here on compiling means compiling.
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    kernels = [*scans(recording), mask_kernel(recording), cluster_kernel(recording)]
    kernels += [kernel(world) for world in maps for kernel in (reach_kernel, site_kernel)]
    with one_core() as report["pinned"]:
        report["kernels"] = [measure(kernel, args.repeat) for kernel in kernels]
        report["kernels"].insert(2, measure_plans(recording, args.repeat))
    print(table(report))
    finish(report, args.out)


if __name__ == "__main__":
    guarded(main)
