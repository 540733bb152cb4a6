"""Users' metrics by the names that they have as columns: checked before anything is compiled."""

import keyword
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

from jexplore.config import InputError, require_different, shown
from jexplore.exploration.metrics import Metric
from jexplore.exploration.uncertain.measures import MEASURES
from jexplore.studies.results.columns import COLUMNS, RATIO_COLUMNS, SUMMARY_COLUMNS, TEAM_COLUMNS
from jexplore.users import described, import_object

MetricsLike: TypeAlias = Mapping[str, Any] | Iterable[str] | None
"""Metrics by name: functions of an `EpisodeView`, `metric`s or "module:function"; or texts, "name=module:function"."""
TAKEN = {
    *(*COLUMNS, *SUMMARY_COLUMNS, *RATIO_COLUMNS, *TEAM_COLUMNS, *MEASURES),
    *("setting", "cell_m", "complete", "percent", "progress_m", "step", "way_row", "way_col", "way_known"),
    *("map", "row", "col", "valid", "known_m2"),
}
"""Names in tables of episodes and their summaries, and in the info of `Environment.step`."""


def named_metrics(metrics: MetricsLike) -> dict[str, Any]:
    """Return metrics by name, without importing those that are texts."""
    if isinstance(metrics, Mapping):
        pairs = list(metrics.items())
    else:
        texts = [metrics] if isinstance(metrics, str) else () if metrics is None else metrics
        texts = list(texts) if isinstance(texts, Iterable) else [texts]
        if not all(isinstance(text, str) for text in texts):
            raise InputError(f"metrics must be a mapping of names to functions, got {metrics!r}")
        split = [text.rpartition("=") for text in texts]
        pairs = [(name or place.rpartition(":")[2], place) for name, _, place in split]
    require_different("metrics", [str(name) for name, _ in pairs], "; name=module:function tells them apart")
    for name, thing in pairs:
        if not (isinstance(thing, str) or callable(thing)):
            raise InputError(f"metric {name!r}: {shown(thing)} is no metric: expected a function or module:function")
        what = (
            f"metric {thing!r}" if isinstance(thing, str) else f"metric {described(getattr(thing, 'function', thing))}"
        )
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name) or name[0] == "_":
            raise InputError(f"{what}: its name must be an identifier such as map_error, got {name!r}")
        if name in TAKEN:
            raise InputError(f"{what}: its name must be new, and {name!r} is in the tables already")
    return dict(pairs)


def ready_metrics(metrics: MetricsLike) -> dict[str, Metric]:
    """Make metrics of functions and names, in order."""
    ready = {}
    for name, thing in named_metrics(metrics).items():
        if isinstance(thing, str):
            place, (module, _, function) = thing, thing.partition(":")
            if not (module and function.isidentifier()):
                raise InputError(f"metric {name!r} must be module:function, got {place!r}")
            thing = import_object(module, function)
            if not callable(thing):
                raise InputError(f"metric {name!r}: {place} is no function")
        ready[name] = thing.anew() if isinstance(thing, Metric) else Metric(thing)
    return ready
