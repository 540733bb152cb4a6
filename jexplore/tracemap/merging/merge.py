"""Behavioral Trace Maps without a common frame become one."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jexplore.config import InputError, as_record, checked_names, require_different, require_kind, require_whole
from jexplore.tracemap.merging import notes
from jexplore.tracemap.merging.join import FROM, join
from jexplore.tracemap.merging.limits import Limits
from jexplore.tracemap.merging.match import NOTHING, Merging, match_maps
from jexplore.tracemap.merging.rigid import Move
from jexplore.tracemap.record import BtmMap, check_map, require_near


@checked_names
@dataclasses.dataclass(frozen=True)
class MergeResult:
    """Result of `merge_maps`."""

    outcome: Merging  # `MERGED` only if all maps are one
    map: BtmMap
    """The map that most maps are in; without a merge the one with most nodes. In the frame of the first map in it."""
    nodes: dict[str, dict[int, int]]  # name of a map in it -> node there -> node of `map`
    moves: dict[str, Move]  # name of a map in it -> what takes it into the frame of `map`
    matched: int  # nodes of `map` that more than one map has
    left: tuple[str, ...]  # names of the maps that are not in it
    evidence: float
    """Of the weakest merge, or of the best one refused: nats beyond what chance gives; -inf where nothing is alike, inf
    where all maps are equal."""
    margin: float  # evidence beyond the best match that excludes it, nats
    notes: tuple[str, ...]
    """Differences of the maps, as sentences: attributes, ways of one place with different ends, and nodes matched by
    their position alone."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    map: BtmMap
    moves: dict[str, Move]


@checked_names
def merge_maps(
    maps: Sequence[BtmMap],
    names: Sequence[str] | None = None,
    *,
    min_common: int = 3,
    limits: Limits | Mapping[str, Any] | None = None,
    on_progress: Callable[[int], object] = lambda compared: None,
) -> MergeResult:
    """Merge maps of one building, each in a frame of its own, to one map.

    The two maps with most evidence become one, again and again. Two become one only if they have nodes enough in
    common, if that is no chance, and if no other way to lay them on each other explains nearly as much: maps of
    passages that all look alike are refused. A map is neither scaled nor mirrored.

    Maps that are equal, node by node and link by link, are one without more ado: a map merged with itself is that map.

    Nodes and links of the result have an attribute `from`, their ids by name of the map. The first node is where the
    robot of the first map started. Attributes that maps give different values are in `conflicts`, with who says so;
    those of one run in its own frame, such as `moved`, are left out.

    Args:
      maps: two maps or more.
      names: of the maps; by default their numbers, from "0".
      min_common: least number of nodes that two maps must have in common.
      limits: how far maps of one place may be apart: `Limits`, or a mapping of some of its fields.
      on_progress: called with the number of pairs of maps that have been compared; all together (n - 1)^2 at most.

    Returns:
      `MergeResult`; that maps do not fit is an outcome.

    Raises:
      InputError: fewer than two maps, names that are not as many or not different, an improper map, places or
        lengths of 1000 km and more, or `merged_from`, `from` or `conflicts` that merging could not have written.
    """
    originals = named_maps(maps, names, least=2)
    limits = as_record("limits", {} if limits is None else limits, Limits)
    min_common = require_whole("min_common", min_common, 1, 10**6)
    parts, joins, refused = _merged(_distinct(originals), limits, min_common, on_progress)
    return _result(parts, joins, refused, originals)


def named_maps(maps: Sequence[BtmMap], names: Sequence[str] | None, least: int = 1) -> dict[str, BtmMap]:
    """Check maps of a building, `least` or more, and return them by name; see `merge_maps`."""
    words = {1: "one map or more", 2: "two maps or more"}[least]
    if len(maps) < least:
        raise InputError(f"expected {words}, got {len(maps) or 'none'}")
    names, checked = [str(i) for i in range(len(maps))] if names is None else list(names), []
    if len(names) != len(maps) or not all(isinstance(name, str) for name in names):
        raise InputError(f"expected a name for each of {len(maps)} maps, got {names!r}")
    for name, btm in zip(names, maps):
        require_kind("a map", btm, BtmMap)
        checked.append(check_map(btm))
        require_near(checked[-1], name)
        notes.require_sources(checked[-1], name)
    sources = [source for name, btm in zip(names, checked) for source in notes.sources_of(btm, name)]
    require_different("names of maps", sources)
    return dict(zip(names, checked))


def _distinct(originals):
    """Return the initial parts: equal maps that have measured something are one."""
    found = []  # the map without attributes, and names
    for name, btm in originals.items():
        bare = notes.stripped(btm)
        same = [names for other, names in found if other == bare and any(link.length_m for link in bare.links)]
        same[0].append(name) if same else found.append((bare, [name]))
    return [_Part(notes.stripped(bare, *names), {name: Move() for name in names}) for bare, names in found]


def _merged(parts, limits, min_common, on_progress):
    """Return parts that cannot be merged further, the matches that were made, and those refused at the end."""
    joins, known = [], {}  # joins: matches, and of which parts
    while True:
        pairs = list(itertools.combinations(parts, 2))
        for one, other in pairs:
            if (one, other) not in known:
                known[one, other] = match_maps(one.map, other.map, limits=limits, min_common=min_common)
                on_progress(len(known))
        fitting = [(known[pair], *pair) for pair in pairs if known[pair].outcome is Merging.MERGED]
        if not fitting:
            return parts, joins, [(known[pair], *pair) for pair in pairs]
        found, one, other = max(fitting, key=lambda pair: pair[0].evidence)
        joins.append((found, one, other))
        moves = {**one.moves, **{name: found.move.after(move) for name, move in other.moves.items()}}
        whole = _Part(join(one.map, other.map, found), moves)
        parts = [whole if part is one else part for part in parts if part is not other]


def _result(parts, joins, refused, originals):
    main = max(parts, key=lambda part: (len(part.moves), len(part.map.nodes)))
    own = [found for found, one, other in refused if main in (one, other)]
    if own:
        worst = max(own, key=lambda found: found.evidence)
    else:
        worst = min((found for found, _, _ in joins), key=lambda found: found.evidence, default=NOTHING)
    nodes = {name: {} for name in main.moves}
    for node in main.map.nodes:
        for name, key in node.attributes[FROM].items():
            nodes[name][key] = node.id
    btm = notes.restored(main.map, {name: originals[name] for name in originals if name in main.moves})
    return MergeResult(
        outcome=worst.outcome,
        map=btm,
        nodes=nodes,
        moves=main.moves,
        matched=sum(len(node.attributes[FROM]) > 1 for node in main.map.nodes),
        left=tuple(name for name in originals if name not in main.moves),
        evidence=worst.evidence,
        margin=worst.margin if worst.evidence > -math.inf else math.inf,
        notes=(*notes.conflicts(btm), *_remarks(joins, nodes)),
    )


def _remarks(joins, nodes):
    """Yield sentences about joins whose nodes were matched by their place, and about those that left contradictions."""
    for found, one, other in joins:
        if not one.moves.keys() <= nodes.keys():
            continue
        own = {node.id: next(iter(node.attributes[FROM].items())) for node in one.map.nodes}
        begun = [way.steps[0] for way, _ in found.contradictions]
        names, others, n = ", ".join(one.moves), ", ".join(other.moves), len(begun)
        ways = f"{n} way leads" if n == 1 else f"{n} ways lead"
        for keys, what in (
            (found.beside, f"one in {names} and in {others} by place and bearings alone"),
            ([link.start if ahead else link.end for link, ahead in begun],
             f"{ways} elsewhere in {others} than in {names}; the map has both"),
        ):  # fmt: skip
            if keys:
                at = sorted({nodes[name][key] for name, key in map(own.__getitem__, keys)})
                yield f"node{'s' * (len(at) > 1)} {', '.join(map(str, at))}: {what}"
