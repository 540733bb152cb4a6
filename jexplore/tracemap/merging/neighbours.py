"""Nodes that lie where a match says they should, though some of their links look otherwise."""

import math
from collections.abc import Mapping, Sequence

from jexplore.tracemap.merging.rigid import Move
from jexplore.tracemap.merging.walk import Pair
from jexplore.tracemap.merging.ways import Way

CLEAR = 2.0  # the second-nearest candidate lies at least this many times as far away


def with_neighbours(
    pair: Pair, nodes: Mapping[int, int], ways: Sequence[tuple[Way, Way]], turns: Mapping[int, float], move: Move
) -> tuple[dict[int, int], list[tuple[Way, Way]]]:
    """Extend a match of two maps by places that lie near the expected position.

    Two places match if both have one type, each is the nearest to the other, no other is nearly as near, their distance
    is within the drift since the nearest matched place, and a way leaves both alike. Places behind a wall are near,
    too: where more ways exist in one map only than in both, drift is not an explanation.

    Args:
      pair: the maps.
      nodes: node of the second -> the same of the first.
      ways: matched ones.
      turns: place of the first -> direction there less direction in the second, degrees.
      move: takes the second map into the frame of the first.

    Returns:
      `nodes` and `ways` with what was added.
    """
    nodes, turns = dict(nodes), dict(turns)
    while True:
        near = {
            b: found for b in pair.other.nodes if b not in nodes and (found := _nearest(pair, nodes, turns, move, b))
        }
        taken = [a for a, _ in near.values()]
        fresh = {b: (a, turn) for b, (a, turn) in near.items() if taken.count(a) == 1}
        if not fresh:
            return nodes, _ways(pair, nodes, ways, turns)
        for b, (a, turn) in fresh.items():
            nodes[b] = a
            turns[a] = pair.aligned(pair.one.ways[a], pair.other.ways[b], turn)[1]


def _nearest(pair, nodes, turns, move, b):
    """Return the place of the first map that matches a place of the second, and its turn there; None for none."""
    matched = [key for key in nodes if nodes[key] in turns]
    here = _place(pair.other, b)
    beside = min(matched, key=lambda key: math.dist(_place(pair.other, key), here))
    away = math.dist(_place(pair.other, beside), here)
    was, now = move.place(*_place(pair.other, beside)), _place(pair.one, nodes[beside])
    x, y = move.place(*here)
    x, y = x + now[0] - was[0], y + now[1] - was[1]
    kind, known = pair.other.nodes[b], set(nodes.values())
    found = sorted((math.dist(_place(pair.one, a), (x, y)), a) for a, node in pair.one.nodes.items()
                   if a not in known and (node.type, node.obstacle) == (kind.type, kind.obstacle))  # fmt: skip
    limit = 2 * pair.limits.length_m + pair.limits.length_share * away
    if not found or found[0][0] > limit or (len(found) > 1 and found[1][0] < CLEAR * found[0][0]):
        return None
    (off, a), turn = found[0], turns[nodes[beside]]
    ways, others = pair.one.ways[a], pair.other.ways[b]
    common = len(pair.aligned(ways, others, turn)[0])
    lost = len(ways) + len(others) - 2 * common
    return (a, turn) if common and (lost <= common or off <= 2 * pair.limits.length_m) else None


def _place(part, key):
    return part.nodes[key].x_m, part.nodes[key].y_m


def _ways(pair, nodes, ways, turns):
    """Return the matched ways, and those of new places that agree."""
    found, taken = list(ways), {key for both in ways for key in _taken(*both)}
    for b, a in nodes.items():
        if a not in turns or b not in pair.other.nodes:
            continue
        for m, n in pair.aligned(pair.one.ways[a], pair.other.ways[b], turns[a])[0]:
            way, match = pair.one.ways[a][m], pair.other.ways[b][n]
            own = {id(link) for one in (way, match) for link, _ in one.steps}
            ends_agree = not (way.is_whole and match.is_whole) or nodes.get(match.end) == way.end
            if not own & taken and ends_agree and pair.lengths_agree(way, match):
                taken |= _taken(way, match)
                found.append((way, match))
    return found


def _taken(way, match):
    """Return links that can be matched no more. A way followed in one map may be met again at its other end."""
    is_half = way.is_whole != match.is_whole
    return {id(link) for one in (way, match) if not (is_half and one.is_whole) for link, _ in one.steps}
