"""Equality of two trace maps, their differences, and the distance between them."""

import dataclasses
import itertools
import math

from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node, check, direction_deg


def code(btm: BtmMap) -> str:
    """Encode the map as a labelled rooted plane graph, in one line; equal codes mean maps equal but for measures.

    A node is T, D, F or O, an obstacle's shape behind a colon; in parentheses follow its other links, counter-clockwise
    from the one by which it is entered: the node reached, `-` for an un-searched one, or `=1`, the same at both ends,
    for one that closes a cycle. The walk is depth-first from the first node, there from the link of lowest id among the
    searched ones (or among all). Links of equal bearing count in order of their ids. Nodes that are not connected with
    the first follow after a `+`.

    Raises:
      InputError: not a proper map; see `record.check`.
    """
    return _code(_tree(check(btm)))


def same(a: BtmMap, b: BtmMap, tolerance_m: float | None = None, tolerance_deg: float | None = None) -> bool:
    """Return whether two maps have equal codes and, with tolerances, measures within them; see `differences`."""
    return not differences(a, b, tolerance_m, tolerance_deg)


def differences(
    a: BtmMap, b: BtmMap, tolerance_m: float | None = None, tolerance_deg: float | None = None
) -> list[str]:
    """List the differences between two maps, as sentences; none if they are the same.

    If the codes differ, that is the only difference: nodes would not correspond. Else corresponding nodes and links are
    compared, whatever their ids and the direction in which a link was followed; `opening_m` only of links that start at
    the same node. A measure that one of them lacks is a difference. Coordinates and bearings are compared as they
    stand: both maps must have one frame. Attributes do not count.

    Args:
      a, b: the maps.
      tolerance_m: largest difference of coordinates, lengths, widths and steps, metres; None leaves them out.
      tolerance_deg: the same of angles, degrees.

    Returns:
      List of text.
    """
    first, second = _tree(check(a)), _tree(check(b))
    if _code(first) != _code(second):
        return _departure(first, second)
    found, told = [], set()
    for one, other in zip(first, second):
        for kind in ("node", "link"):
            item, match = getattr(one, kind), getattr(other, kind)
            if item is not None and (kind, item.id) not in told:
                told.add((kind, item.id))
                turned = kind == "link" and one.forward != other.forward
                found += _measures(kind, item, match, turned, tolerance_m, tolerance_deg)
    return found


def distance(a: BtmMap, b: BtmMap) -> int:
    """Compute the graph distance of two maps: the least number of changes that make their codes equal.

    It is the edit distance of the trees that the codes write out, at unit costs. One change adds, removes or relabels
    one vertex: a node together with the link by which it is entered (one taken out of a way leaves its neighbours
    linked), an un-searched link, or one end of a link that closes a cycle, so such a link counts two. Zero if and only
    if the codes are equal. Exact for rooted plane trees; with cycles a heuristic, for it depends on where the walk
    closes them.

    Returns:
      int.

    Raises:
      InputError: not a proper map; see `record.check`.

    Source:
      Zhang and Shasha 1989, Simple fast algorithms for the editing distance between trees.
    """
    (label_a, left_a), (label_b, left_b) = (_postorder(_tree(check(btm))) for btm in (a, b))
    whole = [[0] * len(label_b) for _ in label_a]
    for i in _key_roots(left_a):
        for j in _key_roots(left_b):
            at_i, at_j = left_a[i], left_b[j]
            cost = [list(range(j - at_j + 2))] + [[x + 1] + [0] * (j - at_j + 1) for x in range(i - at_i + 1)]
            for u in range(at_i, i + 1):
                for v in range(at_j, j + 1):
                    x, y = u - at_i + 1, v - at_j + 1
                    least = min(cost[x - 1][y], cost[x][y - 1]) + 1
                    if left_a[u] == at_i and left_b[v] == at_j:
                        least = min(least, cost[x - 1][y - 1] + (label_a[u] != label_b[v]))
                        whole[u][v] = least
                    else:
                        least = min(least, cost[left_a[u] - at_i][left_b[v] - at_j] + whole[u][v])
                    cost[x][y] = least
    return whole[-1][-1]


# The ordered tree that stands for a map


@dataclasses.dataclass(frozen=True)
class _Vertex:
    """A node, the stub of an un-searched link, or an end of a closing link.

    A closing link leads to a node that has been reached by another way. Both its ends are leaves with its number.
    """

    label: str
    parent: int
    link: Link | None = None
    """By which it hangs on its parent."""
    forward: bool = True
    """True if that link starts at the parent."""
    node: Node | None = None


_LETTER = {"terminal": "T", "divergence": "D", "free_space": "F", "obstacle": "O"}


def _tree(btm):
    """Return vertices in preorder; the first is an extra one above the first node of every connected part."""
    around = ends_around(btm)
    nodes, reached, closing = {node.id: node for node in btm.nodes}, set(), {}
    tree = [_Vertex("", -1)]
    for root in btm.nodes:
        pending = [] if root.id in reached else [(root.id, None, 0, 0)]
        while pending:
            here, link, side, parent = pending.pop()
            hung = {"parent": parent, "link": link, "forward": side == 0}
            if here == NOWHERE:
                tree.append(_Vertex("-", **hung))
                continue
            if link is not None and here in reached:
                tree.append(_Vertex(f"={closing.setdefault(link.id, len(closing) + 1)}", **hung))
                continue
            reached.add(here)
            node, ends = nodes[here], around[here]
            tree.append(_Vertex(_LETTER[node.type] + (f":{node.obstacle}" if node.obstacle else ""), node=node, **hung))
            if link is None:
                first = min(ends, key=lambda end: (end[3].end == NOWHERE, *end[1:3]), default=None)
                turn = ends.index(first) if first else 0
            else:
                turn = next(i for i, end in enumerate(ends) if end[1:3] == (link.id, 1 - side)) + 1
            order = ends[turn:] + ends[: turn if link is None else turn - 1]
            own = len(tree) - 1
            pending += [(way.start if at else way.end, way, at, own) for _, _, at, way in reversed(order)]
    return tree


def ends_around(btm):
    """Return ends of links by node, counter-clockwise: `(bearing, id, 0 at the start of the link or 1, link)`."""
    around = {node.id: [] for node in btm.nodes}
    for link in btm.links:
        around[link.start].append((direction_deg(link.start_bearing_deg), link.id, 0, link))
        if link.end_bearing_deg is not None:
            around[link.end].append((direction_deg(link.end_bearing_deg), link.id, 1, link))
    return {node: sorted(ends, key=lambda end: end[:3]) for node, ends in around.items()}


def _code(tree):
    below = [[] for _ in tree]
    for i in range(len(tree) - 1, 0, -1):
        inner = ",".join(reversed(below[i]))
        below[tree[i].parent].append(tree[i].label + (f"({inner})" if inner else ""))
    return " + ".join(reversed(below[0]))


_TURNED = {"start_bearing_deg": "end_bearing_deg", "end_bearing_deg": "start_bearing_deg"}


def _measures(kind, item, match, turned, tolerance_m, tolerance_deg):
    """Yield sentences about the measures of two records; `turned` if one link was followed the other way."""
    for name in (field.name for field in dataclasses.fields(item)):
        unit, limit = ("m", tolerance_m) if name.endswith("_m") else ("degrees", tolerance_deg)
        if limit is None or not name.endswith(("_m", "_deg")) or (turned and name == "opening_m"):
            continue
        x, y = getattr(item, name), getattr(match, _TURNED.get(name, name) if turned else name)
        if x is None or y is None:
            apart = 0.0 if x is y else math.inf
        elif name.endswith("bearing_deg"):
            apart = min(direction_deg(x - y), direction_deg(y - x))
        else:
            apart = abs(x - y)
        if apart > limit:
            x, y = ("unknown" if value is None else f"{value:g}" for value in (x, y))
            yield f"{kind} {item.id} and {kind} {match.id}: {name} is {x} and {y}, {limit:g} {unit} are allowed"


_WORDS = {
    "T": "terminal node",
    "D": "divergence node",
    "F": "free space node",
    "O": "obstacle node",
    "-": "un-searched link",
    "=": "cycle-closing link end",
}


def _departure(first, second):
    """Describe where two trees differ: how many of what, and where a common walk through both ends."""
    found = []
    for mark, what in _WORDS.items():
        one, other = (sum(vertex.label[:1] == mark for vertex in tree) for tree in (first, second))
        if one != other:
            found.append(f"the first map has {one} {what}s, the second {other}")
    shape = [[(vertex.label, vertex.parent) for vertex in tree] for tree in (first, second)]
    at = next(i for i, (one, other) in enumerate(itertools.zip_longest(*shape)) if one != other)
    walk = " ".join(vertex.label for vertex in first[1:at])
    one, other = (_met(tree, at) for tree in (first, second))
    return [*found, f"after {walk or 'nothing'}, the first map has {one}, the second {other}"]


def _met(tree, at):
    if at == len(tree):
        return "no more"
    node = tree[tree[at].parent].node
    where = f"at node {node.id}" if node else "to begin with"
    return f"{tree[at].label} ({_WORDS[tree[at].label[0]]}) {where}"


def _postorder(tree):
    """Return labels in postorder, and of each vertex the place of the first in its subtree."""
    size, depth = [1] * len(tree), [0] * len(tree)
    for i in range(len(tree) - 1, 0, -1):
        size[tree[i].parent] += size[i]
    labels, left = [""] * len(tree), [0] * len(tree)
    for i, vertex in enumerate(tree):
        depth[i] = depth[vertex.parent] + 1 if i else 0
        place = i - depth[i] + size[i] - 1  # ancestors come later, descendants earlier
        labels[place], left[place] = vertex.label, place - size[i] + 1
    return labels, left


def _key_roots(left):
    return sorted({first: i for i, first in enumerate(left)}.values())
