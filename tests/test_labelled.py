"""Results as labelled arrays, and maps as ROS files."""

import dataclasses
import sys

import numpy as np
import pytest
from ref.refusals import refused
from ref.worlds import two_rooms

from jexplore.exploration.results import to_occupancy
from jexplore.rules import Lidar, Rules
from jexplore.studies.comparison import compare
from jexplore.studies.sweeps.run import sweep
from jexplore.worlds.readers.ros import read_ros

pytestmark = pytest.mark.jit

xarray = pytest.importorskip("xarray", reason="needs xarray: pip install 'jexplore[xarray]'")
WORLDS = [two_rooms("one", 12, 20, 2), two_rooms("two", 14, 16, 2)]


@pytest.fixture(scope="module")
def found(jit_on):
    with jit_on():
        lidar, rules = Lidar(n_beams=37, range_m=1.0), Rules(clearance_m=0.1)
        return compare(WORLDS, ["closest", "random"], episodes=3, lidar=lidar, rules=rules, keep="maps")


def test_every_number_is_in_its_place(found):
    made = found.to_xarray()
    assert dict(made.sizes) | {"step": 0} == {
        **{"world": 2, "strategy": 2, "episode": 3, "percent": 100, "step": 0},
        **{"row": max(w.shape[0] for w in WORLDS), "col": max(w.shape[1] for w in WORLDS)},
    }
    for _, row in found.episodes.iterrows():
        here = made.sel(world=row["world"], strategy=row["strategy"], episode=row["episode"])
        for name in ("path_m", "scans", "outcome", "explored_fraction", "start_row"):
            assert here[name].item() == row[name]
    assert made["room_entries"].dtype == np.float64
    for (world, strategy), rows in found.progress.items():
        np.testing.assert_array_equal(made["progress_m"].sel(world=world, strategy=strategy), rows)
    for (world, strategy), ways in found.paths.items():
        for episode, way in enumerate(ways):
            here = made.sel(world=world, strategy=strategy, episode=episode)
            got = np.stack([here[f"way_{name}"][: len(way)] for name in ("row", "col", "known")], axis=1)
            np.testing.assert_array_equal(got, way)
            assert (here["way_row"][len(way) :] == -1).all()
    state, (height, width) = made["map"].sel(world="one", strategy="random", episode=2).values, WORLDS[0].shape
    np.testing.assert_array_equal(state[:height, :width], found.maps["one", "random"][2])
    assert (state[height:] == 255).all()
    assert made["path_m"].attrs["units"] == "m"
    assert made["cell_m"].values.tolist() == [world.cell_m for world in WORLDS]


def test_what_is_missing_is_told(found):
    fewer = dataclasses.replace(found, episodes=found.episodes.iloc[1:], progress={}, paths={}, maps={})
    here = fewer.to_xarray().sel(world="one", strategy="closest", episode=0)
    assert np.isnan(here["path_m"])
    assert here["scans"] == -1
    assert here["outcome"] == ""
    assert "map" not in fewer.to_xarray()


@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::UserWarning", "ignore::DeprecationWarning")
def test_netcdf_gives_it_back(found, tmp_path):
    pytest.importorskip("h5netcdf", reason="needs h5netcdf: pip install 'jexplore[xarray]'")
    made = found.to_xarray()
    made.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as again:
        xarray.testing.assert_equal(again.load(), made)
        assert again["turning_rad"].attrs["units"] == "rad"


@pytest.mark.slow
def test_settings_are_coordinates():
    asked = {
        "worlds": ["rooms:width_m=5,height_m=5"],
        "strategies": ["closest", {"name": "distance-advantage", "weight": [0.5, 2]}],
        "episodes": 2,
        "lidar": {"n_beams": 31, "range_m": [1, 2.5]},
        "rules": {"look_around": [True, False]},
    }
    found = sweep(asked)
    made = found.to_xarray()
    assert dict(made.sizes) == {"setting": 4, "world": 1, "strategy": 3, "episode": 2}
    assert made["lidar.range_m"].values.tolist() == [1, 1, 2.5, 2.5]
    assert made["rules.look_around"].values.tolist() == ["True", "False"] * 2
    np.testing.assert_array_equal(made["strategy.weight"], [np.nan, 0.5, 2])
    row = found.episodes.iloc[7]
    keys = ("setting", "world", "strategy", "episode")
    assert made["path_m"].sel({key: row[key] for key in keys}) == row["path_m"]


def test_maps_are_ros_maps_to_the_cell(found, tmp_path):
    files = found.save_maps(tmp_path / "maps")
    assert len(files) == 12
    assert files[0].name == "one-closest-0.yaml"
    for file, state in zip(files, [state for maps in found.maps.values() for state in maps]):
        occupancy, _ = read_ros(file)
        np.testing.assert_array_equal(occupancy, to_occupancy(state))


def test_no_maps_and_no_xarray(found, monkeypatch, tmp_path):
    refused("no maps were kept", dataclasses.replace(found, maps={}).save_maps, tmp_path)
    monkeypatch.setitem(sys.modules, "xarray", None)
    refused(r"pip install 'jexplore\[xarray\]'", found.to_xarray)
