"""A station's page: Behavioral Trace Maps of several robots as one web page on which routes are asked for."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from jexplore.report.page.assemble import map_page
from jexplore.tracemap import passable
from jexplore.tracemap.merging.join import FROM
from jexplore.tracemap.merging.notes import MERGED_FROM, sources_of
from jexplore.tracemap.record import BtmMap, Link, Node
from jexplore.tracemap.route import LENGTH_UNIT_M, MapIndex

MEASURES = ("name", "width_m", "max_step_m", "max_slope_deg")  # of a robot, for the page


@dataclasses.dataclass(frozen=True)
class MapPanel:
    """A map of the page, in a frame of its own."""

    name: str
    map: BtmMap
    """A proper one; see `record.check_map`."""
    maps: tuple[str, ...]
    """Names of the maps that it was made of."""
    note: str = ""
    """Reason for standing apart, or a note about its frame: a sentence."""


def station_page(
    title: str, panels: Sequence[MapPanel], robots: Sequence[passable.RobotBody], notes: Sequence[str] = ()
) -> str:
    """Return maps as one HTML file: no network, no server, no other file. It is plain ASCII.

    The first panel is shown large; `robots` can be chosen by name; `notes` are sentences, such as what the maps say
    differently. The page finds what a robot may use.
    """
    writers = list(dict.fromkeys(writer for panel in panels for writer in sources_of(panel.map, panel.name)))
    data = {
        "robots": [{name: getattr(robot, name) for name in MEASURES} for robot in robots],
        "writers": writers,
        "notes": list(notes),
        "panels": [_panel(panel) for panel in panels],
    }
    return map_page("station", title, data, ("routes.js", "station.js", "station_side.js"))


def _panel(panel: MapPanel) -> dict[str, Any]:
    """Return a map's data for the page, plain JSON types; ids as keys become text."""
    btm, index = panel.map, MapIndex(panel.map)
    about = {key: value for key, value in btm.attributes.items() if key not in (MERGED_FROM, passable.CONFLICTS)}
    return {
        "name": panel.name,
        "maps": list(panel.maps),
        "note": panel.note,
        "attributes": about,
        "conflicts": btm.attributes.get(passable.CONFLICTS, {}),
        "nodes": [_node(node, panel) for node in btm.nodes],
        "links": [_link(link, panel, index) for link in btm.links],
    }


def _item(item: Node | Link, panel: MapPanel) -> dict[str, Any]:
    """Return fields of a node or link; its sources and their differences, apart from the other attributes."""
    own = dict(item.attributes)
    told = own.pop(FROM, {panel.name: item.id}) if MERGED_FROM in panel.map.attributes else {panel.name: item.id}
    return {**vars(item), "from": told, "conflicts": own.pop(passable.CONFLICTS, {}), "attributes": own}


def _node(node: Node, panel: MapPanel) -> dict[str, Any]:
    bearings, angles = panel.map.bearings_deg(node.id), panel.map.angles_deg(node.id)
    return {
        **_item(node, panel),
        "bearings_deg": bearings,
        "angles_deg": angles,
        "unknown": list(passable.unknowns_at(node)),
    }


def _link(link: Link, panel: MapPanel, index: MapIndex) -> dict[str, Any]:
    metres, nodes = index.length_m.get(link.id), index.nodes
    blocks = passable.blockages_of(link)
    return {
        **_item(link, panel),
        "step_m": passable.step_of(link, nodes),
        "inclination_deg": passable.inclination_of(link, nodes),
        "blocked": bool(blocks),
        "blocks": [vars(block) for block in blocks],
        "called": passable.link_name(link),
        "unknown": list(passable.unknowns(link, nodes)),
        "doubts": list(index.doubts(link.id)),
        "metres": metres,
        "length_mm": None if metres is None else round(metres / LENGTH_UNIT_M),
    }
