"""The picture by which a Behavioral Trace Map shows itself: links as lines, nodes as marks with their ids.

Plain Python: importing this loads neither numpy nor Pillow.
"""

import math
from typing import Any

from jexplore.arrays.pictures import LONG_PX, written

SUPERSAMPLING = 3  # supersampling factor
EDGE_PX = 26  # round the map
MARK_PX = 6
STUB_PX = 16  # of a link that nobody has followed
MIN_SIDE_M = 1.0  # side of a map, lest a single node fill the picture
NODE_MARKS = {"terminal": "□", "divergence": "○", "free_space": "◇", "obstacle": "△"}  # marker of nodes, by type
_CORNERS = {"terminal": (4, 45), "divergence": (24, 0), "free_space": (4, 0), "obstacle": (3, 90)}
_COLOURS = {"terminal": "#ffffff", "divergence": "#f0e442", "free_space": "#56b4e9", "obstacle": "#cc79a7"}


def nodes_and_links(btm: Any) -> bytes:
    """Draw a map of one node or more as the bytes of a PNG, about `LONG_PX` on its longer side.

    Squares are terminals, circles divergences, diamonds free spaces, triangles obstacles; links that nobody has
    followed are short grey strokes.
    """
    from PIL import Image, ImageDraw, ImageFont

    xs, ys = [node.x_m for node in btm.nodes], [node.y_m for node in btm.nodes]
    width_m, height_m = (max(max(axis) - min(axis), MIN_SIDE_M) for axis in (xs, ys))
    scale = (LONG_PX - 2 * EDGE_PX) / max(width_m, height_m) * SUPERSAMPLING
    size = [round(scale * side + 2 * EDGE_PX * SUPERSAMPLING) for side in (width_m, height_m)]
    image = Image.new("RGB", (size[0], size[1]), "white")
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(11 * SUPERSAMPLING)
    left = size[0] / 2 - scale * (max(xs) + min(xs)) / 2
    bottom = size[1] / 2 + scale * (max(ys) + min(ys)) / 2
    at = {node.id: (left + scale * node.x_m, bottom - scale * node.y_m) for node in btm.nodes}
    for link in btm.links:
        start = at[link.start]
        if link.end in at and link.end != link.start:
            draw.line([start, at[link.end]], fill="black", width=SUPERSAMPLING)
        else:
            bearings = [link.start_bearing_deg, *([link.end_bearing_deg] if link.end in at else [])]
            for bearing in bearings:
                end = _beside(start, bearing, STUB_PX)
                draw.line([start, end], fill="black" if link.end in at else "#999999", width=SUPERSAMPLING)
    for node in btm.nodes:
        sides, turn = _CORNERS[node.type]
        corners = [_beside(at[node.id], turn + 360 * i / sides, MARK_PX) for i in range(sides)]
        draw.polygon(corners, fill=_COLOURS[node.type], outline="black", width=SUPERSAMPLING)
        draw.text(_free_side(btm, node.id, at), str(node.id), fill="black", font=font, anchor="mm")
    return written(image.reduce(SUPERSAMPLING))


def _beside(place, bearing_deg, px):
    turn = math.radians(bearing_deg)
    return place[0] + SUPERSAMPLING * px * math.cos(turn), place[1] - SUPERSAMPLING * px * math.sin(turn)


def _free_side(btm, node_id, at):
    """Return the direction for a node's id: the middle of the widest angle between its links."""
    bearings, angles = btm.bearings_deg(node_id), btm.angles_deg(node_id)
    widest = max(range(len(angles)), key=angles.__getitem__, default=None)
    bearing = 90.0 if widest is None else bearings[widest] + angles[widest] / 2
    return _beside(at[node_id], bearing, 15)
