"""Maps in recordings of ROS, written here by rosbags itself."""

import builtins
import math

import numpy as np
import pytest
from ref.refusals import refused

from jexplore.config import InputError, InputWarning
from jexplore.worlds import load_world
from jexplore.worlds.readers.bags import load_bag, read_bag

bags = pytest.importorskip("ref.bags")

GRID, TEXT = "nav_msgs/msg/OccupancyGrid", "std_msgs/msg/String"
MAP = np.array([[0, 25, -1], [0, 100, 65]])
LEVEL = (0.0, 0.0, 0.0, 1.0)


def write(path, topics, *, resolution=0.05, origin=(1.0, 2.0), turn=LEVEL, values=None):
    """A recording: topic -> occupancies, or texts, one a second; the path of the file that was written."""
    store = bags.ROS1 if path.suffix == ".bag" else bags.ROS2

    def message(occupancy):
        occupancy = np.asarray(occupancy)
        height, width = occupancy.shape
        told = {
            **{f"info__origin__position__{axis}": value for axis, value in zip("xy", origin)},
            **{f"info__origin__orientation__{axis}": value for axis, value in zip("xyzw", turn)},
        }
        data = np.asarray(occupancy.ravel() if values is None else values, np.int8)
        return bags.make(
            store, GRID, info__resolution=resolution, info__width=width, info__height=height, data=data, **told
        )

    made = {}
    for topic, contents in topics.items():
        if contents and isinstance(contents[0], str):
            made[topic] = TEXT, [bags.make(store, TEXT, data=said) for said in contents]
        else:
            made[topic] = GRID, [message(occupancy) for occupancy in contents]
    return bags.write(path, made)


@pytest.fixture(params=["a.bag", "a.mcap"])
def name(request, tmp_path):
    return tmp_path / request.param


@pytest.fixture
def bag(tmp_path):
    return tmp_path / "a.bag"


def test_a_map_by_pencil(name):
    grid = read_bag(write(name, {"/chatter": ["hello"], "/map": [np.full((5, 5), -1), MAP]}))
    assert grid.topic == "/map"
    assert grid.occupancy.tolist() == MAP.tolist()
    assert grid.occupancy.dtype == np.int8
    assert (grid.resolution_m, grid.origin_m) == (0.05, (1.0, 2.0))


def test_a_world_by_its_name(name):
    path = str(write(name, {"/map": [np.zeros((1, 1), int), MAP]}))
    world = load_world(path, cell_m=0.05)
    assert world.name == path
    assert world.occupied.astype(int).tolist() == [[0, 0, 1], [0, 1, 1]]
    np.testing.assert_allclose(world.origin_m, (1.0, 2.0))
    assert load_world(path, cell_m=0.025).shape == (4, 6)


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_a_folder_of_ros_2_is_its_recording(tmp_path, suffix, monkeypatch):
    folder = write(tmp_path / f"run{suffix}", {"/map": [MAP]}).parent
    monkeypatch.chdir(tmp_path)
    for path in (str(folder), "run", "./run/"):
        assert load_world(f"{path}:topic=/map", cell_m=0.05).shape == (2, 3)
        assert load_world(path, cell_m=0.05).name == path
    assert read_bag(folder).occupancy.tolist() == read_bag(folder / "metadata.yaml").occupancy.tolist()
    refused("a ROS bag file has its own scale", load_world, f"run/run{suffix}@0.1")


def test_of_several_topics(name):
    both = write(name, {"/costmap": [np.zeros((2, 2), int)], "/map": [MAP], "/said": ["x"]})
    assert read_bag(both).topic == "/map"
    assert read_bag(both, topic="/costmap").occupancy.shape == (2, 2)
    other = write(name.with_stem("b"), {"/global": [MAP], "/local": [MAP]})
    refused("has maps on /global, /local; append :topic=/global for one of them", read_bag, other)
    assert load_world(f"{other}:topic=/local", cell_m=0.05).shape == (2, 3)
    refused("no map on the topic '/map'; there are maps on /global, /local", load_world, f"{other}:topic=/map")
    one = write(name.with_stem("c"), {"/only": [MAP]})
    assert read_bag(one).topic == "/only"


def test_no_map_at_all(name):
    with pytest.raises(InputError, match=r"has no message of the type nav_msgs/OccupancyGrid \(its topics: /said\)"):
        read_bag(write(name, {"/said": ["x"]}))
    refused("has no message on the topic /map", read_bag, write(name.with_stem("b"), {"/map": []}))


def test_a_turned_map_is_refused(bag):
    path = write(bag, {"/map": [MAP]}, turn=(0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4)))
    refused("the map on /map: is turned by 90 degrees; with a yaw of 0 it is the same building", read_bag, path)


def test_graded_probabilities_are_told_and_divided_where_one_says(bag):
    """As Cartographer publishes them: floor from 5 to 48, walls from 55 to 99."""
    graded = np.array([[-1, 99, 55, 60], [80, 5, 30, 40], [80, 20, 48, 45]])
    path = write(bag, {"/map": [graded]})
    line = (
        r"the map on /map: 55% of its known cells are from 26 to 64, neither free nor occupied, and count as unknown; "
        r"with :free_max=49,occupied_min=50 in its name 6 cells are free, not 2$"
    )
    with pytest.warns(InputWarning, match=line):
        world = load_world(path, cell_m=0.05)
    assert world.free_m2 == pytest.approx(2 * 0.05**2)
    for tail in (":free_max=49,occupied_min=50", ":free_max=54", ":topic=/map,free_max=48,occupied_min=49"):
        world = load_world(f"{path}{tail}", cell_m=0.05)
        assert world.free_m2 == pytest.approx(6 * 0.05**2)
    world = load_bag(path, cell_m=0.05, free_max=49, occupied_min=50)
    assert (~world.occupied).sum() == 6
    assert load_bag(path, cell_m=0.05, occupied_min=20).free_m2 == pytest.approx(0.05**2)


@pytest.mark.parametrize(
    "turn", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, -1.0), (0.0, 0.0, 1e-8, 1.0), (1e-4, 0.0, 1e-4, 1.0)]
)
def test_what_is_no_turn_is_read(bag, turn):
    assert read_bag(write(bag, {"/map": [MAP]}, turn=turn)).occupancy.tolist() == MAP.tolist()


@pytest.mark.parametrize(
    ("occupancy", "changes", "said"),
    [
        (MAP, {"turn": (0.1, 0.0, 0.0, 1.0)}, "is tilted; the orientation of its origin must be a turn about z"),
        (MAP, {"turn": (0.0, 0.0, math.nan, 1.0)}, "the orientation of its origin must be finite"),
        (MAP, {"values": [0] * 5}, "is 2 x 3 cells and has 5 values; expected one for each"),
        (np.zeros((0, 3), int), {}, "is 0 x 3 cells and has 0 values"),
        (MAP, {"resolution": 0.0}, "resolution must be a number above 0 and at most 100, got 0.0"),
        (MAP, {"resolution": math.nan}, "resolution must be a number"),
        (MAP, {"origin": (math.inf, 0.0)}, "origin must be a finite number, got inf"),
        (np.array([[0, 101]]), {}, r"occupancy must lie from -1 \(unknown\) to 100, got 0 to 101"),
        (np.array([[0, -2]]), {}, "got -2 to 0"),
        (np.array([[-1, 26]]), {}, "100% of its known cells are from 26 to 64, .* 1 cells are free, not 0$"),
    ],
)
def test_bad_maps_are_refused(bag, occupancy, changes, said):
    path = write(bag, {"/map": [occupancy]}, **changes)
    assert refused(said, load_world, path).startswith(f"{str(path)!r}: the map on /map: ")


def test_damaged_files_are_refused(name):
    path = write(name, {"/map": [MAP, MAP]})
    content = path.read_bytes()
    bad = name.with_stem("damaged")
    for damaged in (content[:50], content[: len(content) // 2], b"something else"):
        bad.write_bytes(damaged)
        refused("is damaged or no recording of ROS", load_world, bad)
    refused("there is no such file", load_world, name.with_stem("absent"))


@pytest.mark.parametrize(
    ("tail", "said"),
    [
        (":topic=3", "topic must be the name of one, as /map, got 3"),
        (":free=3", "there is no parameter 'free'; it takes topic, free_max, occupied_min"),
        (":free_max=100", "free_max must be an integer from 0 to 99, got 100"),
        (":free_max=0.5", "free_max must be an integer from 0 to 99, got 0.5"),
        (":occupied_min=0", "occupied_min must be an integer from 1 to 100, got 0"),
        (":free_max=50,occupied_min=50", "occupied_min must be above free_max, got 50 and 50"),
        ("@0.1", "a ROS bag file has its own scale"),
    ],
)
def test_bad_parameters_are_refused(bag, tail, said):
    path = write(bag, {"/map": [MAP]})
    refused(said, load_world, f"{path}{tail}")


def test_without_the_package_it_says_what_to_install(bag, monkeypatch):
    path, load = write(bag, {"/map": [MAP]}), builtins.__import__

    def without(module, *args, **kwargs):
        if module.startswith("rosbags"):
            raise ModuleNotFoundError(f"No module named {module!r}", name=module)
        return load(module, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    refused(r"reading it takes rosbags: pip install 'jexplore\[ros\]'", load_world, path)
