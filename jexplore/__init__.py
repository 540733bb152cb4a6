"""jexplore: a laboratory for mobile-robot exploration, written in JAX.

    import jexplore as jx

    world = jx.load_world("cave#3")
    results = jx.compare(world, ["closest", "closest+recheck", "random"], episodes=20)
    results.to_pandas()

Importing this loads neither jax nor numpy; a name is loaded from its module when it is first used.
"""

import importlib
from typing import TYPE_CHECKING

__version__ = "0.1.0"

_MODULE_OF = {
    "InputError": "config",
    "Lidar": "config",
    "Rules": "config",
    "World": "world",
    "occupancy_to_world": "world",
    "load_world": "worlds",
    "GENERATORS": "worlds",
    "STRATEGIES": "policies",
    "MODIFIERS": "policies",
    "compare": "comparison",
    "Comparison": "comparison",
    "explore": "replay",
    "Episode": "replay",
    "reproduce": "reproduction",
    "Reproduction": "reproduction",
    "segment_maps": "segmentation",
    "Segmentation": "segmentation",
    "trace": "tracing",
    "Traced": "tracing",
    "Robot": "btm_settings",
    "Tuning": "btm_settings",
    "Noise": "btm_settings",
    "BtmMap": "btm_map",
    "read_btm": "btm_json",
}

__all__ = [
    "GENERATORS",
    "MODIFIERS",
    "STRATEGIES",
    "BtmMap",
    "Comparison",
    "Episode",
    "InputError",
    "Lidar",
    "Noise",
    "Reproduction",
    "Robot",
    "Rules",
    "Segmentation",
    "Traced",
    "Tuning",
    "World",
    "__version__",
    "compare",
    "explore",
    "load_world",
    "occupancy_to_world",
    "read_btm",
    "reproduce",
    "segment_maps",
    "trace",
]

if TYPE_CHECKING:
    from jexplore.btm_json import read_btm
    from jexplore.btm_map import BtmMap
    from jexplore.btm_settings import Noise, Robot, Tuning
    from jexplore.comparison import Comparison, compare
    from jexplore.config import InputError, Lidar, Rules
    from jexplore.policies import MODIFIERS, STRATEGIES
    from jexplore.replay import Episode, explore
    from jexplore.reproduction import Reproduction, reproduce
    from jexplore.segmentation import Segmentation, segment_maps
    from jexplore.tracing import Traced, trace
    from jexplore.world import World, occupancy_to_world
    from jexplore.worlds import GENERATORS, load_world


def __getattr__(name):
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__():
    return sorted({*globals(), *_MODULE_OF})
