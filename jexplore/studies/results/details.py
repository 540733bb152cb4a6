"""Parts of a comparison outside its table of episodes: columns that are kept as bytes, in files of their own."""

import io
import itertools
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


def parts_of(table: Any) -> dict[str, Any]:
    """Collect the `EXTRAS` of whole strategies, as the fields of a `ComparisonResult`."""
    first, progress, paths, maps = {}, {}, {}, {}
    for pair, rows in table.groupby(["world", "strategy"], sort=False):
        progress[pair] = np.stack(rows[PROGRESS])
        if WAY in rows:
            paths[pair] = list(rows[WAY])
        if MAP in rows:
            maps[pair] = np.stack(rows[MAP])
        if rows["episode"].iloc[0] == 0 and rows[SEEN].iloc[0] is not None:
            first.setdefault(pair[0], []).append(rows[SEEN].iloc[0])
    return {"first": first, "progress": progress, "paths": paths, "maps": maps}


def details_of(found: Any) -> pd.DataFrame:
    """Return the worlds and `EXTRAS` of a `ComparisonResult` as bytes, a row an episode of its table, for its file."""
    episodes, worlds = found.episodes, {os.fspath(world.name): world for world in found.worlds}
    seen = {(world, one.strategy, 0): one for world, own in found.first.items() for one in own}
    keys = zip(episodes["world"], episodes["strategy"], episodes["episode"])
    extras: dict[str, list[Any]] = {SEEN: [seen.get(key) for key in keys]}
    for name, of_pair in ((PROGRESS, found.progress), (WAY, found.paths), (MAP, found.maps)):
        if of_pair:
            extras[name] = list(itertools.chain.from_iterable(of_pair.values()))
    own = [worlds.pop(name, None) for name in episodes["world"]]
    kept = "occupied", "cell_m", "origin_m", "rooms", "start", "name"
    extras[WORLD] = [world and packed(**{name: getattr(world, name) for name in kept}) for world in own]
    return to_file(pd.DataFrame(extras))


def read_details(folder: Path) -> tuple[pd.DataFrame, tuple[World, ...]]:
    """Load the episodes of a comparison's folder, with `EXTRAS`, and its worlds."""
    episodes, details = read_parquet(folder / "episodes.parquet", required=COLUMNS), read_parquet(folder / DETAILS)
    if len(details) != len(episodes):
        raise InputError(f"{folder / DETAILS} must have a row for each of {len(episodes)} episodes")
    worlds = [unpacked(data) for data in details[WORLD] if data is not None]
    for world in worlds:
        world |= {name: tuple(world[name].tolist()) for name in ("start", "origin_m") if name in world}
    return episodes.join(of_file(details.drop(columns=WORLD))), tuple(World(**world) for world in worlds)
