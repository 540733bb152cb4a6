"""Pictures as worlds: a pixel is free if it is bright enough, everything else is a wall.

A grey that stands for "unknown" counts as occupied, and so does every pixel that is not fully opaque. A picture is
read as viewers show it: turned as its EXIF orientation says.
"""

import contextlib
import io
import os
import warnings

import numpy as np
from PIL import Image, ImageOps
from scipy import ndimage

from jexplore.arrays.files import first_line, read_bytes, told_kind
from jexplore.config import InputError, require_number, warn_of_input
from jexplore.worlds.readers.grids import resample
from jexplore.worlds.world import World

MAX_PIXELS = 64 * 10**6
_MAX_PICTURE_BYTES = 512 * 2**20  # 64 megapixels of eight bytes
_FORMATS = ("PNG", "PPM", "JPEG", "BMP", "GIF", "TIFF")  # none that starts another program, as EPS does
_JPEG_GREYS = 16  # a JPEG of no more greys has nothing blurred; a drawing has a few
_BLACK, _WHITE = 16, 250  # greys up to and from these are no others that have been blurred
_SATURATED = 128  # largest minus smallest of red, green, blue: a grey has 0, pure yellow 255


def load_image(path: str, scale: float | tuple[float, float], *, cell_m: float = 0.1, free: float = 250) -> World:
    """Load a world from a picture as drawn: its edges need not be occupied.

    A filled rectangle of one saturated colour in an otherwise grey picture, as in the dungeon maps, marks the start:
    its middle, heading 0. This holds only if it has the only colour and its cell is free. Warns if most of the picture
    is transparent, or as `read_pixels`.

    Args:
      path: PNG, PGM, PBM, PPM, JPEG, BMP, GIF (its first frame) or TIFF.
      scale: `(width_m, height_m)`: the bounding box of the occupied pixels is stretched to this size, as Stage does; or
        a number: metres a pixel of the whole picture.
      cell_m: edge of a cell, metres.
      free: a pixel is free if its grey, 0 to 255, is at least this.
    """
    require_number(f"{path!r}: free", free, high=255)
    levels = read_pixels(path)[::-1]
    occupied = _occupied(path, levels, free)
    if isinstance(scale, tuple):
        if not occupied.any():
            raise InputError(f"{path!r}: no pixel is occupied, so there is no box; take @0.05, metres a pixel")
        box = ndimage.find_objects(occupied.view(np.uint8))[0]
        levels, occupied = levels[box], occupied[box]
        if occupied.all():
            raise InputError(
                f"{path!r}: no pixel is free within the box round the occupied ones; take @0.05, metres a pixel"
            )
        pixel_m = scale[0] / occupied.shape[1], scale[1] / occupied.shape[0]
    else:
        pixel_m = (scale, scale)
    cells = resample(occupied, pixel_m, cell_m, name=path)
    return World(occupied=cells, start=_marked_start(levels, pixel_m, cell_m, cells), cell_m=cell_m, name=path)


def _occupied(path: str, levels: np.ndarray, free: float) -> np.ndarray:
    """Return the occupied pixels of a picture; refuse one without free ones."""
    shade, clear = grey(levels), transparency(levels)
    occupied = (shade < free) | clear
    if occupied.all():
        cure = "append :free=... after the scale to set another bound"
        if clear.mean() > 0.1:
            cure = f"{clear.mean():.0%} of its pixels are transparent, which counts as occupied: flatten it onto white"
        brightest = "none" if clear.all() else shade[~clear].max()
        raise InputError(
            f"{path!r}: no pixel is free; the brightest opaque grey is {brightest} and free is {free:g}; {cure}"
        )
    if clear.mean() > 0.5:
        text = "of its pixels are transparent, which counts as occupied; if they are floor, flatten it onto white"
        warn_of_input(f"{path!r}: {clear.mean():.0%} {text}")
    return occupied


def read_pixels(path: str | os.PathLike[str], *, as_stored: bool = False) -> np.ndarray:
    """Read the pixels of a picture file, refused by its header if there are more than `MAX_PIXELS`.

    `as_stored` passes over the orientation that EXIF data give, as the map servers of ROS do. Warns of a JPEG that is
    blurred, and of several frames or pages, of which the first is read.

    Returns:
      `[h, w, c]` uint8, row 0 at the top; c is 1 (grey), 3 (red, green, blue) or 4 (and opacity). Sixteen bit greys are
        scaled to 0..255.
    """
    content = read_bytes(path, _MAX_PICTURE_BYTES)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's own bound on the size lies above ours; the rest is cosmetic
            image = Image.open(io.BytesIO(content), formats=_FORMATS)
            if image.width * image.height > MAX_PIXELS:
                raise Image.DecompressionBombError
            form, is_animated = image.format, getattr(image, "is_animated", False)
            image.load()  # raises where the picture itself is damaged
            if not as_stored:
                with contextlib.suppress(Exception):  # damaged EXIF data turn nothing
                    image = ImageOps.exif_transpose(image)
            levels = _levels(path, image, form)
    except InputError:
        raise
    except Image.DecompressionBombError:
        raise InputError(
            f"{path!r}: has more than {MAX_PIXELS // 10**6} megapixels; cut it into parts, or scale it down as far as "
            "walls stay a pixel thick"
        ) from None
    except Image.UnidentifiedImageError:
        what = told_kind(content)
        hint = f"; it is {what}" if what else ""
        raise InputError(f"{path!r}: is no picture in a known format ({', '.join(_FORMATS)}){hint}") from None
    except Exception as error:  # Pillow's decoders raise OSError, SyntaxError, ValueError, struct.error and more
        raise InputError(f"{path!r}: is damaged or cut short ({first_line(error)})") from None
    if is_animated:
        warn_of_input(f"{path!r}: has several frames or pages, and the first is read")
    count = np.bincount(grey(levels).ravel(), minlength=256)
    if form == "JPEG" and np.count_nonzero(count) > _JPEG_GREYS:
        warn_of_input(
            f"{path!r}: is a JPEG, and blurred round its walls: {count[_BLACK + 1 : _WHITE].sum() / count.sum():.1%} "
            "of its pixels are neither black nor white, and openings may be narrower than drawn; save the drawing as "
            "PNG (in a world's name, :free=230 helps)",
        )
    return levels


def grey(levels: np.ndarray) -> np.ndarray:
    """Convert `[h, w, c]` levels to `[h, w]` uint8 greys: unchanged, or the luma of ITU-R 601 as in Pillow."""
    if levels.shape[2] == 1:
        return levels[..., 0]
    return np.asarray(Image.fromarray(np.ascontiguousarray(levels[..., :3])).convert("L"))


def transparency(levels: np.ndarray) -> np.ndarray:
    """Return `[h, w]` bool, where `[h, w, c]` levels are not fully opaque."""
    return levels[..., 3] < 255 if levels.shape[2] == 4 else np.zeros(levels.shape[:2], bool)


def _levels(path: str | os.PathLike[str], image: Image.Image, form: str | None) -> np.ndarray:
    if image.mode[0] in "IF":
        values = np.asarray(image)
        is_deep = image.mode == "F" or (image.mode == "I" and form == "TIFF")
        if is_deep or values.min() < 0 or values.max() > 65535:
            raise InputError(
                f"{path!r}: has more than 16 bits a pixel; save it with 8 bits a pixel, 255 (white) where the floor is "
                "free and 0 (black) at walls"
            )
        return ((values.astype(np.int64) + 128) // 257).astype(np.uint8)[..., None]
    plain = "L" if image.mode in ("1", "L") else "RGB"
    pixels = np.array(image.convert("RGBA" if image.has_transparency_data else plain))
    return pixels[..., None] if pixels.ndim == 2 else pixels


def _marked_start(
    levels: np.ndarray, pixel_m: tuple[float, float], cell_m: float, cells: np.ndarray
) -> tuple[int, int, int] | None:
    if levels.shape[2] < 3:
        return None
    rgb = levels[..., :3]
    coloured = rgb.max(axis=2) - rgb.min(axis=2) >= _SATURATED
    if not coloured.any():
        return None
    box = ndimage.find_objects(coloured.view(np.uint8))[0]
    if (rgb[box] != rgb[box][0, 0]).any():
        return None
    row, col = (int((s.start + s.stop) / 2 * size / cell_m) for s, size in zip(box, pixel_m[::-1]))
    return None if cells[row, col] else (row, col, 0)
