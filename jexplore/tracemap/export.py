"""Behavioral Trace Maps as route graphs of Nav2, which leave something out; `json_form.to_json` keeps everything."""

import json
import math
from collections.abc import Mapping
from typing import Any

from jexplore.config import InputError
from jexplore.tracemap.passable import CONFLICTS
from jexplore.tracemap.record import NOWHERE, BtmMap, check_map

NAV2_IDS = 65536  # ids of nodes and edges must lie below: messages of the Route Server hold 16 bits
SHORTEST_M = 0.001  # least cost of an edge: the planner of the Route Server gives up over one that costs nothing

_NODE_MEASURES = ("obstacle", "inclination_deg", "step_m", "posture_deg")
_LINK_MEASURES = ("length_m", "min_width_m", "posture_deg", "max_roll_deg", "max_step_m", "opening_m")


def geojson(btm: BtmMap) -> dict[str, Any]:
    """Convert the map to a GeoJSON route graph for the Nav2 Route Server, for `store.write_json`.

    A node becomes a Point under its own id, a searched link two LineStrings, one each way, under ids that follow the
    highest one of the nodes. Un-searched links lead nowhere, which the server refuses; they are in the metadata of
    their nodes, as `unsearched_bearings_deg`. An edge's `penalty` is what its length exceeds the straight line, since
    the server's distance scorer measures that; its `cost`, used without scorers, is the length, 1 mm or more. `class`
    is for the semantic scorer: the shape of an obstacle, else the type of the node.

    Metadata are text, truth values, floats and flat lists of them, as the server's loader needs: unknown measures are
    left out, extensions lie below `attributes` with integers as floats, and an attribute that is null, nested deeper in
    lists or too large for a float is JSON text there.

    Raises:
      InputError: not a proper map, no searched link (the server refuses a graph without edges), or ids of 65536 and
        above.

    Source:
      The geojson loader, distance, penalty and semantic scorers of nav2_route.
    """
    btm = check_map(btm)
    conflicts = btm.attributes.get(CONFLICTS)
    is_disputed = isinstance(conflicts, Mapping) and "frame" in conflicts
    # That of the map; `odom` where the maps that it was made of differ in that, `map` where it has none.
    frame = str(btm.attributes.get("frame", "odom" if is_disputed else "map"))
    searched = [link for link in btm.links if link.end != NOWHERE]
    if not searched:
        raise InputError("a route graph must have an edge: the map has no searched link")
    first = max(node.id for node in btm.nodes) + 1
    last = first + 2 * len(searched) - 1
    if last >= NAV2_IDS:
        raise InputError(f"ids of a route graph must lie below {NAV2_IDS}, those of this map would reach {last}")
    places = {node.id: [node.x_m, node.y_m] for node in btm.nodes}
    features = []
    for node in btm.nodes:
        metadata = {"class": node.obstacle or node.type, "type": node.type, **_told(node, _NODE_MEASURES)}
        stubs = sorted((end[3] for end in btm.ends[node.id] if end[3].end == NOWHERE), key=lambda link: link.id)
        metadata["angles_deg"] = btm.angles_deg(node.id)
        metadata["unsearched_bearings_deg"] = [link.start_bearing_deg for link in stubs]
        features.append(("Point", places[node.id], {"id": node.id, "frame": frame, "metadata": metadata}))
    for number, link in enumerate(searched):
        for way, (start, end) in enumerate(((link.start, link.end), (link.end, link.start))):
            line = [places[start], places[end]]
            length_m = max(math.dist(*line) if link.length_m is None else link.length_m, SHORTEST_M)
            metadata = {"penalty": max(0.0, length_m - math.dist(*line)), "link": float(link.id)}
            own = {"id": first + 2 * number + way, "startid": start, "endid": end, "cost": length_m}
            own |= {"overridable": True, "metadata": metadata | _told(link, _LINK_MEASURES)}
            features.append(("LineString", line, own))
    return {
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "properties": own, "geometry": {"type": kind, "coordinates": coordinates}}
            for kind, coordinates, own in features
        ],
    }


def _told(record, names):
    """Return what a record tells by these names, and its extensions."""
    found = {name: value for name in names if (value := getattr(record, name)) is not None}
    return {**found, "attributes": _metadata(record.attributes)} if record.attributes else found


def _metadata(value, depth=0):
    """Convert a value to metadata of the Route Server; lists stay only if they hold plain values."""
    if isinstance(value, dict):
        return {key: _metadata(item) for key, item in value.items()}
    if isinstance(value, list) and depth == 0 and not any(isinstance(item, dict) for item in value):
        return [_metadata(item, depth=1) for item in value]
    if isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, float)) and abs(value) < 2**127:  # single precision
        return float(value)
    return json.dumps(value, ensure_ascii=False)
