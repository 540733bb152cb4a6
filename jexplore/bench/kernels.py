"""Kernels one by one, on one map, compared with other implementations and with their floor."""

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from scipy import ndimage

from jexplore.arrays import bits
from jexplore.bench import oracles
from jexplore.bench.beliefs import Recording
from jexplore.bench.engines import RULES, SEED
from jexplore.bench.rates import Effort, floor_s
from jexplore.bench.timing import Seconds, compiled, interleaved, ratio, speed_clock, spread, timed
from jexplore.distance import nearest_site
from jexplore.frontier import frontier_clusters, plan_masks
from jexplore.grid import Grid, empty_grid, radius_d2
from jexplore.raycast import fold, scan
from jexplore.reach import flood, reach
from jexplore.worlds.starts import clear_of_walls, draw_start
from jexplore.worlds.world import World

CALL_S = 0.02  # seconds that one timed call should last
CLUSTERS = 256  # slots
BELIEF_BYTES = 10  # of a cell of a belief: hits, misses, driven, exhausted
NEVER = 123_456_789  # a value that no result holds, which the compiler cannot know


class Reference(NamedTuple):
    """Another answer to a kernel's question."""

    name: str
    answer: Callable[[], Any]  # for all units of the kernel's pass
    agree: Callable[[Any, Any], bool]  # of our output and the answer
    timed: bool = True  # whether its time says anything


class Kernel(NamedTuple):
    """A kernel on one input."""

    name: str
    on: str  # what it works on
    shape: tuple[int, int]
    step: Callable[..., Any]  # (i, last output, arguments) -> output
    vary: Callable[..., Any]  # (never, arguments) -> arguments; `never` is False, in a way the compiler cannot tell
    start: Any  # pytree like the output
    arguments: Any  # pytree of arrays
    units: int  # calls in a row that make up one measured pass
    references: list[Reference]
    work: Effort


def never(out: Any) -> Array:
    """Return False in a way that the compiler cannot know before the output exists."""
    return jax.tree.leaves(out)[0].reshape(-1)[-1] == NEVER


def _looped(kernel):
    """Put a kernel into a loop in a program, so that its call is not measured: `f(passes, units, out, arguments)`.

    What it works on is varied in every round, by nothing in fact, so that no part of the work leaves the loop.
    """

    def run(passes, units, out, arguments):
        def body(i, state):
            out, arguments = state
            arguments = kernel.vary(never(out), arguments)
            return kernel.step(i % units, out, arguments), arguments

        return lax.fori_loop(0, passes * units, body, (out, arguments))[0]

    return jax.jit(run)


def _as_it_is(_, arguments):
    """Return arguments unchanged, for kernels that get another pose in every round."""
    return arguments


def blank(tree: Any) -> Any:
    """Return zeros of given shapes, numpy."""
    return jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), tree)


def microseconds(
    runs: Mapping[str, Sequence[tuple[Any, Seconds]]], units: Mapping[str, int]
) -> dict[str, dict[str, list[float]]]:
    """Return times of `interleaved` runs by name, and by clock: `{name: {"wall": [...], "cpu": [...]}}` a unit."""
    return {
        name: {clock: [1e6 * getattr(took, clock) / units[name] for _, took in turns] for clock in ("wall", "cpu")}
        for name, turns in runs.items()
    }


def row_of(
    name: str,
    on: str,
    shape: Sequence[int],
    took: Mapping[str, float],
    ours: Mapping[str, Sequence[float]],
    references: Sequence[tuple[str, Any, Mapping[str, Sequence[float]] | None]],
    work: Effort,
) -> dict[str, Any]:
    """Return a kernel's entry of the report."""
    median = statistics.median(ours[speed_clock()])
    floor_us = 1e6 * floor_s(work) or None
    return {
        "kernel": name,
        "on": on,
        "shape": list(shape),
        **took,
        "wall_us": spread(ours["wall"]),
        "cpu_us": spread(ours["cpu"]),
        "us": median,
        "references": [
            {
                "reference": reference,
                "equal": bool(equal),
                "wall_us": spread(found["wall"]) if found else None,
                "cpu_us": spread(found["cpu"]) if found else None,
                "ratio": ratio(ours[speed_clock()], found[speed_clock()]) if found else None,
            }
            for reference, equal, found in references
        ],
        "equal": all(bool(equal) for _, equal, _ in references),
        "work": work._asdict(),
        "floor_us": floor_us,
        "k": floor_us and floor_us / median,
    }


def measure_kernel(kernel: Kernel, repeat: int) -> dict[str, Any]:
    """Time one kernel: a dict for the report."""
    start, arguments = jax.device_put((kernel.start, kernel.arguments))
    units = np.int32(kernel.units)
    program, took = compiled(lambda: _looped(kernel).lower(np.int32(1), units, start, arguments))

    def ours(passes=1):
        return jax.block_until_ready(program(np.int32(passes), units, start, arguments))

    answer = jax.tree.map(np.asarray, ours())
    equal = [reference.agree(answer, reference.answer()) for reference in kernel.references]
    _, once = timed(ours)
    passes = max(1, math.ceil(CALL_S / max(once.wall, 1e-6)))
    tasks = {"": lambda: ours(passes)} | {r.name: r.answer for r in kernel.references if r.timed}
    calls = dict.fromkeys(tasks, kernel.units) | {"": passes * kernel.units}
    found = microseconds(interleaved(tasks, repeat), calls)
    references = [(r.name, ok, found.get(r.name)) for r, ok in zip(kernel.references, equal)]
    return row_of(kernel.name, kernel.on, kernel.shape, took, found[""], references, kernel.work)


def scans(recording: Recording) -> list[Kernel]:
    """Return the kernels of scanning and counting along an episode's whole way: list of `Kernel`."""
    truth, beams = recording.site.truth.occupied, recording.site.beams
    offset, length, occupied = (np.asarray(a) for a in (beams.offset, beams.length, truth))
    row, col, heading = recording.poses.T.copy()
    n, shape = len(recording.poses), occupied.shape

    def answer(update=True):
        hits, misses = np.zeros((2, occupied.size), np.int32)
        cells = row * shape[1] + col
        end, visited = oracles.walk(occupied.reshape(-1), offset, length, cells, heading, hits, misses, update)
        return end, hits.reshape(shape), misses.reshape(shape), visited

    def ranges(i, ends, arguments):
        truth, beams, poses = arguments
        end = scan(truth, *poses[i], beams).end
        return lax.dynamic_update_slice(ends, end[None], (i, jnp.int32(0)))

    def update(i, grid, arguments):
        truth, beams, poses = arguments
        return fold(grid, *poses[i], scan(truth, *poses[i], beams), beams)

    def same_map(grid, expected):
        height, width = recording.world.shape
        return all(
            np.array_equal(ours, theirs) and np.array_equal(ours[:height, :width], seen)
            for ours, theirs, seen in zip((grid.hits, grid.misses), expected[1:3], (recording.hits, recording.misses))
        )

    visited = float(answer()[3]) / n
    shared = {
        "on": f"{recording.world.name}, {n} scans", "shape": recording.world.shape, "vary": _as_it_is,
        "arguments": (truth, beams, recording.poses), "units": n,
    }  # fmt: skip
    numba = "cell by cell, numba", oracles.NATIVE
    ends, grid = np.zeros((n, length.shape[1]), np.int32), jax.tree.map(np.asarray, empty_grid(shape))
    only, both = Effort(gathers=visited), Effort(gathers=visited, scatters=visited)
    of_ranges = Reference(
        numba[0], lambda: answer(False), lambda ends, expected: np.array_equal(ends, expected[0]), numba[1]
    )
    of_map = Reference(numba[0], answer, same_map, numba[1])
    return [
        Kernel("scan", step=ranges, start=ends, references=[of_ranges], work=only, **shared),
        Kernel("scan and fold", step=update, start=grid, references=[of_map], work=both, **shared),
    ]


def half_known(world: World) -> tuple[Any, ...]:
    """Return a world known within half its longer side round a drawn start: arguments of `plan_masks`."""
    row, col, _ = draw_start(world, SEED, 0, RULES.clearance_m)
    rows, cols = np.indices(world.shape)
    known = (rows - row) ** 2 + (cols - col) ** 2 <= (max(world.shape) // 2) ** 2
    hits, misses = (np.where(known & mask, 3, 0).astype(np.int32) for mask in (world.occupied, ~world.occupied))
    nothing = np.zeros(world.shape, bool)
    driven = nothing.copy()
    driven[row, col] = True
    return hits, misses, driven, nothing, ~nothing, np.int32(row), np.int32(col)


def _mask_numbers(world):
    return {
        "p_free": RULES.p_free,
        "near_d2": radius_d2(RULES.near_m, world.cell_m),
        "clearance_d2": radius_d2(RULES.clearance_m, world.cell_m),
    }


def vary_masks(never: Any, arguments: Any) -> tuple[Any, ...]:
    """Return arguments of `plan_masks` unchanged."""
    grid, driven, exhausted, inside, row, col = arguments
    grid = grid.replace(hits=grid.hits.at[0, 0].add(never))
    driven, exhausted, inside = (a.at[0, 0].set(a[0, 0] ^ never) for a in (driven, exhausted, inside))
    return grid, driven, exhausted, inside, row, col


def _mask_kernel(world, shared):
    hits, misses, *rest = half_known(world)
    numbers = _mask_numbers(world)
    # Ignored types: numpy on the host, where the record says what it is on the device.
    arguments = Grid(hits, misses), *rest  # type: ignore[arg-type]

    def step(_, out, arguments):
        return plan_masks(*arguments, **numbers)

    def agree(out, expected):
        return all(np.array_equal(bits.unpack(a, world.shape[0]), b) for a, b in zip(out, expected))

    references = [Reference("scipy.ndimage", lambda: oracles.masks(hits, misses, *rest, **numbers), agree)]
    if oracles.SKIMAGE:
        references.append(Reference("skimage", lambda: oracles.masks_skimage(hits, misses, *rest, **numbers), agree))
    start = blank(jax.eval_shape(lambda a: step(0, None, a), arguments))
    cells = world.occupied.size
    work = Effort(bytes=(BELIEF_BYTES + 1 + 1 / 4) * cells)
    return Kernel("masks", step=step, vary=vary_masks, start=start, arguments=arguments, references=references,
                  work=work, **shared)  # fmt: skip


def _cluster_kernel(world, shared):
    frontier = oracles.masks(*half_known(world), **_mask_numbers(world))[1]

    def step(_, out, frontier):
        return frontier_clusters(frontier, max_clusters=CLUSTERS)

    def agree(out, expected):
        labels, sizes = expected
        count = len(sizes)
        fits = int(out.count) == count and int(out.overflow) == 0
        return fits and np.array_equal(out.label, labels) and np.array_equal(out.size[:count], sizes)

    references = [Reference("scipy.ndimage", lambda: oracles.clusters(frontier), agree)]
    if oracles.SKIMAGE:
        references.append(Reference("skimage", lambda: oracles.clusters_skimage(frontier), agree))
    start = blank(jax.eval_shape(lambda a: step(0, None, a), frontier))
    return Kernel("clusters", step=step, vary=_first_cell_never, start=start, arguments=frontier,
                  references=references, work=Effort(bytes=5 * frontier.size), **shared)  # fmt: skip


def _first_cell_never(never, mask):
    return mask.at[0, 0].set(mask[0, 0] ^ never)


def _reach_kernel(world, shared):
    """Return the `Kernel` of the reachability map of a world's clear cells, with every method."""
    row, col, _ = draw_start(world, SEED, 0, RULES.clearance_m)
    clear = clear_of_walls(world.occupied, RULES.clearance_m, world.cell_m)
    graph, nothing = oracles.motion_graph(clear), np.zeros_like(clear)
    reached = int(oracles.flooded(clear, row, col).sum())
    references = [
        Reference("Dijkstra, scipy (graph given)", lambda: oracles.graph_costs(graph, clear.shape, row, col),
                  np.array_equal)
    ]  # fmt: skip
    if oracles.NATIVE:
        heap = Reference(
            "Dijkstra, numba", lambda: oracles.dijkstra(clear, row, col, nothing, False)[0], np.array_equal
        )
        references.append(heap)

    return Kernel(
        "reach", step=lambda _, out, arguments: reach(*arguments),
        vary=lambda never, a: (_first_cell_never(never, a[0]), *a[1:]),
        start=np.zeros(clear.shape, np.int32), arguments=(clear, np.int32(row), np.int32(col)),
        references=references, work=Effort(bytes=5 * clear.size, ops=reached), **shared,
    )  # fmt: skip


def _flood_kernel(world, shared):
    row, col, _ = draw_start(world, SEED, 0, RULES.clearance_m)
    clear = clear_of_walls(world.occupied, RULES.clearance_m, world.cell_m)
    words = np.asarray(bits.pack(jnp.asarray(clear)))

    def agree(out, expected):
        return np.array_equal(bits.unpack(out, clear.shape[0]), expected)

    references = [Reference("scipy.ndimage", lambda: oracles.flooded(clear, row, col), agree)]
    if oracles.SKIMAGE:
        references.append(Reference("skimage", lambda: oracles.flooded_skimage(clear, row, col), agree))
    return Kernel("flood", step=lambda _, out, arguments: flood(*arguments),
                  vary=lambda never, a: (a[0].at[0, 0].set(a[0][0, 0] ^ never), *a[1:]),
                  start=np.zeros_like(words), arguments=(words, np.int32(row), np.int32(col)),
                  references=references, work=Effort(bytes=2 * words.nbytes), **shared)  # fmt: skip


def _site_kernel(world, shared):
    """Return the `Kernel` of the distance to the nearest wall, and which cell that is."""
    walls = world.occupied

    def agree(out, expected):
        d2, site = out
        rows, cols = np.indices(walls.shape)
        at = np.divmod(site, walls.shape[1])
        own = (at[0] - rows) ** 2 + (at[1] - cols) ** 2
        return np.array_equal(d2, np.rint(expected[0] ** 2)) and walls[at].all() and np.array_equal(own, d2)

    reference = Reference("scipy.ndimage", lambda: ndimage.distance_transform_edt(~walls, return_indices=True), agree)
    start = (np.zeros(walls.shape, np.int32), np.zeros(walls.shape, np.int32))
    return Kernel("nearest site", step=lambda _, out, walls: nearest_site(walls), vary=_first_cell_never,
                  start=start, arguments=walls, references=[reference], work=Effort(bytes=9 * walls.size),
                  **shared)  # fmt: skip


def whole_map(world: World) -> list[Kernel]:
    """Return the kernels that work on a whole map, on a world: list of `Kernel`."""
    height, width = world.shape
    shared = {"on": f"{world.name.partition(':')[0]}, {height} x {width}", "shape": world.shape, "units": 1}
    return [
        _mask_kernel(world, shared), _cluster_kernel(world, shared), _reach_kernel(world, shared),
        _flood_kernel(world, shared), _site_kernel(world, shared),
    ]  # fmt: skip
