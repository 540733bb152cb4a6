"""One episode again: the maps of the way, its headings, its pictures."""

import dataclasses

import numpy as np
import pytest
from PIL import Image
from ref.refusals import refused
from ref.worlds import two_rooms

from jexplore.exploration import replay
from jexplore.exploration.results import length_along_m, map_state
from jexplore.exploration.site import prepare_site
from jexplore.policies import parse_strategy
from jexplore.raycast import scans_all_round
from jexplore.report import animate
from jexplore.report.page.replay import FRONTIER, STATE
from jexplore.rules import Lidar, Rules
from jexplore.studies import explore
from jexplore.studies.comparison import compare

pytestmark = pytest.mark.jit

LIDAR = Lidar(n_beams=37, range_m=1.0)


@pytest.fixture(scope="module")
def made(jit_on):
    with jit_on():
        return explore.explore(two_rooms(), "closest+recheck", seed=3, lidar=LIDAR)


ROUGH = Lidar(n_beams=37, range_m=1.0, sigma_m=0.3, dropout=0.1)
VIEWS = "decision-theoretic+recheck:samples=20,min_gain=3"


@pytest.mark.parametrize(
    ("strategy", "lidar", "rules", "number"),
    [
        ("closest+recheck", LIDAR, Rules(), 0),
        ("random", LIDAR, Rules(look_around=False), 3),
        ("closest", Lidar(n_beams=91, fov_deg=90, range_m=1.0), Rules(), 1),
        pytest.param(
            "closest+recheck",
            ROUGH,
            Rules(clearance_m=0.0, near_m=0.0, p_free=0.5, max_plans=40),
            2,
            marks=pytest.mark.slow,
        ),
        pytest.param(VIEWS, LIDAR, Rules(), 1, marks=pytest.mark.slow),
    ],
)
def test_the_replay_is_the_episode(strategy, lidar, rules, number):
    """Every scan, every map on the way, every count, refused steps and exhausted targets included."""
    episode = explore.explore(two_rooms(), strategy, seed=3, episode=number, lidar=lidar, rules=rules)
    site = prepare_site(episode.world, lidar, rules)
    plans = episode.final.plans
    moments = list(replay.moments(site, parse_strategy(strategy), episode.start, 3, number, plans))
    last, measures = moments[-1], episode.measures
    height, width = episode.world.shape
    np.testing.assert_array_equal(np.asarray(last.belief.grid.hits)[:height, :width], episode.final.hits)
    np.testing.assert_array_equal(np.asarray(last.belief.grid.misses)[:height, :width], episode.final.misses)
    after = {moment.step: moment for moment in moments}
    assert [int(after[step].state.n_known) for step in sorted(after)] == episode.final.n_known.tolist()
    assert [(m.row, m.col) for m in (after[step] for step in sorted(after))] == list(
        zip(episode.final.rows.tolist(), episode.final.cols.tolist())
    )
    assert len(moments) + scans_all_round(lidar) - 1 == measures["scans"]
    for name in ("scans", "exhausted", "refused"):
        assert int(getattr(last.state, name)) == measures[name]
    assert int(last.belief.exhausted.sum()) == measures["exhausted"]
    assert (measures["refused"] > 0) == (lidar is ROUGH)
    assert len(plans) == measures["plans"]
    if strategy == VIEWS:
        assert any(plan.is_view for plan in plans)


def test_exhausted_targets_are_marked_in_the_replay():
    """A robot with one short beam sees nothing new from where it stands, however it turns."""
    lidar = Lidar(n_beams=1, range_m=0.25)
    episode = explore.explore(two_rooms(), "closest", seed=3, lidar=lidar, rules=Rules(max_plans=30))
    assert episode.measures["exhausted"] > 0
    *_, last = explore.steps_of(episode)
    assert int(last.belief.exhausted.sum()) == episode.measures["exhausted"]


def test_frames_of_an_animation(made, monkeypatch):
    saved, n = [], made.measures["steps"]
    monkeypatch.setattr(animate, "save_animation", lambda replay, captions, *_, **how: saved.append((replay, captions)))
    for most in (10, 1, 10**6):
        made.save_gif("a.gif", max_frames=most)
    (frames, captions), *others = saved
    assert [len(replay.steps) for replay, _ in others] == [1, n + 1]
    steps, codes = frames.steps.tolist(), [image.copy() for image in frames.maps()]
    assert len(codes) == 10
    assert [steps[0], steps[-1]] == [0, n]
    assert (np.diff(steps) > 0).all()
    states, frontiers = (np.stack(codes) & part for part in (STATE, FRONTIER))
    for caption, step in zip(captions, steps, strict=True):
        driven_m = length_along_m(made.final.rows, made.final.cols, 0.1)[step]
        assert caption == f"{driven_m:.1f} m driven, {made.final.n_known[step] * 0.01:.0f} m² known"
    assert not frontiers[:, made.world.occupied].any()
    assert (states[frontiers > 0] > 0).all()
    assert frontiers[0][tuple(frames.target[0])]  # what it goes to is a frontier cell of the map that it sees
    assert not frontiers[-1].any()
    assert (frames.target[-1] < 0).all()
    np.testing.assert_array_equal(states[-1], map_state(made.final.hits, made.final.misses, Rules().p_free))


def test_an_episode_is_that_number_of_a_comparison(made):
    rows = compare(two_rooms(), "closest+recheck", episodes=3, seed=3, lidar=LIDAR).to_pandas()
    third = explore.explore(two_rooms(), "closest+recheck", seed=3, episode=2, lidar=LIDAR)
    for found, row in ((made, rows.iloc[0]), (third, rows.iloc[2])):
        for name, value in found.measures.items():
            assert value is None if name == "room_entries" else row[name] == value
        assert found.start == (row["start_row"], row["start_col"], row["start_heading_deg"])
    assert made.start != third.start


def test_pictures(made, tmp_path):
    drawn = []
    made.save_gif(tmp_path / "a.gif", max_frames=5, on_progress=drawn.append)
    assert drawn == [1] * 5
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 5
    figure = made.figure()
    assert f"{made.measures['path_m']:.1f} m, COMPLETE" in figure._suptitle.get_text()
    world = made.world.replace(origin_m=(-7.0, 2.0))
    ax = dataclasses.replace(made, world=world).plot(figure.add_subplot())
    (rows, cols), (x_m, y_m) = world.shape, world.origin_m
    assert ax.get_xlim() == pytest.approx((x_m, x_m + cols * world.cell_m))
    assert ax.get_ylim() == pytest.approx((y_m, y_m + rows * world.cell_m))
    begin = ax.lines[0].get_transform().transform(ax.lines[0].get_xydata()[0])
    row, col, _ = made.start
    at = x_m + (col + 0.5) * world.cell_m, y_m + (row + 0.5) * world.cell_m
    assert ax.transData.inverted().transform(begin) == pytest.approx(at)


def test_a_start_given_by_hand_and_what_is_refused():
    options = {"seed": 0, "cell_m": 0.1, "lidar": LIDAR, "rules": Rules()}
    job = explore.prepare_job(two_rooms(), "closest", start=(10, 10, 270), **options)
    assert job.starts.tolist() == [[10, 10, 270]]
    for start, message in [((0, 3, 0), "lies in a wall"), ((99, 3, 0), "outside"), ((10, 10, 7), "45"), ("w", "start")]:
        refused(message, explore.explore, two_rooms(), "closest", start=start)
    refused("episode must be", explore.explore, two_rooms(), "closest", episode=-1)
    refused("seed must be", explore.explore, two_rooms(), "closest", seed=0.5)
