"""Numbers of the robot that drives and writes a trace map. Plain Python.

Sizes of arrays and tables stand in the modules that use them: a compiled program cannot vary them.
"""

import dataclasses
import math

from jexplore.config import checked_names
from jexplore.rules import Settings


@dataclasses.dataclass(frozen=True)
class Sensing(Settings):
    """Points around the robot, scan matching, averages of noisy readings."""

    floor_m: float = 0.1  # a point no higher than this above the level on which the robot stands is ground
    outline_margin_m: float = 0.03  # between a wall and the robot's outline where it turns
    steady_deg: float = 0.33  # standard deviation of a mean attitude
    max_mean_steps: int = 16  # readings of which it is the mean, at most
    steady_m: float = 0.015  # standard deviation of a mean range
    agree_deviations: float = 3.7  # standard deviations within which two beams and the one between them agree
    every_m: float = 0.2  # scans are matched after this way
    every_rad: float = 0.25  # or this turn
    plane_rad: float = math.radians(6)  # scans are of one plane if the robot leans no more otherwise
    tilt_rad: float = math.radians(12)  # one of a robot that leans more is bent


@dataclasses.dataclass(frozen=True)
class Ground(Settings):
    """Slopes, stairs and steps."""

    step_m: float = 0.04  # a rise of the profile by more than this from point to point is a step
    face_m: float = 0.04  # m; within this of a step, points may lie on its face
    min_step_m: float = 0.015  # no lower step is told of
    noise_deviations: float = 4.5  # standard deviations of a point; a lower one may be noise
    together_m: float = 1.2  # steps no farther apart are one, as high as those seen before the robot is on the first
    # m; distance of the robot's end beyond the riser: before, its own tipping shows in the profile
    passed_m: float = 0.30
    # share of the angle at which a robot stands with one end on the riser that counts as tipping
    tip_share: float = 0.5
    # shares that a point has of the variance besides, and of that of noise: of noise alone, such as 5 cm of range noise
    # leave on a slope, the best wave has more once in 200
    noise_shares: tuple[float, float] = (10.0, 8.0)
    sure_wave_ratio: float = 5.0  # thresholds; a larger wave is stairs however large the rest
    profile_margin_m: float = 0.1  # m; margin of an obstacle's profile from the nodes at its ends
    even_deg: float = 1.0  # the robot stands evenly once its lean has varied by less than this
    even_lengths: float = 0.25  # over this way, in lengths of the robot: on a long robot a gentle slope comes slowly
    stairs_rise_m: float = 0.1  # where the profile ahead rises by more, what looks like a wall may be stairs
    step_slack_m: float = 0.03  # a step ahead may be lower than it looks by this
    look_m: float = 0.30  # of the profile ahead, in which a robot finds that it cannot climb
    level_rad: float = math.radians(4)  # ground that leans less is level, where a single step is looked for


@dataclasses.dataclass(frozen=True)
class Places(Settings):
    """Triangles, openings and exits of places, rejected candidates."""

    # least openings between points along a wall: both neighbours of one lie nearer than an opening
    spacing_widths: float = 0.49
    # least openings; points no farther beyond the chord of two corners of a triangle are one wall
    recess_widths: float = 0.25
    graze_rad: float = math.radians(4)  # a narrower gap, with beams a degree apart, is a wall seen at a grazing angle
    ahead_radii: float = 0.6  # radii from the centre from which on they are
    alike_m: float = 0.02  # m; longer connections of the walls on both sides of a gap weigh less by this scale
    same_exit_rad: float = math.radians(40)  # two openings, or a link and one, that bear no farther apart are one
    in_line_rad: float = math.radians(45)  # two openings are in line if they are no farther from it


@dataclasses.dataclass(frozen=True)
class Graph(Settings):
    """Nodes and links: which are one, which are given up."""

    # a node met again truly lies elsewhere if that is farther than this beyond its circle, metres
    elsewhere_m: float = 2.0
    # a robot beyond an opening is no farther before it and behind it
    beyond_opening_m: tuple[float, float] = (0.05, 1.0)
    # share of the way, and metres at most: how far off a known place may seem
    match_drift: tuple[float, float] = (0.025, 2.5)
    drift_share: float = 0.05  # of the way: how far off its other node may seem
    # the way in, or an opening of a known place, that bears no farther from a known link is that link
    same_end_rad: float = math.radians(25)
    turn_rad: float = math.radians(20)  # the odometry's heading is corrected by no more, where a node is met again
    # the odometry's place is corrected by half at a node met again no farther than this away, metres
    shift_m: float = 0.7
    same_node_m: float = 1.0  # free space and obstacles nearer than this to one that is known are that one
    led_node_m: float = 1.5  # and so near to where a known link leads to one
    turn_share: float = 0.2  # applied share of the correction of the heading: scan matching is more certain
    shift_share: float = 0.5  # and of the place
    search_every_steps: int = 3  # steps between two looks for triangles
    goal_m: float = 0.5  # a run ends where it hears its goal's beacon within this
    blind_steps: int = 20  # scans in a row, most of whose beams give no number, that end a run


@dataclasses.dataclass(frozen=True)
class Motion(Settings):
    """Run modes, going to places, obstacle avoidance."""

    trail_m: float = 0.04  # way between two poses of the trail
    trail_rad: float = 0.05  # a pose is reached within this and half of that
    go_m: float = 0.4  # another one is taken whose way is as long as this
    glance_rad: float = 0.2  # a turn is begun that can be gone on with for so long
    min_back_m: float = 0.15  # m; least distance of backing up
    ahead_s: float = 0.2  # s; look-ahead of a step
    outline_slack_m: float = 0.01  # between a wall and the robot's outline after a step
    past_end_m: float = 0.8  # m; a passage whose way ahead is free this far does not end here
    replaceable_votes: int = 2  # votes up to which another triangle takes the place of one that a scan does not show
    latch_steps: int = 200  # steps; a target not reached within these is given up
    # rad; the robot looks round by turning this far: the scanner covers half of the surroundings
    look_rad: float = math.pi - 0.05
    look_step_rad: float = 0.2  # rad; it stops looking where it cannot turn this much further
    # m; way between two looks round where the way is shut
    survey_m: float = 1.0
    same_place_radii: float = 0.4  # of its radius: a place nearer than this is the intended one
    taken_rad: float = math.radians(60)  # a link has been taken when the robot's heading is so near to its direction
    stuck_steps: int = 150  # steps without going on or finding a node after which the operator helps
    stuck_m: float = 0.3  # way that counts as going on
    stray_steps: int = 600  # the operator also helps after these steps near to one place
    stray_m: float = 3.0  # within this


@checked_names
@dataclasses.dataclass(frozen=True)
class Params(Settings):
    """Numbers of perception, driving and mapping besides those of `Tuning`."""

    sensing: Sensing = dataclasses.field(default_factory=Sensing)
    ground: Ground = dataclasses.field(default_factory=Ground)
    places: Places = dataclasses.field(default_factory=Places)
    graph: Graph = dataclasses.field(default_factory=Graph)
    motion: Motion = dataclasses.field(default_factory=Motion)


def default_numbers() -> dict[str, float]:
    """Return the default of every number by its name: `sensing.every_m`, or `graph.beyond_opening_m.0` in a tuple."""
    found: dict[str, float] = {}
    for part, group in vars(Params()).items():
        for name, value in vars(group).items():
            several = enumerate(value) if isinstance(value, tuple) else [(None, value)]
            found |= {f"{part}.{name}" if i is None else f"{part}.{name}.{i}": number for i, number in several}
    return found
