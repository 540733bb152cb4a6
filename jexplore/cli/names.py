"""Fast checks of names, files and numbers, before jax is imported and a world is built.

Names that the package offers are read from its source, as importing a strategy or a generator would load jax.
Everything is checked again where it is used; what text alone does not decide is left to that.
"""

import ast
import functools
import importlib.machinery
import importlib.metadata
import importlib.util
import itertools
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jexplore.arrays.files import missing
from jexplore.config import (
    NUMBER_BOUNDS,
    InputError,
    require_different,
    require_engine,
    require_setting,
    unknown,
)
from jexplore.driving.settings import for_world, require_noise, require_tuning, robot_of
from jexplore.learn.settings import parse_settings, require_names_apart, require_rounds, trainer_settings
from jexplore.studies.metrics import module_and_function, named_metrics
from jexplore.worlds import GENERATORS, known_generators, read_name
from jexplore.worlds import names as grammar
from jexplore.worlds.bounds import require_generator
from jexplore.worlds.poses import read_polygon, read_start

DIFFERENT = "worlds", "strategies", "validation"  # options whose values count once each

ENTRIES = "jexplore.policies.catalogue.entries"
UNREAD = object()  # a default that is no plain value
_FOREIGN = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)(?=$|[+:])")


def check_names(command: str, options: Any) -> None:
    """Refuse names, files and numbers among a command's options that can stand for nothing.

    Raises:
      InputError: naming the first one, and what would be right.
    """
    if hasattr(options, "lanes"):
        require_engine(options.engine, options.lanes)
    for option in sorted(vars(options), key=lambda name: name != "cell_m"):  # which worlds are checked by
        check = OPTION_CHECKS.get(f"{command} {option}") or OPTION_CHECKS.get(option)
        if check is check_world:
            check = functools.partial(check_world, cell_m=getattr(options, "cell_m", 0.1))
        given = getattr(options, option)
        if check is None or given in (None, "", ()):
            continue
        ones = given if isinstance(given, tuple) else (given,)
        for one in ones:
            _check_one(check, one, option, is_alone=ones is not given)
        if option in DIFFERENT:
            require_different(option, ones)
    if command == "trace":
        check_trace(options)
    if command == "compare":
        check_metrics(options)
    if command == "train":
        check_train(options)


def _check_one(check, text, option, is_alone):
    """Check a value; explain how several are written if there are several in one text."""
    try:
        check(text)
    except InputError:
        pieces = re.split(r"[,;\s]+", text) if isinstance(text, str) else [text]
        if len(pieces) == 1 or not all(_passes(check, piece) for piece in pieces):
            raise
        right = "must be one of them" if is_alone else f"are given with spaces between, {' '.join(pieces)}"
        what = "metrics" if option == "metric" else option
        raise InputError(f"{text!r} is no name but several: {what} {right}") from None


def _passes(check, text):
    try:
        check(text)
    except InputError:
        return False
    return True


def check_world(name: str, cell_m: float = 0.1) -> None:
    """Refuse an unknown world, a parameter that its generator cannot use, a missing file."""
    _require_text(name)
    parsed, _ = read_name(name, _parameters_of)
    if parsed.kind != "generator":
        check_file(parsed.base)
    elif parsed.base in GENERATORS:
        given = {"cell_m": cell_m, **(_parameters_of(parsed.base) or {}), **parsed.parameters}
        require_generator(parsed.base, given)


def _parameters_of(generator):
    """Return the parameters of a generator with their defaults, read from its source; None for a user's function."""
    if generator not in GENERATORS:
        if ":" in generator:
            _require_module(generator.partition(":")[0])
        return None
    module, _, function = GENERATORS[generator].partition(":")
    return {key: value for key, value in signature(module, function).items() if key not in ("seed", "cell_m")}


def _require_text(name):
    """Refuse a name that tables cannot hold."""
    try:
        name.encode()
    except UnicodeEncodeError:
        raise InputError(f"{name!r}: the name of a world or strategy must be UTF-8: call the file otherwise") from None


def check_file(path: str) -> None:
    """Refuse the path of a missing file."""
    if not os.path.exists(os.path.expanduser(path)):
        raise missing(path)


def check_strategy(text: str) -> None:
    """Refuse a strategy's name that stands for nothing: no such strategy, module, modifier or parameter."""
    _require_text(text)
    foreign = _FOREIGN.match(text)
    if foreign and not foreign["module"].endswith(".py") and foreign["module"] not in known_strategies():
        name, rest, own = foreign[0], text[foreign.end() :], None
        _require_module(foreign["module"])
    else:
        name = re.split("[+:]", text, maxsplit=1)[0]
        rest, own = text[len(name) :], known_strategies().get(name, UNREAD)
        if own is UNREAD:
            if rest.startswith(":") and "=" not in rest:
                return  # a file is told how its module is named
            if os.path.isfile(f"{name}.py"):
                return
            raise unknown("strategy", name, known_strategies(), catalogue()["SYNONYMS"])
    words, _, tail = rest.partition(":")
    modifiers = [word.partition("=")[0] for word in words.split("+")[1:]]
    for modifier in modifiers:
        if modifier not in catalogue()["MODIFIERS"]:
            raise unknown(f"modifier in {text!r}:", modifier, catalogue()["MODIFIERS"])
    if isinstance(own, dict) and "segment" not in modifiers:
        for item in tail.split(",") if tail else ():
            key, _, value = item.partition("=")
            if key not in own:
                raise unknown(f"parameter of {name + words!r}:", key, own)
            if isinstance(own[key], (int, float)) and not isinstance(own[key], bool) and not _is_number(value):
                raise InputError(f"expected a number for {key} in {text!r}, got {value!r}")


def check_spec(path: str) -> None:
    """Refuse the file of a sweep that cannot be read, or that names missing things."""
    from jexplore.studies.sweeps.spec import read_spec

    spec = read_spec(path)
    spec.records(*(("tuning", "noise") if spec.robots else ()))
    require_different("worlds", [os.fspath(world) for world in spec.worlds])
    cells_m = dict.fromkeys(setting["cell_m"] for setting in spec.expanded())
    for world, cell_m in itertools.product(spec.worlds, cells_m):
        check_world(os.fspath(world), cell_m)
    for name, _ in () if spec.robots else spec.strategy_list():
        check_strategy(name)
    for name, thing in spec.metrics.items():
        if isinstance(thing, str):
            _require_module(module_and_function(name, thing)[0])


def check_metric(text: str) -> None:
    """Refuse a metric whose name cannot be a column's, that is no module:function, or of no module."""
    for name, thing in named_metrics(text).items():
        _require_module(module_and_function(name, thing)[0])


def check_metrics(options: Any) -> None:
    """Refuse an option without metrics, and two metrics of one name."""
    if options.metric == ():
        raise InputError("--metric must name at least one, got none")
    named_metrics(options.metric)


def check_trace(options: Any) -> None:
    """Refuse thresholds that a trace cannot have or sweep, and attributes that no node can have."""
    is_course = grammar.parse_name(options.world, generators=known_generators()).base == "course"
    require_tuning(for_world(options.tuning, is_course=is_course))
    from jexplore.studies.trace_options import attributes_of, require_start_pose, swept_values

    require_start_pose(options.start or ())
    swept_values(options.sweep, options.settings, options.seed)
    attributes_of(options.attribute)


def check_train(options: Any) -> None:
    """Refuse unknown ways of training, networks and settings, and validation worlds that are training worlds."""
    if options.network not in keys_of("jexplore.policies.learned.networks", "NETWORKS"):
        raise unknown("network", options.network, keys_of("jexplore.policies.learned.networks", "NETWORKS"))
    trainer_settings(options.algo, parse_settings(options.set))
    require_rounds(options.rounds, options.check_every)
    require_names_apart(options.worlds or (), options.validation or ())


OPTION_CHECKS: dict[str, Callable[[Any], object]] = {
    **{name: functools.partial(require_setting, name) for name in NUMBER_BOUNDS},
    **dict.fromkeys(("world", "worlds", "validation", "drive"), check_world),
    **dict.fromkeys(("strategy", "strategies"), check_strategy),
    **dict.fromkeys(("map", "from_map", "model", "truth", "parts"), check_file),
    "segment maps": check_world,
    "start": read_start,
    "trace start": lambda coordinate: None,  # checked with the rest of a trace, below
    "within": read_polygon,
    "robot": robot_of,
    "noise": require_noise,
    "compare metric": check_metric,
    "spec": check_spec,
    "bench engine": require_engine,
}
"""Name of an option, of one command or of any -> what refuses one of its values."""


def known_strategies() -> dict[str, dict[str, Any] | None]:
    """Return the named strategies -> their parameters with their defaults; None if unknown."""
    loaded = sys.modules.get(ENTRIES)
    others = [point.name for point in importlib.metadata.entry_points(group="jexplore.strategies")]
    return {**dict.fromkeys((*others, *(loaded.STRATEGIES if loaded else ()))), **catalogue()["STRATEGIES"]}


@functools.cache
def catalogue() -> dict[str, Any]:
    """Return the tables of the catalogue: its modifiers and synonyms, and its strategies with their parameters."""
    tree = _tree(ENTRIES)
    homes = {alias.name: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    tables = {}
    for node in tree.body:
        match node:
            case ast.AnnAssign(target=ast.Name(id="MODIFIERS" | "SYNONYMS" as name), value=ast.Dict() as value):
                tables[name] = ast.literal_eval(value)
            case ast.AnnAssign(target=ast.Name(id="STRATEGIES" as name), value=ast.Dict(keys=keys, values=values)):
                makers = [value.args[0].id for value in values]  # type: ignore[attr-defined]
                names = [ast.literal_eval(key) for key in keys if key is not None]
                tables[name] = {own: signature(homes[maker], maker) for own, maker in zip(names, makers)}
    return tables


@functools.cache
def keys_of(module: str, table: str) -> tuple[str, ...]:
    """Return the keys of a table of a module of this package."""
    (found,) = (
        node.value
        for node in _tree(module).body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == table
    )
    return tuple(ast.literal_eval(key) for key in found.keys)  # type: ignore[union-attr]


@functools.cache
def signature(module: str, function: str) -> dict[str, Any]:
    """Return the parameters of a function of this package -> their defaults, `UNREAD` for other than plain values."""
    (found,) = (node for node in _tree(module).body if isinstance(node, ast.FunctionDef) and node.name == function)
    plain = found.args.posonlyargs + found.args.args
    defaults = [None] * (len(plain) - len(found.args.defaults)) + list(found.args.defaults)
    pairs = [*zip(plain, defaults), *zip(found.args.kwonlyargs, found.args.kw_defaults)]
    return {argument.arg: _value(default) for argument, default in pairs}


def _value(node):
    try:
        return UNREAD if node is None else ast.literal_eval(node)
    except ValueError:
        return UNREAD


def _tree(module):
    path = Path(__file__).parents[1].joinpath(*module.split(".")[1:])
    return ast.parse(path.with_suffix(".py").read_text(encoding="utf-8"))


def _is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def _require_module(module):
    """Refuse a module that neither lies in the current folder nor is installed."""
    here, top = os.getcwd(), module.partition(".")[0]
    if importlib.machinery.PathFinder.find_spec(top, [here]) is None and importlib.util.find_spec(top) is None:
        raise InputError(f"no module {module!r}, neither installed nor in {here}")
