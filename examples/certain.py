"""A robot that does not know its pose trades path for certainty: it prefers targets in sight of walls that it knows.

    python examples/certain.py [PICTURE]

The cost of a frontier cell is the path to it and a penalty for what the robot would be unsure of its pose there: the
odometry's drift on the way, less where many known walls can be matched. Prints how both strategies drive and how well
they know where they are; with the name of a file it also draws the first episodes.
"""

import sys

import jax.numpy as jnp
from jax import lax

import jexplore as jx

NEAR_M = 3.0  # walls within this square round a cell can be matched there


def certain(view: jx.View, penalty: float = 3.0, drift: float = 0.1, walls: float = 50.0):
    """Score frontier cells by path and uncertainty.

    `penalty`: metres of path that a metre of standard deviation is worth; `drift`: standard deviation after a metre
    without walls, in metres; `walls`: as many known cells of walls near a cell as halve the variance.
    """
    grid = view.belief.grid
    wall = jnp.where(grid.hits > grid.misses, 1.0, 0.0)
    side = 2 * int(NEAR_M / 0.1) + 1  # in cells of 10 cm
    near = lax.reduce_window(lax.reduce_window(wall, 0.0, lax.add, (side, 1), (1, 1), "SAME"),
                             0.0, lax.add, (1, side), (1, 1), "SAME")  # fmt: skip
    sd_m = drift * jnp.sqrt(jnp.where(jnp.isfinite(view.path_m), view.path_m, 0) / (1 + near / walls))
    return -(view.path_m + penalty * sd_m)


def main(picture: str | None = None) -> None:
    """Compare the strategy with the plain one."""
    strategies = ["closest+recheck", jx.strategy(certain, recheck=True)]
    odometry = {"length": 0.05, "length_scale": 1.05, "heading_deg_sqrt_m": 2.0}
    found = jx.compare("office", strategies, episodes=8, pose="icp", odometry=odometry)
    print(found.to_markdown())
    print(found.summary[["strategy", "ate_m", "free_iou"]].to_string(index=False))
    if picture is not None:
        found.paths_figure().savefig(picture)


if __name__ == "__main__":
    main(*sys.argv[1:2])
