"""Results as labelled arrays: xarray datasets, for netCDF and zarr. Needs xarray, the extra `xarray`."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from jexplore.config import InputError
from jexplore.studies.results.columns import COLUMNS

UNITS = {
    **dict.fromkeys(("path_m", "path_m_at_50", "path_m_at_90", "path_m_at_95", "path_m_at_99"), "m"),
    **dict.fromkeys(("time_s", "time_s_at_50", "time_s_at_90", "time_s_at_95", "time_s_at_99", "area_s"), "s"),
    **dict.fromkeys(("area_m", "progress_m"), "m"),
    **{"energy_j": "J", "robot.speed_m_s": "m s-1", "robot.turn_rad_s": "rad s-1", "robot.scan_s": "s"},
    **{"robot.acceleration_m_s2": "m s-2", "robot.turn_acceleration_rad_s2": "rad s-2", "robot.plan_s": "s"},
    **{"robot.standby_w": "W", "robot.drive_j_m": "J m-1", "robot.turn_j_rad": "J rad-1", "robot.mass_kg": "kg"},
    **{"turning_rad": "rad", "start_heading_deg": "degree", "explored_fraction": "1", "cell_m": "m"},
    **{"lidar.range_m": "m", "lidar.sigma_m": "m", "lidar.fov_deg": "degree", "rules.clearance_m": "m"},
    **{"rules.near_m": "m", "lidar.dropout": "1", "rules.p_free": "1"},
}
"""Name of a variable -> its unit, as UDUNITS writes it; others are counts or words."""
MISSING = {"i": -1, "f": np.nan, "O": "", "b": False}  # kind of a column -> what stands where there is no episode


def _dataset(table: pd.DataFrame, dims: Mapping[str, Sequence[Any]], metrics: Iterable[str]) -> Any:
    """Make a dataset of the columns of a table, whose rows are identified by the dimensions."""
    try:
        import xarray
    except ImportError as error:
        raise InputError("labelled arrays need xarray: pip install 'jexplore[xarray]'") from error
    whole = pd.MultiIndex.from_product(list(dims.values()), names=list(dims))
    table = table.astype({"room_entries": "float64"})
    rows = table.set_index(list(dims)).reindex(whole)
    found = xarray.Dataset(coords={name: list(values) for name, values in dims.items()})
    for name in (*COLUMNS, *metrics):
        if name not in dims:
            kind = table[name].dtype
            values = rows[name].fillna(MISSING[kind.kind]).astype(str if kind.kind == "O" else kind).to_numpy()
            values = values if kind.kind != "O" else values.astype(str)
            found[name] = tuple(dims), values.reshape([len(values) for values in dims.values()])
    return found


def _with_units(found: Any) -> Any:
    for name in found.variables:
        if name in UNITS:
            found[name].attrs["units"] = UNITS[name]
    return found


def of_comparison(found: Any) -> Any:
    """Convert a `ComparisonResult` to an `xarray.Dataset`.

    Its dimensions are `world`, `strategy`, `episode`: the columns of the table of episodes; and `progress_m`, with the
    dimension `percent` besides (metres driven when each per cent of what can be known was; NaN: never). Where they were
    kept, the ways, `way_row`, `way_col` and `way_known`, with the dimension `step` (-1 beyond the end), and the maps,
    `map`, with the dimensions `row` and `col` (0 unknown, 1 free, 2 occupied; 255 beyond a world's edge). Where an
    episode is missing: NaN, -1 or no text. Units are attributes.
    """
    table = found.episodes
    dims = {
        "world": [world.name for world in found.worlds],
        "strategy": list(dict.fromkeys(table["strategy"])),
        "episode": sorted(table["episode"].unique().tolist()),
    }
    made = _dataset(table, dims, found.metrics)
    shape = tuple(len(values) for values in dims.values())
    place = {value: i for i, value in enumerate(dims["episode"])}
    arrays = {"progress_m": np.full((*shape, 100), np.nan)}
    if found.paths:
        longest = max(len(way) for ways in found.paths.values() for way in ways)
        arrays |= {name: np.full((*shape, longest), -1, np.int32) for name in ("way_row", "way_col", "way_known")}
    if found.maps:
        largest = np.max([maps.shape[1:] for maps in found.maps.values()], axis=0)
        arrays["map"] = np.full((*shape, *largest), 255, np.uint8)
    for (world, strategy), rows in table.groupby(["world", "strategy"], sort=False):
        pair = world, strategy
        at = dims["world"].index(world), dims["strategy"].index(strategy)
        for i, episode in enumerate(rows["episode"]):
            here = (*at, place[episode])
            if pair in found.progress:
                arrays["progress_m"][here] = found.progress[pair][i]
            if pair in found.paths:
                way = found.paths[pair][i]
                for k, name in enumerate(("way_row", "way_col", "way_known")):
                    arrays[name][here][: len(way)] = way[:, k]
            if pair in found.maps:
                state = found.maps[pair][i]
                arrays["map"][here][: state.shape[0], : state.shape[1]] = state
    more = {"progress_m": ("percent",), "map": ("row", "col")}
    for name, array in arrays.items():
        made[name] = (*dims, *more.get(name, ("step",))), array
    made = made.assign_coords(percent=np.arange(1, 101), cell_m=("world", [world.cell_m for world in found.worlds]))
    return _with_units(made)


def of_sweep(found: Any) -> Any:
    """Convert a `SweepResult` to an `xarray.Dataset`.

    Its dimensions are `setting`, `world`, `strategy`, `episode`: the columns of the table of episodes. The settings are
    coordinates: `lidar.range_m` and the like along `setting`, `strategy.weight` and the like along `strategy`. Missing
    episodes and units are as of `of_comparison`.
    """
    table = found.episodes
    dims = {name: list(dict.fromkeys(table[name])) for name in ("setting", "world", "strategy", "episode")}
    dims["episode"].sort()
    made = _dataset(table, dims, found.spec.metrics)
    coordinates = {}
    for name in found.columns[1:]:
        along = "strategy" if name.startswith("strategy.") else "setting"
        values = table.drop_duplicates(along).set_index(along)[name].loc[dims[along]]
        numbers = values.astype("float64") if values.dtype.kind in "if" else values.fillna("").astype(str)
        coordinates[name] = along, numbers.to_numpy()
    return _with_units(made.assign_coords(coordinates))
