"""Parts of a comparison outside its table of episodes: columns that are kept as bytes, in a file of their own."""

import io
import os
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jexplore.config import InputError
from jexplore.exploration.state import MARKS
from jexplore.report.store import read_parquet
from jexplore.studies.results.columns import COLUMNS
from jexplore.worlds.world import World

DETAILS = "details.parquet"
MAX_VALUE_BYTES = 2**32  # of a value once unpacked: the longest way and a map are far smaller
PROGRESS, SEEN, WAY, MAP = "_progress_m", "_seen", "_way", "_map"
EXTRAS = (PROGRESS, SEEN, WAY, MAP)
"""Columns of a comparison's episodes besides `COLUMNS` and metrics: `[MARKS]` float64, metres; of episode 0 a `Seen`;
if they are kept, the way and the last map."""
WORLD = "_world"
"""Column of the file alone: in the first row of each world the world, without elevation, areas and known cells."""


class Seen(NamedTuple):
    """End of episode 0 of a strategy in a world: the robot's map and its way on it."""

    strategy: str
    state: np.ndarray  # [H, W] uint8, 0 unknown, 1 free, 2 occupied
    rows: np.ndarray  # [n + 1] int32, cells driven; of a team float64, NaN between two robots' ways
    cols: np.ndarray  # [n + 1] int32 or float64
    cell_m: float
    path_m: float


def packed(**arrays: Any) -> bytes:
    """Pack arrays, numbers and texts by name, without those that are None, as the value of a column."""
    file = io.BytesIO()
    np.savez(file, **{name: value for name, value in arrays.items() if value is not None})
    return zlib.compress(file.getvalue(), 1)


def unpacked(data: bytes) -> dict[str, Any]:
    """Return what `packed` got, single values as Python's."""
    with np.load(io.BytesIO(zlib.decompressobj().decompress(data, MAX_VALUE_BYTES))) as arrays:
        return {name: value if value.ndim else value.item() for name, value in arrays.items()}


_CODECS = {
    PROGRESS: (np.ndarray.tobytes, lambda data: np.frombuffer(data, np.float64, MARKS)),
    SEEN: (lambda seen: seen and packed(**seen._asdict()), lambda data: data and Seen(**unpacked(data))),
    WAY: (lambda way: packed(way=way), lambda data: unpacked(data)["way"]),
    MAP: (lambda state: packed(map=state), lambda data: unpacked(data)["map"]),
}


def to_file(table: pd.DataFrame) -> pd.DataFrame:
    """Encode the `EXTRAS` of a table as bytes, for its file, from which `of_file` makes it again."""
    return table.assign(**{name: [_CODECS[name][0](one) for one in table[name]] for name in EXTRAS if name in table})


def of_file(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table that `to_file` encoded."""
    return table.assign(**{name: [_CODECS[name][1](one) for one in table[name]] for name in EXTRAS if name in table})


def details_of(found: Any) -> pd.DataFrame:
    """Return the worlds and `EXTRAS` of a `ComparisonResult` as bytes, a row an episode of its table, for its file."""
    worlds = {os.fspath(world.name): world for world in found.worlds}
    own = [worlds.pop(name, None) for name in found.episodes["world"]]
    kept = "occupied", "cell_m", "origin_m", "rooms", "start", "name"
    data = [world and packed(**{name: getattr(world, name) for name in kept}) for world in own]
    return to_file(found.details).assign(**{WORLD: data})


def read_details(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame, tuple[World, ...]]:
    """Load the episodes of a comparison's folder, their `EXTRAS`, and its worlds."""
    episodes = read_parquet(folder / "episodes.parquet", required=COLUMNS)
    details = read_parquet(folder / DETAILS, required=(WORLD, PROGRESS, SEEN))
    if len(details) != len(episodes):
        raise InputError(f"{folder / DETAILS} must have a row for each of {len(episodes)} episodes")
    worlds = [unpacked(data) for data in details[WORLD] if data is not None]
    for world in worlds:
        world |= {name: tuple(world[name].tolist()) for name in ("start", "origin_m") if name in world}
    return episodes, of_file(details.drop(columns=WORLD)), tuple(World(**world) for world in worlds)
