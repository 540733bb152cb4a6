"""Readers of map files, and the resampling below them."""

import itertools
import json
import math
import struct
import zlib
from fractions import Fraction

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image
from ref.refusals import refused
from scipy import ndimage
from skimage.measure import points_in_poly

from jexplore.config import InputWarning
from jexplore.worlds import load_world
from jexplore.worlds.bounds import MAX_SIDE
from jexplore.worlds.readers import houseexpo
from jexplore.worlds.readers.grids import inside_polygon, require_upright, resample
from jexplore.worlds.readers.images import grey, load_image, read_pixels, transparency
from jexplore.worlds.readers.ros import load_ros, read_ros, write_ros
from jexplore.worlds.starts import check_start, start_region

pictures = hnp.arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9)))
sizes = st.fractions(min_value=Fraction(1, 5), max_value=4, max_denominator=7)


def save(path, pixels, mode=None):
    """Write a picture; `pixels` has its row 0 at the top."""
    Image.fromarray(np.asarray(pixels, np.uint8 if mode is None else mode)).save(path)
    return path


# --- resampling


def test_resample_to_cells_of_one_size_changes_nothing_for_rounding():
    for pixels, cell_m in itertools.product((1, 333, 4096), (0.1, 1 / 3, 0.0454)):
        occupied = np.random.default_rng(0).random((2, pixels)) < 0.5
        assert np.array_equal(resample(occupied, (cell_m, cell_m), cell_m, name=""), occupied)


@settings(deadline=None, max_examples=20)
@given(pictures, sizes, sizes)
def test_resample_is_occupied_where_any_occupied_pixel_overlaps(occupied, x, y):
    """The oracle compares exact intervals, cell by cell and pixel by pixel."""
    cells = resample(occupied, (float(x), float(y)), 1.0, name="")
    assert cells.shape == (math.ceil(y * occupied.shape[0]), math.ceil(x * occupied.shape[1]))
    for row, col in np.ndindex(cells.shape):
        overlapping = [
            bool(occupied[r, c])
            for r, c in np.ndindex(occupied.shape)
            if r * y < row + 1 and (r + 1) * y > row and c * x < col + 1 and (c + 1) * x > col
        ]
        assert cells[row, col] == any(overlapping)


def test_too_large_a_world_is_refused_before_allocating_and_says_which_cell_would_do():
    picture = np.zeros((2, 2), bool)
    assert resample(picture, (1, 1024), 0.5, name="").shape == (MAX_SIDE, 4)
    refused("over a billion cells are more than 4096", resample, picture, (1e6, 1e6), 0.001, name="")
    picture = np.zeros((3, 2), bool)
    line = r"'m.png': 12345 x 6 cells are more than 4096 a side; use a larger cell_m, at least 0.31, or cut"
    refused(line, resample, picture, (0.3, 411.5), 0.1, name="m.png")  # 1234.5 m in 4094 cells and a ring: 0.3015 m
    assert resample(picture, (0.3, 411.5), 0.31, name="").shape == (3983, 2)
    refused("see whether its scale, the metres of a pixel, is right", resample, picture, (1, 1e6), 1, name="")
    for pixel_m in ((1e-300, 1), (1, 9e-5), (1, 2e6), (math.inf, 1), (math.nan, 1)):
        refused("'m.png': a pixel must be 0.0001 to 1e", resample, picture, pixel_m, 0.1, name="m.png")


# --- images


def test_image_at_metres_a_pixel_by_pencil(tmp_path):
    path = save(tmp_path / "m.png", [[0, 255, 250], [205, 249, 254]])
    world = load_world(f"{path}@0.1")
    assert world.occupied.tolist() == [[1, 1, 0], [1, 0, 0]]
    assert world.name == f"{path}@0.1"
    assert world.origin_m == (0.0, 0.0)
    assert world.rooms is None
    assert world.start is None
    assert load_world(path.parent / "m.png@0.1").shape == (2, 3)
    assert load_world(f"{path}@0.1:free=205").occupied[0].tolist() == [False, False, False]
    assert load_world(f"{path}@0.1:free=255").occupied[1].tolist() == [True, False, True]
    assert load_world(f"{path}@0.2").shape == (4, 6)


def test_image_of_a_size_stretches_the_box_of_what_is_occupied(tmp_path):
    pixels = np.full((20, 30), 255, np.uint8)
    pixels[4, 5:9] = 0  # the box: rows 4 to 7, columns 5 to 8
    pixels[7, 5] = 0
    world = load_world(f"{save(tmp_path / 'm.png', pixels)}@0.8x0.4")
    inner = np.zeros((4, 8), bool)
    inner[3] = True
    inner[0, :2] = True
    assert np.array_equal(world.occupied, inner)
    assert world.shape == (4, 8)
    assert world.origin_m == (0.0, 0.0)


def test_transparent_is_occupied_whatever_its_colour(tmp_path):
    levels = np.full((1, 4, 4), 255, np.uint8)
    levels[0, 1, 3] = 254
    levels[0, 2, 3] = 0
    world = load_world(f"{save(tmp_path / 'm.png', levels)}@0.1")
    assert world.occupied[0].tolist() == [False, True, True, False]
    levels[..., 3] = 0
    refused("the brightest opaque grey is none", load_world, f"{save(tmp_path / 'n.png', levels)}@0.1")


def test_a_transparent_floor_says_what_to_do(tmp_path):
    levels = np.zeros((6, 10, 4), np.uint8)
    levels[0, :, 3] = 255  # a black wall on nothing
    line = "no pixel is free; .* 83% of its pixels are transparent, which counts as occupied: flatten it onto white"
    refused(line, load_world, f"{save(tmp_path / 'm.png', levels)}@0.1")
    levels[1] = 255  # and a white strip: 40 of 60 are left
    with pytest.warns(InputWarning, match="m.png': 67% of its pixels are transparent, .* flatten it onto white"):
        world = load_world(f"{save(tmp_path / 'm.png', levels)}@0.1")
    assert (~world.occupied).sum() == 10
    levels[2:4] = 255  # 20 of 60: perhaps what lies outside
    assert (~load_world(f"{save(tmp_path / 'm.png', levels)}@0.1").occupied).sum() == 30


def test_a_coloured_block_marks_the_start(tmp_path):
    pixels = np.full((10, 12, 3), 195, np.uint8)
    pixels[0] = 127
    pixels[2:4, 6:10] = (255, 216, 0)
    path = save(tmp_path / "d.png", pixels)
    world = load_world(f"{path}@0.1:free=150")
    assert world.start == (7, 8, 0)  # row 10 - 3 and column 8 of the picture
    assert load_world(f"{path}@0.2:free=150").start == (14, 16, 0)
    assert load_world(f"{path}@0.1:free=190", cell_m=0.2).start == (3, 4, 0)
    pixels[9, 2:] = 127
    stretched = load_world(f"{save(tmp_path / 'box.png', pixels)}@6x2:free=150")  # half a metre by 0.2 m a pixel
    assert stretched.start == (14, 40, 0)  # 1.4 m up and 4 m along
    pixels[0, :10] = 195  # the box begins at column 2
    pixels[0, 11] = 195
    assert load_world(f"{save(tmp_path / 'box.png', pixels)}@5x2:free=150").start == (14, 30, 0)
    pixels[0], pixels[9] = 127, 195
    pixels[5, 5] = (255, 216, 0)
    assert load_world(f"{save(tmp_path / 'two.png', pixels)}@0.1:free=150").start is None
    pixels[2:6, 5:10] = (255, 0, 0)  # grey 76: a start in a wall does not count
    assert load_world(f"{save(tmp_path / 'red.png', pixels)}@0.1:free=150").start is None


@pytest.mark.parametrize("suffix", ["png", "pgm", "bmp", "gif", "tif", "tiff", "ppm", "PNG"])
def test_formats_give_the_same_world(tmp_path, suffix):
    pixels = np.array([[0, 255, 255], [255, 255, 0]], np.uint8)
    image = Image.fromarray(pixels)
    path = tmp_path / f"m.{suffix}"
    (image.convert("RGB") if suffix == "ppm" else image).save(path)
    assert np.array_equal(load_world(f"{path}@0.1").occupied, pixels[::-1] == 0)


def test_a_jpeg_and_a_bitmap(tmp_path):
    pixels = np.zeros((16, 32), np.uint8)
    pixels[:, 16:] = 255
    for name in ("m.jpg", "m.jpeg"):
        save(tmp_path / name, pixels)
        assert np.array_equal(load_world(f"{tmp_path / name}@0.1").occupied, pixels == 0)
    thin = np.full((60, 60), 255, np.uint8)
    thin[[3, 30, 57]], thin[:, [5, 44]] = 0, 0
    Image.fromarray(thin).save(tmp_path / "m.jpg", quality=60)
    with pytest.warns(InputWarning, match=r"m.jpg': is a JPEG, and blurred .* \d+\.\d% of its .* as PNG") as told:
        blurred = load_world(f"{tmp_path / 'm.jpg'}@0.1").occupied
    assert len(told) == 1
    assert blurred[thin[::-1] == 0].all()  # no wall is lost,
    assert blurred.sum() > load_world(f"{save(tmp_path / 'thin.png', thin)}@0.1").occupied.sum()  # but walls grow
    (tmp_path / "m.pbm").write_text("P1\n3 2\n1 0 0\n0 0 1\n")  # 1 is black
    assert load_world(f"{tmp_path / 'm.pbm'}@0.1").occupied.tolist() == [[0, 0, 1], [1, 0, 0]]


def test_sixteen_bits_palettes_and_colours(tmp_path):
    wide = save(tmp_path / "wide.png", np.array([[0, 32768, 64249, 64250, 65535]]), np.uint16)
    assert read_pixels(str(wide))[0, :, 0].tolist() == [0, 128, 250, 250, 255]
    (tmp_path / "wide.pgm").write_bytes(b"P5\n2 1\n65535\n" + struct.pack(">HH", 65535, 257))
    assert read_pixels(str(tmp_path / "wide.pgm"))[0, :, 0].tolist() == [255, 1]
    palette = Image.fromarray(np.array([[0, 1]], np.uint8), mode=None).convert("P")
    palette.putpalette([255, 255, 255, 0, 0, 0])
    palette.putdata([0, 1])
    palette.save(tmp_path / "palette.png", transparency=1)
    levels = read_pixels(str(tmp_path / "palette.png"))
    assert grey(levels).tolist() == [[255, 0]]
    assert transparency(levels).tolist() == [[0, 1]]
    colours = save(tmp_path / "colours.png", [[[255, 0, 0], [0, 255, 0], [0, 0, 255]]])
    assert grey(read_pixels(str(colours))).tolist() == [[76, 150, 29]]  # .299, .587, .114


@pytest.mark.parametrize(
    ("orientation", "shape", "corner"),
    [(1, (16, 24), "top left"), (3, (16, 24), "bottom right"), (6, (24, 16), "top right")],
)
def test_a_picture_is_turned_as_its_exif_data_say_but_in_a_ros_map(tmp_path, orientation, shape, corner):
    """As viewers show it: 6, of a camera held upright, is turned clockwise by a quarter."""
    stored = np.zeros((16, 24), np.uint8)
    stored[:8, :8] = 255  # top left
    image = Image.fromarray(stored)
    image.getexif()[0x0112] = orientation
    image.save(tmp_path / "m.png", exif=image.getexif())
    occupied = load_image(str(tmp_path / "m.png"), 0.1, free=200).occupied
    assert occupied.shape == shape
    rows = slice(-8, None) if "top" in corner else slice(0, 8)
    cols = slice(0, 8) if "left" in corner else slice(-8, None)
    assert not occupied[rows, cols].any()
    assert occupied.sum() == 320
    path = ros_map(tmp_path, stored, image="m.png")
    assert np.array_equal(read_ros(path)[0][::-1] == 0, stored == 255)


def test_images_that_are_no_map_are_refused(tmp_path):
    white = save(tmp_path / "white.png", np.full((3, 3), 255))
    black = save(tmp_path / "black.png", np.full((3, 3), 40))
    refused(r"a picture needs a scale; append @16x16 for its size", load_world, white)
    refused("no pixel is occupied, so there is no box", load_world, f"{white}@2x2")
    refused("no pixel is free; the brightest opaque grey is 40 and free is 250", load_world, f"{black}@0.1")
    refused("free must be a number at least 0 and at most 255, got 256", load_world, f"{white}@0.1:free=256")
    refused("free must be a number", load_world, f"{white}@0.1:free=bright")
    line = "no parameter 'fre'; it takes free, inside, inside_x_m, inside_y_m .did you mean 'free'"
    refused(line, load_world, f"{white}@0.1:fre=1")
    refused("30000 x 30000 cells are more than 4096", load_world, f"{white}@1000")
    line = save(tmp_path / "line.png", np.vstack([np.zeros((1, 4)), np.full((3, 4), 255)]))
    refused("no pixel is free within the box round the occupied ones", load_world, f"{line}@4x4")
    dots = np.full((30, 30), 255, np.uint8)
    dots[::5, ::5] = 0
    refused("no cell is free at cell_m = 1;", load_world, f"{save(tmp_path / 'dots.png', dots)}@0.1", cell_m=1)


def test_files_that_cannot_be_read_are_refused(tmp_path, monkeypatch):
    good = save(tmp_path / "good.png", np.random.default_rng(0).integers(0, 256, (50, 50)))
    data = good.read_bytes()
    for name, content, line in (
        ("empty.png", b"", "is empty"),
        ("text.png", b"hello", "is no picture in a known format"),
        ("cut.png", data[: len(data) // 2], "is damaged or cut short"),
        ("flipped.png", data[:60] + bytes([data[60] ^ 255]) + data[61:], "is damaged or cut short"),
        ("cut.pgm", b"P5\n4 4\n255\n123", "is damaged or cut short"),
        ("none.pgm", b"P5\n0 4\n255\n", "is (damaged|no picture)"),
        ("plan.eps", b"%!PS-Adobe", "is neither"),
        ("eps.png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 5 5\n", "is no picture"),
    ):
        (tmp_path / name).write_bytes(content)
        refused(line, load_world, f"{tmp_path / name}@0.1")
    (tmp_path / "folder.png").mkdir()
    refused("is a directory", load_world, f"{tmp_path / 'folder.png'}@0.1")
    refused("there is no such file", load_world, f"{tmp_path / 'absent.png'}@0.1")
    monkeypatch.chdir(tmp_path)
    refused("'absent.png': there is no such file .looked in ", load_world, "absent.png@0.1")
    refused("cannot be opened", load_world, "nul\0.png@0.1")
    for kind in (np.float32, np.int32):
        Image.fromarray(np.full((2, 2), 1, kind)).save("deep.tif")
        refused("'deep.tif': has more than 16 bits a pixel; save it with 8 bits", load_world, "deep.tif@0.1")


@pytest.mark.parametrize("name", ["m.gif", "m.tif", "m.png"])
def test_of_several_frames_the_first_is_read_and_said(tmp_path, name):
    frames = [Image.fromarray(np.array(row, np.uint8)) for row in ([[0, 255]], [[255, 0]])]
    frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
    with pytest.warns(InputWarning, match=f"{name}': has several frames or pages, and the first is read"):
        assert grey(read_pixels(str(tmp_path / name))).tolist() == [[0, 255]]


@pytest.mark.parametrize("name", ["m.yaml", "m.log", "m.json", "m.png@0.1", "m.db3"])
def test_a_file_of_another_kind_is_told_what_it_is(tmp_path, name):
    for content, said in (
        (b"#ROSBAG V2.0\n", "a bag of ROS 1, whose name must end in .bag"),
        (b"\x89MCAP0\r\n", "a recording of ROS 2, whose name must end in .mcap"),
        (b"\x89PNG\r\n\x1a\n", "is no picture|is damaged" if "png" in name else "a picture, whose name must end"),
        (b"\x1f\x8b\x08\0", "compressed; unpack it"),
        ("FLASER 1".encode("utf-16"), "text in UTF-16; save it as UTF-8"),
    ):
        (tmp_path / name.partition("@")[0]).write_bytes(content)
        refused(said, load_world, f"{tmp_path / name}")


def png_header(width, height):
    """A PNG that claims to be of this size and holds no pixel."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


def test_a_huge_image_is_refused_by_its_header(tmp_path):
    (tmp_path / "bomb.png").write_bytes(png_header(8001, 8000))
    refused("has more than 64 megapixels; cut it into parts, or", load_world, f"{tmp_path / 'bomb.png'}@0.1")
    (tmp_path / "fits.png").write_bytes(png_header(8000, 8000))
    refused("is damaged or cut short", load_world, f"{tmp_path / 'fits.png'}@0.1")


# --- ROS


def ros_map(folder, pixels, suffix="pgm", **changes):
    """Write a ROS map and return its yaml; a change of None takes the key away."""
    save(folder / f"m.{suffix}", pixels)
    keys = {
        "image": f"m.{suffix}",
        "resolution": 0.1,
        "origin": [-1.5, 2.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    } | changes
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in keys.items() if value is not None}))
    return path


def test_ros_trinary_by_pencil(tmp_path):
    path = ros_map(tmp_path, [[0, 89, 90], [204, 205, 206], [254, 255, 128]])
    occupancy, info = read_ros(path)
    # (255 - 89) / 255 = 0.651; (255 - 205) / 255 = 0.19608, just not below 0.196
    assert occupancy.tolist() == [[0, 0, -1], [-1, -1, 0], [100, 100, -1]]
    assert occupancy.dtype == np.int8
    assert (info.resolution_m, info.origin_m, info.mode, info.negate) == (0.1, (-1.5, 2.0), "trinary", False)
    world = load_world(path)
    assert world.occupied.tolist() == [[0, 0, 1], [1, 1, 0], [1, 1, 1]]
    assert world.origin_m == pytest.approx((-1.5, 2.0))
    assert world.start is None
    assert world.name == str(path)


@pytest.mark.parametrize("negate", [0, 1])
def test_a_ros_pixel_on_a_threshold_is_free_or_occupied(tmp_path, negate):
    pixels = np.array([[101, 102, 103, 203, 204, 205]])  # 102 and 204 have exactly p = 0.6 and 0.2
    path = ros_map(tmp_path, 255 - pixels if negate else pixels, occupied_thresh=0.6, free_thresh=0.2, negate=negate)
    assert read_ros(path)[0].tolist() == [[100, 100, -1, -1, 0, 0]]


def test_ros_scale_is_linear_between_the_bounds(tmp_path):
    levels = np.full((1, 6, 4), 255, np.uint8)
    levels[0, :, :3] = np.array([[0, 51, 102, 153, 204, 255]]).T  # p = 1, 0.8, 0.6, 0.4, 0.2, 0
    path = ros_map(tmp_path, levels, "png", mode="scale", occupied_thresh=0.9, free_thresh=0.1)
    assert read_ros(path)[0].tolist() == [[100, 88, 63, 37, 12, 0]]  # 37.5 and 12.5 are a little less in 32 bits
    levels[0, 3, 3] = 254
    ros_map(tmp_path, levels, "png", mode="scale", occupied_thresh=0.9, free_thresh=0.1)
    assert read_ros(path)[0].tolist() == [[100, 88, 63, -1, 12, 0]]
    assert load_ros(path).occupied.tolist() == [[1, 1, 1, 1, 0, 0]]
    assert load_ros(path, free_max=70).occupied.tolist() == [[1, 1, 0, 1, 0, 0]]


def test_ros_raw_is_the_value_itself(tmp_path):
    path = ros_map(tmp_path, [[0, 1, 25, 65, 100, 101, 255]], mode="RAW")
    assert read_ros(path)[0].tolist() == [[0, 1, 25, 65, 100, -1, -1]]
    assert load_ros(path).occupied.tolist() == [[0, 0, 0, 1, 1, 1, 1]]
    ros_map(tmp_path, [[0, 100]], mode="raw", negate=1)
    assert read_ros(path)[0].tolist() == [[0, 100]]  # as nav2: raw does not negate


@pytest.mark.parametrize("alpha", [0, 128, 254])
def test_ros_pixels_that_are_not_opaque_are_unknown(tmp_path, alpha):
    levels = np.zeros((1, 4, 4))
    levels[0, :2, :3], levels[..., 3] = 255, [255, alpha, 255, alpha]
    for mode, expected in (("trinary", [0, -1, 100, -1]), ("scale", [0, -1, 100, -1]), ("raw", [-1, -1, 0, 0])):
        assert read_ros(ros_map(tmp_path, levels, "png", mode=mode))[0].tolist() == [expected]
    line = "no pixel is free at free_thresh 0.196, negate 0; 50% of its pixels are transparent: flatten"
    refused(line, load_ros, ros_map(tmp_path, levels[:, 1:3], "png"))


def told_of_unknown(path, line):
    """The occupancy, and the world, which is told to have free cells that are unknown."""
    with pytest.warns(InputWarning, match=line):
        world = load_ros(path)
    return read_ros(path)[0].tolist(), world.occupied.astype(int).tolist()


def test_unknown_grey_that_turns_free_is_read_as_the_map_server_does_and_told(tmp_path):
    """Worked out from map_io.cpp: p = (255 - 205) / 255 = 0.196 is free up to 0.25; between bounds of 0.1 and 0.9 it
    is 12 of 100.
    """
    grey = np.array([[205, 205, 254, 0]])
    assert load_ros(ros_map(tmp_path, grey)).occupied.tolist() == [[1, 1, 0, 1]]  # without a word
    line = (
        "m.yaml': 50% of its pixels are grey 205, which stands for unknown, and yet free, as in the map server; to "
        "have them unknown "
    )
    path = ros_map(tmp_path, grey, free_thresh=0.25)
    assert told_of_unknown(path, line + "write free_thresh: 0.196$") == ([[0, 0, 0, 100]], [[0, 0, 0, 1]])
    path = ros_map(tmp_path, grey, mode="scale", occupied_thresh=0.9, free_thresh=0.1)
    assert told_of_unknown(path, line + "write mode: trinary$") == ([[12, 12, 0, 100]], [[0, 0, 0, 1]])
    assert load_ros(path, free_max=10).occupied.tolist() == [[1, 1, 0, 1]]
    few = np.full((15, 10), 254)
    few[0, 0] = 205  # 0.7 %
    load_ros(ros_map(tmp_path, few, free_thresh=0.25))
    assert load_ros(ros_map(tmp_path, [[205, 50]], mode="raw", negate=0), free_max=60).occupied.tolist() == [[1, 0]]


def test_a_mask_of_0_and_1_in_mode_raw_has_no_wall_and_is_refused(tmp_path):
    path = ros_map(tmp_path, [[0, 1]], mode="raw")
    assert read_ros(path)[0].tolist() == [[0, 1]]  # what the map server publishes
    refused("m.yaml': integers of 0 and 1 alone would have no wall, for 100 is occupied", load_ros, path)
    path = ros_map(tmp_path, [[0, 255]], mode="raw")
    with pytest.warns(InputWarning, match="in mode raw black is free and white unknown"):
        assert load_ros(path).occupied.tolist() == [[0, 1]]


@pytest.mark.parametrize("yaw", [0, 1e-6, -2 * math.pi])
def test_a_ros_map_lies_as_it_is(tmp_path, yaw):
    free = np.array([[1, 0, 0, 0], [1, 1, 1, 0], [0, 0, 1, 1]], bool)  # row 0 is the bottom
    path = ros_map(tmp_path, np.where(free, 254, 0)[::-1], resolution=0.5, origin=[-2, 1, yaw])
    world = load_ros(path, cell_m=0.5)
    assert np.array_equal(world.occupied, ~free)
    assert world.origin_m == (-2, 1)


def test_a_turned_ros_map_is_refused():
    refused("is turned by 17.19 degrees; with a yaw of 0", require_upright, "m", (3, 4), 0.3)
    refused("180 degrees; with a yaw of 0", require_upright, "m", (3, 4), -math.pi)


def test_ros_yaml_is_read_as_written_by_people(tmp_path):
    save(tmp_path / "m.pgm", [[254]])
    (tmp_path / "m.yaml").write_text(
        "image: ./m.pgm\nresolution: 5e-2  # YAML 1.1 has this as a string\norigin: [-1, 0, -0.0]\n"
        "negate: false\noccupied_thresh: 1\nfree_thresh: 0.2\nmode: trinary\nextra: 1\n"
    )
    _, info = read_ros(tmp_path / "m.yaml")
    assert (info.resolution_m, info.origin_m, info.negate) == (0.05, (-1.0, 0.0), False)
    (tmp_path / "sub").mkdir()
    ros_map(tmp_path / "sub", [[254]], image=str(tmp_path / "m.pgm"))
    assert read_ros(tmp_path / "sub" / "m.yaml")[1].image == str(tmp_path / "m.pgm")


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"image": None}, "the key 'image' is missing"),
        ({"image": "gone.pgm"}, "m.yaml': its image cannot be read: '.*gone.pgm': there is no such file"),
        ({"image": 3}, "image must be the name of a file, got 3"),
        ({"resolution": 0}, r"resolution must be a number at least 0.0001 and at most 1e\+06, got 0.0"),
        ({"resolution": "fine"}, r"resolution must be a number at least 0.0001 .* got 'fine'"),
        ({"resolution": 10**400}, r"resolution must be a number .* got 1000.*\.\.\..*000"),
        ({"resolution": 1e6}, "are more than 4096 a side; see whether its scale, the metres of a pixel, is right"),
        ({"origin": [0, 1e300, 0]}, "origin must be a number at least -1e"),
        ({"origin": [0, 0]}, r"origin must be \[x, y, yaw\]"),
        ({"negate": 2}, "negate must be a number"),
        ({"occupied_thresh": 65}, "occupied_thresh must be a number at least 0 and at most 1"),
        ({"free_thresh": 0.65}, "free_thresh 0.65 must be below occupied_thresh 0.65"),
        ({"mode": "color"}, "mode must be one of trinary, scale, raw, got 'color'"),
        ({"negate": 1}, "no pixel is free at free_thresh 0.196, negate 1"),
    ],
)
def test_bad_ros_maps_are_refused(tmp_path, changes, line):
    refused(line, load_world, ros_map(tmp_path, [[254, 254]], **changes))


@pytest.mark.parametrize(
    ("text", "line"),
    [("", "is empty"), ("- 1\n", "is not a ROS map; expected the keys"), ("image: [", "is not valid YAML")],
)
def test_bad_yaml_is_refused(tmp_path, text, line):
    (tmp_path / "m.yaml").write_text(text)
    refused(line, load_world, tmp_path / "m.yaml")
    (tmp_path / "m.yaml").write_bytes(b"image: \xff\n")
    refused("is not UTF-8 text", load_world, tmp_path / "m.yaml")


def test_write_ros_by_pencil(tmp_path):
    write_ros(np.zeros((2, 2), bool), tmp_path / "o.yaml", cell_m=0.1 + 0.2, origin_m=(-14.2 - 0.1, -1e-17))
    assert (
        "resolution: 0.3\norigin: [-14.3, 0.0, 0.0]\n" in (tmp_path / "o.yaml").read_text()
    )  # without rounding errors
    image = write_ros(np.array([[0, 100], [-1, 0]]), tmp_path / "o.yaml", cell_m=0.25, origin_m=(-1, 1e-7))
    assert image == tmp_path / "o.pgm"
    assert image.read_bytes() == b"P5\n2 2\n255\n" + bytes([205, 254, 254, 0])
    assert yaml.safe_load((tmp_path / "o.yaml").read_text()) == {
        "image": "o.pgm",
        "mode": "trinary",
        "resolution": 0.25,
        "origin": [-1.0, 1e-7, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


@pytest.mark.parametrize("values", [(-1, 0, 100), tuple(range(-1, 101)), (0,), (-1,), (50,)])
def test_write_ros_is_read_back_unchanged(tmp_path, values):
    occupancy = np.random.default_rng(1).choice(values, (7, 300)).astype(np.int8)
    occupancy[0, : len(values)] = values
    write_ros(occupancy, tmp_path / "odd: #1@2.yaml", cell_m=0.1 + 0.2, origin_m=(-1 / 3, 1e9))
    again, info = read_ros(tmp_path / "odd: #1@2.yaml")
    assert np.array_equal(again, occupancy)
    assert (info.resolution_m, *info.origin_m) == pytest.approx((0.3, -1 / 3, 1e9), rel=1e-12)


def test_bad_things_to_write_are_refused(tmp_path):
    refused("must end in .yaml", write_ros, [[0]], tmp_path / "m.pgm")
    refused("cannot be written", write_ros, [[0]], tmp_path / "none" / "m.yaml")
    refused("must lie from -1 .unknown. to 100, got 0 to 101", write_ros, [[0, 101]], tmp_path / "m.yaml")
    refused("got float64", write_ros, [[0.5]], tmp_path / "m.yaml")
    refused("cell_m must be a number at least 0.0001", write_ros, [[0]], tmp_path / "m.yaml", cell_m=0)
    refused("origin_m must be a number at least -1e", write_ros, [[0]], tmp_path / "m.yaml", origin_m=(math.nan, 0))
    refused("integers of 0 and 1 alone would have no wall", write_ros, [[0, 1]], tmp_path / "m.yaml")
    assert list(tmp_path.iterdir()) == []


# --- other formats


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("p.json@0.1", "a HouseExpo file has its own scale"),
        ("p.json:free=1", "no parameter 'free'; it takes inside, inside_x_m, inside_y_m"),
        ("m.yaml@0.1", "a ROS file has its own scale"),
        ("m.yaml:free=3", "no parameter 'free'; it takes free_max, occupied_min"),
        ("m.yaml:free_max=3", "free_max and occupied_min are for the modes scale and raw; in"),
    ],
)
def test_a_scale_or_parameter_of_another_format_is_refused(tmp_path, name, line):
    plan(tmp_path / "p.json", SQUARE)
    ros_map(tmp_path, [[254]])
    refused(line, load_world, f"{tmp_path / name}")


# --- HouseExpo


def plan(path, verts, rooms=None, **more):
    """Write a plan with the keys that HouseExpo has."""
    low, high = np.min(verts, axis=0).tolist(), np.max(verts, axis=0).tolist()
    keys = {"id": "0", "room_num": 1, "bbox": {"min": low, "max": high}, "verts": verts, "room_category": rooms or {}}
    path.write_text(json.dumps(keys | more))
    return path


def test_houseexpo_rooms_are_the_boxes(tmp_path):
    rooms = {"Hall": [[0, 0, 1, 0.5]], "Bedroom": [[0.3, 0.0, 0.5, 0.5], [0.9, 0.5, 0.3, 0.3]]}
    world = load_world(plan(tmp_path / "p.json", [[0, 0], [0.95, 0], [0.95, 0.55], [0, 0.55]], rooms))
    assert world.shape == (6, 10)
    # the hall (0) is the largest; boxes 1 (0.10 m2) and 2 (0.12 m2, its corners the other way round) lie over it
    assert world.rooms.tolist() == [
        [-1] * 10,
        [-1, 0, 0, 1, 1, 0, 0, 0, 0, -1],
        [-1, 0, 0, 1, 1, 0, 0, 0, 0, -1],
        [-1, 0, 0, 1, 1, 2, 2, 2, 2, -1],
        [-1, 0, 0, 1, 1, 2, 2, 2, 2, -1],
        [-1] * 10,
    ]
    assert world.rooms.dtype == np.int32


@settings(deadline=None, max_examples=30)
@given(st.integers(3, 9), st.integers(0, 10**6), st.sampled_from([0.05, 0.1, 0.23]))
def test_houseexpo_inside_and_outline_agree_with_oracles(n, seed, cell_m):
    """A star of n points: free cells have their centres inside; points along the outline lie in occupied cells."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.random(n)) * 2 * np.pi
    verts = (rng.uniform(0.5, 2, n)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)).round(3)
    corners = (verts - verts.min(axis=0)) / cell_m
    cols, rows = (np.floor(corners.max(axis=0)) + 1).astype(int)
    outline = houseexpo._outline(corners, (rows, cols))
    inside = inside_polygon(corners, np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    y, x = np.indices((rows, cols)).reshape(2, -1) + 0.5
    expected = points_in_poly(np.stack([x, y], axis=1), corners).reshape(rows, cols)
    assert np.array_equal(inside | outline, expected | outline)
    t = np.linspace(0, 1, 200)[:, None]
    for a, b in zip(corners, np.roll(corners, -1, axis=0)):
        col, row = np.floor(a + (b - a) * t).astype(int).clip(0, [cols - 1, rows - 1]).T
        assert outline[row, col].all()
    occupied = outline | ~inside
    assert occupied[[0, -1]].all()
    assert occupied[:, [0, -1]].all()


SQUARE = [[0, 0], [2, 0], [2, 2], [0, 2]]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "is empty"),
        ("{", "is not valid JSON"),
        ("[" * 100000, "more than 100 deep"),
        ("[]", "is not a HouseExpo plan; expected an object with the key 'verts'"),
        ('{"verts": []}', "verts must be at least 3 points"),
        ('{"verts": [[0, 0], [1, 1]]}', "verts must be at least 3 points .* got 2"),
        ('{"verts": [[0, 0], [1, 1], [2]]}', "verts must be a list of .metres, metres."),
        ('{"verts": [[0, 0], [1, 1], [2, NaN]]}', "verts must be a list"),
        ('{"verts": [[0, 0], [1, 1], [2, "a"]]}', "verts must be a list"),
        ('{"verts": [[0, 0], [1, 0], [2, 1e300]]}', "verts must be a list"),
        ('{"verts": [[0, 0], [1, 0], [2, 410]]}', "4101 x 21 cells are more than 4096"),
        ('{"verts": [[0, 0], [0, 0], [0, 0]]}', "no cell is free at cell_m = 0.1"),
        (json.dumps({"verts": SQUARE, "room_category": [1]}), "room_category must map names to lists of boxes"),
        (json.dumps({"verts": SQUARE, "room_category": {"A": [[1, 2, 3]]}}), "room_category 'A' must be a list"),
    ],
)
def test_bad_plans_are_refused(tmp_path, text, line):
    (tmp_path / "p.json").write_text(text)
    refused(line, load_world, tmp_path / "p.json")


# --- real maps


@pytest.mark.parametrize(
    ("name", "shape", "component_m2"),
    [
        ("stage/cave_filled.png@16x16", (160, 160), 195.5),
        ("stage/hospital_section.png@49.3x20.1", (201, 493), 689),
        ("avz/avz5floor_open.yaml", (241, 449), 330),
        ("radish/intel.png@0.05", (424, 444), 513),
    ],
)
def test_real_maps_have_their_size_and_nearly_their_free_area(maps, name, shape, component_m2):
    """Free areas are known at the maps' own resolutions; walls of whole cells make them smaller, by a fifth at most."""
    world = load_world(f"{maps / name}")
    assert world.shape == shape
    labels, _ = ndimage.label(~world.occupied)
    free_m2 = np.bincount(labels.ravel())[1:].max() * world.cell_m**2
    assert 0.8 * component_m2 < free_m2 < component_m2
    assert start_region(world, 0.3).sum() * world.cell_m**2 > 0.5 * free_m2


@pytest.mark.parametrize("name", ["1", "easy_1"])
def test_dungeons_have_their_start(maps, name):
    path = maps / "dungeon" / f"{name}.png"
    world = load_world(f"{path}@0.1:free=150")
    assert world.shape == (480, 640)
    row, col, _ = check_start(world, world.start, 0.3)
    assert np.asarray(Image.open(path))[479 - row, col].tolist() == [255, 216, 0, 255]
    refused("the brightest opaque grey is 203", load_world, f"{path}@0.1")
