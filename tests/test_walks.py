"""Walks of bounds: orders compared with brute force, walks that see everything."""

import itertools

import numpy as np
import pytest
from ref.refusals import refused

import jexplore as jx
from jexplore.reach import FAR, STRAIGHT
from jexplore.rules import Lidar, Rules
from jexplore.studies.bounds import bound as study
from jexplore.studies.bounds import scene, search, stops, walks
from jexplore.studies.bounds.scene import Coverage, Sights, rays_of
from jexplore.studies.checks import ready_starts
from jexplore.worlds.world import World

pytestmark = pytest.mark.jit
NEAR, RULES = Lidar(n_beams=61, range_m=1.5), Rules()


def searched(name="rooms:width_m=5,height_m=5", seed=0):
    world = jx.load_world(name, cell_m=0.1)
    start = tuple(int(v) for v in ready_starts(world, "random", 1, seed=seed, rules=RULES)[0])
    made = scene.prepare_scene(world, start, NEAR, RULES, 2)
    assert made is not None
    coverage = Coverage(made.sights, made.must_see)
    return search.Search(made, made.clear, search.Budget(None, 10**9), coverage)


def walks_of(own, seed=0):
    return walks.Walks(own.floor, own.coverage, np.random.default_rng(seed))


def some_stops(own, n, seed=0):
    """The `Stops` of some witnesses, and these."""
    rng, made = np.random.default_rng(seed), stops.Stops(own.floor)
    cells = [int(cell) for cell in rng.permutation(np.flatnonzero(own.floor.scene.must_see))]
    cells = [cell for cell in cells[:60] if own.floor.from_start[own.floor.region(cell)].min() > 0][:n]
    for cell in cells:
        made.add(cell)
    assert len(cells) == n
    return made, cells


def test_too_many_cells_are_refused(monkeypatch):
    rays = rays_of(Lidar(n_beams=4, fov_deg=360, range_m=0.2), 0.1)
    monkeypatch.setattr(scene, "TABLE_BYTES", 10)
    refused("too many cells to be bounded", Sights, np.ones((9, 14), bool), int(rays.length.max()) + 1, rays)


def test_stops_are_as_far_apart_as_floods_say():
    own = searched()
    made, cells = some_stops(own, 5)
    for number, place in enumerate(made.places.tolist()):
        away = own.floor.away_from(np.array([place]))
        np.testing.assert_array_equal(made.apart[number], away[made.places])
        assert made.from_start[number] == own.floor.from_start[place]
    for cell in cells:
        assert set(made.places[made.own[cell]].tolist()) <= set(own.floor.region(cell).tolist())
        assert 1 <= len(made.own[cell]) <= stops.STOPS
    before = len(made.places)
    made.add(cells[0])
    made.touch(cells[0], int(made.places[made.own[cells[0]][0]]))
    assert len(made.places) == before
    last = int(own.floor.region(cells[0])[-1])
    made.touch(cells[0], last)
    assert last in made.places[made.own[cells[0]]]


def shortest_way(made, cells):
    """The cost of the best stops for an order, by trying all."""
    least = FAR
    for chosen in itertools.product(*(made.own[cell] for cell in cells)):
        way = [made.from_start[chosen[0]], *(made.apart[a, b] for a, b in itertools.pairwise(chosen))]
        least = min(least, int(sum(way)))
    return least


def test_the_best_stops_of_an_order_and_the_best_order():
    own = searched()
    made, cells = some_stops(own, 4)
    for cell in cells:
        made.own[cell] = made.own[cell][:4]
    costs = {}
    for order in itertools.permutations(cells):
        settled = stops.StopOrder(made, ((cell, int(made.own[cell][0])) for cell in order))
        settled._best_stops()
        assert settled.witnesses == list(order)
        assert settled.cost <= shortest_way(made, order)  # a stop of another witness may see it as well
        assert all(made.inside[cell][made.places[stop]] for cell, stop in settled.pairs)
        costs[settled.cost] = settled
    worst = costs[max(costs)]
    assert worst.cost > min(costs)
    assert stops.improved_order(worst, np.random.default_rng(0), 60).cost == min(costs)


def test_an_insertion_costs_what_it_says():
    own = searched()
    made, cells = some_stops(own, 6)
    order = stops.StopOrder(made)
    for cell in cells:
        before = order.cost
        extra, at, stop = order.insertion(cell)
        order.insert(cell)
        assert order.pairs[at] == (cell, stop)
        assert order.cost == before + extra
        assert made.inside[cell][made.places[stop]]
    before = order.cost
    order.settle()
    assert order.cost <= before
    assert sorted(order.witnesses) == sorted(cells)
    better = stops.improved_order(order, np.random.default_rng(1), 30)
    assert sorted(better.witnesses) == sorted(cells)
    assert order.pairs == stops.improved_order(order, np.random.default_rng(1), 0).pairs


@pytest.mark.parametrize("name", ["rooms:width_m=5,height_m=5", "cave:width_m=6,height_m=6"])
def test_walks_see_everything_and_become_shorter(name):
    own = searched(name)
    found = walks_of(own)
    assert found.cost == FAR
    assert not found.find(lambda: True)
    assert found.find(lambda: False)
    first = found.cost
    assert not len(own.coverage.unseen(found.walk))
    assert found.walk[0] == own.floor.scene.start
    found.shorten(lambda: False)
    assert found.cost <= first
    assert not len(own.coverage.unseen(found.walk))
    assert search.walk_cost(found.walk, own.floor.scene.width) == found.cost
    again = walks_of(own)
    again.find(lambda: False)
    again.shorten(lambda: False)
    assert (again.cost, again.walk.tolist()) == (found.cost, found.walk.tolist())  # nothing asks a clock
    again.shorten(lambda: False, found.witnesses[::-1][:3])
    assert all(sorted(order.witnesses) == sorted(again.witnesses) for order in again._kept)
    assert not len(own.coverage.unseen(again.walk))


def test_what_tells_most_comes_first():
    """Two dead ends of a corridor tell everything; cells between them nothing more."""
    occupied = np.ones((5, 62), bool)
    occupied[1:4, 1:61] = False
    world = World(occupied=occupied, cell_m=0.1, name="corridor")
    made = scene.prepare_scene(
        world, (2, 20, 0), Lidar(n_beams=31, range_m=0.35), Rules(clearance_m=0.1, near_m=0.0), 2
    )
    assert made is not None
    own = search.Search(made, made.clear, search.Budget(None, 10**9), Coverage(made.sights, made.must_see))
    middle = 2 + made.pad
    cells = [middle * made.width + col + made.pad for col in (8, 30, 2, 45, 59)]
    found = stops.Stops(own.floor)
    for cell in cells:
        found.add(cell)
    rng = np.random.default_rng(0)
    chosen = stops.telling(found, cells, 3, rng, lambda: False)
    assert chosen[:2] == [cells[4], cells[2]]
    assert len(chosen) == 3
    assert stops.telling(found, cells, 3, rng, lambda: True) == []
    # 18 cells to the left, all the way back and to the right, less those seen ahead (3 cells, at both ends).
    walk = walks_of(own)
    assert walk.find(lambda: False)
    walk.shorten(lambda: False)
    assert walk.cost == (15 + 15 + 36) * STRAIGHT


@pytest.mark.slow
def test_a_walk_longer_than_costs_can_say():
    """A winding corridor of some 20,000 cells."""
    occupied = np.ones((201, 201), bool)
    occupied[1:-1:2, 1:-1] = False
    occupied[2:-1:4, -2] = False
    occupied[4:-1:4, 1] = False
    world = World(occupied=occupied, cell_m=0.1, name="winding")
    rules = Rules(clearance_m=0.0, near_m=0.0)
    row = study.solve(study.BoundTask(world, (1, 1, 0), Lidar(n_beams=8, range_m=0.3), rules, None, 4000)).iloc[0]
    assert row["status"] == study.WEAK
    assert np.isnan(row["high_m"])
    assert 1600 < row["low_any_m"] <= row["low_m"] <= FAR / STRAIGHT * 0.1
