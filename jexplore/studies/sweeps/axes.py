"""Axes of sweeps: every combination of lists of values, or draws from lists and ranges. Importing this loads no jax."""

import dataclasses
import itertools
import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from jexplore.config import checked_names


@checked_names
@dataclasses.dataclass(frozen=True)
class Range:
    """Numbers from low to high that are drawn from."""

    low: float
    high: float
    log: bool = False
    """Draw logarithms evenly."""

    def at(self, share: float) -> float:
        """Return the number below which a share lies."""
        if self.log:
            return math.exp(math.log(self.low) + share * (math.log(self.high) - math.log(self.low)))
        return self.low + share * (self.high - self.low)


def combined(
    axes: Mapping[str, list[Any] | Range], draws: int, method: str, seed: int, whole: Collection[str] = ()
) -> list[dict[str, Any]]:
    """Combine the values of axes, name -> list of values or a range: a list of `{name: value}`.

    Without a range every combination is made, else `draws` settings are drawn, from lists as well, each value alike.
    `method` is "sobol" (scrambled) or "latin" (hypercube); `whole` are the axes whose ranges are of whole numbers.
    """
    if not any(isinstance(axis, Range) for axis in axes.values()):
        lists: Any = axes.values()
        return [dict(zip(axes, row)) for row in itertools.product(*lists)]
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    if method == "sobol":
        shares = qmc.Sobol(len(axes), rng=rng).random_base2(max(0, (draws - 1).bit_length()))[:draws]
    else:
        shares = qmc.LatinHypercube(len(axes), rng=rng).random(draws)

    def value(name, axis, share):
        if isinstance(axis, list):
            return axis[min(int(share * len(axis)), len(axis) - 1)]
        return round(axis.at(share)) if name in whole else axis.at(share)

    return [{name: value(name, axis, float(x)) for (name, axis), x in zip(axes.items(), row)} for row in shares]
