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
    "strategies": "policies.catalogue.grammar",
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
    "load_bag": "worlds.readers.bags",
    "read_bag": "worlds.readers.bags",
    "Environment": "studies.environment",
    "EnvState": "studies.environment",
    "World": "worlds.world",
    "inside": "worlds.regions",
    "occupancy_to_world": "worlds.world",
    "load_world": "worlds",
    "GENERATORS": "worlds",
    "STRATEGIES": "policies",
    "MODIFIERS": "policies",
    "compare": "studies.comparison",
    "Comparison": "studies.results.comparison",
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
    "drift": "studies.traces.drift",
    "Drift": "studies.traces.drift",
    "odometry_map": "studies.traces.odometry_map",
    "OdometryMap": "studies.traces.odometry_map",
    "storage": "studies.traces.storage",
    "route": "studies.traces.routes",
    "routes": "studies.traces.routes",
    "follow": "studies.traces.following",
    "Followed": "studies.traces.following",
    "Route": "tracemap.route",
    "Robot": "driving.settings",
    "Tuning": "driving.settings",
    "Noise": "driving.settings",
    "BtmMap": "tracemap.record",
    "read_btm": "tracemap.json_form",
    "correct_map": "tracemap.corrected",
    "merge_maps": "tracemap.merging.merge",
    "station": "studies.traces.station",
    "Merged": "tracemap.merging.merge",
    "Merging": "tracemap.merging.match",
    "Limits": "tracemap.merging.walk",
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
    "Drift",
    "EnvState",
    "Environment",
    "Episode",
    "Field",
    "Followed",
    "InputError",
    "InputWarning",
    "Lidar",
    "Limits",
    "Merged",
    "Merging",
    "Noise",
    "OdometryMap",
    "Outcome",
    "Policy",
    "Range",
    "Reproduction",
    "Robot",
    "Route",
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
    "correct_map",
    "drift",
    "explore",
    "field",
    "fold_scans",
    "follow",
    "frontier_clusters",
    "inside",
    "load",
    "load_bag",
    "load_world",
    "merge_maps",
    "metres",
    "nearest_frontier",
    "occupancy_to_world",
    "odometry_map",
    "read_bag",
    "read_btm",
    "read_carmen",
    "register",
    "reproduce",
    "route",
    "routes",
    "segment_maps",
    "station",
    "storage",
    "strategies",
    "strategy",
    "sweep",
    "trace",
    "train",
    "views",
]

_OF_EXTRAS = ("GymEnv", "GymVectorEnv")  # need a package that may be missing: `from jexplore import *` leaves them out

if TYPE_CHECKING:
    __all__ += ["GymEnv", "GymVectorEnv", "worlds"]
    from jexplore.config import InputError, InputWarning, Lidar, Rules
    from jexplore.driving.settings import Noise, Robot, Tuning
    from jexplore.exploration.state import Outcome
    from jexplore.frontier import frontier_clusters
    from jexplore.learn.training import Trained, train
    from jexplore.planning import Belief, Choice, Field, View, choose, field, metres, nearest_frontier
    from jexplore.policies import MODIFIERS, STRATEGIES, Policy, Strategy, clusters, register, strategy, views
    from jexplore.policies.catalogue.grammar import strategies
    from jexplore.studies.bounds.bound import Bounds, bound
    from jexplore.studies.comparison import compare
    from jexplore.studies.environment import Environment, EnvState
    from jexplore.studies.explore import Episode, explore
    from jexplore.studies.gym.lanes import GymVectorEnv
    from jexplore.studies.gym.single import GymEnv
    from jexplore.studies.reproduction import Reproduction, reproduce
    from jexplore.studies.results.comparison import Comparison
    from jexplore.studies.results.loading import load
    from jexplore.studies.segmentation import Segmentation, segment_maps
    from jexplore.studies.sweeps.run import Swept, sweep
    from jexplore.studies.sweeps.spec import Range, Sweep
    from jexplore.studies.traces.drift import Drift, drift
    from jexplore.studies.traces.following import Followed, follow
    from jexplore.studies.traces.odometry_map import OdometryMap, odometry_map
    from jexplore.studies.traces.routes import route, routes
    from jexplore.studies.traces.station import station
    from jexplore.studies.traces.storage import storage
    from jexplore.studies.traces.tracing import Traced, trace
    from jexplore.tracemap.corrected import correct_map
    from jexplore.tracemap.json_form import read_btm
    from jexplore.tracemap.merging.match import Merging
    from jexplore.tracemap.merging.merge import Merged, merge_maps
    from jexplore.tracemap.merging.walk import Limits
    from jexplore.tracemap.record import BtmMap
    from jexplore.tracemap.route import Route
    from jexplore.worlds import GENERATORS, load_world
    from jexplore.worlds import listing as worlds
    from jexplore.worlds.readers.bags import load_bag, read_bag
    from jexplore.worlds.readers.carmen import read_carmen
    from jexplore.worlds.readers.scans import ScanLog, ScanMap, fold_scans
    from jexplore.worlds.regions import inside
    from jexplore.worlds.world import World, occupancy_to_world


if not TYPE_CHECKING:  # a type checker would take this for a promise that every name exists

    def __getattr__(name):
        if name == "worlds":  # the package, which lists worlds when it is called
            return importlib.import_module(f"{__name__}.worlds")
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        try:
            value = getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        except ImportError as error:
            if name not in _OF_EXTRAS:
                raise
            raise AttributeError(f"module {__name__!r} has no attribute {name!r} here: {error}") from None
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF, "worlds"})
