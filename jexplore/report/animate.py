"""Animations: an episode as a GIF, frame by frame, in pixels and one palette."""

import math
import os
from collections.abc import Callable, Iterable

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jexplore.config import InputError
from jexplore.report.page.replay import FRONTIER, STATE, ReplayData
from jexplore.report.plot import ARROW, MAP_RGB, round_length
from jexplore.report.store import atomic

_GIF_RGB = [*MAP_RGB.tolist(), (224, 16, 16), (0, 114, 178), (230, 159, 0), (123, 44, 160), (245, 245, 245)]
_UNKNOWN, _FREE, _OCCUPIED, _FRONTIER, _TARGET, _ROBOT, _PATH, _BAND = range(len(_GIF_RGB))
_GIF_PALETTE = np.array([*_GIF_RGB, *([grey] * 3 for grey in range(0, 245, 35))], np.uint8)  # greys of letters
_BAND_PX, _MIN_WIDTH_PX, _LONG_PX = 24, 360, 640
_LEGEND = (("unknown", _UNKNOWN), ("frontier", _FRONTIER), ("target", _TARGET), ("robot", _ROBOT), ("path", _PATH))
_HOLD_S = 2.0  # of the last frame


def _font(size):
    return ImageFont.truetype(os.path.join(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"), size)


def _shrunk(classes, factor):
    """Reduce blocks of `factor` x `factor` cells to their highest class: frontier, occupied, free, unknown."""
    padded = np.pad(classes, [(0, -size % factor) for size in classes.shape])
    return np.maximum.reduce([padded[row::factor, col::factor] for row, col in np.ndindex(factor, factor)])


def frame_image(replay: ReplayData, number: int, codes: np.ndarray, caption: str) -> Image.Image:
    """Draw a frame of a replay, its map of codes and a caption as a palette image.

    A cell is drawn as a square of whole pixels, as many as fit 640 pixels; maps of more than 640 cells are reduced by
    whole factors first, where a frontier wins over occupied, occupied over free and free over unknown. Below lie a
    band with the caption and a scale bar, and one with a legend.
    """
    classes = np.where(codes & FRONTIER, np.uint8(_FRONTIER), codes & STATE)
    shrink = math.ceil(max(classes.shape) / _LONG_PX)
    classes = _shrunk(classes, shrink)[::-1]
    scale = max(1, _LONG_PX // max(classes.shape))
    picture = classes.repeat(scale, axis=0).repeat(scale, axis=1)
    height, width = picture.shape
    codes = np.full((height + 2 * _BAND_PX, max(width, _MIN_WIDTH_PX)), _BAND, dtype=np.uint8)
    left = (codes.shape[1] - width) // 2
    codes[:height, left : left + width] = picture
    image = Image.fromarray(_GIF_PALETTE[codes])
    draw, per_cell = ImageDraw.Draw(image), scale / shrink

    def pixel(row, col):
        return left + (col + 0.5) * per_cell, height - (row + 0.5) * per_cell

    robots = [(robot, int(robot.steps[number])) for robot in (replay, *replay.others)]
    for robot, step in robots:
        points = [pixel(row, col) for row, col in zip(robot.rows[: step + 1], robot.cols[: step + 1])]
        if len(points) > 1:
            draw.line(points, fill=_rgb(_PATH), width=max(1, min(3, scale // 2)))
    size = min(max(6.0, 0.3 / replay.cell_m * per_cell), 14.0)
    for robot, _ in robots:
        if robot.target[number, 0] >= 0:
            x, y = pixel(*robot.target[number])
            draw.ellipse((x - size, y - size, x + size, y + size), outline=_rgb(_TARGET), width=3)
    for robot, step in robots:
        (x, y), heading = pixel(robot.rows[step], robot.cols[step]), math.radians(robot.heading_deg[number])
        cos, sin = math.cos(heading), math.sin(heading)
        arrow = [
            (x + size * (u * cos - v * sin), y - size * (u * sin + v * cos)) for u, v in np.asarray(ARROW.vertices)[:-1]
        ]
        draw.polygon(arrow, fill=_rgb(_ROBOT), outline=_rgb(_OCCUPIED))
    _draw_band(image, draw, caption, replay.cell_m / per_cell, height + _BAND_PX // 2)
    _draw_legend(draw, height + 3 * _BAND_PX // 2)
    palette = Image.new("P", (1, 1))
    palette.putpalette(_GIF_PALETTE.tobytes())
    return image.quantize(palette=palette, dither=Image.Dither.NONE)


def _rgb(code):
    return tuple(_GIF_PALETTE[code].tolist())


def _draw_band(image, draw, caption, metres_a_pixel, y):
    """Draw the caption on the left, a scale bar of a round length on the right."""
    font, black = _font(12), _rgb(_OCCUPIED)
    bar_m = round_length(image.width / 4 * metres_a_pixel)
    right, left = image.width - 10, image.width - 10 - round(bar_m / metres_a_pixel)
    label = f"{bar_m:g} m"
    label_left = left - 8 - math.ceil(font.getlength(label))
    draw.text((label_left, y), label, black, font, anchor="lm")
    draw.line((left, y, right, y), fill=black, width=2)
    for x in (left, right):
        draw.line((x, y - 4, x, y + 4), fill=black)
    text = caption
    while text and font.getlength(text) > label_left - 20:
        text = text[:-2].rstrip("…") + "…" if len(text) > 2 else ""
    draw.text((8, y), text, black, font, anchor="lm")


def _draw_legend(draw, y):
    """Draw the legend of the colours, in one line; the target as a ring."""
    font, left = _font(11), 10
    for text, code in _LEGEND:
        box = (left, y - 5, left + 10, y + 5)
        if code == _TARGET:
            draw.ellipse(box, outline=_rgb(code), width=3)
        else:
            draw.rectangle(box, fill=_rgb(code))
        draw.text((left + 15, y), text, _rgb(_OCCUPIED), font, anchor="lm")
        left += 26 + math.ceil(font.getlength(text))


def save_animation(
    replay: ReplayData, captions: Iterable[str], path: str | os.PathLike[str], *, fps: float = 12,
    on_progress: Callable[[int], object] | None = None,
) -> None:  # fmt: skip
    """Write an episode as a GIF, whole or not at all.

    It loops. All frames share one palette, so colours do not flicker. The last frame is held for two seconds.

    Args:
      captions: of all frames.
      path: the file, with the ending .gif or none.
      fps: frames a second, above 0 and at most 50.
      on_progress: called with 1 for each frame drawn.

    Raises:
      ValueError: a rate out of bounds.
    """
    if not 0 < fps <= 50:
        raise ValueError(f"expected 0 < fps <= 50, got {fps!r}")
    ending = os.path.splitext(path)[1].lower()
    if ending not in (".gif", ""):
        raise InputError(f"{path} must end in .gif, got {ending}")
    images = []
    for number, (codes, caption) in enumerate(zip(replay.maps(), captions)):
        images.append(frame_image(replay, number, codes, caption))
        if on_progress is not None:
            on_progress(1)
    first, *rest = images
    durations = [round(100 / fps) * 10] * len(rest) + [round(1000 * _HOLD_S)]
    with atomic(path) as part:
        first.save(part, format="GIF", save_all=True, append_images=rest, duration=durations, loop=0, optimize=False)
