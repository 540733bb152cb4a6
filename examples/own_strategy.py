"""An own map, an own strategy, two scanners: drive on before turning back.

    python examples/own_strategy.py [PICTURE]

Prints a table for each scanner; with the name of a file it also draws the first episodes.
"""

import sys

import jax.numpy as jnp
import numpy as np

import jexplore as jx

PLAN = """\
######################
#......#......#......#
#......#......#......#
#...................##
#...................##
#......#......#......#
####..####..#####..###
#....................#
#....................#
###..######..####..###
#......#......#......#
#......#......#......#
#......#.............#
#......#.............#
######################
"""
BLOCK = 4  # cells of 10 cm along each side of a character: openings of two are 80 cm wide


def map_of(plan: str) -> jx.World:
    """Make a world from a drawing, `#` is wall."""
    walls = np.array([[sign == "#" for sign in line] for line in plan.splitlines()])
    occupied = np.kron(walls[::-1], np.ones((BLOCK, BLOCK))).astype(bool)  # row 0 of a world is at the bottom
    return jx.occupancy_to_world(occupied, cell_m=0.1, name="my floor")


def ahead(view: jx.View, turn_m: float = 1.0):
    """Score near cells high; those behind the robot count as `turn_m` metres farther."""
    robot = view.belief
    rows, cols = jnp.indices(view.cost.shape)
    bearing = jnp.arctan2(rows - robot.row, cols - robot.col) - robot.heading * jnp.pi / 4
    return -(view.path_m + turn_m * (1 - jnp.cos(bearing)) / 2)


def main(picture: str | None = None) -> None:
    """Compare the strategy with the plain one, for each scanner."""
    world = map_of(PLAN)
    strategies = ["closest+recheck", jx.strategy(ahead, recheck=True), jx.strategy(ahead, recheck=True, turn_m=3.0)]
    for range_m in (2.0, 8.0):
        found = jx.compare(world, strategies, episodes=20, lidar=jx.Lidar(range_m=range_m))
        print(f"A scanner that sees {range_m:g} m far:\n\n{found.to_markdown()}")
    if picture is not None:
        found.paths_figure().savefig(picture)


if __name__ == "__main__":
    main(*sys.argv[1:2])
