"""Animations: which pixels come out, which frames are kept."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from ref.refusals import refused

from jexplore.report import animate, plot
from jexplore.report.page.replay import FRONTIER, ReplayData, changes_of
from jexplore.worlds.world import ROBOT

STATE = np.array([[2, 2, 2, 2], [2, 1, 1, 0], [2, 2, 0, 0]], dtype=np.uint8)


def replay(*maps, row=1, col=1, heading_deg=0, target=(-1, -1), cell_m=0.1):
    """A robot that stays where it is, while its map of codes changes."""
    n = len(maps)
    how = {"rows": np.full(n, row), "cols": np.full(n, col), "steps": np.arange(n), "until": np.arange(n)}
    how |= {"heading_deg": np.full(n, heading_deg), "target": np.tile(target, (n, 1)), "known_m2": np.zeros(n)}
    how |= dict.fromkeys(("world", "strategy", "which", "outcome"), "") | {"episode": 0, "rooms": None}
    return ReplayData(**how, cell_m=cell_m, truth=maps[0] == 2, changes=tuple(changes_of(maps)))


def gif_frames(path):
    with Image.open(path) as image:
        assert image.info["loop"] == 0
        found = []
        for number in range(image.n_frames):
            image.seek(number)
            found.append((np.asarray(image.convert("RGB")), image.info["duration"]))
    return found


def test_gif_pixels_by_hand(tmp_path):
    frontier = np.zeros(STATE.shape, bool)
    frontier[2, 3] = True
    shown = replay(STATE + np.uint8(FRONTIER) * frontier, row=0, col=0, target=(2, 0))
    animate.save_animation(shown, ["step 0"], tmp_path / "a.gif")
    ((picture, duration),) = gif_frames(tmp_path / "a.gif")
    assert duration == 2000
    assert picture.shape == (3 * 160 + 48, 640, 3)  # 160 pixels a cell, and two bands
    colours = np.array([[184] * 3, [255] * 3, [0] * 3, [224, 16, 16]])[np.where(frontier, 3, STATE)]
    corner = picture[: 3 * 160][8::160, 8::160][::-1]  # the upper left corner of each cell
    np.testing.assert_array_equal(corner, colours)
    assert (picture[3 * 160 - 80, 80] == to_bytes(ROBOT)).all()  # in the middle of cell (0, 0)
    ring = (picture[: 3 * 160] == to_bytes(plot.TARGET)).all(axis=-1)
    rows, cols = np.nonzero(ring)
    assert abs(rows.mean() - 80) < 1
    assert abs(cols.mean() - 80) < 1
    band = picture[3 * 160 :]
    assert band[12, 8:120].min() < 100  # the caption
    assert band[12, 500:].min() == 0  # the scale bar
    legend = {tuple(colour) for colour in band[24:].reshape(-1, 3).tolist()}
    assert legend >= {tuple(animate._GIF_PALETTE[code]) for _, code in animate._LEGEND}


def to_bytes(colour):
    return np.array([round(255 * value) for value in to_rgb(colour)])


@pytest.mark.parametrize(("heading_deg", "toward"), [(0, (1, 0)), (90, (0, 1)), (225, (-1, -1))])
def test_gif_robot_points_where_it_heads(heading_deg, toward):
    shown = replay(codes := np.ones((9, 9), np.uint8), row=4, col=4, heading_deg=heading_deg)
    image = animate.frame_image(shown, 0, codes, "")
    rows, cols = np.nonzero(np.asarray(image.convert("RGB"))[:630, :, 1] < 200)
    points = np.stack([cols - 4.5 * 71, 4.5 * 71 - rows], axis=-1)
    tip = points[np.argmax((points**2).sum(axis=1))]
    assert tip @ np.array(toward) > 0.95 * np.hypot(*tip) * np.hypot(*toward)


@pytest.mark.parametrize("shape", [(1, 1), (1, 700), (1300, 900)])
def test_gif_of_any_shape(shape):
    state = np.zeros(shape, np.uint8)
    state[-1, -1] = 2
    image = animate.frame_image(replay(state, row=0, col=0, cell_m=0.05), 0, state, "x" * 300)
    assert image.width >= 320
    assert max(image.size) <= 640 + 48
    assert (np.asarray(image) == 2).any()  # a wall of one cell survives the reduction


def test_gif_errors(tmp_path):
    for wrong in ({"fps": 0}, {"fps": 51}):
        with pytest.raises(ValueError, match="expected 0 < fps"):
            animate.save_animation(replay(STATE), [""], tmp_path / "a.gif", **wrong)
    refused("missing", animate.save_animation, replay(STATE), [""], tmp_path / "missing" / "a.gif")

    def breaks():
        yield "step 0"
        raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        animate.save_animation(replay(STATE, STATE), breaks(), tmp_path / "a.gif")
    assert list(tmp_path.iterdir()) == []


def test_only_animations_are_written(tmp_path):
    refused(r"must end in \.gif, got \.png", animate.save_animation, replay(STATE), [""], tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []
    animate.save_animation(replay(STATE), [""], tmp_path / "bare")
    assert (tmp_path / "bare").read_bytes().startswith(b"GIF8")
