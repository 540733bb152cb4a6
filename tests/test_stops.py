"""Stops: an episode seen at some of its steps is the one seen scan by scan."""

import numpy as np
import pytest
from ref.worlds import two_rooms

from jexplore.config import Lidar, Rules
from jexplore.exploration.site import prepare_site
from jexplore.exploration.stops import stops
from jexplore.studies import explore

LIDAR = Lidar(n_beams=37, range_m=1.0)
ROUGH = Lidar(n_beams=37, range_m=1.0, sigma_m=0.3, dropout=0.1)
VIEWS = "decision-theoretic+recheck:samples=20,min_gain=3"


def stops_of(episode, steps):
    site = prepare_site(episode.world, episode.lidar, episode.rules)
    return stops(site, episode.asked, episode.start, episode.seed, episode.number, episode.final, steps)


@pytest.mark.jit
@pytest.mark.parametrize(
    ("strategy", "lidar", "rules", "number"),
    [
        ("closest+recheck", LIDAR, Rules(), 0),
        ("random", LIDAR, Rules(look_around=False), 3),
        ("closest", Lidar(n_beams=91, fov_deg=90, range_m=1.0), Rules(), 1),
        ("closest+recheck", ROUGH, Rules(clearance_m=0.0, near_m=0.0, p_free=0.5, max_plans=40), 2),
        ("closest", LIDAR, Rules(max_steps=30), 0),
        ("closest", Lidar(n_beams=1, range_m=0.25), Rules(max_plans=30), 0),
        (VIEWS, LIDAR, Rules(), 1),
    ],
)
def test_stops_are_those_of_the_replay(strategy, lidar, rules, number):
    """Maps, poses, exhausted targets; with refused steps, looks around, noise, view points and bounds that are met."""
    episode = explore.explore(two_rooms(), strategy, seed=3, episode=number, lidar=lidar, rules=rules)
    moments = list(explore.steps_of(episode))
    found = 0
    for moment, stop in zip(moments, stops_of(episode, range(len(moments))), strict=True):
        assert (stop.step, stop.row, stop.col, stop.heading) == moment[:4]
        for name in ("hits", "misses"):
            np.testing.assert_array_equal(getattr(stop.belief.grid, name), getattr(moment.belief.grid, name))
        for name in ("row", "col", "heading", "driven", "exhausted"):
            np.testing.assert_array_equal(getattr(stop.belief, name), getattr(moment.belief, name), err_msg=name)
        found += 1
    assert found == episode.measures["steps"] + 1
    assert (episode.measures["refused"] > 0) == (lidar is ROUGH)


@pytest.mark.jit
def test_some_steps_are_as_good_as_all():
    episode = explore.explore(two_rooms(), "closest+recheck", seed=3, lidar=LIDAR)
    n = episode.measures["steps"]
    every = {stop.step: np.asarray(stop.belief.grid.misses) for stop in stops_of(episode, range(n + 1))}
    for steps in ([n], [0, n], [1, 5, 6, n - 1]):
        stopped = [(stop.step, np.asarray(stop.belief.grid.misses)) for stop in stops_of(episode, steps)]
        assert [step for step, _ in stopped] == steps
        for step, misses in stopped:
            np.testing.assert_array_equal(misses, every[step])
    height, width = episode.world.shape
    np.testing.assert_array_equal(every[n][:height, :width], episode.final.misses)
