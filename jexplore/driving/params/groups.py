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
    behind_deg: int = 88  # degrees from straight ahead from which on the last scan is not all there is
    outline_margin_m: float = 0.03  # between a wall and the robot's outline where it turns
    steady_deg: float = 0.33  # standard deviation of a mean attitude
    max_mean_steps: int = 16  # readings of which it is the mean, at most
    steady_m: float = 0.015  # standard deviation of a mean range
    agree_deviations: float = 3.7  # standard deviations within which two beams and the one between them agree
    every_m: float = 0.2  # scans are matched after this way
    every_rad: float = 0.25  # or this turn
    key_m: float = 1.0  # the reference scan is replaced after this way
    key_rad: float = 0.6  # or this turn
    reach_m: float = 0.3  # a line is laid through the points of neighbouring beams as far as they are this near
    line_flatness: float = 0.04  # a line is even across which its points vary by no more than this share of along it
    match_rounds: int = 6  # rounds of the fit
    # a point farther from its line than this counts not, in the first round and from the third on
    gate_m: tuple[float, float] = (0.3, 0.1)
    range_sd_m: float = 0.03  # of a point from its line
    encoder_share: float = 0.1  # standard deviation of the encoders, as a share of way and turn
    encoder_m: float = 0.01  # added to that of the way
    encoder_rad: float = math.radians(0.5)  # added to that of the turn
    plane_rad: float = math.radians(6)  # scans are of one plane if the robot leans no more otherwise
    tilt_rad: float = math.radians(12)  # one of a robot that leans more is bent
    key_share: float = 0.6  # of the points; with fewer the next scan is matched with this one


@dataclasses.dataclass(frozen=True)
class Ground(Settings):
    """Slopes, stairs and steps."""

    step_m: float = 0.04  # a rise of the profile by more than this from point to point is a step
    face_m: float = 0.04  # m; within this of a step, points may lie on its face
    min_step_m: float = 0.015  # no lower step is told of
    noise_deviations: float = 4.5  # standard deviations of a point; a lower one may be noise
    together_m: float = 1.2  # steps no farther apart are one, as high as those seen before the robot is on the first
    # share that a point has of the variance besides: of noise alone, such as 5 cm of range noise leave on a slope, the
    # best wave has more once in 200
    rest_share: float = 10.0
    sure_wave_ratio: float = 5.0  # thresholds; a larger wave is stairs however large the rest
    profile_margin_m: float = 0.1  # m; margin of an obstacle's profile from the nodes at its ends
    even_deg: float = 1.0  # the robot stands evenly once its lean has varied by less than this
    even_lengths: float = 0.25  # over this way, in lengths of the robot: on a long robot a gentle slope comes slowly
    step_slack_m: float = 0.03  # a step ahead may be lower than it looks by this
    look_m: float = 0.30  # of the profile ahead, in which a robot finds that it cannot climb
    level_rad: float = math.radians(4)  # ground that leans less is level, where a single step is looked for


@dataclasses.dataclass(frozen=True)
class Places(Settings):
    """Triangles, openings and exits of places, rejected candidates."""

    # least openings between points along a wall: both neighbours of one lie nearer than an opening
    spacing_widths: float = 0.49
    roomy_share: float = 0.9  # of the radius of the circle that free space has room for
    # least openings; points no farther beyond the chord of two corners of a triangle are one wall
    recess_widths: float = 0.25
    wall_fill_share: float = 0.6  # if its points fill this share of the way between them
    near_wall_radii: float = 1.15  # radii within which a wall divides two openings
    graze_rad: float = math.radians(4)  # a narrower gap, with beams a degree apart, is a wall seen at a grazing angle
    door_m: float = 1.25  # a gap is a door up to this width, or the next
    narrow: float = 0.6  # radii; a gap so narrow that leads on is a door, however far its walls
    leads_on_m: float = 0.6  # a gap that is free this far beyond its ends, or its wall, leads on
    max_point_m: float = 10.0  # no point lies farther away
    corner_depth: float = 0.65  # of the width of a gap: walls that meet so close beyond it are a corner
    pocket: float = 1.2  # of the width of a gap: walls so close beyond it are those of a pocket
    deep: float = 0.75  # share of the directions beyond a gap in which they are
    seen: float = 0.7  # and in which there must be walls
    door: int = 3  # directions that a door takes at least
    beyond_pocket_m: float = 0.25  # m; points farther behind its wall are seen through a door in it
    both_ends: float = 0.75  # share of the directions of a wall that its ends are
    ahead_radii: float = 0.6  # radii from the centre from which on they are
    alike_m: float = 0.02  # m; longer connections of the walls on both sides of a gap weigh less by this scale
    same_exit_rad: float = math.radians(40)  # two openings, or a link and one, that bear no farther apart are one
    wider_circle: float = 1.5  # search circles, in which doors that lie partly outside one are looked for
    somewhat_wider: float = 1.25  # radii; wide enough for both jambs, before the next door is in sight
    same_opening_m: float = 0.5  # from the middle of every other opening
    wide_place_m: float = 2.0  # a place is wide from this radius on: doors are looked for wall by wall
    last_resort_m: float = 1.2  # as a last resort they are looked for from this radius on
    last_resort_radii: float = 2.0  # this many radii from the middle
    most_door_m: float = 1.5  # such a door is no wider
    behind_rad: float = math.radians(12)  # what bears no farther from a door, and lies beyond it, is behind it
    through_m: float = 0.5  # m; a point seen through a door's gap and farther by this is behind it too
    # an opening that leads this far off its middle's direction, and off the opposite, is two if another bears no
    # farther from it
    merged_rad: float = math.radians(60)
    # a passage that leads no farther off the direction of its middle is straight ahead, and its link bears as it does
    straight_rad: float = math.radians(30)
    # of a circle's diameter: with only one opening, wider than this, it lies in a corner
    corner_width_ratio: float = 1.3
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
    drift_share: float = 0.05  # of the way: how far off its other node may seem, and a node that a place perhaps is
    # an un-searched link on which the robot has set off so often in vain is given up, and a searched one is followed no
    # more that has led elsewhere so often in a row
    max_tries: int = 3
    # the way in, or an opening of a known place, that bears no farther from a known link is that link
    same_end_rad: float = math.radians(25)
    turn_rad: float = math.radians(20)  # the odometry's heading is corrected by no more, where a node is met again
    door_before_m: float = 3.0  # m; a door passed within this before another opening is the way in
    # the odometry's place is corrected by half at a node met again no farther than this away, metres
    shift_m: float = 0.7
    same_node_m: float = 1.0  # free space and obstacles nearer than this to one that is known are that one
    led_node_m: float = 1.5  # and so near to where a known link leads to one
    turn_share: float = 0.2  # applied share of the correction of the heading: scan matching is more certain
    shift_share: float = 0.5  # and of the place
    steered_lengths: float = 1.5  # length of the stretch in which walls are steered by, in look-aheads
    crossing_m: float = 0.1  # but no nearer than this to a wall across the way
    search_every_steps: int = 3  # steps between two looks for triangles
    near_points_m: float = 4.0  # m; a robot that looks farther than this searches near points once more
    min_centre_x_m: float = -0.2  # m; a divergence is searched from this far ahead of the robot's middle
    goal_m: float = 0.5  # a run ends where it hears its goal's beacon within this
    along_cos: float = 0.7  # cosine of the angle, at least, between a way and a link along it
    blind_steps: int = 20  # scans in a row, most of whose beams give no number, that end a run


@dataclasses.dataclass(frozen=True)
class Motion(Settings):
    """Run modes, going to places, obstacle avoidance, recovery."""

    trail_m: float = 0.04  # way between two poses of the trail
    trail_rad: float = 0.05  # a pose is reached within this and half of that
    off_trail_rad: float = 1.0  # the robot goes straight back from a pose from which it has turned farther
    stop_m: float = 0.25  # a direction is blocked whose way is no longer than this
    go_m: float = 0.4  # another one is taken whose way is as long as this
    glance_rad: float = 0.2  # a turn is begun that can be gone on with for so long
    steer_rad_m: float = 3.0  # steering per metre of offset from the trail
    max_steer_rad: float = 0.25  # and its maximum
    min_back_m: float = 0.15  # m; least distance of backing up
    max_back_m: float = 8.0  # it backs up no farther
    # m; distance driven ahead where it cannot back farther, and as much to the wanted side as is free
    drive_away_m: float = 0.4
    min_back_step_m: float = 0.005  # m; progress counted for a step, turning included
    ahead_s: float = 0.2  # s; look-ahead of a step
    recovery_steps: int = 8  # steps for which it goes on with what gets it away from what it has touched
    touch_again_steps: int = 12  # and within these it tries the next way where it touches again: more than lead back
    lean_rad_s: float = 0.1  # turn rate, rad/s: next to a wall the outline allows no larger one
    outline_slack_m: float = 0.01  # between a wall and the robot's outline after a step
    keep_direction_weight: float = 0.3  # weight of the direction taken before
    replaceable_votes: int = 2  # votes up to which another triangle takes the place of one that a scan does not show
    debounce_steps: int = 3  # steps in a row that free space, or ground that it cannot climb, must be seen
    hysteresis_m: float = 0.3  # a free space ends where both sides have a wall this much nearer than where it began
    contact_guard_m: float = 0.1  # a wall this near to the robot's front stops it, if there is no way past it
    turn_room_m: float = 0.1  # m; a wall is followed at this more than the clearance for turning in place
    way_past_wall_rad: float = 1.75  # a way of `go_m` within this bearing leads past a wall
    # bearing, radians, and length, metres, of a way that leads past an apparent end of a passage
    way_past_end: tuple[float, float] = (1.0, 0.8)
    latch_steps: int = 200  # steps; a target not reached within these is given up
    latch_time_ratio: float = 1.5  # or within this multiple of the steps at full speed, if larger
    via_point_m: float = 0.6  # m; a wide place is left via a point this far before the exit
    off_axis_m: float = 0.25  # m; unless the robot is within this of the exit's axis
    # rad; the robot looks round by turning this far: the scanner covers half of the surroundings
    look_rad: float = math.pi - 0.05
    look_on_rad: float = 0.5  # rad; additional turn while it sees no place although every scan on the way has shown one
    look_step_rad: float = 0.2  # rad; it stops looking where it cannot turn this much further
    unturned_stop_m: float = 0.1  # where it cannot turn at a place, it goes on as near as this
    # a place so near may be the one that is meant; and way between two looks round where the way is shut
    survey_m: float = 1.0
    at_place_ratio: float = 2.0  # a robot is at a place within this multiple of the distance at which it stops there
    max_surveys: int = 2  # so often a robot that has looked round goes to a better place than the one where it is
    same_place_m: float = 0.4  # a place nearer than this is the intended one
    same_place_radii: float = 0.4  # or nearer than this share of its radius
    better_radius_ratio: float = 1.15  # a place is better if its circle is larger by this
    same_radius_share: float = 0.1  # of a node's radius: a circle that differs from it by less is as large
    taken_rad: float = math.radians(60)  # a link has been taken when the robot's heading is so near to its direction
    stuck_steps: int = 150  # steps without going on or finding a node after which the operator helps
    stuck_m: float = 0.3  # way that counts as going on
    stray_steps: int = 600  # the operator also helps after these steps near to one place
    stray_m: float = 3.0  # within this
    # a robot that leaves a place, and has farther than this to go, heeds what it passes on the way
    heed_on_way_m: float = 1.0
    lost_place_m: float = 0.5  # m; a divergence farther ahead than this plus its radius, and no longer seen, is dropped


@dataclasses.dataclass(frozen=True)
class Route(Settings):
    """Following a route."""

    # a match lies within this share of the way plus this many metres of its mapped position
    match_tolerance: tuple[float, float] = (0.1, 1.0)
    exact_match_tolerance: tuple[float, float] = (0.2, 1.5)  # within these if its exits are exactly those of the map
    at_mapped_m: float = 0.7  # one that is so near is it, if only the way on is there
    # and one that is as near as this is it, whatever is seen there, also in free space: the robot steers on
    at_mapped_unseen_m: float = 0.4
    misfit_m: float = 0.3  # m; a missing or additional exit adds this to the distance from the mapped position
    back_rad: float = math.radians(120)  # an exit that bears farther from the expected direction does not count
    # at a place that the map does not have, the robot turns to the next if that is farther than this; at one so near
    # that has not been seen yet, it looks round
    next_place_m: float = 1.5
    heading_share: float = 0.5  # of what the ways of a place say of the heading, by their median
    # and no more than this: the middle of one seen elsewhere turns its ways
    max_heading_turn_rad: float = math.radians(10)
    # of what a place says of where the map lies: it may be another, and its middle is seen differently
    anchor_share: float = 0.3
    other_place_share: float = 0.5  # a place is not on the route if another of the map lies nearer than this share
    # m; without an opening, an exit exists if a strip from the place's middle is free this far
    open_strip_m: float = 2.0
    strip_m: float = 0.6  # so wide
    straight_leg_ratio: float = 1.15  # a way longer than this multiple of the distance of its ends is not straight
    straight_leg_m: float = 2.0  # nor is a leg shorter than this
    # ratio and m of the way: without any next place within these the robot is lost
    lost_bound: tuple[float, float] = (1.5, 5.0)
    # m; tolerance of the end, increase per metre of excess way, and maximum
    end_m: tuple[float, float, float] = (0.4, 0.2, 0.8)
    # ratio and m: a link not longer than the distance of its ends by more is straight
    straight_link: tuple[float, float] = (1.25, 1.0)
    # ratio and m of the way along which the robot steers for the next place
    steer_bound: tuple[float, float] = (1.5, 3.0)
    sight_m: float = 2.5  # a place that is so near, with a free way to it, is steered for anywhere
    known_way_m: float = 4.0  # the robot knows of no free way farther than this
    sight_slack_m: float = 0.3  # m; a way to a place may fall short by this
    hop_m: float = 1.0  # m; free length required of a way to steer along
    # of a direction's distance from that taken before, against that from where the place lies
    keep_course_weight: float = 0.5
    towards_rad: float = math.radians(110)  # no way farther off leads towards a place


@checked_names
@dataclasses.dataclass(frozen=True)
class Params(Settings):
    """Numbers of perception, driving and mapping besides those of `Tuning`."""

    sensing: Sensing = dataclasses.field(default_factory=Sensing)
    ground: Ground = dataclasses.field(default_factory=Ground)
    places: Places = dataclasses.field(default_factory=Places)
    graph: Graph = dataclasses.field(default_factory=Graph)
    motion: Motion = dataclasses.field(default_factory=Motion)
    route: Route = dataclasses.field(default_factory=Route)


def default_numbers() -> dict[str, float]:
    """Return the default of every number by its name: `graph.max_tries`, or `graph.match_drift.0` in a tuple."""
    found: dict[str, float] = {}
    for part, group in vars(Params()).items():
        for name, value in vars(group).items():
            several = enumerate(value) if isinstance(value, tuple) else [(None, value)]
            found |= {f"{part}.{name}" if i is None else f"{part}.{name}.{i}": number for i, number in several}
    return found
