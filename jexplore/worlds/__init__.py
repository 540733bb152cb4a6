"""Worlds by name: generators, and readers of map files.

Importing this loads neither jax nor an image library; `load_world` imports what a name needs.
"""

import dataclasses
import importlib
import inspect
import math
import os
import re
import sys
import types
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from jexplore.arrays.pictures import Listing
from jexplore.config import InputError, checked_names, require_number, require_setting
from jexplore.users import import_object
from jexplore.worlds import names
from jexplore.worlds.bounds import PARAMETERS, require_generator, require_side

if TYPE_CHECKING:
    from jexplore.worlds.world import World

GENERATORS = {name: f"jexplore.worlds.generators.{name}:{name}" for name in PARAMETERS}
"""World name -> "module:function". The function takes a seed and keyword parameters, `cell_m` among them."""
_OWN: dict[str, Callable[..., Any]] = {}  # name -> function of a user's, see `register_world`
_NAME = re.compile(r"[A-Za-z_][\w-]*")


def worlds() -> Listing:
    """List the worlds that `load_world` knows, with their parameters, as a table that shows itself: `jx.worlds()`."""
    told = {
        name: ", ".join(f"{key}={value}" for key, value in generator_parameters(name).items())
        for name in known_generators()
    }
    what = {name: (inspect.getdoc(_function(name)) or "").partition("\n")[0] for name in told}
    rows = [(f"{name}, {name}#3", what[name], told[name]) for name in told]
    rows += [(kind.example, kind.content, "") for kind in names.FILES.values()]
    return Listing(("world", "what it is", "parameters"), tuple(rows))


class _Package(types.ModuleType):
    """Package `worlds`, which lists the worlds when it is called."""

    def __call__(self) -> Listing:
        return worlds()


sys.modules[__name__].__class__ = _Package


@checked_names
def register_world(name: str, function: Callable[..., "World"]) -> None:
    """Give a world of your own a name, for `load_world` and wherever a world is named.

    Without this, `module:function` names a function of a module that is installed or lies in the current folder.

    Args:
      name: letters, digits, `_` and `-`; registered again, it stands for the new function.
      function: `function(seed, **parameters)` returns a `World`: the same for the same arguments. Its parameters have
        defaults and are those of the name, `name#seed:key=value`; `cell_m`, if it has one, is that of the run.

    Raises:
      InputError: a name of the package's own or one that names cannot have, or something that is no such function.
    """
    from jexplore.worlds.own import own_parameters

    if not isinstance(name, str) or not _NAME.fullmatch(name) or name in GENERATORS:
        free = "letters, digits, _ and -, and none of " + ", ".join(GENERATORS)
        raise InputError(f"the name of a world must be {free}; got {name!r}")
    own_parameters(function)
    _OWN[name] = function


def known_generators() -> tuple[str, ...]:
    """Return the names of all generators, registered ones included."""
    return (*GENERATORS, *_OWN)


@checked_names
def load_world(name: str | os.PathLike[str], cell_m: float = 0.1) -> "World":
    """Load the world of a name: a generated one, or one read from a map file.

    `cave`, `cave#3`, `hospital#2:width_m=60,height_m=25`, `map.yaml`, `map.png@16x16`, `map.png@0.05:free=150`,
    `plan.json`, `scans.log`, `run.bag:topic=/map`: `names.parse_name` has the grammar, the readers say
    what a file means.

    Args:
      name: world name or path.
      cell_m: edge of a cell, metres. A file of another resolution is resampled; that never opens a wall.

    Returns:
      A `World` with at least one free cell; its `name` is `name` as given.

    Raises:
      InputError: no such world, a parameter that it does not take, or a file that cannot be read as a map.
    """
    try:
        name = os.fspath(name)
    except TypeError:
        raise InputError(f"world must be a name or a path, got {name!r}") from None
    require_setting("cell_m", cell_m)
    parsed = names.parse_name(name, generators=known_generators())
    world = _generate(parsed, cell_m) if parsed.kind == "generator" else _read(parsed, cell_m)
    world = dataclasses.replace(world, name=name)

    from jexplore.worlds.world import ringed_shape

    require_side(name, *ringed_shape(world.occupied), cell_m)
    if world.occupied.all():
        raise InputError(f"{name!r}: no cell is free at cell_m = {cell_m:g}; a smaller cell_m leaves more")
    return world


def _generate(parsed: names.WorldName, cell_m: float) -> "World":
    defaults, make = generator_parameters(parsed.base), _function(parsed.base)
    names.require_parameters(parsed, defaults)
    given = {key: _as_default(parsed, key, value, defaults[key]) for key, value in parsed.parameters.items()}
    if parsed.base in GENERATORS:
        require_generator(parsed.base, {**defaults, **given, "cell_m": cell_m})
        return make(parsed.seed, cell_m=cell_m, **given)
    from jexplore.worlds.own import make_world

    return make_world(make, parsed.seed, cell_m, given)


def _read(parsed: names.WorldName, cell_m: float) -> "World":
    """Read a map file by the function of its kind, whose keyword parameters are those of the name."""
    module, _, function = names.FILES[parsed.kind].reader.partition(":")
    load = getattr(importlib.import_module(f"jexplore.worlds.readers.{module}"), function)
    own = [one.name for one in inspect.signature(load).parameters.values() if one.kind is one.KEYWORD_ONLY]
    names.require_parameters(parsed, [*own[1:], *names.INSIDE])  # the first is `cell_m`
    region = _region(parsed)
    if parsed.kind == "image" and parsed.scale is None:
        scale = "append @16x16 for its size in metres or @0.05 for metres a pixel"
        raise InputError(f"{parsed.name!r}: a picture needs a scale; {scale}")
    if parsed.kind != "image" and parsed.scale is not None:
        raise InputError(f"{parsed.name!r}: a {parsed.kind} file has its own scale; leave out what follows the '@'")
    given = {key: value for key, value in parsed.parameters.items() if key not in names.INSIDE}
    scale = () if parsed.scale is None else (parsed.scale,)
    world = load(parsed.base, *scale, cell_m=cell_m, **given)
    if region is None:
        return world
    from jexplore.worlds.regions import inside

    return inside(world, *region)


def _region(parsed: names.WorldName) -> tuple[Any, ...] | None:
    """Return what comes after the world in the arguments of `regions.inside`; None where no region is chosen."""
    inside, *point_m = (parsed.parameters.get(key) for key in names.INSIDE)
    if point_m == [None, None] and isinstance(inside, bool | None):
        return () if inside else None
    if inside is not None or None in point_m:
        raise InputError(f"{parsed.name!r}: give inside=true, or both inside_x_m and inside_y_m")
    for key, value in zip(names.INSIDE[1:], point_m):
        require_number(f"{parsed.name!r}: {key}", value, low=-math.inf)
    return (tuple(point_m),)


def generator_parameters(base: str) -> dict[str, Any]:
    """Return the parameters of a generator in a world name, without seed and `cell_m`: name -> default."""
    from jexplore.worlds.own import own_parameters

    return own_parameters(_function(base))


def _function(base: str) -> Callable[..., Any]:
    if base in _OWN:
        return _OWN[base]
    module, _, function = GENERATORS.get(base, base).partition(":")
    return getattr(importlib.import_module(module), function) if base in GENERATORS else import_object(module, function)


def _as_default(parsed: names.WorldName, key: str, value: Any, default: Any) -> Any:
    """Convert `value` to the type of the parameter's default, so that `width_m=60` is the metres 60.0."""
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if isinstance(default, (bool, int, float, str)) and type(value) is not type(default):
        kinds = {bool: "true or false", int: "an integer", float: "a number", str: "a word"}
        raise InputError(f"{parsed.name!r}: {key} must be {kinds[type(default)]}, got {value!r}")
    return value
