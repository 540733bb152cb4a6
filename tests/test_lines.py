"""Lines of the Voronoi graph as passages are read off them: their branches, and free space along them."""

import math

import numpy as np
import pytest

from jexplore.extraction.lines import Lines, bearing_deg, cells_apart, chains, connected_cells, lines_of, take_corners
from jexplore.extraction.passages import free_spaces


def drawn(cells, near, radius, spread_deg=180.0):
    """`Lines` of cells by hand: places, neighbours, clearances, angles between the walls; all known."""
    at = np.array(cells, float)
    n = len(at)
    return Lines(
        row=at[:, 0].astype(int),
        col=at[:, 1].astype(int),
        at=at,
        radius=np.broadcast_to(np.asarray(radius, float), n).copy(),
        spread_deg=np.broadcast_to(np.asarray(spread_deg, float), n).copy(),
        known=np.ones(n, bool),
        near=[set(others) for others in near],
    )


def row_of(radius):
    """A straight line of cells with these clearances, each linked to the next."""
    n = len(radius)
    near = [{i for i in (k - 1, k + 1) if 0 <= i < n} for k in range(n)]
    return drawn([(0, k) for k in range(n)], near, radius)


def test_distances_bearings_and_components_by_hand():
    lines = drawn([(0, 0), (0, 3), (4, 3), (9, 9)], [{1}, {0, 2}, {1}, set()], 5)
    assert cells_apart(lines, 0, 2) == 5
    assert [bearing_deg(lines, 0, 1), bearing_deg(lines, 1, 2), bearing_deg(lines, 1, 0)] == [0, 90, 180]
    assert connected_cells(dict(enumerate(lines.near)), [0, 3]) == [{0, 1, 2}, {3}]
    assert list(chains(lines.near, range(4), {})) == [[0, 1, 2]]


@pytest.mark.parametrize("width", [3, 4])
def test_the_axis_of_a_passage_lies_between_its_walls(width):
    obstacle = np.ones((width + 2, 24), bool)
    obstacle[1:-1] = False
    lines = lines_of(obstacle, ~obstacle, width=2)
    inside = (lines.col > 4) & (lines.col < 19)
    assert set(lines.col[inside]) == set(range(5, 19))
    for found, want in ((lines.at[:, 0], (width + 1) / 2), (lines.radius, (width + 1) / 2), (lines.spread_deg, 180)):
        np.testing.assert_allclose(found[inside], want)


def spaces_of(radius, open_cells):
    lines = row_of(radius)
    near = dict(enumerate(lines.near))
    found, mouths = free_spaces(lines, near, {0, len(radius) - 1}, open_cells)
    return [sorted(space) for space in found], sorted(mouths)


WIDE = [5.0] * 10 + [31.0] * 5
DIP = [28.0] * 4  # between 0.9 and 1 of the bound


@pytest.mark.parametrize(("middle", "n"), [([31.0] * 4, 1), (DIP, 1), ([26.0] * 4, 2)])
def test_free_space_once_entered_lasts_until_it_is_a_tenth_narrower(middle, n):
    """Clearances are to the centre of an obstacle's cell, half a cell more than is free: the bound is 30 cells."""
    spaces, mouths = spaces_of([*WIDE, *middle, *WIDE[::-1]], 30.0)
    assert len(spaces) == n
    assert len(mouths) == 2 * n
    assert mouths[0] < 10
    assert mouths[-1] >= 10 + len(middle) + 10


def test_what_dips_below_the_bound_is_no_free_space_by_itself():
    assert spaces_of([5.0] * 8 + DIP + [5.0] * 8, 30.0) == ([], [])


LONG, MIDDLE = 201, 100  # cells of the passage, and the one from which the branch leads


def branch_of(spread_deg, length=12, tip=12.0, here=60.0):
    """Return counted corners where a branch leaves a passage between walls at some angle, and the rest."""
    cells = [(0, k - MIDDLE) for k in range(LONG)] + [(k, 0) for k in range(1, length + 1)]
    n = len(cells)
    near = [{i for i in (k - 1, k + 1) if 0 <= i < LONG} for k in range(LONG)]
    near += [{k - 1 if k > LONG else MIDDLE, *([k + 1] if k + 1 < n else [])} for k in range(LONG, n)]
    near[MIDDLE].add(LONG)
    radius = [here] * LONG + np.linspace(here - 1, tip, length).tolist()
    lines = drawn(cells, near, radius, [180.0] * LONG + [spread_deg] * length)
    return take_corners(lines), len(lines.near[MIDDLE])


@pytest.mark.parametrize(("spread_deg", "corners"), [(90, {100: 1}), (40.5, {100: 1}), (39.5, {}), (10, {})])
def test_a_branch_to_a_wall_is_a_corner_from_forty_degrees_on(spread_deg, corners):
    found, left = branch_of(spread_deg)
    assert found == corners
    assert left == 2  # either way it is taken off


def test_a_branch_between_walls_that_face_each_other_is_a_passage():
    found, left = branch_of(178, length=80)
    assert (found, left) == ({}, 3)
    assert math.isclose(180, bearing_deg(drawn([(0, 1), (0, 0)], [{1}, {0}], 1), 0, 1))
