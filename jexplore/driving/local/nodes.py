"""The trace map while it is written: nodes, their exits, what a look at the local map adds, routes."""

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from jexplore import btm
from jexplore.arrays.poses import wrapped
from jexplore.btm import Btm
from jexplore.driving.local.sight import SeenPlace
from jexplore.driving.vehicle import SCAN_RANGE_M
from jexplore.tracemap.record import NODE_TYPES

SAME_M = 0.5  # two places of a type no farther apart than this are one node,
SAME_RADII = 0.6  # or than this share of the smaller clearance
SAME_RAD = math.radians(35)  # two exits of a node less apart than this are one, or than twice that if they have one end
NEAR_M = SCAN_RANGE_M / 2  # a robot no farther than this from a node sees which exits it has
TRIES = 3  # times that the robot goes in vain to a node, to an exit's end or along a link before it gives that up
FAIL_M = 10.0  # a link along which it did not come counts as longer by this each time


def length_of(path: np.ndarray) -> float:
    """Return the length of a path `[n, 2]`."""
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def direction_out(path: np.ndarray) -> float:
    """Return the direction in which a path leaves its begin, radians."""
    away = np.hypot(*(path - path[0]).T) > SAME_M
    return math.atan2(*(path[int(away.argmax()) if away.any() else -1] - path[0])[::-1])


def _off_m(path, xy):
    return float(np.hypot(*(path - xy).T).min())


@dataclasses.dataclass(eq=False)
class Exit:
    """An exit of a node."""

    bearing: float  # radians
    path: np.ndarray  # [n, 2], metres, as far as it was seen
    to: int = -1  # node; -1: none yet
    tries: int = 0  # times that the robot has gone to its end in vain
    fails: int = 0  # times that the robot has not come along it


@dataclasses.dataclass(eq=False)
class Node:
    """A node."""

    xy: np.ndarray  # [2] float, metres
    type: str  # one of `NODE_TYPES`
    radius_m: float
    truth: np.ndarray  # [2] float, its true position, as far off as the robot when it first saw it
    exits: list[Exit] = dataclasses.field(default_factory=list)
    is_visited: bool = False
    tries: int = 0  # times that the robot has gone there in vain

    @property
    def reached_m(self) -> float:
        """Return the distance within which the robot is at the node."""
        return max(SAME_M, self.radius_m)


class TraceMap:
    """A trace map; node 0 is the start."""

    def __init__(self, start: np.ndarray, truth: np.ndarray) -> None:
        """Begin with the start `[2]`, metres, estimated and true."""
        self.nodes = [Node(start, "terminal", 0.0, truth, is_visited=True)]

    def note(self, seen: Sequence[SeenPlace], pose: np.ndarray, truth: np.ndarray) -> dict[int, int]:
        """Enter what a look at the local map shows.

        Args:
          pose, truth: `[3]`, of the robot.

        Returns:
          Place in `seen` -> node, of the places that are nodes.
        """
        node_of: dict[int, int] = {}
        for i, place in enumerate(seen):
            same = self._same(place, set(node_of.values()))
            if same is not None:
                node_of[i] = same
                node = self.nodes[same]
                if place.is_sure and place.type != "terminal":
                    node.radius_m = place.radius_m
                    if not node.is_visited:
                        node.truth = node.truth + place.xy - node.xy
                        node.xy = place.xy
            elif place.is_sure:
                node_of[i] = len(self.nodes)
                self.nodes.append(Node(place.xy, place.type, place.radius_m, place.xy + (truth - pose)[:2]))
        for i, at in node_of.items():
            self._note_exits(self.nodes[at], seen[i], node_of, math.dist(self.nodes[at].xy, pose[:2]) < NEAR_M)
        self._join_meeting(set(node_of.values()))
        return node_of

    def drop(self, i: int) -> None:
        """Remove a node; exits that led there lead into the unknown."""
        del self.nodes[i]
        for exit_ in (exit_ for node in self.nodes for exit_ in node.exits):
            exit_.to = -1 if exit_.to == i else exit_.to - (exit_.to > i)

    def _join_meeting(self, in_view):
        """Link a node out of view to one in view where the exit of one passes the end of the other's."""
        for i, node in enumerate(self.nodes):
            for exit_ in node.exits if i not in in_view else []:
                for at in in_view if exit_.to < 0 else []:
                    for other in self.nodes[at].exits:
                        off = np.hypot(*(other.path - exit_.path[-1]).T)
                        k = int(off.argmin())
                        if exit_.to < 0 and other.to < 0 and off[k] < SAME_M and length_of(other.path[k:]) > SAME_M:
                            path = np.concatenate([other.path[: k + 1], exit_.path[::-1]])
                            other.to, other.path, exit_.to, exit_.path = i, path, at, path[::-1]

    def _same(self, place, taken):
        """Return the node that a place is, None if it is new."""
        best, nearest = None, math.inf
        for i, node in enumerate(self.nodes):
            off = math.dist(node.xy, place.xy)
            limit = max(SAME_M, SAME_RADII * min(place.radius_m, node.radius_m))
            if node.type == place.type and i not in taken and off < min(limit, nearest):
                best, nearest = i, off
        return best

    @staticmethod
    def _note_exits(node, place, node_of, is_near):
        met = set()
        for way in place.ways:
            to = node_of.get(way.to, -1)

            def off(exit_, way=way, to=to):
                apart = abs(wrapped(way.bearing - exit_.bearing))
                return apart if apart < (2 * SAME_RAD if to >= 0 and exit_.to == to else SAME_RAD) else math.inf

            best = min((e for e in node.exits if id(e) not in met), key=off, default=None)
            if best is not None and off(best) < math.inf:
                met.add(id(best))
                if best.to < 0:
                    if to >= 0 or length_of(way.path) > length_of(best.path) + SAME_M / 2:  # it was seen to lead on
                        best.tries = 0
                    best.bearing, best.path, best.to = way.bearing, way.path, to
            elif (place.is_sure and is_near) or not node.exits:
                node.exits.append(Exit(way.bearing, way.path, to))
                met.add(id(node.exits[-1]))
        if place.is_sure and is_near:
            node.exits = [e for e in node.exits if id(e) in met or e.to >= 0 or e.tries >= TRIES]

    def link_driven(self, one: int, other: int, way: np.ndarray) -> None:
        """Link two nodes by the way `[n, 2]` that the robot has driven, if no route leads from one to the other."""
        if self.route(one, {other}) is None:
            for begin, end, path in ((one, other, way), (other, one, way[::-1])):
                self.nodes[begin].exits.append(Exit(direction_out(path), path, end))

    def forget_failures(self) -> bool:
        """Let links on which the robot failed be tried anew; return False without any."""
        failed = [exit_ for node in self.nodes for exit_ in node.exits if exit_.fails]
        for exit_ in failed:
            exit_.fails = 0
        return bool(failed)

    def route(self, begin: int, goals: set[int]) -> list[tuple[Exit, int]] | None:
        """Return the shortest way from a node to another of `goals`: exits and the nodes they lead to; None: none."""
        ends = [(i, e.to, e) for i, node in enumerate(self.nodes) for e in node.exits if e.to >= 0 and e.fails < TRIES]
        shortest: dict[tuple[int, int], tuple[float, Exit]] = {}
        for i, to, exit_ in ends:
            length = 0.1 + length_of(exit_.path) + FAIL_M * exit_.fails
            if length < shortest.get((i, to), (math.inf,))[0]:
                shortest[i, to] = length, exit_
        first, last = np.array(list(shortest), int).reshape(-1, 2).T
        lengths = [length for length, _ in shortest.values()]
        n = len(self.nodes)
        away, before = dijkstra(csr_matrix((lengths, (first, last)), (n, n)), indices=begin, return_predecessors=True)
        at = min(goals - {begin}, key=lambda i: away[i], default=None)
        if at is None or math.isinf(away[at]):
            return None
        found = []
        while at != begin:
            found.append((shortest[int(before[at]), at][1], at))
            at = int(before[at])
        return found[::-1]

    def to_btm(self, n_nodes: int, n_links: int) -> Btm:
        """Return the map as padded arrays: every link once, numbered as the nodes that have them."""
        blank = btm.empty(n_nodes, n_links)
        fields = {name: np.array(value) for name, value in blank.__dict__.items() if name != "overflow"}
        for i, node in enumerate(self.nodes[:n_nodes]):
            fields["x_m"][i], fields["y_m"][i] = node.xy
            fields["kind"][i], fields["radius_m"][i] = NODE_TYPES.index(node.type), node.radius_m
        found = list(self.links())
        links = [link for link in found if link[0] < n_nodes and link[1].to < n_nodes]
        for n, (i, exit_, back) in enumerate(links[:n_links]):
            fields["start"][n], fields["start_bearing"][n] = i, wrapped(exit_.bearing)
            fails = max(exit_.fails, back.fails if back else 0)
            fields["status"][n], fields["blocked"][n] = btm.UNSEARCHED, fails >= TRIES
            if exit_.to >= 0:
                fields["end"][n], fields["status"][n] = exit_.to, btm.SEARCHED
                fields["end_bearing"][n] = wrapped(direction_out(exit_.path[::-1]) if back is None else back.bearing)
                ends = self.nodes[i].xy, self.nodes[exit_.to].xy
                fields["length_m"][n] = length_of(np.array([ends[0], *exit_.path[1:-1], ends[1]]))
        room = {"n_nodes": (n_nodes, self.nodes), "n_links": (n_links, links)}
        counts = {name: np.array(min(most, len(items)), np.int32) for name, (most, items) in room.items()}
        over = np.array(max(len(self.nodes) - n_nodes, 0) + len(found) - int(counts["n_links"]), np.int32)
        return blank.replace(**(fields | counts), overflow=over)

    def links(self) -> Iterator[tuple[int, Exit, Exit | None]]:
        """Yield node, exit and the exit that leads back, if the way has an end; every pair of exits once.

        Ways that were seen before a node on them and those told by others are left out.
        """
        used, kept = set(), {}
        joined = {frozenset((i, e.to)) for i, node in enumerate(self.nodes) for e in node.exits if e.to >= 0}

        def is_told(i, exit_):
            k, pair, path = exit_.to, frozenset((i, exit_.to)), exit_.path
            between = [j for j in range(len(self.nodes)) if {frozenset((i, j)), frozenset((j, k))} <= joined]
            is_through = any(_off_m(path, self.nodes[j].xy) < SAME_M for j in between if j not in (i, k))
            same = kept.setdefault(pair, [])
            if is_through and not same:
                joined.discard(pair)
            is_double = any(_off_m(other, path[len(path) // 2]) < 2 * SAME_M for other in same)
            if not (is_through or is_double):
                same.append(path)
            return is_through or is_double

        for i, node in enumerate(self.nodes):
            for exit_ in node.exits:
                if id(exit_) not in used:
                    used.add(id(exit_))
                    others = self.nodes[exit_.to].exits if exit_.to >= 0 else []
                    others = [e for e in others if e.to == i and id(e) not in used]
                    path = exit_.path
                    back = min(others, key=lambda e, p=path: math.dist(e.path[0], p[-1]), default=None)
                    used.add(id(back))
                    if exit_.to in (-1, i) or not is_told(i, exit_):
                        yield i, exit_, back
