"""Attributes of merged maps, and their sources."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from jexplore.config import InputError, shown
from jexplore.tracemap.merging.join import FROM
from jexplore.tracemap.passable import BLOCKED, BLOCKED_FOR, CONFLICTS
from jexplore.tracemap.record import BtmMap

MERGED_FROM = "merged_from"  # attribute of a merged map: names of the maps that it was made of
OF_A_RUN = ("moved", "profile_variance_m2", "seed", "overflow")
"""Attributes that mean nothing beyond the run that wrote them, in its own frame: a merged map has none of them."""
OF_A_WRITER = ("robot", "frame")  # attributes that tell the maps apart and are no dispute about the building


def sources_of(btm: BtmMap, name: str) -> list[str]:
    """Return names of the maps that a map was made of: its own, if it was not merged."""
    return list(btm.attributes.get(MERGED_FROM, [name]))


def stripped(btm: BtmMap, *names: str) -> BtmMap:
    """Strip the map of all attributes but `FROM`, by its names if there are any."""

    def bare(item):
        return dataclasses.replace(item, attributes={FROM: dict.fromkeys(names, item.id)} if names else {})

    return BtmMap(tuple(map(bare, btm.nodes)), tuple(map(bare, btm.links)))


def restored(btm: BtmMap, originals: Mapping[str, BtmMap]) -> BtmMap:
    """Add the attributes of the originals, by name, to a joined map of stripped ones.

    Values that only some maps have, or that agree, are kept; where they differ they go to `CONFLICTS`. Attributes in
    `OF_A_RUN` are left out. Merged maps among the originals pass on their own sources.
    """
    items = {
        name: ({node.id: node for node in one.nodes}, {link.id: link for link in one.links})
        for name, one in originals.items()
    }

    def filled(item, kind):
        told = [(name, items[name][kind][key]) for name, key in item.attributes[FROM].items()]
        sources = {}
        for name, one in told:
            sources |= one.attributes.get(FROM, {name: one.id})
        said = [(list(one.attributes.get(FROM, [name])), one.attributes) for name, one in told]
        return dataclasses.replace(item, attributes={**_joined(said), FROM: sources})

    said = [(sources_of(one, name), one.attributes) for name, one in originals.items()]
    sources = [source for names, _ in said for source in names]
    return BtmMap(
        tuple(filled(node, 0) for node in btm.nodes),
        tuple(filled(link, 1) for link in btm.links),
        {**_joined(said), MERGED_FROM: sources},
    )


def conflicts(btm: BtmMap) -> list[str]:
    """List the differences of the maps that one was made of, in sentences."""
    found = []
    for what, item in _named(btm):
        for name, told in item.attributes.get(CONFLICTS, {}).items():
            if name in OF_A_WRITER:
                continue
            found.append(
                f"{what}: {name} is " + " and ".join(f"{shown(t['value'])} in {', '.join(t['from'])}" for t in told)
            )
    return found


def require_sources(btm: BtmMap, name: str) -> None:
    """Refuse a map whose `MERGED_FROM`, `FROM` or `CONFLICTS` merging could not have written: an `InputError`."""
    sources, is_merged = btm.attributes.get(MERGED_FROM), MERGED_FROM in btm.attributes
    if is_merged and not _are_names(sources):
        raise InputError(f"{name}: {MERGED_FROM}: expected a list of names of maps, got {shown(sources)}")
    for what, item in _named(btm)[1:]:
        own, is_there = item.attributes.get(FROM), FROM in item.attributes
        if is_there and not is_merged:
            raise InputError(f'{name}: {what}: expected no attribute "{FROM}", got {shown(own)}')
        if is_merged and not _are_ids(own, sources):
            wanted = f"a {FROM} with ids by names in {MERGED_FROM}"
            raise InputError(f"{name}: {what}: expected {wanted}, got {shown(own)}")
    for what, item in _named(btm):
        told = item.attributes.get(CONFLICTS, {})
        if not (isinstance(told, dict) and all(_is_told(*pair) for pair in told.items())):
            wanted = f"{CONFLICTS} with lists of {{from, value}} by attribute"
            raise InputError(f"{name}: {what}: expected {wanted}, got {shown(told)}")


def _named(btm):
    return [("the map", btm), *((f"node {n.id}", n) for n in btm.nodes), *((f"link {n.id}", n) for n in btm.links)]


def _are_names(value):
    return isinstance(value, list) and len(value) > 0 and all(isinstance(name, str) for name in value)


def _are_ids(value, names):
    is_filled = isinstance(value, dict) and len(value) > 0
    return is_filled and all(name in names and type(key) is int for name, key in value.items())


def _is_told(attribute, told):
    return (
        attribute not in (FROM, MERGED_FROM, CONFLICTS)
        and isinstance(told, list)
        and len(told) > 0
        and all(isinstance(one, dict) and one.keys() == {"from", "value"} and _are_names(one["from"]) for one in told)
    )


def _joined(said: Sequence[tuple[list[str], Mapping[str, Any]]]) -> dict[str, Any]:
    """Merge the attributes of one item from its sources: `(names, attributes)`.

    A link blocked for an unnamed robot is blocked for all: that is kept in addition to named robots.
    """
    values: dict[str, list[dict[str, Any]]] = {}
    names_robots = any(BLOCKED_FOR in {**own, **own.get(CONFLICTS, {})} for _, own in said)
    for names, attributes in said:
        named = {**attributes, **attributes.get(CONFLICTS, {})}
        if names_robots and attributes.get(BLOCKED) and BLOCKED_FOR not in named:
            attributes = {**attributes, BLOCKED_FOR: None}
        for key, value in attributes.items():
            if key not in (FROM, MERGED_FROM, CONFLICTS, *OF_A_RUN):
                _add(values.setdefault(key, []), names, value)
        for key, told in attributes.get(CONFLICTS, {}).items():
            for one in told if key not in OF_A_RUN else ():
                _add(values.setdefault(key, []), one["from"], one["value"])
    plain = {key: told[0]["value"] for key, told in values.items() if len(told) == 1}
    differing = {key: told for key, told in values.items() if len(told) > 1}
    return {**plain, **({CONFLICTS: differing} if differing else {})}


def _add(told, names, value):
    for one in told:
        if one["value"] == value and type(one["value"]) is type(value):
            one["from"] += [name for name in names if name not in one["from"]]
            return
    told.append({"from": list(names), "value": value})
