"""A sweep over a strategy's own parameter: the weight of frontiers left behind.

    python examples/sweep.py [PICTURE]

`distance-advantage` goes to frontiers near the robot and far from all others; its weight says how much the second
counts. Prints the summary; with the name of a file it also draws the response.
"""

import sys

import jexplore as jx
from jexplore.studies.statistics.figures import response_figure

SPEC = {
    "worlds": [f"rooms#{seed}:width_m=8,height_m=8" for seed in range(4)],
    "strategies": [
        "closest+recheck",
        {"name": "distance-advantage+recheck", "weight": [0.1, 0.25, 0.5, 1.0, 2.0]},
    ],
    "episodes": 10,
    "lidar": {"range_m": [2.0, 4.0]},
}


def main(picture: str | None = None) -> None:
    """Run the sweep."""
    found = jx.sweep(SPEC)
    shown = found.summary.groupby(["lidar.range_m", "strategy"], sort=False)[["mean", "ratio", "complete"]]
    print(f"{len(found.episodes):,} episodes; means over {len(SPEC['worlds'])} worlds:\n\n{shown.mean().round(3)}")
    if picture is not None:
        one_line = found.episodes.assign(strategy=found.episodes["strategy"].str.partition(":")[0])
        response_figure(one_line, "strategy.weight", over_worlds=True).savefig(picture)


if __name__ == "__main__":
    main(*sys.argv[1:2])
