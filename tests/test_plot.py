"""Pictures: what the artists hold, which pixels come out, and that no two texts collide."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from PIL import Image
from ref.figures import check_texts, pixels, shown
from ref.refusals import refused

from jexplore.config import InputError
from jexplore.report import plot
from jexplore.report.plots import maps

STATE = np.array([[2, 2, 2, 2], [2, 1, 1, 0], [2, 2, 0, 0]], dtype=np.uint8)
LONG = "decision-theoretic+recheck+segment:samples=500,lam=0.2"


def test_map_by_pixels(ax):
    image = plot.draw_map(ax, STATE, 0.5)
    assert image.get_extent() == [0.0, 2.0, 0.0, 1.5]
    assert ax.get_aspect() == 1.0
    got = pixels(ax.figure, dpi=100)  # 400 x 300 pixels: a cell has 100 x 100
    expected = np.array([[184] * 3, [255] * 3, [0] * 3])[STATE[::-1]]
    np.testing.assert_array_equal(got[50::100, 50::100], expected)


def test_path_by_hand(ax):
    line, start, end = plot.draw_path(ax, [1, 1, 1, 4], [2, 3, 4, 4], 0.5)
    np.testing.assert_allclose(
        np.array(line.get_segments())[:, :, :],
        [[[1.25, 0.75], [1.75, 0.75]], [[1.75, 0.75], [2.25, 0.75]], [[2.25, 0.75], [2.25, 2.25]]],
    )
    np.testing.assert_allclose(line.get_array(), [0.2, 0.4, 1.0])  # by distance, not by step
    np.testing.assert_allclose(start.get_xydata(), [[1.25, 0.75]])
    np.testing.assert_allclose(end.get_xydata(), [[2.25, 2.25]])
    first, last = line.cmap(0.0), line.cmap(1.0)
    assert first[2] > first[0]  # from blue
    assert last[0] > last[2]  # to orange


def test_path_of_one_cell_and_of_none_and_one_that_stays(ax):
    assert plot.draw_path(ax, [1, 1], [2, 2], 0.5)[0].get_array().tolist() == [0.0]
    line, start, end = plot.draw_path(ax, [1], [2], 0.5)
    assert len(line.get_segments()) == 0
    np.testing.assert_array_equal(start.get_xydata(), end.get_xydata())
    pixels(ax.figure)
    with pytest.raises(ValueError, match="one or more cells"):
        plot.draw_path(ax, [], [], 0.5)


def entries():
    tall, wide = np.ones((40, 20), np.uint8), np.ones((15, 60), np.uint8)
    cells = np.arange(2, 12)
    one = [
        ("closest", tall, cells, cells, 0.1, 12.3),
        (LONG, tall, cells, cells, 0.1, 11.0),
        ("random", tall, [3], [4], 0.1, 0.0),
    ]
    return [
        ("office#1", one),
        ("maps/stage/hospital_section.png@56.5x25.3", [("closest", wide, cells, cells, 0.1, 45.6)]),
    ]


def test_paths_figure():
    figure = maps.paths_figure(entries())
    check_texts(figure)
    panels = [ax for ax in shown(figure) if ax.images]
    assert len(panels) == 4
    assert [ax.get_title().split("\n")[-1] for ax in panels] == ["12.3 m", "11.0 m", "0.0 m", "45.6 m"]
    assert panels[0].get_title().startswith("closest")
    assert [ax.get_ylabel().split("\n")[0] for ax in panels] == [
        "office#1",
        "",
        "",
        panels[3].get_ylabel().split("\n")[0],
    ]
    assert panels[3].get_ylabel()
    assert panels[3].images[0].get_array().shape == (15, 60, 3)


@pytest.mark.parametrize("shape", [(90, 20), (15, 90)])
def test_episode_figure(shape):
    cells, known = np.arange(2, 12), np.array([100, 300, 500])
    state = np.ones(shape, np.uint8)
    figure = plot.episode_figure(
        state,
        cells,
        cells,
        0.1,
        path_m=[0.0, 4.0, 8.0],
        known_cells=known,
        title="office#1, closest, episode 3: COMPLETE",
    )
    check_texts(figure)
    left, right = figure.axes
    assert left.images[0].get_array().shape == (*shape, 3)
    (curve,) = right.collections
    np.testing.assert_allclose(curve.get_segments(), [[[0, 1], [4, 3]], [[4, 3], [8, 5]]])
    (share,) = right.child_axes
    np.testing.assert_allclose(share.get_ylim(), [0.0, 105.0])


@pytest.mark.parametrize(("width_m", "length", "said"), [(3.5, 1.0, "1 m"), (29.0, 5.0, "5 m"), (0.4, 0.1, "0.1 m")])
def test_a_scale_bar_is_true(ax, width_m, length, said):
    plot.draw_map(ax, np.ones((4, 10), np.uint8), width_m / 10)
    plot.scale_bar(ax)
    check_texts(ax.figure)
    (bar,) = ax.findobj(AnchoredSizeBar)
    assert bar.txt_label.get_text() == said
    assert bar.size_bar.get_children()[0].get_width() == length
    long_px = np.diff(ax.transData.transform([(0, 0), (length, 0)])[:, 0])
    assert bar.size_bar.get_window_extent(ax.figure.canvas.get_renderer()).width == pytest.approx(long_px, abs=2)


def a_figure():
    figure = Figure(figsize=(2, 1.5))
    figure.add_subplot().barh(["a b"], [1.0])
    return figure


def test_save_figure(tmp_path):
    plot.save_figure(a_figure(), tmp_path / "bars.png", dpi=50)
    with Image.open(tmp_path / "bars.png") as image:
        assert (image.format, image.size) == ("PNG", (100, 75))
        assert np.asarray(image.convert("L")).min() < 50
    plot.save_figure(a_figure(), tmp_path / "bare")
    assert (tmp_path / "bare").read_bytes().startswith(b"\x89PNG")
    refused("missing", plot.save_figure, a_figure(), tmp_path / "missing" / "bars.png")
    with pytest.raises(InputError, match=r"bars\.gifx must end in \.png, \.svg or \.pdf, got \.gifx"):
        plot.save_figure(a_figure(), tmp_path / "bars.gifx")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bare", "bars.png"]


@pytest.mark.parametrize(("ending", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF"), ("SVG", b"<?xml")])
def test_vectors_are_the_same_each_time(tmp_path, ending, start):
    for name in ("one", "two"):
        plot.save_figure(a_figure(), tmp_path / f"{name}.{ending}")
    one, two = ((tmp_path / f"{name}.{ending}").read_bytes() for name in ("one", "two"))
    assert one.startswith(start)
    assert one == two
    if ending == "pdf":
        assert b"/Type3" not in one  # glyphs as drawings, which many journals refuse
