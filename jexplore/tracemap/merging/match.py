"""Matching of two trace maps: the guess that explains most, if no other rivals it."""

import dataclasses
import enum
import math
from collections.abc import Mapping, Sequence

import numpy as np

from jexplore.tracemap.merging.evidence import Evidence
from jexplore.tracemap.merging.limits import Limits
from jexplore.tracemap.merging.pair import Guess, Pair, PlaceWay, leaving_alike, places_of
from jexplore.tracemap.merging.rigid import Move, fit, mean_deg, mirrored
from jexplore.tracemap.record import BtmMap

EVIDENCE = 6.0  # nats that a match must be worth, beyond what the number of tries makes of chance
MARGIN = 4.6  # nats by which it must be worth more than any other that it excludes: a hundred to one
CLEAR = 2.0  # a neighbour's second-nearest candidate lies at least this many times as far away


class Merging(enum.Enum):
    """Outcome of a merge."""

    MERGED = "merged"
    NOT_ENOUGH_IN_COMMON = "not enough in common"
    AMBIGUOUS = "ambiguous"


@dataclasses.dataclass(frozen=True)
class Match:
    """Common part of two maps."""

    outcome: Merging
    nodes: dict[int, int]  # node of the second map -> the same of the first
    ways: tuple[tuple[PlaceWay, PlaceWay], ...]
    """Ways of places that are matched, of the first map and of the second, each once."""
    contradictions: tuple[tuple[PlaceWay, PlaceWay], ...]
    """Pairs of ways of matched places that leave alike and continue differently."""
    beside: tuple[int, ...]
    """Nodes of the first map that are matched because they lie where they should, see `with_neighbours`."""
    move: Move  # takes the second map into the frame of the first
    evidence: float  # nats beyond chance
    margin: float
    """Nats beyond the best match that gives a node another meaning; infinite without one. 0 at most where it
    contradicts itself and the second map in a mirror explains more."""


NOTHING = Match(Merging.MERGED, {}, (), (), (), Move(), math.inf, math.inf)


def match_maps(one: BtmMap, other: BtmMap, *, limits: Limits | None = None, min_common: int = 3) -> Match:
    """Find the common part of two proper maps.

    Guesses are grown from every pair of nodes that look alike, and weighed. The best one holds if it has enough nodes,
    enough evidence and no rival nearly as good. If it contradicts itself, the mirrored second map is a rival too: the
    common part of a building and its mirror image ends in nodes whose links leave the other way round. Then nodes at
    the expected position are added by `with_neighbours`.
    """
    pair, tries, weighed = _weighed(one, other, limits or Limits())
    # Once more grown: few are asked for, and all together would take much memory.
    grown = ((gain, guess, _nodes_of(guess, pair.limits)) for gain, guess in ((g, pair.grown(*e)) for g, e in weighed))
    gain, best, nodes = next(grown, (-math.inf, Guess(), {}))
    if not nodes:
        return dataclasses.replace(NOTHING, outcome=Merging.NOT_ENOUGH_IN_COMMON, evidence=-math.inf)
    margin = gain - next((rival for rival, _, others in grown if _exclude(nodes, others)), -math.inf)
    if best.contradictions:
        reflected = _weighed(one, mirrored(other), pair.limits)[2]
        margin = min(margin, 0.0 if reflected and reflected[0][0] > gain + MARGIN else math.inf)
    worth = gain - tries
    if len(nodes) < min_common or worth < EVIDENCE:
        outcome = Merging.NOT_ENOUGH_IN_COMMON
    else:
        outcome = Merging.AMBIGUOUS if margin < MARGIN else Merging.MERGED
    places = _places(one), _places(other)
    move = _fit(*places, nodes, mean_deg([alike.turn_deg for alike in best.alike.values()]))
    ways, against, sure = best.ways, best.contradictions, set(nodes)
    if outcome is Merging.MERGED:
        turns = {a: alike.turn_deg for a, alike in best.alike.items()}
        nodes, ways = with_neighbours(pair, nodes, ways, turns, move)
        move = _fit(*places, nodes, move.turn_deg)
        same = [_links(*both) for both in ways]
        against = [both for both in against if not any(_links(*both) <= links for links in same)]
    beside = tuple(a for b, a in nodes.items() if b not in sure)
    return Match(outcome, nodes, tuple(ways), tuple(against), beside, move, worth, margin)


def _weighed(one, other, limits):
    """Return the pair, the logarithm of its tries, and what guesses gain and how they begin, the best first."""
    pair = Pair(places_of(one), places_of(other), limits)
    evidence = Evidence(pair)
    weighed = [(evidence.gain(guess), guess.entries[0]) for guess in pair.guesses()]
    return pair, evidence.tries, sorted(weighed, key=lambda entry: -entry[0])


def _nodes_of(guess, limits):
    """Return the nodes of a guess: `{of the second: of the first}`, terminal nodes at one point of a way included."""
    whole = [(way.length_m, match.length_m) for way, match in guess.ways if way.is_whole and match.is_whole]
    noise2, scale2 = limits.length_m**2 / 4 + 1e-6, limits.length_share**2 * 2 / 3 + 1e-9
    first, second = (sum(lengths[side] ** 2 for lengths in whole) / noise2 + 1 / scale2 for side in (0, 1))
    scale = (second / first) ** 0.25  # half of the correction to either map
    unsure = (first * second) ** -0.25  # standard deviation of the scale that the ways leave open
    nodes = {b: a for a, b in guess.places.items()}
    for way, match in guess.ways:
        for a, at in way.stops:
            near = [(abs(there / scale - scale * at), there, b) for b, there in match.stops if b not in nodes]
            off, there, b = min(near, default=(math.inf, 0.0, -1))
            if off <= limits.length_m + 2 * math.sqrt(at * there) * unsure:
                nodes[b] = a
    return nodes


def _exclude(nodes, others):
    """Return whether a node has two meanings in two guesses."""
    back = {a: b for b, a in nodes.items()}
    return any(nodes.get(b, a) != a or back.get(a, b) != b for b, a in others.items())


def _places(btm):
    return {node.id: (node.x_m, node.y_m) for node in btm.nodes}


def _fit(onto, points, nodes, turn_deg):
    return fit([points[b] for b in nodes], [onto[a] for a in nodes.values()], turn_deg)


def _links(way, match):
    return {id(link) for one in (way, match) for link, _ in one.steps}


def with_neighbours(
    pair: Pair,
    nodes: Mapping[int, int],
    ways: Sequence[tuple[PlaceWay, PlaceWay]],
    turns: Mapping[int, float],
    move: Move,
) -> tuple[dict[int, int], list[tuple[PlaceWay, PlaceWay]]]:
    """Extend a match of two maps by places that lie near the expected position.

    Two places match if both have one type, each is the nearest to the other, no other is nearly as near, their distance
    is within the drift since the nearest matched place, and a way leaves both alike. Places behind a wall are near,
    too: where more ways exist in one map only than in both, drift is not an explanation.

    `nodes` has nodes of the second -> the same of the first, `turns` places of the first -> direction there less
    direction in the second, degrees; `move` takes the second map into the frame of the first.
    """
    nodes, turns = dict(nodes), dict(turns)
    while True:
        near = {b: (a, turn) for b, a, turn in _neighbours(pair, nodes, turns, move)}
        taken = [a for a, _ in near.values()]
        fresh = {b: (a, turn) for b, (a, turn) in near.items() if taken.count(a) == 1}
        if not fresh:
            return nodes, _ways_between(pair, nodes, ways, turns)
        for b, (a, turn) in fresh.items():
            nodes[b] = a
            turns[a] = leaving_alike(pair.one.ways[a], pair.other.ways[b], turn, pair.limits.angle_deg)[1]


def _neighbours(pair, nodes, turns, move):
    """Yield places of the second map with the ones of the first that they match, and the turn there."""
    matched, known = [b for b, a in nodes.items() if a in turns], set(nodes.values())
    rest, free = [b for b in pair.other.nodes if b not in nodes], sorted(pair.one.nodes.keys() - known)
    if not (rest and free):
        return
    here, anchors = (_rows(pair.other, many) for many in (rest, matched))
    between = _apart(here, anchors)
    beside = between.argmin(axis=1)
    matches = _rows(pair.one, [nodes[b] for b in matched])
    place = move.place(*here.T) + matches.T[:, beside] - np.array(move.place(*anchors.T))[:, beside]
    off = _apart(place.T, _rows(pair.one, free))
    kinds = [np.array([f"{part.nodes[key].type} {part.nodes[key].obstacle}" for key in many])
             for part, many in ((pair.other, rest), (pair.one, free))]  # fmt: skip
    off[kinds[0][:, None] != kinds[1]] = np.inf
    nearest = np.sort(off, axis=1)[:, :2]
    limits = pair.limits
    fits = nearest[:, 0] <= 2 * limits.length_m + limits.length_share * between.min(axis=1)
    fits &= nearest[:, -1] >= CLEAR * nearest[:, 0] if len(free) > 1 else True
    for i in np.flatnonzero(fits).tolist():
        b, a, turn = rest[i], free[off[i].argmin()], turns[nodes[matched[beside[i]]]]
        ways, others = pair.one.ways[a], pair.other.ways[b]
        common = len(leaving_alike(ways, others, turn, limits.angle_deg)[0])
        if common and (len(ways) + len(others) <= 3 * common or nearest[i, 0] <= 2 * limits.length_m):
            yield b, a, turn


def _rows(part, keys):
    return np.array([(part.nodes[key].x_m, part.nodes[key].y_m) for key in keys])


def _apart(points, others):
    return np.hypot(*(points[:, None] - others[None]).transpose(2, 0, 1))


def _ways_between(pair, nodes, ways, turns):
    """Return the matched ways, and those of new places that agree."""
    found, taken = list(ways), {key for both in ways for key in _taken(*both)}
    for b, a in nodes.items():
        if a not in turns or b not in pair.other.nodes:
            continue
        for m, n in leaving_alike(pair.one.ways[a], pair.other.ways[b], turns[a], pair.limits.angle_deg)[0]:
            way, match = pair.one.ways[a][m], pair.other.ways[b][n]
            ends_agree = not (way.is_whole and match.is_whole) or nodes.get(match.end) == way.end
            if not _links(way, match) & taken and ends_agree and pair.lengths_agree(way, match):
                taken |= _taken(way, match)
                found.append((way, match))
    return found


def _taken(way, match):
    """Return links that can be matched no more. A way followed in one map may be met again at its other end."""
    is_half = way.is_whole != match.is_whole
    return {id(link) for one in (way, match) if not (is_half and one.is_whole) for link, _ in one.steps}
