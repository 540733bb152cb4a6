"""Settings of localisation and mapping by scans: every number is a leaf of a compiled program.

Plain Python: importing this loads neither jax nor numpy. The docstrings are the command line's help texts.
"""

import dataclasses

from jexplore.config import checked_names, is_array, require_number
from jexplore.rules import Settings


@checked_names
@dataclasses.dataclass(frozen=True)
class SlamSettings(Settings):
    """Thresholds of scan matching, of its map and of loop closing."""

    min_distance_m: float = 0.05
    """A point goes into the map only if none lies nearer, in metres."""
    gate_m: float = 0.2
    """Greatest distance of a point from its partner in the first round, in metres; at most 4 `min_distance_m`."""
    fine_gate_m: float = 0.1
    """The same in the last rounds, and the distance within which a point counts as matched."""
    noise_m: float = 0.03
    """Standard deviation of a point from its line, in metres."""
    isolated_m: float = 0.1
    """Standard deviation of a point from a partner that lies on no line, in metres."""
    huber: float = 1.5
    """A point farther from its line than this many standard deviations pulls no stronger."""
    line_reach_m: float = 0.5
    """Points as near as this count as neighbours on a line, in metres."""
    line_flatness: float = 0.1
    """A line's points vary across it by no more than this share of their variance along it."""
    max_facing_deg: float = 45.0
    """The normals of partners differ by less than this, in degrees."""
    settled_m: float = 5e-4
    """A match has settled when a round moves it by less than this, in metres and in radians."""
    min_points: float = 10.0
    """A match needs this many partners."""
    min_share: float = 0.8
    """A match of a smaller share of the scan's points is searched for anew, and the scan enters the map: it shows
    something new."""
    plain_share: float = 1.0
    """A match of a larger share of them is not searched for anew, however uncertain the odometry is."""
    degenerate_m: float = 0.05
    """A direction in which the scan alone gives a larger standard deviation than this, in metres, is degenerate."""
    correlation: float = 10.0
    """Neighbouring points err alike: this many count as one measurement."""
    max_deviations: float = 4.0
    """A match farther from the odometry than this many of its standard deviations is refused."""
    way_share: float = 0.05
    """Standard deviation of the odometry's way, as a share of that way."""
    way_m: float = 0.04
    """The same, a constant in every step, in metres."""
    turn_share: float = 0.05
    """Standard deviation of the odometry's turn, as a share of that turn."""
    turn_deg_m: float = 3.0
    """The same for every metre of way, in degrees."""
    turn_deg: float = 1.5
    """The same, a constant in every step, in degrees."""
    unknown_m: float = 1.0
    """Standard deviation of a step without odometry, in metres."""
    unknown_deg: float = 45.0
    """The same of its turn, in degrees."""
    search_turn_deg: float = 1.5
    """Step of the search in heading, in degrees."""
    search_blur_m: float = 0.1
    """A point of the search costs half the square of its distance over this, in metres, and
    `search_cap` at most: that of a point without any of the map within 4 `min_distance_m`."""
    search_cap: float = 2.0
    """The largest cost of a point."""
    key_m: float = 0.5
    """A scan enters the map after this way since the last one that did, in metres."""
    key_deg: float = 20.0
    """The same for a turn, in degrees."""
    key_sd_m: float = 0.02
    """Standard deviation that a measured step between key scans has besides its own, in metres."""
    key_sd_deg: float = 0.3
    """The same of its turn, in degrees."""
    close_every_m: float = 1.0
    """A loop is looked for every this much way, in metres."""
    close_m: float = 4.0
    """A key scan within this distance may close a loop if the way since is longer, in metres."""
    close_turn_m: float = 1.0
    """A radian of heading adds this to that distance, in metres."""
    close_share: float = 0.6
    """A loop needs a match of this share of the scan's points."""
    close_margin: float = 0.1
    """By how much more another place must cost than the place found."""
    close_doubt: float = 11.3
    """Squared misfit, in standard deviations, from which on a loop is refused and one closed before counts less: 1 in
    100 true ones err by more."""
    remake_m: float = 5.0
    """The map is made anew of the nearest key scans every this much way, in metres, where loops are closed."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not is_array(value):
                require_number(name, value, low_open=True, high=1e6)
