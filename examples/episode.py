"""One exploration episode in one file: scan, map, frontier, reachability, choice, motion.

    python examples/episode.py [WORLD]

The kernels are those of the package, the loop around them is plain Python. The robot goes to the nearest frontier
cell, by the default rules, and drives the same cells as `jx.explore(WORLD, "closest")`.
"""

import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np

import jexplore as jx
from jexplore.frontier import clear_cells, disc
from jexplore.grid import Grid, any_within_one, empty_grid, is_free, is_known, radius_d2
from jexplore.planning.readout import lay_route
from jexplore.raycast import beam_table, fold, scan, scans_all_round
from jexplore.reach import FAR, HEADING, MOTIONS, NO_MOTION, reach

LIDAR, RULES = jx.Lidar(), jx.Rules()


@jax.jit
def is_open(grid: Grid, driven, row, col):
    """Return whether the robot may step into a cell: it is free as far as is known, or was driven on."""
    return is_free(grid, RULES.p_free)[row, col] | driven[row, col]


@jax.jit
def live_cells(grid: Grid):
    """Return the cells with an unknown cell on one of their eight sides: `[H, W]` bool."""
    return any_within_one(~is_known(grid))


@functools.partial(jax.jit, static_argnames="cell_m")
def plan(grid: Grid, driven, exhausted, row, col, *, cell_m: float):
    """Choose the nearest frontier cell and lay the route to it.

    Returns:
      `(target, route)`: `[2]` int32, row and col, -1 where no frontier cell can be reached; `[H, W]` int8, in each cell
      of the route the motion to the next, an index into `MOTIONS`.
    """
    free = is_free(grid, RULES.p_free)
    clear = clear_cells(grid, p_free=RULES.p_free, clearance_d2=radius_d2(RULES.clearance_m, cell_m))
    near = disc(free.shape, row, col, radius_d2(RULES.near_m, cell_m))
    traversable = clear | (free & near) | driven
    cost = reach(traversable, row, col)  # [H, W] int32, the reachability map
    frontier = clear & live_cells(grid) & ~exhausted & (cost < FAR)
    at = jnp.argmin(jnp.where(frontier, cost, FAR))  # of equal costs the lowest index, row by row
    target = at // free.shape[1], at % free.shape[1]
    route = lay_route(jnp.full(free.shape, NO_MOTION, jnp.int8), cost, traversable, (row, col), target, (0, 0))
    return jnp.where(jnp.any(frontier), jnp.stack(target), -1), route


class Robot:
    """A robot in a world that it does not know. Cells are (row, col), headings are units of 45 degrees from +x."""

    def __init__(self, world: jx.World, start: tuple[int, int, int]):
        self.world = world  # walled all round, as `scan` needs it
        self.beams = beam_table(LIDAR, world.cell_m, world.shape[1])
        self.row, self.col, heading_deg = start
        self.heading = heading_deg // 45
        self.grid = empty_grid(world.shape)  # hits and misses of every cell: what the robot knows
        self.driven = jnp.zeros(world.shape, bool).at[self.row, self.col].set(True)
        self.exhausted = jnp.zeros(world.shape, bool)  # targets from which a look-around did not show everything
        self.path = [(self.row, self.col)]

    def scan(self) -> None:
        """Make one scan and count it: a miss in every cell that a beam passes, a hit where it is stopped."""
        pose = self.row, self.col, self.heading
        self.grid = fold(self.grid, *pose, scan(self.world.occupied, *pose, self.beams), self.beams)

    def turn(self, eighths: int, *, times: int) -> None:
        """Turn in place, with a scan after each turn."""
        for _ in range(times):
            self.heading = (self.heading + eighths) % 8
            self.scan()

    def step(self, motion: int) -> bool:
        """Turn towards a neighbouring cell, drive there unless it is blocked, and scan. Return whether it drove."""
        drow, dcol = MOTIONS[motion]
        row, col = self.row + drow, self.col + dcol
        self.heading = HEADING[motion]
        is_free_ahead = not self.world.occupied[row, col] and bool(is_open(self.grid, self.driven, row, col))
        if is_free_ahead:
            both_sides = np.array([row, row, self.row]), np.array([col, self.col, col])  # of a diagonal step
            self.driven = self.driven.at[both_sides].set(True)
            self.row, self.col = row, col
            self.path.append((row, col))
        self.scan()
        return is_free_ahead

    def drive(self, target: tuple[int, int], route: np.ndarray) -> None:
        """Follow a route until the target or a blocked cell; look around at a target that may still show something."""
        while (self.row, self.col) != target:
            if not self.step(route[self.row, self.col]):
                return
        if live_cells(self.grid)[target]:
            self.turn(2, times=3)
        if live_cells(self.grid)[target]:
            self.exhausted = self.exhausted.at[target].set(True)

    def explore(self) -> None:
        """Scan all round, then plan and drive until no frontier cell can be reached."""
        n = scans_all_round(LIDAR)
        self.turn(8 // n, times=n)
        while True:
            maps = self.grid, self.driven, self.exhausted
            target, route = plan(*maps, self.row, self.col, cell_m=self.world.cell_m)
            row, col = target.tolist()
            if row < 0:
                return
            self.drive((row, col), np.asarray(route))


def main(name: str = "cave") -> None:
    """Explores a world twice, once here and once by `jx.explore`."""
    world = jx.load_world(name)
    found = jx.explore(world, "closest")
    robot = Robot(world, found.start)
    robot.explore()
    explored = np.asarray(is_known(robot.grid))[~world.occupied].mean()
    print(f"{len(robot.path) - 1} steps, {explored:.1%} of the free cells of {world.name} known")
    same = robot.path == list(zip(found.final.rows, found.final.cols))
    print(f"jx.explore drove {'the same' if same else 'other'} cells")


if __name__ == "__main__":
    main(*sys.argv[1:2])
