"""Specification of a sweep: lists are axes of a product, ranges are drawn from."""

import dataclasses
import itertools
import math
import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jexplore.arrays.files import first_line, read_yaml
from jexplore.config import (
    InputError,
    checked_names,
    require_different,
    require_number,
    require_setting,
    require_whole,
    unknown,
)
from jexplore.report.store import jsonable
from jexplore.rules import POSES, Lidar, Odometry, Robot, Rules
from jexplore.studies.checks import list_of
from jexplore.studies.metrics import named_metrics
from jexplore.studies.sweeps.axes import Range, combined
from jexplore.users import bare, name_of
from jexplore.worlds.poses import read_start

MAX_SETTINGS = 100_000
MAX_TOTAL = 100_000_000  # episodes
RANGE = ("low", "high", "log")
SETTING_PARTS = {"lidar": Lidar, "rules": Rules, "odometry": Odometry, "robot": Robot}
TEAM = {"robots": 1, "coordination": "independent", "contact": "all", "team_starts": "together", "members": ""}
SINGLE = {"seed": 0, "cell_m": 0.1, "pose": "true", **TEAM}
"""Settings that are no part of a record -> their defaults."""
_FIELDS = {
    f"{part}.{one.name}": one
    for part, kind in SETTING_PARTS.items()
    for one in dataclasses.fields(kind)
    if one.name not in (*SINGLE, *SETTING_PARTS)
}
DEFAULTS = SINGLE | {name: one.default for name, one in _FIELDS.items()}
"""Every setting -> its default."""
WHOLE_SETTINGS = ["seed", "robots", *(name for name, one in _FIELDS.items() if one.type in (int, int | None))]
"""Names of settings that are whole numbers."""


class Setting(NamedTuple):
    """One setting of a sweep."""

    values: dict[str, Any]  # dotted name -> value, as of `Sweep.expanded`
    seed: int
    cell_m: float
    lidar: Lidar
    rules: Rules
    robot: Robot
    team: dict[str, Any]  # arguments of `team_jobs`; empty where no team is asked for


@checked_names
@dataclasses.dataclass(frozen=True)
class Sweep:
    """A sweep of comparisons. A list is an axis of the product; a `Range`, or `{low: 1, high: 4}`, is drawn from."""

    worlds: tuple[str, ...]
    """Names of worlds, as `jx.load_world` takes them."""
    strategies: tuple[Any, ...] = ("closest", "closest+recheck", "random")
    """Names; or mappings with `name` and parameters, of which lists are axes: `{name: gain-rate, samples: [50, 100]}`.
    In every setting the others are compared with the first."""
    episodes: int = 20
    """Of each strategy in each world and setting."""
    seed: Any = 0
    """Of starts and draws."""
    cell_m: Any = 0.1
    """Edge of a cell of the worlds, metres."""
    start: Any = "random"
    """"random", or "world" for every world's own; or in all of them `(row, col, heading_deg)` or `2.0m,1.5m,90`."""
    start_m: Any = None
    """`(x_m, y_m, yaw_deg)` in all worlds, in metres of the map's frame, instead of `start`."""
    lidar: Mapping[str, Any] | Lidar = dataclasses.field(default_factory=dict)
    """A `jx.Lidar`, or some of its fields."""
    rules: Mapping[str, Any] | Rules = dataclasses.field(default_factory=dict)
    """A `jx.Rules`, or some of its fields, without the next two."""
    pose: Any = None
    """Way in which robots learn their pose: "true" (the default), "odometry", "icp" or "icp+closing"."""
    odometry: Mapping[str, Any] | Odometry = dataclasses.field(default_factory=dict)
    """A `jx.Odometry`, or some of its fields."""
    robot: Mapping[str, Any] | Robot = dataclasses.field(default_factory=dict)
    """A `jx.Robot`, or some of its fields."""
    robots: Any = None
    """Sizes of teams, as in `jx.compare`."""
    coordination: Any = None
    """With `robots`: name, or "module:function"."""
    contact: Any = None
    """With `robots`: "all", "none", "range:4", "line-of-sight", ..."""
    team_starts: Any = None
    """With `robots`: "together" or "apart"."""
    members: Any = None
    """With `robots`: a text such as "pace=1 pace=2,range=3", a word for each robot; smaller teams take the first."""
    metrics: Any = dataclasses.field(default_factory=dict)
    """Columns of your own: name -> function or "module:function", as in `jx.compare`."""
    settings: tuple[Mapping[str, Any], ...] = ()
    """Settings one by one instead of a product: mappings such as `{lidar.range_m: 4, rules.clearance_m: 0.2}`; with the
    product of the rest."""
    draws: int | None = None
    """Number of settings to draw, with ranges; axes of lists are drawn from as well."""

    def __post_init__(self) -> None:
        strategies = (self.strategies,) if isinstance(self.strategies, Mapping) else self.strategies
        lists = {"worlds": self.worlds, "strategies": strategies, "settings": self.settings}
        for name, given in lists.items():
            is_none = name == "settings" and isinstance(given, (list, tuple)) and not given
            object.__setattr__(self, name, () if is_none else tuple(list_of(name, given)))
        for world in self.worlds:
            if not isinstance(world, (str, os.PathLike)):
                raise InputError(f"worlds must be names or files, got {world!r}")
        object.__setattr__(self, "metrics", named_metrics(self.metrics))
        require_whole("episodes", self.episodes, 1, MAX_TOTAL)
        read_start(self.start, self.start_m)
        if self.draws is not None:
            require_whole("draws", self.draws, 1, MAX_SETTINGS)
        for name, kind in SETTING_PARTS.items():
            known, given = [key.partition(".")[2] for key in _FIELDS if key.startswith(f"{name}.")], getattr(self, name)
            if isinstance(given, Rules):
                self._take_pose(given)
            if isinstance(given, kind):
                given = {key: value for key, value in dataclasses.asdict(given).items() if key in known}
                object.__setattr__(self, name, given)
            if not isinstance(given, Mapping):
                raise InputError(f"{name} must be a mapping such as {{{known[0]}: ...}}, got {given!r}")
            for key in given:
                if key not in known:
                    raise unknown(f"field of {name}", str(key), known)
        for one in self.settings:
            if not isinstance(one, Mapping) or not one:
                raise InputError(f"settings must be mappings such as {{lidar.range_m: 4}}, got {one!r}")
            for key, value in one.items():
                if key not in DEFAULTS:
                    raise unknown("setting", str(key), list(DEFAULTS))
                _require_plain(key, value)

    def _take_pose(self, rules: Rules) -> None:
        """Take over how a record of rules has robots learn their pose, unless the sweep says it itself."""
        for name, own, default in (("pose", rules.pose, "true"), ("odometry", rules.odometry, Odometry())):
            if own != default:
                if getattr(self, name):
                    raise InputError(f"{name} is given twice, in rules and in its own place")
                object.__setattr__(self, name, own)

    @property
    def axes(self) -> dict[str, Any]:
        """Return the varied settings: dotted name -> list of values, or a `Range`."""
        given = {"seed": self.seed, "cell_m": self.cell_m}
        given |= {name: own for name in ("pose", *TEAM) if (own := getattr(self, name)) is not None}
        for part in SETTING_PARTS:
            given |= {f"{part}.{key}": value for key, value in getattr(self, part).items()}
        return {key: _axis(key, value) for key, value in given.items()}

    def expanded(self) -> list[dict[str, Any]]:
        """Return the settings: a list of `{dotted name: value}`, all with the same names, all different."""
        axes, explicit = self.axes, [dict(one) for one in self.settings]
        for key in dict.fromkeys(key for one in explicit for key in one):
            if key in axes and key not in SINGLE:
                raise InputError(f"{key} is given twice, in settings and in its own place")
        ranges = [key for key, axis in axes.items() if isinstance(axis, Range)]
        if ranges and self.draws is None:
            raise InputError(f"{ranges[0]} is a range: say how many settings are drawn, as in draws: 64")
        if self.draws is not None and not ranges:
            raise InputError("draws goes with a range, such as lidar: {range_m: {low: 4, high: 12}}, and there is none")
        own = [{key: axis for key, axis in axes.items() if key not in one} for one in explicit or [{}]]
        n = sum(self.draws or math.prod(map(len, some.values())) for some in own)
        if n > MAX_SETTINGS:
            raise InputError(f"a sweep may have {MAX_SETTINGS:,} settings, got {n:,}; use fewer values, or draws")
        names = dict.fromkeys([*axes, *(key for one in explicit for key in one)])
        found = []
        seed = 0 if not isinstance(self.seed, int) else require_setting("seed", self.seed)
        for one, some in zip(explicit or [{}], own):
            for row in combined(some, self.draws or 1, "sobol", seed, WHOLE_SETTINGS):
                setting = {**row, **one}
                found.append({key: setting.get(key, DEFAULTS[key]) for key in names})
        if len({tuple((type(v) is bool, v) for v in setting.values()) for setting in found}) < len(found):  # True is 1
            raise InputError("settings must differ: a value is given twice, or a range of whole numbers is too short")
        return found

    def records(self) -> list[Setting]:
        """Return the settings of `expanded`, checked."""
        return [_setting(values) for values in self.expanded()]

    def strategy_list(self) -> list[tuple[str, dict[str, Any]]]:
        """Return the strategies, lists of parameters expanded: a list of `(name, parameters that are settings)`."""
        found = []
        for given in self.strategies:
            if isinstance(given, str):
                found.append((given, {}))
                continue
            if not isinstance(given, Mapping) or not isinstance(given.get("name"), str):
                raise InputError(f"a strategy must be a name, or a mapping with one: {{name: closest}}, got {given!r}")
            axes: dict[str, Any] = {key: _axis(key, value) for key, value in given.items() if key != "name"}
            for key, axis in axes.items():
                if isinstance(axis, Range):
                    raise InputError(f"{given['name']}: {key} must be a list of values, got a range")
            for row in itertools.product(*axes.values()):
                own = dict(zip(axes, row))
                text = ",".join(f"{key}={_text(given['name'], key, value)}" for key, value in own.items())
                joint = "," if "=" in given["name"] else ":"
                found.append((given["name"] + (joint + text if text else ""), own))
        names = [name for name, _ in found]
        require_different("strategies", names)
        return found


def _setting(values):
    """Make a `Setting` of one of `Sweep.expanded`; refuse values that its records do."""
    part = {
        kind: {key.partition(".")[2]: value for key, value in values.items() if key.startswith(f"{kind}.")}
        for kind in SETTING_PARTS
    }
    seed, cell_m = (require_setting(name, values[name]) for name in ("seed", "cell_m"))
    robot, odometry = Robot(**part["robot"]), Odometry(**part["odometry"])
    rules = Rules(**part["rules"], pose=values.get("pose", SINGLE["pose"]), odometry=odometry)
    team = {key: value for key, value in values.items() if key in TEAM}
    if isinstance(members := team.get("members"), str) and isinstance(n := team.get("robots"), int):
        team["members"] = tuple(members.split()[:n])
    return Setting(values, seed, float(cell_m), Lidar(**part["lidar"]), rules, robot, team)


def _axis(key, value) -> Any:
    """Read values of an axis: a list, or a `Range`."""
    if isinstance(value, Range):
        value = dataclasses.asdict(value)
    if isinstance(value, Mapping):
        if key == "pose":
            raise InputError(f"pose must be one of {', '.join(POSES)}, or a list of them, got {dict(value)!r}")
        for name in value:
            if name not in RANGE:
                raise unknown(f"word in the range of {key}:", str(name), RANGE)
        if not {"low", "high"} <= set(value):
            raise InputError(f"{key}: a range has low and high, got {dict(value)!r}")
        log = value.get("log", False)
        low = require_number(f"{key}: low", value["low"], low=-math.inf if not log else 0, low_open=bool(log))
        high = require_number(f"{key}: high", value["high"], low=low, low_open=True)
        if not isinstance(log, bool):
            raise InputError(f"{key}: log must be true or false, got {log!r}")
        return Range(low, high, log)
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        if not value:
            raise InputError(f"{key} must have at least one value, got none")
        return [_require_plain(key, one) for one in value]
    return [_require_plain(key, value)]


def _require_plain(key, value):
    """Refuse anything but a single value."""
    value = value.item() if isinstance(value, np.generic) else value
    if key == "pose" and value is True:  # as YAML has it
        return "true"
    if value is not None and not isinstance(value, (bool, int, float, str)):
        raise InputError(f"{key} must be a number, a word or a truth value, got {value!r}")
    return value


def _text(name, key, value):
    """Format a parameter's value as in the name of a strategy."""
    if value is None or (isinstance(value, str) and set(value) & set(",:+=")):
        raise InputError(f"{name}: {key} must be a number, a truth value or a plain word, got {value!r}")
    return str(value).lower() if isinstance(value, bool) else str(value)


def sweep_from(page: Any, name: str = "the sweep") -> Sweep:
    """Make a `Sweep` of plain values, as a YAML file has them."""
    if not isinstance(page, Mapping):
        raise InputError(f"{name} must be a mapping with worlds: [...], got {type(page).__name__}")
    known = [field.name for field in dataclasses.fields(Sweep)]
    for key in page:
        if key not in known:
            raise InputError(f"{name}: {unknown('key', str(key), known)}")
    if "worlds" not in page:
        raise InputError(f"{name}: worlds must name at least one: worlds: [cave, office]")
    try:
        return Sweep(**page)
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{name}: {first_line(error)}") from error


def read_spec(path: str | os.PathLike[str]) -> Sweep:
    """Read a `Sweep` from a YAML file by `plain_yaml`: YAML 1.2."""
    path = os.path.expanduser(path)
    return sweep_from(read_yaml(path), os.fspath(path))


def plain_spec(spec: Sweep) -> dict[str, Any]:
    """Convert a `Sweep` to plain values, from which `sweep_from` makes it again."""
    given: dict[str, Any] = {name: value for name, value in vars(spec).items() if value is not None}
    given = {name: value for name, value in given.items() if not isinstance(value, (Mapping, tuple)) or value}
    for name, metric in spec.metrics.items():
        if not isinstance(metric, str):
            function = bare(getattr(metric, "function", metric))
            given["metrics"] = given["metrics"] | {name: f"{function.__module__}:{name_of(function)}"}
    return jsonable(given)
