"""Behavioral Trace Maps as padded arrays: records of nodes and links, how they grow, and what one may ask of them.

A map is rooted: node 0 is where the robot started. Links leave a node in a direction; one that has not been followed
has no other end. What does not fit is counted, never written over.

`jx.btm` has besides the settings of robots that write such maps: `trace`, `route`, `merge_maps` and the other names of
`btm_names.pyi`, which are loaded when they are first used.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Self

import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array

from jexplore.arrays.loops import settled
from jexplore.arrays.poses import wrapped
from jexplore.lazy import read_stub as _read
from jexplore.tracemap.record import NODE_TYPES, NOWHERE, OBSTACLE_SHAPES, STATUS, BtmMap, Link, Node, direction_deg

if TYPE_CHECKING:
    from jexplore.btm_names import *  # noqa: F403  # pyright: ignore[reportMissingModuleSource]
else:
    _LAZY = _read(__name__, "btm_names.pyi")
    __getattr__ = _LAZY.get

    def __dir__():
        own = [name for name, value in globals().items() if getattr(value, "__module__", None) == __name__]
        return sorted({*(name for name in own if not name.startswith("_")), *_LAZY.module_of})


TERMINAL, DIVERGENCE, FREE_SPACE, OBSTACLE = range(len(NODE_TYPES))
SLOPE, STAIRS = range(len(OBSTACLE_SHAPES))
UNSEARCHED, SEARCHED = range(len(STATUS))
NONE = -1
NO_WAY_M = np.float32(1e9)


@struct.dataclass
class Btm:
    """A map of at most N nodes and M links. Unused slots hold `NONE` and NaN."""

    x_m: Array  # [N] float32
    y_m: Array  # [N] float32
    kind: Array  # [N] int32, place in `NODE_TYPES`
    radius_m: Array  # [N] float32, of a divergence's circle; 0 for other nodes
    obstacle: Array  # [N] int32, place in `OBSTACLE_SHAPES`
    inclination_deg: Array  # [N] float32, of an obstacle
    step_m: Array  # [N] float32, of stairs
    posture_deg: Array  # [N] float32, the robot's largest inclination there
    intervention: Array  # [N] int32, how often the operator had to help after this node
    variance_m2: Array  # [N] float32, residual variance of an obstacle's height profile
    start: Array  # [M] int32, node
    end: Array  # [M] int32, node
    status: Array  # [M] int32, place in `STATUS`
    blocked: Array  # [M] bool, the robot cannot follow it
    length_m: Array  # [M] float32
    min_width_m: Array  # [M] float32
    link_posture_deg: Array  # [M] float32
    max_roll_deg: Array  # [M] float32
    max_step_m: Array  # [M] float32
    start_bearing: Array  # [M] float32, radians
    end_bearing: Array  # [M] float32, radians
    opening_m: Array  # [M] float32
    moved_x_m: Array  # [M] float32, from its first node to the other as the odometry had it, in the first's frame
    moved_y_m: Array  # [M] float32, y of the same
    turned: Array  # [M] float32, how far the other end's frame is turned against the first's, radians; NaN: unknown
    n_nodes: Array  # int32, nodes in use
    n_links: Array  # int32, links in use
    overflow: Array  # int32, nodes and links that did not fit
    replace: ClassVar[Callable[..., Self]]


def empty(n_nodes: int, n_links: int) -> Btm:
    """Return a map without nodes, with room for `n_nodes` nodes and `n_links` links. Both static."""

    def full(n, value, dtype):
        return jnp.full(n, value, dtype)

    nodes = dict.fromkeys(("x_m", "y_m", "inclination_deg", "step_m", "posture_deg", "variance_m2"), jnp.nan)
    measures = ("length_m", "min_width_m", "link_posture_deg", "max_roll_deg", "max_step_m", "opening_m")
    links = dict.fromkeys((*measures, "start_bearing", "end_bearing", "moved_x_m", "moved_y_m", "turned"), jnp.nan)
    return Btm(
        **{name: full(n_nodes, value, jnp.float32) for name, value in nodes.items()},
        **{name: full(n_links, value, jnp.float32) for name, value in links.items()},
        radius_m=full(n_nodes, 0, jnp.float32),
        **{name: full(n_nodes, NONE, jnp.int32) for name in ("kind", "obstacle")},
        intervention=full(n_nodes, 0, jnp.int32),
        **{name: full(n_links, NONE, jnp.int32) for name in ("start", "end", "status")},
        blocked=full(n_links, False, bool),
        n_nodes=jnp.int32(0),
        n_links=jnp.int32(0),
        overflow=jnp.int32(0),
    )


def _put(array, at, value):
    """Replace one entry of `array`; an index beyond the last does nothing."""
    # Of so few entries all are looked at: a scatter each, a hundred of them, takes long to compile.
    return jnp.where(jnp.arange(array.shape[0]) == at, jnp.asarray(value).astype(array.dtype), array)


def add_node(btm: Btm, kind: Array | int, x_m: Array | float, y_m: Array | float, **fields: Any) -> tuple[Btm, Array]:
    """Add a node: `(btm, id)`; id is N, which is no node, where there was no room. `fields` are others of a node."""
    at, room = btm.n_nodes, btm.n_nodes < btm.kind.shape[0]
    new = {"kind": kind, "x_m": x_m, "y_m": y_m, **fields}
    return btm.replace(
        **{name: _put(getattr(btm, name), at, value) for name, value in new.items()},
        n_nodes=at + room,
        overflow=btm.overflow + ~room,
    ), at


def add_link(
    btm: Btm, start: Array | int, bearing: Array | float, *, when: Array | bool = True, **fields: Any
) -> tuple[Btm, Array]:
    """Add a link that has not been followed, leaving node `start` at `bearing`, radians; `fields` are others of a link.

    Returns:
      `(btm, id)`; id is M, which is no link, where there was no room or `when` is False.
    """
    size = btm.start.shape[0]
    room = when & (btm.n_links < size)
    at = jnp.where(room, btm.n_links, size)
    new = {"start": start, "status": UNSEARCHED, "start_bearing": wrapped(bearing), **fields}
    return btm.replace(
        **{name: _put(getattr(btm, name), at, value) for name, value in new.items()},
        n_links=btm.n_links + room,
        overflow=btm.overflow + (when & ~room),
    ), at


def end_link(
    btm: Btm, link: Array | int, end: Array | int, bearing: Array | float, *, when: Array | bool = True, **fields: Any
) -> Btm:
    """End a followed link at node `end`, which it leaves at `bearing`, radians. Nothing changes if not `when`."""
    at = jnp.where(when, link, btm.start.shape[0])
    new = {"end": end, "status": SEARCHED, "end_bearing": wrapped(bearing), **fields}
    return btm.replace(**{name: _put(getattr(btm, name), at, value) for name, value in new.items()})


def turned_left(bearing: Array | float, reference: Array | float) -> Array:
    """Return the counter-clockwise angle from `reference` to a bearing: in (0, 2 pi], radians; 2 pi if equal."""
    angle = (bearing - reference) % (2 * math.pi)
    return jnp.where(angle <= 1e-6, 2 * math.pi, angle)


def nearest_node(btm: Btm, x_m: Array | float, y_m: Array | float, kind: Array | int) -> tuple[Array, Array]:
    """Return the nearest node of a kind: `(id, distance_m)`; `NONE` and `NO_WAY_M` without one."""
    d2 = (btm.x_m - x_m) ** 2 + (btm.y_m - y_m) ** 2
    d2 = jnp.where(btm.kind == kind, d2, NO_WAY_M)
    at = jnp.argmin(d2).astype(jnp.int32)
    found = d2[at] < NO_WAY_M
    return jnp.where(found, at, NONE), jnp.where(found, jnp.sqrt(d2[at]), NO_WAY_M)


def open_links(btm: Btm) -> Array:
    """Return links that nobody has followed though one could: `[M] bool`."""
    return (btm.status == UNSEARCHED) & ~btm.blocked


def first_open(btm: Btm, node: Array | int, entry: Array | float) -> Array:
    """Return the first un-searched link of a node, counter-clockwise from the way in's bearing (Mano et al., V.A).

    int32, its id; `NONE` without one.
    """
    angle = jnp.where(open_links(btm) & (btm.start == node), turned_left(btm.start_bearing, entry), jnp.inf)
    at = jnp.argmin(angle).astype(jnp.int32)
    return jnp.where(angle[at] < jnp.inf, at, NONE)


def hops_to_open(btm: Btm) -> Array:
    """Compute the length of the shortest way along followed links from every node to one with an un-searched link.

    `[N]` float32, metres; `NO_WAY_M` without one.
    """
    n = btm.kind.shape[0]
    size = btm.start.shape[0]
    open_ = open_links(btm)
    here = jnp.arange(n)
    has = jnp.any(open_ & (btm.start == here[:, None]), axis=1)
    followed = (btm.status == SEARCHED) & (jnp.arange(size) < btm.n_links)
    touches = [(btm.start == here[:, None]) & followed, (btm.end == here[:, None]) & followed]  # [N, M] each

    def nearer(distance):
        far_end = [distance[jnp.clip(end, 0, n - 1)] for end in (btm.end, btm.start)]
        for touch, other in zip(touches, far_end):
            way = jnp.min(jnp.where(touch, btm.length_m + other, NO_WAY_M), axis=1)
            distance = jnp.minimum(distance, way)
        return distance

    return settled(nearer, jnp.where(has, 0.0, NO_WAY_M))


def next_hop(btm: Btm, node: Array | int) -> tuple[Array, Array, Array]:
    """Return the link by which the shortest way to an un-searched link leaves a node.

    Returns:
      `(link, bearing, to)`: int32, radians, int32 node at its other end; `NONE`, 0 and `NONE` where there is no way.
    """
    n, size = btm.kind.shape[0], btm.start.shape[0]
    distance, followed = hops_to_open(btm), btm.status == SEARCHED
    way = jnp.stack([  # [2, M]
        jnp.where(followed & (here == node), btm.length_m + distance[jnp.clip(there, 0, n - 1)], NO_WAY_M)
        for here, there in ((btm.start, btm.end), (btm.end, btm.start))
    ])  # fmt: skip
    best = jnp.argmin(way)
    link, from_end = (best % size).astype(jnp.int32), best >= size
    there = way.reshape(-1)[best] < NO_WAY_M
    bearing = jnp.where(from_end, btm.end_bearing[link], btm.start_bearing[link])
    to = jnp.where(from_end, btm.start[link], btm.end[link])
    return jnp.where(there, link, NONE), jnp.where(there, bearing, 0.0), jnp.where(there, to, NONE)


def to_map(btm: Btm, *, origin_m: tuple[float, float] = (0.0, 0.0), **attributes: Any) -> BtmMap:
    """Convert the map of one run to a record with these attributes, `origin_m` added to its positions."""
    fields = {name: np.asarray(value) for name, value in btm.__dict__.items()}

    def number(name, i):
        value = float(fields[name][i])
        return value if math.isfinite(value) else None

    def extras(**found):
        return {name: value for name, value in found.items() if value}

    nodes = tuple(
        Node(
            id=i,
            x_m=float(fields["x_m"][i]) + origin_m[0],
            y_m=float(fields["y_m"][i]) + origin_m[1],
            type=NODE_TYPES[fields["kind"][i]],
            obstacle=None if fields["obstacle"][i] == NONE else OBSTACLE_SHAPES[fields["obstacle"][i]],
            **{name: number(name, i) for name in ("inclination_deg", "step_m", "posture_deg")},
            attributes=extras(
                intervention=int(fields["intervention"][i]), profile_variance_m2=number("variance_m2", i)
            ),
        )
        for i in range(int(fields["n_nodes"]))
    )
    measures = ("length_m", "min_width_m", "max_roll_deg", "max_step_m", "opening_m")
    kept = np.flatnonzero(fields["status"][: int(fields["n_links"])] != NONE)  # the others have been withdrawn
    links = tuple(
        Link(
            id=number_,
            start=int(fields["start"][i]),
            end=int(fields["end"][i]) if fields["status"][i] == SEARCHED else NOWHERE,
            status=STATUS[fields["status"][i]],
            start_bearing_deg=_bearing_deg(fields["start_bearing"][i]) or 0.0,
            end_bearing_deg=_bearing_deg(fields["end_bearing"][i]),
            posture_deg=number("link_posture_deg", i),
            **{name: number(name, i) for name in measures},
            attributes=extras(blocked=bool(fields["blocked"][i]), moved=_moved(fields, i)),
        )
        for number_, i in enumerate(kept)
    )
    return BtmMap(nodes, links, {"overflow": int(fields["overflow"]), **attributes})


def _bearing_deg(bearing):
    return direction_deg(math.degrees(bearing)) if math.isfinite(bearing) else None


def _moved(fields, i):
    """Return the odometry along a link: x, y, metres; turn, degrees, if known; empty for a link not followed."""
    x_m, y_m, turned = (float(fields[name][i]) for name in ("moved_x_m", "moved_y_m", "turned"))
    if not math.isfinite(x_m):
        return []
    return [x_m, y_m, math.degrees(turned)] if math.isfinite(turned) else [x_m, y_m]
