"""Worlds of a user's: functions of a seed that return a `World`, registered or named `module:function`."""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from jexplore.config import InputError, shown
from jexplore.users import call_user, described
from jexplore.worlds.world import ARRAYS, World, require_world


def own_parameters(make: Callable[..., Any]) -> dict[str, Any]:
    """Return what a user's world takes in its name, without seed and `cell_m`: parameter -> default."""
    what = f"{described(make)} is no world: expected a function of a seed, whose other parameters have defaults"
    try:
        first, *rest = inspect.signature(make).parameters.values()
    except (TypeError, ValueError):
        raise InputError(f"{what}, got {shown(make)}") from None
    if first.kind not in (first.POSITIONAL_ONLY, first.POSITIONAL_OR_KEYWORD):
        raise InputError(what)
    for one in rest:
        if one.kind not in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY) or (
            one.default is one.empty and one.name != "cell_m"
        ):
            raise InputError(f"{what}, got {one}")
    return {one.name: one.default for one in rest if one.name != "cell_m"}


def make_world(make: Callable[..., Any], seed: int, cell_m: float, parameters: dict[str, Any]) -> World:
    """Call a user's world twice, with `cell_m` if it takes one; refuse an error, no `World`, or two that differ."""
    what = described(make)
    more = {"cell_m": cell_m} if "cell_m" in inspect.signature(make).parameters else {}
    first, again = (_require_own(call_user(make, what, seed, **more, **parameters), what) for _ in range(2))
    for name in ("cell_m", "origin_m", "start", "occupied", *ARRAYS):
        one, other = getattr(first, name), getattr(again, name)
        if not (one is other is None) and not np.array_equal(np.asarray(one), np.asarray(other)):
            raise InputError(f"{what} is not a function of its seed: two calls with seed {seed} differ in {name}")
    return first


def _require_own(world: Any, what: str) -> World:
    if not isinstance(world, World):
        raise InputError(f"{what} must return a jx.World, got {shown(world)}")
    for name in ("occupied", *ARRAYS):
        value = getattr(world, name)
        try:
            world = world if value is None else world.replace(**{name: np.asarray(value)})
        except Exception:  # whatever jax raises for an array that it is tracing
            raise InputError(f"{what} must return a jx.World of arrays: {name} is a {type(value).__name__}") from None
    try:
        return require_world(world)
    except InputError as error:
        raise InputError(f"{what}: {error}") from None
