"""World names: the grammar, and `load_world`."""

import numpy as np
import pytest
from ref.refusals import refused

from jexplore import worlds
from jexplore.worlds import load_world
from jexplore.worlds.names import file_names, parse_name, short_names
from jexplore.worlds.world import World

KNOWN = ("cave", "office", "hospital")


def parsed(name):
    found = parse_name(name, generators=KNOWN)
    assert found.name == name
    return found.kind, found.base, found.seed, found.scale, found.parameters


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("cave", ("generator", "cave", 0, None, {})),
        ("cave#3", ("generator", "cave", 3, None, {})),
        ("hospital#2:width_m=60,height_m=25", ("generator", "hospital", 2, None, {"width_m": 60, "height_m": 25})),
        ("office:door_m=.9,style=a", ("generator", "office", 0, None, {"door_m": 0.9, "style": "a"})),
        ("office#0:loops=true", ("generator", "office", 0, None, {"loops": True})),
        ("map.yaml", ("ROS", "map.yaml", 0, None, {})),
        ("dir/map.YML", ("ROS", "dir/map.YML", 0, None, {})),
        ("map.png@16x16", ("image", "map.png", 0, (16.0, 16.0), {})),
        ("map.png@49.3X2e1", ("image", "map.png", 0, (49.3, 20.0), {})),
        ("map.pgm@0.05", ("image", "map.pgm", 0, 0.05, {})),
        ("map.tiff@0.05:free=150", ("image", "map.tiff", 0, 0.05, {"free": 150})),
        ("map.tif:free=1.5", ("image", "map.tif", 0, None, {"free": 1.5})),
        ("plan.json", ("HouseExpo", "plan.json", 0, None, {})),
        (".png@1", ("image", ".png", 0, 1.0, {})),
    ],
)  # fmt: skip
def test_names_by_pencil(name, expected):
    assert parsed(name) == expected


@pytest.mark.parametrize(
    ("name", "path", "scale"),
    [
        ("a#1/b:c/d@2/map.png@16x8", "a#1/b:c/d@2/map.png", (16.0, 8.0)),
        ("C:/maps/map.pgm", "C:/maps/map.pgm", None),
        ("x.png@2/map.png@0.05", "x.png@2/map.png", 0.05),
        ("map@0.05.png", "map@0.05.png", None),
        ("plan.json.png@1", "plan.json.png", 1.0),
        ("cave#3.png@1", "cave#3.png", 1.0),
    ],
)
def test_a_path_may_contain_the_signs(name, path, scale):
    assert parsed(name)[1:4] == (path, 0, scale)


def test_of_two_cuts_the_longest_file_that_exists_counts(tmp_path):
    name = f"{tmp_path}/a.png@1:b.png"
    assert parsed(name)[1] == name
    (tmp_path / "a.png").touch()
    refused(r"key=value,key=value; got 'b.png'", parsed, name)
    (tmp_path / "a.png@1:b.png").touch()
    assert parsed(name)[1] == name


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("caev", r"there is no world 'caev'; there are cave, office, hospital \(did you mean 'cave'\?\)"),
        ("zzz", "there is no world 'zzz'; there are cave, office, hospital and map files"),
        ("", "is neither"),
        ("map.bin", "is neither .* nor a map file ending in .yaml"),
        ("dir/cave", "is neither"),
        ("map.png#3", "is neither"),
        ("cave#", "seed after '#' must be an integer from 0 to 4294967295, got ''"),
        ("cave#4294967296", "seed"),
        ("cave#²", "seed"),
        ("cave:", "key=value,key=value; got ''"),
        ("cave:a", "key=value"),
        ("cave:a=1,,b=2", "key=value"),
        ("cave:a=1,a=2", "'a' is given twice"),
        ("cave:a=nan", "a must be finite"),
        ("cave:a=1e999", "a must be finite"),
        ("map.png@", "after '@' comes the size in metres"),
        ("map.png@1x2x3", "after '@' comes"),
        ("map.png@true", "after '@' comes"),
        ("map.png@0", "above 0"),
        ("map.png@5x-1", "above 0"),
        ("map.png@nan", "above 0"),
        ("map.png@1e9", "at most 1e\\+06"),
    ],
)
def test_bad_names_are_refused_in_one_line(name, line):
    refused(line, parsed, name)


def test_a_directory_and_a_file_of_no_known_kind_are_refused(tmp_path, monkeypatch):
    (tmp_path / "office").mkdir()
    (tmp_path / "folder").mkdir()
    (tmp_path / "floor").touch()
    monkeypatch.chdir(tmp_path)
    assert parsed("office")[0] == "generator"  # a folder of that name does not hide the generator
    for name in ("folder", str(tmp_path)):
        refused("is a directory; name a map file in it", parsed, name)
    refused("'floor': is neither", parsed, "floor")


# --- load_world and generators


CALLS = []


def bare(seed, *, cell_m=0.1, width_m=1.0, n_doors=2, loops=False, style="plain", height_m=None):
    """A generator as the package has them; it draws no ring, and notes what it was given."""
    CALLS.append((seed, cell_m, width_m, n_doors, loops, style, height_m))
    return World(occupied=np.zeros((2, round(width_m / cell_m)), bool), cell_m=cell_m)


def full(seed, *, cell_m=0.1):
    return World(occupied=np.ones((3, 3), bool), cell_m=cell_m)


@pytest.fixture
def generators(monkeypatch):
    monkeypatch.setattr(worlds, "GENERATORS", {"bare": f"{__name__}:bare", "full": f"{__name__}:full"})
    monkeypatch.setattr(worlds, "require_generator", lambda *_: None)


@pytest.mark.usefixtures("generators")
def test_a_generator_gets_its_seed_cell_and_parameters_and_its_world_has_them_as_its_name():
    CALLS.clear()
    load_world("bare")
    name = "bare#3:width_m=2,n_doors=4,loops=true,style=grand,height_m=5"
    world = load_world(name, cell_m=0.5)
    assert CALLS == [(0, 0.1, 1.0, 2, False, "plain", None), (3, 0.5, 2.0, 4, True, "grand", 5)]
    assert type(CALLS[1][2]) is float
    assert world.name == name
    assert (world.shape, world.cell_m, world.origin_m) == ((2, 4), 0.5, (0.0, 0.0))


@pytest.mark.usefixtures("generators")
@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("bare:widht_m=2", r"no parameter 'widht_m'; it takes width_m, .* \(did you mean 'width_m'\?\)"),
        ("full:a=1", "no parameter 'a'; it takes none"),
        ("bare:seed=1", "no parameter 'seed'"),
        ("bare:cell_m=1", "cell_m is an option of its own"),
        ("bare:width_m=wide", "width_m must be a number, got 'wide'"),
        ("bare:width_m=true", "width_m must be a number, got True"),
        ("bare:n_doors=1.5", "n_doors must be an integer, got 1.5"),
        ("bare:loops=1", "loops must be true or false, got 1"),
        ("bare:style=1", "style must be a word, got 1"),
        ("full", "no cell is free at cell_m = 0.1"),
        ("cave", "there is no world 'cave'; there are bare, full"),
    ],
)
def test_bad_generator_names_are_refused(name, line):
    refused(line, load_world, name)


@pytest.mark.parametrize("cell_m", [0, -0.1, float("nan"), 1e-9, "x", True])
def test_a_bad_cell_is_refused(cell_m):
    refused("cell_m must be a number", load_world, "cave", cell_m=cell_m)


@pytest.mark.parametrize("name", [None, 3, ["cave"]])
def test_a_name_that_is_none_is_refused(name):
    refused("world must be a name or a path", load_world, name)


# --- short names, names of files


@pytest.mark.parametrize(
    ("given", "short"),
    [
        (["cave", "office#1"], ["cave", "office#1"]),
        (["maps/flat.png@0.05"], ["flat.png@0.05"]),
        (["a/map.yaml", "b/map.yaml", "c/plan.yaml"], ["a/map.yaml", "b/map.yaml", "plan.yaml"]),
        (["x/1/map.yaml", "y/1/map.yaml", "y/2/map.yaml"], ["x/1/map.yaml", "y/1/map.yaml", "2/map.yaml"]),
        (["map.yaml", "a/map.yaml"], ["map.yaml", "a/map.yaml"]),
        (["/a/map.yaml", "a/map.yaml"], ["/a/map.yaml", "a/map.yaml"]),
        (["a/run.bag:topic=/map", "a/run.bag:topic=/other/map"], ["run.bag:topic=/map", "run.bag:topic=/other/map"]),
        (["x\\a\\map.yaml", "x\\b\\map.yaml"], ["a/map.yaml", "b/map.yaml"]),
        (["a\\map.yaml", "a/map.yaml"], ["a\\map.yaml", "a/map.yaml"]),
    ],
)
def test_short_names_tell_apart(given, short):
    assert short_names(given) == short


@pytest.mark.parametrize(
    ("texts", "names"),
    [
        (["flat.png@0.05-closest+recheck-0"], ["flat.png_0.05-closest+recheck-0"]),
        (["a/map.yaml", "a_map.yaml", "a?map.yaml"], ["a_map.yaml", "a_map.yaml-2", "a_map.yaml-3"]),
        (["Map", "map"], ["Map", "map-2"]),
        (["map-2", "Map", "map"], ["map-2", "Map", "map-3"]),
        (["..", "/", "é"], ["_", "_-2", "_-3"]),
        (["../up", "-rf"], ["_up", "rf"]),
    ],
)
def test_names_of_files_are_plain_and_different(texts, names):
    assert file_names(texts) == names


def test_names_of_files_are_short_enough():
    first, second = file_names(["x" * 300 + "-0", "y" * 300 + "-0"])
    assert max(len(first), len(second)) <= 210
    assert first != second
    assert len(set(file_names(["x" * 300, "x" * 301]))) == 2
