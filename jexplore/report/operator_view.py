"""The operator's view: one run with a Behavioral Trace Map as a web page that replays offline, all in one file."""

import dataclasses

import numpy as np

from jexplore.report.page.assemble import map_page
from jexplore.report.page.packing import packed_numbers
from jexplore.report.store import jsonable
from jexplore.tracemap.record import BtmMap

_RESOLUTION = {  # of the arrays that are no whole numbers
    **{"time_s": 1e-3, "pose": 1e-3, "estimate": 1e-3, "walls_m": 1e-3, "angles_rad": 1e-4},
    **{"target_m": 1e-2, "ranges_m": 1e-2, "triangles_m": 1e-2, "left_m": 1e-2, "right_m": 1e-2},
    **{"pitch_deg": 1e-2, "roll_deg": 1e-2},
}


@dataclasses.dataclass(frozen=True, eq=False)
class RunRecording:
    """A run, frame by frame (N frames, one or more), and the map that it left. Numpy arrays, on the host."""

    title: str
    dt_s: float  # time between two frames, seconds
    mode_names: tuple[str, ...]
    walls_m: np.ndarray  # [S, 4] x0, y0, x1, y1 of the walls of the true building, metres
    goal_m: tuple[float, float] | None  # x, y in the true building, metres
    angles_rad: np.ndarray  # [B] bearings of the beams in the robot's frame, counter-clockwise from ahead
    time_s: np.ndarray  # [N], increasing
    pose: np.ndarray  # [N, 3] true x, y (metres) and heading (radians)
    estimate: np.ndarray  # [N, 3] the same by odometry: the frame of target, scan, triangles and map
    mode: np.ndarray  # [N] int index into `mode_names`
    target_m: np.ndarray  # [N, 2] point steered to, in the frame of the estimate; NaN for none
    ranges_m: np.ndarray  # [N, B]; NaN or infinite for no return
    triangles_m: np.ndarray  # [N, K, 3, 2] corners of the surviving triangles in the robot's frame; NaN for none
    chosen: np.ndarray  # [N] int index of the chosen triangle among the K; -1 for none
    pitch_deg: np.ndarray  # [N], above 0 nose down
    roll_deg: np.ndarray  # [N]
    n_nodes: np.ndarray  # [N] int, number of nodes of the map at that time: the first ones of `map.nodes`
    n_links: np.ndarray  # [N] int, number of links, the first ones of `map.links`
    link_searched_frame: np.ndarray  # [L] int frame from which a link of the map counts as searched; N for never
    votes: np.ndarray  # [N] int votes for the node that is being approached
    left_m: np.ndarray  # [N] L_l, distance to the wall on the left; infinite for none within reach
    right_m: np.ndarray  # [N] L_r, the same on the right
    map: BtmMap  # as it was at the end, in the frame of the estimate
    robot_m: tuple[float, float] = (0.70, 0.39)  # length and width of the robot, for its outline


def _data(recording):
    """Return the data for the page: packed arrays by name, the rest as is. Triangles lie end to end, without NaN."""
    arrays = {name: value for name, value in vars(recording).items() if isinstance(value, np.ndarray)}
    present = np.isfinite(recording.triangles_m).all(axis=(2, 3))
    rows = np.flatnonzero(recording.chosen >= 0)
    chosen = np.full(len(present), -1)
    chosen[rows] = (np.cumsum(present, axis=1) - 1)[rows, recording.chosen[rows]]
    arrays |= {"triangles_m": recording.triangles_m[present], "chosen": chosen, "n_triangles": present.sum(axis=1)}
    plain = ("title", "dt_s", "mode_names", "goal_m", "robot_m")
    return {
        **{name: jsonable(getattr(recording, name)) for name in plain},
        "nodes": [jsonable(vars(node)) for node in recording.map.nodes],
        "links": [jsonable(vars(link)) for link in recording.map.links],
        "arrays": {name: packed_numbers(values, _RESOLUTION.get(name, 1), name) for name, values in arrays.items()},
    }


def page(recording: RunRecording) -> str:
    """Return a run as one HTML file that replays in a browser: no network, no server, no other file. Plain ASCII.

    Metres are kept to 1 cm (poses and walls to 1 mm), angles of beams to 0.1 mrad, tilt to 0.01 degrees.
    """
    modes = '<div id="modekey" aria-label="Colours of the run modes"></div>'
    return map_page("trace", recording.title, _data(recording), ("trace.js",), own_controls=modes)
