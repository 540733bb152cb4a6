"""Time kernels in JAX on one core, and other libraries' answers to the same questions, which must be equal.

    taskset -c 0 python benchmarks/kernels.py
    taskset -c 0 python benchmarks/kernels.py --world 'office:width_m=25.6,height_m=25.6' --repeat 9

`scan and fold` is timed on 256 scans from drawn places and counted into one map; all others work on the whole map, of
which half is known where that matters. A kernel runs in a loop within one compiled program, and what it works on is
varied in every round by nothing in fact, so that no part of the work leaves the loop.
"""

import argparse
import math
import statistics
import sys

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from jexplore.arrays import bits
from jexplore.bench import LIDAR, RULES, SEED
from jexplore.bench.tables import markdown
from jexplore.bench.timing import interleaved, timed
from jexplore.distance import nearest_offset
from jexplore.engine.backend import start_backend
from jexplore.exploration.site import prepare_site
from jexplore.frontier import frontier_clusters, plan_masks
from jexplore.grid import Grid, empty_grid, radius_d2
from jexplore.raycast import fold, scan
from jexplore.reach import FAR, flood, reach
from jexplore.worlds import load_world
from jexplore.worlds.starts import clear_of_walls, draw_starts
from jexplore.worlds.world import with_ring

CALL_S = 0.02  # seconds that one timed call should last
SCANS, CLUSTERS = 256, 256
STRAIGHT, DIAGONAL = 2**16, 92682  # cost of a step
NEVER = 123_456_789  # a value that no result holds, which the compiler cannot know
SQUARE = np.ones((3, 3), int)


def walk(occupied, offset, length, cells, headings):
    """Count scans into a map by numpy, all beams of a scan at once, along the beam table: hits and misses."""
    hits, misses = np.zeros((2, occupied.size), np.int32)
    steps = np.arange(offset.shape[1])[:, None]
    for here, k in zip(cells, headings):
        at = np.clip(here + offset[k], 0, occupied.size - 1)
        blocked = occupied[at] & (steps < length[k])
        end = np.where(blocked.any(axis=0), blocked.argmax(axis=0), length[k])
        hits += np.bincount(at[(steps == end) & blocked], minlength=occupied.size).astype(np.int32)
        misses += np.bincount(at[steps < end], minlength=occupied.size).astype(np.int32)
        misses[here] += 1
    return hits, misses


def scans_of(world):
    """Return the kernel of scanning and counting."""
    site = prepare_site(world, LIDAR, RULES)
    truth, beams = site.truth.occupied, site.beams
    poses = np.array(draw_starts(world, SEED, SCANS, RULES.clearance_m), np.int32) // np.array([1, 1, 45], np.int32)
    occupied, offset, length = (np.asarray(a) for a in (truth, beams.offset, beams.length))

    def step(grid, arguments):
        truth, beams, poses = arguments
        return lax.fori_loop(
            0, SCANS, lambda i, grid: fold(grid, *poses[i], scan(truth, *poses[i], beams), beams), grid
        )

    def answer():
        cells = poses[:, 0] * occupied.shape[1] + poses[:, 1]
        counts = walk(occupied.reshape(-1), offset, length, cells, poses[:, 2])
        return tuple(a.reshape(occupied.shape) for a in counts)

    start = jax.tree.map(np.asarray, empty_grid(occupied.shape))
    return step, start, (truth, beams, poses), answer, lambda grid: (grid.hits, grid.misses)


def half_known(world):
    """Return a world known within half its longer side round a drawn start: arguments of `plan_masks`."""
    ((row, col, _),) = draw_starts(world, SEED, 1, RULES.clearance_m)
    rows, cols = np.indices(world.shape)
    known = (rows - row) ** 2 + (cols - col) ** 2 <= (max(world.shape) // 2) ** 2
    hits, misses = (np.where(known & mask, 3, 0).astype(np.int32) for mask in (world.occupied, ~world.occupied))
    driven, nothing = np.zeros((2, *world.shape), bool)
    driven[row, col] = True
    return hits, misses, driven, nothing, ~nothing, np.int32(row), np.int32(col)


def masks(hits, misses, driven, exhausted, inside, row, col, *, p_free, near_d2, clearance_d2):
    """Compute traversable and frontier cells by scipy, arguments as for `frontier.plan_masks`."""
    seen = hits + misses
    occupied = (seen > 0) & (hits.astype(np.float32) > np.float32(p_free) * seen.astype(np.float32))
    free = (seen > 0) & ~occupied
    clear = free & (np.rint(ndimage.distance_transform_edt(~occupied) ** 2) > clearance_d2)
    rows, cols = np.ogrid[: free.shape[0], : free.shape[1]]
    near = (rows - row) ** 2 + (cols - col) ** 2 <= near_d2
    beside_unknown = ndimage.binary_dilation(inside & (seen == 0), SQUARE)
    return clear | (free & near) | driven, clear & beside_unknown & ~exhausted


def clusters(frontier):
    """Label 8-connected groups by scipy, in the order of their lowest cell; -1: none."""
    labels, n = ndimage.label(frontier, SQUARE)
    first = ndimage.minimum(np.arange(labels.size).reshape(labels.shape), labels, np.arange(1, n + 1))
    return np.concatenate([[-1], np.argsort(np.argsort(first))])[labels]


def motion_graph(traversable):
    """Build the graph of cells and motions with their cost: a scipy sparse matrix."""
    height, width = traversable.shape
    index, ends = np.arange(height * width).reshape(height, width), []
    for drow, dcol, cost in ((0, 1, STRAIGHT), (1, 0, STRAIGHT), (1, 1, DIAGONAL), (1, -1, DIAGONAL)):
        rows, cols = slice(0, height - drow), slice(max(-dcol, 0), width - max(dcol, 0))
        to_rows, to_cols = slice(drow, height), slice(max(dcol, 0), width - max(-dcol, 0))
        possible = traversable[rows, cols] & traversable[to_rows, to_cols]
        if drow and dcol:
            possible &= traversable[rows, to_cols] & traversable[to_rows, cols]
        a, b = index[rows, cols][possible], index[to_rows, to_cols][possible]
        ends.append(np.stack([a, b, np.full(len(a), cost)]))
    a, b, cost = np.concatenate(ends, axis=1)
    graph = sparse.csr_matrix((cost.astype(float), (a, b)), shape=(index.size, index.size))
    return graph + graph.T


def kernels_of(world):
    """Return kernels: name -> `(step, start, arguments, answer, result)`.

    `step(last output, arguments)` returns the output, `result(output)` what must equal `answer()`.
    """
    ((row, col, _),) = draw_starts(world, SEED, 1, RULES.clearance_m)
    clear = clear_of_walls(world.occupied, RULES.clearance_m, world.cell_m)
    graph, words = motion_graph(clear), np.asarray(bits.pack(jnp.asarray(clear)))
    hits, misses, *rest = half_known(world)
    d2 = {f"{name}_d2": radius_d2(getattr(RULES, f"{name}_m"), world.cell_m) for name in ("near", "clearance")}
    rules = {"p_free": RULES.p_free, **d2}
    frontier = masks(hits, misses, *rest, **rules)[1]
    height, at = world.shape[0], (np.int32(row), np.int32(col))

    def costs():
        found = csgraph.dijkstra(graph, indices=row * world.shape[1] + col).reshape(world.shape)
        return np.where(np.isinf(found), FAR, found).astype(np.int32)

    def flooded():
        labels = ndimage.label(clear)[0]  # a diagonal step needs both neighbours: 8 directions lead no further
        return labels == labels[row, col]

    def walls_d2():
        return np.rint(ndimage.distance_transform_edt(~world.occupied) ** 2).astype(np.int32)

    def unpacked(words):
        return bits.unpack(jnp.asarray(words), height)

    found = {
        "masks": (lambda out, a: plan_masks(*a, **rules), (Grid(hits, misses), *rest),
                  lambda: masks(hits, misses, *rest, **rules), lambda out: tuple(map(unpacked, out))),
        "clusters": (lambda out, a: frontier_clusters(a[0], max_clusters=CLUSTERS), (frontier,),
                     lambda: clusters(frontier), lambda out: out.label),
        "reach": (lambda out, a: reach(*a), (clear, *at), costs, lambda out: out),
        "flood": (lambda out, a: flood(*a), (words, *at), flooded, unpacked),
        "nearest site": (lambda out, a: nearest_offset(a[0]), (world.occupied,), walls_d2, lambda out: out[0]),
    }  # fmt: skip

    def blank(step, arguments):
        return jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), jax.eval_shape(lambda a: step(None, a), arguments))

    whole = {name: (step, blank(step, a), a, answer, result) for name, (step, a, answer, result) in found.items()}
    return {"scan and fold": scans_of(world), **whole}


def measure(name, kernel, repeat):
    """Time one kernel in turns with its reference: a row of the table."""
    step, start, arguments, answer, result = kernel

    def run(passes, out, arguments):
        def body(_, state):
            out, arguments = state
            never = jax.tree.leaves(out)[0].reshape(-1)[-1] == NEVER
            leaves, tree = jax.tree.flatten(arguments)
            first = [(0,) * a.ndim for a in leaves]
            leaves = [a.at[i].set(jnp.where(never, jnp.ones((), a.dtype), a[i])) for i, a in zip(first, leaves)]
            arguments = jax.tree.unflatten(tree, leaves)
            return step(out, arguments), arguments

        return lax.fori_loop(0, passes, body, (out, arguments))[0]

    placed = jax.device_put((start, arguments))
    program, compiling = timed(lambda: jax.jit(run).lower(np.int32(1), *placed).compile())

    def ours(passes=1):
        return jax.block_until_ready(program(np.int32(passes), *placed))

    equal = all(map(np.array_equal, jax.tree.leaves(result(ours())), jax.tree.leaves(answer())))
    passes = max(1, math.ceil(CALL_S / timed(ours)[1].wall))
    runs = interleaved({"ours": lambda: ours(passes), "theirs": answer}, repeat)
    units = {"ours": passes, "theirs": 1}
    if name == "scan and fold":
        units = {who: SCANS * n for who, n in units.items()}
    us = {who: [1e6 * took.cpu / units[who] for _, took in turns] for who, turns in runs.items()}
    reference = {"scan and fold": "numpy", "reach": "Dijkstra, scipy (graph given)"}.get(name, "scipy.ndimage")
    return [
        name,
        compiling.cpu,
        *(statistics.median(us[who]) for who in us),
        float(np.median(np.divide(us["ours"], us["theirs"]))),
        reference,
        equal,
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--world", default="cave:width_m=25.6,height_m=25.6")
    parser.add_argument("--repeat", type=int, default=5)
    args = parser.parse_args()
    start_backend(1)
    world = with_ring(load_world(args.world))
    rows = [measure(name, kernel, args.repeat) for name, kernel in kernels_of(world).items()]
    print(markdown(["kernel", "compile s", "CPU µs", "its CPU µs", "ratio", "reference", "equal"], rows))
    return int(not all(row[-1] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
