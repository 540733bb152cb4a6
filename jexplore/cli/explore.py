"""The command `jexplore explore`."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

from jexplore.cli.options import ReportOptions, SceneOptions, fields_of
from jexplore.cli.output.console import COMPILING, Out, note_if_slow, progress_of


@dataclasses.dataclass(frozen=True)
class Explore(ReportOptions, SceneOptions):
    """Run one episode and draw it.

    Writes episode.png, episode.gif (known map, frontiers, target, path), explored.yaml and explored.pgm (the map at the
    end, for ROS's map_server), report.html and run.json. The episode is that of a comparison with the same options.
    """

    world: str = "cave"
    """Explore this world: a generator's name such as cave#3, or a map file; see `jexplore worlds`."""
    strategy: str = "closest+recheck"
    """Explore by this strategy; see `jexplore strategies`."""
    seed: int = 0
    """Draw the start and all that is random from this seed."""
    episode: int = 0
    """Run the episode of this number, from 0, of a comparison with the same options."""
    robots: int | None = None
    """Explore with a team of this size, up to 16 robots."""
    coordination: str = "independent"
    """Have the team choose targets in this way: see compare."""
    frames: int = 300
    """Most frames of the animation, evenly spaced."""

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        from jexplore.studies.explore import prepare_job, run_job
        from jexplore.studies.replays import why_no_replay

        with Out(self, arguments) as out:
            job = prepare_job(
                self.world,
                self.strategy,
                **fields_of(self, "seed episode cell_m start within from_map lidar rules robot"),
                **fields_of(self, "robots coordination contact team_starts members"),
            )
            with note_if_slow(COMPILING):
                found = run_job(job)
            measures = found.measures
            times: dict[str, Any] = {"compile_s": found.compile_s, "run_s": found.run_s}
            record = out.record(result=measures, worlds=[found.world], **times)
            lines = [f"{name:<18} {_text(value)}" for name, value in measures.items()]
            if not found.can_be_replayed:
                lines.append(f"warning: {why_no_replay(found.rules)}: no animation")
            return out.finish(record, {}, "\n".join(lines), self._pictures(found, record))

    def _pictures(self, found, record):
        """Return pictures, animation and page: name -> content."""
        from jexplore.exploration.results import map_state, to_occupancy
        from jexplore.report.page.report import write_report
        from jexplore.report.tables import aligned_table
        from jexplore.worlds.readers.ros import write_ros

        def animation(path):
            with progress_of(min(found.measures["steps"] + 1, self.frames), "frames") as update:
                drawn = itertools.count(1)
                found.save_gif(path, max_frames=self.frames, on_progress=lambda _: update(next(drawn)))

        def page(path):
            replays = [found.replay] if found.can_be_replayed else []
            rows = [[name, _text(value)] for name, value in record["result"].items()]
            table = aligned_table(["measure", "value"], rows, left=["measure"])
            write_report(path, record, [("What it measured", table)], ["episode.png"], replays)

        def explored(path):
            final, world = found.final, found.world
            state = map_state(final.hits, final.misses, self.rules.p_free)
            write_ros(to_occupancy(state), path, cell_m=world.cell_m, origin_m=world.origin_m)

        writers = {"episode.png": found.figure, "explored.yaml": explored}
        if found.can_be_replayed:
            writers["episode.gif"] = animation
        return writers | ({"report.html": page} if self.report else {})


def _text(value):
    return "-" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
