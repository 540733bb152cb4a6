"""Results of episodes for tests."""

import dataclasses

import numpy as np

from jexplore.exploration.state import Result


def result(n=1, **fields):
    """Return a `Result` of n episodes, COMPLETE, all else 0 but for the given fields."""
    zero = np.zeros(n, np.int32)
    values = {field.name: zero for field in dataclasses.fields(Result)} | {"metrics": (), "way_m": None, "ride": None}
    values |= {"outcome": zero + 1, "explorable": zero + 1, "straight_at": np.zeros((n, 4), np.int32)}
    values |= {"diagonal_at": np.zeros((n, 4), np.int32)}
    values |= {"time_at": np.zeros((n, 4), np.int32)}
    values |= dict.fromkeys(("straight_along", "diagonal_along", "time_along"), np.zeros((n, 100), np.int32))
    return Result(**{**values, **{name: np.asarray(value, np.int32) for name, value in fields.items()}})
