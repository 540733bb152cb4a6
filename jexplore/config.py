"""Frozen settings of a run and the error for wrong input. Plain Python: importing this loads neither jax nor numpy.

The command line builds its options from these classes; their docstrings are its help texts.
"""

import dataclasses
import difflib
import math
import numbers
import operator
from collections.abc import Collection
from typing import Any

MAX_SEED = 2**32 - 1


class InputError(ValueError):
    """Wrong input from outside: a file, a name, a number. The message is one line that says what would be right."""

    def _render_traceback_(self):
        """What a notebook shows instead of a traceback: the one line."""
        return [f"{type(self).__name__}: {self}"]


def require_whole(name: str, value: Any, low: int, high: int) -> int:
    """`value` as an int within the bounds, both inclusive.

    Raises:
      InputError: not a whole number, or outside the bounds.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool) or not low <= number <= high:
        raise InputError(f"{name} must be an integer from {low} to {high}, got {value!r}")
    return number


def require_number(
    name: str, value: Any, *, low: float = 0.0, high: float = math.inf, low_open: bool = False, high_open: bool = False
) -> Any:
    """Refuse `value` unless it is a finite number within the bounds.

    Args:
      name: what the user calls it, for the message.
      value: the number.
      low, high: bounds, inclusive unless `low_open` / `high_open`.

    Raises:
      InputError: not a number, NaN, infinite, or outside the bounds.
    """
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    number: Any = value
    ok = is_number and math.isfinite(number)
    ok = ok and (number > low if low_open else number >= low) and (number < high if high_open else number <= high)
    if not ok:
        above = "" if math.isinf(low) else f" {'above' if low_open else 'at least'} {low:g}"
        below = "" if math.isinf(high) else f"{' and' if above else ''} {'below' if high_open else 'at most'} {high:g}"
        kind = "a number" if above or below else "a finite number"
        raise InputError(f"{name} must be {kind}{above}{below}, got {value!r}")
    return value


def unknown(kind: str, word: str, known: Collection[str]) -> InputError:
    """The error for a word that is not among those known: says which exist and which was probably meant."""
    near = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    have = ", ".join(known) if known else "none"
    return InputError(f"unknown {kind} {word!r}{hint} (there are: {have})")


@dataclasses.dataclass(frozen=True)
class Lidar:
    """A planar laser scanner that looks forward. The defaults are a SICK LMS 200 as Stage models it."""

    n_beams: int = 181
    """Beams a scan, evenly spaced over the field of view, both edges included."""
    fov_deg: float = 180.0
    """Field of view, degrees. At 360 the beams are spaced so that first and last do not coincide. Below 90 a look all
    round is eight scans."""
    range_m: float = 8.0
    """A beam sees what it enters at a distance below this, metres."""
    sigma_m: float = 0.0
    """Standard deviation of the range noise, metres."""
    dropout: float = 0.0
    """Probability that a beam returns nothing at all, and leaves the map as it is."""

    def __post_init__(self) -> None:
        require_whole("lidar.n_beams", self.n_beams, low=1, high=4096)
        require_number("lidar.fov_deg", self.fov_deg, low=0, high=360, low_open=self.n_beams > 1)
        require_number("lidar.range_m", self.range_m, low_open=True, high=1000)
        require_number("lidar.sigma_m", self.sigma_m, high=1000)
        require_number("lidar.dropout", self.dropout, high=1, high_open=True)


@dataclasses.dataclass(frozen=True)
class Rules:
    """The rules of an exploration episode, besides the scanner and the strategy."""

    clearance_m: float = 0.30
    """A cell is clear if it is free and no occupied cell lies within this distance, centre to centre, metres."""
    near_m: float = 0.50
    """Free cells within this distance of the robot are traversable even where they are not clear, metres."""
    p_free: float = 0.25
    """A known cell is free if its reflection probability is at most this, in float32, else occupied."""
    look_around: bool = True
    """Whether arriving at a live target turns the robot in place, with scans at +90, +180 and +270 degrees; at every 45
    where the field of view is below 90 degrees."""
    max_steps: int | None = None
    """Steps after which an episode ends as STEP_LIMIT. Default: the larger of 20000 and the number of cells."""
    max_plans: int | None = None
    """Plans after which an episode ends as PLAN_LIMIT. Default: the larger of 20000 and the number of cells."""

    def __post_init__(self) -> None:
        require_number("rules.clearance_m", self.clearance_m, high=10)
        require_number("rules.near_m", self.near_m, high=10)
        require_number("rules.p_free", self.p_free, high=1, high_open=True)
        if not isinstance(self.look_around, bool):
            raise InputError(f"rules.look_around must be True or False, got {self.look_around!r}")
        for name in ("max_steps", "max_plans"):
            value = getattr(self, name)
            if value is not None:
                require_whole(f"rules.{name}", value, low=1, high=2**24)
