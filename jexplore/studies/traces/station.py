"""A station: the Behavioral Trace Maps of several robots as one page for an operator.

Plain Python: importing this loads neither jax nor numpy.
"""

from collections.abc import Callable, Sequence
from typing import Any

from jexplore.config import checked_names
from jexplore.driving.settings import ROBOTS
from jexplore.report.page.station import MapPanel, station_page
from jexplore.tracemap.merging import notes
from jexplore.tracemap.merging.match import Merging, match_maps
from jexplore.tracemap.merging.merge import MergeResult, merge_maps, named_maps
from jexplore.tracemap.merging.rigid import Move
from jexplore.tracemap.record import BtmMap

GLOBAL_MAP = "global map"
WHY = {
    Merging.NOT_ENOUGH_IN_COMMON: "it has not enough in common with the other maps",
    Merging.AMBIGUOUS: "it could be laid on the other maps in more than one way",
}
"""Why a map stands apart from a global map."""
WHY_NONE = {
    Merging.NOT_ENOUGH_IN_COMMON: "no two of the maps have enough in common",
    Merging.AMBIGUOUS: "the maps could be laid on each other in more than one way",
}
"""Why there is no global map."""


@checked_names
def station(maps: Sequence[BtmMap], names: Sequence[str] | None = None, *, title: str | None = None) -> str:
    """Show maps of robots as one HTML file that works without a network: the maps drawn, and routes over them.

    Maps that fit are merged as by `merge_maps`; the others are shown next to the global map, each in its own frame.

    Args:
      maps: one or more, such as `jx.btm.read_btm("btm.json")`.
      names: of the maps; by default their numbers, from "0".
      title: of the page; by default the names.

    Returns:
      The page, text, plain ASCII.
    """
    return page_from(*panels_of(maps, names), title)


def page_from(panels: Sequence[MapPanel], said: Sequence[str], title: str | None = None) -> str:
    """Make the page of the result of `panels_of`."""
    names = [name for panel in panels for name in panel.maps]
    return station_page(title or f"Station: {', '.join(names)}", panels, list(ROBOTS.values()), said)


def panels_of(
    maps: Sequence[BtmMap],
    names: Sequence[str] | None = None,
    on_progress: Callable[[int], object] = lambda compared: None,
) -> tuple[list[MapPanel], list[str]]:
    """Merge maps as far as they fit.

    Return panels, the map that most maps are in first; and what merged maps say differently, sentences: attributes,
    and ways of one place that lead elsewhere.
    """
    given = named_maps(maps, names)
    groups: list[MergeResult] = []
    left, outcome = given, Merging.MERGED
    while len(left) > 1:
        once: Any = {} if groups else {"on_progress": on_progress}
        found = merge_maps(list(left.values()), list(left), **once)
        outcome = found.outcome
        if len(found.moves) < 2:
            break
        groups.append(found)
        left = {name: left[name] for name in found.left}
    main = groups[0].map if groups else None
    panels = [_joined(found, given, main) for found in groups]
    for name, btm in left.items():
        why = "" if len(given) == 1 else WHY_NONE[outcome] if main is None else WHY[_outcome(main, btm)]
        panels.append(MapPanel(name, btm, (name,), why and f"Stands apart: {why}."))
    said = [line for found in groups for line in found.notes]
    return panels, said + [line for btm in left.values() for line in notes.conflicts(btm)]


def _joined(found: MergeResult, given, main):
    maps = tuple(name for name in given if name in found.moves)
    note = f"In the frame of {next(name for name, move in found.moves.items() if move == Move())}."
    if found.map is main:
        return MapPanel(GLOBAL_MAP, found.map, maps, note)
    return MapPanel(" and ".join(maps), found.map, maps, f"Stands apart: {WHY[_outcome(main, found.map)]}. {note}")


def _outcome(main, btm):
    """Explain why a map is not part of another. If it would fit alone, the maps merged with it do not."""
    outcome = match_maps(main, btm).outcome
    return outcome if outcome in WHY else Merging.NOT_ENOUGH_IN_COMMON
