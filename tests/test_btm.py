"""Maps as padded arrays: how they grow, what one may ask of them, and the record that they become."""

import math

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jexplore import btm
from jexplore.btm import DIVERGENCE, FREE_SPACE, NONE, OBSTACLE, SEARCHED, TERMINAL
from jexplore.tracemap import record

EAST, NORTH, WEST, SOUTH = (math.radians(angle) for angle in (0, 90, 180, -90))


def grown(nodes=(), links=(), *, n=4, m=5):
    """A map of nodes `(kind, x, y)` and links `(start, bearing)` or `(start, bearing, end, bearing, length)`."""
    map_ = btm.empty(n, m)
    for kind, x, y in nodes:
        map_, _ = btm.add_node(map_, kind, x, y)
    for start, bearing, *rest in links:
        followed = {}
        if rest:
            end, end_bearing, length = rest
            followed = {"end": end, "status": SEARCHED, "end_bearing": end_bearing, "length_m": length}
        map_, _ = btm.add_link(map_, start, bearing, **followed)
    return map_


def same(one, other, *but):
    for name, value in one.__dict__.items():
        if name not in but:
            np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)


# ---------------------------------------------------------------- growth


def test_an_empty_map_holds_nothing():
    map_ = btm.empty(2, 3)
    zeros = {"radius_m": 0, "intervention": 0, "blocked": False, "n_nodes": 0, "n_links": 0, "overflow": 0}
    blanks = {"float32": np.nan, "int32": NONE}
    for name, value in map_.__dict__.items():
        want = zeros[name] if name in zeros else blanks[value.dtype.name]
        np.testing.assert_array_equal(value, np.full(value.shape, want), err_msg=name)


def test_what_does_not_fit_is_counted_and_overwrites_nothing():
    full = grown([(TERMINAL, 0, 0), (DIVERGENCE, 1, 1)], [(0, EAST), (1, WEST)], n=2, m=2)
    more, node = btm.add_node(full, FREE_SPACE, 9.0, 9.0, posture_deg=9.0)
    assert (int(node), int(more.n_nodes), int(more.overflow)) == (2, 2, 1)
    same(full, more, "overflow")
    more, link = btm.add_link(more, 1, NORTH, opening_m=9.0)
    assert (int(link), int(more.n_links), int(more.overflow)) == (2, 2, 2)
    same(full, more, "overflow")


@pytest.mark.parametrize("links", [[], [(0, EAST), (0, WEST)]])
def test_a_link_that_is_not_wanted_changes_nothing(links):
    before = grown([(TERMINAL, 0, 0)], links, m=2)
    after, link = btm.add_link(before, 0, NORTH, when=jnp.bool_(False), opening_m=1.0)
    assert int(link) == 2
    same(before, after)


# ---------------------------------------------------------------- angles


@pytest.mark.parametrize(
    ("angle", "want"),
    [(0, 0), (90, 90), (-90, -90), (179, 179), (-180, -180), (180, -180), (270, -90), (-200, 160), (730, 10)],
)  # fmt: skip
def test_wrapped_by_hand(angle, want):
    assert math.degrees(btm.wrapped(math.radians(angle))) == pytest.approx(want, abs=1e-9)


@pytest.mark.parametrize(
    ("bearing", "reference", "want"),
    [(0, -90, 90), (90, -90, 180), (180, -90, 270), (-90, -90, 360), (-91, -90, 359), (10, 350, 20), (350, 10, 340)],
)
def test_turned_left_by_hand(bearing, reference, want):
    found = btm.turned_left(jnp.float32(math.radians(bearing)), jnp.float32(math.radians(reference)))
    assert math.degrees(found) == pytest.approx(want, abs=1e-3)


# ---------------------------------------------------------------- nodes and links near by


@pytest.mark.parametrize(
    ("place", "kind", "want"),
    [
        ((0, 0), TERMINAL, (0, 2)),
        ((3, 6), TERMINAL, (0, 5)),
        ((3, 4), DIVERGENCE, (1, 4)),
        ((10, 1), DIVERGENCE, (2, 1)),
        ((6.5, 0), DIVERGENCE, (1, 3.5)),  # equally near: the lower id
        ((0, 0), OBSTACLE, (NONE, btm.NO_WAY_M)),
        ((0, 0), FREE_SPACE, (NONE, btm.NO_WAY_M)),
    ],
)
def test_the_nearest_node_of_a_kind(place, kind, want):
    map_ = grown([(TERMINAL, 0, 2), (DIVERGENCE, 3, 0), (DIVERGENCE, 10, 0)])
    which, distance = btm.nearest_node(map_, *place, kind)
    assert (int(which), float(distance)) == want


def test_the_first_open_link_lies_to_the_right_then_ahead_then_to_the_left():
    """A robot that came north, so that the way in lies south, at a crossing."""
    nodes = [(DIVERGENCE, 0, 0), (DIVERGENCE, 5, 5)]
    links = [(0, WEST), (0, NORTH), (1, EAST), (0, EAST), (0, SOUTH)]
    map_ = grown(nodes, links)
    order = []
    while (link := int(btm.first_open(map_, 0, SOUTH))) != NONE:
        order.append(link)
        map_ = map_.replace(status=map_.status.at[link].set(SEARCHED))
    assert order == [3, 1, 0, 4]  # the way in last of all
    assert int(btm.first_open(map_, 1, SOUTH)) == 2


def test_a_blocked_link_is_never_open():
    map_ = grown([(DIVERGENCE, 0, 0)], [(0, EAST), (0, NORTH)])
    np.testing.assert_array_equal(btm.open_links(map_), [True, True, False, False, False])
    map_ = map_.replace(blocked=map_.blocked.at[0].set(True))
    np.testing.assert_array_equal(btm.open_links(map_), [False, True, False, False, False])
    assert int(btm.first_open(map_, 0, SOUTH)) == 1
    map_ = map_.replace(blocked=map_.blocked.at[1].set(True))
    assert int(btm.first_open(map_, 0, SOUTH)) == NONE


# ---------------------------------------------------------------- the way back


N, M = 7, 12
HOPS, HOP = jax.jit(btm.hops_to_open), jax.jit(jax.vmap(btm.next_hop, (None, 0)))


def random_map(seed):
    """Nodes and links at random: followed, un-searched, blocked, withdrawn; room left over."""
    draw = np.random.default_rng(seed)
    n, m = int(draw.integers(2, N + 1)), int(draw.integers(1, M + 1))
    followed, withdrawn = draw.random(m) < 0.7, draw.random(m) < 0.1
    start, end = draw.integers(n, size=(2, m))
    empty = btm.empty(N, M)

    def padded(name, values):
        whole = np.array(getattr(empty, name))
        whole[: len(values)] = values
        return jnp.asarray(whole)

    return empty.replace(
        kind=padded("kind", [DIVERGENCE] * n),
        x_m=padded("x_m", draw.random(n)),
        y_m=padded("y_m", draw.random(n)),
        start=padded("start", np.where(withdrawn, NONE, start)),
        end=padded("end", np.where(followed, end, NONE)),
        status=padded("status", np.where(withdrawn, NONE, followed)),
        blocked=padded("blocked", draw.random(m) < 0.3),
        length_m=padded("length_m", np.where(followed, draw.uniform(0.5, 9, m), np.nan)),
        start_bearing=padded("start_bearing", draw.uniform(-3, 3, m)),
        end_bearing=padded("end_bearing", np.where(followed, draw.uniform(-3, 3, m), np.nan)),
        n_nodes=jnp.int32(n),
        n_links=jnp.int32(m),
    )


@pytest.mark.jit
@given(st.integers(0, 2**20))
@settings(max_examples=30, deadline=None)
def test_the_way_back_is_dijkstras(seed):
    map_ = random_map(seed)
    graph = nx.MultiGraph()
    graph.add_nodes_from(range(N))
    sources = set()
    fields = ("start", "end", "status", "blocked", "length_m", "start_bearing", "end_bearing")
    rows = list(zip(*(np.asarray(getattr(map_, name)).tolist() for name in fields)))
    for start, end, status, blocked, length, *_ in rows:
        if status == SEARCHED:
            graph.add_edge(start, end, weight=length)
        elif status == btm.UNSEARCHED and not blocked:
            sources.add(start)
    away = nx.multi_source_dijkstra_path_length(graph, sources) if sources else {}
    want = [away.get(node, btm.NO_WAY_M) for node in range(N)]
    np.testing.assert_allclose(HOPS(map_), want, rtol=1e-5)
    for node, (link, bearing, to) in enumerate(zip(*(np.asarray(a).tolist() for a in HOP(map_, jnp.arange(N))))):
        ways = {}
        for i, (start, end, status, _, length, start_bearing, end_bearing) in enumerate(rows):
            if status == SEARCHED:
                for here, there, leaves in ((start, end, start_bearing), (end, start, end_bearing)):
                    if here == node and there in away:
                        ways[i, leaves, there] = length + away[there]
        assert ((link, bearing, to) == (NONE, 0, NONE)) == (not ways)
        if ways:
            assert ways[link, bearing, to] == pytest.approx(min(ways.values()), rel=1e-5)


# ---------------------------------------------------------------- the record


def test_the_record_by_hand():
    map_ = btm.empty(3, 6)
    map_, _ = btm.add_node(map_, TERMINAL, 1.0, 2.0, posture_deg=0.5)
    map_, _ = btm.add_node(map_, OBSTACLE, 3.0, 4.0, obstacle=btm.STAIRS, step_m=0.25, inclination_deg=30.0,
                           variance_m2=0.001953125, intervention=2)  # fmt: skip
    map_, _ = btm.add_link(map_, 0, EAST, end=1, status=SEARCHED, length_m=2.5, min_width_m=jnp.inf,
                           end_bearing=-math.pi / 2, link_posture_deg=12.5)  # fmt: skip
    map_, gone = btm.add_link(map_, 1, NORTH)
    map_, _ = btm.add_link(map_, 1, NORTH, opening_m=1.25, blocked=True)
    map_ = map_.replace(status=map_.status.at[gone].set(NONE), start=map_.start.at[gone].set(NONE))
    written = btm.to_map(map_.replace(overflow=jnp.int32(3)), origin_m=(10.0, -20.0), seed=7)
    assert written == record.BtmMap(
        nodes=(
            record.Node(0, 11.0, -18.0, "terminal", posture_deg=0.5),
            record.Node(1, 13.0, -16.0, "obstacle", "stairs", 30.0, 0.25,
                         attributes={"intervention": 2, "profile_variance_m2": 0.001953125}),
        ),
        links=(
            record.Link(0, 0, 1, "searched", 0.0, pytest.approx(270), 2.5, None, 12.5),
            record.Link(1, 1, record.NOWHERE, "un-searched", pytest.approx(90), opening_m=1.25,
                         attributes={"blocked": True}),
        ),
        attributes={"overflow": 3, "seed": 7},
    )  # fmt: skip
    assert record.check_map(written) == written
    assert (btm.NODE_TYPES[FREE_SPACE], btm.NODE_TYPES[DIVERGENCE], btm.OBSTACLE_SHAPES[btm.SLOPE]) == (
        "free_space", "divergence", "slope",
    )  # fmt: skip


def test_an_end_is_forgotten_where_the_link_is_unsearched():
    map_ = grown([(TERMINAL, 0, 0)], [(0, EAST)])
    map_ = map_.replace(end=map_.end.at[0].set(0))
    assert btm.to_map(map_).links[0].end == record.NOWHERE


def test_an_empty_map_becomes_an_empty_record():
    assert record.check_map(btm.to_map(btm.empty(2, 2))) == record.BtmMap((), (), {"overflow": 0})
