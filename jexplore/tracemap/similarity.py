"""Codes of trace maps: two maps with equal codes are equal but for measures."""

import dataclasses

from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node, check_map

_LETTER = {"terminal": "T", "divergence": "D", "free_space": "F", "obstacle": "O"}


@dataclasses.dataclass(frozen=True)
class Vertex:
    """Vertex of the ordered tree that stands for a map: a node, an un-searched link, an end of a closing link.

    A closing link leads to a node that has been reached by another way. Both its ends are leaves with its number.
    """

    label: str
    parent: int
    link: Link | None = None  # by which it hangs on its parent
    forward: bool = True  # true if that link starts at the parent
    node: Node | None = None


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
    tree = tree_of(check_map(btm))
    below = [[] for _ in tree]
    for i in range(len(tree) - 1, 0, -1):
        inner = ",".join(reversed(below[i]))
        below[tree[i].parent].append(tree[i].label + (f"({inner})" if inner else ""))
    return " + ".join(reversed(below[0]))


def tree_of(btm: BtmMap) -> list[Vertex]:
    """Return vertices in preorder; the first is an extra one above the first node of every connected part."""
    nodes, reached, closing = {node.id: node for node in btm.nodes}, set(), {}
    tree = [Vertex("", -1)]
    for root in btm.nodes:
        pending = [] if root.id in reached else [(root.id, None, 0, 0)]
        while pending:
            here, link, side, parent = pending.pop()
            hung = {"parent": parent, "link": link, "forward": side == 0}
            if here == NOWHERE:
                tree.append(Vertex("-", **hung))
                continue
            if link is not None and here in reached:
                tree.append(Vertex(f"={closing.setdefault(link.id, len(closing) + 1)}", **hung))
                continue
            reached.add(here)
            node, ends = nodes[here], btm.ends[here]
            tree.append(Vertex(_LETTER[node.type] + (f":{node.obstacle}" if node.obstacle else ""), node=node, **hung))
            if link is None:
                first = min(ends, key=lambda end: (end[3].end == NOWHERE, *end[1:3]), default=None)
                turn = ends.index(first) if first else 0
            else:
                turn = next(i for i, end in enumerate(ends) if end[1:3] == (link.id, 1 - side)) + 1
            order = ends[turn:] + ends[: turn if link is None else turn - 1]
            own = len(tree) - 1
            pending += [(way.start if at else way.end, way, at, own) for _, _, at, way in reversed(order)]
    return tree
