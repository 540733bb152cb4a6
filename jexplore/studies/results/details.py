"""Parts of a comparison outside its table of episodes, in a file of their own: details.npz."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jexplore.arrays.files import read_npz
from jexplore.config import InputError
from jexplore.exploration.state import MARKS
from jexplore.worlds.world import World

DETAILS = "details.npz"
MAX_DETAILS_BYTES = 2**32  # unpacked; the progress of a million episodes takes a fifth


class Seen(NamedTuple):
    """End of episode 0 of a strategy in a world: the robot's map and its way on it."""

    strategy: str
    state: np.ndarray  # [H, W] uint8, 0 unknown, 1 free, 2 occupied
    rows: np.ndarray  # [n + 1] int32, cells driven; of a team float64, NaN between two robots' ways
    cols: np.ndarray  # [n + 1] int32 or float64
    cell_m: float
    path_m: float


def write_details(found: Any, path: Path) -> None:
    """Write worlds, first episodes, progress, ways, maps: parts of a result outside its table of episodes."""
    arrays: dict[str, Any] = {}
    for i, world in enumerate(found.worlds):
        kept = {name: getattr(world, name) for name in ("occupied", "cell_m", "origin_m", "rooms", "start")}
        kept["name"] = os.fspath(world.name)
        arrays |= {f"world/{i}/{name}": np.asarray(value) for name, value in kept.items() if value is not None}
        for k, seen in enumerate(found.first.get(world.name, [])):
            arrays |= {f"first/{i}/{k}/{name}": np.asarray(value) for name, value in seen._asdict().items()}
    if found.progress:
        arrays["progress"] = np.concatenate(list(found.progress.values()))
    for k, pair in enumerate(found.progress):
        if pair in found.paths:
            ways = found.paths[pair]
            arrays[f"ways/{k}"], arrays[f"ways/{k}/length"] = np.concatenate(ways), [len(way) for way in ways]
        if pair in found.maps:
            arrays[f"maps/{k}"] = found.maps[pair]
    np.savez_compressed(path, **arrays)


def read_details(path: Path, episodes: pd.DataFrame) -> dict[str, Any]:
    """Load worlds, first episodes, progress, ways and maps, as fields of a `ComparisonResult` of these episodes."""
    arrays = read_npz(path, MAX_DETAILS_BYTES)
    worlds, first = [], {}
    while (at := f"world/{len(worlds)}") + "/occupied" in arrays:
        start = arrays.get(f"{at}/start")
        world = World(
            occupied=arrays[f"{at}/occupied"],
            rooms=arrays.get(f"{at}/rooms"),
            start=None if start is None else tuple(start.tolist()),
            cell_m=float(arrays[f"{at}/cell_m"]),
            name=str(arrays[f"{at}/name"]),
            origin_m=tuple(arrays[f"{at}/origin_m"].tolist()),
        )
        own, i = [], len(worlds)
        while (at := f"first/{i}/{len(own)}") + "/state" in arrays:
            state, rows, cols = (arrays[f"{at}/{name}"] for name in ("state", "rows", "cols"))
            strategy, path_m = str(arrays[f"{at}/strategy"]), float(arrays[f"{at}/path_m"])
            own.append(Seen(strategy, state, rows, cols, world.cell_m, path_m))
        worlds.append(world)
        if own:
            first[world.name] = own
    progress, paths, maps, at = {}, {}, {}, 0
    if "progress" in arrays:
        if arrays["progress"].shape != (len(episodes), MARKS):
            raise InputError(f"{path} must have the progress of {len(episodes)} episodes")
        for k, (pair, rows) in enumerate(episodes.groupby(["world", "strategy"], sort=False)):
            progress[pair] = arrays["progress"][at : at + len(rows)]
            at += len(rows)
            if f"ways/{k}" in arrays:
                paths[pair] = np.split(arrays[f"ways/{k}"], np.cumsum(arrays[f"ways/{k}/length"])[:-1])
            if f"maps/{k}" in arrays:
                maps[pair] = arrays[f"maps/{k}"]
    return {"worlds": tuple(worlds), "first": first, "progress": progress, "paths": paths, "maps": maps}
