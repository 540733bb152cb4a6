"""Contents of figures: pixels and texts."""

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text


def pixels(figure, dpi=100):
    """The figure as RGB, `[H, W, 3]` uint8, row 0 at the top."""
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def shown(figure):
    """Return the axes that are drawn."""
    return [ax for ax in figure.axes if ax.get_visible()]


def shown_texts(figure):
    """The texts that are drawn; tick labels beyond the limits of their axis are not."""
    ticks = [
        (tick, axis.get_view_interval())
        for axes in figure.findobj(Axes)
        for axis in (axes.xaxis, axes.yaxis)
        for tick in axis.get_major_ticks()
    ]
    beyond = {
        label
        for tick, limits in ticks
        for label in (tick.label1, tick.label2)
        if not min(limits) <= tick.get_loc() <= max(limits)
    }
    for text in figure.findobj(Text):
        hidden = text.axes is not None and not text.axes.get_visible()
        if text.get_visible() and text.get_text().strip() and not hidden and text not in beyond:
            yield text


def check_texts(figure):
    """No text that is shown leaves the figure or touches another one."""
    pixels(figure)
    renderer, page = figure.canvas.get_renderer(), figure.bbox.padded(2)
    boxes = [(text.get_text(), text.get_window_extent(renderer).padded(-1.5)) for text in shown_texts(figure)]
    assert len(boxes) > 0
    outside = [text for text, box in boxes if not page.containsx(box.x0) or not page.containsx(box.x1)]
    outside += [text for text, box in boxes if not page.containsy(box.y0) or not page.containsy(box.y1)]
    assert outside == []
    clashes = [(a, b) for (a, box_a), (b, box_b) in itertools.combinations(boxes, 2) if box_a.overlaps(box_b)]
    assert clashes == []
