"""Replays: the frames of a page are the episode that was run."""

import dataclasses

import numpy as np
import pytest
from ref.refusals import refused
from ref.worlds import two_rooms

from jexplore.engine.runner import Costs
from jexplore.exploration import batch
from jexplore.exploration.replay import Moment
from jexplore.exploration.results import map_state
from jexplore.planning import field
from jexplore.policies.room_wise import own_segment
from jexplore.report.page.replay import FRONTIER, OWN_ROOM, STATE
from jexplore.rules import Lidar, Rules
from jexplore.studies import explore, replays
from jexplore.studies.checks import prepare_jobs
from jexplore.studies.explore import replay_of
from jexplore.studies.replays import before_leaving, replays_of

pytestmark = pytest.mark.jit

LIDAR = Lidar(n_beams=37, range_m=1.0)


def ran(strategy, **settings):
    return explore.explore(two_rooms(), strategy, seed=3, lidar=LIDAR, **settings)


@pytest.mark.parametrize("max_frames", [1, 10**6])
def test_frames_are_those_of_the_episode(max_frames):
    """Against the episode made again scan by scan."""
    episode = ran("closest+recheck", episode=1)
    replay, made = replay_of(episode, max_frames=max_frames), {m.step: m for m in explore.steps_of(episode)}
    n, (height, width) = episode.measures["steps"], episode.world.shape
    assert replay.steps.tolist() == ([n] if max_frames == 1 else list(range(n + 1)))
    for codes, step, heading_deg, target in zip(
        replay.maps(), replay.steps.tolist(), replay.heading_deg.tolist(), replay.target.tolist(), strict=True
    ):
        plans = [plan for plan in episode.final.plans if plan.step <= step]
        assert heading_deg == 45 * made[step].heading
        assert target == list((plans[-1].target if plans else None) or (-1, -1))
        belief = made[step].belief
        hits, misses, frontier = (
            np.asarray(own)[:height, :width] for own in (belief.grid.hits, belief.grid.misses, field(belief).frontier)
        )
        np.testing.assert_array_equal(codes & STATE, map_state(hits, misses, Rules().p_free))
        np.testing.assert_array_equal((codes & FRONTIER) > 0, frontier)
        assert not (codes & OWN_ROOM).any()
    np.testing.assert_allclose(replay.known_m2, episode.final.n_known[replay.steps] * 0.01)
    assert (replay.world, replay.strategy, replay.which) == ("two rooms", "closest+recheck", "seed 3")
    assert replay.episode == 1
    assert (replay.outcome, replay.cell_m) == (episode.measures["outcome"], 0.1)
    np.testing.assert_array_equal(replay.truth, episode.world.occupied)


def test_the_way_ahead_ends_where_the_next_plan_is_made():
    episode = ran("closest")
    replay = replay_of(episode, max_frames=10**6)
    made = [plan.step for plan in episode.final.plans]
    n = episode.measures["steps"]
    for step, until in zip(replay.steps.tolist(), replay.until.tolist()):
        assert until == next((other for other in made if other > step), n)


@pytest.mark.slow
def test_the_own_room_is_the_strategys():
    episode = ran("closest+segment")
    replay = replay_of(episode, max_frames=5)
    moments = {moment.step: moment for moment in explore.steps_of(episode)}
    assert replay.has_own_room
    (height, width), some = episode.world.shape, 0
    for codes, step in zip(replay.maps(), replay.steps.tolist()):
        mine, is_room, _ = own_segment(episode.asked.policy.params, moments[step].belief)
        wanted = (np.asarray(mine) & bool(is_room))[:height, :width]
        np.testing.assert_array_equal((codes & OWN_ROOM) > 0, wanted)
        some += wanted.any()
    assert some > 0


@pytest.fixture(scope="module")
def jobs(jit_on):
    with jit_on():
        settings = {"seed": 3, "cell_m": 0.1, "start": "random", "lidar": LIDAR, "rules": Rules()}
        return [explore.prepare_job(two_rooms(), name, **settings) for name in ("closest", "random", "closest+recheck")]


def test_jobs_are_replayed(jobs):
    found, notes = replays_of(jobs, max_frames=30)
    assert notes == []
    for one, name in zip(found, ("closest", "random", "closest+recheck"), strict=True):
        assert one.changes == replay_of(ran(name), max_frames=30).changes
        assert (one.strategy, one.outcome) == (name, "COMPLETE")


def test_later_episodes_are_those_of_the_comparison():
    settings = {"seed": 3, "cell_m": 0.1, "start": "random", "lidar": LIDAR, "rules": Rules()}
    jobs = prepare_jobs(two_rooms(), ["closest", "random"], episodes=4, **settings)
    found, notes = replays_of(jobs, episodes=2, max_frames=10)
    assert notes == []
    assert [(one.strategy, one.episode) for one in found] == [(s, e) for e in (0, 1) for s in ("closest", "random")]
    for one in found:
        assert one.changes == replay_of(ran(one.strategy, episode=one.episode), max_frames=10).changes
    assert len(replays_of([job._replace(starts=job.starts[:1]) for job in jobs], max_frames=3)[0]) == 2


def test_what_is_missing_is_said(jobs, monkeypatch):
    outcomes = batch.run_jobs(jobs, LIDAR, Rules()).outcomes
    assert outcomes[1].first is not None
    runs = batch.run_jobs
    cut = [
        outcomes[0]._replace(first=None),
        outcomes[1]._replace(first=outcomes[1].first._replace(plans=None)),
        outcomes[2],
    ]
    monkeypatch.setattr(batch, "run_jobs", lambda *_, **__: batch.Finished(cut, Costs()))
    found, notes = replays_of(jobs, max_frames=3)
    assert [replay.strategy for replay in found] == ["closest+recheck"]
    assert notes == [
        "closest in two rooms, episode 0: no replay, the run was interrupted before it ended.",
        "random in two rooms, episode 0: no replay, it made more plans than are kept.",
    ]
    monkeypatch.setattr(batch, "run_jobs", runs)
    monkeypatch.setattr(replays, "MAX_PAIRS", 1)
    found, notes = replays_of(jobs, max_frames=3)
    assert [replay.strategy for replay in found] == ["closest"]
    assert notes == ["Replays show the first 1 of 3 pairs of world and strategy."]


def test_an_episode_of_more_plans_than_are_kept_is_refused():
    episode = ran("closest")
    lost = dataclasses.replace(episode, final=episode.final._replace(plans=None))
    refused("closest in two rooms: no replay, it made more plans than are kept", replay_of, lost)


def test_the_last_moment_at_each_place_is_shown():
    """Looks round and refused steps are made without a step."""
    steps = [0, 1, 1, 1, 2, 3, 3]
    found = [Moment(step, 0, 0, number, None, None) for number, step in enumerate(steps)]
    assert [moment.heading for moment in before_leaving(iter(found), [0, 1, 2, 3])] == [0, 3, 4, 6]
    assert [moment.heading for moment in before_leaving(iter(found), [1, 3])] == [3, 6]
    assert [moment.heading for moment in before_leaving(iter(found[:1]), [0])] == [0]
