"""Behavioral Trace Maps as route graphs of Nav2, which leave something out; `json_form.to_json` keeps everything."""

import collections
import json
import math
from collections.abc import Mapping
from typing import Any

from jexplore.config import InputError
from jexplore.tracemap.passable import CONFLICTS
from jexplore.tracemap.record import NOWHERE, BtmMap, check_map

NAV2_IDS = 65536  # ids of nodes and edges must lie below: messages of the Route Server hold 16 bits
SHORTEST_M = 0.001  # least cost of an edge: the planner of the Route Server gives up over one that costs nothing

_NODE_MEASURES = ("inclination_deg", "step_m", "posture_deg")
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
    bearings = _both_bearings(btm)
    features = [
        _feature("Point", [node.x_m, node.y_m], _node_properties(node, frame, bearings(node))) for node in btm.nodes
    ]
    places = {node.id: [node.x_m, node.y_m] for node in btm.nodes}
    for number, link in enumerate(searched):
        for way, (start, end) in enumerate(((link.start, link.end), (link.end, link.start))):
            line = [places[start], places[end]]
            ends = {"id": first + 2 * number + way, "startid": start, "endid": end}
            features.append(_feature("LineString", line, {**ends, **_edge_properties(link, math.dist(*line))}))
    return {"type": "FeatureCollection", "features": features}


def _feature(kind, coordinates, properties):
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def _node_properties(node, frame, bearings):
    metadata = {"class": node.obstacle or node.type, "type": node.type}
    if node.obstacle:
        metadata["obstacle"] = node.obstacle
    metadata |= _measures(node, _NODE_MEASURES)
    return {"id": node.id, "frame": frame, "metadata": metadata | bearings | _extensions(node.attributes)}


def _edge_properties(link, chord_m):
    length_m = max(chord_m if link.length_m is None else link.length_m, SHORTEST_M)
    metadata = {"penalty": max(0.0, length_m - chord_m), **_measures(link, _LINK_MEASURES), "link": float(link.id)}
    return {"cost": length_m, "overridable": True, "metadata": metadata | _extensions(link.attributes)}


def _measures(record, names):
    return {name: value for name in names if (value := getattr(record, name)) is not None}


def _both_bearings(btm):
    """Return node -> angles between its links, and bearings of its un-searched ones, by their names in files."""
    unsearched = collections.defaultdict(list)
    for link in btm.links:
        if link.end == NOWHERE:
            unsearched[link.start].append(link.start_bearing_deg)
    return lambda node: {
        "angles_deg": btm.angles_deg(node.id),
        "unsearched_bearings_deg": unsearched.get(node.id, []),
    }


def _extensions(attributes):
    return {"attributes": _metadata(attributes)} if attributes else {}


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
