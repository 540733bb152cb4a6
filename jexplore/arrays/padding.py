"""Sizes to which arrays are padded, and the types of numbers, so that similar work shares a compiled program."""

import math
from typing import Any

import numpy as np

from jexplore.arrays.bits import WORD


def bucket(n: int) -> int:
    """Return the padded size of a side of n cells: the next of 4, 5, 6 or 7 times a power of two, in multiples of 32.

    So that maps of similar size share a compiled program, at the price of at most a quarter more rows and columns.
    """
    step = max(WORD, 2 ** (math.ceil(math.log2(max(n, 1))) - 3))
    return max(2 * WORD, math.ceil(n / step) * step)


def number(value: Any) -> np.ndarray:
    """Convert a parameter to an array: integers to int32, others to float32, so that all programs agree."""
    value = np.asarray(value)
    return value.astype(
        np.int32 if value.dtype.kind in "iu" else value.dtype if value.dtype.kind == "b" else np.float32
    )


def framed(mask: np.ndarray) -> np.ndarray:
    """Pad a mask to sizes of `bucket`, with False cells all round: it begins at row 1, column 1."""
    return np.pad(mask, [(1, bucket(n + 2) - n - 1) for n in mask.shape])


def within(array: np.ndarray, shape: tuple[int, ...], ring: int) -> np.ndarray:
    """Return the cells of a world of this shape in a padded map, whose indices are larger by `ring`."""
    return array[ring : ring + shape[0], ring : ring + shape[1]]
