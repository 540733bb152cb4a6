"""What README and CONTRIBUTING show runs as it stands."""

import re
from pathlib import Path

import numpy as np
import pytest

import jexplore as jx

ROOT = Path(__file__).resolve().parents[1]


def blocks(file, section):
    """The Python code of a section, in one piece."""
    text = (ROOT / file).read_text(encoding="utf-8")
    (own,) = re.findall(rf"^## {section}\n(.*?)^## ", text, re.S | re.M)
    return "\n".join(re.findall(r"```python\n(.*?)```", own, re.S))


@pytest.mark.jit
def test_ones_own_strategy_and_steps(capsys):
    exec(blocks("README.md", "Your own"), found := {})
    said, outcome = capsys.readouterr().out.splitlines()[-1].split()
    assert outcome == "COMPLETE"
    start = np.asarray(found["state"].episode.belief.start) * [1, 1, 45]
    episode = jx.explore(found["world"], "closest", start=tuple(start.tolist()))
    assert float(said) == pytest.approx(episode.measures["path_m"], rel=1e-5)
    assert found["many"][0].world.shape == (256,)


@pytest.mark.jit
def test_the_longer_form():
    exec(blocks("CONTRIBUTING.md", "A strategy of your own"), found := {})
    one = jx.compare("maze:width_m=6,height_m=6", found["restless"], episodes=1)
    assert one.episodes["outcome"].tolist() == ["COMPLETE"]
