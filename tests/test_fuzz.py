"""Random episodes by the engine and by the oracle; `benchmarks/fuzz.py` plays any number of them."""

import dataclasses

import numpy as np
import pytest
from ref import episodes, fuzz

SEED = 1
CASES = 40


@pytest.mark.jit
@pytest.mark.parametrize("number", range(CASES))
def test_an_episode_is_the_oracles(number):
    assert fuzz.compare(fuzz.draw_case(SEED, number, fuzz.FEW)).differences == []


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("number", [18, 149])
def test_a_robot_that_knows_enough_looks_no_further(number):
    """It goes home in the middle of a look-around."""
    assert fuzz.compare(fuzz.draw_case(77, number, fuzz.ENDS[:1])).differences == []


@pytest.mark.jit
def test_whatever_differs_is_told():
    """One number of what the oracle measured is changed at a time."""
    case = next(
        case
        for case in (fuzz.draw_case(SEED, number, fuzz.FEW[:1]) for number in range(100))
        if case.rooms is not None and case.occupied.size < 1500 and fuzz.compare(case).steps > 20
    )
    episode, world = (case.start, case.strategy, case.lidar, case.rules), {"cell_m": case.cell_m, "rooms": case.rooms}
    played = episodes.play(case.occupied, *episode, **world, shape=case.fixed.shape, beams_as=case.fixed.beams_as)
    want = episodes.replay(case.occupied, *episode, **world)
    assert episodes.differences(*played, want, **world) == []
    counts = np.zeros_like(want.hits)
    counts[tuple(np.argwhere(want.hits > 0)[-1])] = 1
    changes = {
        **{name: getattr(want, name) + 1 for name in (*episodes.COUNTS, "room_entries")},
        "outcome": want.outcome.lower(),
        "visited": [*want.visited[:-1], (0, 0)],
        "hits": want.hits + counts,
        "misses": want.misses + counts,
        "known_after_scan": [(step, known + 1) for step, known in want.known_after_scan],
        "log": [dataclasses.replace(plan, target=(0, 0)) for plan in want.log],
        "explored_fraction": want.explored_fraction + 1e-3,
        "events": [*want.events, ("scan",)],
        "steps_at": [*want.steps_at[:-1], 0],
        "path_m_at": {share: length + 0.01 for share, length in want.path_m_at.items()},
    }
    told = {
        name: episodes.differences(*played, dataclasses.replace(want, **{name: value}), **world)
        for name, value in changes.items()
    }
    assert [name for name, differences in told.items() if not differences] == []
    assert told["refused"][0] == f"refused {want.refused}, expected {want.refused + 1}"
