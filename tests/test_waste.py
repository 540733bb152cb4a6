"""Wasted path, by hand and in a comparison."""

import numpy as np
import pytest

import jexplore as jx
from jexplore.cli import main
from jexplore.config import InputError
from jexplore.studies.results.columns import WASTE_COLUMNS
from jexplore.studies.statistics import waste


def way(known, cols=None):
    """A way along a row: one cell a step."""
    cols = np.arange(len(known)) if cols is None else np.asarray(cols)
    return np.stack([np.zeros(len(known), int), cols, np.asarray(known)], axis=1).astype(np.int32)


def test_a_way_by_hand():
    """In cells of 1 m: two steps that show a lot, a transit of 3 m, a visit that shows 2 m2, 2 m back, 10 m2."""
    known = [10, 20, 30, 30, 30, 30, 32, 32, 32, 42]
    found = waste.waste_of(way(known), 1.0)
    assert found.kinds.tolist() == [0, 0, 2, 2, 2, 2, 1, 1, 0]
    assert (found.idle_m, found.leftovers, found.leftover_m, found.leftover_m2) == (5.0, 1, 4.0, 2.0)


def test_what_is_short_is_no_transit():
    found = waste.waste_of(way([10, 10, 11, 11, 12]), 1.0)
    assert found.kinds.tolist() == [0, 0, 0, 0]
    assert (found.idle_m, found.leftovers, found.leftover_m) == (2.0, 0, 0.0)


def test_a_transit_at_the_end_leads_to_nothing_and_diagonals_are_longer():
    known, cols = [10, 12, 12, 12], [0, 1, 2, 3]
    one = way(known, cols)
    one[:, 0] = cols
    found = waste.waste_of(one, 1.0)
    assert found.kinds.tolist() == [0, 2, 2]
    assert found.leftover_m == pytest.approx(2 * np.sqrt(2))
    assert found.leftovers == 1
    assert waste.waste_of(way([5]), 1.0).kinds.tolist() == []


@pytest.mark.slow
@pytest.mark.jit
def test_of_a_comparison(tmp_path, printed):
    small = jx.Lidar(n_beams=31, range_m=2)
    found = jx.compare("rooms:width_m=5,height_m=5", ["closest", "random"], episodes=3, lidar=small, keep="paths")
    table = found.wasted
    assert (table["idle_m"] <= table["path_m"] + 1e-9).all()
    assert (table["leftover_m"] <= table["path_m"] + 1e-9).all()
    assert table["idle_m"].sum() > 0
    assert "to leftovers" in waste.waste_table(table)
    with pytest.raises(InputError, match="no ways were kept"):
        _ = jx.compare("rooms:width_m=5,height_m=5", "closest", episodes=1, lidar=small).wasted
    options = ["--lidar.n-beams", "31", "--lidar.range-m", "2", "--waste", "--no-report"]
    options += ["--out", str(tmp_path / "run")]
    command = ["compare", "--worlds", "rooms:width_m=5,height_m=5", "--strategies", "closest", "random", *options]
    assert "to leftovers" in printed([*command, "--episodes", "3"]).out
    again = jx.load(tmp_path / "run").to_pandas()
    np.testing.assert_allclose(again[list(WASTE_COLUMNS)], table[list(WASTE_COLUMNS)])
    assert main.main([*command, "--episodes", "5", "--resume"]) == 0  # the ways of the first three are there
    longer = jx.load(tmp_path / "run")
    assert (longer.resumed, len(longer.episodes)) == (6, 10)
    np.testing.assert_allclose(longer.wasted.query("episode < 3")[list(WASTE_COLUMNS)], table[list(WASTE_COLUMNS)])
