"""Rooms: free space cut at the narrow places of its Voronoi graph (Holz et al. 2010, section 2.4 and Figure 7)."""

import functools
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
from flax import struct
from jax import Array, lax

from jexplore.arrays import bits, groups
from jexplore.arrays.loops import repeat
from jexplore.grid import beside, bordered
from jexplore.reach import nearest_source
from jexplore.skeleton import Graph, voronoi_graph

MAX_HOPS = {"thrun": 2**30, "wurm": 1, "holz": 2}
"""Name -> how many nodes of the reduced Voronoi graph a critical point may lie away from a junction."""

PROMINENCE_M = 0.15  # by which a critical point stands out, unless said otherwise


@struct.dataclass
class Criteria:
    """Criteria of a critical point. Numbers that may be swept without compiling anew."""

    max_hops: Array  # int32, nodes of the reduced graph up to a junction
    prominence: Array  # float32, cells: how much the clearance must rise on both sides; 0: any local minimum
    gamma: Array  # float32, cells: how far apart two obstacle cells must be to have a Voronoi edge between them


class Form(NamedTuple):
    """Static sizes. Hashable."""

    nodes: int  # cells of the Voronoi graph, at most
    splits: int  # critical points, at most


@struct.dataclass
class Segments:
    """Free space in segments."""

    label: Array  # [H, W] int32, segment of every free cell, 0 or more, not consecutive; -1 for none
    graph: Graph  # the Voronoi graph, K slots
    critical: Array  # [K] bool, slots of the graph that are critical points
    group: Array  # [2 C] int32, segment that each side of each split has become part of
    seed: Array  # [2 C] int32, flat index of the cell that each side of each split grew from; H * W for none
    split_d2: Array  # [C] int32, squared clearance of each split's critical point, cells^2; 0 in an unused slot
    count: Array  # int32, critical points
    overflow: Array  # int32, cells of the graph and critical points that did not fit


def form_for(shape: tuple[int, ...], *, coarse: bool = False) -> Form:
    """Return the `Form` that suits a map of a shape.

    One cell in 8 may lie on the Voronoi graph and one in 400 be critical, on small maps more; on coarse maps, where
    corridors are only a few cells wide, one in 4 and one in 96. The most that built-in worlds have on an exploring
    robot's way, furnished ones among them, is printed by `benchmarks/graph_sizes.py`.
    """
    cells = shape[0] * shape[1]
    nodes = max(768, -(-cells // (4 if coarse else 8)))
    splits = max(64, cells // (96 if coarse else 400))
    return Form(-(-nodes // 256) * 256, min(splits, 1024))


def criteria(
    variant: str = "holz",
    *,
    prominence: float | Array = 1.0,
    gamma: float = 3.0,
) -> Criteria:
    """Return `Criteria` of a variant. Lengths in cells."""
    return Criteria(jnp.int32(MAX_HOPS[variant]), jnp.float32(prominence), jnp.float32(gamma))


class _Walks(NamedTuple):
    """Walks along the graph's chains. State 2 k + j stands for: at node k, on the way to its j-th neighbour.

    Level l of a table tells of the first 2**l nodes ahead. Only the first `levels` of them are filled in.
    """

    levels: Array  # int32
    ahead: Array  # [L, 2 K + 1] int32, state after them; 2 K: past the end of the chain
    top: Array  # [L, 2 K + 1] int32, largest key among them; -1 for none
    bottom: Array  # [L, 2 K + 1] int32, smallest key; NO_KEY for none


NO_KEY = 2**31 - 1


def _chains(graph):
    """Return the next node of every state, and the state that follows it: `([2 K + 1], [2 K + 1])` int32."""
    size = graph.cell.shape[0]
    nodes = lax.iota(jnp.int32, size)
    order = jnp.where(graph.link < size, lax.broadcasted_iota(jnp.int32, graph.link.shape, 1), 8)
    first = jnp.min(order, axis=1)
    second = jnp.min(jnp.where(order > first[:, None], order, 8), axis=1)
    pair = [jnp.where(at < 8, graph.link[nodes, jnp.minimum(at, 7)], size) for at in (first, second)]
    pair = [jnp.where(graph.degree <= 2, next_, size) for next_ in pair]
    head = jnp.append(jnp.stack(pair, axis=1).reshape(-1), size)
    # From a node of degree 2 on to its other neighbour; every other node ends the chain.
    passes = (graph.degree == 2)[jnp.minimum(head, size - 1)] & (head < size)
    came_from = jnp.append(jnp.repeat(nodes, 2), size)
    back = head[jnp.minimum(2 * head, 2 * size)] == came_from
    return head, jnp.where(passes, 2 * head + back, 2 * size)


def _doubled(head, after, keys):
    """Build the `_Walks` of a graph's chains: as many levels as the longest chain needs."""
    size = keys.shape[0]
    at = jnp.minimum(head, size - 1)
    tables = after, jnp.where(head < size, keys[at], -1), jnp.where(head < size, keys[at], NO_KEY)
    tables = tuple(jnp.zeros(((2 * size).bit_length(), *a.shape), jnp.int32).at[0].set(a) for a in tables)

    def going(state):
        n, (ahead, _, _) = state
        return (n < ahead.shape[0]) & jnp.any(ahead[n - 1] < 2 * size)

    def level(state):
        n, tables = state
        ahead, top, bottom = (a[n - 1] for a in tables)
        new = ahead[ahead], jnp.maximum(top, top[ahead]), jnp.minimum(bottom, bottom[ahead])
        return n + going(state), tuple(lax.dynamic_update_slice(a, b[None], (n, 0)) for a, b in zip(tables, new))

    return _Walks(*(lambda n, tables: (n, *tables))(*repeat(going, level, (jnp.int32(1), tables))))


def _barrier(walks, keys, upwards):
    """Return for every state, `[2 K]`, the largest key met before one smaller than the node's own, or the chain's end.

    -1 without one. With `upwards` False the reverse: the smallest before a larger one, NO_KEY for none.
    """
    own = jnp.repeat(keys, 2)

    def descend(i, state):
        at, best = state
        ahead, top, bottom = (a[walks.levels - 1 - i] for a in walks[1:])
        if upwards:
            on = bottom[at] > own
            best = jnp.where(on, jnp.maximum(best, top[at]), best)
        else:
            on = top[at] < own
            best = jnp.where(on, jnp.minimum(best, bottom[at]), best)
        return jnp.where(on, ahead[at], at), best

    start = lax.iota(jnp.int32, own.shape[0]), jnp.full(own.shape, -1 if upwards else NO_KEY, jnp.int32)
    return lax.fori_loop(0, walks.levels, descend, start)[1]


def critical_points(graph: Graph, criteria: Criteria) -> Array:
    """Find nodes at which free space is narrow.

    A node of degree 2 whose clearance is a local minimum along its chain: on either side the clearance rises by the
    prominence before it falls below the node's, or the chain ends. On the way to a junction there are fewer than
    `max_hops` other minima and maxima.

    Returns:
      `[K]` bool. Clearances from sqrt(2**31 / K) cells up, K rounded up to a power of two, count as equal: 724 cells
        for 4096 nodes, 90 for 262,144.

    Source:
      Holz et al. 2010, Figure 7, step 2, following the text of section 2.4; Thrun 1998 and Wurm et al. 2008 as
        variants.
    """
    size = graph.cell.shape[0]
    index_bits = (size - 1).bit_length()
    # One number that orders nodes by clearance, then by index.
    keys = jnp.minimum(graph.d2, 2 ** (31 - index_bits) - 2) * 2**index_bits + lax.iota(jnp.int32, size)
    head, after = _chains(graph)
    walks = _doubled(head, after, keys)

    def clearance(key):
        return jnp.sqrt((key >> index_bits).astype(jnp.float32))

    own, prominence = clearance(jnp.repeat(keys, 2)), criteria.prominence
    highest, lowest = _barrier(walks, keys, True), _barrier(walks, keys, False)
    rises = (highest >= 0) & (clearance(highest) - own >= prominence)
    falls = (lowest < NO_KEY) & (own - clearance(lowest) >= prominence)
    passing = graph.degree == 2
    minimum = passing & jnp.all(rises.reshape(size, 2), axis=1)
    extreme = minimum | (passing & jnp.all(falls.reshape(size, 2), axis=1))

    def hop(i, state):
        ahead, hops, last = state
        # Combine the walk up to here with the walk from its end.
        return ahead[ahead], hops + hops[ahead], jnp.where(ahead < 2 * size, last[ahead], last)

    at = jnp.minimum(head, size - 1)
    hops = jnp.where((head < size) & extreme[at], 1, 0)
    state = after, hops, head
    _, hops, last = lax.fori_loop(0, walks.levels, hop, state)
    ends_at = jnp.where(after < 2 * size, last, head)[: 2 * size]
    at_junction = (ends_at < size) & (graph.degree[jnp.minimum(ends_at, size - 1)] >= 3)
    near = at_junction & (hops[: 2 * size] < criteria.max_hops)
    near = jnp.any(near.reshape(size, 2), axis=1) | (criteria.max_hops >= MAX_HOPS["thrun"])
    return minimum & near


def borders(label: Array, n: int) -> Array:
    """Count the pairs of adjacent cells for each pair of labels: `[n, n]` int32, at (lower, higher)."""
    b = bordered(label, -1)
    total = jnp.zeros((n * n,), jnp.int32)
    for drow, dcol in ((0, 1), (1, 0)):
        other = beside(b, drow, dcol)
        low, high = jnp.minimum(label, other), jnp.maximum(label, other)
        pair = jnp.where((low >= 0) & (low < high), low * n + high, n * n)
        total = total.at[pair.reshape(-1)].add(1, mode="drop")
    return total.reshape(n, n)


def merged(shared: Array, start: Array) -> Array:
    """Join segments that touch and do not come from the same split, the longest shared border first.

    Segments 2 k and 2 k + 1 come from split k: no two groups that hold opposite sides of one split are joined.

    Args:
      shared: `[2 C, 2 C]` int32, from `borders`: of single segments, not of the groups that they become part of.
      start: `[2 C]` int32, for each segment the lowest that grew from the same cell.

    Returns:
      `[2 C]` int32, the lowest segment of the group that each segment is part of.

    Source:
      Holz et al. 2010, Figure 7, steps 5 and 6. Changed: an order, because the result depends on it; ties go to the
        lowest labels.
    """
    n = shared.shape[0]
    edges = min(n * n, 4 * n)  # a planar graph has fewer than three times as many edges as nodes
    at = bits.first_cells(bits.pack(shared > 0), edges)
    length = shared.reshape(-1).at[at].get(mode="fill", fill_value=0)
    order = jnp.argsort(jnp.where(at < n * n, -length, NO_KEY))
    low, high = at[order] // n, at[order] % n
    used = jnp.sum(length > 0)

    def join(state):
        i, group = state
        a, b = group[low[i]], group[high[i]]
        side = group[0::2], group[1::2]
        opposite = jnp.any(((side[0] == a) & (side[1] == b)) | ((side[0] == b) & (side[1] == a)))
        joined = jnp.where(group == jnp.maximum(a, b), jnp.minimum(a, b), group)
        return i + 1, jnp.where(opposite | (i >= used), group, joined)

    return repeat(lambda state: state[0] < used, join, (jnp.int32(0), start))[1]


@functools.partial(jax.jit, static_argnames=("form",))
def segment(free: Array, criteria: Criteria, *, form: Form) -> Segments:
    """Divide free space into segments, roughly rooms.

    Args:
      free: `[H, W]` bool, cells known to be free; all others count as obstacles. What lies outside the map is no
        obstacle: it should have a wall all round, as worlds have. A passage needs three free cells across to have an
        axis that can be split.
      form: static.

    Returns:
      `Segments`. Free cells that no seed reaches have the label -1; without any critical point all have.

    Source:
      Holz et al. 2010, Figure 7. Changed: closest along paths, so that segments do not leak through walls; the order
        of merging is fixed; see `skeleton.voronoi_graph`.
    """
    chex.assert_rank(free, 2)
    chex.assert_type(free, bool)
    (height, width), n = free.shape, 2 * form.splits
    none = height * width
    graph, _, _ = voronoi_graph(~free, criteria.gamma**2, size=form.nodes)
    critical = critical_points(graph, criteria)
    node = jnp.nonzero(critical, size=form.splits, fill_value=form.nodes)[0]
    head = _chains(graph)[0]
    sides = jnp.stack([head[jnp.minimum(2 * node + j, 2 * form.nodes)] for j in (0, 1)], axis=1).reshape(-1)
    sides = jnp.where(jnp.repeat(node, 2) < form.nodes, sides, form.nodes)
    seed = groups.at(graph.cell, sides, none)
    at_seed = jnp.full((none,), n, jnp.int32).at[seed].min(lax.iota(jnp.int32, n), mode="drop").reshape(height, width)
    sources = jnp.where((at_seed < n) & free, at_seed, -1)
    label = nearest_source(free, sources, n)
    # Two splits side by side may share a cell between them, which only one segment can grow from.
    start = jnp.where(seed < none, groups.at(at_seed, seed, n), lax.iota(jnp.int32, n))
    group = merged(borders(label, n), start)
    label = jnp.where(label >= 0, group[jnp.maximum(label, 0)], -1)
    count = jnp.sum(critical, dtype=jnp.int32)
    overflow = graph.overflow + jnp.maximum(count - form.splits, 0)
    return Segments(label, graph, critical, group, seed, groups.at(graph.d2, node, 0), count, overflow)
