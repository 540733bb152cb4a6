"""A map as begun elsewhere: a square ring by pencil, then laws on courses with rings."""

import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ref.refusals import refused
from ref.traces import are_same

from jexplore.config import InputError
from jexplore.tracemap.record import BtmMap, Link, Node
from jexplore.tracemap.rooted import topology_from
from jexplore.tracemap.similarity import code
from jexplore.worlds.generators.course import course

CORNERS = ((0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0))


def link(number, start, end, bearing, length):
    back = (bearing + 180.0) % 360
    return Link(number, start, end, "searched", bearing, back, length, 2.0, opening_m=2.0)


def ring(spur=True):
    """A ring of 8 m sides, counter-clockwise from its lower left corner, with a dead end below the lower right one."""
    nodes = [Node(i, *at, "divergence") for i, at in enumerate(CORNERS)]
    links = [link(i, i, (i + 1) % 4, 90.0 * i, 8.0) for i in range(4)]
    if spur:
        nodes.append(Node(4, 8.0, -6.0, "divergence"))
        links.append(link(4, 1, 4, 270.0, 6.0))
    return BtmMap(tuple(nodes), tuple(links))


# By pencil


def test_a_start_on_a_ring_splits_its_side():
    found = topology_from(ring(), (3.0, 0.4, 0.0))
    assert code(found) == "T(D(D,D(D(D(=1)))),=1)"
    assert [(node.x_m, node.y_m, node.type) for node in found.nodes] == [
        (3.0, 0.4, "terminal"), (0.0, 0.0, "divergence"), (8.0, 0.0, "divergence"),
        (8.0, 8.0, "divergence"), (0.0, 8.0, "divergence"), (8.0, -6.0, "divergence"),
    ]  # fmt: skip
    assert [(one.start, one.end, one.length_m) for one in found.links] == [
        (0, 2, 5.0), (2, 3, 8.0), (3, 4, 8.0), (4, 1, 8.0), (2, 5, 6.0), (0, 1, 3.0),
    ]  # fmt: skip
    assert [one.start_bearing_deg for one in found.links] == [0, 90, 180, 270, 270, 180]
    assert [one.end_bearing_deg for one in found.links] == [180, 270, 0, 90, 90, 0]
    assert {(one.min_width_m, one.opening_m) for one in found.links} == {(2.0, 2.0)}


@pytest.mark.parametrize(
    ("heading", "first"),
    [(0, 5.0), (45, 5.0), (-45, 5.0), (315, 5.0), (135, 3.0), (225, 3.0), (90, 3.0), (270, 5.0), (89, 5.0), (91, 3.0)],
)
def test_ahead_is_where_the_robot_heads_and_to_the_left_where_it_heads_square_to_the_link(heading, first):
    assert topology_from(ring(), (3.0, 0.0, float(heading))).links[0].length_m == first


# Laws

COURSES = {(loops, repeat): course(7, loops=loops, repeat=repeat) for loops, repeat in ((1, 0), (3, 0), (2, 3), (0, 4))}


@settings(max_examples=25)
@given(st.sampled_from(sorted(COURSES)), st.integers(0, 10**6), st.floats(0.1, 0.9), st.sampled_from(range(0, 360, 45)))
def test_where_the_map_was_begun_before_does_not_matter(which, number, share, heading):
    whole = COURSES[which].course.topology
    side = whole.links[number % len(whole.links)]
    a, b = whole.nodes[side.start], whole.nodes[side.end]
    pose = a.x_m + share * (b.x_m - a.x_m), a.y_m + share * (b.y_m - a.y_m), float(heading)
    found = topology_from(whole, pose)
    assert (found.nodes[0].x_m, found.nodes[0].y_m, found.nodes[0].type) == (*pose[:2], "terminal")
    assert (found.links[0].start, len(found.bearings_deg(0))) == (0, 2)
    assert (len(found.nodes), len(found.links)) == (len(whole.nodes), len(whole.links))
    assert math.fsum(one.length_m for one in found.links) == pytest.approx(sum(one.length_m for one in whole.links))
    back = topology_from(found, COURSES[which].course.start_pose)
    assert are_same(back, whole)
    assert [node.id for node in found.nodes] == list(range(len(found.nodes)))
    for node in found.nodes[1:]:
        (true,) = [other for other in whole.nodes if (other.x_m, other.y_m) == (node.x_m, node.y_m)]
        assert dataclasses.replace(true, id=node.id) == node


@pytest.mark.parametrize("which", sorted(COURSES))
def test_from_its_own_start_a_course_is_as_it_is(which):
    world = COURSES[which]
    assert topology_from(world.course.topology, world.course.start_pose) == world.course.topology


# Bad input


def test_a_map_with_ways_that_nobody_knows_is_refused():
    with pytest.raises(InputError, match="expected a map whose links have both ends and lengths, got one where link 8"):
        topology_from(course(0).course.topology, (3.0, 27.0, 0.0))
    refused("it has no link", topology_from, BtmMap(ring().nodes, ()), (3.0, 0.0, 0.0))
