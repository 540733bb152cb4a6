"""jexplore: a laboratory for mobile-robot exploration, written in JAX.

    import jexplore as jx

    world = jx.load_world("cave#3")
    results = jx.compare(world, ["closest", "closest+recheck", "random"], episodes=20)
    results.to_pandas()

Importing this loads neither jax nor numpy; a name is loaded from its module when it is first used.
"""

import importlib
from typing import TYPE_CHECKING

from jexplore.version import __version__

_MODULE_OF = {
    "InputError": "config",
    "InputWarning": "config",
    "Lidar": "config",
    "Rules": "config",
    "Policy": "policies",
    "Strategy": "policies",
    "register": "policies",
    "strategy": "policies",
    "Belief": "planning",
    "Choice": "planning",
    "Field": "planning",
    "View": "planning",
    "field": "planning",
    "choose": "planning",
    "nearest_frontier": "planning",
    "metres": "planning",
    "frontier_clusters": "frontier",
    "clusters": "policies",
    "views": "policies",
    "Outcome": "exploration.state",
    "GymEnv": "studies.gym.single",
    "GymVectorEnv": "studies.gym.lanes",
    "ScanLog": "worlds.readers.scans",
    "ScanMap": "worlds.readers.scans",
    "fold_scans": "worlds.readers.scans",
    "read_carmen": "worlds.readers.carmen",
    "read_bag": "worlds.readers.bags",
    "Environment": "studies.environment",
    "EnvState": "studies.environment",
    "World": "worlds.world",
    "occupancy_to_world": "worlds.world",
    "load_world": "worlds",
    "GENERATORS": "worlds",
    "STRATEGIES": "policies",
    "MODIFIERS": "policies",
    "compare": "studies.comparison",
    "Comparison": "studies.comparison",
    "explore": "studies.explore",
    "Episode": "studies.explore",
    "reproduce": "studies.reproduction",
    "Reproduction": "studies.reproduction",
    "bound": "studies.bounds.bound",
    "Bounds": "studies.bounds.bound",
    "train": "learn.training",
    "Trained": "learn.training",
    "sweep": "studies.sweeps.run",
    "Swept": "studies.sweeps.run",
    "Sweep": "studies.sweeps.spec",
    "Range": "studies.sweeps.spec",
    "load": "studies.results.loading",
    "segment_maps": "studies.segmentation",
    "Segmentation": "studies.segmentation",
    "trace": "studies.traces.tracing",
    "Traced": "studies.traces.tracing",
    "Robot": "driving.settings",
    "Tuning": "driving.settings",
    "Noise": "driving.settings",
    "BtmMap": "tracemap.record",
    "read_btm": "tracemap.json_form",
}

__all__ = [
    "GENERATORS",
    "MODIFIERS",
    "STRATEGIES",
    "Belief",
    "Bounds",
    "BtmMap",
    "Choice",
    "Comparison",
    "EnvState",
    "Environment",
    "Episode",
    "Field",
    "GymEnv",
    "GymVectorEnv",
    "InputError",
    "InputWarning",
    "Lidar",
    "Noise",
    "Outcome",
    "Policy",
    "Range",
    "Reproduction",
    "Robot",
    "Rules",
    "ScanLog",
    "ScanMap",
    "Segmentation",
    "Strategy",
    "Sweep",
    "Swept",
    "Traced",
    "Trained",
    "Tuning",
    "View",
    "World",
    "__version__",
    "bound",
    "choose",
    "clusters",
    "compare",
    "explore",
    "field",
    "fold_scans",
    "frontier_clusters",
    "load",
    "load_world",
    "metres",
    "nearest_frontier",
    "occupancy_to_world",
    "read_bag",
    "read_btm",
    "read_carmen",
    "register",
    "reproduce",
    "segment_maps",
    "strategy",
    "sweep",
    "trace",
    "train",
    "views",
]

if TYPE_CHECKING:
    from jexplore.config import InputError, InputWarning, Lidar, Rules
    from jexplore.driving.settings import Noise, Robot, Tuning
    from jexplore.exploration.state import Outcome
    from jexplore.frontier import frontier_clusters
    from jexplore.learn.training import Trained, train
    from jexplore.planning import Belief, Choice, Field, View, choose, field, metres, nearest_frontier
    from jexplore.policies import MODIFIERS, STRATEGIES, Policy, Strategy, clusters, register, strategy, views
    from jexplore.studies.bounds.bound import Bounds, bound
    from jexplore.studies.comparison import Comparison, compare
    from jexplore.studies.environment import Environment, EnvState
    from jexplore.studies.explore import Episode, explore
    from jexplore.studies.gym.lanes import GymVectorEnv
    from jexplore.studies.gym.single import GymEnv
    from jexplore.studies.reproduction import Reproduction, reproduce
    from jexplore.studies.results.loading import load
    from jexplore.studies.segmentation import Segmentation, segment_maps
    from jexplore.studies.sweeps.run import Swept, sweep
    from jexplore.studies.sweeps.spec import Range, Sweep
    from jexplore.studies.traces.tracing import Traced, trace
    from jexplore.tracemap.json_form import read_btm
    from jexplore.tracemap.record import BtmMap
    from jexplore.worlds import GENERATORS, load_world
    from jexplore.worlds.readers.bags import read_bag
    from jexplore.worlds.readers.carmen import read_carmen
    from jexplore.worlds.readers.scans import ScanLog, ScanMap, fold_scans
    from jexplore.worlds.world import World, occupancy_to_world


if not TYPE_CHECKING:  # a type checker would take this for a promise that every name exists

    def __getattr__(name):
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})
