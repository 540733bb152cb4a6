"""Arrays as short text for a page: numbers by a step, and images as the runs of cells that changed."""

import base64
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
    if not len(changed):
        return b""
    codes = after[changed]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(changed) != 1) | (np.diff(codes) != 0)]))
    lengths = np.diff(np.concatenate([first, [len(changed)]]))
    pieces = -(-lengths // MAX_RUN_CELLS)
    own = np.repeat(np.arange(len(first)), pieces)  # the run of each piece
    rank = np.arange(len(own)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    starts = changed[first][own] + MAX_RUN_CELLS * rank
    length = np.minimum(lengths[own] - MAX_RUN_CELLS * rank, MAX_RUN_CELLS)
    gaps = starts - np.concatenate([[0], (starts + length)[:-1]])
    wide = np.maximum(1, -(-np.frexp(gaps)[1] // 7))  # bytes of each gap
    table = np.zeros((len(gaps), int(wide.max()) + 1), np.uint8)
    column = np.arange(table.shape[1])
    for i in column[:-1]:
        table[:, i] = (gaps >> (7 * i) & 127) | np.where(i < wide - 1, 128, 0)
    table[np.arange(len(gaps)), wide] = 16 * length + codes[first][own]
    return table[column <= wide[:, None]].tobytes()


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
