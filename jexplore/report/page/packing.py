"""Arrays as short text for a page: numbers by a step, and images as the runs of cells that changed."""

import base64
import itertools
from typing import Any

import numpy as np

MAX_RUN_CELLS = 15  # cells of a run; a longer one is several


def base64_of(raw: bytes) -> str:
    return base64.b64encode(raw).decode("ascii")


def packed_numbers(values: Any, step: float = 1.0, name: str = "values") -> dict[str, Any]:
    """Encode an array as little-endian whole multiples of a step, in base64; the type's extremes are NaN and +infinity.

    Return a dict for JSON: `type` ("i2" or "i4"), `step`, `shape`, `base64`. An infinity below 0 becomes NaN; a number
    too large to be kept is a `ValueError`.
    """
    scaled = np.round(np.asarray(values, dtype=np.float64) / step)
    most = np.abs(scaled[np.isfinite(scaled)]).max(initial=0)
    kind = np.int16 if most < np.iinfo(np.int16).max else np.int32
    low, high = np.iinfo(kind).min, np.iinfo(kind).max
    if most >= high:
        raise ValueError(f"expected {name} below {high * step:.10g}, got {most * step:.10g}")
    whole = np.nan_to_num(scaled, nan=low, posinf=high, neginf=low).astype(np.dtype(kind).newbyteorder("<"))
    text = base64_of(whole.tobytes())
    return {"type": f"i{whole.itemsize}", "step": step, "shape": list(whole.shape), "base64": text}


def runs(before: np.ndarray, after: np.ndarray) -> bytes:
    """Encode the changes from one image to the next of the same shape.

    Every run is a number of unchanged cells to skip (seven bits a byte, the lowest first, the top bit set on all but
    the last) and a byte, 16 times the length of the run plus the code of its cells, 0 to 15. Cells are counted
    row by row, and a run may go on in the next row.
    """
    before, after = before.ravel(), after.ravel()
    changed = np.flatnonzero(before != after)
    codes = after[changed]
    ends = np.flatnonzero((np.diff(changed) != 1) | (np.diff(codes) != 0)) + 1
    changed, found, at = changed.tolist(), bytearray(), 0
    for begin, end in itertools.pairwise([0, *ends.tolist(), len(changed)]):
        for i in range(begin, end, MAX_RUN_CELLS):
            gap, length = changed[i] - at, min(MAX_RUN_CELLS, end - i)
            at = changed[i] + length
            while gap > 127:
                found.append(gap & 127 | 128)
                gap >>= 7
            found += bytes((gap, 16 * length + int(codes[i])))
    return bytes(found)


def change(image: np.ndarray, found: bytes) -> None:
    """Change a contiguous image in place by the result of `runs`."""
    flat, at, gap, shift = image.reshape(-1), 0, 0, 0
    fresh = iter(found)
    for byte in fresh:
        gap |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            at += gap
            head = next(fresh)
            flat[at : at + (head >> 4)] = head & 15
            at, gap, shift = at + (head >> 4), 0, 0
