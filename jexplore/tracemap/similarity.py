"""Codes of trace maps: two maps with equal codes are equal but for measures."""

from collections.abc import Iterator
from typing import Any

from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node, check_map

_LETTER = {"terminal": "T", "divergence": "D", "free_space": "F", "obstacle": "O"}


def code(btm: BtmMap) -> str:
    """Encode the map as a labelled rooted plane graph, in one line; equal codes mean maps equal but for measures.

    A node is T, D, F or O, an obstacle's shape behind a colon; in parentheses follow its other links, counter-clockwise
    from the one by which it is entered: the node reached, `-` for an un-searched one, or `=1`, the same at both ends,
    for one that closes a cycle. The walk is depth-first from the first node, there from the link of lowest id among the
    searched ones (or among all). Links of equal bearing count in order of their ids. Nodes that are not connected with
    the first follow after a `+`.

    Raises:
      InputError: not a proper map; see `record.check_map`.
    """
    return "".join(text for text, *_ in pieces_of(check_map(btm)))


def pieces_of(btm: BtmMap) -> Iterator[tuple[str, Node | None, Link | None, int]]:
    """Yield the code of a proper map in pieces: the text, the node, the link by which the walk came there and whether
    from its end, 1, or its start, 0; a piece of punctuation has neither node nor link.
    """
    nodes, reached, closing = {node.id: node for node in btm.nodes}, set(), {}
    for root in btm.nodes:
        pending: list[Any] = [] if root.id in reached else [(root.id, None, 0), *([" + "] if reached else [])]
        while pending:
            piece = pending.pop()
            if isinstance(piece, str):
                yield piece, None, None, 0
                continue
            here, link, side = piece
            if here == NOWHERE:
                yield "-", None, link, side
                continue
            if link is not None and here in reached:
                yield f"={closing.setdefault(link.id, len(closing) + 1)}", None, link, side
                continue
            reached.add(here)
            node, ends = nodes[here], btm.ends[here]
            yield _LETTER[node.type] + (f":{node.obstacle}" if node.obstacle else ""), node, link, side
            if link is None:
                first = min(ends, key=lambda end: (end[3].end == NOWHERE, *end[1:3]), default=None)
                turn = ends.index(first) if first else 0
                order = ends[turn:] + ends[:turn]
            else:
                turn = next(i for i, end in enumerate(ends) if end[1:3] == (link.id, 1 - side))
                order = ends[turn + 1 :] + ends[:turn]
            told = [part for *_, at, way in order for part in (",", (way.start if at else way.end, way, at))]
            pending += reversed(["(", *told[1:], ")"] if told else [])
