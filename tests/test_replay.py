"""One episode again: the maps of the way, its headings, its pictures."""

import numpy as np
import pytest
from PIL import Image
from test_comparison import two_rooms

from jexplore.config import InputError, Lidar, Rules
from jexplore.exploration.batch import Final
from jexplore.raycast import scans_all_round
from jexplore.studies import explore
from jexplore.studies.comparison import compare

LIDAR = Lidar(n_beams=37, range_m=1.0)
NOISY = Lidar(n_beams=37, range_m=1.0, sigma_m=0.03, dropout=0.2)


@pytest.fixture(scope="module")
def made(jit_on):
    with jit_on():
        return explore.explore(two_rooms(), "closest+recheck", seed=3, lidar=LIDAR)


def final_of(rows, cols):
    zero = np.zeros(len(rows), np.int32)
    return Final(zero, zero, np.array(rows), np.array(cols), zero, zero, zero, zero)


def test_headings_by_hand():
    rows, cols = [5, 5, 6, 7, 7, 6, 5, 5, 4, 3], [5, 6, 7, 7, 6, 5, 5, 6, 7, 7]
    assert explore.headings_of(final_of(rows, cols), 3) == [3, 0, 1, 2, 4, 5, 6, 0, 7, 6]
    assert explore.headings_of(final_of([5], [5]), 7) == [7]


@pytest.mark.jit
@pytest.mark.parametrize(
    ("strategy", "lidar", "rules"),
    [
        ("closest", LIDAR, Rules()),
        ("random", LIDAR, Rules(look_around=False)),
        ("closest", Lidar(n_beams=91, fov_deg=90, range_m=1.0), Rules()),
        ("closest+recheck", NOISY, Rules()),
    ],
)
def test_the_replay_ends_in_the_maps_of_the_episode(strategy, lidar, rules):
    episode = explore.explore(two_rooms(), strategy, seed=3, lidar=lidar, rules=rules)
    assert episode.measures["refused"] == 0
    height, width = episode.world.shape
    known, scans = [], 0
    for step, grid, _, _ in explore._states(episode):
        hits, misses = (np.asarray(a)[:height, :width] for a in (grid.hits, grid.misses))
        known.append(int(((hits + misses) > 0).sum()))
        scans += episode.final.looked[step] + (1 if step else scans_all_round(lidar.fov_deg))
    np.testing.assert_array_equal(hits, episode.final.hits)
    np.testing.assert_array_equal(misses, episode.final.misses)
    assert known == episode.final.known.tolist()
    assert scans == episode.measures["scans"]


@pytest.mark.jit
def test_frames(made):
    frames = list(explore.frames(made, max_frames=10))
    n = made.measures["steps"]
    assert len(frames) == 10
    assert [frames[0].step, frames[-1].step] == [0, n]
    assert (np.diff([frame.step for frame in frames]) > 0).all()
    for frame in frames:
        assert (frame.row, frame.col) == (made.final.rows[frame.step], made.final.cols[frame.step])
        assert not frame.frontier[made.world.occupied].any()
        assert ((frame.hits + frame.misses)[frame.frontier] > 0).all()
    assert frames[0].frontier.any()
    assert frames[0].frontier[frames[0].target]  # what it goes to is a frontier cell of the map that it sees
    assert not frames[-1].frontier.any()
    assert frames[-1].target is None
    np.testing.assert_array_equal(frames[-1].hits, made.final.hits)
    assert [frame.step for frame in explore.frames(made, max_frames=1)] == [n]
    assert len(list(explore.frames(made, max_frames=10**6))) == n + 1


@pytest.mark.jit
def test_an_episode_is_number_0_of_a_comparison(made):
    row = compare(two_rooms(), "closest+recheck", episodes=1, seed=3, lidar=LIDAR).to_pandas().iloc[0]
    for name, value in made.measures.items():
        assert value is None if name == "room_entries" else row[name] == value
    assert made.start == (row["start_row"], row["start_col"], row["start_heading_deg"])


@pytest.mark.jit
def test_pictures(made, tmp_path):
    drawn = []
    made.save_gif(tmp_path / "a.gif", max_frames=5, on_progress=drawn.append)
    assert drawn == [1] * 5
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 5
    figure = made.figure()
    assert f"{made.measures['path_m']:.1f} m, COMPLETE" in figure._suptitle.get_text()


def test_a_start_given_by_hand_and_what_is_refused():
    options = {"seed": 0, "cell_m": 0.1, "lidar": LIDAR, "rules": Rules()}
    job = explore.prepare_job(two_rooms(), "closest", start=(10, 10, 270), **options)
    assert job.starts.tolist() == [[10, 10, 270]]
    for start, message in [((0, 3, 0), "lies in a wall"), ((99, 3, 0), "outside"), ((10, 10, 7), "45"), ("w", "start")]:
        with pytest.raises(InputError, match=message):
            explore.explore(two_rooms(), "closest", start=start)
    with pytest.raises(InputError, match="seed must be"):
        explore.explore(two_rooms(), "closest", seed=0.5)
