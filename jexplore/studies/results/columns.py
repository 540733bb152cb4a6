"""Names of columns of the tables of episodes and of their summaries. Importing this loads neither jax nor numpy."""

COLUMNS = (
    *("world", "strategy", "episode", "seed", "start_row", "start_col", "path_m", "turning_rad", "time_s", "energy_j"),
    *("steps", "scans", "plans", "outcome", "exhausted", "explored_fraction"),
    *("path_m_at_50", "path_m_at_90", "path_m_at_95", "path_m_at_99", "area_m", "room_entries"),
    *("time_s_at_50", "time_s_at_90", "time_s_at_95", "time_s_at_99", "area_s"),
    *("start_heading_deg", "refused", "saturated", "overflow"),
)
"""Columns of a table of episodes. `stats` and `plot` read them by these names."""
MEANS = ("plans", "scans", "turning_rad", "time_s", "energy_j", "explored_fraction", "exhausted", "room_entries")
"""Columns of which a summary has the means."""
SUMMARY_COLUMNS = (
    *("world", "strategy", "n", "mean", "sd", "ci_low", "ci_high", "ratio", "ratio_low", "ratio_high", "p"),
    "p_holm",
    *MEANS,
    "outcomes",
)
"""Columns of a summary by world and strategy."""
TEAM_MEASURES = "robots", "path_m_at_100", "path_sum_m", "overlap", "share_sd", "waits", "connected"
"""Columns of teams that are numbers: see `team_columns`."""
TEAM_COLUMNS = (*TEAM_MEASURES, "coordination", "contact")
"""Columns that tables of teams have besides `COLUMNS`."""
RATIO_COLUMNS = ("path_over_high", "path_over_low_any")
"""Columns of ratios of the path: to the walk that was found, and to the lower bound of every robot."""
