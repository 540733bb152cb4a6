"""The maps of a comparison's episodes as files for ROS."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jexplore.exploration.results import to_occupancy
from jexplore.worlds.names import file_names, short_names
from jexplore.worlds.readers.ros import write_ros
from jexplore.worlds.world import World

if TYPE_CHECKING:
    import pandas as pd


def write_maps(
    folder: str | os.PathLike[str],
    maps: Mapping[tuple[str, str], np.ndarray],
    episodes: "pd.DataFrame",
    worlds: Sequence[World],
) -> list[Path]:
    """Write maps as yaml files with a picture each, named world-strategy-episode; arguments as of `Comparison`.

    Returns:
      Paths of the yaml files.

    Raises:
      InputError: a file cannot be written.
    """
    short = dict(zip([world.name for world in worlds], short_names([world.name for world in worlds])))
    of_name, texts, made = {world.name: world for world in worlds}, [], []
    for (world, strategy), states in maps.items():
        rows = episodes[(episodes["world"] == world) & (episodes["strategy"] == strategy)]
        for number, state in zip(rows["episode"], states):
            texts.append(f"{short[world]}-{strategy}-{number}")
            made.append((of_name[world], state))
    Path(folder).mkdir(parents=True, exist_ok=True)
    files = [Path(folder) / f"{name}.yaml" for name in file_names(texts)]
    for file, (world, state) in zip(files, made):
        write_ros(to_occupancy(state), file, cell_m=world.cell_m, origin_m=world.origin_m)
    return files
