"""Maps divided into rooms and scored: the command, the table, refusals."""

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from ref.refusals import refused

from jexplore.cli import main
from jexplore.config import InputError
from jexplore.studies.room_variants import ROOM_VARIANTS
from jexplore.studies.segmentation import SCORE_COLUMNS, segment_maps
from jexplore.worlds.world import occupancy_to_world

pytestmark = pytest.mark.jit

SMALL = "rooms#1:width_m=9.6,height_m=6.4"


def picture(path, free):
    Image.fromarray(np.where(free, 255, 0).astype(np.uint8)).save(path)
    return str(path)


def two_rooms():
    """Two rooms of 2 x 2 m with a door of 0.4 m between them, at 0.05 m; and the same with the door closed."""
    free = np.zeros((42, 84), bool)
    free[1:41, 1:41] = free[1:41, 43:83] = True
    closed = free.copy()
    free[17:25, 41:43] = True
    return free, closed


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    free, closed = two_rooms()
    return f"{picture(folder / 'map.png', free)}@0.05", picture(folder / "truth.png", closed)


def test_two_rooms_are_found_whole(pictures):
    variants = [name for name in ROOM_VARIANTS if name != "morphological"]  # to which both together are one small room
    found = segment_maps(pictures[0], truth=[pictures[1]], variants=variants)
    assert tuple(found.scores.columns) == SCORE_COLUMNS
    assert found.scores["variant"].tolist() == variants
    assert found.scores["rooms"].tolist() == found.scores["rooms_truth"].tolist() == [2] * len(variants)
    assert (found.scores["mcc"] > 0.97).all()
    assert (found.scores["doors"] == 1).all()
    assert not found.scores[["doors_missed", "doors_extra"]].any(axis=None)
    assert (found.scores["explored"] == 1).all()
    assert not found.scores["overflow"].any()
    text = found.to_markdown()
    assert text.count("### ") == len(variants)
    assert "map.png@0.05" in text
    labels = {frozenset(np.unique(p.label[p.free])) for p in found.pictures}
    assert labels == {frozenset({0, 1})}


def test_worlds_that_know_their_rooms_need_no_truth():
    scores = segment_maps(SMALL, cell_m=0.1, variants=["holz"]).scores
    assert scores["rooms_truth"].iloc[0] >= 2
    assert 0 < scores["mcc"].iloc[0] <= 1


def test_without_truth_rooms_are_only_counted():
    free, _ = two_rooms()
    world = occupancy_to_world(~free, name="mine", cell_m=0.05)
    scores = segment_maps(world, variants=["wurm"]).scores
    assert scores["rooms"].iloc[0] == 2
    assert np.isnan(scores["mcc"].iloc[0])


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["voronoi", "holz"])
def test_partial_maps_are_those_of_an_episode(variant):
    scores = segment_maps(SMALL, cell_m=0.1, variants=variant, partial=True).scores
    assert set(scores["stage"]) <= {0.25, 0.5, 0.75, 1.0}
    assert (scores["stage"].iloc[-1], scores["explored"].iloc[-1], len(scores) > 1) == (1, 1, True)
    assert scores["stage"].is_unique
    assert (scores["explored"] >= scores["stage"]).all()
    assert scores["explored"].is_monotonic_increasing
    assert scores["rooms_truth"].is_monotonic_increasing
    assert scores["mcc"].notna().all()


@pytest.mark.parametrize("open_in", ["map", "truth", "both"])
def test_a_picture_that_is_open_at_its_edge_is_scored(tmp_path, open_in):
    free, closed = two_rooms()
    for mask, name in ((free, "map"), (closed, "truth")):
        mask[20, 0] = open_in in (name, "both")
    names = [picture(tmp_path / f"{name}.png", mask) for name, mask in (("map", free), ("truth", closed))]
    scores = segment_maps(f"{names[0]}@0.05", truth=names[1], variants="holz").scores
    assert scores["rooms_truth"].tolist() == [2]
    assert scores["mcc"].iloc[0] > 0.97


def test_the_command(pictures, tmp_path, capsys):
    out = tmp_path / "out"
    assert main.main(["segment", pictures[0], "--truth", pictures[1], "--variant", "holz", "--out", str(out)]) == 0
    assert {p.name for p in out.iterdir()} == {"scores.parquet", "segments.png", "run.json"}
    assert pd.read_parquet(out / "scores.parquet")["variant"].tolist() == ["holz"]
    assert "### holz, 100% of the map" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"variants": ["dude"]}, "unknown variant 'dude'"),
        ({"variants": []}, "at least one"),
        ({"variants": ["holz", "holz"]}, "more than once"),
        ({"gamma": float("nan")}, "gamma must be"),
        ({"ratio": 1.5}, "ratio must be"),
        ({"clutter_m": float("inf")}, "clutter_m must be"),
        ({"truth": ["a.png", "b.png"]}, "ground truth for each of 1 maps, got 2"),
        ({"truth": ["nowhere.png"]}, "nowhere.png"),
    ],
)
def test_wrong_input_is_refused_in_one_line(pictures, more, message):
    assert message in refused(None, segment_maps, pictures[0], **more)


def test_truth_of_another_size_is_refused(pictures, tmp_path):
    with pytest.raises(InputError, match=r"must be as large as .*84 x 42 pixels, got 80 x 42"):
        segment_maps(pictures[0], truth=[picture(tmp_path / "small.png", two_rooms()[1][:, :80])])
    refused("ground truth is for maps such as", segment_maps, SMALL, truth=[pictures[1]], cell_m=0.1)


@pytest.mark.parametrize("variant", ROOM_VARIANTS)
def test_a_hall_is_one_room(variant):
    free = np.zeros((40, 40), bool)
    free[2:38, 2:38] = True
    scores = segment_maps(occupancy_to_world(~free, name="hall", cell_m=0.1), variants=variant).scores
    assert scores["rooms"].tolist() == [1]
    assert scores["doors"].tolist() == [0]


def test_the_command_refuses(printed, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert "expected a map" in printed(["segment"], 2).err
