"""Pictures of maps: what the artists hold, and that no text or legend covers another."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from ref.figures import pixels

from jexplore.report import plot_traces
from jexplore.tracemap import picture
from jexplore.tracemap.record import NOWHERE, BtmMap, Link, Node

MODES = ["central run", "wall following", "branch_selection $x$", "dead end run"]
COURSE = BtmMap(
    (
        Node(0, 0.0, 0.0, "terminal"),
        Node(1, 4.0, 0.0, "obstacle", "slope"),
        Node(2, 8.0, 0.0, "divergence"),
        Node(3, 8.0, -4.0, "free_space"),
    ),
    (
        Link(0, 0, 1, "searched", 0.0, 180.0),
        Link(1, 1, 2, "searched", 0.0, 180.0),
        Link(2, 2, NOWHERE, "un-searched", 90.0),
        Link(3, 2, 3, "searched", -90.0, 90.0),
    ),
)
TRAIL = np.column_stack(
    [
        np.concatenate([np.linspace(0, 8, 81), np.full(40, 8.0)]),
        np.concatenate([np.zeros(81), np.linspace(-0.1, -4, 40)]),
        np.zeros(121),
    ]
)
WALLS = np.array([[-1.0, 1.0, 7.0, 1.0], [9.0, 3.0, 9.0, -6.0]])
RUN = np.repeat([0, 2, 1], [70, 11, 40])


def lines_of(ax):
    return [np.array(lines.get_segments()) for lines in ax.collections if isinstance(lines, LineCollection)]


def test_nodes_and_links(ax):
    picture.draw_btm(ax, COURSE)
    searched, stubs = lines_of(ax)
    np.testing.assert_array_equal(searched, [[[0, 0], [4, 0]], [[4, 0], [8, 0]], [[8, 0], [8, -4]]])
    np.testing.assert_allclose(stubs, [[[8, 0], [8, picture.STUB_M]]], atol=1e-12)
    drawn_nodes = {line.get_marker(): line.get_xydata().tolist() for line in ax.lines}
    assert drawn_nodes == {"s": [[0, 0]], "^": [[4, 0]], "o": [[8, 0]], "D": [[8, -4]]}
    assert {text.get_text(): text.xy for text in ax.texts} == {
        str(node.id): (node.x_m, node.y_m) for node in COURSE.nodes
    }
    labels = ax.get_legend_handles_labels()[1]
    assert labels[:2] == ["searched link", "un-searched link"]
    assert sorted(labels[2:]) == ["divergence node", "free space node", "obstacle node", "terminal node"]


def test_a_loop_and_nothing(ax):
    picture.draw_btm(ax, BtmMap((), ()))
    assert ax.get_legend_handles_labels() == ([], [])
    picture.draw_btm(ax, BtmMap((Node(0, 1.0, 1.0, "divergence"),), (Link(0, 0, 0, "searched", 0.0, 90.0),)))
    (loop,) = lines_of(ax)
    np.testing.assert_allclose(loop, [[[1 + picture.STUB_M, 1], [1, 1], [1, 1 + picture.STUB_M]]])


def test_a_node_is_marked_where_the_way_first_comes_to_it(ax):
    there_and_back = np.concatenate([TRAIL[:81], TRAIL[80::-1] + np.array([0, 0.01, 0]), TRAIL[:81]])
    nodes = (
        COURSE.nodes[0],
        Node(1, 4.0, 0.1, "free_space"),
        Node(2, 8.0, 0.0, "divergence"),
        Node(3, 4.0, 0.0, "terminal"),
    )
    plot_traces.draw_pitch(ax, BtmMap(nodes, ()), there_and_back, np.zeros(len(there_and_back)))
    marks = [float(mark.get_xdata()[0]) for mark in ax.lines[1:]]
    np.testing.assert_allclose(marks, [0, 4, 8, 12.01], atol=1e-3)


def test_a_page_of_a_run():
    points, pitch = np.zeros((2, 2)), np.sin(np.arange(121))
    page = plot_traces.trace_figure(COURSE, WALLS, TRAIL, points, RUN, MODES, "A run_1 of $x$", pitch_deg=pitch)
    pixels(page)  # draws it
    assert [text.get_text() for text in page.legends[0].get_texts()] == [
        *("searched link", "un-searched link", "terminal node", "divergence node", "free space node", "obstacle node"),
        *("building", "scan point", *MODES[:3], "start", "end"),
    ]
    walls = next(
        lines for lines in page.axes[0].collections if to_rgb(lines.get_colors()[0]) == to_rgb(plot_traces.WALL)
    )
    np.testing.assert_array_equal(walls.get_segments(), WALLS.reshape(-1, 2, 2))
    assert page.axes[1].lines[0].get_ydata().tolist() == pitch.tolist()
    assert all(axes.get_xlabel() and axes.get_ylabel() for axes in page.axes)


def test_a_page_of_nothing():
    page = plot_traces.trace_figure(BtmMap((), ()), None, np.zeros((0, 3)), None, [], MODES, "")
    pixels(page)
    assert len(page.axes) == 1
