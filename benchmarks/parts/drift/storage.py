"""Bytes of a building as a trace map, as a packed grid and as a pose graph."""

import json
import math
import os
import zlib

import numpy as np
from scipy import ndimage

from jexplore.driving.settings import Tuning, for_world
from jexplore.driving.vehicle import BEAMS
from jexplore.extraction.extract import extract
from jexplore.grid import is_known, is_occupied
from jexplore.report.store import jsonable
from jexplore.studies import checks
from jexplore.tracemap.json_form import to_json
from jexplore.tracemap.passable import blockages_of
from jexplore.tracemap.record import NODE_TYPES, NOWHERE, OBSTACLE_SHAPES, STATUS, BtmMap, closings_of
from jexplore.worlds.readers.scans import ScanMap
from jexplore.worlds.world import World, with_ring

CELLS_A_BYTE = 4  # two bits a cell: unknown, free, occupied
POSE_EVERY_M = 1.0  # m of way per pose with a scan in a pose graph
POSE_BYTES = 3 * 4  # x, y, heading, float32
EDGE_BYTES = 2 * 4 + 3 * 4 + 6 * 4  # two poses, the motion between, the upper half of its information, float32
P_FREE = 0.25  # largest reflection probability of a free cell
READING_BYTES = 2  # a range in whole millimetres
UNKNOWN = -1  # of a measure in a packed record
_NODE = {"x_m": ("<i2", 100), "y_m": ("<i2", 100), "type": ("i1", 1), "inclination_deg": ("i1", 1),
         "step_m": ("i1", 100), "posture_deg": ("i1", 1)}  # fmt: skip
_LINK = {"start": ("<u2", 1), "end": ("<i2", 1), "status": ("i1", 1), "start_bearing_deg": ("<i2", 1),
         "end_bearing_deg": ("<i2", 1), "length_m": ("<i2", 100), "min_width_m": ("i1", 10), "opening_m": ("i1", 10),
         "max_step_m": ("i1", 100), "posture_deg": ("i1", 1), "max_roll_deg": ("i1", 1)}  # fmt: skip
"""Fields of packed records -> type, and steps a metre or degree."""


def storage(
    world: str | os.PathLike[str] | World, btm: BtmMap | None = None, *,
    drawn: ScanMap | None = None, cell_m: float = 0.1,
) -> dict[str, int]:  # fmt: skip
    """Count the bytes of a building in several forms.

    Args:
      world: name or `World`.
      btm: its map; by default the true one of a course, else that extracted from the finished plan, see
        `extraction.extract`.
      drawn: a grid map from scans; by default the finished plan, whose straight walls compress better.
      cell_m: edge of a cell, metres.

    Returns:
      Name -> bytes: `btm_json`, without spaces; `btm_packed`, see `packed_map`; `grid_packed`, two bits a cell of the
      building's bounding box; `pose_graph`, a pose with a scan and an edge to the next for every metre of searched
      link, and an edge for every link that closes a cycle. `_zlib` after the first three: compressed.
    """
    world = with_ring(*checks.ready_worlds([world], cell_m))
    free = ~world.occupied
    if btm is None and world.course is not None:
        btm = world.course.topology
    elif btm is None:  # the map that a robot should write there
        open_m = for_world(Tuning(), is_course=False).open_m
        btm = extract(free, np.ones_like(free), world.cell_m, open_m=open_m)
    text = json.dumps(jsonable(to_json(btm)), separators=(",", ":")).encode()
    forms = {"btm_json": text, "btm_packed": packed_map(btm), "grid_packed": _grid(_states(world, drawn))}
    found = {name: len(data) for name, data in forms.items()}
    found |= {f"{name}_zlib": len(zlib.compress(data, 9)) for name, data in forms.items()}
    return {**found, "pose_graph": _pose_graph(btm)}


def packed_map(btm: BtmMap) -> bytes:
    """Pack the map into two arrays of records, one after the other: 8 bytes a node, 16 a link, without attributes.

    Places, lengths and bearings are whole centimetres and degrees of 16 bits, widths and openings decimetres, steps
    centimetres and inclinations degrees of 8 bits; a type and its obstacle are one number, so are status and a link
    that is `blocked`. What a byte cannot hold is its largest number.
    """
    x_m, y_m = (min((getattr(node, name) for node in btm.nodes), default=0.0) for name in ("x_m", "y_m"))
    place = {node.id: i for i, node in enumerate(btm.nodes)} | {NOWHERE: NOWHERE}
    nodes, links = [], []
    for node in btm.nodes:
        shape = OBSTACLE_SHAPES.index(node.obstacle) if node.obstacle else 0
        kind = NODE_TYPES.index(node.type) + len(NODE_TYPES) * shape
        nodes.append(vars(node) | {"x_m": node.x_m - x_m, "y_m": node.y_m - y_m, "type": kind})
    for link in btm.links:
        status = STATUS.index(link.status) + len(STATUS) * bool(blockages_of(link))
        links.append(vars(link) | {"start": place[link.start], "end": place[link.end], "status": status})
    return _packed(nodes, _NODE) + _packed(links, _LINK)


def _packed(items, fields):
    """Pack records as whole numbers."""

    def whole(value, kind, scale):
        return UNKNOWN if value is None else min(round(value * scale), np.iinfo(kind).max)

    rows = [tuple(whole(item[name], *how) for name, how in fields.items()) for item in items]
    return np.array(rows, [(name, kind) for name, (kind, _) in fields.items()]).tobytes()


def _states(world, drawn):
    """Return states of cells, of a `ScanMap` or the plan: 0 unknown, 1 free, 2 occupied and next to a free one."""
    if drawn is not None:
        return np.asarray(is_known(drawn.grid)).astype(np.uint8) + np.asarray(is_occupied(drawn.grid, P_FREE))
    near_free = ndimage.binary_dilation(~world.occupied, np.ones((3, 3), bool))
    return (near_free * np.where(world.occupied, 2, 1)).astype(np.uint8)


def _grid(states):
    """Pack the bounding box of the known cells, two bits a cell."""
    seen = np.argwhere(states)
    (top, left), (bottom, right) = seen.min(axis=0), seen.max(axis=0) + 1
    flat = states[top:bottom, left:right].reshape(-1)
    four = np.pad(flat, (0, -len(flat) % CELLS_A_BYTE)).reshape(-1, CELLS_A_BYTE)
    return (four << np.array([0, 2, 4, 6], np.uint8)).sum(axis=1).astype(np.uint8).tobytes()


def _pose_graph(btm):
    """Return the bytes of poses, one scan each, and edges."""
    searched = [link for link in btm.links if link.end != NOWHERE]
    way_m = sum(link.length_m or 0.0 for link in searched)
    poses = 1 + math.ceil(way_m / POSE_EVERY_M)
    return poses * (POSE_BYTES + READING_BYTES * BEAMS) + (poses - 1 + closings_of(btm)) * EDGE_BYTES
