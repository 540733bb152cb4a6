"""The lockstep engine's program compiled for a device that is not there, and the texts that tell of it."""

import functools
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import SingleDeviceSharding

from jexplore.bench.ahead import launches
from jexplore.bench.ahead.hlo import Module
from jexplore.bench.engines import LIDAR, REFILLS, RULES, SEED, size_of
from jexplore.bench.timing import timed
from jexplore.engine.lockstep import Group
from jexplore.exploration.site import kernels_for, line_of, prepare_site
from jexplore.policies import Strategy
from jexplore.worlds.world import World


class Compiled(NamedTuple):
    """A program for a device."""

    steps: list[launches.Step]
    module: Module
    kernels: dict[str, str]  # name -> PTX
    n_lanes: int
    shape: tuple[int, ...]  # of the padded maps
    lane_bytes: int  # by the compiler's account: a lane's state and its share of what is needed in between
    temporary_bytes: int  # the share of that
    estimate_bytes: int  # `lanes.Engine.lane_bytes`
    compile_s: float


def lower(world: World, strategy: Strategy, n_lanes: int, device: Any) -> tuple[Any, int, int, tuple[int, ...]]:
    """The program of so many lanes, traced for a device: `(lowered, bytes that are no lanes', estimate, shape)`."""
    site = prepare_site(world, LIDAR, RULES, kernels_for("lockstep", "gpu"))
    starts = np.zeros((REFILLS * n_lanes, 3), np.int32)
    line = line_of(site, site.with_strategy(strategy), starts, SEED, np.arange(len(starts)))
    group = Group([line], jax.local_devices()[:1])
    queue = jax.tree.map(lambda a: a[0], group.queue())
    blank = jax.eval_shape(functools.partial(group.engine.empty, n_lanes=n_lanes), queue, group.common)
    arguments = jax.tree.map(
        lambda a: jax.ShapeDtypeStruct(np.shape(a), a.dtype), (blank, queue, np.int32(1), group.common)
    )
    place = SingleDeviceSharding(device)
    step = jax.jit(group.engine.go_on, donate_argnums=0, in_shardings=place, out_shardings=place)
    estimate = int(group.engine.lane_bytes(blank, line.shared))
    return step.lower(*arguments), size_of((blank.results, blank.kept)), estimate, site.truth.occupied.shape


def compile_for(world: World, strategy: Strategy, n_lanes: int, device: Any, options: dict[str, Any]) -> Compiled:
    """Compiles the program of so many lanes for a device.

    Args:
      world, strategy: `World`, `Strategy`.
      n_lanes: L.
      device: from `targets.compile_only`.
      options: of XLA, name -> value.
    """
    lowered, not_lanes, estimate, shape = lower(world, strategy, n_lanes, device)
    with tempfile.TemporaryDirectory(prefix="jexplore-") as folder:
        options = {"xla_dump_to": folder, "xla_dump_hlo_as_text": True, **options}
        program, took = timed(lambda: lowered.compile(compiler_options=options))
        module = Module(program.as_text())
        thunks = _text(folder, "thunk_sequence_after_thunk_passes", "thunk_sequence")
        steps = launches.read(thunks, _text(folder, "thunk_metadata"), module)
        ptx = [path.read_text() for path in Path(folder).glob("*.ptx")]
    memory = program.memory_analysis()
    temporary = memory.temp_size_in_bytes
    return Compiled(
        steps=steps,
        module=module,
        kernels={launches.kernel_of(text): text for text in ptx},
        n_lanes=n_lanes,
        shape=shape,
        lane_bytes=(temporary + memory.output_size_in_bytes - not_lanes) // n_lanes,
        temporary_bytes=temporary // n_lanes,
        estimate_bytes=estimate,
        compile_s=took.wall,
    )


def _text(folder, *kinds):
    """What XLA wrote of the first kind that it wrote of; of several programs the largest."""
    for kind in kinds:
        if paths := sorted(Path(folder).glob(f"*.{kind}.txt"), key=lambda path: path.stat().st_size):
            return paths[-1].read_text()
    raise RuntimeError(
        f"expected XLA to write {kinds[0]}.txt, got {sorted(p.name for p in Path(folder).glob('*.txt'))}"
    )
