"""Frozen settings of a run and the error for wrong input. Plain Python: importing this loads neither jax nor numpy.

The command line builds its options from these classes; their docstrings are its help texts, and "off" among a field's
metadata is that of the option which switches it off, "short" leaves the record's name off the option.
"""

import dataclasses
import difflib
import functools
import inspect
import math
import numbers
import operator
import re
import reprlib
from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, Self, TypeVar

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
    "check_every": (1, 10**6),
    "patience": (0, 10**6),
    "workers": (1, 1024),
    "lanes": (1, 2**20),
    "batch_sizes": (1, 2**16),
    "sides": (32, 2048),
    "repeat": (1, 1000),
    "seconds": (0.001, 7 * 86400.0),
    "bound_seconds": (0.001, 7 * 86400.0),
    "cell_m": (0.001, 100.0),
}
"""Name of a number that a user gives -> least and largest value; an integer where these are."""


class InputError(ValueError):
    """Wrong input from outside: a file, a name, a number. The message says in one line what would be right."""

    def _render_traceback_(self):
        """Return the one line that a notebook shows instead of a traceback."""
        return [f"{type(self).__name__}: {self}"]


class InputWarning(UserWarning):
    """Usable input that hardly means what its author thinks. The message says the remedy in one line."""


def shown(value: Any) -> str:
    """Return a value for messages: its `repr` on one line, cut short, whatever the value is."""
    try:
        text = _SHORT.repr(value)
    except Exception:  # whole numbers of more digits than Python writes out
        text = f"<{type(value).__name__}>"
    text = " ".join(text.split())
    return text if len(text) <= _MAX_SHOWN_CHARS else text[: _MAX_SHOWN_CHARS - 3] + "..."


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
    own = f"{'jx' if kind.__module__ == __name__ else 'jx.btm'}.{kind.__name__}"
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


class Settings:
    """Common base of records of settings."""

    def replace(self, **changes: Any) -> Self:
        """Return the same settings with some fields changed, checked as when they are made."""
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]


@checked_names
@dataclasses.dataclass(frozen=True)
class Lidar(Settings):
    """A planar laser scanner, at the robot's centre and looking forward unless told otherwise.

    The defaults are a SICK LMS 200 as Stage models it.
    """

    n_beams: int = 181
    """A scan has this many beams, evenly spaced over the field of view, both edges included."""
    fov_deg: float = 180.0
    """The field of view is this wide, in degrees. At 360 the beams are spaced so that first and last do not coincide.
    Below 90 a look all round is eight scans."""
    range_m: float = 8.0
    """A beam sees what it enters at a distance below this, in metres."""
    sigma_m: float = 0.0
    """The noise of the ranges has this standard deviation, in metres."""
    dropout: float = 0.0
    """A beam returns nothing at all, and leaves the map as it is, with this probability."""
    no_echo: Literal["free", "unknown"] = "free"
    """A beam that nothing stops within the range says that its cells are free, or says nothing: they stay unknown, as
    drivers have it that report no echo as an invalid reading."""
    min_range_m: float = 0.0
    """A beam that is stopped nearer than this to the scanner says nothing, in metres (REP 117: an invalid reading)."""
    forward_m: float = 0.0
    """The scanner is mounted this far ahead of the robot's centre, in metres."""
    left_m: float = 0.0
    """The scanner is mounted this far to the left of the robot's centre, in metres."""
    yaw_deg: float = 0.0
    """The scanner looks this far to the left of the robot's heading, in degrees."""

    @property
    def mount_m(self) -> float:
        """Return distance of the scanner from the robot's centre, metres."""
        return math.hypot(self.forward_m, self.left_m)

    def without_noise(self) -> Self:
        """Return the scanner that has the same beams and perfect readings."""
        return dataclasses.replace(self, sigma_m=0.0, dropout=0.0, no_echo="free")

    def __post_init__(self) -> None:
        if self.no_echo not in ("free", "unknown"):
            raise InputError(f"lidar.no_echo must be 'free' or 'unknown', got {shown(self.no_echo)}")
        require_whole("lidar.n_beams", self.n_beams, low=1, high=4096)
        require_number("lidar.fov_deg", self.fov_deg, low=0, high=360, low_open=self.n_beams > 1)
        require_number("lidar.range_m", self.range_m, low_open=True, high=1000)
        require_number("lidar.sigma_m", self.sigma_m, high=1000)
        require_number("lidar.dropout", self.dropout, high=1, high_open=True)
        require_number("lidar.min_range_m", self.min_range_m, high=self.range_m, high_open=True)
        require_number("lidar.forward_m", self.forward_m, low=-10, high=10)
        require_number("lidar.left_m", self.left_m, low=-10, high=10)
        require_number("lidar.yaw_deg", self.yaw_deg, low=-360, high=360)


POSES = ("true", "odometry", "icp")
"""Ways in which a robot learns its pose: it is given; by odometry alone; by matching its scans as well."""


@checked_names
@dataclasses.dataclass(frozen=True)
class Odometry(Settings):
    """Errors of the odometry, for robots whose pose is not given.

    The squares of the first four are alpha 3, 1, 2 and 4 of Thrun, Burgard and Fox 2005, 5.4; the errors of alpha 2 and
    4 grow with the root of way and turn, so that they do not depend on the length of steps.
    """

    length: float = 0.01
    """The length of a step has this standard deviation, relative to it."""
    turn: float = 0.01
    """A turn has this standard deviation, relative to it."""
    heading_deg_sqrt_m: float = 0.5
    """The heading has this standard deviation after one metre of way, in degrees; it grows with the root of the way."""
    length_m_sqrt_rad: float = 0.0
    """The length of a step has this standard deviation after a turn of one radian, in metres; it grows with the root of
    the turn."""
    length_scale: float = 1.0
    """The encoders report every length scaled by this."""
    turn_scale: float = 1.0
    """The encoders report every turn scaled by this."""
    heading_bias_deg_m: float = 0.0
    """The odometry's heading turns by this on every metre of way, in degrees, counter-clockwise."""
    slip: float = 0.02
    """The robot loses this share of every turn to slip, which the encoders do not notice."""

    def __post_init__(self) -> None:
        low, high = {"heading_bias_deg_m": -45}, {"heading_deg_sqrt_m": 45, "heading_bias_deg_m": 45}
        for name, value in vars(self).items():
            if isinstance(value, numbers.Number):  # arrays and tracers are the kernels' own
                is_scale = name.endswith("_scale")
                most = 2 if is_scale else high.get(name, 0.5)
                require_number(f"odometry.{name}", value, low=low.get(name, 0), high=most, low_open=is_scale)


@checked_names
@dataclasses.dataclass(frozen=True)
class Robot(Settings):
    """Times and energies of the robot's motions; no path depends on them.

    The defaults are a Pioneer 3-DX with a SICK LMS 200: accelerations and turns as its firmware has them (300 mm/s²,
    100 degrees/s²), half a metre a second as in rooms, energy by Mei et al. 2005.
    """

    speed_m_s: float = 0.5
    """The robot drives this fast, in metres a second."""
    turn_rad_s: float = 1.75
    """It turns in place this fast, in radians a second."""
    acceleration_m_s2: float = 0.3
    """It speeds up and brakes this much, in metres a second squared."""
    turn_acceleration_rad_s2: float = 1.75
    """It speeds up and slows down a turn this much, in radians a second squared."""
    scan_s: float = 0.013
    """A scan takes this long where the robot stands for it, in seconds; on its way it scans while it drives."""
    plan_s: float = 0.0
    """A plan takes this long, in seconds, and the robot stands meanwhile; at 0 it plans while it drives."""
    standby_w: float = 36.0
    """Whatever it does it draws this power, in watts: controller 5, computer 11, scanner 20."""
    drive_j_m: float = 7.4
    """Rolling takes this energy, in joules a metre."""
    turn_j_rad: float = 1.2
    """Turning in place takes this energy, in joules a radian: that of wheels that roll 0.16 m from the centre."""
    mass_kg: float = 14.0
    """It weighs this much, in kilograms; braking loses the kinetic energy."""

    def __post_init__(self) -> None:
        for name in ("speed_m_s", "turn_rad_s", "acceleration_m_s2", "turn_acceleration_rad_s2"):
            require_number(f"robot.{name}", getattr(self, name), low=0.001, high=1000)
        for name in ("scan_s", "plan_s"):
            require_number(f"robot.{name}", getattr(self, name), high=3600)
        for name in ("standby_w", "drive_j_m", "turn_j_rad", "mass_kg"):
            require_number(f"robot.{name}", getattr(self, name), high=1e6)


@checked_names
@dataclasses.dataclass(frozen=True)
class Rules(Settings):
    """The rules of an exploration episode, besides the scanner and the strategy."""

    clearance_m: float = 0.30
    """A cell is clear if it is free and no occupied cell lies within this distance, centre to centre, in metres."""
    near_m: float = 0.50
    """Free cells within this distance of the robot, in metres, are traversable even where they are not clear."""
    p_free: float = 0.25
    """A known cell is free if its reflection probability is at most this, in float32; else it is occupied."""
    look_around: bool = dataclasses.field(
        default=True, metadata={"off": "A robot that arrives at a live target does not turn to look all round."}
    )
    """A robot that arrives at a live target turns in place, with scans at +90, +180 and +270 degrees; at every 45 where
    the field of view is below 90 degrees."""
    known_outline: bool = False
    """Strategies know where the world ends: beams of an expected gain stop at its outermost cells. By default what lies
    beyond counts as unknown."""
    scan_every_m: float = 0.0
    """A robot on its way makes a scan whenever it has driven this far since the last one, in metres; 0 is after every
    step. It also scans at its target, where it looks round, and where a step is refused."""
    arrival_m: float = 0.0
    """A target within this distance, in metres, that is no longer live counts as reached, also without +recheck."""
    max_steps: int | None = None
    """An episode ends as STEP_LIMIT after this many steps; by default the larger of 20000 and the number of cells."""
    max_plans: int | None = None
    """An episode ends as PLAN_LIMIT after this many plans; by default the larger of 20000 and the number of cells."""
    pose: Literal["true", "odometry", "icp"] = dataclasses.field(default="true", metadata={"short": True})
    """The robot is given its pose (true), takes it from its odometry, or corrects that by matching its scans (icp)."""
    odometry: Odometry = dataclasses.field(default_factory=Odometry, metadata={"short": True})

    def __post_init__(self) -> None:
        object.__setattr__(self, "odometry", as_record("odometry", self.odometry, Odometry))
        object.__setattr__(self, "pose", "true" if self.pose is True else self.pose)  # as YAML has it
        if self.pose not in POSES:
            raise unknown("pose", str(self.pose), POSES)
        require_number("rules.clearance_m", self.clearance_m, high=10)
        require_number("rules.near_m", self.near_m, high=10)
        for name in ("scan_every_m", "arrival_m"):
            require_number(f"rules.{name}", getattr(self, name), high=1000)
        require_number("rules.p_free", self.p_free, high=1, high_open=True)
        for name in ("look_around", "known_outline"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"rules.{name} must be True or False, got {getattr(self, name)!r}")
        for name in ("max_steps", "max_plans"):
            value = getattr(self, name)
            if value is not None:
                require_whole(f"rules.{name}", value, low=1, high=2**24)
