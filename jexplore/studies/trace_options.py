"""Options of a trace in text form: swept thresholds, attributes of nodes. Importing this loads no jax."""

import contextlib
import dataclasses
import itertools
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jexplore.config import MAX_RUNS, InputError, require_number
from jexplore.driving.settings import WHOLE, Noise, Tuning
from jexplore.tracemap.record import BtmMap

NOISE = "noise."  # names of noise begin so in a sweep


def require_start_pose(start: Sequence[float]) -> None:
    """Refuse a pose in metres and degrees that no map has."""
    for name, value in zip(("x", "y", "heading"), start):
        require_number(f"start {name}", value, low=-1e6, high=1e6)


def swept_values(sweep: Sequence[str], settings: int, seed: int) -> dict[str, np.ndarray]:
    """Read the values of thresholds to be swept: `{name: [S] values}`, S = 1 without a sweep.

    Each text is a list, `votes=1,3,5`, or a range, `circle=1.1:2.0`. Lists alone make every combination; with a range
    among them, `settings` draws by Latin hypercube.
    """
    known = {field.name: field.type for field in dataclasses.fields(Tuning)} | {
        f"{NOISE}{field.name}": field.type for field in dataclasses.fields(Noise)
    }
    lists, ranges = {}, {}
    for text in sweep:
        name, equals, values = text.partition("=")
        if name in lists or name in ranges:
            raise InputError(f"sweep names {name} more than once")
        if name not in known or not equals:
            names = ", ".join(known)
            raise InputError(f"sweep must be NAME=A,B,... or NAME=LOW:HIGH, got {text!r}; there are {names}")
        try:
            if ":" in values:
                low, high = (float(v) for v in values.split(":", 1))
                if not low < high:
                    raise InputError(f"sweep {text!r}: a range must rise, as in {name}={high:g}:{low:g}")
                ranges[name] = (low, high)
            else:
                lists[name] = [float(v) for v in values.split(",")]
                if name in WHOLE and any(value != int(value) for value in lists[name]):
                    raise InputError(f"sweep {text!r}: {name} must be integers")
        except InputError:
            raise
        except (ValueError, OverflowError):
            raise InputError(f"sweep {text!r}: values must be numbers") from None
    if not ranges:
        if math.prod(len(values) for values in lists.values()) > MAX_RUNS:
            raise InputError(f"sweep: more than {MAX_RUNS} combinations; use fewer values")
        rows = list(itertools.product(*lists.values()))
        return {name: np.array([row[i] for row in rows]) for i, name in enumerate(lists)}
    from scipy.stats import qmc

    names = [*ranges, *lists]
    draws = qmc.LatinHypercube(len(names), rng=np.random.default_rng(seed)).random(settings)
    values = {name: low + draws[:, i] * (high - low) for i, (name, (low, high)) in enumerate(ranges.items())}
    for i, (name, given) in enumerate(lists.items(), len(ranges)):
        values[name] = np.asarray(given)[np.minimum((draws[:, i] * len(given)).astype(int), len(given) - 1)]
    return {name: np.round(value) if name in WHOLE else value for name, value in values.items()}


def attributes_of(texts: Sequence[str]) -> tuple[tuple[str, Any, tuple[float, float]], ...]:
    """Read attributes of nodes, each `NAME=VALUE@X,Y`: a value of JSON, else text; a place in metres."""
    found = []
    for text in texts:
        what, _, place = text.rpartition("@")
        name, equals, value = what.partition("=")
        try:
            x_m, y_m = (float(v) for v in place.split(","))
        except ValueError:
            x_m = y_m = math.nan
        if not (name and equals and math.isfinite(x_m) and math.isfinite(y_m)):
            raise InputError(f"attribute must be NAME=VALUE@X,Y, as in victim=true@12.5,4, got {text!r}")
        with contextlib.suppress(ValueError, RecursionError):
            value = json.loads(value, parse_constant=str)
        BtmMap((), ()).with_attributes({name: value})
        found.append((name, value, (x_m, y_m)))
    return tuple(found)
