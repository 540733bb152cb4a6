"""The command `jexplore slam`."""

import dataclasses
from collections.abc import Sequence

from tyro.conf import Positional

from jexplore.cli.options import OutOptions, fields_of
from jexplore.cli.output.console import Out, working
from jexplore.config import InputError
from jexplore.slam2d.settings import SlamSettings


@dataclasses.dataclass(frozen=True)
class Slam(OutOptions):
    """Find the way of a recorded robot and the map of its building, by its scans and its odometry.

    Prints outcomes and errors. Writes trajectory.txt (TUM: t x y z qx qy qz qw), map.yaml and map.pgm (ROS), slam.png
    (the map by odometry and the map found), errors.parquet and run.json.
    """

    log: Positional[str] = ""
    """A CARMEN log (.log, .clf, or packed, .log.gz), or a rosbag with laser scans and odometry (.bag, .db3, .mcap)
    (required)."""
    closing: bool = True
    """Recognise places and correct the way by what they tell."""
    cell_m: float = 0.05
    """Make the edge of a cell of the map this long, in metres."""
    max_range_m: float | None = None
    """Readings of a CARMEN log of this or more mean that nothing was seen, in metres; by default found in the log."""
    topic: str | None = None
    """Take the scans of a rosbag from this topic."""
    odometry_topic: str | None = None
    """Take the odometry of a rosbag from this topic."""
    relations: str | None = None
    """Also give the errors against this file of relations, lines of t1 t2 x y z roll pitch yaw."""
    relations_offset_s: float = 0.0
    """The times in that file have this much more than the log's, in seconds."""
    matching: SlamSettings = dataclasses.field(default_factory=SlamSettings)

    def execute(self, arguments: Sequence[str]) -> int | None:
        """Run the command and return the exit status, None for 0."""
        import numpy as np

        from jexplore.engine.backend import use_compilation_cache
        from jexplore.grid import is_free, is_known
        from jexplore.studies.slam.logs import read_log, slam
        from jexplore.worlds.readers.ros import write_ros

        if not self.log:
            raise InputError("expected a log: robot.log, robot.log.gz, run.bag")
        with Out(self, arguments) as out:
            log = read_log(self.log, **fields_of(self, "max_range_m topic odometry_topic"))
            use_compilation_cache()
            with working(len(log.ranges), "scans") as on_progress:
                found = slam(
                    log,
                    **fields_of(self, "closing matching relations relations_offset_s"),
                    on_progress=on_progress,
                )
            drawn = found.map(self.cell_m)
            free, known = (np.asarray(mask) for mask in (is_free(drawn.grid, 0.25), is_known(drawn.grid)))
            occupancy = np.select([~known, free], [-1, 0], 100)
            errors = found.errors.to_dict("records")
            record = out.record(errors=errors, ate_m=found.ate_m, loops=len(found.loops))
            files = {
                "trajectory.txt": found.trajectory(),
                "map.yaml": lambda path: write_ros(occupancy, path, cell_m=drawn.cell_m, origin_m=drawn.origin_m),
                "errors.parquet": found.errors,
            }
            pictures = {"slam.png": found.figure}
            return out.finish(record, files, found.to_markdown(), pictures, interrupted=found.interrupted)
