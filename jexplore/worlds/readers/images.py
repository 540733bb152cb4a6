"""Pictures as worlds: a pixel is free if it is bright enough, everything else is a wall.

A grey that stands for "unknown" counts as occupied, and so does every pixel that is not fully opaque. A picture is
read as viewers show it: turned as its EXIF orientation says.
"""

import io
import os
import warnings

import numpy as np
from PIL import Image, ImageOps

from jexplore.arrays.files import first_line, read_bytes, told_kind
from jexplore.config import InputError, InputWarning, require_number
from jexplore.worlds.readers.resample import resample
from jexplore.worlds.world import World

MAX_PIXELS = 64 * 10**6
_MAX_BYTES = 512 * 2**20  # 64 megapixels of eight bytes
_FORMATS = ("PNG", "PPM", "JPEG", "BMP", "GIF", "TIFF")  # none that starts another program, as EPS does
_JPEG_GREYS = 16  # a JPEG of no more greys has nothing blurred; a drawing has a few
_BLACK, _WHITE = 16, 250  # greys up to and from these are no others that have been blurred
_SATURATED = 128  # largest minus smallest of red, green, blue: a grey has 0, pure yellow 255


def load_image(path: str, scale: float | tuple[float, float], *, cell_m: float = 0.1, free: float = 250) -> World:
    """Load a world from a picture.

    A filled rectangle of one saturated colour in an otherwise grey picture, as in the dungeon maps, marks the start:
    its middle, heading 0. This holds only if it has the only colour and its cell is free.

    Args:
      path: PNG, PGM, PBM, PPM, JPEG, BMP, GIF (its first frame) or TIFF.
      scale: `(width_m, height_m)`: the bounding box of the occupied pixels is stretched to this size, as Stage does; or
        a number: metres a pixel of the whole picture.
      cell_m: edge of a cell, metres.
      free: a pixel is free if its grey, 0 to 255, is at least this.

    Returns:
      A `World` as drawn: its edges need not be occupied. The origin is the lower left corner of the used part.

    Warns:
      InputWarning: most of the picture is transparent; or as `read_pixels`.

    Raises:
      InputError: the file cannot be read, has no free pixel, or the world would be too large.
    """
    require_number(f"{path!r}: free", free, low=0, high=255)
    levels = read_pixels(path)[::-1]
    occupied = _occupied(path, levels, free)
    bottom, left = 0, 0
    rows, cols = occupied.shape
    if isinstance(scale, tuple):
        if not occupied.any():
            raise InputError(
                f"{path!r}: no pixel is occupied, so there is no box to stretch; take @0.05, metres a pixel"
            )
        (bottom, rows), (left, cols) = (_extent(occupied.any(axis=axis)) for axis in (1, 0))
        pixel_m = (scale[0] / cols, scale[1] / rows)
    else:
        pixel_m = (scale, scale)
    box = (slice(bottom, bottom + rows), slice(left, left + cols))
    if occupied[box].all():
        raise InputError(
            f"{path!r}: no pixel is free within the box round the occupied ones; take @0.05, metres a pixel"
        )
    cells = resample(occupied[box], pixel_m, cell_m, name=path)
    return World(occupied=cells, start=_marked_start(levels[box], pixel_m, cell_m, cells), cell_m=cell_m, name=path)


def _occupied(path, levels, free):
    """Return the occupied cells of a picture; refuse one without free cells."""
    shade = grey(levels)
    clear = transparency(levels)
    occupied = (shade < free) | clear
    if occupied.all():
        cure = "append :free=... after the scale to set another bound"
        if clear.mean() > 0.1:
            cure = f"{clear.mean():.0%} of its pixels are transparent, which counts as occupied: flatten it onto white"
        raise InputError(
            f"{path!r}: no pixel is free; the brightest opaque grey is {_brightest(shade, clear)} and free is "
            f"{free:g}; {cure}"
        )
    if clear.mean() > 0.5:
        text = "of its pixels are transparent, which counts as occupied; if they are floor, flatten it onto white"
        warnings.warn(f"{path!r}: {clear.mean():.0%} {text}", InputWarning, stacklevel=3)
    return occupied


def read_pixels(path: str | os.PathLike[str], *, as_stored: bool = False) -> np.ndarray:
    """Read the pixels of a picture file, refused by its header if there are too many.

    Args:
      path: the file.
      as_stored: pass over the orientation that EXIF data give, as the map servers of ROS do.

    Returns:
      `[h, w, c]` uint8, row 0 at the top; c is 1 (grey), 3 (red, green, blue) or 4 (and opacity). Sixteen bit greys
      are scaled to 0..255; so are the 32 bits of a TIFF, whose white is the least of 1 (floating point), 255 and 65535
      that no pixel is above.

    Warns:
      InputWarning: a JPEG that is blurred, or several frames or pages, of which the first is read.

    Raises:
      InputError: the file cannot be read, is no picture, is cut short, has more than `MAX_PIXELS` pixels, or pixels of
        32 bits below 0 or above 65535.
    """
    content = read_bytes(path, _MAX_BYTES)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's own bound on the size lies above ours; the rest is cosmetic
            image = Image.open(io.BytesIO(content), formats=_FORMATS)
            width, height = image.size
            if width * height > MAX_PIXELS:
                raise Image.DecompressionBombError
            if image.format == "PPM":
                image = Image.open(io.BytesIO(_with_short_line_end(content, image)), formats=_FORMATS)
            is_animated = getattr(image, "is_animated", False) and image.format in ("GIF", "PNG", "TIFF")
            levels = _levels(path, image if as_stored else _upright(image), image.format)
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
        warnings.warn(f"{path!r}: has several frames or pages, and the first is read", InputWarning, stacklevel=3)
    if image.format == "JPEG":
        _warn_of_blur(path, grey(levels))
    return levels


def _upright(image):
    """Turn a picture as its EXIF data say; unchanged if these are damaged."""
    image.load()  # raises where the picture itself is damaged
    try:
        return ImageOps.exif_transpose(image)
    except Exception:
        return image


def _with_short_line_end(content, image):
    """Normalise a binary PBM, PGM or PPM: one character between header and pixels, where CR LF are two.

    The two are told from CR and a first pixel of 10 by the length of the file.
    """
    start = image.tile[0][2]
    header = content[:start]
    if not header.endswith(b"\r") or content[start : start + 1] != b"\n":
        return content
    most = 1 if header.startswith(b"P4") else int(header.split()[-1])
    bits = most.bit_length() if most == 1 else 8 if most < 256 else 16
    size = image.height * -(-image.width * bits * len(image.getbands()) // 8)
    return header[:-1] + content[start:] if len(content) == start + 1 + size else content


def _warn_of_blur(path, shade):
    count = np.bincount(shade.ravel(), minlength=256)
    if np.count_nonzero(count) > _JPEG_GREYS:
        share = count[_BLACK + 1 : _WHITE].sum() / shade.size
        warnings.warn(
            f"{path!r}: is a JPEG, and blurred round its walls: {share:.1%} of its pixels are neither black nor white, "
            "and openings may be narrower than drawn; save the drawing as PNG (in a world's name, :free=230 helps)",
            InputWarning,
            stacklevel=4,
        )


def grey(levels: np.ndarray) -> np.ndarray:
    """Convert `[h, w, c]` levels to `[h, w]` uint8 greys: unchanged, or the luma of ITU-R 601 as in Pillow."""
    if levels.shape[2] == 1:
        return levels[..., 0]
    return np.asarray(Image.fromarray(np.ascontiguousarray(levels[..., :3])).convert("L"))


def transparency(levels: np.ndarray) -> np.ndarray:
    """Return `[h, w]` bool, where `[h, w, c]` levels are not fully opaque."""
    if levels.shape[2] == 4:
        return levels[..., 3] < 255
    return np.zeros(levels.shape[:2], bool)


def _levels(path, image, form):
    plain = "save it with 8 bits a pixel, 255 (white) where the floor is free and 0 (black) at walls"
    if form == "TIFF" and image.mode in ("I", "F"):
        return _levels_of_32_bits(path, np.asarray(image), plain)
    if image.mode.startswith("I"):
        values = np.asarray(image).astype(np.int64)
        if values.min() < 0 or values.max() > 65535:
            raise InputError(f"{path!r}: has more than 16 bits a pixel; {plain}")
        return ((values + 128) // 257).astype(np.uint8)[..., None]
    plain = "L" if image.mode in ("1", "L") else "RGB"
    pixels = np.array(image.convert("RGBA" if image.has_transparency_data else plain))
    return pixels[..., None] if pixels.ndim == 2 else pixels


def _levels_of_32_bits(path, values, plain):
    """Scale greys of unknown range: white is the least of 1 (of floats), 255 and 65535 that none is above."""
    top = values.max()  # NaN is no number at all
    whites = (1, 255, 65535) if values.dtype.kind == "f" else (255, 65535)
    white = next((white for white in whites if top <= white), None)
    if white is None or not values.min() >= 0:
        raise InputError(f"{path!r}: has pixels of 32 bits from {values.min():g} to {top:g}; {plain}")
    return np.floor(values * (255 / white) + 0.5).astype(np.uint8)[..., None]


def _brightest(shade, clear):
    opaque = shade[~clear]
    return int(opaque.max()) if opaque.size else "none"


def _extent(any_along):
    """Return first index and length of the range from the first to the last True."""
    where = np.flatnonzero(any_along)
    return int(where[0]), int(where[-1] - where[0] + 1)


def _marked_start(levels, pixel_m, cell_m, cells):
    if levels.shape[2] < 3:
        return None
    rgb = levels[..., :3]
    coloured = rgb.max(axis=2) - rgb.min(axis=2) >= _SATURATED
    if not coloured.any():
        return None
    (bottom, rows), (left, cols) = (_extent(coloured.any(axis=axis)) for axis in (1, 0))
    block = rgb[bottom : bottom + rows, left : left + cols]
    if (block != block[0, 0]).any():
        return None
    col, row = (
        (low + n / 2) * size / cell_m for low, n, size in ((left, cols, pixel_m[0]), (bottom, rows, pixel_m[1]))
    )
    return None if cells[int(row), int(col)] else (int(row), int(col), 0)
