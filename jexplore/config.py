"""Checks of input from outside, and the error for wrong input. Loads neither jax nor numpy."""

import dataclasses
import difflib
import functools
import inspect
import math
import numbers
import operator
import re
import reprlib
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar

MAX_SEED = 2**32 - 1
GENERATOR = "threefry2x32"  # of random numbers, as JAX names it; its draws are partitionable
# What runs episodes and trace runs: native code where there is some and JAX for the rest; JAX alone, as the reference.
ENGINES = ("auto", "jax")
MAX_RUNS = 1_000_000  # episodes of one strategy in one world; runs of a trace
NUMBER_BOUNDS: dict[str, tuple[float, float]] = {
    "seed": (0, MAX_SEED),
    "episodes": (1, MAX_RUNS),
    "episode": (0, MAX_RUNS - 1),
    "runs": (1, MAX_RUNS),
    "starts": (1, MAX_RUNS),
    "settings": (1, MAX_RUNS),
    "max_steps": (100, 100_000),
    "nodes": (2, 512),
    "links": (2, 1024),
    "frames": (1, 10_000),
    "rounds": (1, 10**6),
    "trials": (1, 10_000),
    "world_seeds": (1, 1000),
    "check_every": (1, 10**6),
    "workers": (1, 1024),
    "lanes": (1, 2**20),
    "batch_sizes": (1, 2**16),
    "repeat": (1, 1000),
    "seconds": (0.001, 7 * 86400.0),
    "bound_seconds": (0.001, 7 * 86400.0),
    "cell_m": (0.001, 100.0),
}
"""Name of a number that a user gives -> least and largest value; an integer where these are."""


__version__ = "0.1.0"


class InputError(ValueError):
    """Wrong input from outside: a file, a name, a number. The message says in one line what would be right."""

    def _render_traceback_(self):
        """Return the one line that a notebook shows instead of a traceback."""
        return [f"{type(self).__name__}: {self}"]


class InputWarning(UserWarning):
    """Usable input that hardly means what its author thinks. The message says the remedy in one line."""


def warn_of_input(text: str, stacklevel: int = 3) -> None:
    """Warn of input by an `InputWarning`; `stacklevel` as of `warnings.warn` where this is called."""
    warnings.warn(text, InputWarning, stacklevel=stacklevel + 1)


def shown(value: Any) -> str:
    """Return a value for messages: its `repr` on one line, cut short, whatever the value is."""
    try:
        text = _SHORT.repr(value)
    except Exception:  # whole numbers of more digits than Python writes out
        text = f"<{type(value).__name__}>"
    text = " ".join(text.split())
    return text if len(text) <= _MAX_SHOWN_CHARS else text[: _MAX_SHOWN_CHARS - 3] + "..."


def is_array(value: object) -> bool:
    """Return whether a value of a record is an array of a kernel, which was checked when it was a number."""
    return value is not None and not isinstance(value, (numbers.Number, str, list, tuple, dict))


_MAX_SHOWN_CHARS = 200  # characters of a value that a message shows
_SHORT = reprlib.Repr()  # stays short and quick however deep and repetitive a value is
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 60


def require_kind(name: str, given: object, kind: type) -> None:
    """Refuse a value that is not a record of a kind, but for example a dict of its fields; show how one is written."""
    if isinstance(given, kind):
        return
    fields = {field.name: field.default for field in dataclasses.fields(kind)}
    first = next(iter(fields))
    example = given if isinstance(given, dict) and given and given.keys() <= fields.keys() else {first: fields[first]}
    text = ", ".join(f"{key}={shown(value)}" for key, value in example.items())
    own = f"{'jx' if kind.__module__ == 'jexplore.rules' else 'jx.btm'}.{kind.__name__}"
    such = "" if dataclasses.MISSING in example.values() else f", such as {own}({text}),"
    raise InputError(f"{name} must be a {own}{such} got {shown(given)}")


_Record = TypeVar("_Record")


def as_record(name: str, given: Any, kind: type[_Record]) -> _Record:
    """Make a record of settings from a mapping of some of its fields: `{"range_m": 4}` for `Lidar(range_m=4)`."""
    if isinstance(given, Mapping):
        known = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
        for key in given:
            if key not in known:
                raise unknown(f"field of {name}:", str(key), known)
        return kind(**given)
    require_kind(name, given, kind)
    return given


def require_whole(name: str, value: Any, low: int, high: int) -> int:
    """Return `value` as an int within the bounds, both inclusive."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool) or not low <= number <= high:
        raise InputError(f"{name} must be an integer from {low} to {high}, got {shown(value)}")
    return number


def require_number(
    name: str, value: Any, *, low: float = 0.0, high: float = math.inf, low_open: bool = False, high_open: bool = False
) -> Any:
    """Return `value` if it is a finite number within the bounds, inclusive unless `low_open` / `high_open`."""
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    number: Any = value
    try:
        ok = is_number and math.isfinite(number)
    except OverflowError:  # a whole number beyond the largest float
        ok = False
    ok = ok and (number > low if low_open else number >= low) and (number < high if high_open else number <= high)
    if not ok:
        above = "" if math.isinf(low) else f" {'above' if low_open else 'at least'} {low:g}"
        below = "" if math.isinf(high) else f"{' and' if above else ''} {'below' if high_open else 'at most'} {high:g}"
        kind = "a number" if above or below else "a finite number"
        raise InputError(f"{name} must be {kind}{above}{below}, got {shown(value)}")
    return value


def require_setting(name: str, value: Any) -> Any:
    """Return a number that lies within its `NUMBER_BOUNDS`, an integer where these are."""
    low, high = NUMBER_BOUNDS[name]
    if isinstance(low, int):
        return require_whole(name, value, low, int(high))
    return require_number(name, value, low=low, high=high)


def require_engine(engine: str, lanes: int | None = None) -> None:
    """Refuse an engine that does not exist, and lanes where it has none to set."""
    if engine not in ENGINES:
        raise InputError(f"engine must be one of {', '.join(ENGINES)}, got {shown(engine)}")
    if lanes is not None:
        require_setting("lanes", lanes)
        if engine != "jax":
            raise InputError(f"lanes are for the engine jax, got {lanes} for {engine}")


def require_different(kind: str, names: Sequence[str], hint: str = "") -> None:
    """Refuse a name that is given more than once."""
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{kind} must differ, got {name!r} more than once{hint}")


def unknown(
    kind: str, word: str, known: Collection[str], synonyms: Mapping[str, str] = MappingProxyType({})
) -> InputError:
    """Return the error for an unknown word: names the known ones and the one probably meant.

    `synonyms`: what others call some of them -> their names.
    """
    meant = synonyms.get(word.lower().replace("_", "-"))
    near = [meant] if meant else difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    have = ", ".join(known) if known else "none"
    return InputError(f"unknown {kind} {word!r}{hint} (there are: {have})")


_Called = TypeVar("_Called", bound=Callable[..., Any])


def checked_names(called: _Called, own: str = "") -> _Called:
    """Make a public function or class refuse keyword arguments that it does not take, with the nearest that it does.

    Of a class that holds for making one and for its own public methods. Signatures stay as they are. `own` is what a
    message calls it, by default its name.
    """
    if not isinstance(called, type):
        return _checked_function(called, own)
    for name, value in list(vars(called).items()):
        if inspect.isfunction(value) and (name == "__init__" or not name.startswith("_")):
            setattr(called, name, _checked_function(value, own if name == "__init__" else ""))
        elif name == "__new__" and isinstance(value, staticmethod):  # of a NamedTuple
            setattr(called, name, staticmethod(_checked_function(value.__func__, own)))
    return called  # type: ignore[return-value]


def _checked_function(function, own=""):
    """Make unknown keyword arguments of a function an `InputError`."""
    parameters = inspect.signature(function).parameters
    kinds = {parameter.kind for parameter in parameters.values()}
    known = [name for name, parameter in parameters.items() if parameter.kind not in _NAMELESS]
    known = [name for name in known if name not in ("self", "_cls")]
    if inspect.Parameter.VAR_KEYWORD in kinds or not known:
        return function

    @functools.wraps(function)
    def checked(*args, **kwargs):
        for name in kwargs:
            if name not in known:
                raise _unknown_argument(own or _name_of(function), name, known, parameters)
        return function(*args, **kwargs)

    return checked


MIN_NAME_LIKENESS = 0.65  # share of letters in common with the name that was meant; resolution and elevation: 0.63
_NAMELESS = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.VAR_POSITIONAL)


def _name_of(function):
    """Return a user's name for a function; for a method that makes an object, the class."""
    return re.sub(r"\.__(init|new)__$", "", function.__qualname__).rpartition(".")[2]


def _unknown_argument(own, name, known, parameters):
    """Return the error for an argument that a function does not take, with a hint for a field of one of its records."""
    records = {key: parameters[key].default for key in known if dataclasses.is_dataclass(parameters[key].default)}
    fields = [(field.name, key) for key, record in records.items() for field in dataclasses.fields(record)]
    inside = {field: key for field, key in fields if field not in known}
    without_unit = [one for one in (*known, *inside) if one.startswith(f"{name}_")]
    near = without_unit or difflib.get_close_matches(name, [*known, *inside], n=1, cutoff=MIN_NAME_LIKENESS)
    meant = [f"{inside[one]}={{{one!r}: ...}}" if one in inside else repr(one) for one in near[:1]]
    hint = f"; did you mean {meant[0]}?" if meant else ""
    return InputError(f"unknown argument of {own}: {name!r}{hint} (there are: {', '.join(known)})")
