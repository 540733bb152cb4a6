"""One tuning budget for every strategy: the same number of trials, in the same worlds, from the same starts.

Random search with successive halving (Jamieson and Talwalkar, AISTATS 2016): all trials run in few worlds, the better
half of them in twice as many, and so on. Strategies declare the bounds of their settings (`policies.policy.Span`).
"""

import contextlib
import functools
import math
import os
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jexplore.arrays.files import read_json
from jexplore.config import InputError, InputWarning, shown
from jexplore.learn.bank import REFERENCE, Bank
from jexplore.policies import parse_strategy, search_space
from jexplore.report.store import MAX_RECORD_BYTES
from jexplore.report.tables import aligned_table, ratio_text
from jexplore.studies.statistics.league import LEAGUE_STRATEGIES
from jexplore.studies.statistics.over_worlds import ratio_over_worlds
from jexplore.studies.sweeps.axes import Range

FIRST_SEED = 1000  # of the worlds; the league's are #0 and on
SHIPPED = Path(__file__).with_name("tuned.json")
MAX_DRAWS = 1000  # for each trial; of those of `mcdm` a fifteenth is a measure


class Search(NamedTuple):
    """Trials of one strategy."""

    name: str
    settings: list[dict[str, float]]  # of T trials; the first has the defaults, and none
    log_ratio: np.ndarray  # [T, W] float64, of the path and the reference's in every world; NaN: dropped before

    @property
    def best(self) -> int:
        """Return the number of the trial with the shortest paths of those that ran in all worlds."""
        return int(np.nanargmin(self.log_ratio.mean(axis=1)))


def with_values(name: str, values: Mapping[str, float]) -> str:
    """Return the text of a strategy that is given settings."""
    tail = ",".join(f"{key}={value}" for key, value in values.items())
    return f"{name}{',' if ':' in name else ':'}{tail}" if tail else name


def ready_spaces(names: Sequence[str] | None = None) -> list[str]:
    """Return the strategies to be tuned, by default the league's that have settings; refuse one without."""
    if names is None:
        return [name for name in LEAGUE_STRATEGIES if ":" not in name and search_space(name)]
    for name in names:
        if not search_space(name):
            raise InputError(f"{name!r} has no setting with bounds to be tuned; tune takes {', '.join(ready_spaces())}")
    return list(dict.fromkeys(names))


def drawn_settings(name: str, trials: int, seed: int) -> list[dict[str, float]]:
    """Draw settings of a strategy, to three digits; what it refuses is drawn again. Other strategies change nothing."""
    space, found = search_space(name), []
    draw = np.random.default_rng([seed, zlib.crc32(name.encode())])
    for _ in range(MAX_DRAWS * trials):
        values = {}
        for key, (span, default) in space.items():
            value = Range(*span).at(draw.random())
            values[key] = float(f"{value:.3g}") if isinstance(default, float) else round(value)
        with contextlib.suppress(InputError):
            parse_strategy(with_values(name, values))
            found.append(values)
        if len(found) == trials:
            return found
    raise InputError(f"{name!r}: {len(found)} of {MAX_DRAWS * trials} settings within their bounds are settings of it")


def halvings(trials: int, seeds: int) -> list[tuple[int, int]]:
    """Return the rounds, `(worlds of each kind, trials)`: the worlds double as often as trials can be halved."""
    rounds = 1 + int(math.log2(min(trials, seeds)))
    return [(seeds >> (rounds - 1 - i), math.ceil(trials / 2**i)) for i in range(rounds)]


def episodes_needed(strategies: int, worlds: int, trials: int, seeds: int) -> int:
    """Return the number of episodes of a search, those of the reference included."""
    before, total = 0, 0
    for n, left in halvings(trials, seeds):
        total += (n - before) * worlds // seeds * (1 + strategies * (1 + left))
        before = n
    return total


def search(
    names: Sequence[str], bank: Bank, *, seeds: int, trials: int, seed: int, workers: int | None = None,
    on_progress: Callable[[int], object] = lambda done: None,
) -> list[Search]:  # fmt: skip
    """Tune strategies, all together, so that they share compiled programs; none changes the result of another.

    The bank has worlds, kind by kind, `seeds` of each. `trials` settings are drawn besides the defaults, which run in
    all worlds; `seed` is that of starts and draws. `on_progress` is called with the number of finished episodes, see
    `episodes_needed`.
    """
    found = []
    for name in names:
        settings: list[dict[str, float]] = [{}, *drawn_settings(name, trials, seed)]
        found.append(Search(name, settings, np.full((len(settings), len(bank.worlds)), np.nan)))
    number, before, done = np.arange(len(bank.worlds)) % seeds, 0, 0
    left = [np.arange(1, trials + 1) for _ in names]
    for n, _ in halvings(trials, seeds):
        new = np.flatnonzero((number >= before) & (number < n))
        asked = [(one, i) for one, own in zip(found, left) for i in (0, *own)]
        strategies = [parse_strategy(with_values(one.name, one.settings[i])) for one, i in asked]
        moved = functools.partial(lambda before, k: on_progress(before + k), done)
        rows = bank.log_ratios(strategies, new.tolist(), seed, workers=workers, on_progress=moved)
        for (one, i), row in zip(asked, rows):
            one.log_ratio[i, new] = row
        for k, (one, own) in enumerate(zip(found, left)):
            order = np.argsort(one.log_ratio[own][:, number < n].mean(axis=1), kind="stable")
            left[k] = own[order[: (len(own) + 1) // 2]]
        before, done = n, done + len(new) * (1 + len(strategies))
    return found


def trials_table(searches: Iterable[Search]) -> pd.DataFrame:
    """Tabulate all trials: a row each with `strategy`, `trial`, `text`, `worlds`, and `ratio` over those worlds."""
    rows = [
        (one.name, i, with_values(one.name, values), n := int(np.isfinite(own).sum()), math.exp(np.nansum(own) / n))
        for one in searches
        for i, (values, own) in enumerate(zip(one.settings, one.log_ratio))
    ]
    return pd.DataFrame(rows, columns=["strategy", "trial", "text", "worlds", "ratio"])


def tuning_table(searches: Iterable[Search], worlds: Sequence[str]) -> str:
    """Format the choices as a Markdown table. Intervals are over worlds; the choice was made in the same ones."""
    lines = []
    for one in searches:
        chosen, default = one.log_ratio[one.best], one.log_ratio[0]
        ratios = [ratio_over_worlds(logs, worlds)[:3] for logs in (default, chosen, chosen - default)]
        settings = ", ".join(f"{key} {value:g}" for key, value in one.settings[one.best].items()) or "the defaults"
        lines.append([one.name, settings, *(ratio_text(*ratio) for ratio in ratios)])
    head = ["strategy", "chosen", f"defaults, to {REFERENCE}", f"chosen, to {REFERENCE}", "chosen to defaults"]
    return aligned_table(head, lines, left=["strategy", "chosen"])


def chosen_settings(searches: Iterable[Search]) -> dict[str, dict[str, float]]:
    """Return the chosen settings by strategy; none for one whose defaults were best."""
    return {one.name: one.settings[one.best] for one in searches}


def with_settings(strategies: Iterable[str], file: str | os.PathLike[str]) -> list[str]:
    """Give strategies the settings of a file of `jexplore tune`; `shipped` is the one that comes with the package."""
    page: Any = read_json(SHIPPED if os.fspath(file) == "shipped" else file, MAX_RECORD_BYTES)
    settings = page.get("settings") if isinstance(page, dict) else None
    if not isinstance(settings, dict) or not all(isinstance(values, dict) for values in settings.values()):
        raise InputError(f"{file}: must be a file of settings as `jexplore tune` writes, with settings by strategy")
    numbers = [value for values in settings.values() for value in values.values()]
    if not all(isinstance(value, int | float) for value in numbers):
        raise InputError(f"{file}: settings must be numbers, got {shown(numbers)}")
    names = list(strategies)
    missing = [name for name in names if name not in settings and ":" not in name and search_space(name)]
    if missing:
        warnings.warn(f"{file}: has no settings of {', '.join(missing)}, which keep their defaults", InputWarning, 2)
    return [with_values(name, settings.get(name, {})) for name in names]
