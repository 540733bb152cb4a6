"""Repair of contradictions in a finished map, as far as they can be explained."""

from collections.abc import Iterator
from typing import NamedTuple

from jexplore.tracemap.record import NOWHERE, BtmMap, check_map, connected_parts
from jexplore.tracemap.repairing.doubles import both_ways, doubled, misled, strayed, turned_back
from jexplore.tracemap.repairing.through import explained, twins


class Repaired(NamedTuple):
    """A map without contradictions that could be explained."""

    map: BtmMap
    closings: int  # ways round: searched links beyond those that it takes to reach every node
    contradicted: int  # what was there twice, led through a node or ended by a wrong opening
    left: int  # pairs of ways by one opening for which there was no explanation


def repaired(btm: BtmMap) -> Repaired:
    """Repair a map: no links that pass a node unnoticed, and no duplicate nodes and links.

    In this order: links on which the robot has turned back; ways that were followed from both ends; links that end by
    an opening that is another's; pairs of ways by one opening, see `through.explained`; sets of nodes that are there
    twice; links that end where the robot strayed to. What nothing explains is left as it is, and counted.

    Args:
      btm: a map of a run, whose links have the attribute `moved`; those without are left alone.

    Returns:
      `Repaired`.

    Raises:
      InputError: not a proper map.
    """
    btm, contradicted = check_map(btm), 0
    for _ in btm.links:  # each time one link less is doubtful
        found = next(_mended(btm), None)
        if found is None:
            break
        btm, contradicted = found, contradicted + 1
    return Repaired(btm, closings_of(btm), contradicted, sum(1 for _ in twins(btm)))


def _mended(btm: BtmMap) -> Iterator[BtmMap]:
    """Yield the map with one contradiction less."""
    yield from turned_back(btm)
    yield from both_ways(btm)
    yield from misled(btm)
    yield from _explanations(btm)
    yield from doubled(btm)
    for other in strayed(btm):  # only where another link is known then to lead there
        waiting = {link.id for link in other.links if link.end == NOWHERE}
        for found in _explanations(other):
            if len(waiting & {link.id for link in found.links if link.end == NOWHERE}) < len(waiting):
                yield found


def _explanations(btm):
    return filter(None, (explained(btm, *pair) for pair in twins(btm)))


def closings_of(btm: BtmMap) -> int:
    """Count the cycles of a map: searched links beyond those of a spanning tree."""
    parts = set(connected_parts((node.id for node in btm.nodes), btm.links).values())
    return sum(link.end != NOWHERE for link in btm.links) - len(btm.nodes) + len(parts)
