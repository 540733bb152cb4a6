"""The command `jexplore explore`."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

import tyro

from jexplore.cli.console import COMPILING, Out, note, progress_of
from jexplore.cli.options import OneStrategy, OneWorld, OutFolder
from jexplore.config import InputError, Lidar, Rules, require_whole


@dataclasses.dataclass(frozen=True)
class Explore:
    """Run one episode and draw it.

    Writes episode.png, episode.gif (known map, frontiers, target, path) and run.json. It is one of the episodes of a
    comparison with the same options.
    """

    world: OneWorld = "cave"
    """World: a generator's name such as cave#3, or a map file; see `jexplore worlds`."""
    strategy: OneStrategy = "closest+recheck"
    """Strategy; see `jexplore strategies`."""
    seed: int = 0
    """Seed of the start and the draws."""
    episode: int = 0
    """Number of the episode in a comparison with the same options, from 0."""
    cell_m: float = 0.1
    """Edge of a cell, metres."""
    start: Annotated[str, tyro.conf.arg(metavar="{random,world,ROW,COL,HEADING_DEG}")] = "random"
    """A start drawn from the seed, the world's own, or a cell and a heading that is a multiple of 45."""
    frames: int = 300
    """Frames of the animation at most, evenly spaced."""
    out: OutFolder = None
    """Folder to write."""
    overwrite: bool = False
    """Replace the run that the folder holds."""
    lidar: Lidar = dataclasses.field(default_factory=Lidar)
    rules: Rules = dataclasses.field(default_factory=Rules)

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Runs the command; returns the exit status, None for 0."""
        from jexplore.report import plot, store
        from jexplore.studies.checks import MAX_EPISODES
        from jexplore.studies.explore import prepare_job, run_job

        out = Out(self, "explore")
        require_whole("frames", self.frames, 1, 10_000)
        require_whole("episode", self.episode, 0, MAX_EPISODES - 1)
        job = prepare_job(
            self.world,
            self.strategy,
            seed=self.seed,
            episode=self.episode,
            cell_m=self.cell_m,
            start=_start(self.start),
            lidar=self.lidar,
            rules=self.rules,
        )
        with note(COMPILING):
            found = run_job(job, self.lidar, self.rules)
        measures = {"world": found.world.name, "strategy": found.strategy, **found.measures}
        record = out.record(arguments, self, result=measures, compile_s=found.compile_s, run_s=found.run_s)
        with progress_of(min(len(found.final.rows), self.frames), "frames") as progress:
            files = {"episode.png": lambda path: plot.save_figure(found.figure(), path)}
            if found.final.plans is not None:
                files["episode.gif"] = lambda path: found.save_gif(
                    path, max_frames=self.frames, on_progress=progress.step
                )
            wrote = out.write({**files, "run.json": lambda path: store.write_json(record, path)})
        for name, value in measures.items():
            text = "-" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
            print(f"{name:<18} {text}")
        if found.final.plans is None:
            print(f"warning: an episode of {found.measures['plans']} plans cannot be played again: no animation")
        print(wrote)


def _start(text):
    """`random`, `world`, or `row,col,heading_deg` as integers."""
    if text in ("random", "world"):
        return text
    try:
        row, col, heading = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--start must be random, world or ROW,COL,HEADING_DEG, got {text!r}") from None
    return row, col, heading
