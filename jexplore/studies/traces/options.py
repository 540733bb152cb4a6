"""Options of a trace in text form: swept thresholds, attributes of nodes. Importing this loads no jax."""

import contextlib
import dataclasses
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jexplore.config import MAX_RUNS, InputError, require_number
from jexplore.driving.params.groups import default_numbers
from jexplore.driving.settings import WHOLE, Noise, Tuning
from jexplore.studies.sweeps.axes import Range, combined
from jexplore.tracemap.record import BtmMap

NOISE = "noise."  # names of noise begin so in a sweep


def floats_of(value: Any) -> tuple[float, ...]:
    """Convert numbers, or a text such as `12.5,4`, to finite floats; () for anything else."""
    try:
        found = tuple(map(float, value.split(",") if isinstance(value, str) else value))
    except (TypeError, ValueError, OverflowError):
        return ()
    return found if all(map(math.isfinite, found)) else ()


def require_start_pose(start: Sequence[float]) -> None:
    """Refuse a pose in metres and degrees that no map has."""
    for name, value in zip(("x", "y", "heading"), start):
        require_number(f"start {name}", value, low=-1e6, high=1e6)


def swept_values(sweep: Sequence[str], settings: int, seed: int) -> dict[str, np.ndarray]:
    """Read the values of thresholds to be swept: `{name: [S] values}`, S = 1 without a sweep.

    Each text is a list, `votes=1,3,5`, or a range, `circle=1.1:2.0`. Lists alone make every combination; with a range
    among them, `settings` draws by Latin hypercube.
    """
    known = [field.name for field in dataclasses.fields(Tuning)]
    known += [f"{NOISE}{field.name}" for field in dataclasses.fields(Noise)]
    own = default_numbers()
    whole = {*WHOLE, *(name for name, value in own.items() if isinstance(value, int))}
    axes: dict[str, Any] = {}
    for text in sweep:
        name, equals, values = text.partition("=")
        if name in axes:
            raise InputError(f"sweep names {name} more than once")
        if name not in (*known, *own) or not equals:
            names = ", ".join((*known, "the numbers of jx.btm.Params, as in sensing.every_m"))
            raise InputError(f"sweep must be NAME=A,B,... or NAME=LOW:HIGH, got {text!r}; there are {names}")
        is_range = ":" in values
        try:
            numbers = [float(value) for value in (values.split(":", 1) if is_range else values.split(","))]
        except ValueError:
            raise InputError(f"sweep {text!r}: values must be numbers") from None
        if name in whole and not is_range and not all(value.is_integer() for value in numbers):
            raise InputError(f"sweep {text!r}: {name} must be integers")
        if is_range and not numbers[0] < numbers[1]:
            raise InputError(f"sweep {text!r}: a range must rise, as in {name}={numbers[1]:g}:{numbers[0]:g}")
        for value in numbers if name in own else ():
            low, high = sorted((float(name in whole), 100.0 * own[name]))
            require_number(f"sweep of {name}", value, low=low, high=high)
        axes[name] = Range(numbers[0], numbers[1]) if is_range else numbers
    n_combinations = math.prod(len(axis) if isinstance(axis, list) else 0 for axis in axes.values())
    if n_combinations > MAX_RUNS:
        raise InputError(f"sweep: more than {MAX_RUNS} combinations; use fewer values")
    if not n_combinations:  # ranges have the first columns of the draws
        axes = dict(sorted(axes.items(), key=lambda axis: isinstance(axis[1], list)))
    rows = combined(axes, settings, "latin", seed, whole)
    return {name: np.array([row[name] for row in rows], float) for name in axes}


def attributes_of(texts: Sequence[str]) -> tuple[tuple[str, Any, tuple[float, float]], ...]:
    """Read attributes of nodes, each `NAME=VALUE@X,Y`: a value of JSON, else text; a place in metres."""
    found = []
    for text in texts:
        what, _, place = text.rpartition("@")
        name, equals, value = what.partition("=")
        at_m = floats_of(place)
        if not (name and equals and len(at_m) == 2):
            raise InputError(f"attribute must be NAME=VALUE@X,Y, as in victim=true@12.5,4, got {text!r}")
        with contextlib.suppress(ValueError, RecursionError):
            value = json.loads(value, parse_constant=str)
        BtmMap((), ()).with_attributes({name: value})
        found.append((name, value, at_m))
    return tuple(found)
